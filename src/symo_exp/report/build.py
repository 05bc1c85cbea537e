"""The report of a store: every file of it, from the runs that are there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from symo_exp.report import accuracy, chapter, curves, motions, tables
from symo_exp.report.cells import beside_published, cells, main_variant
from symo_exp.report.charts import Chart
from symo_exp.report.claims import judge
from symo_exp.report.labels import systems_in_order
from symo_exp.report.page import Section, page
from symo_exp.report.runs import Runs
from symo_exp.report.studied import studied
from symo_exp.report.style import TRUE
from symo_exp.tracking.store import Store


class Report(NamedTuple):
    """``sections`` hold all tables and charts; ``found`` and ``compared`` are tables of numbers."""

    title: str
    summary: str
    sections: list[Section]
    runs: Runs
    found: pd.DataFrame
    compared: pd.DataFrame


STUDIES = ("test_trajectory", "long_term", "forced", "forced_fast", "learned_quantities")
OF_TRUE_SYSTEMS = ("drift",)


def report(runs: Runs, source: str, store: Store | None = None) -> Report:
    """Everything that can be said of the runs; ``source`` says where they are from.

    ``store`` has their files; without it there are no figures of studies.
    """
    found = cells(runs.measures)
    compared = beside_published(found)
    variant = main_variant(found)
    learned, floors = curves.learned_of(found, variant), curves.floors_of(found)
    mine = runs.measures[
        (runs.measures.variant == variant) & ~runs.measures.method.isin(TRUE)
        & curves.at_usual_step(runs.measures)
    ]  # fmt: skip
    at_32 = mine[(mine.n_traj == 32) & (mine.noise_std == 0)]
    true = runs.measures[runs.measures.method.isin(TRUE)]
    studies = [
        one
        for measures, names in ((at_32, STUDIES), (true, OF_TRUE_SYSTEMS))
        for one in (studied(store, measures, names) if store else [])
    ]
    sections = [
        Section("state", "What has been run", _state(runs, variant), tables=[
            *chapter.progress(runs), *_unless_empty(chapter.unfinished(runs)),
        ]),
        Section("tables", "Tables of chapter 6", tables=_tables(found, compared)),
        Section("agreement", "Agreement with the published figures",
                tables=_unless_empty(chapter.agreement(compared))),
        Section("sizes", "Errors over the size of the training set",
                charts=curves.data_size(learned, floors)),
        Section("noise", "Errors over noise", charts=curves.noise(learned, floors)),
        Section("motions", "Motions, and what was learned", charts=motions.charts(studies)),
        Section("floors", "Floors: the integrators alone",
                tables=_unless_empty(chapter.floors(floors)), charts=curves.steps(runs.measures)),
        Section("ranking", "Ranking", tables=list(chapter.ranks(mine))),
        Section("claims", "The statements of the thesis",
                tables=[chapter.claims(judge(mine))]),
        Section("accuracy", "Beyond the thesis: accuracy",
                tables=_unless_empty(accuracy.table(found)),
                charts=accuracy.over_order(found, floors)),
        Section("time", "Accuracy against time", charts=curves.speed(runs.measures)),
    ]  # fmt: skip
    title = "Symplectic momentum networks: the experiments"
    return Report(title, f"From {source}.", [_drawn(s) for s in sections], runs, found, compared)


def write(made: Report, out: Path, *, formats: Sequence[str], web: bool = True) -> list[Path]:
    """Write the report's files below ``out``; those of an earlier report are overwritten."""
    out.mkdir(parents=True, exist_ok=True)
    files = [
        _tidy(made.runs.measures, out / "runs.csv"),
        _tidy(made.runs.measures, out / "runs.parquet"),
    ]
    files.append(_tidy(made.compared, out / "published.csv"))
    for section in made.sections:
        for table in section.tables:
            for suffix, printed in (("md", tables.markdown), ("tex", tables.latex)):
                files.append(_text(out / "tables" / f"{table.key}.{suffix}", printed(table)))
    if formats:
        from symo_exp.report.paper import save

        for chart in _charts(made):
            files += save(chart, out / "figures", formats)
    files.append(_text(out / "report.md", markdown(made, pictures="png" in formats)))
    if web:
        files.append(_text(out / "index.html", page(made.title, made.summary, made.sections)))
    return files


def markdown(made: Report, *, pictures: bool) -> str:
    """The whole report in one file, with pictures where they were written."""
    lines = [f"# {made.title}", made.summary]
    for section in made.sections:
        lines += [f"## {section.title}", *section.text]
        lines += [tables.markdown(table) for table in section.tables]
        for chart in section.charts if pictures else ():
            lines += [f"![{chart.title}](figures/{chart.key}.png)", chart.caption]
    return "\n\n".join(lines) + "\n"


def _state(runs: Runs, variant: str) -> list[str]:
    counts = runs.table.status.value_counts()
    if runs.table.empty:
        return ["There are no runs yet: nothing below can be told."]
    told = ", ".join(f"{n} {str(status).lower()}" for status, n in counts.items())
    hours = runs.measures.drop_duplicates("run_id").seconds.sum() / 3600
    revisions = sorted({r[:10] for r in runs.measures.revision if r})
    lines = [f"{len(runs.table)} runs: {told}. The finished ones trained for {hours:.1f} hours."]
    if revisions:
        lines.append(f"Revisions: {', '.join(revisions)}.")
    if variant:
        lines.append(f"Figures, ranks and statements are of the runs with {variant}.")
    return lines


def _tables(found: pd.DataFrame, compared: pd.DataFrame) -> list[tables.Table]:
    learned = found[~found.method.isin(TRUE) & curves.at_usual_step(found)]
    at_32 = learned[(learned.n_traj == 32) & (learned.noise_std == 0)]
    made = []
    for variant in sorted(set(at_32.variant)):
        mine = at_32[at_32.variant == variant]
        theirs = compared[(compared.variant == variant) | compared.variant.isna()]
        for system in systems_in_order(set(mine.system)):
            made.append(chapter.beside(mine, theirs, system, variant))
    return made


def _drawn(section: Section) -> Section:
    """Without the charts that would show nothing; said, if nothing is left."""
    charts = [chart for chart in section.charts if not chart.empty]
    empty = not charts and not section.tables and not section.text
    text = ["Nothing of this has been run."] if empty else section.text
    return Section(section.key, section.title, text, section.tables, charts)


def _unless_empty(table: tables.Table) -> list[tables.Table]:
    return [table] if table.rows else []


def _charts(made: Report) -> list[Chart]:
    return [chart for section in made.sections for chart in section.charts]


def _tidy(table: pd.DataFrame, path: Path) -> Path:
    table = table.drop(columns=["files"], errors="ignore")
    if path.suffix == ".parquet":
        table.to_parquet(path, index=False)
    else:
        table.to_csv(path, index=False)
    return path


def _text(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path
