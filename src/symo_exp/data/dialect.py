"""How text files write tables."""

from __future__ import annotations

import codecs
import csv
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from symo_exp.data.paths import few

COMMENT = re.compile(r"\s*[#%]+\s*")
"""The beginning of a comment before the table."""
SEPARATOR = re.compile(r'"?sep=.?"?\s*')
"""A line before the table with which spreadsheets state the separator."""
NUMBER = re.compile(r"\s*[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?\s*")
"""A word that is a number, perhaps with a decimal comma."""
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+\D*\d*")
"""A word that is a number with a decimal comma, or with commas between thousands."""
WITH_COMMA = r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$"
"""A number with a decimal comma alone."""
FEWEST_CELLS = 2
"""In a row: a time and a position."""
BEGINNING = 50
"""Lines of a text file from which its dialect is inferred."""
NO_TEXT = "it is no text in a known encoding; save it as UTF-8"


class Dialect(NamedTuple):
    """How a text file writes a table.

    Attributes:
        encoding: Of the characters.
        separator: Between columns.
        decimal: Decimal sign.
        skipped: Lines before the rows, the line of names included.
        names: Names of the columns.
        cells: In the longest one of the first rows.
        heading: The first line of those before the names that belong to no table.
    """

    encoding: str
    separator: str
    decimal: str
    skipped: int
    names: tuple[str, ...]
    cells: int
    heading: str = ""

    @classmethod
    def of(cls, file: Path) -> Dialect:
        """Infer the dialect from the first lines of a file.

        Before the table there may be blank lines, a line such as ``sep=;``, comments, which begin
        with # or %, and lines of data loggers with fewer cells, such as a date. The last comment
        has the names if rows of numbers follow, as NumPy's ``savetxt`` writes them.
        """
        encoding, before, first = _encoding(file), [], ""
        with file.open(encoding=encoding, newline="") as text:
            lines = (line.rstrip("\r\n") for line in text)
            for line in lines:
                if line.strip() and not (COMMENT.match(line) or SEPARATOR.fullmatch(line)):
                    first = line
                    break
                before.append(line)
            others = list(itertools.islice(lines, BEGINNING))
        skipped, comments = len(before) + 1, list(filter(COMMENT.match, before))
        if comments and re.match(NUMBER.pattern + r"(?:[,;\s]|$)", first):
            skipped, others = len(before), [first, *others]
            first = COMMENT.sub("", comments[-1], count=1)
        heading, place = first, _line_of_names([first, *others])
        if place:
            skipped, first, others = skipped + place, others[place - 1], others[place:]
        separator = _separator(first)
        names, *rows = _cells([first, *others], separator)
        comma = any(DECIMAL_COMMA.fullmatch(cell) for row in rows for cell in row)
        return cls(
            encoding, separator, "," if comma else ".", skipped,
            tuple(name.strip() for name in names), max(map(len, rows), default=0),
            heading if place else "",
        )  # fmt: skip

    def read(self, file: Path) -> pd.DataFrame:
        """Return the table without rows that are empty throughout.

        Raises:
            ValueError: If there are cells beyond the last name that are not empty.
        """
        count = len(self.names)
        table = pd.read_csv(
            file,
            encoding=self.encoding,
            sep=r"\s+" if self.separator == " " else self.separator,
            decimal=self.decimal,
            skiprows=self.skipped,
            skipinitialspace=True,
            header=None,
            names=list(range(max(count, self.cells))),
            low_memory=False,
        )
        if table.iloc[:, count:].notna().any(axis=None):
            raise ValueError(
                f"a row has {self.cells} cells, the line of names {count}, {few(self.names)}; "
                "names are in the first line that is no comment (#)"
            )
        table = table.iloc[:, :count].dropna(how="all").reset_index(drop=True)
        if self.decimal == "," and self.separator != " ":  # a line of words has blanks, too
            # beside words, such as a row of units, numbers are still text
            words = table.select_dtypes(exclude="number")
            table[words.columns] = words.replace(WITH_COMMA, r"\1.\2", regex=True)
        return table

    @property
    def notes(self) -> list[str]:
        """Lines for the log on differences from a plain CSV file."""
        found = []
        if self.heading:
            found.append(f"lines before the names are left out, first {self.heading[:40]!r}")
        names = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "blanks"}
        if self.separator in names:
            decimal = " and decimal commas" if self.decimal == "," else ""
            found.append(f"read with {names[self.separator]} between columns{decimal}")
        return found


def _encoding(file: Path) -> str:
    """Return the encoding that the beginning of a text file shows.

    Spreadsheets also write UTF-16 and the encoding of Windows, in which a degree sign is one byte.

    Raises:
        ValueError: If the first line holds zero bytes, which no text does.
    """
    with file.open("rb") as handle:
        beginning = handle.read(2**16)
    if beginning.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if b"\0" in beginning.partition(b"\n")[0]:
        raise ValueError(NO_TEXT)
    try:
        codecs.getincrementaldecoder("utf-8")().decode(beginning)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _separator(line: str) -> str:
    """Return the separator of the line of names, or of numbers where names are missing.

    Commas are decimal signs if another one makes all cells numbers.
    """
    counts = Counter({sign: line.count(sign) for sign in (",", ";", "\t", "|")})
    for sign, count in counts.items():
        if sign != "," and count and all(map(NUMBER.fullmatch, line.split(sign))):
            return sign
    separator, count = counts.most_common(1)[0]
    return " " if count == 0 and len(line.split()) > 1 else separator


def _line_of_names(lines: Sequence[str]) -> int:
    """Return which line has as many names as the first row of numbers has cells.

    It is the first line, unless that has another number of cells and a later one has as many.
    """
    signs = (";", "\t", "|", ",", " ")
    for place, line in enumerate(lines):
        for sign in signs:
            (cells,) = _cells([line], sign)
            if len(cells) < FEWEST_CELLS or not all(map(NUMBER.fullmatch, cells)):
                continue
            heads = [_cells([head], sign)[0] for head in lines[:place]]
            fits = [k for k, head in enumerate(heads) if len(head) == len(cells) and all(head)]
            return fits[0] if fits else 0
    return 0


def _cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    """Return the cells of lines, without their quotes."""
    if separator == " ":
        return [line.split() for line in lines]
    return list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
