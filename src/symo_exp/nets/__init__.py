"""Learned Lagrangians and dissipation, and the networks that they consist of."""
