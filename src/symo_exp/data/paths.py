"""Files of recordings, and words for messages about them."""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import pandas as pd

from symo_exp.errors import ConfigError

TABLES = (".parquet", ".csv", ".npz", ".mat")
TEXT = (".csv", ".tsv", ".txt", ".dat")
"""Text files; in a folder only the first kind is taken for a recording."""
BAGS = (".db3", ".mcap", ".bag")
OTHER_FILES = {
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "save the sheet as CSV"),
    **dict.fromkeys(("", ".asc", ".log"), "rename a table of text to mine.csv"),
    ".npy": "save t, q and u by numpy.savez",
    **dict.fromkeys((".gz", ".bz2", ".xz", ".zst", ".zip", ".7z"), "unpack it"),
    **dict.fromkeys(
        (".json", ".jsonl", ".feather", ".h5", ".hdf5", ".pkl"),
        "read it with pandas and write it by DataFrame.to_csv(..., index=False)",
    ),
}
"""Remedies for other files, by their suffix."""
Location = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""One file, folder or glob pattern, or a list of them."""


def shown(path: Location) -> str:
    """Return ``data.path=...`` as it begins every message about it."""
    if isinstance(path, str | os.PathLike):
        return f"data.path={path}"
    return f"data.path=[{few(list(path))}]"


def few(words: Sequence[object]) -> str:
    """Return the first words in a line, and how many are left."""
    text = ", ".join(map(str, words[:12]))
    return f"{text}, and {len(words) - 12} more" if len(words) > 12 else text


def titled(label: str) -> str:
    """Return how messages call a trajectory, which has no name if it is alone."""
    return f"trajectory {label}" if label else "the recording"


def files(path: Location) -> list[Path]:
    """Return the files that a path names, in order.

    Args:
        path: A file, a folder of tables, a bag, a glob pattern, or a list of these.

    Raises:
        ConfigError: If nothing is found or a file has an unknown suffix.
    """
    if isinstance(path, pd.DataFrame):
        raise ConfigError(
            "data.path is a DataFrame: write it with to_parquet('mine.parquet') and give that path"
        )
    if isinstance(path, Sequence) and not isinstance(path, str) and path:
        return [file for one in path for file in files(one)]
    if not isinstance(path, str | os.PathLike) or not str(path):
        raise ConfigError(
            f"data.path={path!r}: expected a file, a folder, a pattern such as 'logs/*.csv' or a "
            "list of these"
        )
    file = Path(str(path)).expanduser()
    if is_bag(file):
        return [file]
    if file.is_dir():
        there = (one for one in file.iterdir() if not one.name.startswith("."))
        tables = (one for one in there if suffix(one) in TABLES or is_bag(one))
        found = sorted(tables, key=_by_number)
        if not found:
            raise ConfigError(f"{shown(path)}: the folder has no {', '.join(TABLES)} file or bag")
        return found
    if not file.exists() and glob.has_magic(str(file)):
        matches = sorted(glob.glob(str(file), recursive=True), key=_by_number)
        if not matches:
            raise ConfigError(f"{shown(path)}: no file matches this pattern")
        return files(matches)
    if suffix(file) not in (*TABLES, *TEXT):
        if not file.exists():
            raise ConfigError(f"{shown(path)}: there is no such file or folder")
        mend = f"; {known}" if (known := OTHER_FILES.get(suffix(file))) else ""
        raise ConfigError(
            f"{shown(path)}: expected a file that ends in {', '.join((*TEXT, *TABLES[2:]))} or "
            f"{TABLES[0]}, a ROS 2 bag, or a folder of these{mend}"
        )
    return [file]


def _by_number(path: str | Path) -> tuple[list[tuple[int, str]], str]:
    """Return what orders ``run_9`` before ``run_10``."""
    text = str(path)
    parts = re.split(r"(\d+)", text)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], text


def suffix(file: Path) -> str:
    """Return the suffix in lower case; data loggers write ``LOG.CSV``."""
    return file.suffix.lower()


def is_bag(file: Path) -> bool:
    """Return whether a path is a ROS bag: a file of one, or a folder with its metadata."""
    return suffix(file) in BAGS or (file / "metadata.yaml").is_file()


def content_of(paths: Sequence[Path]) -> str:
    """Return a digest of the content of files and of folders of files, read once a version."""
    every = [
        file
        for path in paths
        for file in (sorted(path.rglob("*")) if path.is_dir() else [path])
        if file.is_file()
    ]
    states = [(file.absolute(), file.stat()) for file in every]
    return _content(tuple((file, now.st_mtime_ns, now.st_size) for file, now in states))


@lru_cache(maxsize=64)  # shared by the jobs of a sweep
def _content(versions: tuple[tuple[Path, int, int], ...]) -> str:
    found = hashlib.sha256()
    for file, *_ in versions:
        with file.open("rb") as handle:
            while part := handle.read(2**20):
                found.update(part)
    return found.hexdigest()[:10]
