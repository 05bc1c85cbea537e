"""The table of this folder from its searches.

    python results/machines/table.py outputs/machines > results/machines/table.md

Reads the last fits of ``outputs/machines/MACHINE/SEED``, whose numbers it keeps in ``runs.csv``
beside this file in place of earlier ones. Without an argument it reads ``runs.csv`` alone.
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
OTHERS = {"": "test", "reference_": "makers", "constant_velocity_": "constant velocity"}


def searches(outputs: Path) -> pd.DataFrame:
    """A row a search: its budget, its choice, and the errors of the last fit on the test part."""
    rows = []
    for plan in sorted(outputs.glob("*/*/plan.json")):
        folder = plan.parent
        if not (folder / "best" / "metrics.json").exists():
            continue
        given, found = json.loads(plan.read_text()), RunFolder(folder / "best").measures()
        candidates = pd.read_csv(folder / "candidates.csv")
        chosen = candidates[candidates.chosen == 1].iloc[0]
        rows.append(
            {
                "machine": folder.parent.name, "seed": int(folder.name),
                "budget": given["budget"], "cores": given["cores"],
                "candidates": len(candidates), "failed": int(candidates.failed.notna().sum()),
                "ended_by_the_clock": int((candidates.ended_by_the_clock > 0).sum()),
                "folds": given["folds"], "chosen": chosen.candidate, "fold_error": chosen.error,
                "verdict": verdict(found),
                "open_loop_rmse": found.get("open_loop_rmse"),
                "pooled_rmse_2s": found.get("pooled_rmse_2s"),
                **{f"{who}{e}": found.get(f"{who}{e}") for who in OTHERS for e in ERRORS},
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def told(row: pd.Series, prefix: str) -> str:
    """The errors to 0.5, 1 and 2 s in a cell."""
    values = [row.get(f"{prefix}{error}") for error in ERRORS]
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
            row.machine, row.seed, f"{row.budget:g} s, {row.cores} core(s)", row.chosen,
            *(told(row, prefix) for prefix in OTHERS), f"{row.open_loop_rmse:.2g}", row.verdict,
        ]  # fmt: skip
        print("| " + " | ".join(map(str, cells)) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])
