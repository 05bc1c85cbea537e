"""Models of noisy trajectories by the command for machines, beside runs with settings by hand.

    python results/noise/one_command.py [SETTING=VALUE ...] RUN ... >> results/noise/one_command.csv

The noisy trajectories of every run of ``noise_robust`` are written as a log, from which
``-cn machine`` with these settings chooses and trains a model. Both models are rolled out along the
motions that the run was measured on.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from hydra.utils import instantiate
from omegaconf import OmegaConf

import symo_exp
from symo_exp.data.base import DataModule
from symo_exp.evaluation.measures import mean_squared
from symo_exp.evaluation.rollouts import roll_out
from symo_exp.mechanics.types import Trajectories
from symo_exp.models.base import DynamicsModel
from symo_exp.systems.base import System

STEPS = {"acrobot": 100}
"""Steps of a rollout, 500 of other systems."""


def main(words: list[str]) -> None:
    """Search for a model of every run's data, and print a row for each."""
    settings = [word for word in words if "=" in word]
    for run in (word for word in words if "=" not in word):
        config = OmegaConf.load(Path(run) / "config.yaml")
        system = instantiate(config.system)
        data = instantiate(config.data, _partial_=True)(system=system)
        data.setup()
        name = type(system).__name__.lower()
        steps, experiment = STEPS.get(name, 500), f"{name}_{config.data.noise_std}_{config.seed}"
        log = Path(f"{experiment}.parquet")
        pd.concat(recordings(data, system)).to_parquet(log, index=False)
        begun = time.monotonic()
        search(log, system, [f"experiment={experiment}", *settings])
        seconds = time.monotonic() - begun
        models = symo_exp.load(run), symo_exp.load(f"outputs/{experiment}/best")
        errors = [f"{error(model, data.integration, steps):.3g}" for model in models]
        table = pd.read_csv(f"outputs/{experiment}/candidates.csv")
        chosen = table[table.chosen == 1].candidate.item()
        row = [name, config.data.noise_std, config.seed, *errors, f'"{chosen}"', f"{seconds:.0f}"]
        print(*row, sep=",", flush=True)


def recordings(data: DataModule, system: System) -> Iterator[pd.DataFrame]:
    """Yield the noisy trajectories and, as the test part, the motions without noise."""
    noisy = [*data.trajectories("train"), *data.trajectories("held_out")]
    clean = list(zip(data.integration.q, data.integration.u, strict=True))
    for split, motions in ("train", [(t.q, t.u) for t in noisy]), ("test", clean):
        for place, (q, u) in enumerate(motions):
            columns = {f"q_{name}": q[:, i] for i, name in enumerate(system.coordinates.names)}
            columns |= {f"u_{name}": u[:, i] for i, name in enumerate(system.inputs)}
            t = system.time_step * np.arange(len(q))
            yield pd.DataFrame(
                {"trajectory": f"{split}-{place}", "split": split, "t": t, **columns}
            )


def search(log: Path, system: System, settings: list[str]) -> None:
    """Search for a model of a log; lines of the search go to standard error."""
    matrix = f"system.input_matrix={str(system.input_matrix.tolist()).replace(' ', '')}"
    words = ["-cn", "machine", f"data.path={log}", matrix, *settings]
    subprocess.run([sys.executable, "-m", "symo_exp", *words], check=True, stdout=sys.stderr)


def error(model: DynamicsModel, motions: Trajectories, steps: int) -> float:
    """Return the mean squared error of rollouts along motions [rad², m²]."""
    errors = roll_out(model.for_evaluation(), None, motions).errors()
    return mean_squared(errors[:, 1 : steps + 1]).mean().item()


if __name__ == "__main__":
    main(sys.argv[1:])
