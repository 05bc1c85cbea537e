"""Training: the learner, the trainer with its callbacks, checkpoints and resuming."""
