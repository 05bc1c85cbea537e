"""The table of candidates, as it is printed and kept."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from symo_exp.files import write_whole
from symo_exp.identify.validation import Trial, compared
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.sweep.table import aligned

LENGTHS = {1e-9: "nm", 1e-6: "µm", 1e-3: "mm", 1.0: "m", 1e3: "km"}


def unit_of_held_out(coordinates: Coordinates, units: Units) -> str:
    """Return the unit of held-out errors, in which lengths are in the unit of the parameters."""
    length = LENGTHS.get(units.length, f"{units.length:g} m")
    return ", ".join(length if unit == "m" else unit for unit in coordinates.units_of_errors)


def candidates_table(trials: Sequence[Trial], best: Trial | None, folds: int, unit: str) -> str:
    """Return a row for each candidate, the chosen one marked; failures with their reasons.

    Args:
        trials: The candidates as they ended.
        best: The chosen one.
        folds: Number of folds.
        unit: Unit of the errors.
    """
    rows = [
        (
            f"{trial.candidate.name}{' *' if trial is best else ''}",
            "-" if trial.failed or not trial.errors else f"{trial.mean():.3g}",
            f"{len(trial.errors)}/{folds}",
            "-" if trial.parameters is None else str(trial.parameters),
            f"{trial.seconds:.0f} s",
        )
        for trial in trials
    ]
    names, *columns = zip(("", "error", "folds", "parameters", "time"), *rows, strict=True)
    lines = aligned(names, columns)
    if best is not None:
        lines.append(f"* chosen; error: geometric mean of those over several times [{unit}]")
    lines += [
        f"failed: {trial.candidate.name}: {reason}"
        for trial in trials
        for reason in list(trial.reasons.values())[:1]
    ]
    return "\n".join(lines)


def write_candidates(file: Path, trials: Sequence[Trial], best: Trial | None, unit: str) -> None:
    """Write the table with the errors of each fold and the settings of each candidate.

    Args:
        file: The file.
        trials: The candidates as they ended.
        best: The chosen one.
        unit: Unit of the errors.
    """

    def write(path: Path) -> None:
        with path.open("w", encoding="utf-8", newline="") as text:
            table = csv.writer(text)
            table.writerow(
                ["candidate", "rank", "chosen", "error", "over_chosen", "standard_error",
                 "parameters", "seconds", "ended_by_the_clock", "folds", "failed", "settings",
                 "unit"]
            )  # fmt: skip
            for trial in trials:
                table.writerow([*_cells(trial, best), unit])

    write_whole(file, write)


def _cells(trial: Trial, best: Trial | None) -> list[object]:
    mean, spread = math.nan, math.nan
    if best is not None and trial.errors:
        common = sorted(set(trial.errors) & set(best.errors))
        if common:
            mean, spread = compared(trial.errors, best.errors, common)
    errors = " ".join(f"{k}:{x:.4g}" for k, x in sorted(trial.errors.items()))
    return [
        trial.candidate.name, trial.candidate.rank, int(trial is best), f"{trial.mean():.5g}",
        f"{math.exp(mean):.4g}", f"{spread:.3g}", trial.parameters, f"{trial.seconds:.1f}",
        len(trial.overran), errors, "; ".join(dict.fromkeys(trial.reasons.values())),
        " ".join(trial.candidate.overrides()),
    ]  # fmt: skip
