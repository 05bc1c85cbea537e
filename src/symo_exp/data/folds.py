"""Cross-validation over recordings: folds of the training and validation parts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from symo_exp.data.parts import GAP, REST, Parts
from symo_exp.data.sensors import noise_of
from symo_exp.data.table import Recording
from symo_exp.errors import ConfigError

POOLED = "pooled"
"""Name of the division that trains on the training and the validation part."""
SHORTEST = 1.0
"""Length of the pieces that data are reduced to [s], where recordings are not shorter."""
VALIDATED = 8.0
"""Length of the pieces that validation data are reduced to [s]: windows and a whole motion."""
ABOVE_NOISE = 10.0
"""Range of a coordinate over its noise from which it moves."""
GOLDEN = 0.6180339887498949
"""Multiples of it, modulo 1, are spread evenly over the unit interval, however many there are."""


def folded(parts: Parts, fold: Sequence[int] | str) -> Parts:
    """Return the parts of one fold, or of the last training.

    Args:
        parts: The recordings of the parts ``train``, ``val`` and ``test``.
        fold: ``[k, K]``: training and validation recordings are dealt to ``K`` folds, and the
            ``k``-th, the first being 0, is both the validation and the test part; the others are
            for training, and so are those at rest in every fold. ``"pooled"``: all of them are for
            training, the test part stays.

    Raises:
        ConfigError: If there is no such fold.
    """
    pool = [*parts["train"], *parts["val"]]
    if fold == POOLED:
        return {"train": pool, "val": list(parts["val"]), "test": list(parts["test"])}
    index, count = _checked(fold)
    rests = at_rest(pool)
    moving = [one for one, x in zip(pool, rests, strict=True) if not x]
    still = [one for one, x in zip(pool, rests, strict=True) if x]
    pieces = moving if len(moving) >= count else _blocks(moving, count)
    dealt = deal([piece.samples.seconds for piece in pieces], count)
    held_out = [pieces[i] for i in dealt[index]]
    train = [pieces[i] for k, group in enumerate(dealt) if k != index for i in group]
    return {"train": [*train, *still], "val": held_out, "test": held_out}


def at_rest(recordings: Sequence[Recording]) -> list[bool]:
    """Return in which recordings nothing moves, so that no prediction can be measured on them.

    No coordinate moves by more than its noise or by more than a small part of its motion in another
    recording. It is false for all if nothing moves in any recording.
    """
    motion = np.array([np.ptp(one.samples.q, axis=0) for one in recordings])
    little = (motion <= REST * motion.max(axis=0)).all(axis=1)
    still = [bool(x) and not any_moves([one]) for x, one in zip(little, recordings, strict=True)]
    return [False] * len(still) if all(still) else still


def any_moves(recordings: Sequence[Recording]) -> bool:
    """Return whether any coordinate moves by more than its noise in any recording."""
    return any(map(moves, zip(*(one.samples.q.T for one in recordings), strict=True)))


def moves(columns: Sequence[np.ndarray]) -> bool:
    """Return whether a coordinate moves by more than its noise in any recording."""
    least = max(ABOVE_NOISE * np.nan_to_num(noise_of(columns)), np.finfo(float).tiny)
    return any(float(np.ptp(x)) > least for x in columns)


def deal(durations: Sequence[float], count: int) -> list[list[int]]:
    """Return the indices of each of ``count`` folds of nearly equal durations.

    The longest goes first, always to the fold that is shortest so far.
    """
    folds: list[list[int]] = [[] for _ in range(count)]
    total = [0.0] * count
    for i in sorted(range(len(durations)), key=lambda i: -durations[i]):
        k = total.index(min(total))
        folds[k].append(i)
        total[k] += durations[i]
    return [sorted(fold) for fold in folds]


def thinned(
    recordings: Sequence[Recording],
    seconds: float,
    shortest: float = SHORTEST,
    least: float = 0.0,
) -> list[Recording]:
    """Return a piece of each recording, the same share of all, that together last ``seconds``.

    Each begins elsewhere in its recording, since motions often differ along recordings. Where
    pieces would be shorter than ``shortest`` [s], or than the recordings if these are shorter, only
    every so many recordings have one. No piece of a recording of ``least`` [s] is shorter than
    this; those of shorter recordings are whole.
    """
    total = sum(one.samples.seconds for one in recordings)
    if seconds >= total:
        return list(recordings)
    shortest = min(shortest, max(one.samples.seconds for one in recordings))
    most = max(1, int(seconds / shortest))
    if len(recordings) > most:
        chosen = np.linspace(0, len(recordings), most, endpoint=False).astype(int)
        recordings = [recordings[i] for i in chosen]
    share = min(1.0, seconds / sum(one.samples.seconds for one in recordings))
    pieces = []
    for i, one in enumerate(recordings):
        length = min(one.samples.seconds, max(share * one.samples.seconds, least))
        low = (GOLDEN * i) % 1.0 * (one.samples.seconds - length)
        pieces.append(one._replace(samples=one.samples.between(low, low + length)))
    return pieces


def _checked(fold: object) -> tuple[int, int]:
    if not isinstance(fold, str) and isinstance(fold, Sequence) and len(fold) == 2:
        index, count = fold
        if isinstance(index, int) and isinstance(count, int) and 0 <= index < count > 1:
            return index, count
    raise ConfigError(f"data.fold={fold}: expected [k,K] with 0 <= k < K, at least 2, or {POOLED}")


def _blocks(recordings: Sequence[Recording], count: int) -> list[Recording]:
    """Return at least ``count`` pieces of the recordings, all of them about equally long."""
    size = sum(one.samples.seconds for one in recordings) / count
    cuts = [max(1, round(one.samples.seconds / size)) for one in recordings]
    while sum(cuts) < count:
        longest = max(range(len(cuts)), key=lambda i: recordings[i].samples.seconds / cuts[i])
        cuts[longest] += 1
    pieces = []
    for one, blocks in zip(recordings, cuts, strict=True):
        edges = np.linspace(0.0, one.samples.seconds, blocks + 1)
        gap = min(GAP, 0.1 * edges[1])
        for k, (low, high) in enumerate(itertools.pairwise(edges)):
            samples = one.samples.between(low + gap * (k > 0), high)
            pieces.append(one._replace(label=f"{one.label}/{k}", samples=samples))
    if any(len(one.samples.t) < 2 for one in pieces):
        raise ConfigError(
            f"data.fold: recordings of {size * count:.3g} s have too few samples for {count} folds "
            "of them; give fewer folds"
        )
    return pieces
