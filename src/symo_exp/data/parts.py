"""Which recordings are for training, which for validation, which for testing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from symo_exp.data.header import few
from symo_exp.data.table import Recording
from symo_exp.errors import ConfigError
from symo_exp.systems.checks import whole

PARTS = ("train", "val", "test")
Parts = dict[str, list[Recording]]


def divided(
    where: str,
    recordings: Sequence[Recording],
    named: Mapping[str, Sequence[object] | None],
    n_val: int | None,
    n_test: int | None,
) -> Parts:
    """The recordings of each part, in the order of the table.

    ``named`` lists their labels; what it does not say, the column ``split`` does. Without either
    the last ``n_test`` are for testing, the ``n_val`` before them for validation (``None``: one)
    and the others for training; ``n_val`` or ``n_test`` given have this rule in any case.
    """
    counted = n_val is not None or n_test is not None
    listed = {part: _labels(part, labels) for part, labels in named.items() if labels is not None}
    if listed and counted:
        raise ConfigError(f"data.{next(iter(listed))} names trajectories: leave out n_val, n_test")
    if listed:
        parts = _by_name(where, recordings, listed)
    elif not counted and any(r.part for r in recordings):
        parts = {part: [r for r in recordings if r.part == part] for part in PARTS}
    else:
        n_val = whole("data.n_val", 1 if n_val is None else n_val)
        n_test = whole("data.n_test", 1 if n_test is None else n_test)
        return _last(where, recordings, n_val, n_test)
    for part, chosen in parts.items():
        if not chosen:
            given = few(sorted({r.part for r in recordings} - {""})) or "none"
            raise ConfigError(
                f"{where}: no trajectory for {part}; its column split has {given}; name some by "
                f"data.{part}=[...] of {few([r.label for r in recordings])}"
            )
    return parts


def _labels(part: str, given: object) -> list[str]:
    if isinstance(given, str | int):
        given = [given]
    if not isinstance(given, Sequence) or not given:
        raise ConfigError(f"data.{part}={given}: expected the names of some trajectories")
    return [str(label) for label in given]


def _by_name(
    where: str, recordings: Sequence[Recording], listed: Mapping[str, Sequence[str]]
) -> Parts:
    there = [r.label for r in recordings]
    everything = [label for labels in listed.values() for label in labels]
    for label in everything:
        if label not in there:
            raise ConfigError(f"{where} has no trajectory {label}; it has {few(there)}")
        if everything.count(label) > 1:
            raise ConfigError(f"{where}: trajectory {label} is named twice, by data.train/val/test")
    rest = [r for r in recordings if r.label not in everything]
    parts: Parts = {}
    for part in PARTS:
        if part in listed:
            parts[part] = [r for r in recordings if r.label in listed[part]]
        elif any(r.part for r in recordings):
            parts[part] = [r for r in rest if r.part == part]
        else:
            parts[part] = rest if part == "train" else []
    return parts


def _last(where: str, recordings: Sequence[Recording], n_val: int, n_test: int) -> Parts:
    available = len(recordings) - n_val - n_test
    if available < 1:
        lone = len(recordings) == 1 and not recordings[0].label
        hint = "; number trajectories apart in a column trajectory" if lone else ""
        raise ConfigError(
            f"{where} has {len(recordings)} trajectories, too few for data.n_val={n_val}, "
            f"data.n_test={n_test} and at least one to train on{hint}"
        )
    val = available + n_val
    bounds = {"train": (0, available), "val": (available, val), "test": (val, None)}
    return {part: list(recordings[low:high]) for part, (low, high) in bounds.items()}
