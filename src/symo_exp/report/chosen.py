"""The best model of a recording in the report: windows, friction, parameters and its search."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from symo_exp.errors import ConfigError
from symo_exp.report.figures import Figure
from symo_exp.report.looks import duration, short
from symo_exp.report.recordings import recording_figures
from symo_exp.report.tables import ResultTable
from symo_exp.runs.folder import CANDIDATES, PARAMETERS, WINDOWS

NOTES = (
    "In order of simplicity. Error [rad, m]: geometric mean over the folds of those to 0.5, 1 and "
    "2 s and of whole recordings, or of unstable machines over shorter times. × chosen: ratio over "
    "the folds that both have, with the standard error of its logarithm.",
    "The chosen one is the simplest that the best one does not beat by more than one standard "
    "error.",
)


def model_figures(folder: Path, method: str, title: str, key: str) -> list[Figure]:
    """Return the figures of the windows and of the friction of a run, if its files are there."""
    from symo_exp.runs.load import from_folder

    try:
        model, table = from_folder(folder), pd.read_parquet(folder / WINDOWS)
    except (ConfigError, OSError):  # of a run without windows, or of which files are gone
        return []
    # windows of earlier versions have no errors
    return recording_figures(model, table, method, title, key) if "error" in table else []


def parameters_table(folder: Path, key: str) -> ResultTable:
    """Return the physical parameters of a run with their standard deviations."""
    title = "Physical parameters"
    if not (folder / PARAMETERS).exists():
        return ResultTable(f"{key}_parameters", title, pd.DataFrame())
    found = pd.read_csv(folder / PARAMETERS).fillna({"unit": "", "note": ""})
    rows = pd.DataFrame(
        {
            "parameter": found.name,
            "value": found.value.map(short),
            "standard deviation": found.standard_deviation.map(short),
            "unit": found.unit,
            "determined": found.determined,
            "note": found.note,
        }
    )
    return ResultTable(f"{key}_parameters", title, rows)


def search_table(folder: Path, key: str) -> ResultTable:
    """Return the candidates of the search that ended with a run, or an empty table."""
    file, title = folder.parent / CANDIDATES, "Candidates of the search"
    if not file.exists():
        return ResultTable(f"{key}_candidates", title, pd.DataFrame())
    found = pd.read_csv(file, keep_default_na=False)
    numbers = found[["error", "over_chosen", "standard_error"]].apply(
        pd.to_numeric, errors="coerce"
    )
    ratio = [
        f"{short(over)} ± {short(spread)}" if over == over and not chosen else "–"
        for over, spread, chosen in zip(
            numbers.over_chosen, numbers.standard_error, found.chosen, strict=True
        )
    ]
    rows = pd.DataFrame(
        {
            "candidate": [
                f"{name} (chosen)" if chosen else str(name)
                for name, chosen in zip(found.candidate, found.chosen, strict=True)
            ],
            "error": numbers.error.map(short),
            "× chosen": ratio,
            "folds": found.folds.str.split().map(len),
            "parameters": found.parameters,
            "time": found.seconds.astype(float).map(duration),
        }
    )
    if (found.failed != "").any():
        rows["failed"] = found.failed
    return ResultTable(f"{key}_candidates", title, rows, NOTES)
