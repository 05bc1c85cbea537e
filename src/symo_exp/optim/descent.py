"""A damped, geodesically accelerated least-squares step, tried with growing damping.

A straight step ``δ`` solves the damped normal equations. Valleys of the objective are bent, and a
straight step is no longer than the bend allows; so it is taken to second order, by geodesic
acceleration (Transtrum and Sethna 2012): with ``r''`` the second derivative of the residuals along
``δ``, the correction ``a`` solves the same equations for ``½ r''``, and the step is ``δ + a``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from torch import Tensor

PROBE = 0.1
"""Part of the straight step at which its bend is measured."""
LONGEST = 0.75
"""Bound on twice the correction, relative to the straight step."""


class DampedEquations(ABC):
    """Linearised residuals with damped normal equations, at one damping."""

    @abstractmethod
    def straight(self) -> Tensor:
        """Return the step ``δ`` that minimises the damped linear problem, (parameters,)."""

    @abstractmethod
    def bend(self, step: Tensor) -> Tensor:
        """Return ``½ r''`` along a step."""

    @abstractmethod
    def correction(self, bend: Tensor) -> Tensor:
        """Return the step that the equations ask for with ``½ r''`` for residuals."""

    @abstractmethod
    def length(self, step: Tensor) -> Tensor:
        """Return the length of a step in the norm of the damping."""

    @abstractmethod
    def predicted(self, step: Tensor) -> float:
        """Return the decrease of the objective that the linear problem predicts for ``δ``."""


class Move(NamedTuple):
    """A trial step."""

    step: Tensor
    bend: Tensor | None
    """``½ r''`` along it; ``None`` if the step is straight."""
    predicted: float


def accelerated(equations: DampedEquations) -> Move:
    """Return the accelerated step, straight if the correction is too long."""
    straight = equations.straight()
    bend = equations.bend(straight)
    correction = equations.correction(bend)
    predicted = equations.predicted(straight)
    if bool(2.0 * equations.length(correction) <= LONGEST * equations.length(straight)):
        return Move(straight + correction, bend, predicted)
    return Move(straight, None, predicted)


class Descent(ABC):
    """Trials of one step: the first that lowers the objective is accepted.

    Args:
        objective: The objective at the start.
    """

    def __init__(self, objective: float) -> None:
        self.objective = objective

    @abstractmethod
    def equations(self) -> DampedEquations | None:
        """Return the equations at the present damping, ``None`` without a factor."""

    @abstractmethod
    def take(self, move: Move) -> float:
        """Put a trial step in place and return the objective there."""

    @abstractmethod
    def accepted(self, gain: float, *, first: bool) -> None:
        """Adapt the damping to the decrease relative to the predicted one."""

    @abstractmethod
    def refused(self) -> None:
        """Undo a trial, if there was one, and raise the damping."""

    def run(self, trials: int) -> bool:
        """Try steps with growing damping; return whether one was accepted."""
        for trial in range(trials):
            equations = self.equations()
            if equations is not None:
                move = accelerated(equations)
                fall = self.objective - self.take(move)
                if fall > 0.0:
                    self.accepted(fall / max(move.predicted, 1e-300), first=trial == 0)
                    return True
            self.refused()
        return False
