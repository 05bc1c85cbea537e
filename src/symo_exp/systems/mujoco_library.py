"""Access to MuJoCo: the library, its models and its warnings."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from pathlib import Path
from typing import Any

from symo_exp.errors import ConfigError, shortened
from symo_exp.shell import install_command
from symo_exp.shipped import CONF


def library() -> Any:
    """Return the module ``mujoco``.

    Without a display it is set to draw by EGL, if that is installed.

    Raises:
        ConfigError: If MuJoCo is not installed.
    """
    no_display = sys.platform == "linux" and not os.environ.get("DISPLAY")
    if no_display and "mujoco" not in sys.modules and find_library("EGL"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError as error:
        raise ConfigError(
            f"MuJoCo models need mujoco, which is not installed: {install_command('mujoco')}"
        ) from error
    return mujoco


def model_file(path: str | os.PathLike[str]) -> Path:
    """Return the file of a model; one that is not found is looked for among those that ship."""
    file = Path(str(path)).expanduser()
    ours = CONF / "system" / file
    return ours if not file.is_file() and ours.is_file() else file


def load_model(path: str | os.PathLike[str]) -> Any:
    """Return MuJoCo's own model of an MJCF or URDF file."""
    return library().MjModel.from_xml_path(str(model_file(path)))


def environment_model(name: str) -> Any:
    """Return the MuJoCo model of a Gymnasium environment, ``None`` if it has none."""
    library()  # before Gymnasium imports it
    import gymnasium

    made = gymnasium.make(name)
    made.close()
    return getattr(made.unwrapped, "model", None)


@contextmanager
def warnings_heard() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which it would write to a file in the working folder."""
    lines: list[str] = []
    library().set_mju_user_warning(lambda text: lines.append(shortened(text)))
    try:
        yield lines
    finally:
        library().set_mju_user_warning(None)
