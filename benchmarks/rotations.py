"""`python -m benchmarks.rotations`: steps and rollouts on a rotation beside flat coordinates.

Both systems have three degrees of freedom, a network of the same width and the same samples in
number: a chain of three pendulums and a spherical pendulum. Eager, double precision. Writes
`rotations.csv` and prints a table of milliseconds and ratios.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pandas as pd
import torch

from benchmarks.run import machine
from benchmarks.timing import interleaved
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import VariationalIntegrator, VariationalMidpoint
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.e2e_symo import E2ESyMo
from symo_exp.models.learned import MakesLagrangian
from symo_exp.models.symo import SyMo
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.runs.instances import arguments_of
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system

BATCH, ROLLOUTS, STEPS = 128, 16, 50
FLAT = "flat"
"""The contender that others are compared with."""


def contenders() -> dict[str, tuple[LagrangianSystem, MakesLagrangian]]:
    """Return systems of three degrees of freedom with the Lagrangians to be learned."""
    network = partial(NetworkLagrangian, width=64)
    pendulum = system("spherical_pendulum")
    return {
        FLAT: (ChainPendulum(3), network),
        "rotation, network": (pendulum, network),
        "rotation, rigid body": (pendulum, LearnedRigidBody),
    }


INTEGRATORS: dict[str, VariationalIntegrator] = {
    "order 2": VariationalMidpoint(), "order 4": Galerkin(stages=2), "order 6": Galerkin(stages=3),
}  # fmt: skip


def calls(integrator: VariationalIntegrator) -> dict[str, dict[str, Callable[[], object]]]:
    """Return what is timed, by measure and contender."""
    found: dict[str, dict[str, Callable[[], object]]] = {}
    for name, (truth, lagrangian) in contenders().items():
        q, v, u = truth.points(BATCH, seed=0)
        windows = cut_windows(simulate(truth, q, v, u, 2, Solver(rtol=1e-8, atol=1e-8)).each())
        for kind in (SyMo, E2ESyMo):
            torch.manual_seed(0)
            model = kind(
                lagrangian,
                integrator=integrator,
                root=Newton(tolerance=1e-8, max_iterations=20),
                **arguments_of(truth),
            )

            def step(model: SyMo | E2ESyMo = model, windows: Windows = windows) -> None:
                model.zero_grad()
                residuals = model.objective(model.flow, windows)
                residuals.values.square().mean().backward()

            found.setdefault(f"{kind.__name__} step", {})[name] = step
        start = q[:ROLLOUTS], v[:ROLLOUTS], torch.zeros(ROLLOUTS, STEPS + 1, u.shape[1])
        found.setdefault("rollout step", {})[name] = partial(model.flow.rollout, *start)
    return found


def main(arguments: list[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--process-clock", action="store_true", help="count processor time")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    given.out.mkdir(parents=True, exist_ok=True)
    clock = time.process_time if given.process_clock else time.perf_counter
    rows: list[dict[str, object]] = []
    print(machine())
    for order, integrator in INTEGRATORS.items():
        for measure, of in calls(integrator).items():
            each = STEPS if measure.startswith("rollout") else 1
            times = interleaved(of, rounds=11, turn_ms=100, clock=clock)
            for name, t in times.items():
                ratio = t.median / times[FLAT].median
                rows.append({
                    "measure": measure, "integrator": order, "contender": name,
                    "ms": t.median / each, "ratio": ratio,
                })  # fmt: skip
                print(f"{measure:14} {order:8} {name:21} {t.median / each:8.2f} ms {ratio:6.2f}")
    pd.DataFrame(rows).to_csv(given.out / "rotations.csv", index=False)


if __name__ == "__main__":
    main()
