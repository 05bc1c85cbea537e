"""Lines that fit a terminal."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Iterable


def fitted_lines(lines: Iterable[str]) -> list[str]:
    """Return lines that fit the terminal, continued below their second column.

    In a file or a pipe they remain whole.
    """
    width, found = shutil.get_terminal_size((1000, 0)).columns, []
    for line in lines:
        second = re.match(r" *(\S+( \S+)*  +)?", line)
        indent = " " * (second.end() if second else 0)
        found += textwrap.wrap(
            line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return found
