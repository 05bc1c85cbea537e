"""Tables, apart from who prints them: Markdown, LaTeX, HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "×": r"$\times$", "÷": r"$\div$", "–": "--", "∞": r"$\infty$", "²": r"$^2$", "σ": r"$\sigma$",
    "±": r"$\pm$", "·": r"$\cdot$", "…": r"\dots{}", "≤": r"$\le$", "−": r"$-$",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """``key`` names its files. ``notes`` stand below it. ``words`` columns are set flush left."""

    key: str
    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = field(default_factory=tuple)
    words: int = 1
    """How many columns, from the left, are words and not numbers."""


def markdown(table: Table) -> str:
    rule = [":--" if i < table.words else "--:" for i in range(len(table.header))]
    lines = [_row(table.header), _row(rule), *map(_row, table.rows)]
    notes = [f"\n{note}" for note in table.notes]
    return "\n".join([f"**{table.title}**\n", *lines, *notes]) + "\n"


def latex(table: Table) -> str:
    """A ``table`` environment of the package booktabs."""
    columns = "l" * table.words + "r" * (len(table.header) - table.words)
    lines = [" & ".join(map(_escaped, row)) + r" \\" for row in table.rows]
    notes = [f"\\par\\footnotesize {_escaped(note)}" for note in table.notes]
    return "\n".join(
        [
            r"\begin{table}", r"\centering", rf"\caption{{{_escaped(table.title)}}}",
            rf"\label{{tab:{table.key}}}", rf"\begin{{tabular}}{{{columns}}}", r"\toprule",
            " & ".join(map(_escaped, table.header)) + r" \\", r"\midrule",
            *lines, r"\bottomrule", r"\end{tabular}", *notes, r"\end{table}", "",
        ]
    )  # fmt: skip


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
