"""The table of this folder from its runs.

    python results/uncertainty/table.py > results/uncertainty/table.md

A cell gives a share with the standard error of its mean over machines.
"""

from pathlib import Path

import pandas as pd

HEAD = (
    "| system | optimiser | machines | parameters held | rms error / std. dev. "
    "| rollouts over 2 s held |\n|---|---|---|---|---|---|"
)


def share(values: pd.Series) -> str:
    return f"{100 * values.mean():.0f} ± {100 * values.sem():.0f} %"


def table(runs: pd.DataFrame) -> str:
    lines = [HEAD]
    for (system, optimizer), rows in runs.groupby(["system", "optimizer"], sort=False):
        total = rows.parameters.sum()
        squares = (rows.rms_score**2 * rows.parameters).sum() / total
        held = f"{rows.held.sum()} of {total}: {share(rows.held / rows.parameters)}"
        lines.append(
            f"| {system} | {str(optimizer).replace('_', ' ')} | {len(rows)} | {held} "
            f"| {squares**0.5:.2f} | {share(rows.rollouts_held)} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(pd.read_csv(Path(__file__).parent / "runs.csv")))
