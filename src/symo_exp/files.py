"""Files that are there whole or not at all, also after a power cut."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, write: Callable[[Path], object], *, keep: Path | None = None) -> None:
    """Have ``write`` fill a file beside ``path``, which then takes its place.

    What was there before is lost, or kept as ``keep``. When ``write`` fails nothing is changed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(new)
        _settle(new)
        if keep is not None and path.exists():
            os.replace(path, keep)
        os.replace(new, path)
        _settle(path.parent)
    finally:
        new.unlink(missing_ok=True)


def _settle(path: Path) -> None:
    """Have the system put a file, or the names in a folder, on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):  # not every file system can
            os.fsync(handle)
    finally:
        os.close(handle)
