"""Simulated logs of machines."""

import pandas as pd
import torch

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
