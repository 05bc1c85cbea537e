"""Names and looks of methods, integrators, measures and numbers in tables and figures.

Methods differ by colour (Okabe and Ito, 2008: safe for the colour-blind) and marker, integrators
by dash.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.mechanics.types import Coordinates

Pair = tuple[str, str]
"""A method and an integrator by their names in the configuration."""


class Look(NamedTuple):
    """Name, colour and marker of a method; the marker is Matplotlib's."""

    label: str
    colour: str
    marker: str = "o"


class Stroke(NamedTuple):
    """Name and dashes of an integrator.

    Args:
        label: The name for a reader.
        dash: Lengths of strokes and gaps [px]; empty for a solid line.
    """

    label: str
    dash: tuple[int, ...] = ()


METHODS = {
    "node": Look("NODE", "#E69F00", "o"),
    "residual": Look("residual network", "#8C564B", "X"),
    "l_node": Look("L-NODE", "#009E73", "s"),
    "symo": Look("SyMo", "#0072B2", "^"),
    "e2e_symo": Look("E2E-SyMo", "#D55E00", "D"),
}
TRUE = {
    "true_ode": Look("true system, explicit", "#8a8a8a", "."),
    "true_variational": Look("true system, variational", "#222222", "."),
}
"""True systems, which are drawn as floors below learned models."""
BASELINES = {
    "constant_velocity": Look("constant velocity", "#8a8a8a", "v"),
    "reference": Look("reference model", "#CC79A7", "P"),
    "noise": Look("noise of the measurement", "#222222", "."),
}
"""Baselines of models of recordings."""
TRUTH = Look("truth", "#3b3b3b", ".")
MEASURED = Look("measured", "#3b3b3b", ".")
SPARE = (("#CC79A7", "v"), ("#56B4E9", "P"), ("#F0E442", "X"))
INTEGRATORS = {
    "": Stroke(""),  # a line through several integrators
    "midpoint": Stroke("midpoint"),
    "refined_midpoint": Stroke("refined midpoint", (3, 3)),
    "rk4": Stroke("RK4", (6, 3)),
    "dopri5": Stroke("Dormand-Prince 5", (6, 2, 1, 2)),
    "galerkin4": Stroke("Galerkin 4", (10, 3)),
    "galerkin6": Stroke("Galerkin 6", (10, 2, 3, 2)),
    "galerkin10": Stroke("Galerkin 10", (2, 2)),
    "none": Stroke(""),
}
MEASURES = {
    "train_mse": ("train MSE", "m², rad²"),
    "test_mse": ("test MSE", "m², rad²"),
    "integration_mse": ("integration MSE", "m², rad²"),
    "integration_mse_100": ("integration MSE, first 100 steps", "m², rad²"),
    "energy_mse": ("energy MSE", "J²"),
    "inertia_mse": ("inertia MSE", "kg², kg² m², kg² m⁴"),
    "inertia_mse_aligned": ("inertia MSE on the true path", "kg², kg² m², kg² m⁴"),
    "valid_steps": ("valid", "steps"),
    "rmse_0.5s": ("RMSE to 0.5 s, median window", "m, rad"),
    "rmse_1s": ("RMSE to 1 s, median window", "m, rad"),
    "rmse_2s": ("RMSE to 2 s, median window", "m, rad"),
    "valid_s": ("valid time", "s"),
    "energy_mse_fd": ("energy MSE, finite differences", "J²"),
    "training_seconds": ("training", "s"),
    "test_relative": ("one-step error over motion", ""),
    "step_ms": ("optimiser step", "ms"),
    "peak_memory": ("peak memory", "MiB"),
}
"""Label and unit of each measure; others are named by their key.

The first of several units is that of lengths, the last that of angles.
"""
RC: dict[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 9, "axes.titlesize": 9.5,
    "axes.titlelocation": "left", "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": "#888888", "axes.linewidth": 0.8, "axes.labelcolor": "#333333",
    "axes.grid": True, "grid.color": "#e6e6e6", "grid.linewidth": 0.6, "xtick.color": "#555555",
    "ytick.color": "#555555", "legend.frameon": False, "lines.solid_capstyle": "round",
    "figure.dpi": 120,
}  # fmt: skip
GREEK = dict(
    zip(
        ["alpha", "beta", "gamma", "delta", "theta", "phi", "psi", "omega"], "αβγδθφψω", strict=True
    )
)


def look(method: str) -> Look:
    """Return the look of a method; an unknown one has a spare look chosen by its name."""
    known = METHODS | TRUE | BASELINES
    return known.get(method) or Look(method, *SPARE[sum(method.encode()) % len(SPARE)])


def stroke(integrator: str) -> Stroke:
    """Return the dash of an integrator; an unknown one is dotted."""
    return INTEGRATORS.get(integrator, Stroke(integrator, (1, 2)))


def pair_name(method: str, integrator: str) -> str:
    """Return the name of a method with its integrator."""
    return ", ".join(filter(None, (look(method).label, stroke(integrator).label)))


def pair_names(rows: pd.DataFrame) -> list[str]:
    """Return the name of the method with its integrator for each row."""
    return [pair_name(*pair) for pair in zip(rows.method, rows.integrator, strict=True)]


def in_order(pair: Pair) -> tuple[int, str, int, str]:
    """Return a sort key: methods, then integrators in the order above, unknown ones last."""
    places = (list(METHODS | TRUE), list(INTEGRATORS))
    at = [p.index(x) if x in p else len(p) for x, p in zip(pair, places, strict=True)]
    return at[0], pair[0], at[1], pair[1]


def all_angles(names: Iterable[str], values: Iterable[float]) -> bool | None:
    """Return whether all coordinates of runs are angles, by the names and values of their measures.

    ``None`` if only some are, or the measures do not say it.
    """
    found: dict[str, list[float]] = {"coordinates": [], "angles": []}
    for name, value in zip(names, values, strict=True):
        if name in found:
            found[name].append(value)
    every, turning = found.values()
    if not turning or len(every) != len(turning) or 0 < sum(turning) < sum(every):
        return None
    return sum(turning) > 0


def label_and_unit(metric: str, angular: bool | None = None) -> tuple[str, str]:
    """Return the label of a measure, and its unit or units, separated by commas.

    Args:
        metric: The measure.
        angular: Whether all coordinates are angles, ``None`` if only some are or it is not known.
    """
    label, units = MEASURES.get(metric, (metric.replace("_", " "), ""))
    return label, units if angular is None else units.split(", ")[-1 if angular else 0]


def measure_name(metric: str, angular: bool | None = None) -> str:
    """Return the label of a measure with its unit, if it has one unit."""
    label, unit = label_and_unit(metric, angular)
    return f"{label} [{unit}]" if unit and "," not in unit else label


def unit(metric: str, angular: bool | None = None) -> str:
    """Return the label of an axis below a title that names the measure."""
    _, unit = label_and_unit(metric, angular)
    return f"[{unit}]" if unit else ""


def short(x: float | None) -> str:
    """Return a measure as tables print it, with a dash for a missing one."""
    if x is None or math.isnan(x):
        return "–"
    if math.isinf(x):
        return "diverged" if x > 0 else "-∞"
    return written(x)


def written(x: float) -> str:
    """Return a number with three digits: ``1.38e-4``, ``0.498``, ``38.6``."""
    if x == 0 or not math.isfinite(x) or 1e-2 <= abs(x) < 1e3:
        return f"{x:.3g}"
    digits, exponent = f"{x:.2e}".split("e")
    return f"{digits}e{int(exponent)}"


def duration(seconds: float) -> str:
    """Return a duration in a suitable unit: ``0.26 s``, ``80 s``, ``4 h``."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s" if seconds >= 10.0 else f"{seconds:.2g} s"


def number(x: float) -> str:
    """Return the value of a setting, with a dash for a missing one."""
    return "–" if math.isnan(x) else f"{x:g}"


def symbol(name: str) -> str:
    """Return the symbol of a coordinate: θ₁ for ``theta_1``."""
    found = re.fullmatch(rf"({'|'.join(GREEK)}|[a-zA-Z])_?(\d*)", name)
    if found is None:
        return name
    digits = found[2].translate(str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉"))
    return GREEK.get(found[1], found[1]) + digits


def axis_label(name: str, *, velocity: bool = False, angular: bool | None = None) -> str:
    """Return the symbol of a coordinate or of its velocity with its SI unit.

    Args:
        name: The name of the coordinate.
        velocity: Whether the label is of the velocity.
        angular: Whether the coordinate is an angle; by its name if not given.
    """
    label = symbol(name)
    if velocity:
        label = f"d{' ' * (len(label) > len('θ₁₂'))}{label}/dt"
    return f"{label} [{', '.join(unit + '/s' * velocity for unit in unit_choices(name, angular))}]"


TURNS, RATES = ("roll", "pitch", "yaw"), ("ω_x", "ω_y", "ω_z")
"""The angles that show a rotation, and its body rates."""


def coordinate_labels(coordinates: Coordinates, *, velocity: bool = False) -> list[str]:
    """Return the labels of all coordinates or velocities; of rotations, roll, pitch and yaw."""
    flat, words = len(coordinates.flat), RATES if velocity else TURNS
    plain = zip(coordinates.flat, coordinates.angular[:flat], strict=True)
    labels = [axis_label(name, velocity=velocity, angular=turns) for name, turns in plain]
    unit = "rad/s" if velocity else "rad"
    return labels + [f"{w} of {name} [{unit}]" for name in coordinates.rotations for w in words]


def inertia_unit(row: tuple[str, bool | None], column: tuple[str, bool | None]) -> str:
    """Return the unit of an entry of the mass matrix.

    Args:
        row: The name of the coordinate of its row, and whether it is an angle; by its name if
            ``None``.
        column: The same of its column.
    """
    units = [unit_choices(*coordinate) for coordinate in (row, column)]
    if any(len(one) > 1 for one in units):
        return "kg, kg m, kg m²"
    return ("kg", "kg m", "kg m²")[units.count(("rad",))]


def unit_choices(name: str, angular: bool | None) -> tuple[str, ...]:
    """Return the possible units of a coordinate.

    Args:
        name: Its name: Greek ones are those of angles, x, y and z those of lengths.
        angular: Whether it is an angle; by its name if ``None``.
    """
    if angular is None:
        plain = re.sub(r"_?\d*$", "", name)
        return ("rad",) if plain in GREEK else ("m",) if plain in ("x", "y", "z") else ("m", "rad")
    return ("rad",) if angular else ("m",)
