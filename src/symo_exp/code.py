"""Classes that a configuration may name, and those of the folder ``code=FOLDER``.

A configuration is data and must not run anything else.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import pkgutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from symo_exp.errors import ConfigError, place_in_code, with_place

COMMANDS = "symo_exp", "torch", "lightning"
"""The packages that a ``_target_`` of a command may name."""
MODELS = "symo_exp.systems", "symo_exp.models", "symo_exp.mechanics", "symo_exp.nets"
"""The packages that a ``_target_`` of a stored model may name."""

_folders: list[Path] = []


def add(folder: str | os.PathLike[str] | None) -> None:
    """Have the modules of a folder found from now on; ``None`` adds nothing."""
    if folder is None:
        return
    path = Path(str(folder)).expanduser().absolute()
    if not path.is_dir():
        raise ConfigError(f"code={folder}: no such folder; give the folder with your modules")
    if path not in _folders:
        _folders.append(path)
        sys.path.append(str(path))


def locate(target: Any, where: str, homes: tuple[str, ...] = COMMANDS) -> Callable[..., Any]:
    """Import what a ``_target_`` names.

    Args:
        target: The dotted name.
        where: The place of the name, for the error.
        homes: The packages that it may name, besides the modules of ``code=FOLDER``.

    Returns:
        A class of these packages or modules; a function only of a module of the user's, or of this
        package where a command asks for it.

    Raises:
        ConfigError: For any other name. The name alone proves nothing: ``symo_exp.x.os.system``
            also begins well.
    """
    mine = _modules()
    allowed = f"it may name a class of {', '.join((*homes, *mine))} (your own: code=FOLDER)"
    if not isinstance(target, str) or not target.startswith(
        tuple(f"{name}." for name in (*homes, *mine))
    ):
        raise ConfigError(f"{where}={target} is refused: {allowed}")
    try:
        made: Callable[..., Any] = pkgutil.resolve_name(target)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(
            f"{where}={target} cannot be found: {error}{place_in_code(error)}"
        ) from error
    except (Exception, SystemExit) as error:  # of a module of the user's, which may be a script
        raise ConfigError(f"{where}={target} cannot be imported: {with_place(error)}") from error
    module = f"{getattr(made, '__module__', '')}."
    function = ("symo_exp.",) if homes == COMMANDS else ()
    homely = inspect.isclass(made) and module.startswith(tuple(f"{home}." for home in homes))
    if not homely and not (callable(made) and (module.startswith(function) or _owns(made))):
        raise ConfigError(f"{where}={target} is refused: {allowed}")
    return made


def digests(folder: str | Path | None) -> dict[str, str]:
    """Return digests of the modules of a folder that are imported, by their files below it."""
    if folder is None:
        return {}
    home = Path(str(folder)).expanduser().absolute()
    files = [file for name in list(sys.modules) if (file := _file_below(home, name))]
    return {str(file.relative_to(home)): _digest(file) for file in files}


def changed(folder: str | Path | None, before: Mapping[str, str]) -> list[str]:
    """Return the files that have another content than they had when ``digests`` were taken."""
    home = Path(str(folder)).expanduser()
    files = [name for name in before if (home / name).is_file()]
    return [name for name in files if _digest(home / name) != before[name]]


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def _modules() -> set[str]:
    """Return the names of all modules that were added."""
    return {
        entry.stem
        for folder in _folders
        for entry in folder.iterdir()
        if entry.suffix == ".py" or (entry / "__init__.py").exists()
    }


def _owns(made: object) -> bool:
    """Return whether a class or function is written in one of the folders."""
    name = str(getattr(made, "__module__", ""))
    return any(_file_below(folder, name) for folder in _folders)


def _file_below(folder: Path, name: str) -> Path | None:
    """Return the file of an imported module that is found by its name in a folder.

    Others may lie below it as well: an environment with all its packages.
    """
    file = getattr(sys.modules.get(name), "__file__", None)
    place = folder.joinpath(*name.split("."))  # a package, or a module without its suffix
    return Path(file) if file and Path(file).parent in (place, place.parent) else None
