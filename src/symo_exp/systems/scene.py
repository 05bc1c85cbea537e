"""Pictures of a MuJoCo model by MuJoCo's own renderer, off the screen."""

from __future__ import annotations

import logging
import os
import sys
from ctypes.util import find_library
from functools import lru_cache
from typing import Any

import numpy as np

log = logging.getLogger(__name__)

ELEVATION, DISTANCE = -30.0, 2.6
"""Of the camera: in degrees, and in radii of what there is to see; it has 45 degrees of view."""


def prepare() -> None:
    """Before MuJoCo is imported: without a display it draws by EGL, if that is there."""
    no_display = sys.platform == "linux" and not os.environ.get("DISPLAY")
    if no_display and "mujoco" not in sys.modules and find_library("EGL"):
        os.environ.setdefault("MUJOCO_GL", "egl")


class Scene:
    """A model, with a camera that stands where all of it but the floor is in view at first."""

    def __init__(self, model: Any, size: int) -> None:
        import mujoco

        self._mujoco, self._model, self._data = mujoco, model, mujoco.MjData(model)
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

    def draw(self, q: np.ndarray) -> np.ndarray:
        """The picture (size, size, 3), uint8, of a configuration."""
        self._data.qpos[:] = q
        self._mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        return np.array(self._renderer.render())


@lru_cache(maxsize=4)
def scene(model: str | None, environment: str | None, size: int) -> Scene | None:
    """That of a file or of an environment's model; ``None`` where it, MuJoCo or a way to draw is
    not there: whoever asks draws a stick figure instead."""
    from symo_exp.systems import mujoco

    try:
        found = mujoco.model_of(model, environment)
        return None if found is None else Scene(found, size)
    except Exception as error:  # drivers of graphics fail in many ways
        log.debug("MuJoCo draws nothing here: %s", error)
        return None
