"""Settings that have moved, by their old names."""

MOVED = {
    "pair": "model=... integrator",
    "structure": "lagrangian",
    "axes": "lagrangian.axes",
    "harmonics": "lagrangian.harmonics",
    "initial_inertia": "lagrangian.initial_inertia",
    "model.structure": "lagrangian",
    "model.axes": "lagrangian.axes",
    "model.harmonics": "lagrangian.harmonics",
    "model.initial_inertia": "lagrangian.initial_inertia",
    "model.width": "net.width",
    "model.depth": "net.depth",
    "gradient_clip": "learner.gradient_clip",
    "scheduler_monitor": "learner.scheduler_monitor",
    "validation": "learner.validation",
    "model.optimizer": "learner.optimizer",
    "model.scheduler": "learner.scheduler",
    "model.gradient_clip": "learner.gradient_clip",
    "model.scheduler_monitor": "learner.scheduler_monitor",
    "model.validation": "learner.validation",
}
"""Old name to new name."""
