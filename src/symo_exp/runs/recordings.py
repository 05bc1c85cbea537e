"""The recordings of a run."""

from __future__ import annotations

import hydra.utils

from symo_exp.data.base import Splits
from symo_exp.runs.folder import RunFolder


def divided_recordings(run: RunFolder) -> Splits:
    """Return the recordings of a run, divided as its configuration says."""
    config = run.config()
    system = hydra.utils.instantiate(config["system"])
    # given afterwards: Hydra would take a system, a dataclass, for configuration
    splits: Splits = hydra.utils.instantiate(config["data"], _partial_=True)(system=system).load()
    return splits
