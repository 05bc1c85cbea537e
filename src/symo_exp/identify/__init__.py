"""Identification: from recordings of a machine to a model of it, without an expert."""
