"""`python -m benchmarks.run [--quick]`: the project beside its two baselines, one thread.

First every contender must compute the same loss, gradient and prediction; then they are timed in
interleaved rounds. Writes `measurements.csv` and `table.md` into the folder given by --out.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

from benchmarks import agreement, tables
from benchmarks.cases import CASES, METHODS, initial_weights, training_batch
from benchmarks.contenders import Autograd, Contender, Jax, jax_is_installed
from benchmarks.plausible import plausible_weights
from benchmarks.project import Project, compiler_available, trained_weights, whole_fit
from benchmarks.tables import Row
from benchmarks.timing import interleaved
from symo_exp.mechanics.types import Windows
from symo_exp.training.allocator import keep_freed_memory

BATCHES = (32, 128, 512)
EVALUATION_ROWS = 4096
ROLLOUTS, ROLLOUT_STEPS = 16, 500
FIT_BATCH = 128


MEASURES = ("step", "evaluation", "rollout", "fit", "hard")


@dataclass(frozen=True)
class Plan:
    """Selection and duration of the measurements."""

    measures: tuple[str, ...]
    systems: tuple[str, ...]
    methods: tuple[str, ...]
    batches: tuple[int, ...]
    rounds: int
    heavy_rounds: int
    turn_ms: float
    rollout_steps: int
    baseline_rollout_steps: int
    fit_epochs: int
    fit_seconds: float
    fit_rounds: int
    clock: Callable[[], float]
    compiled: bool


def contenders(system: str, method: str, *, lr: float = 0.0) -> dict[str, Contender]:
    """All implementations on the same weights. With lr = 0 a step costs what it costs, and the
    weights stay what they are, so that every round measures the same thing."""
    case, layers = CASES[system], trained_weights(system, method)
    found: dict[str, Contender] = {"autograd": Autograd(method, case, layers, lr=lr)}
    if jax_is_installed():
        found["jax"] = Jax(method, case, layers, lr=lr)
    found["project"] = Project(method, case, layers, lr=lr)
    return found


def cells(plan: Plan) -> Iterator[Row]:
    """Every measurement of the plan."""
    for system in plan.systems:
        for method in plan.methods:
            group = contenders(system, method)
            for rows in plan.batches if "step" in plan.measures else ():
                step = dict.fromkeys(group, lambda c, b: c.train_step(b))
                if plan.compiled:  # a graph may belong to one number of rows
                    group["compiled"], step["compiled"] = compiled(system, method), step["project"]
                windows = training_batch(system, rows)
                yield from measure(plan, "step", system, method, windows, group, step)
            group.pop("compiled", None)
            if "evaluation" in plan.measures:
                predict = dict.fromkeys(group, lambda c, b: c.predict(b))
                windows = training_batch(system, EVALUATION_ROWS)
                yield from measure(plan, "evaluation", system, method, windows, group, predict)
            if "rollout" in plan.measures:
                yield from rollout_cells(plan, system, method, group)
            if "fit" in plan.measures:
                yield from fit_cells(plan, system, method)
        if "hard" in plan.measures:
            group, windows = hard_contenders(system), training_batch(system, 32)
            step = dict.fromkeys(group, lambda c, b: c.train_step(b))
            yield from measure(plan, "hard rows", system, "e2e_symo", windows, group, step)


def compiled(system: str, method: str) -> Project:
    return Project(method, CASES[system], trained_weights(system, method), lr=0.0, compiled=True)


def measure(
    plan: Plan,
    name: str,
    system: str,
    method: str,
    windows: Windows,
    group: dict[str, Contender],
    calls: dict[str, Callable[[Contender, Any], object]],
    scale: dict[str, float] | None = None,
) -> Iterator[Row]:
    """Calls of contenders in interleaved rounds; `scale` multiplies the times of some."""
    batches = {k: c.prepare(windows) for k, c in group.items()}
    bound = {k: partial(calls[k], group[k], batches[k]) for k in calls}
    heavy = name in ("evaluation", "rollout")
    times = interleaved(
        bound,
        rounds=plan.heavy_rounds if heavy else plan.rounds,
        turn_ms=plan.turn_ms,
        warm_up=1 if heavy else 2,
        clock=plan.clock,
    )
    for k, t in times.items():
        s = (scale or {}).get(k, 1.0)
        taken = group[k].iterations(batches[k], training=not heavy)
        rows = len(windows.q)
        yield Row(name, system, method, rows, k, s * t.median, s * t.low, s * t.high, taken)


def rollout_cells(
    plan: Plan, system: str, method: str, group: dict[str, Contender]
) -> Iterator[Row]:
    """Rollouts, unforced as the protocol's; some steps tell the cost of all."""
    windows = training_batch(system, ROLLOUTS)
    still = torch.zeros_like(windows.u)
    windows = windows._replace(u_prev=still, u=still, u_next=still)
    few = plan.baseline_rollout_steps
    if plan.compiled:
        group = group | {"compiled": compiled(system, method)}
    roll = dict.fromkeys(group, lambda c, b: c.rollout(b, plan.rollout_steps))
    roll["autograd"] = lambda c, b: c.rollout(b.rows(slice(1)), few)  # it takes one row at a time
    scale = dict.fromkeys(roll, ROLLOUT_STEPS / plan.rollout_steps)
    scale["autograd"] = ROLLOUTS * ROLLOUT_STEPS / few
    yield from measure(plan, "rollout", system, method, windows, group, roll, scale)


def fit_cells(plan: Plan, system: str, method: str) -> Iterator[Row]:
    """`Trainer.fit` per optimiser step beside the steps in it: the round of the median ratio."""
    layers = trained_weights(system, method)
    with whole_fit(
        method,
        CASES[system],
        layers,
        FIT_BATCH,
        epochs=plan.fit_epochs,
        seconds=plan.fit_seconds,
        clock=plan.clock,
    ) as fit:
        rounds = sorted((fit() for _ in range(plan.fit_rounds)), key=lambda t: t[1] / t[0])
    middle = rounds[len(rounds) // 2]
    for name, ms, all_ms in zip(("bare", "fit"), middle, zip(*rounds, strict=True), strict=True):
        low, high = 1e3 * min(all_ms), 1e3 * max(all_ms)
        yield Row(name, system, method, FIT_BATCH, "project", 1e3 * ms, low, high, None)


def hard_contenders(system: str) -> dict[str, Contender]:
    """Return implementations of E2E-SyMo where its training starts.

    At the Xavier weights of the thesis' text some rows have no root; where the inertia is half as
    large again as it should be, all have.
    """
    case = CASES[system]
    starts = {
        "initial weights": initial_weights(case, "e2e_symo"),
        "half as heavy again": plausible_weights(system, "e2e_symo"),
    }
    group: dict[str, Contender] = {}
    for start, layers in starts.items():
        group |= {
            f"autograd, {start}": Autograd("e2e_symo", case, layers, lr=0.0),
            f"project, {start}": Project("e2e_symo", case, layers, lr=0.0),
            f"project, whole batch, {start}": Project(
                "e2e_symo", case, layers, lr=0.0, stopping="batch", guess="inertial"
            ),
        }
    return group


def machine() -> str:
    """Return a description of the machine."""
    name = platform.processor() or platform.machine()
    path = Path("/proc/cpuinfo")
    if path.exists():
        models = [
            x.split(":")[1].strip() for x in path.read_text().splitlines() if "model name" in x
        ]
        name = models[0] if models else name
    return f"{name}, one thread, Python {platform.python_version()}, torch {torch.__version__}"


def main(arguments: list[str] | None = None) -> None:
    """Check, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the acrobot only, two minutes")
    parser.add_argument("--measures", nargs="+", choices=MEASURES, default=list(MEASURES))
    parser.add_argument("--systems", nargs="+", choices=list(CASES))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--batches", nargs="+", type=int)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument(
        "--process-clock", action="store_true", help="count processor time: for a shared machine"
    )
    parser.add_argument(
        "--compiled",
        action=argparse.BooleanOptionalAction,
        help="measure what is compiled too (default: unless --quick; compiling takes long)",
    )
    given = parser.parse_args(arguments)
    if given.compiled is None:
        given.compiled = not given.quick
    given.batches = given.batches or ([128] if given.quick else list(BATCHES))
    given.systems = given.systems or (["acrobot"] if given.quick else list(CASES))
    plan = Plan(
        tuple(given.measures),
        tuple(given.systems),
        tuple(given.methods),
        tuple(given.batches),
        rounds=5 if given.quick else 21,
        heavy_rounds=1 if given.quick else 7,
        turn_ms=5.0 if given.quick else 60.0,
        rollout_steps=50 if given.quick else ROLLOUT_STEPS,
        baseline_rollout_steps=10 if given.quick else 100,
        fit_epochs=5 if given.quick else 50,
        fit_seconds=0.0 if given.quick else 6.0,
        fit_rounds=1 if given.quick else 3,
        clock=time.process_time if given.process_clock else time.perf_counter,
        compiled=given.compiled and compiler_available(),
    )
    if hasattr(os, "sched_setaffinity"):  # XLA's threads, too, have to share one core
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    keep_freed_memory()  # for everybody
    if not jax_is_installed():
        print("JAX is not installed: baseline (b) is skipped (pip install 'symo_exp[bench]')")
    differences = agreement.check(given.systems, given.methods, compiled=plan.compiled)
    worst = max(d.gradient for d in differences)
    print(f"all contenders compute the same numbers (gradients to {worst:.1e} of float64)")
    given.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    with (given.out / "measurements.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [f.name for f in fields(Row)])
        writer.writeheader()
        for row in cells(plan):
            rows.append(row)
            writer.writerow(asdict(row))
            stream.flush()
            print(
                f"{row.measure:10} {row.system:9} {row.method:9} {row.batch:5} "
                f"{row.contender:20} {row.ms:10.3f} ms",
                file=sys.stderr,
            )
    text = tables.report(rows, machine=machine(), worst_gradient=worst)
    (given.out / "table.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
