"""The table of this folder from its runs.

    python results/noise/table.py outputs/noise_* > results/noise/table.md

Keeps the numbers of the finished runs in ``runs.csv`` beside this file, in place of earlier ones;
without an argument it reads that. Cells are medians over seeds and, in brackets, the range of all
of them. Of runs that are equal in ``KEYS`` and the seed, the last one counts.
"""

import sys
from pathlib import Path

import pandas as pd

from symo_exp.report.tables import ResultTable, markdown_table
from symo_exp.runs.before import model_settings
from symo_exp.runs.folder import RunFolder

HERE = Path(__file__).parent
KEYS = ["system", "method", "structure", "noise", "input noise", "input weight"]
MEASURES = ["test_mse", "integration_mse", "integration_mse_100", "energy_mse", "inertia_mse"]
METHODS = {
    "SyMo": "SyMo",
    "E2ESyMo": "E2E-SyMo",
    "LNODE": "L-NODE",
    "NODE": "NODE",
}


def runs(outputs: Path) -> pd.DataFrame:
    rows = []
    for path in sorted(outputs.glob("*/config.yaml")):
        folder = RunFolder(path.parent)
        about = folder.about()
        if about is None or folder.outcome().status != "finished":
            continue
        config, found = folder.config(), folder.measures()
        method = METHODS[config["model"]["_target_"].rsplit(".", 1)[-1]]
        rows.append(
            {
                "system": config["system"]["_target_"].rsplit(".", 1)[-1].lower(),
                "method": method + (", estimated velocities" if estimated(config) else ""),
                "structure": structure(config["model"]),
                "noise": config["data"]["noise_std"],
                "input noise": config["data"].get("input_noise_std", 0.0),
                "input weight": config["optimizer"].get("input_weight", 0.0),
                "seed": config["seed"],
                "started": about.started,
                **{name: found[name] for name in MEASURES if name in found},
                "seconds": pd.read_csv(path.with_name("series.csv")).training_seconds.max(),
            }
        )
    return pd.DataFrame(rows)


def structure(stored: dict) -> str:
    """Return the kind of a learned Lagrangian."""
    settings = model_settings(stored).get("lagrangian", {})
    if "relative" not in settings:
        return "rigid" if settings.get("_target_", "").endswith("RigidChain") else "network"
    return "relative" if settings["relative"] else "absolute"


def estimated(config: dict) -> bool:
    return config["data"].get("velocities") == "estimated"


def cell(values: pd.Series) -> str:
    middle, low, high = (f"{x:.2g}" for x in (values.median(), values.min(), values.max()))
    return middle if len(values) == 1 else f"{middle} [{low}, {high}]"


def table(found: pd.DataFrame) -> str:
    cells = {m: (m, cell) for m in MEASURES}
    rows = found.groupby(KEYS).agg(
        seeds=("seed", "nunique"), **cells, training=("seconds", "median")
    )
    rows["training"] = rows.training.map("{:.0f} s".format)
    return markdown_table(
        ResultTable("noise", "Medians over seeds", rows.reset_index().astype(str))
    )


if __name__ == "__main__":
    kept = HERE / "runs.csv"
    if sys.argv[1:]:
        found = pd.concat([runs(Path(folder)) for folder in sys.argv[1:]])
        if found.empty:
            sys.exit(f"no finished runs in {' '.join(sys.argv[1:])}; {kept} stays as it is")
        found = found.sort_values("started").drop(columns="started")
        both = pd.concat([pd.read_csv(kept), found]).drop_duplicates([*KEYS, "seed"], keep="last")
        both.to_csv(kept, index=False, float_format="%.4g")
    print(table(pd.read_csv(kept)))
