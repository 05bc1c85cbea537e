"""Lagrangian and discrete mechanics: torch only, no networks, no configuration."""
