"""Stores of runs: MLflow as a view of run folders."""
