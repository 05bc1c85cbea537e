"""Everything that knows MLflow, which is imported (2.5 s) only when a store is opened."""
