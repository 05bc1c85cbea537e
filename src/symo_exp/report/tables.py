"""Tables, apart from who prints them: Markdown, LaTeX, HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import pandas as pd

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "×": r"$\times$", "÷": r"$\div$", "–": "--", "∞": r"$\infty$", "²": r"$^2$", "σ": r"$\sigma$",
    "±": r"$\pm$", "·": r"$\cdot$", "…": r"\dots{}", "≤": r"$\le$", "−": r"$-$",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """``key`` names its files; ``rows`` are text, the first ``words`` columns set flush left;
    ``notes`` stand below it."""

    key: str
    title: str
    rows: pd.DataFrame
    notes: Sequence[str] = ()
    words: int = 1

    def lines(self) -> Iterable[list[str]]:
        """The header, then the rows."""
        return [list(map(str, self.rows.columns)), *self.rows.astype(str).to_numpy().tolist()]


def markdown(table: Table) -> str:
    rule = [":--" if i < table.words else "--:" for i in range(table.rows.shape[1])]
    header, *rows = ([cell.replace("|", r"\|") for cell in line] for line in table.lines())
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, rule, *rows)]
    return "\n".join([f"**{table.title}**\n", *lines, *(f"\n{n}" for n in table.notes)]) + "\n"


def latex(table: Table) -> str:
    """A ``table`` environment of the package booktabs."""
    columns = "l" * table.words + "r" * (table.rows.shape[1] - table.words)
    header, *rows = (" & ".join(map(_escaped, line)) + r" \\" for line in table.lines())
    lines = [
        r"\begin{table}", r"\centering", rf"\caption{{{_escaped(table.title)}}}",
        rf"\label{{tab:{table.key}}}", rf"\begin{{tabular}}{{{columns}}}", r"\toprule", header,
        r"\midrule", *rows, r"\bottomrule", r"\end{tabular}",
        *(rf"\par\footnotesize {_escaped(note)}" for note in table.notes), r"\end{table}", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)
