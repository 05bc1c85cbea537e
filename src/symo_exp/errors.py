"""The error of invalid user input, and messages of one line."""

import os
import re
import sysconfig
import traceback
from pathlib import Path

PACKAGES = {"site-packages", "dist-packages"}
"""Folders of installed packages."""


class ConfigError(ValueError):
    """Raised for invalid user input.

    The message says in one line what was given, what was expected and what to do. The command line
    prints it without a traceback and exits with code 2.
    """

    def __init__(self, message: object) -> None:
        super().__init__(" ".join(str(message).split()))  # the user's words may have more lines


def debugging() -> bool:
    """Return whether errors are shown with their traceback."""
    return os.environ.get("SYMO_EXP_DEBUG") == "1"


def one_line(error: BaseException) -> str:
    """Return the message of an error, with that of its cause where it adds something."""
    cause = error.__cause__
    text = str(error)
    if not isinstance(error, ConfigError) and cause is not None and first_line(cause) not in text:
        text = f"{text}: {cause}"
    return " ".join(text.split())


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, the name of its class if there is none."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def with_place(error: BaseException) -> str:
    """Return the class and the first line of an error, and the place in the code of the user."""
    return f"{type(error).__name__}: {first_line(error)}{place_in_code(error)}"


def place_in_code(error: BaseException) -> str:
    """Return where the code of the user raised an error, as `` (mine.py, line 12)``.

    It is the last line that was executed outside this package, the installed ones and Python's own;
    empty if there is none, or if the message of the error has the place already.
    """
    if isinstance(error, SyntaxError):
        return ""
    lines = [(Path(x.f_code.co_filename), n) for x, n in traceback.walk_tb(error.__traceback__)]
    of_user = [(file, number) for file, number in lines if not _is_installed(file)]
    return f" ({of_user[-1][0].name}, line {of_user[-1][1]})" if of_user else ""


def _is_installed(file: Path) -> bool:
    """Return whether a file of code belongs to this package, an installed one or Python."""
    ours, python = Path(__file__).parent, sysconfig.get_path("stdlib")
    own = file.is_relative_to(ours) or file.is_relative_to(python)
    return own or not file.is_file() or not PACKAGES.isdisjoint(file.parts)


def shortened(text: object, most: int = 300) -> str:
    """Return a text without line ends, at most so many characters."""
    return " ".join(str(text).split())[:most]


def without_passwords(text: str) -> str:
    """Return a text in which addresses, as ``postgresql://me:…@host``, have no passwords."""
    return re.sub(r"(://[^/\s:@]*):[^/\s]*@", r"\1:…@", text)


class Refused(BaseException):
    """Carry a ``ConfigError`` of a job through Hydra, which reports every ``Exception`` itself.

    Attributes:
        error: The error.
    """

    def __init__(self, error: ConfigError) -> None:
        super().__init__(error)
        self.error = error
