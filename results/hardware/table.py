"""The tables of this folder from its runs.

    python results/hardware/table.py outputs > results/hardware/table.md

Reads the finished runs of ``outputs/hardware_*``, whose numbers it keeps in ``runs.csv`` in place
of earlier ones, and the makers' refitted equations in ``refitted.csv``, both beside this file.
Without an argument it reads ``runs.csv`` alone. Cells are medians over seeds and, in brackets, the
range of all of them.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from symo_exp.report.tables import ResultTable, markdown_table
from symo_exp.runs.folder import RunFolder

HERE = Path(__file__).parent
KEYS = ["machine", "method", "start", "seed"]
MEASURES = ["rmse_0.5s", "rmse_1s", "rmse_2s", "pooled_rmse_2s", "valid_s"]
STARTS = {"fitted": "", "measured": "_measured"}
METHODS = {
    "symo": "SyMo",
    "symo-network": "SyMo, no structure given",
    "symo-none": "SyMo, no dissipation",
    "symo-smoothed": "SyMo on smoothed data",
    "e2e_symo": "E2E-SyMo",
    "e2e_symo-none": "E2E-SyMo, no dissipation",
    "e2e_symo-horizon": "E2E-SyMo, error over 10 steps",
    "l_node-horizon": "L-NODE, error over 10 steps",
    "l_node": "L-NODE, measured velocities",
    "l_node-estimated": "L-NODE, estimated velocities",
    "node": "NODE, measured velocities",
    "node-estimated": "NODE, estimated velocities",
    "makers, refitted": "makers, refitted",
    "makers": "makers",
    "constant velocity": "constant velocity",
}
OTHERS = {"makers": "reference_", "constant velocity": "constant_velocity_"}


def runs(outputs: Path) -> pd.DataFrame:
    """A row a run and start; what every run was held to besides is a method of its own.

    Of runs that are equal in ``KEYS``, the table has the last one.
    """
    rows = []
    for path in sorted(outputs.glob("hardware_*/*")):
        folder = RunFolder(path)
        about = folder.about()
        if about is None or folder.outcome().status != "finished":
            continue
        config, found = folder.config(), folder.measures()
        run = {
            "machine": Path(config["data"]["path"]).stem,
            "seed": config["seed"],
            "started": about.started,
        }
        seconds = pd.read_csv(path / "series.csv").training_seconds.max()
        revision = about.tags.get("mlflow.source.git.commit", "")[:7]
        method = path.parent.name.removeprefix("hardware_")
        for start, suffix in STARTS.items():
            for name, prefix in {method: "", **OTHERS}.items():
                keys = {m: f"{prefix}{m}{suffix}" for m in MEASURES}
                values = {m: found[key] for m, key in keys.items() if key in found}
                own = {"seconds": seconds, "revision": revision} if name == method else {}
                rows.append(run | {"method": name, "start": start} | values | own)
    found = pd.DataFrame(rows).sort_values("started").drop(columns="started")
    return found.drop_duplicates(KEYS, keep="last")


def table(found: pd.DataFrame, machine: str, start: str) -> ResultTable:
    chosen = found[(found.machine == machine) & (found.start == start)]
    makers = chosen[chosen.method == "makers"].iloc[0]
    head = ["model", "seeds", *MEASURES, "makers' over its errors", "training [s]"]
    rows = [line(chosen[chosen.method == key], name, makers) for key, name in METHODS.items()]
    known = pd.DataFrame([row for row in rows if row], columns=head)
    title = f"{machine.replace('_', ' ').capitalize()}, {start} start"
    return ResultTable(f"{machine}_{start}", title, known)


def line(rows: pd.DataFrame, name: str, makers: pd.Series) -> list[str]:
    if rows.empty:
        return []
    own = name not in OTHERS and "refitted" not in name
    ratios = [makers[m] / rows[m].median() for m in MEASURES[:3]]
    return [
        name,
        str(rows.seed.nunique()) if own else "",
        *(cell(rows[m]) if own else f"{rows[m].median():.2g}" for m in MEASURES),
        " / ".join(f"{ratio:.2g}" for ratio in ratios),
        f"{rows.seconds.median():.0f}" if own else "",
    ]


def cell(values: pd.Series) -> str:
    middle, low, high = (f"{x:.2g}" for x in (values.median(), values.min(), values.max()))
    return middle if len(values) == 1 else f"{middle} [{low}, {high}]"


def tables(found: pd.DataFrame) -> Iterator[str]:
    for start in STARTS:
        for machine in found.machine.unique():
            yield markdown_table(table(found, machine, start))


if __name__ == "__main__":
    kept = HERE / "runs.csv"
    if sys.argv[1:]:
        both = pd.concat([runs(Path(sys.argv[1])), pd.read_csv(kept)])
        ordered = both.drop_duplicates(KEYS).sort_values(KEYS)
        ordered.to_csv(kept, index=False, float_format="%.5g")
    found = pd.read_csv(kept)
    refitted = HERE / "refitted.csv"
    if refitted.exists():
        others = pd.read_csv(refitted).rename(columns={"model": "method"})
        found = pd.concat([found, others[others.method == "makers, refitted"].assign(seed=0)])
    print("\n".join(tables(found)))
