"""Tables of the runs of this folder.

    python results/hardware/table.py outputs > results/hardware/table.md

Reads the finished runs of ``outputs/hardware_*``, and ``refitted.csv`` beside this file. Medians over
seeds with the range of all of them; ``runs.csv`` beside this file gets every number.
"""

import sys
from pathlib import Path

import pandas as pd

from symo_exp.runs.folder import RunFolder

HERE = Path(__file__).parent
MEASURES = ["rmse_0.5s", "rmse_1s", "rmse_2s", "pooled_rmse_2s", "valid_s"]
NAMES = {
    "symo": "SyMo",
    "symo-none": "SyMo, no dissipation",
    "symo-smoothed": "SyMo on smoothed data",
    "e2e_symo": "E2E-SyMo",
    "e2e_symo-none": "E2E-SyMo, no dissipation",
    "l_node": "L-NODE, measured velocities",
    "l_node-estimated": "L-NODE, estimated velocities",
    "node": "NODE, measured velocities",
    "node-estimated": "NODE, estimated velocities",
}


def runs(outputs: Path) -> pd.DataFrame:
    rows = []
    for path in sorted(outputs.glob("hardware_*/*")):
        folder = RunFolder(path)
        if not folder.finished:
            continue
        config = folder.config()
        machine = Path(config["data"]["path"]).stem
        method = path.parent.name.removeprefix("hardware_")
        metrics = folder.metrics()
        row = {"machine": machine, "method": method, "seed": config["seed"]}
        rows.append(row | {key: metrics.get(key) for key in sorted(metrics)})
    return pd.DataFrame(rows)


if __name__ == "__main__":
    print(runs(Path(sys.argv[1])).to_string())
