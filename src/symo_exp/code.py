"""Classes of a user's own: modules of the folder that ``code=FOLDER`` names, and of no other."""

from __future__ import annotations

import sys
from pathlib import Path

from symo_exp.errors import ConfigError

_folders: list[Path] = []


def add(folder: str | Path | None) -> None:
    """Have the modules of a folder found from now on; ``None`` adds nothing."""
    if folder is None:
        return
    path = Path(str(folder)).expanduser().absolute()
    if not path.is_dir():
        raise ConfigError(f"code={folder} is not a folder: it names the one with your modules")
    if path not in _folders:
        _folders.append(path)
        sys.path.append(str(path))


def modules() -> set[str]:
    """The names of all modules that were added."""
    return {
        entry.stem
        for folder in _folders
        for entry in folder.iterdir()
        if entry.suffix == ".py" or (entry / "__init__.py").exists()
    }


def owns(made: object) -> bool:
    """Whether a class or function is written in one of the folders: a name alone proves nothing."""
    module = sys.modules.get(str(getattr(made, "__module__", "")))
    file = getattr(module, "__file__", None)
    return file is not None and any(Path(file).is_relative_to(folder) for folder in _folders)
