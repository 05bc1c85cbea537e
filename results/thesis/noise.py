"""Effect of noise on SyMo's losses.

    python results/thesis/noise.py outputs/thesis SYSTEM ... > results/thesis/noise.md

For every finished run of SyMo and E2E-SyMo under noise, on the noisy windows that it was trained
on: the mean squares of the residual g and of the preconditioned one h H⁻¹ g, for the true
Lagrangian in the same integrator and for the learned one, and the share of the true inertia that
was learned. Where the learned residual is below the true one, the loss leads away from the truth.
"""

import sys
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

import symo_exp
from symo_exp.data.base import DataModule
from symo_exp.mechanics.types import Windows
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import PreconditionedResidual, Residual
from symo_exp.models.true import TrueVariational
from symo_exp.report.tables import ResultTable, markdown_table
from symo_exp.runs.folder import RunFolder
from symo_exp.runs.instances import arguments_of, instance_of

HEAD = [
    "run", "noise", "learning rate", "seed", "g²: true", "learned", "(h H⁻¹ g)²: true", "learned",
    "inertia, learned / true",
]  # fmt: skip


def training_windows(config: dict, system: object) -> Windows:
    """Return the training windows of a run, in float64."""
    settings = config["data"] | {"dtype": "float64", "shuffle": False}
    data: DataModule = instance_of(settings, system=system)
    data.setup()
    return data.train


def inertia(model: DynamicsModel, windows: Windows) -> Tensor:
    """The mean trace of H over the configurations."""
    return model.lagrangian.mass_matrix(windows.q).diagonal(dim1=1, dim2=2).sum(1).mean()


def squares(model: DynamicsModel, windows: Windows) -> list[float]:
    return [float(it(model.flow, windows).loss) for it in (Residual(), PreconditionedResidual())]


@torch.no_grad()
def table(runs: Path, name: str) -> str:
    """The runs of one system."""
    rows = []
    for file in runs.glob(f"*symo-{name}-*/config.yaml"):
        folder = RunFolder(file.parent)
        config = folder.config()
        noise = config["data"]["noise_std"]
        if not noise or folder.outcome().status != "finished":
            continue
        learned = symo_exp.load(file.parent, dtype=torch.float64).for_evaluation().double()
        system = instance_of(config["system"])
        truth = TrueVariational(
            lagrangian=system,
            integrator=learned.flow.integrator,
            root=learned.flow.root,
            **arguments_of(system),
        ).double()
        windows = training_windows(config, system)
        pairs = zip(squares(truth, windows), squares(learned, windows), strict=True)
        share = inertia(learned, windows) / inertia(truth, windows)
        figures = [*(x for pair in pairs for x in pair), share]
        method, rate = file.parent.name.split("-")[0], config["learning_rate"]
        objective = config["model"].get("objective", {}).get("_target_", "")
        if objective.endswith("PreconditionedResidual"):
            method += ", preconditioned"
        rows.append((method, noise, rate, config["seed"], [f"{x:.2g}" for x in figures]))
    told = [(run, *(f"{x:g}" for x in cell), *shown) for run, *cell, shown in sorted(rows)]
    return markdown_table(ResultTable(f"noise_{name}", name, pd.DataFrame(told, columns=HEAD)))


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder, *systems = sys.argv[1:]
    print("\n".join(table(Path(folder), name) for name in systems), end="")
