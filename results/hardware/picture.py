"""Draw a machine: a window predicted in open loop, and the errors in all windows.

    python results/hardware/picture.py RUN FILE.png

``RUN`` is the folder of a run on recordings with a reference.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from symo_exp.report.looks import BASELINES, MEASURED, METHODS, RC, axis_label

SINGLE = 10
"""Number of windows up to which each is drawn."""
OURS = {"color": METHODS["symo"].colour}
MAKERS = {"color": BASELINES["reference"].colour, "linestyle": (0, (4, 2))}


def error(table: pd.DataFrame, prefix: str, names: list[str]) -> pd.Series:
    squares = [(table[f"{prefix}_{n}"] - table[f"q_true_{n}"]) ** 2 for n in names]
    return np.sqrt(sum(squares) / len(names))


def draw(run: Path, file: Path) -> None:
    table = pd.read_parquet(run / "windows.parquet")
    names = [c[7:] for c in table if c.startswith("q_true_")]
    table["ours"], table["makers"] = error(table, "q", names), error(table, "q_reference", names)
    totals = table.groupby("window").ours.mean().sort_values()
    one = table[table.window == totals.index[(len(totals) - 1) // 2]]
    gaps = np.diff(np.sort(one[[f"q_{n}" for n in names]].to_numpy(), axis=1), axis=1)
    apart = int(gaps.min(axis=1, initial=np.inf).argmax())  # where labels do not collide
    figure, (motion, errors) = plt.subplots(1, 2, figsize=(10, 3.2))
    for i, name in enumerate(names):
        predicted, measured = one[f"q_{name}"], one[f"q_true_{name}"]
        motion.plot(one.t, predicted, lw=1.5, label="" if i else "predicted by SyMo", **OURS)
        motion.plot(
            one.t, measured, ".", ms=4, color=MEASURED.colour, label="" if i else "measured"
        )
        label = axis_label(name, angular=True).partition(" [")[0]
        where = (one.t.iloc[apart], predicted.iloc[apart])
        motion.annotate(label, where, (4, -14), textcoords="offset points", fontsize=10)
    motion.set(xlabel="time [s]", ylabel="angle [rad]", title="Window of median error")
    motion.legend(frameon=False, fontsize=8)
    for key, label, look in (("makers", "makers' model", MAKERS), ("ours", "SyMo", OURS)):
        over = table[table.t > 0].pivot(index="t", columns="window", values=key)
        if len(totals) <= SINGLE:
            errors.plot(over.index, over, lw=1.2, label=[label, *[""] * (len(totals) - 1)], **look)
            continue
        low, middle, high = (over.quantile(share, axis=1) for share in (0.1, 0.5, 0.9))
        errors.plot(over.index, middle, lw=1.8, label=f"{label}, median and 80 %", **look)
        errors.fill_between(over.index, low, high, color=look["color"], alpha=0.25, lw=0)
    errors.set(yscale="log", xlabel="time [s]", ylabel="RMS error over angles [rad]")
    errors.set_title(f"All {len(totals)} windows of the test part")
    errors.legend(frameon=False, fontsize=8)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    with plt.rc_context(RC):
        draw(Path(sys.argv[1]), Path(sys.argv[2]))
