"""Reasons why a machine has no good model, as far as its recordings show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from symo_exp.identify.recordings import Machine

EXPLAINED = 0.5
"""Share of the accelerations' power below which something else moves the machine."""
BETTER = 0.5
"""Share of constant velocity's error at 1 s above which reasons are given."""
LITTLE = 10.0
"""Length of recordings that is little [s]."""


def doubts(measures: Mapping[str, float], machine: Machine) -> Iterator[str]:
    """Yield reasons for a bad model; none for one that is better than constant velocity.

    Args:
        measures: Those of the run on its test part.
        machine: What the recordings say.
    """
    own, other = (measures.get(f"{who}rmse_1s") for who in ("", "constant_velocity_"))
    if own is not None and other is not None and own <= BETTER * other:
        return
    if machine.explained is None:
        yield "why: too few samples, or nothing moves"
    elif machine.explained < EXPLAINED:
        yield (
            f"why: configurations, friction and inputs explain {100 * machine.explained:.2g} % of "
            "the accelerations' power; something else moves the machine, a sensor fails, or clocks "
            "or units differ"
        )
    if machine.seconds < LITTLE:
        yield f"why: {machine.seconds:.2g} s are little to learn from"
    if machine.delay:
        yield f"perhaps: inputs seem to act {1e3 * machine.delay:g} ms after they are recorded"
