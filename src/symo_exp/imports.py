"""Imports of large packages, which cost a command more than anything else before it trains."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def first_import(module: str) -> Iterator[None]:
    """Around the statement that may be the first to import ``module`` and all it brings along.

    What PyTorch, Lightning and MLflow make while they are imported stays until the process ends.
    To look for garbage in it is in vain: left to itself Python does so during the import, a sixth
    of its time, in every later collection, and once more at the end, which takes a second or two.
    """
    if module in sys.modules or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
