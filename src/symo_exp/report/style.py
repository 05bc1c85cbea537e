"""One look for all figures: a colour for each method, colour-blind safe (Okabe and Ito, 2008)."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from symo_exp.mechanics.types import Coordinates


class Look(NamedTuple):
    """How a method is named and drawn."""

    label: str
    colour: str


TRUTH = Look("truth", "#3b3b3b")
METHODS = {
    "node": Look("NODE", "#E69F00"),
    "l_node": Look("L-NODE", "#009E73"),
    "symo": Look("SyMo", "#0072B2"),
    "e2e_symo": Look("E2E-SyMo", "#D55E00"),
}
TRUE = {
    "true_ode": Look("true system, explicit", "#8a8a8a"),
    "true_variational": Look("true system, variational", "#222222"),
}
"""The models that are not learned: drawn as floors under the others."""
SPARE = ("#CC79A7", "#56B4E9", "#F0E442")


class Stroke(NamedTuple):
    """How an integrator is named and drawn: ``dash`` is Matplotlib's, ``web`` Plotly's."""

    label: str
    dash: str
    web: str


INTEGRATORS = {
    "midpoint": Stroke("midpoint", "-", "solid"),
    "": Stroke("", "-", "solid"),  # a line through several integrators
    "rk4": Stroke("RK4", "--", "dash"),
    "dopri5": Stroke("Dormand-Prince 5", "-.", "dashdot"),
    "galerkin4": Stroke("Galerkin 4", "--", "dash"),
    "galerkin6": Stroke("Galerkin 6", "-.", "dashdot"),
}

RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.8,
    "axes.labelcolor": "#333333",
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "figure.dpi": 120,
}


def look(method: str) -> Look:
    """The look of a method; one that has no entry gets a spare colour by its name."""
    known = METHODS | TRUE
    if method in known:
        return known[method]
    return Look(method, SPARE[sum(method.encode()) % len(SPARE)])


def stroke(integrator: str) -> Stroke:
    """The stroke of an integrator; one that has no entry is dotted."""
    return INTEGRATORS.get(integrator, Stroke(integrator, ":", "dot"))


GREEK = "alpha|beta|gamma|delta|theta|phi|psi|omega"


def symbol(name: str, dotted: bool = False) -> str:
    """A coordinate's name as mathematics: ``theta_1`` or ``theta1`` becomes θ₁."""
    found = re.fullmatch(rf"({GREEK}|[a-zA-Z])(?:_?(\d+)|_(\w+))?", name)
    if found is None:
        return f"d/dt {name}" if dotted else name
    letter, index = found[1], found[2] or found[3]
    letter = f"\\{letter}" if len(letter) > 1 else letter
    letter = f"\\dot{{{letter}}}" if dotted else letter
    return f"${letter}_{{{index}}}$" if index else f"${letter}$"


def axis_label(coordinates: Coordinates, i: int, velocity: bool = False) -> str:
    """Symbol and SI unit of a coordinate or of its velocity."""
    unit = ("rad" if coordinates.angular[i] else "m") + ("/s" if velocity else "")
    return f"{symbol(coordinates.names[i], velocity)} [{unit}]"
