"""Simulated logs of machines, and what a search infers from a log."""

from typing import Any

import numpy as np
import pandas as pd
import torch

from symo_exp.identify.recordings import Machine, examine
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated


def pendulum_log(viscous: float, time_step: float, steps: int, noise: float) -> pd.DataFrame:
    """Eight driven motions of a pendulum of 1 kg with friction [N m s], with noise [rad]."""
    truth = stated("pendulum", viscous=(viscous,), time_step=time_step)
    q, v, u = truth.box.points(8, 3)
    path = simulate(truth, q, v, u, steps, Solver())
    random = torch.Generator().manual_seed(1)
    q = path.q + noise * torch.randn(path.q.shape, generator=random).double()
    t = time_step * torch.arange(steps + 1)
    tables = [
        pd.DataFrame({"trajectory": k, "t": t, "q_theta": y, "u_0": f})
        for k, (y, f) in enumerate(zip(q[..., 0], path.u[..., 0], strict=True))
    ]
    return pd.concat(tables)


def pushes(t: Any) -> Any:
    """An input of several frequencies."""
    return sum(np.sin(w * t + w**2) for w in (1.0, 2.3, 3.7, 5.1, 8.3))


def examined(table: pd.DataFrame, data: Any = None, **given: Any) -> Machine:
    """The machine that a table shows, with settings of its file, ``mine.csv``."""
    table.to_csv("mine.csv", index=False)
    return examine({"path": "mine.csv", **(data or {})}, **given)
