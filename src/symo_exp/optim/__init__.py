"""Optimisers of whole epochs, beside those of torch, and the posterior of their estimates."""
