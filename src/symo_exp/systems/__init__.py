"""The true mechanical systems, one file each."""
