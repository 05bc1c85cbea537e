"""Fitting a model: the trainer, what watches it, and what is left of it."""
