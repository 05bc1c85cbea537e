"""The files of a run: its folder on disk, and the same names among its MLflow artifacts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from symo_exp.files import write_whole

if TYPE_CHECKING:
    import pyarrow

    from symo_exp.evaluation.evaluate import Rollouts

CONFIG = "config.yaml"
"""The resolved configuration."""
CHECKPOINT = "checkpoints/last.ckpt"
"""Lightning's checkpoint with the trained weights."""
MEASURES = "metrics.json"
ROLLOUTS = "rollouts.parquet"
PICTURES = "pictures"
STUDIES = "studies"

NAMES = (CONFIG, CHECKPOINT, MEASURES, ROLLOUTS, PICTURES, STUDIES)


def present(folder: Path) -> list[Path]:
    """The files of a run that exist in its folder."""
    return [folder / name for name in NAMES if (folder / name).exists()]


def write_config(folder: Path, config: Mapping[str, Any]) -> Path:
    """The resolved configuration as plain YAML: from it ``symo_exp.load`` rebuilds the model."""
    text = yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True)
    return _write(folder / CONFIG, text)


def write_measures(folder: Path, measures: Mapping[str, float]) -> Path:
    """The measures as JSON; ``"inf"`` and ``"nan"`` as strings, since JSON has no such numbers."""
    plain = {k: x if math.isfinite(x) else str(float(x)) for k, x in measures.items()}
    text = json.dumps(plain, indent=1) + "\n"
    return _write(folder / MEASURES, text)


def read_measures(folder: Path) -> dict[str, float]:
    """What ``write_measures`` wrote."""
    text = (folder / MEASURES).read_text(encoding="utf-8")
    return {name: float(value) for name, value in json.loads(text).items()}


def write_rollouts(folder: Path, rollouts: Rollouts) -> Path:
    """The rollouts as a tidy Parquet table, one row for each trajectory and node."""
    import pyarrow.parquet

    table = rollout_table(rollouts)
    path = folder / ROLLOUTS
    write_whole(path, lambda file: pyarrow.parquet.write_table(table, file, compression="zstd"))
    return path


def rollout_table(rollouts: Rollouts) -> pyarrow.Table:
    """Columns ``trajectory, step, t`` [s], then for each coordinate ``q_<name>``, ``v_<name>``
    and the true ``q_true_<name>``, ``v_true_<name>``, then ``energy``, ``energy_true`` [J] and
    ``converged`` (whether the step that led to this node found its root).
    """
    import pyarrow
    import torch

    columns = rollouts.columns()
    columns["energy"], columns["energy_true"] = rollouts.energy, rollouts.energy_true
    start = torch.ones_like(rollouts.converged[:, :1])
    columns["converged"] = torch.cat((start, rollouts.converged), dim=1)
    return pyarrow.table({name: x.flatten().numpy() for name, x in columns.items()})


def _write(path: Path, text: str) -> Path:
    write_whole(path, lambda file: file.write_text(text, encoding="utf-8"))
    return path
