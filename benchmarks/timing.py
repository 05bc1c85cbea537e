"""Interleaved timing: each round measures every contender, so that drift affects all alike."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Times of one call [ms]: the median over rounds, and the quartiles."""

    median: float
    low: float
    high: float


def interleaved(
    calls: Mapping[str, Callable[[], object]],
    *,
    rounds: int,
    turn_ms: float = 20.0,
    warm_up: int = 2,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Timing]:
    """Median time of a call of each, over `rounds` rounds.

    A turn repeats the call until about `turn_ms` are spent (at least once), measured beforehand,
    after one more that refills the caches where a call is short enough; the order is reversed in
    every other round, and the garbage collector rests. On a machine that
    is shared, `clock=time.process_time` counts only what this process used.
    """
    repeats = {}
    for name, call in calls.items():
        for _ in range(warm_up):
            call()
        began = clock()
        call()
        repeats[name] = max(1, int(turn_ms / 1e3 / max(clock() - began, 1e-9)))
    seen: dict[str, list[float]] = {name: [] for name in calls}
    collecting = gc.isenabled()
    gc.disable()
    try:
        for turn in range(rounds):
            for name in list(calls)[:: 1 if turn % 2 == 0 else -1]:
                call = calls[name]
                if repeats[name] > 1:
                    call()
                began = clock()
                for _ in range(repeats[name]):
                    call()
                seen[name].append(max(clock() - began, 1e-9) * 1e3 / repeats[name])
    finally:
        if collecting:
            gc.enable()
    return {name: summary(times) for name, times in seen.items()}


def summary(times: list[float]) -> Timing:
    """Median and quartiles of a few times [ms]."""
    if len(times) < 2:
        return Timing(times[0], times[0], times[0])
    low, middle, high = statistics.quantiles(times, n=4, method="inclusive")
    return Timing(middle, low, high)
