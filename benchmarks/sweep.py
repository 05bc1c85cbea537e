"""`python -m benchmarks.sweep`: a sweep of ten jobs by one process, and by as many as cores.

Both runs start with the data simulated and nothing trained. Prints the wall times and their ratio,
which on two cores should be at most 0.6.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SEEDS = 10


def command(processes: int, epochs: int, folder: Path, cache: Path) -> list[str]:
    """The sweep with a folder of its own."""
    return [
        *(sys.executable, "-m", "symo_exp", "-m"),
        *("hydra/launcher=joblib", f"hydra.launcher.n_jobs={processes}"),
        *("model=e2e_symo", "data.n_traj=16", f"trainer.max_epochs={epochs}"),
        *("trainer.compile=false", "trainer.progress=false", f"data.cache_dir={cache}"),
        *("data.seed=0", f"seed=range({SEEDS})"),
        *(f"output_dir={folder / 'outputs'}", f"logger.directory={folder / 'mlruns'}"),
    ]


def seconds(processes: int, epochs: int, folder: Path, cache: Path) -> float:
    """Wall time of the sweep [s]."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    began = time.perf_counter()
    subprocess.run(
        command(processes, epochs, folder, cache), env=environment, check=True, capture_output=True
    )
    return time.perf_counter() - began


def main(arguments: list[str] | None = None) -> None:
    """Measure both and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--epochs", type=int, default=300)
    given = parser.parse_args(arguments)
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seconds(1, 1, folder / "first", folder / "cache")  # simulates the data
        one = seconds(1, given.epochs, folder / "one", folder / "cache")
        all_cores = seconds(cores, given.epochs, folder / "all", folder / "cache")
    print(
        f"{SEEDS} jobs: {one:.0f} s with one process, {all_cores:.0f} s with {cores}: "
        f"{all_cores / one:.2f} of the time"
    )


if __name__ == "__main__":
    main()
