"""Access to MuJoCo: the library, its models, its warnings and its pictures."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from symo_exp.errors import ConfigError, shortened
from symo_exp.shell import install_command
from symo_exp.shipped import CONF

log = logging.getLogger(__name__)

ELEVATION, DISTANCE = -30.0, 2.6
"""Elevation of the camera [degrees], and its distance in radii of the model."""
AMBIENT, DIFFUSE = 0.5, 0.7
"""Headlight of a model that has no other light."""


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


class Scene:
    """A model, its light and a camera that at first sees the whole model except the floor.

    Where bodies move freely, it follows the centre of mass.
    """

    def __init__(self, model: Any, size: int) -> None:
        mujoco = library()
        self._mujoco, self._model, self._data = mujoco, model, mujoco.MjData(model)
        if model.nlight == 0:  # only the headlight shines, which is weak
            model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = AMBIENT, DIFFUSE
        self._sky = bool((model.tex_type == int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)).any())
        self._renderer = mujoco.Renderer(model, size, size)
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._camera)
        mujoco.mj_forward(model, self._data)
        seen = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        if seen.any():
            places, radii = self._data.geom_xpos[seen], model.geom_rbound[seen]
            middle = 0.5 * (places.min(0) + places.max(0))
            radius = (np.linalg.norm(places - middle, axis=1) + radii).max()
            self._camera.lookat[:], self._camera.distance = middle, DISTANCE * radius
        self._camera.elevation = ELEVATION
        self._follows = bool((model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any())
        self._offset = np.array(self._camera.lookat) - self._data.subtree_com[0]

    def draw(self, q: np.ndarray, middle: np.ndarray) -> np.ndarray:
        """Return the picture (size, size, 3), uint8, of ``qpos``, the camera that of ``middle``."""
        if self._follows:
            self._data.qpos[:] = middle
            self._mujoco.mj_forward(self._model, self._data)
            self._camera.lookat[:] = self._data.subtree_com[0] + self._offset
        self._data.qpos[:] = q
        self._mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        picture = np.array(self._renderer.render())
        return picture if self._sky else self._on_paper(picture)

    def _on_paper(self, picture: np.ndarray) -> np.ndarray:
        """Return a picture whose background, black without a sky, is white."""
        self._renderer.enable_segmentation_rendering()
        empty = self._renderer.render()[..., 0] < 0
        self._renderer.disable_segmentation_rendering()
        picture[empty] = 255
        return picture


@lru_cache(maxsize=4)
def scene(model: str | None, environment: str | None, size: int) -> Scene | None:
    """Return the scene of a model file or of a Gymnasium environment.

    ``None`` where neither is given, the model is not found, or nothing can be drawn off screen;
    callers draw a stick figure instead.
    """
    try:
        if model is not None:
            return Scene(load_model(model), size)
        found = None if environment is None else environment_model(environment)
        return None if found is None else Scene(found, size)
    except Exception as error:  # drivers of graphics fail in many ways
        log.debug("MuJoCo draws nothing here: %s", error)
        return None
