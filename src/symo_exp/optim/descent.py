"""A damped, geodesically accelerated least-squares step, tried with growing damping.

A straight step ``δ`` solves the damped normal equations. Valleys of the objective are bent, and a
straight step is no longer than the bend allows; so it is taken to second order, by geodesic
acceleration (Transtrum and Sethna 2012): with ``r''`` the second derivative of the residuals along
``δ``, the correction ``a`` solves the same equations for ``½ r''``, and the step is ``δ + a``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

PROBE = 0.1
"""Part of the straight step at which its bend is measured."""
LONGEST = 0.75
"""Bound on twice the correction, relative to the straight step."""


class Move(NamedTuple):
    """A trial step."""

    step: Tensor
    bend: Tensor | None
    """``½ r''`` along it; ``None`` if the step is straight."""
    predicted: float
    correction: Tensor | None = None
    """The part of the step that is of second order."""

    def straight(self) -> Move:
        """Return the move without what is of second order."""
        step = self.step if self.correction is None else self.step - self.correction
        return Move(step, None, self.predicted)

    def shortened(self, share: float) -> Move:
        """Return the move a ``share`` of the way along the parabola of the step."""
        shorter = self.predicted * share * (2.0 - share)
        if self.bend is None or self.correction is None:
            return Move(share * self.step, None, shorter)
        correction = share**2 * self.correction
        straight = share * (self.step - self.correction)
        return Move(straight + correction, share**2 * self.bend, shorter, correction)


def accelerated(
    straight: Tensor,
    bend: Tensor,
    correction: Tensor,
    predicted: float,
    length: Callable[[Tensor], Tensor],
) -> Move:
    """Return the accelerated step, straight if the correction is too long.

    Args:
        straight: The step ``δ`` that minimises the damped linear problem, (parameters,).
        bend: ``½ r''`` along it.
        correction: The step that the equations ask for with ``½ r''`` for residuals.
        predicted: The decrease of the objective that the linear problem predicts for ``δ``.
        length: The norm of the damping.
    """
    if bool(2.0 * length(correction) <= LONGEST * length(straight)):
        return Move(straight + correction, bend, predicted, correction)
    return Move(straight, None, predicted)


class Descent(ABC):
    """Trials of one step: the first that lowers the objective is accepted.

    A step that lowers it by less than half of what was predicted is halved as long as that helps,
    until its share is at most ``shortest``. Damping also shortens steps, but first in the
    directions that the residuals determine weakly, such as those of a curved valley.

    Args:
        objective: The objective at the start.
        shortest: Share of a step until which it is halved; 1: steps are not shortened.
    """

    def __init__(self, objective: float, *, shortest: float = 1.0) -> None:
        self.objective, self.shortest = objective, shortest

    @abstractmethod
    def proposed(self) -> Move | None:
        """Return the step at the present damping, ``None`` if its equations have no factor."""

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
            move = self.proposed()
            if move is not None:
                fall = self.objective - self.take(move)
                if fall < 0.5 * move.predicted and self.shortest < 1.0:
                    fall = self._shorter(move, fall)
                if fall > 0.0:
                    self.accepted(fall / max(move.predicted, 1e-300), first=trial == 0)
                    return True
            self.refused()
        return False

    def _shorter(self, move: Move, fall: float) -> float:
        """Put the best of shorter moves in place; return by how much it lowers the objective."""
        best, last, share = move, move, 1.0
        while share > self.shortest:
            share *= 0.5
            last = move.shortened(share)
            less = self.objective - self.take(last)
            if less > fall:
                best, fall = last, less
            elif fall > 0.0:
                break
        return fall if best is last else self.objective - self.take(best)
