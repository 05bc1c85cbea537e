"""Settings of runs that take a second."""

import shutil

TINY = [
    "net.width=8",
    "trainer.max_epochs=2",
    "trainer.validate_every=1",
    "data.n_traj=2",
    "data.n_steps=8",
    "data.n_train_max=4",
    "data.n_val=2",
    "data.n_test=2",
    "data.n_integration=2",
    "data.integration_steps=20",
    "data.monitor_trajectories=2",
    "data.solver={method: RK45, rtol: 1e-4, atol: 1e-4}",
    "data.cache_dir=cache",
]


def copy_store(database, folder):
    """Copy an empty store to where commands look for one: MLflow takes seconds to make it."""
    (folder / "mlruns").mkdir()
    shutil.copy(database, folder / "mlruns" / "mlflow.db")
