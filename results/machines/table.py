"""The table of this folder from its searches.

    python results/machines/table.py outputs/machines > results/machines/table.md

Reads the last fits of ``outputs/machines/MACHINE/SEED``, whose numbers it keeps in ``runs.csv``
beside this file in place of earlier ones, also where a search has no model. Without an argument it
reads ``runs.csv`` alone.
"""

import json
import sys
from pathlib import Path

import pandas as pd

from symo_exp.evaluation.verdict import verdict
from symo_exp.runs.folder import RunFolder

HERE = Path(__file__).parent
HORIZONS = ("0.5s", "1s", "2s")
ERRORS = [f"rmse_{t}" for t in HORIZONS]
COVERAGES = [f"coverage_90_{t}" for t in HORIZONS]
OTHERS = {"": "test", "reference_": "makers", "constant_velocity_": "constant velocity"}


def searches(outputs: Path) -> pd.DataFrame:
    """A row a search: its budget, its choice, and the errors of the last fit on the test part."""
    rows = []
    for file in sorted(outputs.glob("*/*/candidates.csv")):
        folder, candidates = file.parent, pd.read_csv(file)
        given = json.loads((folder / "plan.json").read_text())
        chosen = next(iter(candidates[candidates.chosen == 1].to_dict("records")), {})
        found = RunFolder(folder / "best").measures() if chosen else {}
        measures = ["open_loop_rmse", "pooled_rmse_2s", *COVERAGES]
        measures += [f"{who}{error}" for who in OTHERS for error in ERRORS]
        rows.append(
            {
                "machine": folder.parent.name, "seed": int(folder.name),
                "budget": given["budget"], "cores": given["cores"],
                "candidates": len(candidates), "failed": int(candidates.failed.notna().sum()),
                "ended_by_the_clock": int((candidates.ended_by_the_clock > 0).sum()),
                "folds": given["folds"],
                "chosen": chosen.get("candidate"), "fold_error": chosen.get("error"),
                "verdict": verdict(found) if found else "no model",
                **{name: found.get(name) for name in measures},
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def told(row: pd.Series, *names: str) -> str:
    """Values in a cell, a dash if there are none."""
    values = [row.get(name) for name in names]
    return "–" if pd.isna(values).all() else " / ".join(f"{x:.2g}" for x in values)


def main(arguments: list[str]) -> None:
    kept = HERE / "runs.csv"
    table = pd.read_csv(kept) if kept.exists() else pd.DataFrame()
    if arguments:
        found = searches(Path(arguments[0]))
        table = pd.concat([found, table]).drop_duplicates(["machine", "seed"])
        table.sort_values(["machine", "seed"]).to_csv(kept, index=False)
    print("| recording | seed | budget | chosen | test, 0.5 / 1 / 2 s | makers' model | "
          "constant velocity | open loop | verdict |")  # fmt: skip
    print("|---|--:|--:|---|---|---|---|--:|---|")
    for _, row in table.sort_values(["machine", "seed"]).iterrows():
        cells = [
            row.machine, row.seed, f"{row.budget:g} s, {row.cores} core(s)",
            "–" if pd.isna(row.chosen) else row.chosen,
            *(told(row, *(f"{prefix}{error}" for error in ERRORS)) for prefix in OTHERS),
            told(row, "open_loop_rmse"), row.verdict,
        ]  # fmt: skip
        print("| " + " | ".join(map(str, cells)) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])
