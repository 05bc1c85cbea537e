"""When and in which direction the inputs of a machine act, as its motions show it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from symo_exp.data.delays import acting_late
from symo_exp.data.diagnose import HELP
from symo_exp.data.explained import explained_power, input_gains
from symo_exp.data.table import Recording
from symo_exp.identify.sampled import EXAMINED, NODES, Sampled, at_nodes, first_seconds, with_inputs
from symo_exp.mechanics.types import Coordinates

ACTING = "input_delay", "input_lag"
"""Settings of data that say when inputs act."""
DELAYS = np.arange(-4, 7) / 100
"""Delays of inputs that are tried [s], in proportion to a time step below ``UNHURRIED``."""
LAGS = tuple(
    np.arange(low, high + 1) / 100 for low, high in ((0, 10), (10, 20), (20, 40), (40, 80))
)
"""Time constants of inputs that are tried [s], likewise, each range where the longest of the one
before explains most."""
GRAIN = 0.01
"""Share of the distance of these times to which the best one in between is rounded."""
UNHURRIED = 0.005
"""Time step from which all of ``DELAYS`` and ``LAGS`` are tried [s]."""
GAIN, CLEAR = 0.05, 0.5
"""Shares of the unexplained power that a delay explains at least to be a candidate, and to be that
of all candidates."""
TOLD = 0.2
"""Unexplained power with a delay of all candidates over that without inputs, at most: regressions
represent arms badly, and where inputs explain little of the motion, they say nothing of delays."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """When inputs act after their record.

    Args:
        motions: The motions, whose inputs follow their record with the time constant.
        lag: Time constant [s]; 0: a delay explains the motion nearly as well.
        delay: Delay [s]; 0: none explains it better.
        clear: Whether the delay is that of all candidates.
        explained: Share of the accelerations' power that is explained; ``None``: unknown.
        vary: Whether the inputs ever change.
        note: A line about the delay.
    """

    motions: Sequence[Sampled]
    lag: float
    delay: float
    clear: bool
    explained: float | None
    vary: bool
    note: str

    @property
    def settings(self) -> list[str]:
        """Overrides of all candidates."""
        found = {"input_lag": self.lag, "input_delay": self.delay if self.clear else 0.0}
        return [f"data.{name}={time:g}" for name, time in found.items() if time != 0.0]

    @property
    def notes(self) -> list[str]:
        """Lines about the time constant and the delay."""
        told = f"inputs: forces follow them with a time constant of {1e3 * self.lag:g} ms"
        return [*([told] if self.lag else []), self.note]


def timing(
    motions: Sequence[Sampled],
    coordinates: Coordinates,
    h: float,
    *,
    driven: bool,
    known: bool,
    given: Collection[str],
) -> Timing:
    """Return when the inputs of motions at nodes act.

    Args:
        motions: The motions.
        coordinates: Those of the machine.
        h: Distance of the nodes [s].
        driven: Whether there are inputs.
        known: Whether the equations are known: a delay is then never that of all candidates.
        given: Those of ``ACTING`` that are given, so that the inputs of the motions act so.
    """
    delay_given, lag_given = (name in given for name in ACTING)
    delays = DELAYS * min(1.0, h / UNHURRIED) if driven and not delay_given else np.zeros(1)
    left = _best(delays, lambda delay: _unexplained(motions, coordinates, h, delay))
    lag = 0.0
    if driven and left and not lag_given:
        best, with_lag = _lag(motions, coordinates, h)
        if with_lag <= (1.0 - CLEAR) * min(left.values()):
            lag, motions, left = best, _lagging(motions, best), {0.0: with_lag}
    delay, note = _delay(left, given=delay_given)
    inputs = [one.samples.u for one, _, _ in motions]
    vary = not inputs or bool(np.ptp(np.concatenate(inputs), axis=0).any())
    if not vary:
        note = "inputs: they never change, which does not tell their delay"
    clear = not known and delay != 0.0 and left[delay] <= (1.0 - CLEAR) * left[0.0]
    if clear:
        free = _unexplained(motions, coordinates, h, driven=False)
        clear = free is not None and left[delay] <= TOLD * free
    return Timing(
        motions=motions,
        lag=lag,
        delay=delay,
        clear=clear,
        explained=1.0 - left[delay] if left else None,
        vary=vary,
        note=note,
    )


def _delay(left: Mapping[float, float], *, given: bool) -> tuple[float, str]:
    """Return the delay with which inputs explain most, if it is much, and a line about it."""
    if 0.0 not in left:
        return 0.0, "inputs: too little motion to tell their delay"
    best = min(left, key=lambda delay: left[delay])
    if best != 0.0 and left[best] <= (1.0 - GAIN) * left[0.0]:
        return best, (
            f"inputs: with a delay of {1e3 * best:g} ms, {100 * left[best]:.2g} % of the "
            f"accelerations' power is not explained, without {100 * left[0.0]:.2g} %"
        )
    told = "the given delay" if given else "no delay"
    return 0.0, f"inputs: {told}; {100 * (1 - left[0.0]):.3g} % of the power is explained"


def _lag(motions: Sequence[Sampled], coordinates: Coordinates, h: float) -> tuple[float, float]:
    """Return the best time constant of inputs [s], and the share that is not explained with it."""

    def unexplained(lag: float) -> float | None:
        return _unexplained(_lagging(motions, lag), coordinates, h)

    left: dict[float, float] = {}
    for lags in LAGS:
        left |= _best(lags * min(1.0, h / UNHURRIED), unexplained)
        best = min(left, key=lambda lag: left[lag])
        if best != max(left):
            break
    return best, left[best]


def _lagging(motions: Sequence[Sampled], lag: float) -> list[Sampled]:
    return [(acting_late(one, lag=lag), nodes, q) for one, nodes, q in motions]


def _best(
    times: Iterable[float], unexplained: Callable[[float], float | None]
) -> dict[float, float]:
    """Return the share that is not explained with each time, and with the best one in between."""
    found = {float(f"{each:.3g}"): unexplained(float(each)) for each in times}
    left = {each: share for each, share in found.items() if share is not None}
    if (between := _lowest(left)) is not None and (share := unexplained(between)) is not None:
        left[float(f"{between:.3g}")] = share
    return left


def _lowest(left: Mapping[float, float]) -> float | None:
    """Return where the parabola through the least unexplained share and its neighbours is lowest.

    Times are equally distant. Inputs that a digital controller holds between samples act half a
    sample after their record, a part of the distance of ``DELAYS``.
    """
    delays = sorted(left)
    k = min(range(len(delays)), key=lambda i: left[delays[i]], default=0)
    if not 0 < k < len(delays) - 1:
        return None
    before, least, after = (left[delay] for delay in delays[k - 1 : k + 2])
    curvature = before - 2.0 * least + after
    if not curvature > 0.0:
        return None
    shift, grain = 0.5 * (before - after) / curvature, GRAIN * (delays[k + 1] - delays[k])
    return grain * round((delays[k] + shift * (delays[k + 1] - delays[k])) / grain)


def _unexplained(
    motions: Sequence[Sampled],
    coordinates: Coordinates,
    h: float,
    delay: float = 0.0,
    *,
    driven: bool = True,
) -> float | None:
    """Return the share of the accelerations' power that inputs with a delay do not explain.

    Where it is not ``driven``, that which configurations and velocities do not explain.
    """
    share = explained_power(with_inputs(motions, h, delay), coordinates, h, driven=driven)
    return None if share is None else 1.0 - share


def reversed_inputs(
    recordings: Sequence[Recording], coordinates: Coordinates, h: float, input_matrix: np.ndarray
) -> np.ndarray:
    """Return which inputs (m,) act against the coordinates that they drive; none with rotations.

    The acceleration that an input adds along its own column ``b``, ``b · H⁻¹ b``, is positive with
    any inertia, unless the sign of the input is that of another direction.
    """
    none = np.zeros(input_matrix.shape[1], dtype=bool)
    if coordinates.rotations:
        return none
    pairs = with_inputs(at_nodes(first_seconds(recordings, max(EXAMINED, NODES * h)), h), h, 0.0)
    free, driven = (explained_power(pairs, coordinates, h, driven=x) for x in (False, True))
    if free is None or driven is None or driven - free < HELP * (1.0 - free):
        return none
    gains = input_gains(pairs, coordinates, h)
    return none if gains is None else (input_matrix * gains).sum(axis=0) < 0.0
