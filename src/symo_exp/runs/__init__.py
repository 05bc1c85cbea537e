"""The folder of a run: what is in it, who works on it, how it ended, and its model."""
