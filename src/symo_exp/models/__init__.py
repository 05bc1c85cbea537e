"""The four methods as plain modules: a flow, and an objective to train it on."""
