"""Effect of the choice of test trajectories.

    python results/thesis/draws.py outputs/thesis SYSTEM ... > results/thesis/draws.md

A published integration error is a mean over 16 trajectories. For every finished run of 32
trajectories at the published learning rate it is made here over 256 others, and then over 16 of
these drawn at random, ten thousand times: a published figure is one such draw.
"""

import sys
from pathlib import Path

import hydra.utils
import numpy as np
import pandas as pd
import torch

import symo_exp
from symo_exp.data.draws import generate, uniform
from symo_exp.evaluation.evaluate import roll_out
from symo_exp.evaluation.measures import mean_squared
from symo_exp.mechanics.types import Trajectories
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.report.tables import ResultTable, markdown_table
from symo_exp.runs.folder import RunFolder
from symo_exp.systems.base import System
from symo_exp.thesis.published import TIME_STEPS, published

TRAJECTORIES, DRAWN, DRAWS = 256, 16, 10_000


def trajectories(system: System, config: dict) -> Trajectories:
    """Unforced, from other starts than those of any seed."""
    return generate(
        system,
        uniform(system.box, TRAJECTORIES, (2026, 0)),
        steps=config["integration_steps"] + 1,
        forced=False,
        solver=hydra.utils.instantiate(config["solver"]),
    )


def errors(model: DynamicsModel, system: System, true: Trajectories, over: str) -> np.ndarray:
    """The integration error of each of the trajectories, over the configuration or the state."""
    motion = roll_out(model.for_evaluation(), system, true)
    error = mean_squared(motion.q[:, 1:] - motion.q_true[:, 1:])
    if over == "state":
        error = 0.5 * (error + mean_squared(motion.v[:, 1:] - motion.v_true[:, 1:]))
    return error.numpy()


def draws(runs: Path, name: str) -> str:
    """A table of the runs of one system."""
    table = published()
    cells = table[
        (table.system == name)
        & (table.time_step == TIME_STEPS[name])
        & (table.metric == "integration_mse")
        & (table.n_traj == 32)
    ]
    over = cells.over.iloc[0]
    system = true = None
    rows = []
    for file in runs.glob(f"*-{name}-*/config.yaml"):
        folder = RunFolder(file.parent)
        config = folder.config()
        data = config["data"]
        if folder.outcome().status != "finished" or data["n_traj"] != 32:
            continue
        noise = data["noise_std"]
        alike = cells[cells.noise_std == noise]
        if config["learning_rate"] not in alike.learning_rate.to_numpy():
            continue
        method = file.parent.name.split("-")[0]
        model = symo_exp.load(file.parent)
        if isinstance(getattr(model, "objective", None), PreconditionedResidual):
            continue
        integrator = folder.about().parameters["integrator"]
        like = alike[(alike.method == method) & (alike.integrator == integrator)].value
        if true is None:  # the same for all of them
            system = hydra.utils.instantiate(config["system"])
            true = trajectories(system, data)
        error = errors(model, system, true, over)
        drawn = np.random.default_rng(0).choice(error, (DRAWS, DRAWN)).mean(1)
        figures = [np.median(error), error.mean(), *np.quantile(drawn, [0.05, 0.5, 0.95]), *like]
        row = [f"{method} {integrator}", f"{noise:g}", str(config["seed"])]
        row += [f"{x:.2g}" for x in figures]
        # The true systems have nothing published.
        row += [f"{100 * (drawn < x).mean():.0f} %" for x in like] or ["–", "–"]
        rows.append(row)
    head = ["run", "noise", "seed", "median", "mean", "16 drawn: 5 %", "50 %", "95 %"]
    head += ["published", "of draws below"]
    table = pd.DataFrame(sorted(rows), columns=head)
    return markdown_table(ResultTable(f"draws_{name}", f"{name}, over the {over}", table))


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder, *systems = sys.argv[1:]
    print("\n".join(draws(Path(folder), name) for name in systems), end="")
