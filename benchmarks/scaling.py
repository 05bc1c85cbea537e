"""`python -m benchmarks.scaling`: growth of the cost of a training step.

Time per optimiser step of the project against batch, width and number of coordinates, one series
a method, with the exponent of a power law fitted to the upper half of each series; and the peak
memory of a process that trains. Writes `scaling.csv`, `memory.csv` and `scaling.png`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import torch

from benchmarks.cases import CASES, METHODS, Case, calm_weights, chain, random_windows
from benchmarks.project import Project
from benchmarks.tables import NAMES
from benchmarks.timing import interleaved
from symo_exp.report.looks import METHODS as METHOD_LOOKS

Point = tuple[int, Case, int]
"""(the abscissa, the case, the batch)."""


def axes(*, quick: bool) -> dict[str, list[Point]]:
    """The varied quantity; all else is the acrobot with batch 128 and width 256."""
    base = CASES["acrobot"]
    batches = (32, 128, 512) if quick else (16, 32, 64, 128, 256, 512, 1024, 2048)
    widths = (64, 256, 512) if quick else (32, 64, 128, 256, 512, 1024)
    counts = (1, 2, 4, 8) if quick else tuple(range(1, 9))
    return {
        "batch": [(b, base, b) for b in batches],
        "width": [(w, replace(base, width=w), 128) for w in widths],
        "coordinates": [(n, chain(n), 128) for n in counts],
    }


def measure(*, quick: bool, process_clock: bool) -> list[dict[str, Any]]:
    """Milliseconds of an optimiser step at every point, all points of a series interleaved."""
    clock = time.process_time if process_clock else time.perf_counter
    rows: list[dict[str, Any]] = []
    for axis, points in axes(quick=quick).items():
        for method in METHODS:
            calls = {}
            for x, case, rows_in_batch in points:
                contender = Project(method, case, calm_weights(case, method), lr=0.0)
                batch = contender.prepare(random_windows(case, rows_in_batch))
                calls[str(x)] = lambda c=contender, b=batch: c.train_step(b)
            times = interleaved(calls, rounds=3 if quick else 11, turn_ms=20, clock=clock)
            for x, t in times.items():
                rows.append({"axis": axis, "method": method, "x": int(x), "ms": t.median})
            print(f"{axis:12} {method:9} exponent {exponent(rows, axis, method):.2f}", flush=True)
    return rows


def exponent(rows: list[dict[str, Any]], axis: str, method: str) -> float:
    """k of ms ~ x^k by least squares over the upper half of a series, where fixed costs fade."""
    series = sorted((r["x"], r["ms"]) for r in rows if (r["axis"], r["method"]) == (axis, method))
    upper = np.log(series[len(series) // 2 - (len(series) < 4) :])
    return float(np.polyfit(*upper.T, 1)[0])


MEMORY = """
import sys, torch
torch.set_num_threads(1)
from benchmarks.cases import CASES, calm_weights, random_windows
from benchmarks.project import Project
def peak():  # getrusage would count what the parent used before exec
    with open("/proc/self/status") as lines:
        return next(int(x.split()[1]) / 1024 for x in lines if x.startswith("VmHWM"))
case, method, batch = CASES["acrobot"], sys.argv[1], int(sys.argv[2])
imported = peak()
contender = Project(method, case, calm_weights(case, method))
rows = contender.prepare(random_windows(case, batch))
for _ in range(5):
    contender.train_step(rows)
print(imported, peak())
"""


def memory(batches: tuple[int, ...]) -> list[dict[str, Any]]:
    """Peak resident memory [MiB] of a fresh process (Linux): after imports, and after training."""
    rows: list[dict[str, Any]] = []
    for method in METHODS:
        for batch in batches:
            command = [sys.executable, "-c", MEMORY, method, str(batch)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            imported, trained = map(float, done.stdout.split())
            rows.append(
                {"method": method, "batch": batch, "imported_mib": imported, "peak_mib": trained}
            )
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """One panel an axis, double logarithmic, the exponents in the legends."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullLocator, ScalarFormatter

    names = {"batch": "batch [rows]", "width": "hidden width", "coordinates": "coordinates n"}
    figure, panels = plt.subplots(1, len(names), figsize=(12, 4), sharey=True, layout="tight")
    for panel, (axis, label) in zip(panels, names.items(), strict=True):
        for method in METHODS:
            series = [r for r in rows if (r["axis"], r["method"]) == (axis, method)]
            power = exponent(rows, axis, method)
            panel.loglog(
                [r["x"] for r in series],
                [r["ms"] for r in series],
                "o-",
                color=METHOD_LOOKS[method].colour,
                label=f"{NAMES[method]}, $x^{{{power:.2f}}}$",
            )
        panel.set_xlabel(label)
        panel.set_xticks([r["x"] for r in series])
        panel.xaxis.set_major_formatter(ScalarFormatter())
        panel.xaxis.set_minor_locator(NullLocator())
        panel.legend(fontsize="small")
        panel.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("optimiser step [ms]")
    figure.savefig(path, dpi=150)


def main(arguments: list[str] | None = None) -> None:
    """Measure, fit, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--process-clock", action="store_true")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    rows = measure(quick=given.quick, process_clock=given.process_clock)
    pd.DataFrame(rows).to_csv(given.out / "scaling.csv", index=False)
    draw(rows, given.out / "scaling.png")
    if Path("/proc/self/status").exists():
        found = memory((128,) if given.quick else (32, 128, 512))
        pd.DataFrame(found).to_csv(given.out / "memory.csv", index=False)


if __name__ == "__main__":
    main()
