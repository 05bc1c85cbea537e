"""The command line: what it may say, checked before any work."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def _shipped(name: str) -> Path:
    """A folder of files at the top of the project; a wheel carries it inside the package."""
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parents[1] / name


CONF = _shipped("conf")
SWEEPS = _shipped("sweeps")
