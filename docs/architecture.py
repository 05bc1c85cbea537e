"""Draw the packages and who imports whom, from the sources, as the tests read them."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from tests.architecture import graph

LIGHTS = {"light": ("#1f2933", "#e8eef7", "#8aa0b8"), "dark": ("#e6e9ee", "#263445", "#7288a0")}
"""Text, boxes and arrows on each ground."""


def draw(folder: Path) -> None:
    """``architecture_light.svg`` and ``architecture_dark.svg``."""
    folder.mkdir(exist_ok=True)
    for name, colours in LIGHTS.items():
        picture(*colours).savefig(folder / f"architecture_{name}.svg", transparent=True)


def layers(needs: dict[str, set[str]]) -> dict[str, int]:
    """Each package one above the highest that it imports."""

    def height(package: str) -> int:
        return 1 + max((height(other) for other in needs[package]), default=-1)

    return {package: height(package) for package in needs}


def direct(needs: dict[str, set[str]]) -> dict[str, set[str]]:
    """The imports that do not follow from others: an arrow for each is enough to see all."""

    def reached(package: str) -> set[str]:
        return needs[package].union(*(reached(other) for other in needs[package]))

    return {
        package: {x for x in mine if not any(x in reached(other) for other in mine - {x})}
        for package, mine in needs.items()
    }


def places(needs: dict[str, set[str]]) -> dict[str, tuple[float, float]]:
    """Return the places of the boxes; within a layer each is near those that it imports."""
    at: dict[str, tuple[float, float]] = {}
    rank = layers(needs)
    for y in range(max(rank.values()) + 1):
        row = [package for package in needs if rank[package] == y]

        def below(package: str) -> float:
            xs = [at[other][0] for other in needs[package]]
            return sum(xs) / len(xs) if xs else 0.0

        row.sort(key=below)
        for i, package in enumerate(row):
            at[package] = (i - (len(row) - 1) / 2, float(y))
    return at


def picture(ink: str, ground: str, line: str) -> Figure:
    """A box for each package, an arrow to each that it imports."""
    needs = graph()
    arrows, at = direct(needs), places(needs)
    figure = Figure(figsize=(7.2, 1.0 * (max(y for _, y in at.values()) + 1)))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for package, (x, y) in at.items():
        axes.add_patch(
            FancyBboxPatch(
                (x - 0.36, y - 0.17), 0.72, 0.34, boxstyle="round,pad=0.02",
                facecolor=ground, edgecolor=line, linewidth=1.0, zorder=2,
            )
        )  # fmt: skip
        axes.text(x, y, package, ha="center", va="center", color=ink, fontsize=11, zorder=3)
        for other in arrows[package]:
            end = at[other]
            bend = 0.0 if y - end[1] == 1 else 0.18 * (1 if x >= end[0] else -1)  # beside others
            axes.annotate(
                "", (end[0], end[1] + 0.2), (x, y - 0.2), zorder=1,
                arrowprops={"arrowstyle": "-|>", "color": line, "linewidth": 1.1,
                            "connectionstyle": f"arc3,rad={bend}"},
            )  # fmt: skip
    xs = [x for x, _ in at.values()]
    axes.set(xlim=(min(xs) - 0.6, max(xs) + 0.6), ylim=(-0.4, max(y for _, y in at.values()) + 0.4))
    axes.axis("off")
    return figure
