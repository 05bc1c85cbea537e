"""Mechanical systems: known ones, MuJoCo models, recorded machines, and their simulation."""
