"""Atomic writing of files, also at a power failure, and the folder of those kept for all runs."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any


def user_cache() -> Path:
    """Return the folder for what later commands of the user need not compute again."""
    return Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "symo_exp"


def write_whole(path: Path, write: Callable[[Path], object], *, keep: Path | None = None) -> None:
    """Replace a file atomically.

    Args:
        path: The file.
        write: Writes the content to the path that it is given, beside ``path``. If it raises,
            nothing is changed.
        keep: Where the previous content is kept; ``None``: nowhere.
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


def write_text(path: Path, text: str) -> None:
    """Replace a file atomically by a text."""
    write_whole(path, lambda file: file.write_text(text, encoding="utf-8"))


def write_state(path: Path, state: Any, *, keep: Path | None = None) -> None:
    """Replace a file atomically by tensors and plain values, for ``torch.load``.

    Args:
        path: The file.
        state: Tensors and plain values.
        keep: As in ``write_whole``.

    Raises:
        OSError: If the file cannot be written, as on a full disk.
    """
    import torch

    # in memory first: where it writes a file, torch.save tells of a full disk by a RuntimeError
    content = io.BytesIO()
    torch.save(state, content)
    write_whole(path, lambda file: file.write_bytes(content.getbuffer()), keep=keep)


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file, an empty one if it cannot be read or is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _settle(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):  # not every file system can
            os.fsync(handle)
    finally:
        os.close(handle)
