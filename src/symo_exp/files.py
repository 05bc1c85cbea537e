"""Atomic writing of files, also at a power failure, their reading, and the folder of a cache."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from symo_exp.errors import first_line


class UnsoundError(Exception):
    """The content of a file is damaged, or is not what it should be; the message is the reason."""


def user_cache() -> Path:
    """Return the folder for what later commands of the user need not compute again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "symo_exp"


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


def write_bytes(path: Path, content: bytes) -> None:
    """Replace a file atomically by some bytes."""
    write_whole(path, lambda file: file.write_bytes(content))


def write_text(path: Path, text: str) -> None:
    """Replace a file atomically by a text."""
    write_bytes(path, text.encode())


def write_frame(path: Path, frame: Any) -> None:
    """Replace a file atomically by a frame of pandas, as Parquet or else as CSV by its suffix."""
    write = frame.to_parquet if path.suffix == ".parquet" else frame.to_csv
    write_whole(path, lambda file: write(file, index=False))


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


def read_state(path: Path) -> Any:
    """Return tensors and plain values of a file of ``write_state``; nothing in it is executed.

    Raises:
        OSError: If the system does not read the file, which may be intact.
        MemoryError: If its content finds no room.
        UnsoundError: If the content is damaged or of another kind.
    """
    import torch

    content = io.BytesIO(path.read_bytes())  # at once: all later errors are those of the content
    try:
        if not content.getbuffer():
            raise UnsoundError("it is empty")
        with zipfile.ZipFile(content) as archive:
            damaged = archive.testzip()  # checks all its parts, as torch.load does not
        if damaged is not None:
            raise UnsoundError(f"{damaged} in it is damaged")
        content.seek(0)
        return torch.load(content, map_location="cpu", weights_only=True)
    except zipfile.BadZipFile:
        raise UnsoundError("it is not a complete file") from None
    except Exception as error:  # damaged in another way, or of another program
        if isinstance(error, UnsoundError | MemoryError):
            raise
        raise UnsoundError(f"it cannot be read ({first_line(error)})") from None


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
