"""Friction of a learned dissipation, as far as a model file can hold it."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import torch
from torch import Tensor

from symo_exp.mechanics.dissipation import Friction
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.known import KnownFriction

Coupled = list[tuple[float, list[float]]]
"""Coefficients and the directions in joint coordinates that they act along."""
SMOOTH = "dry friction is smooth about standstill in the learned model, and abrupt in this file"


@singledispatch
def passive(dissipation: Any, n: int) -> tuple[Tensor, Coupled, list[str]]:
    """Return viscous friction, dry friction with its directions, and what no file can hold."""
    missing = [] if dissipation is None else [f"{type(dissipation).__name__} is not in this file"]
    return torch.zeros(n, n).double(), [], missing


@passive.register
def _(dissipation: LearnedDissipation, n: int) -> tuple[Tensor, Coupled, list[str]]:
    viscous, dry = dissipation.coefficients()
    joints = dissipation.joints.double()
    missing = [SMOOTH] if dry is not None else []
    if dissipation.net is not None:
        missing.append("the network of the dissipation is not in this file")
    coefficients = [] if dry is None else dry[0].tolist()
    matrix = torch.zeros(n, n).double() if viscous is None else viscous.double()
    along = list(zip(coefficients, joints.tolist(), strict=dry is not None))
    return joints.T @ matrix @ joints, along, missing


@passive.register
def _(dissipation: MachineFriction, n: int) -> tuple[Tensor, Coupled, list[str]]:
    viscous, along, missing = passive.dispatch(LearnedDissipation)(dissipation, n)
    terms = {
        "asymmetric friction": dissipation.asymmetry(),
        "the Stribeck effect": dissipation.stribeck(),
        "the constant force": dissipation.constant,
    }
    lost = [f"{name} is not in this file" for name, term in terms.items() if term is not None]
    return viscous, along, missing + lost


@passive.register
def _(dissipation: KnownFriction, n: int) -> tuple[Tensor, Coupled, list[str]]:
    viscous, coulomb = (x[0].double() for x in dissipation.coefficients())
    missing = [SMOOTH] if coulomb.any() else []
    if dissipation.drag is not None:
        missing.append("the drag of the fluid is not in this file")
    return torch.diag(viscous), of_each(coulomb), missing


@passive.register
def _(dissipation: Friction, n: int) -> tuple[Tensor, Coupled, list[str]]:
    missing = [SMOOTH] if dissipation.coulomb.any() else []
    return dissipation.viscous.double(), of_each(dissipation.coulomb), missing


def of_each(coulomb: Tensor) -> Coupled:
    """Return the dry friction of each coordinate that has some."""
    along = zip(coulomb.tolist(), torch.eye(len(coulomb)).tolist(), strict=True)
    return [(c, a) for c, a in along if c > 0.0]
