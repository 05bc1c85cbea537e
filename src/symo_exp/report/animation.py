"""An animation of prediction and truth side by side, drawn by Pillow from a system's skeleton."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from symo_exp.evaluation.evaluate import Rollouts
from symo_exp.report.style import TRUTH, Look
from symo_exp.systems.base import Skeleton, System

SECONDS, FRAME = 12.0, 0.05
"""Length of the animation and shortest time between two frames [s]; it plays in real time."""
PANEL, HEADER = 240, 44
FINE = 3
"""Drawn this much larger and scaled down: Pillow's lines have no soft edges."""
MARGIN = 1.3
PAPER, RAIL, GHOST, INK = "#ffffff", "#c8c8c8", "#d5d5d5", "#333333"


def animate(
    system: System, rollouts: Rollouts, which: int, style: Look, title: str, folder: Path
) -> Path:
    """Write ``animation.gif``: left the prediction with a shadow of the truth, right the truth.

    The true motion's first point stays in the middle of both pictures.
    """
    stride = max(1, round(FRAME / rollouts.time_step))
    last = min(rollouts.q.shape[1] - 1, round(SECONDS / rollouts.time_step))
    frames = [
        _frame(system, rollouts.q[which, k], rollouts.q_true[which, k],
               k * rollouts.time_step, style, title)
        for k in range(0, last + 1, stride)
    ]  # fmt: skip
    palette = frames[0].quantize(48, dither=Image.Dither.NONE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    path = folder / "animation.gif"
    small[0].save(
        path,
        save_all=True,
        append_images=small[1:],
        duration=round(1000 * stride * rollouts.time_step),
        loop=0,
        optimize=False,
    )
    return path


def _frame(
    system: System, q: torch.Tensor, q_true: torch.Tensor, t: float, style: Look, title: str
) -> Image.Image:
    size = (2 * PANEL * FINE, (PANEL + HEADER) * FINE)
    image = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(image)
    true = system.skeleton(q_true)
    camera = _points(true)[0]
    _figure(draw, true, 0, camera, GHOST, GHOST)
    if torch.isfinite(q).all():
        figure = system.skeleton(q)
        _figure(draw, figure, 0, camera, style.colour, INK)
        away = (_points(figure) - camera) / (MARGIN * figure.reach)
        gone = "out of view" if (np.abs(away) > 1).any(axis=1).all() else ""
    else:
        gone = "diverged"
    _text(draw, (PANEL / 2, HEADER + PANEL - 16), gone, style.colour, 12, "mm")
    # the prediction may leave its panel: the truth's is cleared of it
    draw.rectangle((PANEL * FINE, 0, *size), fill=PAPER)
    _figure(draw, true, PANEL, camera, TRUTH.colour, INK)
    draw.rectangle((0, 0, size[0], HEADER * FINE), fill=PAPER)
    draw.line((PANEL * FINE, HEADER * FINE, PANEL * FINE, size[1]), fill=RAIL, width=FINE)
    _text(draw, (8, 5), title, INK, 11, "la")
    _text(draw, (2 * PANEL - 8, 5), f"{t:5.1f} s", INK, 11, "ra")
    _text(draw, (PANEL / 2, 24), style.label, style.colour, 13, "ma")
    _text(draw, (PANEL * 1.5, 24), TRUTH.label, TRUTH.colour, 13, "ma")
    return image.resize((2 * PANEL, PANEL + HEADER), Image.Resampling.BOX)


def _figure(
    draw: ImageDraw.ImageDraw,
    skeleton: Skeleton,
    left: int,
    camera: np.ndarray,
    colour: str,
    joint: str,
) -> None:
    """One stick figure in the panel that begins ``left`` pixels from the edge."""
    points = _points(skeleton)
    scale = PANEL * FINE / (2 * MARGIN * skeleton.reach)
    centre = np.array([left + PANEL / 2, HEADER + PANEL / 2]) * FINE
    far = 4.0 * PANEL * FINE  # Pillow takes no infinite coordinates

    def pixel(point: np.ndarray) -> tuple[float, float]:
        x, y = np.clip(scale * (point - camera), -far, far)
        return float(centre[0] + x), float(centre[1] - y)

    width = round(0.055 * PANEL * FINE)
    if skeleton.carts:
        level = pixel(np.array([camera[0], 0.0]))[1]
        edges = (left * FINE, (left + PANEL) * FINE)
        draw.line((edges[0], level, edges[1], level), fill=RAIL, width=FINE)
        half = PANEL * FINE / 2 / scale
        for metre in range(int(camera[0] - half) - 1, int(camera[0] + half) + 2):
            x = pixel(np.array([float(metre), 0.0]))[0]
            if edges[0] < x < edges[1]:
                draw.line((x, level - 5 * FINE, x, level + 5 * FINE), fill=RAIL, width=FINE)
    for cart in skeleton.carts:
        x, y = pixel(points[cart])
        box = (x - 2 * width, y - 1.2 * width, x + 2 * width, y + 1.2 * width)
        draw.rounded_rectangle(box, radius=width / 2, fill=joint)
    for start, end in skeleton.links:
        draw.line((*pixel(points[start]), *pixel(points[end])), fill=colour, width=width)
    for point in points:
        x, y = pixel(point)
        r = 0.5 * width
        draw.ellipse((x - r, y - r, x + r, y + r), fill=colour)
        r = 0.24 * width
        draw.ellipse((x - r, y - r, x + r, y + r), fill=PAPER)


def _points(skeleton: Skeleton) -> np.ndarray:
    return skeleton.points.detach().cpu().double().numpy()


def _text(
    draw: ImageDraw.ImageDraw,
    at: tuple[float, float],
    text: str,
    colour: str,
    size: int,
    anchor: str,
) -> None:
    place = (at[0] * FINE, at[1] * FINE)
    draw.text(place, text, fill=colour, font=_font(size * FINE), anchor=anchor)


@lru_cache(maxsize=4)
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Matplotlib's own font: there on every machine."""
    return ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf", size)
