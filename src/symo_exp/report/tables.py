"""Tables as data, and as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "×": r"$\times$", "÷": r"$\div$", "–": "--", "∞": r"$\infty$", "²": r"$^2$", "σ": r"$\sigma$",
    "±": r"$\pm$", "·": r"$\cdot$", "…": r"\dots{}", "≤": r"$\le$", "−": r"$-$", "⁴": r"$^4$",
}  # fmt: skip


NUMBER = r"[-+−±×÷]?(\d|inf|nan|∞|–|$)|diverged"
"""The beginning of a cell with a number, with the word for none, or without anything."""


class Cell(NamedTuple):
    """Text of a cell; ``shade`` is its rank between 0 and 1, the best, or NaN."""

    text: str
    shade: float

    @property
    def best(self) -> bool:
        """True if the cell has the best rank."""
        return self.shade == 1


@dataclass(frozen=True)
class ResultTable:
    """A table of text.

    Args:
        key: The name of its files.
        title: The heading.
        rows: The text.
        notes: Lines below the table.
        system: The system of the table, for a page that selects one.
        shades: Of a heat map, the rank of each cell between 0 and 1, the best.
    """

    key: str
    title: str
    rows: pd.DataFrame
    notes: Sequence[str] = ()
    system: str = ""
    shades: pd.DataFrame | None = None

    @property
    def header(self) -> list[str]:
        """The headings of the columns."""
        return list(map(str, self.rows.columns))

    @property
    def numeric(self) -> list[bool]:
        """Whether each column has numbers, which are set flush right; the first has names."""
        there = self.rows.astype(str)
        of = [there.iloc[:, i].str.match(NUMBER).all() for i in range(there.shape[1])]
        return [bool(every) and i > 0 for i, every in enumerate(of)]

    def lines(self) -> Iterator[list[Cell]]:
        """Yield the rows below the header."""
        shades = self.rows.map(lambda _: float("nan")) if self.shades is None else self.shades
        for texts, marks in zip(self.rows.astype(str).values, shades.values, strict=True):
            yield [Cell(text, mark) for text, mark in zip(texts, marks, strict=True)]


def markdown_table(table: ResultTable) -> str:
    """Return a table as Markdown, the best cells in bold."""
    rule = ["--:" if numeric else ":--" for numeric in table.numeric]
    lines = [_markdown_row(table.header), _markdown_row(rule)]
    for line in table.lines():
        lines.append(_markdown_row([f"**{x.text}**" if x.best else x.text for x in line]))
    return "\n".join([f"**{table.title}**\n", *lines, *(f"\n{n}" for n in table.notes)]) + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def latex(table: ResultTable) -> str:
    """Return a table as a LaTeX ``table`` environment, for the package booktabs."""
    columns = "".join("r" if numeric else "l" for numeric in table.numeric)
    rows = [
        [rf"\textbf{{{_escaped(x.text)}}}" if x.best else _escaped(x.text) for x in line]
        for line in table.lines()
    ]
    header, *printed = (" & ".join(x) + r" \\" for x in [map(_escaped, table.header), *rows])
    lines = [
        r"\begin{table}", r"\centering", rf"\caption{{{_escaped(table.title)}}}",
        rf"\label{{tab:{table.key}}}", rf"\begin{{tabular}}{{{columns}}}", r"\toprule", header,
        r"\midrule", *printed, r"\bottomrule", r"\end{tabular}",
        *(rf"\par\footnotesize {_escaped(note)}" for note in table.notes), r"\end{table}", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
