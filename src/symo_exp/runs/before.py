"""Runs of earlier versions, translated to what this version reads.

In the first a model was a LightningModule whose settings held those of its training, of its network
and of its Lagrangian; the weights had no prefix. Coefficients of learned friction were softplus of
their parameters, later squares.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import torch
from torch import Tensor

TRAINING = ("optimizer", "scheduler", "scheduler_monitor", "gradient_clip", "validation")
NETWORK = {"width": None, "depth": 2}
LAGRANGIAN = {"structure": "network", "harmonics": 0, "initial_inertia": 1.0, "axes": None}
"""Settings that have moved, with their former defaults."""

NETWORKS = ("symo_exp.models.node.", "symo_exp.models.residual.")
LAGRANGIANS = ("symo_exp.models.l_node.", "symo_exp.models.symo.", "symo_exp.models.e2e_symo.")

PREFIX = "model."
"""Of the weights of a model in the checkpoint of its learner."""

COEFFICIENTS = ("viscous", "coulomb", "breakaway")
"""Parameters of learned friction."""


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
    weights = {name.removeprefix(PREFIX): value for name, value in stored.items()}
    drag = {name.removesuffix("weight") for name in weights if name.endswith("dissipation.weight")}
    return dict(_friction(name, old, drag=drag) for name, old in weights.items())


def _friction(name: str, old: Tensor, *, drag: Collection[str]) -> tuple[str, Tensor]:
    """Return a parameter under its present name; coefficients of drag have kept theirs."""
    module, _, own = name.rpartition(".")
    if not module.endswith("dissipation") or own not in COEFFICIENTS or f"{module}." in drag:
        return name, old
    return f"{name}_root", _roots(old, triangle=own == "viscous")


def _roots(old: Tensor, *, triangle: bool) -> Tensor:
    """Return parameters of friction whose squares are coefficients; of a triangle the diagonal."""
    at = torch.arange(len(old))
    if triangle:
        at = at * (at + 3) // 2
        at = at[at < len(old)]
    return old.index_copy(0, at, torch.nn.functional.softplus(old[at]).sqrt())
