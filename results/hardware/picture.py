"""The picture of a machine: a window predicted in open loop, and the errors over all windows.

    python results/hardware/picture.py RUN FILE.png

``RUN`` is the folder of a run on recordings with a reference.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from symo_exp.report.charts import draw_charts
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import axis_label

SYMO, MAKERS = ("symo", ""), ("reference", "")


def points(t, y, source: str, pair=("", ""), **more) -> pd.DataFrame:
    method, integrator = pair
    table = {"x": t, "y": y, **more}
    return pd.DataFrame(table).assign(source=source, method=method, integrator=integrator)


def motion(one: pd.DataFrame, name: str) -> Panel:
    parts = [points(one.t, one[f"q_true_{name}"], "measured"),
             points(one.t, one[f"q_reference_{name}"], "floor", MAKERS),
             points(one.t, one[f"q_{name}"], "ours", SYMO)]  # fmt: skip
    label = axis_label(name, angular=True)
    return Panel("", "time [s]", label, pd.concat(parts), y_log=False, mark="line")


def errors(table: pd.DataFrame, names: list[str]) -> Panel:
    parts = []
    for source, pair, prefix in (("floor", MAKERS, "q_reference"), ("ours", SYMO, "q")):
        squares = [(table[f"{prefix}_{n}"] - table[f"q_true_{n}"]) ** 2 for n in names]
        rms = table.assign(error=np.sqrt(sum(squares) / len(names)))[table.t > 0]
        by_time = rms.groupby("t").error.quantile([0.1, 0.5, 0.9]).unstack()
        low, middle, high = (by_time[share].to_numpy() for share in (0.1, 0.5, 0.9))
        parts.append(points(by_time.index, middle, source, pair, low=low, high=high))
    title = f"all {table.window.nunique()} windows of the test part: median and 80 %"
    return Panel(title, "time [s]", "RMS error [rad]", pd.concat(parts), mark="line")


def draw(run: Path, file: Path) -> None:
    table = pd.read_parquet(run / "windows.parquet")
    names = [c[7:] for c in table if c.startswith("q_true_")]
    squares = sum((table[f"q_{n}"] - table[f"q_true_{n}"]) ** 2 for n in names)
    totals = squares.groupby(table.window).mean().sort_values()
    one = table[table.window == totals.index[(len(totals) - 1) // 2]]
    panels = [*(motion(one, name) for name in names), errors(table, names)]
    title = "A window of median error, predicted in open loop, and the errors"
    draw_charts(Figure(file.stem, title, "", panels, columns=2), file.parent, ["png"])


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
