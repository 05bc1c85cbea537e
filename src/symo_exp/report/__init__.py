"""Tracked runs to tables, figures and pictures."""
