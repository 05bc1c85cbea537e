"""Trained models at work: runs from Python, and their steps without this package."""
