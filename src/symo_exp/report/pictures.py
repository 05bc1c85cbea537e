"""Pictures of one run: what the model predicts and what it has learned, beside the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from symo_exp.evaluation.evaluate import Rollouts
from symo_exp.evaluation.measures import rollout_pose_mse
from symo_exp.evaluation.protocols import Model
from symo_exp.report.animation import animate
from symo_exp.report.style import RC, TRUTH, Look, axis_label, look
from symo_exp.systems.base import System

LEARNED_SECONDS = 10.0
"""Length of the motion along which learned quantities are drawn, as in the thesis."""


def draw_run(
    model: Model, system: System, rollouts: Rollouts, *, method: str, title: str, folder: Path
) -> list[Path]:
    """Write all pictures of a run into ``folder``.

    ``method`` chooses the colour (see ``style``), ``title`` is what the run is called.
    """
    folder.mkdir(parents=True, exist_ok=True)
    style = look(method)
    figures = {
        "trajectories": trajectories(rollouts, style, title),
        "energy": energy(rollouts, style, title),
        "phase_portrait": phase_portrait(rollouts, style, title),
    }
    if model.lagrangian is not None:
        figures["learned"] = learned_quantities(model, system, rollouts, style, title)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1])
    paths.append(animate(system, rollouts, median(rollouts), style, title, folder))
    return paths


def ranking(rollouts: Rollouts) -> list[int]:
    """Trajectories from the best predicted to the worst."""
    error = rollout_pose_mse(rollouts.q[:, 1:], rollouts.q_true[:, 1:])
    return error.argsort(stable=True).tolist()


def median(rollouts: Rollouts) -> int:
    """The trajectory of median error."""
    order = ranking(rollouts)
    return order[(len(order) - 1) // 2]


def trajectories(rollouts: Rollouts, style: Look, title: str) -> Figure:
    """Every coordinate over time, prediction on truth, for a good, a typical and a bad rollout."""
    order = ranking(rollouts)
    shown = {"best": order[0], "median": median(rollouts), "worst": order[-1]}
    error = rollout_pose_mse(rollouts.q[:, 1:], rollouts.q_true[:, 1:])
    t = _times(rollouts)
    n = rollouts.coordinates.n
    with _figure(f"{title}: rollouts", 11.0, 1.2 + 2.0 * n) as figure:
        grid = figure.subplots(n, len(shown), sharex=True, squeeze=False)
        for column, (name, which) in enumerate(shown.items()):
            for i in range(n):
                axes = grid[i][column]
                _truth(axes, t, rollouts.q_true[which, :, i])
                axes.plot(t, rollouts.q[which, :, i], color=style.colour, lw=1.2)
                _frame(axes, rollouts.q_true[which, :, i], rollouts.q[which, :, i])
            grid[0][column].set_title(
                f"{name} of {len(order)}: pose MSE {error[which].item():.2g}", color="#333333"
            )
            grid[-1][column].set_xlabel("time [s]")
        for i in range(n):
            grid[i][0].set_ylabel(axis_label(rollouts.coordinates, i))
        _legend(figure, style)
    return figure


def energy(rollouts: Rollouts, style: Look, title: str) -> Figure:
    """The true system's energy of the predicted states, and its distance from the start's."""
    which, t = median(rollouts), _times(rollouts)
    initial = rollouts.energy_true[:, :1]
    # a logarithm knows no zero, and its axis no more than this
    error = (rollouts.energy - initial).abs().clamp(1e-16, 1e30)
    drift = (rollouts.energy_true - initial).abs().clamp(1e-16, 1e30)
    with _figure(f"{title}: energy of the predicted states", 8.0, 5.4) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        _truth(top, t, rollouts.energy_true[which])
        top.plot(t, rollouts.energy[which], color=style.colour, lw=1.2)
        spread = (rollouts.energy_true.max() - rollouts.energy_true.min()).item()
        _frame(top, rollouts.energy_true[which], rollouts.energy[which], scale=spread)
        top.set_ylabel("energy $E$ [J]")
        top.set_title("rollout of median pose error")

        bottom.plot(t, error.T, color=style.colour, lw=0.5, alpha=0.35)
        bottom.plot(t, error.nanmedian(0).values, color=style.colour, lw=1.8)
        bottom.plot(t, drift.median(0).values, color=TRUTH.colour, lw=1.2, ls=(0, (4, 2)))
        bottom.set_yscale("log")
        bottom.set_ylabel(r"$|E - E_0|$ [J]")
        bottom.set_xlabel("time [s]")
        bottom.set_title(
            "all rollouts, their median, and (dashed) what the ground truth itself loses"
        )
        _legend(figure, style)
    return figure


def phase_portrait(rollouts: Rollouts, style: Look, title: str) -> Figure:
    """All rollouts in the phase plane of every coordinate, truth beside prediction.

    Angles are wrapped to (−π, π].
    """
    n = rollouts.coordinates.n
    sides = (
        (TRUTH, rollouts.q_true, rollouts.v_true),
        (style, rollouts.q, rollouts.v),
    )
    with _figure(f"{title}: phase portrait", 8.4, 0.9 + 3.2 * n) as figure:
        grid = figure.subplots(n, 2, sharex="row", sharey="row", squeeze=False)
        for i in range(n):
            for axes, (side, q, v) in zip(grid[i], sides, strict=True):
                for path, speed in zip(q[..., i], v[..., i], strict=True):
                    x, y = path.numpy(), speed.numpy()
                    if rollouts.coordinates.angular[i]:
                        x, y = _wrapped(x, y)
                    axes.plot(x, y, color=side.colour, lw=0.7, alpha=0.6)
                    axes.plot(x[0], y[0], "o", color=side.colour, ms=2.5)
                axes.set_xlabel(axis_label(rollouts.coordinates, i))
                if i == 0:
                    axes.set_title(side.label, color=side.colour, fontweight="bold")
                if rollouts.coordinates.angular[i]:
                    axes.set_xticks([-np.pi, 0, np.pi], ["−π", "0", "π"])
            grid[i][0].set_ylabel(axis_label(rollouts.coordinates, i, velocity=True))
            _frame(grid[i][0], rollouts.v_true[..., i], rollouts.v[..., i])
            if not rollouts.coordinates.angular[i]:
                _frame(grid[i][0], rollouts.q_true[..., i], rollouts.q[..., i], "x")
    return figure


@torch.no_grad()
def learned_quantities(
    model: Model, system: System, rollouts: Rollouts, style: Look, title: str
) -> Figure:
    """Energies and inertia, learned and true, along one true motion.

    A potential is known up to a constant: the learned one is shifted by its mean difference from
    the truth along this motion. Nothing else is aligned: a known input fixes the scale of a
    Lagrangian.
    """
    model = model.for_evaluation()
    assert model.lagrangian is not None
    which = median(rollouts)
    nodes = min(rollouts.q.shape[1], 1 + round(LEARNED_SECONDS / rollouts.time_step))
    t = _times(rollouts)[:nodes]
    q, v = rollouts.q_true[which, :nodes], rollouts.v_true[which, :nodes]
    q_, v_ = q.to(model.input_matrix), v.to(model.input_matrix)
    found = model.lagrangian
    potential, true_potential = found.potential(q_).cpu(), system.potential(q)
    offset = (potential - true_potential).mean()
    inertia, true_inertia = found.mass_matrix(q_).cpu(), system.mass_matrix(q)
    panels = {
        "kinetic energy $T$ [J]": (found.kinetic(q_, v_).cpu(), system.kinetic(q, v)),
        f"potential energy $V$ [J]  (shifted by {-offset.item():+.3g} J)": (
            potential - offset,
            true_potential,
        ),
        "total energy $T + V$ [J]  (shifted likewise)": (
            found.energy(q_, v_).cpu() - offset,
            system.energy(q, v),
        ),
    }
    names = rollouts.coordinates.names
    for i in range(len(names)):
        for j in range(i, len(names)):
            unit = "kg" + " m" * (rollouts.coordinates.angular[i] + rollouts.coordinates.angular[j])
            unit = unit.replace(" m m", " m²")
            panels[f"inertia $H_{{{i + 1}{j + 1}}}$ [{unit}]"] = (
                inertia[:, i, j],
                true_inertia[:, i, j],
            )
    swing = (true_potential.max() - true_potential.min()).item()
    columns = 2 if len(panels) in (2, 4) else 3
    rows = -(-len(panels) // columns)
    with _figure(f"{title}: learned quantities along a true motion", 11.0, 1.2 + 2.3 * rows) as f:
        grid = f.subplots(rows, columns, sharex=True, squeeze=False).flatten()
        for axes, (name, (learned, true)) in zip(grid, panels.items(), strict=False):
            _truth(axes, t, true)
            axes.plot(t, learned, color=style.colour, lw=1.2)
            _frame(axes, true, learned, scale=swing if "total" in name else None)
            axes.set_title(name)
        for axes in grid[len(panels) :]:
            axes.remove()
        for axes in grid[max(0, len(panels) - columns) : len(panels)]:
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
        _legend(f, style)
    return f


@contextmanager
def _figure(title: str, width: float, height: float) -> Iterator[Figure]:
    with matplotlib.rc_context(RC):  # type: ignore[arg-type]
        figure = Figure(figsize=(width, height))
        figure.suptitle(
            title, x=0.1 / width, y=1 - 0.1 / height, ha="left", va="top", fontsize=12,
            fontweight="bold",
        )  # fmt: skip
        # margins in inches; Matplotlib's own layout costs as much as the drawing
        figure.subplots_adjust(
            left=0.75 / width, right=1 - 0.15 / width, top=1 - 0.75 / height, bottom=0.55 / height,
            wspace=0.24, hspace=0.34,
        )  # fmt: skip
        yield figure


def _truth(axes: Axes, t: Tensor, values: Tensor) -> None:
    """The truth lies below, wide and pale, so that a prediction on top of it is seen as such."""
    axes.plot(t, values, color=TRUTH.colour, lw=3.2, alpha=0.35)


def _legend(figure: Figure, style: Look) -> None:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=TRUTH.colour, lw=3.2, alpha=0.35),
        Line2D([], [], color=style.colour, lw=1.6),
    ]
    figure.legend(lines, [TRUTH.label, style.label], loc="upper right", ncols=2, borderaxespad=0.6)


def _frame(
    axes: Axes, true: Tensor, predicted: Tensor, which: str = "y", scale: float | None = None
) -> None:
    """Keep the truth readable when a prediction runs away, and say where it went.

    Beyond the truth, at most ``scale`` is shown on either side: as much again as the truth's
    range or, for a quantity that hardly varies, its size.
    """
    low, high = true.min().item(), true.max().item()
    scale = scale or max(high - low, abs(low), abs(high)) or 1.0
    finite = predicted[torch.isfinite(predicted)]
    reached = [*finite.aminmax()] if len(finite) else [true.min(), true.max()]
    bottom = max(low - scale, min(low, reached[0].item()))
    top = min(high + scale, max(high, reached[1].item()))
    margin = 0.06 * max(top - bottom, 0.02 * scale)
    if which == "x":
        axes.set_xlim(bottom - margin, top + margin)
        return
    axes.set_ylim(bottom - margin, top + margin)
    if not ((predicted > bottom - margin) & (predicted < top + margin)).any():
        middle = finite.median().item() if len(finite) else math.nan
        text = f"prediction off the scale: around {middle:.3g}"
        axes.text(
            0.5, 0.9, text, transform=axes.transAxes, ha="center", color="#777777", fontsize=8
        )


def _wrapped(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles in (−π, π], with a gap instead of a line across where they jump."""
    x = np.where(np.isfinite(x), x, np.nan)
    wrapped = np.pi - np.mod(np.pi - x, 2 * np.pi)
    jumps = 1 + np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi)
    return np.insert(wrapped, jumps, np.nan), np.insert(y, jumps, np.nan)


def _times(rollouts: Rollouts) -> Tensor:
    return rollouts.time_step * torch.arange(rollouts.q.shape[1], dtype=torch.float64)
