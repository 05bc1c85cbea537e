"""Remarks on recordings: what their user may have overlooked, a line each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from symo_exp.data.advice import Columns, omitting
from symo_exp.data.folds import moves
from symo_exp.data.naming import is_no_force
from symo_exp.data.paths import few
from symo_exp.data.sensors import noise_of
from symo_exp.data.table import Recording
from symo_exp.data.velocities import contradicting_velocities
from symo_exp.data.weak import ROUNDING
from symo_exp.identify.circles import circle_of
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.recorded import matrix_setting, without_unit

TOGETHER, SMALL = 3.0, 0.1
"""Distance of two coordinates in a constant ratio over their noise, and over their motion, up to
which they are one."""
GEARED = 5.0
"""Ratio of two angles, or its inverse, from which an elastic gear seems to join them."""


class Remarks:
    """Remarks on the coordinates and inputs of recordings.

    Args:
        recordings: Those for training and validation, angles in radians.
        space: The coordinates.
        inputs: Names of the inputs.
        header: All names of the table.
        columns: As ``data.columns``.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        space: Coordinates,
        inputs: Sequence[str],
        header: Sequence[str],
        columns: Columns | None,
    ) -> None:
        self._recordings, self._space = recordings, space
        self._inputs, self._header, self._columns = inputs, header, columns
        # values of each length and angle in each recording
        every = zip(*(one.samples.q.T for one in recordings), strict=True)
        self._measured = dict(zip(space.flat, every, strict=False))
        self._still = [name for name, columns in self._measured.items() if not moves(columns)]
        self._angles = {n for n, angle in zip(space.flat, space.angular, strict=False) if angle}

    def on_coordinates(self) -> list[str]:
        """Return remarks on coordinates that never move, or depend on others."""
        return [*self._on_still_ones(), *self._on_ratios(), *self.on_circles()]

    def _on_still_ones(self) -> Iterator[str]:
        """Yield a line on lengths and angles that never move, if others or a rotation do."""
        if 0 < len(self._still) < self._recordings[0].samples.q.shape[1]:
            told = "never moves" if len(self._still) == 1 else "never move"
            yield (
                f"{few([f'q_{name}' for name in self._still])} {told} by more than noise; for a "
                f"model without such a coordinate, give {self._omitting(self._still, 'qvu')}"
            )

    def _omitting(self, coordinates: Sequence[str], kinds: str) -> str:
        """Return the setting that leaves out the columns of coordinates, of those ``kinds``."""
        every = [f"{kind}_{name}" for kind in kinds for name in coordinates]
        return omitting([name for name in every if name in self._header], self._columns)

    def _on_ratios(self) -> Iterator[str]:
        """Yield lines on lengths and angles that are, or nearly are, in a constant ratio."""
        about = {
            name: np.concatenate([x - x.mean() for x in columns])
            for name, columns in self._measured.items()
            if name not in self._still
        }
        found: dict[str, str] = {}
        through: dict[str, tuple[str, float]] = {}  # the coordinate that moves another, the ratio
        for one, other in itertools.combinations(about, 2):
            if other in found:
                continue
            x, y = about[one], about[other]
            ratio = float(x @ y / (x @ x))
            apart = float(np.std(y - ratio * x))
            noise = math.hypot(self._noise(other), ratio * self._noise(one))
            if apart > SMALL * float(np.std(y)):
                continue
            if apart <= TOGETHER * noise + ROUNDING * float(np.ptp(y)):
                found[other] = f"q_{other} is {ratio:.3g} times q_{one}"
                through[other] = one, ratio
            elif {one, other} <= self._angles and abs(math.log(abs(ratio))) > math.log(GEARED):
                fast, times = (other, ratio) if abs(ratio) > 1.0 else (one, 1 / ratio)
                yield (
                    f"q_{other} is nearly {ratio:.3g} times q_{one}: an elastic gear seems to join "
                    f"them; divide q_{fast} by its ratio, about {times:.3g}, in the file, and "
                    "multiply a torque on it, since angles that turn so fast need a small time step"
                )
        if found:
            mend = self._omitting(list(found), "qv") + self._driving(through)
            yield (
                f"{few(list(found.values()))}, but for noise: a gear joins them, or one is what "
                f"the other should be; for a model without such a coordinate, give {mend}"
            )

    def _driving(self, through: Mapping[str, tuple[str, float]]) -> str:
        """Return the setting by which inputs of coordinates left out act on those that move them.

        Nothing if there are no such inputs, or if inputs have other names than coordinates.

        Args:
            through: By coordinate left out: the one that moves it, and its ratio to that one.
        """
        flat, inputs = self._space.flat, [*map(without_unit, self._inputs)]
        places = {without_unit(name): name for name in flat}
        if self._space.rotations or not set(inputs) <= places.keys():
            return ""
        acting = [through.get(places[name], (places[name], 1.0)) for name in inputs]
        if all(ratio == 1.0 for _, ratio in acting) or any(place in through for place, _ in acting):
            return ""
        kept = [name for name in flat if name not in through]
        rows = [[float(f"{r:.3g}") if place == name else 0 for place, r in acting] for name in kept]
        return f" and {matrix_setting(rows)}, by which inputs act through the gear"

    def on_circles(self) -> Iterator[str]:
        """Yield lines on two lengths that are the place of a point on a link that turns."""
        lengths = [x for x in self._measured if x not in self._angles and x not in self._still]
        for x, y in itertools.combinations(lengths, 2):
            noise = max(self._noise(x), self._noise(y))
            first, second = (np.concatenate(self._measured[name]) for name in (x, y))
            if (found := circle_of(first, second, noise)) is None:
                continue
            digits = 2 - math.floor(math.log10(found.radius))
            a, b = (round(value, digits) + 0.0 for value in (found.x, found.y))
            yield (
                f"q_{x} and q_{y} lie on a circle of radius {found.radius:.3g} around a = {a:g}, "
                f"b = {b:g}: if they are the place of a point on a link that turns, replace them "
                f"in the file by its angle, numpy.unwrap(numpy.arctan2({y} - b, {x} - a))"
            )

    def _noise(self, name: str) -> float:
        return noise_of(self._measured[name])

    def on_velocities(self) -> list[str]:
        """Return lines on velocities in another unit or direction than lengths and angles."""
        samples = [one.samples for one in self._recordings]
        with np.errstate(all="ignore"):  # values that overflow
            return list(contradicting_velocities(self._space, samples, self._columns))

    def on_idle_inputs(self) -> Iterator[str]:
        """Yield lines on inputs that are always zero, and on others that never change."""
        every = np.concatenate([one.samples.u for one in self._recordings])
        columns = {f"u_{name}": x for name, x in zip(self._inputs, every.T, strict=True)}
        still = [name for name, x in columns.items() if np.ptp(x) == 0.0]
        idle = [name for name in still if not columns[name].any()]
        constant = [name for name in still if columns[name].any()]
        for found, told in ((idle, "always zero;"), (constant, "constant; if nothing acts,")):
            are, them = ("is", "it") if len(found) == 1 else ("are", "them")
            if found:
                mend = omitting(found, self._columns)
                yield f"{few(found)} {are} {told} leave {them} out by {mend}"

    def on_units_of_inputs(self) -> Iterator[str]:
        """Yield a line on inputs that are neither in N m nor in N, as their names say."""
        given = self._columns or {}
        written = [str(given.get(f"u_{name}") or f"u_{name}") for name in self._inputs]
        if odd := [name for name in written if is_no_force(name)]:
            yield (
                f"inputs, {few(odd)}, are used as they are: where results say N, N m or kg, they "
                "are in proportion to the unit of the input; multiply it in the file by the force "
                "or torque of one unit for results in SI units"
            )
