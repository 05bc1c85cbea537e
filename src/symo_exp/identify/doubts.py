"""Reasons why a machine has no good model, as far as its recordings show them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from symo_exp.evaluation.verdict import WINDOW, beside_baseline, outlasts
from symo_exp.identify.recordings import Machine

EXPLAINED = 0.5
"""Share of the accelerations' power below which something else moves the machine."""
BETTER = 0.5
"""Ratio of the error of a model to that of constant velocity above which, over all horizons, there
is no model."""
USEFUL, PART = 0.1, 0.5
"""Time to which a model is usable at least [s], if its errors over longer times are no better, and
the share of the time over which errors are compared if that is less."""
MISSED = 10.0
"""Errors of a fit, over those that say nothing against it, above which no candidate suits."""
LITTLE = 10.0
"""Length below which recordings are short [s]."""


def hopeless(measures: Mapping[str, float], horizon: float = WINDOW) -> bool:
    """Return whether a model is hardly better than constant velocity over every horizon.

    It is false if there is no window, or if the model is usable for a short time, but twice as
    long, as of an unstable machine. ``horizon`` is the time over which errors were compared [s].
    """
    if measures.get("windows") == 0.0:
        return False
    if measures.get("usable_s", 0.0) >= min(USEFUL, PART * horizon) and outlasts(measures):
        return False
    return all(not own <= BETTER * other for own, other in beside_baseline(measures))


def doubts(machine: Machine) -> Iterator[str]:
    """Yield properties of the recordings that may prevent a model from being found."""
    if not machine.moves:
        yield "nothing moves by more than its noise"
    elif machine.explained is None:
        yield "there are too few samples to tell what moves the machine"
    elif machine.explained < EXPLAINED:
        yield (
            f"configurations, friction and inputs explain {100 * machine.explained:.2g} % of the "
            "accelerations' power: something else moves the machine, a sensor fails, or clocks or "
            "units differ"
        )
    if machine.seconds < LITTLE:
        yield f"the recordings are short: {machine.seconds:.2g} s"
    if machine.delay:
        yield f"inputs seem to act {1e3 * machine.delay:g} ms after they are recorded"


def missed(machine: Machine, error: float, unit: str) -> Iterator[str]:
    """Yield that a model does not suit the recordings it was fitted to, if its errors say so.

    Args:
        machine: The recorded machine.
        error: Root mean square of the errors that the fit leaves.
        unit: Their unit.
    """
    if 0.0 < MISSED * machine.unseen < error < math.inf:
        yield (
            f"the fit leaves errors of {error:.2g} {unit}, and noise is {machine.unseen:.2g} at "
            "most: no candidate has a force that acts, as of a stop, a hand or a rotor that spins, "
            "an input acts otherwise than it is recorded, as where a motor saturates, or "
            "recordings, or parts of one, differ, as by a load or by a sensor that slipped; "
            "parameters may be off by more than their standard deviations"
        )
