"""Commands that messages name, spelled as they can be typed."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PLAIN = re.compile(
    r"(?!(null|true|false|nan|inf)\Z)([a-z_/]|\.(?!\d))[\w./:+-]*", re.ASCII | re.IGNORECASE
)
"""Text that Hydra reads without quotes, and as text."""


def python_command(*words: str) -> str:
    """Return ``python -m WORDS`` for the running interpreter, quoted for a shell.

    The interpreter is spelled ``python`` where that is found on ``PATH``, and else by its path,
    which is relative if it lies below the working directory.
    """
    return shlex.join([_interpreter(), "-m", *words])


def install_command(extra: str) -> str:
    """Return the command that installs an extra of this package."""
    return python_command("pip", "install", f"symo_exp[{extra}]")


def override_value(value: Any, *, nested: bool = False) -> str:
    """Write a value as in an override of Hydra; an array or a tensor is a list.

    A string that is not nested is unchanged: it may be anything that Hydra reads.
    """
    if hasattr(value, "tolist"):  # of NumPy, PyTorch or pandas
        value = value.tolist()
    if isinstance(value, Mapping):
        items = (f"{key}: {override_value(x, nested=True)}" for key, x in value.items())
        return "{" + ", ".join(items) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(override_value(x, nested=True) for x in value) + "]"
    if isinstance(value, os.PathLike):
        return text_value(os.fspath(value))
    if isinstance(value, str):
        return _quoted(value) if nested else value
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


def text_value(text: str) -> str:
    """Write a text as in an override of Hydra, with quotes where it would be read otherwise."""
    return text if PLAIN.fullmatch(text) else _quoted(text)


def _quoted(text: str) -> str:
    """Quote a string as Hydra reads it: of backslashes, those before a quote alone are doubled."""
    inside = re.sub(r'(\\*)"', r'\1\1\\"', text)
    return '"' + re.sub(r"(\\+)\Z", r"\1\1", inside) + '"'


def _interpreter() -> str:
    found = shutil.which("python")
    running = Path(sys.executable or "python")
    if found is not None and _same(Path(found), running):
        return "python"
    if running.is_relative_to(Path.cwd()):
        return os.path.join(".", running.relative_to(Path.cwd())).removeprefix("./")
    return str(running)


def _same(one: Path, other: Path) -> bool:
    """Compare folders as well: the interpreter of an environment is a link to one of another."""
    try:
        return one.samefile(other) and one.parent.samefile(other.parent)
    except OSError:
        return False
