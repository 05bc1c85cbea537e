"""Fit rivals to machines, by default to all five; their rows go to rivals.csv beside this file.

python results/rivals/run.py --rivals sindy,mujoco_sysid --budget 120 MACHINE ...
"""

import argparse
import importlib
import time
from pathlib import Path

import pandas as pd
import torch
from machines import chosen, machine, measures

HERE = Path(__file__).parent
KEY = ["machine", "rival"]
RIVALS = ["sindy", "narx", "neural_state_space", "mujoco_sysid"]
MACHINES = [
    "free_single_pendulum", "free_double_pendulum", "free_triple_pendulum", "motor_pendulum",
    "motor_double_pendulum",
]  # fmt: skip


def kept(row: dict[str, object]) -> None:
    """Add a row in place of an earlier one."""
    path = HERE / "rivals.csv"
    before = [pd.read_csv(path)] if path.exists() else []
    both = pd.concat([*before, pd.DataFrame([row])]).drop_duplicates(KEY, keep="last")
    both.sort_values(KEY).to_csv(path, index=False, float_format="%.4g")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="*", default=MACHINES)
    parser.add_argument("--rivals", default=",".join(RIVALS))
    parser.add_argument("--budget", type=float, default=120.0, help="processor time [s]")
    parser.add_argument(
        "--seed", type=int, default=0, help="of networks; rivals.csv keeps those of 0"
    )
    given = parser.parse_args()
    for words, known in ((given.machines, MACHINES), (given.rivals.split(","), RIVALS)):
        for word in words:
            if word not in known:
                parser.error(f"{word} is unknown; there are {', '.join(known)}")
    torch.set_num_threads(1)
    torch.manual_seed(given.seed)
    for name in given.machines:
        of = machine(name)
        for key in given.rivals.split(","):
            rival = importlib.import_module(key)
            print(f"{name}, {rival.NAME}", flush=True)
            start = time.process_time()
            model, settings, count, seconds = chosen(rival, of, given.budget)
            found = measures(model, of)
            print(f"  chosen: {settings}; {found}", flush=True)
            if given.seed == 0:
                kept(
                    {"machine": name, "rival": rival.NAME, **found, "seconds": seconds,
                     "candidates": count, "settings": settings, "given": rival.GIVEN}
                )  # fmt: skip
            print(f"  {time.process_time() - start:.0f} s in all", flush=True)
