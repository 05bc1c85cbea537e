"""The table of this folder: rivals beside the methods of results/hardware, fitted starts.

python results/rivals/table.py > results/rivals/table.md
"""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from symo_exp.report.tables import ResultTable, markdown_table

HERE = Path(__file__).parent
HARDWARE = HERE.parent / "hardware"
MEASURES = ["rmse_0.5s", "rmse_1s", "rmse_2s", "valid_s"]
OURS = {
    "symo": ("SyMo", "a Lagrangian, friction"),
    "l_node": ("L-NODE, measured velocities", "a Lagrangian, friction; velocities"),
    "l_node-estimated": ("L-NODE, estimated velocities", "a Lagrangian, friction"),
    "node": ("NODE, measured velocities", "angles are angles; velocities"),
    "node-estimated": ("NODE, estimated velocities", "angles are angles"),
    "makers, refitted": ("makers' equations, refitted", "the equations; velocities"),
    "makers": ("makers' model", "the equations"),
}


def rows() -> pd.DataFrame:
    """A row for each machine and method: medians over seeds."""
    runs = pd.read_csv(HARDWARE / "runs.csv")
    runs = runs[runs.start == "fitted"]
    refitted = pd.read_csv(HARDWARE / "refitted.csv").rename(columns={"model": "method"})
    refitted = refitted[(refitted.start == "fitted") & (refitted.part == "test")]
    ours = pd.concat([runs[~runs.method.isin(refitted.method.unique())], refitted])
    middle = ours.groupby(["machine", "method"])[[*MEASURES, "seconds"]].median().reset_index()
    middle = middle[middle.method.isin(OURS)]
    middle["rival"] = [OURS[key][0] for key in middle.method]
    middle["given"] = [OURS[key][1] for key in middle.method]
    return pd.concat([pd.read_csv(HERE / "rivals.csv"), middle])


def tables() -> Iterator[str]:
    found = rows()
    for machine in sorted(found.machine.unique()):
        chosen = found[found.machine == machine].sort_values("rmse_1s")
        lines = [
            [
                row["rival"],
                *(f"{row[m]:.2g}" for m in MEASURES),
                "" if pd.isna(row["seconds"]) else f"{row['seconds']:#.2g}".rstrip("."),
                "" if pd.isna(row.get("settings")) else row["settings"],
                row["given"],
            ]
            for _, row in chosen.iterrows()
        ]
        head = ["method", *MEASURES, "time [s]", "chosen on val", "what it is given"]
        title = machine.replace("_", " ").capitalize()
        yield markdown_table(ResultTable(machine, title, pd.DataFrame(lines, columns=head)))


if __name__ == "__main__":
    print("\n".join(tables()))
