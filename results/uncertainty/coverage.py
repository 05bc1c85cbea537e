"""Coverage of 90 % intervals on simulated machines of random constants.

    python results/uncertainty/coverage.py SYSTEM FIRST COUNT [--optimizer NAME]

Each machine has constants within a factor of two of the system's, viscous friction, and four
recordings of 3 s with white noise of 1e-3 to 1e-2 rad or m. It moves by the midpoint rule in which
it is learned, so that intervals alone are tested, not an integrator. Its known equations are
learned from configurations and inputs, from constants that are wrong by up to 30 %; two further
recordings choose which parameters are kept.

A row is kept in ``runs.csv`` beside this file, in place of an earlier one. It has, for one machine
and optimiser, the number of physical parameters, how many lie in their intervals, their root mean
square error in standard deviations, the share of the configurations of unseen motions over 2 s that
lie in theirs, and the error of each parameter in standard deviations.
"""

import argparse
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from symo_exp.evaluation.parameters import Parameter, physical_parameters
from symo_exp.evaluation.recordings import HeldOutErrors
from symo_exp.evaluation.uncertainty import posterior_of
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Trajectories, Trajectory
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.models.symo import SyMo
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.optim.base import EpochOptimizer
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.optim.total_least_squares import TotalLeastSquares
from symo_exp.runs.instances import arguments_of
from symo_exp.systems.table import system as stated
from symo_exp.training.learner import Learner

H, STEPS, MOTIONS, UNSEEN, LEVEL = 0.05, 60, 4, 4, 0.9
SPREAD, WRONG = math.log(2.0), math.log(1.3)
CONSTANTS = {
    "pendulum": {"mass": 1.0, "length": 1.0},
    "cartpole": {"mass_cart": 1.0, "mass_pole": 0.3, "half_length": 0.5},
}
OPTIMIZERS: dict[str, Callable[..., EpochOptimizer]] = {
    "total_least_squares": partial(TotalLeastSquares, starts=1, start=6, epochs=6),
    "levenberg_marquardt": LevenbergMarquardt,
}
EPOCHS = {"total_least_squares": 30, "levenberg_marquardt": 12}
VALIDATE = 6
RUNS = Path(__file__).parent / "runs.csv"
KEY = ["system", "machine", "optimizer"]
COLUMNS = [
    *KEY, "noise", "noise_found", "parameters", "held", "rms_score", "rollouts_held", "scores",
]  # fmt: skip


def machine(kind: str, seed: int) -> tuple[Any, Any, float]:
    """The true system, the one that learning starts from, and the noise."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand(1, generator=generator))

    true = {k: x * math.exp(uniform(-SPREAD, SPREAD)) for k, x in CONSTANTS[kind].items()}
    off = {k: x * math.exp(uniform(-WRONG, WRONG)) for k, x in true.items()}
    n = stated(kind).coordinates.n
    viscous = [uniform(0.05, 0.3) for _ in range(n)]
    wrong = [x * math.exp(uniform(-WRONG, WRONG)) for x in viscous]
    sigma = 1e-3 * 10.0 ** uniform(0.0, 1.0)
    return (
        stated(kind, time_step=H, viscous=tuple(viscous), **true),
        stated(kind, time_step=H, viscous=tuple(wrong), **off),
        sigma,
    )


def learned(system: Any, objective: PreconditionedResidual) -> SyMo:
    return SyMo(
        partial(KnownLagrangian, system=system, fixed=["gravity"]),
        integrator=VariationalMidpoint(),
        root=Newton(tolerance=1e-10, max_iterations=50),
        dissipation=partial(KnownFriction, system=system),
        objective=objective,
        **arguments_of(system),
    ).double()


def motions(truth: SyMo, system: Any, count: int, seed: int, sigma: float) -> list[Trajectory]:
    q, v, u = system.box.points(count, seed)
    u = u[:, None].expand(-1, STEPS + 1, -1)
    q, v, _ = truth.flow.rollout(q, v, u)
    generator = torch.Generator().manual_seed(seed)
    noise = sigma * torch.randn(q.shape, dtype=torch.float64, generator=generator)
    return Trajectories(q + noise, v, u).each()


def table(model: SyMo) -> dict[str, Parameter]:
    posterior = None if model.posterior is None else model.posterior.parameters
    rows = physical_parameters(
        model.lagrangian, model.coordinates, list(model.parameters()), posterior
    )
    return {row.name: row for row in rows}


def trained(start: Any, kind: str, train: list[Trajectory], val: list[Trajectory]) -> SyMo:
    """The model as a run leaves it: the parameters that are best on held-out motions."""
    model = learned(start, PreconditionedResidual())
    learner = Learner(model, optimizer=OPTIMIZERS[kind])
    optimizer = learner.configure_optimizers()[0][0]
    given = train if optimizer.reads_trajectories else [learner.objective.cut(train)]
    for epoch in range(EPOCHS[kind]):
        optimizer.epoch(learner, given)
        if (epoch + 1) % VALIDATE == 0:
            optimizer.validated(torch.tensor(HeldOutErrors()(model, val)))
    optimizer.ended()
    model.posterior = posterior_of(model, learner.residuals, optimizer.estimate(), train, ())
    return model


def row(kind: str, seed: int, optimizer: str) -> dict[str, Any]:
    true, start, sigma = machine(kind, seed)
    exact = learned(true, PreconditionedResidual())
    train = motions(exact, true, MOTIONS, 10 * seed, sigma)
    model = trained(start, optimizer, train, motions(exact, true, 2, 10 * seed + 1, sigma))
    about = {"system": kind, "machine": seed, "optimizer": optimizer, "noise": sigma}
    if model.posterior is None:
        return about
    truth, found = table(exact), table(model)
    names = [name for name in truth if name in found and found[name].determined != "no"]
    scores = torch.tensor(
        [(found[k].value - truth[k].value) / found[k].standard_deviation for k in names]
    )
    bound = math.sqrt(2.0) * float(torch.erfinv(torch.tensor(LEVEL)))
    unseen = motions(exact, true, UNSEEN, 10 * seed + 2, 0.0)
    q, v, u = (torch.stack(x)[:, : round(2.0 / H) + 1] for x in zip(*unseen, strict=True))
    interval = model.for_evaluation().rollout_interval(q[:, 0], v[:, 0], u, level=LEVEL)
    inside = ((interval.lower <= q) & (q <= interval.upper))[:, 1:].double()
    return about | {
        "noise_found": model.posterior.parameters.noise,
        "parameters": len(names),
        "held": int((scores.abs() <= bound).sum()),
        "rms_score": float(scores.square().mean().sqrt()),
        "rollouts_held": float(inside.mean()),
        "scores": " ".join(f"{x:.2f}" for x in scores.tolist()),
    }


def keep(rows: pd.DataFrame, file: Path) -> None:
    """Add rows in place of earlier ones."""
    before = [pd.read_csv(file)] if file.exists() else []
    both = pd.concat([*before, rows]).drop_duplicates(KEY, keep="last")
    both.to_csv(file, index=False, float_format="%.4g")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("system", choices=list(CONSTANTS))
    parser.add_argument("first", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--optimizer", action="append", choices=list(OPTIMIZERS))
    given = parser.parse_args()
    chosen = given.optimizer or list(OPTIMIZERS)
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    for seed in range(given.first, given.first + given.count):
        rows = pd.DataFrame([row(given.system, seed, kind) for kind in chosen], columns=COLUMNS)
        keep(rows, RUNS)
