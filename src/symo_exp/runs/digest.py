"""Which settings change the numbers of a run, and the digest of them that names its folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

INCIDENTAL = {
    "hydra", "experiment", "output_dir", "logger", "resume", "study", "pictures", "measures",
    "code", "optimized_metric", "reference", "data.cache_dir", "trainer.progress",
    "trainer.checkpoint_every", "trainer.time_limit", "budget",
}  # fmt: skip
"""Settings, and groups of them, that change no number of a run."""


def digest(settings: Mapping[str, Any]) -> str:
    """Ten hexadecimal digits that stand for the relevant part of resolved ``settings``.

    Two commands share a digest exactly if they compute the same: the order of keys and the
    spelling of numbers (``0``, ``0.0``, ``1e-3``) do not enter.
    """
    text = json.dumps(dict(relevant(settings)), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def kernels(settings: Mapping[str, Any]) -> str:
    """A digest of what a compiled training step depends on, but for the sizes of its batches."""
    groups = {
        "seed", "data", "draws", "optimizer", "scheduler", "learning_rate", "learner", "trainer",
    }  # fmt: skip
    return digest({key: value for key, value in settings.items() if key not in groups})


def relevant(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The settings that change numbers, flat (``data.n_traj``) and in canonical spelling."""
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if name in INCIDENTAL:
            continue
        if isinstance(value, Mapping) and value:
            yield from relevant(value, f"{name}.")
        else:
            yield name, _canonical(value)


def _canonical(value: Any) -> Any:
    """Every number as a float: whether a constructor wants a whole one is checked elsewhere."""
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, list | tuple):
        return [_canonical(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _canonical(item) for key, item in value.items()}
    return value
