"""Measurements as Markdown, beside their aims."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One cell: milliseconds of one call (median, quartiles), and Newton iterations at most."""

    measure: str
    system: str
    method: str
    batch: int
    contender: str
    ms: float
    low: float
    high: float
    iterations: int | None


NAMES = {"e2e_symo": "E2E-SyMo", "l_node": "L-NODE RK4", "symo": "SyMo", "node": "NODE RK4"}

TARGETS: dict[str, dict[int, float]] = {
    "e2e_symo": {32: 6.0, 128: 5.0, 512: 4.0},
    "l_node": {32: 5.0, 128: 4.0, 512: 3.0},
    "symo": {32: 4.0, 128: 2.5, 512: 1.8},
    "node": {32: 3.0, 128: 2.2, 512: 1.9},
}
"""Steps: times faster than the double-autograd baseline, at least."""

PEER_TARGETS = {32: 1.5, 128: 1.1, 512: 1.0}
"""Steps: time relative to JAX, at most."""

OVERHEAD_TARGET = 1.1
"""`fit` per step relative to the bare step at batch 128, at most."""

ROLLOUT_TARGET = 2000.0
"""16 x 500 rollout steps [ms], at most."""

Key = tuple[str, str, str, int, str]


def report(rows: Sequence[Row], *, machine: str, worst_gradient: float) -> str:
    """The whole page."""
    found: dict[Key, Row] = {(r.measure, r.system, r.method, r.batch, r.contender): r for r in rows}
    systems = list(dict.fromkeys(r.system for r in rows))
    parts = [
        "# Benchmark",
        machine + ". Medians of interleaved rounds; before timing, all implementations computed "
        f"the same loss and gradient (to {worst_gradient:.0e} of float64). Weights are those of "
        "E2E-SyMo after 2000 steps of a training.",
        "(a) double autograd in PyTorch, (b) the same maths in `jax.jit`.",
        "## Targets",
        targets(found, systems),
    ]
    for measure, title in (
        ("step", "Optimiser step [ms]"),
        ("evaluation", "One-step prediction of the rows [ms]"),
        (
            "rollout",
            f"Rollouts of 500 steps, all rows [ms] (≤ {ROLLOUT_TARGET:g} wanted; (a) extrapolated "
            "from one row)",
        ),
    ):
        parts += [f"## {title}", comparison(found, measure)]
    parts += ["## Fit: the whole `Trainer.fit`, per optimiser step [ms]", overhead(found)]
    parts += ["## E2E-SyMo steps where training starts, 32 rows [ms]", hard(rows)]
    return "\n\n".join(parts) + "\n"


def table(header: Iterable[str], lines: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    header = list(header)
    out = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return "\n".join(out + ["| " + " | ".join(line) + " |" for line in lines])


def ms(row: Row | None) -> str:
    """A time and, where roots are found, the iterations of its slowest row."""
    if row is None:
        return "–"
    text = f"{row.ms:.3g}" if row.ms < 1000 else f"{row.ms:.0f}"
    return text if row.iterations is None else f"{text} ({row.iterations})"


def ratio(over: Row | None, under: Row | None) -> str:
    """Return a ratio as text."""
    return "–" if over is None or under is None else f"{over.ms / under.ms:.2f}"


def targets(found: dict[Key, Row], systems: list[str]) -> str:
    """Medians over systems beside the aims."""
    lines = []

    def line(
        title: str, aim: dict[int, float], cell: Callable[[str, int], float | None], *, least: bool
    ) -> None:
        texts = [title]
        for batch, wanted in aim.items():
            values = [x for x in (cell(s, batch) for s in systems) if x is not None]
            if not values:
                texts.append("–")
                continue
            got = statistics.median(values)
            met = got >= wanted if least else got <= wanted
            texts.append(
                f"{got:.2f} ({'≥' if least else '≤'} {wanted:g}{'' if met else ', missed'})"
            )
        lines.append(texts)

    def compare(method: str, over: str, under: str) -> Callable[[str, int], float | None]:
        def cell(system: str, batch: int) -> float | None:
            a = found.get(("step", system, method, batch, over))
            b = found.get(("step", system, method, batch, under))
            return None if a is None or b is None else a.ms / b.ms

        return cell

    kinds = {"project": "eager", "compiled": "compiled"}
    for method, aim in TARGETS.items():
        for ours, kind in kinds.items():
            title = f"{NAMES[method]} step, {kind}: times faster than (a)"
            line(title, aim, compare(method, "autograd", ours), least=True)
    for method in TARGETS:
        for ours, kind in kinds.items():
            title = f"{NAMES[method]} step, {kind}: time relative to (b)"
            line(title, PEER_TARGETS, compare(method, ours, "jax"), least=False)
    return table(["reached (wanted)", *map(str, PEER_TARGETS)], lines)


def comparison(found: dict[Key, Row], measure: str) -> str:
    """Every cell of one measure; iterations of Newton's method in brackets."""
    keys = dict.fromkeys(k[1:4] for k in found if k[0] == measure)
    lines = []
    for system, method, batch in keys:
        a, b, p, c = (
            found.get((measure, system, method, batch, name))
            for name in ("autograd", "jax", "project", "compiled")
        )
        times = (ms(x) for x in (a, b, p, c))
        ratios = (ratio(a, p), ratio(p, b), ratio(a, c), ratio(c, b))
        lines.append([system, NAMES[method], str(batch), *times, *ratios])
    header = ["system", "method", "rows", "(a)", "(b)", "project", "compiled"]
    header += ["(a)/project", "project/(b)", "(a)/compiled", "compiled/(b)"]
    return table(header, lines)


def overhead(found: dict[Key, Row]) -> str:
    """Return the overhead of the framework over the steps."""
    lines = []
    for key, fit in found.items():
        if key[0] == "fit":
            bare = found[("bare", *key[1:])]
            lines.append([fit.system, NAMES[fit.method], ms(bare), ms(fit), ratio(fit, bare)])
    return table(["system", "method", "bare step", "fit", f"ratio (≤ {OVERHEAD_TARGET})"], lines)


def hard(rows: Sequence[Row]) -> str:
    """Per-row stopping beside the whole-batch rule; iterations of the slowest row in brackets."""
    lines = [[r.system, r.contender, ms(r)] for r in rows if r.measure == "hard rows"]
    return table(["system", "implementation", "step"], lines)
