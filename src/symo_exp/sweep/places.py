"""Where a run may write: a place below the output folder, which nobody leaves by a name."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from symo_exp.errors import ConfigError


def check_places(config: DictConfig, place: DictConfig) -> None:
    """Refuse names of folders that are empty or climb out of the output folder.

    ``place`` is Hydra's: the folder of a run, or of a sweep with its ``subdir`` for each.
    """
    _check_text("output_dir", config.get("output_dir"))
    _check_text("hydra's dir", place.dir)
    name = _check_text("experiment", config.get("experiment"))
    for part in name.split("/"):
        if not part or part.startswith(".") or not part.isprintable():
            raise ConfigError(
                f"experiment={name!r} names a folder below output_dir: letters, digits and what "
                "else can be printed, parts divided by /, none of which is empty or begins with ."
            )


def _check_text(name: str, value: Any) -> str:
    if not isinstance(value, str) or not value or "\0" in value:
        raise ConfigError(f"{name}={value!r} has to be a word that names a folder")
    return value


def check_folder(folder: Path) -> None:
    """Refuse an output folder that cannot be made or written."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir():
        raise ConfigError(f"output folder {folder}: {there} is a file; choose another output_dir")
    try:
        probe = there / f".symo_exp.{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(
            f"output folder {folder}: {there} cannot be written ({error.strerror}); "
            "choose another output_dir"
        ) from error
