"""The settings that change the numbers of a run, and their digest, which names its folder."""

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
    """Return ten hexadecimal digits for the relevant part of resolved settings.

    Two commands share a digest exactly if they compute the same: the order of keys and the
    spelling of numbers (``0``, ``0.0``, ``1e-3``) do not matter.
    """
    text = json.dumps(dict(relevant(settings)), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def kernels(settings: Mapping[str, Any]) -> str:
    """Return a digest of what a compiled training step depends on, sizes of batches apart."""
    groups = {
        "seed", "data", "draws", "optimizer", "scheduler", "learning_rate", "learner", "trainer",
        "start_from",
    }  # fmt: skip
    return digest({key: value for key, value in settings.items() if key not in groups})


def relevant(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the settings that change numbers, by dotted name and in canonical spelling."""
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if name in INCIDENTAL:
            continue
        if isinstance(value, Mapping) and value:
            yield from relevant(value, f"{name}.")
        else:
            yield name, _canonical(value)


def _canonical(value: Any) -> Any:
    """Return every number as a float; constructors check elsewhere for whole ones."""
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, list | tuple):
        return [_canonical(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _canonical(item) for key, item in value.items()}
    return value
