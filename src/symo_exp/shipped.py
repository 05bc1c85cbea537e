"""Folders of the files that ship with the code: the configuration and the sweeps."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def _folder(name: str) -> Path:
    """Return a folder at the top of a checkout, or inside the package of a wheel."""
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parents[1] / name


def in_checkout() -> bool:
    """Return whether the working directory is the checkout that runs, with its Makefile."""
    return Path.cwd() == _PACKAGE.parents[1] and Path("Makefile").is_file()


CONF = _folder("conf")
SWEEPS = _folder("sweeps")
