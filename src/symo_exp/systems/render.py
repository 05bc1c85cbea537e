"""Stick figures drawn by Pillow, for animations and environments, and the window of these."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from symo_exp.errors import ConfigError
from symo_exp.shell import install_command
from symo_exp.systems.base import Skeleton

SIZE = 480
MARGIN = 1.25
"""Half the picture's width in units of the skeleton's reach."""
FINE = 3
"""Factor by which figures are drawn larger and scaled down, for soft edges."""
PAPER, RAIL, LINK, JOINT = "#ffffff", "#c8c8c8", "#285aa0", "#333333"


def paint(
    canvas: ImageDraw.ImageDraw, box: tuple[float, float, float], skeleton: Skeleton,
    camera: np.ndarray, link: str = LINK, joint: str = JOINT,
) -> None:  # fmt: skip
    """Draw a skeleton into the square ``box = (left, top, side)`` [pixel].

    The point ``camera`` [m] is in the middle. Where there is a rail, its ticks, one a metre, show
    how far the camera has moved.
    """
    left, top, side = box
    points = points_of(skeleton)
    scale = side / (2 * MARGIN * skeleton.reach)
    far = 4.0 * side  # Pillow takes no infinite coordinates

    def pixel(point: np.ndarray) -> tuple[float, float]:
        x, y = np.clip(scale * (point - camera), -far, far)
        return float(left + side / 2 + x), float(top + side / 2 - y)

    width, thin = round(0.055 * side), max(1, round(side / 200))
    if skeleton.carts:
        _, level = pixel(np.array([camera[0], 0.0]))
        canvas.line((left, level, left + side, level), fill=RAIL, width=thin)
        half = side / 2 / scale
        for metre in range(int(camera[0] - half) - 1, int(camera[0] + half) + 2):
            x, _ = pixel(np.array([float(metre), 0.0]))
            if left < x < left + side:
                canvas.line((x, level - 5 * thin, x, level + 5 * thin), fill=RAIL, width=thin)
    for cart in skeleton.carts:
        x, y = pixel(points[cart])
        corners = (x - 2 * width, y - 1.2 * width, x + 2 * width, y + 1.2 * width)
        canvas.rounded_rectangle(corners, radius=width / 2, fill=joint)
    for start, end in skeleton.links:
        canvas.line((*pixel(points[start]), *pixel(points[end])), fill=link, width=width)
    for x, y in map(pixel, points):
        for radius, colour in ((0.5 * width, link), (0.24 * width, PAPER)):
            canvas.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)


def points_of(skeleton: Skeleton) -> np.ndarray:
    """Return the points (points, 2) of a skeleton [m]."""
    return np.asarray(skeleton.points.detach().cpu().double().numpy())


def draw_skeleton(skeleton: Skeleton) -> np.ndarray:
    """Return a picture (SIZE, SIZE, 3), uint8, of a skeleton, its first point in the middle."""
    image = Image.new("RGB", (SIZE * FINE, SIZE * FINE), PAPER)
    box = (0.0, 0.0, float(SIZE * FINE))
    paint(ImageDraw.Draw(image), box, skeleton, points_of(skeleton)[0])
    return np.array(image.resize((SIZE, SIZE), Image.Resampling.BOX))


class Window:
    """A window of pygame, with its frames per second and its title."""

    def __init__(self, frames_per_second: float, title: str) -> None:
        try:
            import pygame
        except ImportError as error:
            raise ConfigError(
                f"a window needs pygame, which is not installed: {install_command('render')}"
            ) from error
        self._fps, self._pygame = frames_per_second, pygame
        pygame.display.init()
        pygame.display.set_caption(title)
        self._window = pygame.display.set_mode((SIZE, SIZE))
        self._clock = pygame.time.Clock()

    def show(self, picture: np.ndarray) -> None:
        """Show a picture (SIZE, SIZE, 3), uint8."""
        image = self._pygame.image.frombuffer(picture.tobytes(), (SIZE, SIZE), "RGB")
        self._window.blit(image, (0, 0))
        self._pygame.event.pump()
        self._pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window."""
        self._pygame.display.quit()
