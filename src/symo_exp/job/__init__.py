"""One run: checked, built, trained, measured, kept."""
