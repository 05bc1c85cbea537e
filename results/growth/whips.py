"""Samples of a run of SyMo that even the true Lagrangian does not fit, in the run's integrator.

python results/growth/whips.py outputs/growth/RUN
"""

import sys
import tempfile
from pathlib import Path

import torch

from symo_exp.job.parts import build, default_dtype
from symo_exp.models.flows import VariationalFlow
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.optim.base import concatenated
from symo_exp.runs.folder import RunFolder

if __name__ == "__main__":
    settings = RunFolder(sys.argv[1]).config()
    with tempfile.TemporaryDirectory() as folder, default_dtype(settings["dtype"]):
        parts = build(settings, RunFolder(Path(folder)))
        parts.data.prepare_data()
        parts.data.setup()
        flow = parts.model.flow
        true = VariationalFlow(
            parts.system, flow.integrator, flow.time_step, flow.input_matrix, root=flow.root
        )
        samples = concatenated(next(iter(parts.data.train_dataloader())))
        with torch.no_grad():
            squares = PreconditionedResidual()(true.converged(), samples).values.square()
        largest, where = squares.mean(1).sort(descending=True)
        change = (samples.q_next - 2.0 * samples.q + samples.q_prev) / flow.time_step
        print(f"loss of the true Lagrangian: {squares.mean():.2g}, of {len(squares)} samples:")
        for square, row in zip(largest[:6].tolist(), where[:6].tolist(), strict=True):
            print(f"{square:.2g}, a velocity changes by {change[row].abs().max():.2g} rad/s a step")
