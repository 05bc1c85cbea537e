"""Figures of studies: motions over time, phase spaces, what was learned, drift."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from symo_exp.report.charts import Chart, Panel, Series
from symo_exp.report.labels import Pair, pair_name, systems_in_order
from symo_exp.report.studied import Studied
from symo_exp.report.style import symbol

POINTS = 600
"""Of a line at most: more are not seen, and weigh on the page."""
NUMBERS = {
    ("long_term", "pendulum"): "6.4", ("test_trajectory", "acrobot"): "6.10 and 6.11",
    ("test_trajectory", "cartpole"): "6.15 and 6.16", ("forced", "pendulum"): "6.6 and 6.7",
    ("forced_fast", "cartpole"): "6.18", ("learned_quantities", "pendulum"): "6.5",
    ("learned_quantities", "acrobot"): "6.12", ("learned_quantities", "cartpole"): "6.17",
}  # fmt: skip
TITLES = {
    "long_term": "a long motion without input",
    "test_trajectory": "a motion without input",
    "forced": "a motion under a sinusoidal input of 10 s",
    "forced_fast": "a motion under a sinusoidal input of 2 s",
}
TRUTH: Pair = ("truth", "")
FIRST = "Each method's run of the lowest seed, from the same start; the first of its motions."


def charts(found: Sequence[Studied]) -> list[Chart]:
    """All figures of studies, in the order of the studies."""
    made = []
    for one in found:
        if one.study in TITLES:
            made.append(_motion(one))
        if one.study == "long_term":
            made.append(_phase_space(one))
        if one.study == "learned_quantities":
            made.append(_learned(one))
    return [*made, *_drift([one for one in found if one.study == "drift"])]


def _motion(one: Studied) -> Chart:
    """Every coordinate over time, the squared error of the pose, and the energy."""
    names = _coordinates(one)
    seconds = 50.0 if one.study == "long_term" else np.inf
    rows = {pair: _first(table, seconds) for pair, table in one.tables.items()}
    panels = []
    for name in names:
        lines = [_line(pair, table, table[f"q_{name}"]) for pair, table in rows.items()]
        panels.append(_over_time(_plain(symbol(name)), [_truth(rows, f"q_true_{name}"), *lines]))
    errors = []
    for pair, table in rows.items():
        found, true = (table[[f"{field}_{n}" for n in names]] for field in ("q", "q_true"))
        squares = ((found.to_numpy() - true.to_numpy()) ** 2).mean(axis=1)
        errors.append(_line(pair, table, pd.Series(squares)))
    panels.append(_over_time("squared error of the pose", errors, log=True))
    energies = [_line(pair, table, table.energy) for pair, table in rows.items()]
    panels.append(_over_time("energy [J]", [_truth(rows, "energy_true"), *energies]))
    return Chart(
        key=f"{one.study}_{one.system}",
        title=f"{one.system}: {TITLES[one.study]}",
        caption=FIRST,
        panels=[_bounded(panel) for panel in panels],
        number=NUMBERS.get((one.study, one.system), ""),
    )


def _phase_space(one: Studied) -> Chart:
    """A panel for each method, the truth under it."""
    name = _coordinates(one)[0]
    panels = []
    for pair, table in one.tables.items():
        mine = _first(table)
        under = _wrapped(mine[f"q_true_{name}"], mine[f"v_true_{name}"])
        over = _wrapped(mine[f"q_{name}"], mine[f"v_{name}"])
        series = [
            Series(*TRUTH, *under, source="truth", points=True, name="truth"),
            Series(*pair, *over, points=True),
        ]
        label = _plain(symbol(name))
        panels.append(_bounded(Panel(pair_name(*pair), label, f"d{label}/dt", series, y_log=False)))
    return Chart(
        key=f"{one.study}_{one.system}_phase_space",
        title=f"{one.system}: phase space over {len(mine)} steps",
        caption=FIRST + " Angles are wrapped.",
        panels=panels,
        number="6.3" if one.system == "pendulum" else "",
    )


def _learned(one: Studied) -> Chart:
    rows = {pair: _first(table) for pair, table in one.tables.items()}
    columns = next(iter(rows.values())).columns
    panels = []
    for column in columns:
        if f"{column}_true" not in columns:
            continue
        title = (
            f"inertia H{column[-2:]}" if column.startswith("inertia") else f"{column} energy [J]"
        )
        lines = [_line(pair, table, table[column]) for pair, table in rows.items()]
        panels.append(_over_time(title, [_truth(rows, f"{column}_true"), *lines]))
    return Chart(
        key=f"{one.study}_{one.system}",
        title=f"{one.system}: what was learned, along a true motion",
        caption=FIRST + " Potentials are shifted by a constant each.",
        panels=panels,
        number=NUMBERS.get((one.study, one.system), ""),
    )


def _drift(found: Sequence[Studied]) -> Iterable[Chart]:
    """The true systems over small and large steps: energy lost, and volume of phase space."""
    for system in systems_in_order({one.system for one in found}):
        steps = sorted((one for one in found if one.system == system), key=lambda x: x.time_step)
        energies, volumes = [], []
        for one in steps:
            rows = {pair: _first(table) for pair, table in one.tables.items()}
            lost = [
                _line(pair, table, (table.energy - table.energy_true).abs())
                for pair, table in rows.items()
            ]
            kept = [_line(pair, table, np.exp(table.log_volume)) for pair, table in rows.items()]
            energies.append(
                _over_time(f"energy error [J], step {one.time_step:g} s", lost, log=True)
            )
            volumes.append(_over_time(f"phase-space volume, step {one.time_step:g} s", kept))
        yield Chart(
            key=f"drift_{system}",
            title=f"{system}: the true system in integrators, small steps and large",
            caption="Above: distance of the energy from the start's. Below: a small volume around "
            "the start, carried along; a symplectic integrator keeps it.",
            panels=[_bounded(panel) for panel in (*energies, *volumes)],
            number={"pendulum": "3.1", "acrobot": "1.2", "cartpole": "1.2"}.get(system, ""),
        )


def _coordinates(one: Studied) -> list[str]:
    columns = next(iter(one.tables.values())).columns
    return [c.removeprefix("q_true_") for c in columns if c.startswith("q_true_")]


def _first(table: pd.DataFrame, seconds: float = np.inf) -> pd.DataFrame:
    return table[(table.trajectory == 0) & (table.t <= seconds)]


def _line(pair: Pair, table: pd.DataFrame, values: pd.Series) -> Series:
    stride = max(1, len(table) // POINTS)
    return Series(*pair, list(table.t[::stride]), list(values[::stride]), lined=True)


def _truth(rows: dict[Pair, pd.DataFrame], column: str) -> Series:
    table = next(iter(rows.values()))
    line = _line(TRUTH, table, table[column])
    return Series(*TRUTH, line.x, line.y, source="truth", lined=True, name="truth")


def _over_time(title: str, series: Sequence[Series], *, log: bool = False) -> Panel:
    return Panel(title, "time [s]", title, list(series), y_log=log)


def _bounded(panel: Panel) -> Panel:
    """Linear axes follow the truth: what leaves it far is cut off, not everything squeezed."""
    if panel.y_log:
        return panel
    inside = [y for s in panel.series for y in s.y if s.source == "truth" and np.isfinite(y)]
    if not inside:
        return panel
    low, high = min(inside), max(inside)
    # A truth that is constant, an energy, has a spread of rounding errors only.
    room = max(0.5 * (high - low), 0.1 * max(abs(low), abs(high))) or 1.0
    everything = [y for s in panel.series for y in s.y if np.isfinite(y)]
    bounds = (max(low - room, min(everything)), min(high + room, max(everything)))
    edge = 0.04 * (bounds[1] - bounds[0]) or 1.0
    return panel.within(bounds[0] - edge, bounds[1] + edge)


def _wrapped(angle: pd.Series, speed: pd.Series) -> tuple[list[float], list[float]]:
    stride = max(1, len(angle) // (2 * POINTS))
    wrapped = np.pi - np.mod(np.pi - angle.to_numpy(dtype=float), 2 * np.pi)
    return list(wrapped[::stride]), list(speed[::stride])


def _plain(name: str) -> str:
    """Symbols without TeX, which the page does not read."""
    letters = {r"\theta": "θ", r"\phi": "φ", r"\alpha": "α", r"\beta": "β", "$": "", "_": ""}
    for tex, letter in letters.items():
        name = name.replace(tex, letter)
    return name.replace("{", "").replace("}", "")
