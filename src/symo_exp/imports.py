"""Imports of large packages, the slowest part of a command before training."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def first_import(module: str) -> Iterator[None]:
    """Suspend garbage collection while ``module`` is imported for the first time.

    The objects that PyTorch, Lightning and MLflow create on import live until the process ends.
    Collecting garbage there is pointless and costs a sixth of the import, a part of every later
    collection, and one to two seconds at exit.
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
