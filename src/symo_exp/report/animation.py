"""Animations of prediction and truth side by side."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from symo_exp.evaluation.evaluate import Rollouts
from symo_exp.report.looks import Look
from symo_exp.systems.base import System
from symo_exp.systems.render import FINE, JOINT, MARGIN, PAPER, RAIL, paint, points_of

SECONDS, FRAME = 12.0, 0.05
"""Length of an animation and shortest time between two frames [s]; it plays in real time."""
PANEL, HEADER = 240, 44
GHOST = "#d5d5d5"
Looks = tuple[Look, Look]
"""Of the prediction and of the truth."""


def animate(
    system: System, rollouts: Rollouts, which: int, looks: Looks, title: str, folder: Path
) -> Path:
    """Write ``animation.gif``: left the prediction with a shadow of the truth, right the truth.

    The first point of the true motion stays in the middle of both pictures.

    Args:
        system: The system, which has a skeleton or a picture.
        rollouts: Predicted and true motions.
        which: The number of the motion.
        looks: The looks of the prediction and of the truth.
        title: The text above.
        folder: Where the file is written.

    Returns:
        The file.
    """
    stride = max(1, round(FRAME / rollouts.time_step))
    last = min(rollouts.q.shape[1] - 1, round(SECONDS / rollouts.time_step))
    frames = [
        _frame(system, rollouts.q[which, k], rollouts.q_true[which, k],
               k * rollouts.time_step, looks, title)
        for k in range(0, last + 1, stride)
    ]  # fmt: skip
    palette = frames[0].quantize(48, dither=Image.Dither.NONE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    path = folder / "animation.gif"
    duration = round(1000 * stride * rollouts.time_step)
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=duration, loop=0, optimize=False
    )
    return path


def _frame(
    system: System, q: torch.Tensor, q_true: torch.Tensor, t: float, looks: Looks, title: str
) -> Image.Image:
    style, other = looks
    size = (2 * PANEL * FINE, (PANEL + HEADER) * FINE)
    image = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(image)
    here = bool(torch.isfinite(q).all())
    truth = system.picture(q_true, PANEL)
    if truth is None:
        gone = _figures(system, draw, q if here else None, q_true, looks)
    else:
        gone = "" if here else "diverged"
        _pictures(image, truth, system.picture(q, PANEL, q_true) if here else None)
    _text(draw, (PANEL / 2, HEADER + PANEL - 16), gone, style.colour, 12, "mm")
    draw.rectangle((0, 0, size[0], HEADER * FINE), fill=PAPER)
    draw.line((PANEL * FINE, HEADER * FINE, PANEL * FINE, size[1]), fill=RAIL, width=FINE)
    _text(draw, (8, 5), title, JOINT, 11, "la")
    _text(draw, (2 * PANEL - 8, 5), f"{t:5.1f} s", JOINT, 11, "ra")
    _text(draw, (PANEL / 2, 24), style.label, style.colour, 13, "ma")
    _text(draw, (PANEL * 1.5, 24), other.label, other.colour, 13, "ma")
    return image.resize((2 * PANEL, PANEL + HEADER), Image.Resampling.BOX)


def _figures(
    system: System, draw: ImageDraw.ImageDraw, q: torch.Tensor | None, q_true: torch.Tensor,
    looks: Looks,
) -> str:  # fmt: skip
    """Draw skeletons; return a note if the prediction is not seen."""
    true = system.skeleton(q_true)
    assert true is not None
    camera = points_of(true)[0]
    left, right = ((x * FINE, HEADER * FINE, PANEL * FINE) for x in (0, PANEL))
    paint(draw, left, true, camera, GHOST, GHOST)
    gone = "diverged"
    if q is not None:
        figure = system.skeleton(q)
        assert figure is not None
        paint(draw, left, figure, camera, looks[0].colour)
        away = (points_of(figure) - camera) / (MARGIN * figure.reach)
        gone = "out of view" if (np.abs(away) > 1).any(axis=1).all() else ""
    # the prediction may have left its panel
    draw.rectangle((PANEL * FINE, 0, 2 * PANEL * FINE, (PANEL + HEADER) * FINE), fill=PAPER)
    paint(draw, right, true, camera, looks[1].colour)
    return gone


def _pictures(image: Image.Image, truth: np.ndarray, predicted: np.ndarray | None) -> None:
    """Paste pictures of the system; on the left a quarter is the truth."""
    seen = truth if predicted is None else 0.25 * truth + 0.75 * predicted
    for x, picture in ((0, seen), (PANEL, truth)):
        panel = Image.fromarray(picture.astype(np.uint8))
        size = (PANEL * FINE, PANEL * FINE)
        image.paste(panel.resize(size, Image.Resampling.NEAREST), (x * FINE, HEADER * FINE))


def _text(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, colour: str, size: int,
    anchor: str,
) -> None:  # fmt: skip
    place = (at[0] * FINE, at[1] * FINE)
    draw.text(place, text, fill=colour, font=_font(size * FINE), anchor=anchor)


@lru_cache(maxsize=4)
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font that Matplotlib ships."""
    return ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf", size)
