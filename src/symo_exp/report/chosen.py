"""The best model of a recording in the report: windows, friction, parameters and its search."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from symo_exp.errors import ConfigError
from symo_exp.report.figures import Figure
from symo_exp.report.looks import duration, short
from symo_exp.report.runs import run_table
from symo_exp.report.tables import ResultTable
from symo_exp.runs.folder import BEST, CANDIDATES, WINDOWS, RunFolder

NUMBERS = ["error", "over_chosen", "standard_error"]
ERRORS = (
    "In order of simplicity. Error [{unit}]: geometric mean over the folds of those to 0.5, 1 and "
    "2 s and of whole recordings, or of unstable machines over shorter times."
)
CHOICE = (
    "× chosen: ratio over the folds that both have, with the standard error of its logarithm. The "
    "search takes the simplest one that the best one does not beat by more than one standard "
    "error. It then tries this one with fewer forces, a simpler structure and a higher order of "
    "the integrator, and keeps what the data support."
)
NO_CHOICE = (
    "None is chosen yet: the search has not ended, or it found no model. When it has ended, write "
    "this page again. Errors over different numbers of folds are not comparable."
)


def model_figures(folder: Path, method: str, title: str, key: str) -> list[Figure]:
    """Return the figures of the windows and of the friction of a run, if its files are there."""
    # here: they import PyTorch, which takes seconds
    from symo_exp.report.recordings import recording_figures
    from symo_exp.runs.load import from_folder

    try:
        model, table = from_folder(folder), run_table(folder / WINDOWS)
    except ConfigError:  # of a run of which files are gone
        return []
    if table is None or "error" not in table:  # as in windows of earlier versions
        return []
    return recording_figures(model, table, method, title, key)


def parameters_table(folder: Path, key: str) -> ResultTable:
    """Return the physical parameters of a run with their standard deviations."""
    rows = [
        {
            "parameter": row["name"],
            "value": short(float(row["value"])),
            "standard deviation": short(float(row["standard_deviation"])),
            "unit": row["unit"],
            "determined": row["determined"],
            "note": row["note"],
        }
        for row in RunFolder(folder).parameters()
    ]
    return ResultTable(f"{key}_parameters", "Physical parameters", pd.DataFrame(rows))


def search_table(folder: Path, key: str) -> ResultTable:
    """Return the candidates so far of the search that a run belongs to, or an empty table."""
    file, rows = folder.parent / CANDIDATES, pd.DataFrame()
    notes: list[str] = []
    if file.exists():
        found = pd.read_csv(file, keep_default_na=False)
        found[NUMBERS] = found[NUMBERS].apply(pd.to_numeric, errors="coerce")
        rows = pd.DataFrame([_candidate(row) for row in found.to_dict("records")])
        if (found.failed != "").any():
            rows["failed"] = found.failed
        unit = found.get("unit", pd.Series(["rad, m"])).iloc[0]  # files of earlier versions: either
        notes = [ERRORS.format(unit=unit), CHOICE]
        if not found.chosen.any():
            rows, notes[1] = rows.drop(columns="× chosen"), NO_CHOICE
        else:
            notes.append(f'The chosen model: symo_exp.load("{folder.parent / BEST}")')
    return ResultTable(f"{key}_candidates", "Candidates of the search", rows, notes)


def _candidate(row: Mapping[Hashable, Any]) -> dict[str, Any]:
    chosen, over, spread = row["chosen"], row["over_chosen"], row["standard_error"]
    return {
        "candidate": f"{row['candidate']} (chosen)" if chosen else str(row["candidate"]),
        "error": short(row["error"]),
        "× chosen": f"{short(over)} ± {short(spread)}" if over == over and not chosen else "–",
        "folds": len(str(row["folds"]).split()),
        "parameters": row["parameters"],
        "time": duration(float(row["seconds"])),
    }
