"""A report as files: the tidy table, tables, figures, one Markdown file and one page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from symo_exp.report import tables
from symo_exp.report.figures import Figure
from symo_exp.report.runs import save
from symo_exp.report.tables import Table


@dataclass(frozen=True)
class Section:
    """One heading, and what stands under it; tables and figures that show nothing are left out.

    What is ``folded`` stands at the end of a page until it is opened.
    """

    key: str
    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    folded: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "tables", [one for one in self.tables if len(one.rows)])
        object.__setattr__(self, "figures", [one for one in self.figures if one.panels])

    def __bool__(self) -> bool:
        return any((self.text, self.tables, self.figures))


@dataclass(frozen=True)
class Report:
    """``sections`` hold all tables and figures; ``extra`` are tables of numbers by file name."""

    title: str
    summary: str
    sections: Sequence[Section]
    runs: pd.DataFrame
    extra: dict[str, pd.DataFrame] = field(default_factory=dict)


def write(made: Report, out: Path, *, formats: Sequence[str], web: bool = True) -> list[Path]:
    """Write the report's files below ``out``; those of an earlier report are overwritten."""
    out.mkdir(parents=True, exist_ok=True)
    files = [save(made.runs, out / f"runs.{suffix}") for suffix in ("csv", "parquet")]
    for name, table in made.extra.items():
        table.to_csv(out / name, index=False)
        files.append(out / name)
    for name, text in _texts(made, pictures="png" in formats, web=web):
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_text(text, encoding="utf-8")
        files.append(out / name)
    if formats:
        from symo_exp.report.paper import save as draw

        for figure in (figure for section in made.sections for figure in section.figures):
            files += draw(figure, out / "figures", formats)
    return files


def _texts(made: Report, *, pictures: bool, web: bool) -> Iterator[tuple[str, str]]:
    for table in (table for section in made.sections for table in section.tables):
        yield f"tables/{table.key}.md", tables.markdown(table)
        yield f"tables/{table.key}.tex", tables.latex(table)
    yield "report.md", markdown(made, pictures=pictures)
    if web:
        from symo_exp.report.page import page

        yield "index.html", page(made)


def markdown(made: Report, *, pictures: bool) -> str:
    """The whole report in one file, with pictures where they were written."""
    lines = [f"# {made.title}"]
    for section in made.sections:
        body = [*section.text, *map(tables.markdown, section.tables)]
        for figure in section.figures if pictures else ():
            body += [f"![{figure.title}](figures/{figure.key}.png)", figure.caption]
        lines += [f"## {section.title}"] * bool(body and section.key != "answer") + body
    lines.append(made.summary)
    return "\n\n".join(lines) + "\n"
