"""A step of total least squares over the length of one trajectory.

    python -m benchmarks.smoothing

Ratios are to the shortest trajectory, times and nodes alike: linear is where they agree.
"""

import time
from functools import partial

import torch

from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Trajectory
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.models.symo import SyMo
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.optim.total_least_squares import TotalLeastSquares
from symo_exp.systems.table import system
from symo_exp.training.learner import Learner

NODES, STEPS = (625, 1250, 2500, 5000), 3


def measured(nodes: int) -> float:
    """Seconds of a step with free nodes, the shortest of some."""
    torch.manual_seed(0)
    known = system("acrobot")
    t = torch.arange(nodes, dtype=torch.float64) * 0.02
    q = torch.stack((torch.sin(t) + 0.1 * torch.sin(7 * t), torch.cos(1.3 * t)), dim=1)
    noisy = q + 1e-3 * torch.randn_like(q)
    motion = Trajectory(noisy, torch.zeros_like(q), torch.zeros(nodes, 1, dtype=q.dtype))
    model = SyMo(
        coordinates=known.coordinates, input_matrix=known.input_matrix, time_step=0.02,
        objective=PreconditionedResidual(), integrator=Galerkin(stages=2),
        root=Newton(tolerance=1e-11), lagrangian=partial(NetworkLagrangian, width=8),
    ).double()  # fmt: skip
    learner = Learner(model)
    optimizer = TotalLeastSquares(model.parameters(), epsilons=[1.0], starts=1, start=1, epochs=9)
    taken = []
    for _ in range(1 + STEPS):
        start = time.process_time()
        optimizer.epoch(learner, [motion])
        taken.append(time.process_time() - start)
    return min(taken[1:])


if __name__ == "__main__":
    torch.set_num_threads(1)
    seconds = {nodes: measured(nodes) for nodes in NODES}
    for nodes, taken in seconds.items():
        longer, slower = nodes / NODES[0], taken / seconds[NODES[0]]
        print(f"{nodes} nodes: {taken:.2f} s a step; nodes x {longer:.3g}, time x {slower:.3g}")
