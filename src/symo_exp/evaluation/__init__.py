"""Rollouts and measures, written once for every method."""
