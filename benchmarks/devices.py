"""`python -m benchmarks.devices`: a training step on a core of the processor and on a GPU.

Time per optimiser step of the acrobot's networks (two layers of 256 units, single precision)
against the number of rows in a batch, compiled on the processor, as they are and compiled on the
GPU. Writes `devices.csv` and prints a table.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pandas as pd
import torch

from benchmarks.cases import CASES, METHODS, calm_weights, random_windows
from benchmarks.project import Project
from benchmarks.run import machine
from benchmarks.tables import table
from benchmarks.timing import interleaved
from symo_exp.mechanics.types import Windows

ROWS = (32, 128, 512, 2048, 8192, 32768)
MOST_ON_A_CORE = 2048
KINDS = {"core": ("cpu", True), "gpu": ("cuda", False), "gpu_compiled": ("cuda", True)}
"""Name of a column, its device, and whether the step is compiled."""


def measure(methods: list[str], kinds: list[str], rounds: int) -> Iterator[dict[str, object]]:
    """Yield a row each method, kind and batch: milliseconds of an optimiser step."""
    case = CASES["acrobot"]
    for method in methods:
        for kind in kinds:
            device, compiled = KINDS[kind]
            contender = Project(
                method, case, calm_weights(case, method), lr=0.0, compiled=compiled, device=device
            )
            for rows in ROWS:
                if device == "cpu" and rows > MOST_ON_A_CORE:
                    continue
                batch = contender.prepare(random_windows(case, rows))
                calls = {kind: partial(_step, contender, batch)}
                found = interleaved(calls, rounds=rounds, turn_ms=50)[kind]
                yield {"method": method, "kind": kind, "rows": rows, "ms": round(found.median, 3)}


def _step(contender: Project, batch: Windows) -> None:
    contender.train_step(batch)
    if contender.device != "cpu":
        torch.cuda.synchronize()


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=None)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    there = torch.cuda.is_available()
    kinds = given.kinds or [k for k, (device, _) in KINDS.items() if there or device == "cpu"]
    print(machine(), torch.cuda.get_device_name() if there else "")
    given.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, object]] = []
    for row in measure(given.methods, kinds, given.rounds):
        rows.append(row)
        # a measurement that is stopped keeps its rows
        pd.DataFrame(rows).to_csv(given.out / "devices.csv", index=False)
    found = {(row["method"], row["kind"], row["rows"]): row["ms"] for row in rows}
    lines = [
        [*pair, *(str(found.get((*pair, count), "–")) for count in ROWS)]
        for pair in dict.fromkeys((str(row["method"]), str(row["kind"])) for row in rows)
    ]
    print(table(["", "", *map(str, ROWS)], lines))


if __name__ == "__main__":
    main()
