"""`python -m benchmarks.cold SYSTEM ROWS`: processor time of compiling E2E-SyMo's training step.

Kernels that are in the cache are taken from there; `TORCHINDUCTOR_CACHE_DIR` names an empty one.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

from benchmarks.cases import CASES, training_batch
from benchmarks.project import Project, trained_weights


def main() -> None:
    """Measure the first two steps, in which everything is compiled."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("system", choices=list(CASES))
    parser.add_argument("rows", type=int)
    given = parser.parse_args()
    torch.set_num_threads(1)
    layers = trained_weights(given.system, "e2e_symo")
    project = Project("e2e_symo", CASES[given.system], layers, lr=0.0, compiled=True)
    batch = project.prepare(training_batch(given.system, given.rows))
    before = os.times()
    for _ in range(2):
        project.train_step(batch)
    after = os.times()
    own = after.user + after.system - before.user - before.system
    compiler = sum(after[2:4]) - sum(before[2:4])
    print(
        f"{given.system}, {given.rows} rows: {own:.0f} s in PyTorch, {compiler:.0f} s in the C++ "
        "compiler"
    )


if __name__ == "__main__":
    main()
