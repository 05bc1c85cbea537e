"""The error of invalid user input, and messages of one line."""

import os
import re


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
    if not isinstance(error, ConfigError) and cause is not None and str(cause) not in text:
        text = f"{text}: {cause}"
    return " ".join(text.split())


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, the name of its class if there is none."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


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
