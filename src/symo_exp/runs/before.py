"""Runs of earlier versions, translated to what this version reads.

In these a model was a LightningModule whose settings held those of its training, of its network
and of its Lagrangian; the weights had no prefix.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TRAINING = ("optimizer", "scheduler", "scheduler_monitor", "gradient_clip", "validation")
NETWORK = {"width": None, "depth": 2}
LAGRANGIAN = {"structure": "network", "harmonics": 0, "initial_inertia": 1.0, "axes": None}
"""Settings that have moved, with their former defaults."""

NETWORKS = ("symo_exp.models.node.", "symo_exp.models.residual.")
LAGRANGIANS = ("symo_exp.models.l_node.", "symo_exp.models.symo.", "symo_exp.models.e2e_symo.")

PREFIX = "model."
"""Of the weights of a model in the checkpoint of its learner."""


def model_settings(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a model as this version has them."""
    moved = (*TRAINING, *NETWORK, *LAGRANGIAN)
    settings = {key: value for key, value in stored.items() if key not in moved}
    size = {key: stored.get(key, default) for key, default in NETWORK.items()}
    target = str(stored.get("_target_"))
    if target.startswith(NETWORKS) and "net" not in stored:
        settings["net"] = {"_target_": "symo_exp.nets.mlp.MLP", "_partial_": True, **size}
    if target.startswith(LAGRANGIANS) and "lagrangian" not in stored:
        known = {key: stored.get(key, default) for key, default in LAGRANGIAN.items()}
        settings["lagrangian"] = {"_partial_": True, **_lagrangian(size=size, **known)}
    return settings


def _lagrangian(
    *, size: Mapping[str, Any], structure: str, harmonics: int, initial_inertia: Any, axes: Any
) -> dict[str, Any]:
    start = {"initial_inertia": initial_inertia}
    if structure == "rigid":
        return {"_target_": "symo_exp.nets.rigid_chain.RigidChain", "axes": axes, **start}
    start["harmonics"] = harmonics
    if structure == "network":
        return {"_target_": "symo_exp.nets.lagrangians.NetworkLagrangian", **size, **start}
    relative = structure == "relative"
    home = "symo_exp.nets.lagrangians.PlanarLagrangian"
    return {"_target_": home, "relative": relative, **start}


def model_weights(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the weights of a model from those of a checkpoint."""
    return {name.removeprefix(PREFIX): value for name, value in stored.items()}
