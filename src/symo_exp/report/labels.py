"""Names of measures, systems, methods and numbers, as tables and figures print them."""

from __future__ import annotations

import math

from symo_exp.report.style import look, stroke

MEASURES = {
    "train_mse": "train MSE",
    "test_mse": "test MSE",
    "integration_mse": "integration MSE",
    "energy_mse": "energy MSE [J²]",
    "inertia_mse": "inertia MSE",
    "integration_mse_100": "integration MSE, first 100 steps",
    "valid_steps": "valid steps",
    "test_mse_state": "test MSE of the state",
    "integration_mse_state": "integration MSE of the state",
    "energy_mse_fd": "energy MSE [J²], finite differences",
    "inertia_mse_aligned": "inertia MSE at the true poses",
    "training_seconds": "training [s]",
}
TABLE = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")
"""The columns of the tables of chapter 6."""
SYSTEMS = ("pendulum", "acrobot", "cartpole")
"""In the order of the thesis; others follow."""
PAIRS = (
    ("node", "midpoint"),
    ("node", "rk4"),
    ("l_node", "midpoint"),
    ("l_node", "rk4"),
    ("symo", "midpoint"),
    ("e2e_symo", "midpoint"),
)
"""In the order of the thesis; others follow."""

Pair = tuple[str, str]


def pair_name(method: str, integrator: str) -> str:
    return f"{look(method).label}, {stroke(integrator).label}"


def measure_name(metric: str) -> str:
    return MEASURES.get(metric, metric.replace("_", " "))


def in_order(pair: Pair) -> tuple[int, Pair]:
    """To sort pairs by: as in the thesis, then by name."""
    return (PAIRS.index(pair) if pair in PAIRS else len(PAIRS), pair)


def systems_in_order(names: set[str]) -> list[str]:
    return sorted(names, key=lambda s: (SYSTEMS.index(s) if s in SYSTEMS else len(SYSTEMS), s))


def short(x: float | None) -> str:
    """Three digits: ``1.38e-4``, ``0.498``, ``38.6``; a dash for what is not there."""
    if x is None or math.isnan(x):
        return "–"
    if math.isinf(x):
        return "diverged" if x > 0 else "-∞"
    if x == 0:
        return "0"
    if 1e-2 <= abs(x) < 1e3:
        return f"{x:.3g}"
    digits, exponent = f"{x:.2e}".split("e")
    return f"{digits}e{int(exponent)}"


def factor(x: float | None) -> str:
    """How many times: ``×2.1``, ``÷830``."""
    if x is None or math.isnan(x):
        return "–"
    if x == 0 or math.isinf(x):
        return "÷∞" if x == 0 else "×∞"
    times, sign = (x, "×") if x >= 1 else (1 / x, "÷")
    if times < 1000:
        return f"{sign}{float(f'{times:.2g}'):g}"
    digits, exponent = f"{times:.1e}".split("e")
    return f"{sign}{digits}e{int(exponent)}"
