"""The makers' equations with parameters fitted to the training part.

    python results/hardware/refit.py [--part val] MACHINE ... > results/hardware/refitted.csv

Least squares with Huber's loss (from 0.02 rad on) on rollouts of 0.5 s from measured states, in at
most 300 windows spread over the training trajectories. A row has the measures of the test part (or
of another) for one start.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pandas as pd
import torch
import yaml
from hydra.utils import instantiate
from scipy.optimize import least_squares

from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.evaluation.horizon import cut, predict
from symo_exp.evaluation.references import Continuous
from symo_exp.mechanics.types import Trajectory
from symo_exp.systems.rigs import Rig

TIME_STEP, SPAN, WINDOWS, HUBER, SUBSTEPS = 0.02, 0.5, 300, 0.02, 5
FIXED = ("gravity", "gear")


def flat(rig: Rig) -> np.ndarray:
    return np.concatenate([np.atleast_1d(getattr(rig, f.name)) for f in free(rig)])


def with_parameters(rig: Rig, values: np.ndarray) -> Rig:
    changed: dict[str, Any] = {}
    for field in free(rig):
        given = getattr(rig, field.name)
        count = np.size(given)
        first, values = values[:count], values[count:]
        changed[field.name] = tuple(map(float, first)) if np.ndim(given) else float(first[0])
    return replace(rig, **changed)


def free(rig: Rig) -> list[Any]:
    return [f for f in fields(rig) if f.name not in FIXED and np.size(getattr(rig, f.name))]


def pieces(trajectories: Sequence[Trajectory]) -> Trajectory:
    """Windows of equal length, evenly over all trajectories."""
    steps = round(SPAN / TIME_STEP)
    starts = [(t, k) for t in trajectories for k in range(0, len(t.q) - steps, steps)]
    count = min(WINDOWS, len(starts))
    chosen = [starts[i] for i in np.linspace(0, len(starts) - 1, count).astype(int)]
    return Trajectory(*(torch.stack([getattr(t, x)[k : k + steps + 1] for t, k in chosen])
                        for x in ("q", "v", "u")))  # fmt: skip


def refitted(rig: Rig, trajectories: Sequence[Trajectory]) -> Rig:
    windows, start = pieces(trajectories), flat(rig)
    scale = np.maximum(np.abs(start), 1e-3)

    def residuals(x: np.ndarray) -> np.ndarray:
        moved = Continuous(with_parameters(rig, start + scale * x), TIME_STEP, SUBSTEPS)
        with torch.no_grad():
            path = moved.rollout(windows.q[:, 0], windows.v[:, 0], windows.u)
        error = (path.q - windows.q)[:, 1:].nan_to_num(1e3, 1e3, -1e3).clamp(-1e3, 1e3)
        return np.asarray(error.flatten())

    found = least_squares(
        residuals, np.zeros_like(start), loss="huber", f_scale=HUBER, max_nfev=15, diff_step=1e-5
    )
    return with_parameters(rig, start + scale * found.x)


def rows(machine: str, part: str) -> list[dict[str, Any]]:
    path = f"recordings/{machine}.parquet"
    system = recorded_system(path, time_step=TIME_STEP, angular="all")
    data = RecordedData(system=system, path=path)
    data.setup()
    with open(f"conf/reference/{machine}.yaml") as file:
        settings = yaml.safe_load(file)
    makers = instantiate(settings)
    found = refitted(makers, data.trajectories("train"))
    print(machine, found, file=sys.stderr)
    trajectories = data.trajectories(part)
    lines = []
    for who, rig in (("makers", makers), ("makers, refitted", found)):
        for start, run_in in (("fitted", True), ("measured", False)):
            windows = cut(trajectories, TIME_STEP, run_in=run_in)
            assert windows is not None
            measures = predict(Continuous(rig, TIME_STEP), windows).measures()
            lines.append(
                {"machine": machine, "model": who, "part": part, "start": start} | measures
            )
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="+")
    parser.add_argument("--part", default="test", choices=["val", "test"])
    given = parser.parse_args()
    table = pd.DataFrame([row for name in given.machines for row in rows(name, given.part)])
    table.to_csv(sys.stdout, index=False, float_format="%.4g")
