"""The content of a report, whatever the format: sections with text, tables and figures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import pandas as pd

from symo_exp.report.figures import Figure
from symo_exp.report.tables import ResultTable


@dataclass(frozen=True)
class Section:
    """A heading with its text, tables and figures; empty tables and figures are left out.

    Args:
        key: The anchor of the section in the page.
        title: The heading.
        text: Paragraphs; words between ``**`` are bold, those between grave accents commands.
        tables: Tables below the text.
        figures: Figures below the tables.
        folded: Whether the page shows the section only when it is opened.
    """

    key: str
    title: str
    text: Sequence[str] = ()
    tables: Sequence[ResultTable] = ()
    figures: Sequence[Figure] = ()
    folded: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "tables", [one for one in self.tables if len(one.rows)])
        object.__setattr__(self, "figures", [one for one in self.figures if one.panels])

    def __bool__(self) -> bool:
        return any((self.text, self.tables, self.figures))


@dataclass(frozen=True)
class Report:
    """The content of a report.

    Keys of sections and figures are anchors of the page, those of tables and figures are names of
    files. Underscores therefore replace all but letters and digits, and a number is added to a key
    that is taken.

    Args:
        title: The heading of the report.
        summary: Where the runs are from.
        sections: The parts, in reading order.
        runs: The tidy table of the runs (``report.runs``).
        extra: Further tables of numbers by the name of their file.
    """

    title: str
    summary: str
    sections: Sequence[Section]
    runs: pd.DataFrame
    extra: dict[str, pd.DataFrame] = field(default_factory=dict)

    def __post_init__(self) -> None:
        anchors: set[str] = set()
        names: set[str] = set()
        named = [replace(one, key=_free(one.key, anchors)) for one in self.sections]
        named = [
            replace(
                one,
                tables=[replace(x, key=_free(x.key, names)) for x in one.tables],
                figures=[replace(x, key=_free(x.key, anchors)) for x in one.figures],
            )
            for one in named
        ]
        object.__setattr__(self, "sections", named)

    @property
    def tables(self) -> list[ResultTable]:
        """The tables of all sections."""
        return [table for section in self.sections for table in section.tables]

    @property
    def figures(self) -> list[Figure]:
        """The figures of all sections."""
        return [figure for section in self.sections for figure in section.figures]


def _free(key: str, taken: set[str]) -> str:
    """Return a key that is not yet ``taken``, and add it there."""
    name, count = re.sub(r"\W", "_", key), 1
    free = name
    while free.casefold() in taken:  # some disks do not tell capital letters from small ones
        count += 1
        free = f"{name}_{count}"
    taken.add(free.casefold())
    return free
