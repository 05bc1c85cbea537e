"""The name of a run's folder: what was run, readable, and a digest of all that shapes its result.

The same command finds its folder again; two commands that compute different things never share
one, whether they are single runs or jobs of a sweep.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from omegaconf import Container, DictConfig, OmegaConf

from symo_exp.configuration import references

assert references  # registers what files may say besides names

_INCIDENTAL = {
    "": {"hydra", "experiment", "output_dir", "logger", "resume", "study"},
    "data": {"cache_dir"},
    "trainer": {"progress", "checkpoint_every"},
}
"""Keys, by group, that change no number of a run."""


def run_folder(*, _root_: Container) -> str:
    assert isinstance(_root_, DictConfig)
    choices = _root_.hydra.runtime.choices
    return f"{choices.model}-{choices.system}-{digest(_root_)}"


def digest(config: DictConfig) -> str:
    relevant = [key for key in map(str, config) if key not in _INCIDENTAL[""]]
    values: dict[str, Any] = OmegaConf.to_container(  # type: ignore[assignment]
        OmegaConf.masked_copy(config, relevant), resolve=True
    )
    for group, keys in _INCIDENTAL.items():
        if isinstance(values.get(group), dict):
            values[group] = {k: v for k, v in values[group].items() if k not in keys}
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
