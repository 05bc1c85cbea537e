"""Recordings in the report: errors of models beside baseline and noise, and the best model.

Runs that were not measured on the test part, such as folds of a search, are left out, unless none
was.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import pandas as pd

from symo_exp.evaluation.verdict import ERRORS, comparison, verdict
from symo_exp.report.cells import settings_of
from symo_exp.report.chosen import model_figures, parameters_table, search_table
from symo_exp.report.document import Section
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import (
    BASELINES,
    all_angles,
    in_order,
    label_and_unit,
    pair_name,
    short,
)
from symo_exp.report.runs import local_folder
from symo_exp.report.tables import ResultTable
from symo_exp.runs.outcome import recording_names

TESTED = "windows"
"""A measure of all runs that were measured on the test part."""
TIMES = {"usable_s": "usable [s]", "valid_s": "error below 0.1 [s]"}
KEYS = ["method", "integrator", "settings", "time_step"]
"""Columns that identify a model."""
PATH = re.compile(r"(?:^|, )data\.path=(?:\[[^\]]*\]|[^,]*)")


def answer(name: str, rows: pd.DataFrame) -> str:
    """Return the best model of a file, its error, baseline, noise and verdict in a sentence."""
    medians = _medians(rows)
    best = medians.iloc[0]
    measures = _measures(best)
    if "rmse_1s" not in medians:
        return f"**{name}**: {verdict(measures) or 'not yet measured on the test part'}."
    told = [text for text in (comparison(measures, _unit(rows)), verdict(measures)) if text]
    which = f"**{pair_name(best.method, best.integrator)}**"
    which += " predicts best" * (len(medians) > 1)
    return f"**{name}**: {which}: {'; '.join(told)}."


def recordings(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the measured runs of each file by its name, or by its path if names are equal."""
    there = runs[(runs.recording != "") & (runs.metric != "")]
    there = there.assign(settings=[PATH.sub("", v).removeprefix(", ") for v in there.variant])
    tested = there.run_id.isin(there[there.metric == TESTED].run_id)
    there = there[tested | ~there.recording.isin(there[tested].recording)]
    paths = sorted(set(there.recording))
    names = {path: recording_names(path) for path in paths}
    twice = {name for name in names.values() if list(names.values()).count(name) > 1}
    return {
        path if names[path] in twice else names[path]: there[there.recording == path]
        for path in paths
    }


def _medians(rows: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each model and its settings, the best first, a column for each measure."""
    wide = rows.groupby([*KEYS, "metric"], dropna=False).value.median().unstack()
    wide["seeds"] = rows.groupby(KEYS, dropna=False).seed.nunique()
    wide = wide.reset_index()
    order = [in_order(pair) for pair in zip(wide.method, wide.integrator, strict=True)]
    wide = wide.loc[pd.Series(order, index=wide.index, dtype=object).sort_values().index]
    return wide.sort_values("rmse_1s", kind="stable") if "rmse_1s" in wide else wide


def _measures(row: pd.Series) -> Mapping[str, float]:
    numbers = {k: float(v) for k, v in row.items() if isinstance(v, (int, float)) and v == v}
    return {str(name): value for name, value in numbers.items()}


def section(name: str, rows: pd.DataFrame) -> Section:
    """Return the errors of the models of a file, and figures and tables of the best one."""
    medians, key = _medians(rows), f"recording_{name}"
    tested = (rows.metric == TESTED).any()
    tables = [_errors_table(medians, key, _unit(rows))] if tested else []
    caption = f"{_summary(medians)} Of each method, the settings with the smallest error to 1 s."
    figures = [Figure(f"{key}_horizon", "Error over the horizon", caption, _panels(rows, medians))]
    best = rows.merge(medians[KEYS].head(1), on=KEYS).sort_values("seed", kind="stable").iloc[0]
    if (folder := local_folder(best.files)) is not None:
        title = pair_name(best.method, best.integrator)
        figures += model_figures(folder, best.method, title, f"{key}_")
        tables += [parameters_table(folder, key), search_table(folder, key)]
    return Section(key, f"Recording {name}", tables=tables, figures=figures)


def _summary(medians: pd.DataFrame) -> str:
    """Return a sentence on what the errors are."""
    seeds = ", and over the seeds" * bool(medians.seeds.max() > 1)
    return f"Medians over the windows of the test part{seeds}; open loop from fitted starts."


def _unit(rows: pd.DataFrame) -> str:
    """Return the unit of the errors of runs."""
    return label_and_unit("rmse_1s", all_angles(rows.metric, rows.value))[1]


def _errors_table(medians: pd.DataFrame, key: str, unit: str) -> ResultTable:
    """Return the errors and the verdict of each model, then the errors of the baselines."""
    common = set.intersection(*(set(settings_of(text)) for text in medians.settings))
    lines = []
    for _, row in medians.iterrows():
        own = ", ".join(word for word in settings_of(row.settings) if word not in common)
        who = pair_name(row.method, row.integrator) + f" ({own})" * bool(own)
        lines.append([who, str(row.seeds), *_printed(row), verdict(_measures(row)) or "–"])
    for baseline, known in BASELINES.items():
        line = _printed(_baseline(medians, baseline))
        if any(text != "–" for text in line):
            lines.append([known.label, "", *line, ""])
    errors = [f"RMSE to {h:g} s [{unit}]" for h in ERRORS.values()]
    columns = pd.DataFrame(lines, columns=["", "seeds", *errors, *TIMES.values(), "verdict"])
    return ResultTable(key, "Errors of open-loop predictions", columns, [_summary(medians)])


def _baseline(medians: pd.DataFrame, name: str) -> pd.Series:
    """Return the measures of a baseline, which all runs on the file have alike."""
    if name == "noise":
        noise = medians.get("noise", pd.Series(dtype=float)).median()
        return pd.Series(dict.fromkeys(ERRORS, noise))
    names = [*ERRORS, *TIMES]
    there = {m: medians[f"{name}_{m}"].median() for m in names if f"{name}_{m}" in medians}
    return pd.Series(there, dtype=float)


def _printed(row: pd.Series) -> list[str]:
    return [short(row.get(name)) for name in (*ERRORS, *TIMES)]


def _panels(rows: pd.DataFrame, medians: pd.DataFrame) -> list[Panel]:
    """Return the errors over the horizon, and over those of constant velocity."""
    best = medians.drop_duplicates(["method", "integrator"])[KEYS]
    errors = rows[rows.metric.isin(ERRORS)].merge(best, on=KEYS)
    grouped = errors.groupby(["method", "integrator", "metric"]).value
    lines = grouped.agg(y="median", low="min", high="max").reset_index().assign(source="ours")
    parts = [lines.assign(x=lines.metric.map(ERRORS))]
    for baseline in BASELINES:
        found = _baseline(medians, baseline)
        there = [(ERRORS[m], found[m]) for m in ERRORS if m in found and found[m] == found[m]]
        line = pd.DataFrame(there, columns=["x", "y"], dtype=float)
        parts.append(line.assign(method=baseline, integrator="", source="floor"))
    drawn = pd.concat(parts, ignore_index=True)
    for bound in ("low", "high"):
        drawn[bound] = drawn[bound].fillna(drawn.y)
    ticks = tuple(ERRORS.values())
    panels = [Panel("", "horizon [s]", f"RMSE [{_unit(rows)}]", drawn, ticks=ticks)]
    still = _baseline(medians, "constant_velocity")
    if not still.empty:
        least = drawn.x.map({h: still.get(name) for name, h in ERRORS.items()})
        shares = drawn.assign(**{name: drawn[name] / least for name in ("y", "low", "high")})
        label = "RMSE relative to constant velocity"
        panels.append(Panel("", "horizon [s]", label, shares, ticks=ticks))
    return panels
