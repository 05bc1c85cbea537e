"""Shapes that signatures state are checked while tests run: in each test's first calls, since what
a rollout repeats a thousand times need not be looked at so often."""

import functools
import random
from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, beartype
from jaxtyping import config

CALLS = 100
WHOLE = BeartypeConf(is_pep484_tower=True)
"""Whole numbers, as a file of settings has them, are floats as well."""
_left = CALLS


def begin() -> None:
    """Another test: check again."""
    global _left
    _left = CALLS
    config.update("jaxtyping_disable", False)


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrapper that jaxtyping's import hook puts around each function."""
    check = beartype(function, conf=WHOLE)

    @functools.wraps(function)
    def counted(*args: Any, **kwargs: Any) -> Any:
        global _left
        _left -= 1
        if _left <= 0:
            config.update("jaxtyping_disable", True)
        drawn = random.getstate()  # beartype draws which items of a list it looks at
        try:
            return check(*args, **kwargs)
        finally:
            random.setstate(drawn)

    return counted
