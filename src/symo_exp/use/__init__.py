"""Use of trained models: runs from Python, environments, exported files."""
