"""Division of recordings into training, validation and test parts."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from symo_exp.checks import whole_number
from symo_exp.data.paths import few, titled
from symo_exp.data.resample import LONGEST_GAP, TIME_TOLERANCE, Samples
from symo_exp.data.table import Recording
from symo_exp.errors import ConfigError
from symo_exp.words import counted

PARTS = ("train", "val", "test")
PATTERN = ("train", "train", "val", "train", "test")
"""Parts of the blocks of a recording that is split in time, repeated."""
BLOCK, ROUNDS = 6.0, 4
"""Length that blocks have at least where the pattern is repeated [s], and how often it is, at
most."""
GAP = 0.5
"""Left out between blocks of different parts or folds [s], at most a tenth of a block."""
FEWEST = 5
"""Time steps of a block, at least."""
REST = 0.05
"""Share of a coordinate's range that it moves by at most where a recording is at rest."""
RESTS = 2.0
"""Length from which a rest is left out [s]."""
Parts = dict[str, list[Recording]]
"""Recordings by the name of their part."""


def divided(
    where: str,
    recordings: Sequence[Recording],
    named: Mapping[str, Sequence[object] | None],
    n_val: int | None,
    n_test: int | None,
    time_step: float,
) -> tuple[Parts, Sequence[Recording], str | None]:
    """Return the recordings of each part in the order of the table, and all of them.

    Without names and numbers these are those of ``with_every_part``, whose line is the last result.

    Args:
        where: The beginning of error messages.
        recordings: All recordings, with the part of the column ``split`` where there is one.
        named: Labels of the recordings of a part; they go before the column ``split``.
        n_val: Number of recordings for validation, those before the test ones. Without names and
            without a split ``None`` is one; a number goes before the column ``split``.
        n_test: Number of recordings for testing, the last ones; ``None`` as for ``n_val``.
        time_step: Distance of the nodes [s].

    Raises:
        ConfigError: If a part is empty.
    """
    numbered = n_val is not None or n_test is not None
    listed = {part: _labels(part, labels) for part, labels in named.items() if labels is not None}
    if listed and numbered:
        raise ConfigError(
            f"data.{next(iter(listed))} names trajectories: leave out data.n_val and data.n_test"
        )
    note = None
    if not (listed or numbered):
        recordings, note = with_every_part(recordings, time_step)
    if numbered:
        parts = _by_count(where, recordings, n_val, n_test)
    elif listed or any(r.part for r in recordings):
        parts = _by_name(where, recordings, listed)
    elif len(recordings) >= len(PARTS):
        parts = _by_count(where, recordings, 1, 1)
    else:
        spans = " and ".join(f"{np.ptp(one.samples.t):.3g} s" for one in recordings) or "none"
        raise ConfigError(
            f"{where} has {counted(len(recordings), 'trajectory')}, too few for train, val and "
            f"test, and too short to be split in time ({spans}, a node every {time_step:g} s); "
            "record longer ones, or more, and number trajectories apart in a column trajectory"
        )
    for part, chosen in parts.items():
        if not chosen:
            given = few(sorted({r.part for r in recordings} - {""}))
            split = f"its column split has {given}, expected {', '.join(PARTS)}; " * bool(given)
            raise ConfigError(
                f"{where}: no trajectory for {part}; {split}name some by data.{part}=[...] of "
                f"{_named([r.label for r in recordings])}"
            )
    return parts, recordings, note


def _labels(part: str, given: object) -> list[str]:
    if isinstance(given, str | int):
        given = [given]
    if not isinstance(given, Sequence) or not given:
        raise ConfigError(f"data.{part}={given}: expected the names of some trajectories")
    return [str(label) for label in given]


def _by_name(
    where: str, recordings: Sequence[Recording], listed: Mapping[str, Sequence[str]]
) -> Parts:
    """Return the recordings with the listed labels; parts without any have those of their split.

    Without a split the recordings that are not listed are for training.
    """
    there = [r.label for r in recordings]
    everything = [label for labels in listed.values() for label in labels]
    for label in everything:
        if label not in there:
            raise ConfigError(f"{where} has no trajectory {label}; it has {_named(there)}")
        if everything.count(label) > 1:
            raise ConfigError(f"{where}: trajectory {label} is named twice, by data.train/val/test")
    rest = [r for r in recordings if r.label not in everything]
    parts: Parts = {"train": rest, "val": [], "test": []}
    if any(r.part for r in recordings):
        parts = {part: [r for r in rest if r.part == part] for part in PARTS}
    for part, labels in listed.items():
        parts[part] = [r for r in recordings if r.label in labels]
    return parts


def _named(labels: Sequence[str]) -> str:
    """Return the names of trajectories; a recording that is alone has none."""
    return few(list(filter(None, labels))) or "one without a name"


def _by_count(
    where: str, recordings: Sequence[Recording], n_val: int | None, n_test: int | None
) -> Parts:
    n_val = whole_number("data.n_val", 1 if n_val is None else n_val)
    n_test = whole_number("data.n_test", 1 if n_test is None else n_test)
    first_test = len(recordings) - n_test
    first_val = first_test - n_val
    if first_val < 1:
        raise ConfigError(
            f"{where} has {counted(len(recordings), 'trajectory')}, too few for "
            f"data.n_val={n_val}, data.n_test={n_test} and at least one to train on"
        )
    return {
        "train": list(recordings[:first_val]),
        "val": list(recordings[first_val:first_test]),
        "test": list(recordings[first_test:]),
    }


def with_every_part(
    recordings: Sequence[Recording], time_step: float
) -> tuple[list[Recording], str | None]:
    """Return recordings of which some are for validation and for testing, and a line that says so.

    Nothing changes where each part has recordings, or none has and there are at least three. One or
    two recordings without a part are split in time. Where the column ``split`` has nothing for
    testing, every second recording for validation is. Otherwise the last recordings for training
    are for the parts that have none or, where these are fewer than three, all of them are split in
    time.

    In time, a recording is cut into blocks with equal times of samples, gaps not counted, which
    belong to train, train, val, train and test, in turn. Neighbours of one part stay together;
    between others a gap is left out. So are rests before the first and after the last motion, since
    no block could be predicted there. Recordings too short for this are returned as they are.
    """
    given = {one.part for one in recordings} & set(PARTS)
    lacking = [part for part in PARTS if part not in given]
    if not given:
        alone = 0 < len(recordings) < len(PARTS) and not any(one.part for one in recordings)
        return _in_blocks(recordings, time_step, PARTS) if alone else (list(recordings), None)
    if not lacking or "train" in lacking:
        return list(recordings), None
    told = f"the column split has nothing for {' and '.join(lacking)}"
    if len(held_out := _of(recordings, "val")) > 1:
        moved = dict.fromkeys(held_out[1::2], "test")
    elif len(train := _of(recordings, "train")) >= len(PARTS):
        moved = dict(zip(train[-len(lacking) :], lacking, strict=True))
    else:
        cut, note = _in_blocks([recordings[i] for i in train], time_step, lacking)
        others = [one for i, one in enumerate(recordings) if i not in train]
        return [*cut, *others], note and f"{told}: {note}"
    names = (f"{recordings[i].label} is for {part}" for i, part in moved.items())
    changed = [one._replace(part=moved.get(i, one.part)) for i, one in enumerate(recordings)]
    return changed, f"{told}: {', '.join(names)}"


def _of(recordings: Sequence[Recording], part: str) -> list[int]:
    return [i for i, one in enumerate(recordings) if one.part == part]


def without(
    recordings: Sequence[Recording], stretches: object, time_step: float
) -> tuple[Recording, ...]:
    """Return recordings without the samples of some stretches.

    Stretches are widened to gaps at which ``uninterrupted`` cuts.

    Args:
        recordings: All of a table.
        stretches: ``[NAME, FROM, TO]`` each, in seconds after the first sample of a recording; the
            only recording of a table needs no name.
        time_step: Distance of the nodes [s].

    Raises:
        ConfigError: If a stretch is none of a recording, or a recording is left out as a whole.
    """
    found = {one.label: one for one in recordings}
    starts = {one.label: one.samples.t[0] for one in recordings}
    for name, low, high in _checked_stretches(stretches, list(found)):
        half = max((high - low) / 2, LONGEST_GAP * time_step)
        one = found[name]
        kept = np.abs(one.samples.t - starts[name] - (low + high) / 2) > half
        if kept.sum() < 2:
            raise ConfigError(f"data.leave_out leaves nothing of {titled(name)}")
        found[name] = one._replace(samples=one.samples.rows(kept))
    return tuple(found.values())


def _checked_stretches(given: object, names: Sequence[str]) -> Iterator[tuple[str, float, float]]:
    wanted = "expected [[NAME,FROM,TO],...] in seconds after the first sample of a trajectory"
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise ConfigError(f"data.leave_out={given}: {wanted}")
    for one in given:
        if isinstance(one, str) or not isinstance(one, Sequence) or len(one) not in (2, 3):
            raise ConfigError(f"data.leave_out: {one}: {wanted}")
        name = str(one[0]) if len(one) == 3 else names[0]
        if name not in names or (len(one) == 2 and len(names) > 1):
            raise ConfigError(f"data.leave_out: {one}: {wanted}, of {_named(names)}")
        low, high = one[-2:]
        numbers = all(isinstance(x, int | float) for x in (low, high))
        if not (numbers and -np.inf < low <= high < np.inf):
            raise ConfigError(f"data.leave_out: {one}: {wanted}")
        yield name, float(low), float(high)


def uninterrupted(
    recordings: Sequence[Recording], time_step: float
) -> tuple[list[Recording], str | None]:
    """Return the pieces of recordings between gaps, and a line that says so if there are gaps.

    A gap is longer than ``LONGEST_GAP`` time steps. Pieces of fewer than ``FEWEST`` steps are left
    out. A recording whose samples are usually farther apart than a time step is left as it is.
    """
    pieces, gaps, cut, lost = [], [], 0, 0.0
    for one in recordings:
        t = one.samples.t
        steps = np.diff(t)
        long = np.flatnonzero(steps > LONGEST_GAP * time_step * (1 + TIME_TOLERANCE))
        if not len(long) or np.median(steps) > time_step * (1 + TIME_TOLERANCE):
            pieces.append(one)
            continue
        edges = [0, *(long + 1), len(t)]
        spans = [slice(a, b) for a, b in itertools.pairwise(edges)]
        kept = [x for x in spans if t[x][-1] - t[x][0] >= FEWEST * time_step]
        pieces += [
            one._replace(
                label=f"{one.label}/{t[x][0]:.4g} to {t[x][-1]:.4g} s".lstrip("/"),
                samples=one.samples.rows(x),
            )
            for x in kept
        ]
        cut += 1
        gaps += list(steps[long])
        lost += sum(t[x][-1] - t[x][0] for x in spans if x not in kept)
    if not gaps:
        return pieces, None
    told = (
        f"gaps: {cut} of {len(recordings)} trajectories have {len(gaps)} of more than "
        f"{LONGEST_GAP * time_step:.2g} s (the longest {max(gaps):.3g} s) and are cut there"
    )
    return pieces, told + (f"; {lost:.2g} s in pieces too short are left out" if lost else "")


def _in_blocks(
    recordings: Sequence[Recording], time_step: float, lacking: Sequence[str]
) -> tuple[list[Recording], str | None]:
    """Split recordings in time; blocks of parts that are not lacking are for training."""
    clocks = [one.samples.clock for one in recordings]
    ends = [
        _moving(one.samples._replace(t=clock))
        for one, clock in zip(recordings, clocks, strict=True)
    ]
    spans = [end - start for start, end in ends]
    if any(span < FEWEST * time_step * len(PATTERN) / 0.9 for span in spans):
        return list(recordings), None
    pattern = tuple(part if part in lacking else "train" for part in PATTERN)
    blocks, told = [], []
    for one, clock, (start, _), span in zip(recordings, clocks, ends, spans, strict=True):
        rounds = int(min(max(span // (BLOCK * len(PATTERN)), 1), ROUNDS))
        size = span / (rounds * len(PATTERN))
        gap = min(GAP, size / 10)
        order = pattern * rounds
        changes = [k for k in range(1, len(order)) if order[k] != order[k - 1]]
        for first, last in itertools.pairwise([0, *changes, len(order)]):
            low, high = start + first * size + gap * (first > 0), start + last * size
            samples = one.samples.between(low, high)
            low, high = np.interp([low, high], clock, one.samples.t - one.samples.t[0])
            name = f"{low:.4g} to {high:.4g} s"
            label = f"{one.label}/{name}" if one.label else name
            blocks.append(one._replace(label=label, part=order[first], samples=samples))
        rest = float(clock[-1]) - span
        left = f" ({rest:.3g} s at rest are left out)" if rest > 0 else ""
        told.append(f"{span:.4g} s{left} in {rounds * len(PATTERN)} blocks of {size:.3g} s")
    if any(len(block.samples.t) < 2 for block in blocks):
        return list(recordings), None
    return blocks, (
        f"split in time: {' and '.join(told)}, in turn {', '.join(pattern)}; {gap:.2g} s left out "
        "between parts"
    )


def _moving(samples: Samples) -> tuple[float, float]:
    """Return when a recording leaves and comes to rest [s], after its first sample.

    It is at rest where, for ``RESTS`` seconds at least, no coordinate moves by more than ``REST``
    of its range until the end, or since the start, and no input acts. If it never moves, it counts
    as a whole.
    """
    t, q, acts = samples.t - samples.t[0], samples.q, np.asarray(samples.u.any(axis=1))
    least = REST * np.ptp(q, axis=0)

    def at_rest(q: np.ndarray, acts: np.ndarray) -> int:
        """Return how many of the first samples are at rest."""
        reach = np.maximum.accumulate(q) - np.minimum.accumulate(q)
        return int(((reach <= least).all(1) & ~np.logical_or.accumulate(acts)).sum())

    start = t[max(at_rest(q, acts) - 1, 0)]
    end = t[min(len(t) - at_rest(q[::-1], acts[::-1]), len(t) - 1)]
    start = start if RESTS <= start < t[-1] else 0.0
    return float(start), float(end if t[-1] - end >= RESTS and end > start else t[-1])
