"""One renderer for the skeleton of any system."""

from __future__ import annotations

from typing import Any

import numpy as np

from symo_exp.errors import ConfigError
from symo_exp.systems.base import Skeleton

SIZE = 480
MARGIN = 1.25
"""Half the picture's width in units of the skeleton's reach."""

_PAPER, _RAIL, _LINK, _JOINT, _CART = (
    (250, 250, 248),
    (190, 190, 190),
    (40, 90, 160),
    (200, 80, 40),
    (70, 70, 70),
)


class Renderer:
    """Draws skeletons with pygame: in a window (``human``) or as an array (``rgb_array``).

    The first point stays in the middle of the picture. Where there is a rail, its ticks, one a
    metre, show how far it has moved. Arrays need no display.
    """

    def __init__(self, mode: str, frames_per_second: float, title: str) -> None:
        try:
            import pygame
        except ImportError as error:
            raise ConfigError(
                "rendering needs pygame, which is not installed: pip install 'symo_exp[render]'"
            ) from error
        self._pygame: Any = pygame
        self._mode, self._fps = mode, frames_per_second
        self._canvas = pygame.Surface((SIZE, SIZE))
        self._window: Any = None
        if mode == "human":
            pygame.display.init()
            pygame.display.set_caption(title)
            self._window = pygame.display.set_mode((SIZE, SIZE))
            self._clock = pygame.time.Clock()

    def draw(self, skeleton: Skeleton) -> np.ndarray | None:
        """The picture (height, width, 3), uint8; ``None`` where it went to the window."""
        pygame, canvas = self._pygame, self._canvas
        points = skeleton.points.detach().cpu().numpy().astype(float)
        scale = SIZE / (2 * MARGIN * skeleton.reach)
        origin = points[0]
        width = max(2, round(0.08 * skeleton.reach * scale))

        def pixel(point: np.ndarray) -> tuple[int, int]:
            x, y = scale * (point - origin)
            return round(SIZE / 2 + x), round(SIZE / 2 - y)

        canvas.fill(_PAPER)
        if skeleton.carts:
            level = pixel(np.array([origin[0], 0.0]))[1]
            pygame.draw.line(canvas, _RAIL, (0, level), (SIZE, level), 2)
            half = SIZE / 2 / scale
            for metre in range(int(origin[0] - half) - 1, int(origin[0] + half) + 2):
                x = pixel(np.array([float(metre), 0.0]))[0]
                pygame.draw.line(canvas, _RAIL, (x, level - 6), (x, level + 6), 2)
        for cart in skeleton.carts:
            box = pygame.Rect(0, 0, 5 * width, 3 * width)
            box.center = pixel(points[cart])
            pygame.draw.rect(canvas, _CART, box, border_radius=width // 2)
        for start, end in skeleton.links:
            pygame.draw.line(canvas, _LINK, pixel(points[start]), pixel(points[end]), width)
        for point in points:
            pygame.draw.circle(canvas, _JOINT, pixel(point), round(0.7 * width))
        if self._window is None:
            return np.transpose(pygame.surfarray.array3d(canvas), (1, 0, 2)).copy()
        self._window.blit(canvas, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None
