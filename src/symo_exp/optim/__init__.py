"""Optimisers that use an epoch in a way of their own, beside those of torch."""
