"""Arrays on disk, under a key of everything that their bytes depend on."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from symo_exp.errors import ConfigError
from symo_exp.files import write_text, write_whole
from symo_exp.locks import where_possible

log = logging.getLogger(__name__)

Arrays = Mapping[str, np.ndarray]


class Cache:
    """A folder of ``<name>-<key>.npz`` files, each with its recipe inside and beside it as JSON.

    Files are written atomically. Processes that need the same one wait for the first.

    Args:
        directory: The folder, made when the first file is written.

    Raises:
        ConfigError: If it cannot be a folder.
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self.directory = Path(directory).expanduser()
        if not str(directory):
            raise self._refusal("the name is empty")
        if not self._existing.is_dir():
            raise self._refusal(f"{self._existing} is not a directory")

    def check(self, name: str, recipe: Mapping[str, Any]) -> None:
        """Raise ``ConfigError`` if arrays are neither stored nor can be."""
        writable = os.access(self._existing, os.W_OK | os.X_OK)
        if not writable and _read(self.path(name, recipe), recipe) is None:
            raise self._refusal(f"{self._existing} is not writable")

    @property
    def _existing(self) -> Path:
        folders = (self.directory, *self.directory.absolute().parents)
        return next(folder for folder in folders if folder.exists())

    def path(self, name: str, recipe: Mapping[str, Any]) -> Path:
        """Return the file of a recipe."""
        return self.directory / f"{name}-{key(recipe)}.npz"

    def get(
        self, name: str, recipe: Mapping[str, Any], make: Callable[[], Arrays]
    ) -> dict[str, np.ndarray]:
        """Return the arrays of a recipe, read or else made by ``make()`` and stored."""
        path = self.path(name, recipe)
        found = _read(path, recipe)
        if found is not None:
            return found
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            with ExitStack() as stack:
                # without locks, as on some network file systems, two processes may make the same
                # data; the last file replaces the other, with the same bytes
                with where_possible():
                    stack.enter_context(FileLock(path.with_suffix(".lock")))
                found = _read(path, recipe, report=True)
                if found is not None:
                    return found
                arrays = dict(make())
                text = json.dumps(recipe, sort_keys=True, indent=1) + "\n"
                write_text(path.with_suffix(".json"), text)
                write_whole(path, lambda file: _save(file, recipe, arrays))
        except OSError as error:
            raise self._refusal(error.strerror or str(error)) from error
        return arrays

    def _refusal(self, reason: str) -> ConfigError:
        return ConfigError(
            f"data.cache_dir={self.directory}: {reason}; "
            "name a writable directory, or null to keep no data on disk"
        )


def key(recipe: Mapping[str, Any]) -> str:
    """Return a short hash of the recipe's canonical JSON."""
    return hashlib.sha256(_canonical(recipe).encode()).hexdigest()[:16]


def _canonical(recipe: Mapping[str, Any]) -> str:
    return json.dumps(recipe, sort_keys=True, allow_nan=False)


def _read(
    path: Path, recipe: Mapping[str, Any], report: bool = False
) -> dict[str, np.ndarray] | None:
    """Arrays of a valid file, ``None`` for any other, which is reported on request."""
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if str(arrays.pop("recipe")) == _canonical(recipe):
            return arrays
        reason = "it holds other data"
    except (OSError, ValueError, TypeError, AttributeError, KeyError, EOFError) as error:
        reason = f"unreadable ({' '.join(str(error).split()) or type(error).__name__})"
    except (zipfile.BadZipFile, zlib.error, RuntimeError) as error:  # encrypted, by a flipped bit
        reason = f"damaged ({error})"
    if report:
        log.warning("Cached data %s: %s; it is generated again", path, reason)
    return None


def _save(file: Path, recipe: Mapping[str, Any], arrays: Arrays) -> None:
    contents: dict[str, Any] = {"recipe": np.array(_canonical(recipe)), **arrays}
    with open(file, "wb") as handle:
        np.savez(handle, **contents)
