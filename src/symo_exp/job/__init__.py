"""One run: checks, construction, training, measures, saving."""
