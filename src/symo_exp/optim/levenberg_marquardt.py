"""The Levenberg-Marquardt method on the residuals of all samples, with geodesic acceleration."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import real, whole_number
from symo_exp.mechanics.types import TrainingSamples
from symo_exp.optim.base import EpochOptimizer, Equations, Problem, concatenated
from symo_exp.optim.damped import DampedSystem
from symo_exp.optim.descent import PROBE, Descent, Move, accelerated
from symo_exp.optim.robust import median_of_rows, weights_beyond

FALLS = 0.9
"""Ratio of training losses between two held-out losses below which the loss counts as falling."""
TRIALS = 8
"""Trials of one step."""
CHUNK = 1024
"""Samples in a piece of ``J``."""
LIMIT = 1e12
"""The damping at which a refused step ends the training."""
EQUATIONS = 8
"""Equations for each parameter while residuals are forces."""


class LevenbergMarquardt(EpochOptimizer):
    """``(JᵀJ + λ s I) δ = −Jᵀ r`` on all samples: one accepted step an epoch (Levenberg 1944).

    ``r`` are the residuals divided by the root of their number, ``J`` their derivatives in the
    parameters, in float64; ``s`` is the largest entry of the diagonal of ``JᵀJ``. (With that
    diagonal itself, as in Marquardt's rule, parameters without influence diverge, and trainings end
    far from data that they could fit to rounding.) The step is accelerated (see ``descent``). ``λ``
    is multiplied by ``max(⅓, 1 − (2ρ − 1)³)`` after a step that lowers
    ``‖r‖²`` by ``ρ`` times the predicted decrease, and by 2, 4, 8, … after steps that do not lower
    it (Nielsen 1999); after eight of these the epoch ends. It is ``finished`` if no step lowers the
    loss and ``λ`` passes 1e12.

    The first ``force_epochs`` minimise the residuals as forces, where the problem has them, each on
    as many samples as have eight equations for each parameter. Forces are linear in inertias and in
    friction, and a quadratic function of factors of these has hardly any poor minimum (Burer and
    Monteiro 2003), while accelerations ``H⁻¹ F`` are also small with an infinite inertia, which
    training on them may approach. These epochs end early when no step lowers the loss.

    The system is solved by Cholesky in the space of the parameters or, for a wide network, in that
    of the residuals, whichever is smaller.

    Args:
        params: The parameters, float64.
        damping: Initial ``λ``.
        force_epochs: Epochs at the start in which residuals are forces.
        shortest: Share of a step until which it is halved before the damping is raised. Where few
            data determine many parameters, 0.03 takes a tenth of the epochs; where residuals stay
            large, 1, no shortening, takes fewer.
        huber: Samples whose residuals are longer than this many times the median length count
            linearly (Huber 1964), so that a few that no model fits, such as motions too fast for
            the time step, do not decide; null: all count quadratically.
        patience: Number of held-out losses without improvement.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        *,
        damping: float = 1e-3,
        force_epochs: int = 0,
        shortest: float = 1.0,
        huber: float | None = None,
        patience: int = 20,
    ) -> None:
        real("optimizer.damping", damping, above=0)
        whole_number("optimizer.force_epochs", force_epochs, low=0)
        real("optimizer.shortest", shortest, above=0, high=1)
        if huber is not None:
            real("optimizer.huber", huber, above=0)
        super().__init__(params, patience=patience)
        self.require_normal_equations()
        self.shortest, self.huber = shortest, huber
        self.initial_damping = damping
        self.memory |= {"damping": damping, "loss": math.inf, "asked": math.inf}
        self.memory["forces"] = force_epochs

    @property
    def damping(self) -> float:
        """``λ``."""
        return float(self.memory["damping"])

    @override
    def epoch(self, model: Problem, batches: Sequence[TrainingSamples]) -> dict[str, Tensor]:
        samples = concatenated(batches)
        forces = model.as_forces(samples) if self.memory["forces"] else None
        if forces is not None:
            samples = self._few(forces, samples)
        descent = _Trials(self, forces or model, samples)
        stuck = not descent.run(TRIALS)
        if stuck:
            self.place(descent.start)
            self.finished = forces is None and self.damping >= LIMIT
        if self.memory["forces"]:
            self.memory["forces"] = 0 if stuck or forces is None else self.memory["forces"] - 1
            if not self.memory["forces"]:
                self.memory["damping"] = self.initial_damping
        self.memory["loss"] = descent.objective
        squares = descent.system.r @ descent.system.r
        return {"train_loss": squares, "damping": torch.tensor(self.damping)}

    @override
    def estimate(self) -> dict[str, Any]:
        return {}

    @override
    def falls(self) -> bool:
        if self.memory["forces"]:
            return True
        before, self.memory["asked"] = self.memory["asked"], self.memory["loss"]
        return bool(self.memory["loss"] < FALLS * before)

    def damp(self, factor: float) -> None:
        """Multiply the damping."""
        self.memory["damping"] = min(max(self.damping * factor, 1e-16), 1e16)

    def _few(self, equations: Equations, samples: TrainingSamples) -> TrainingSamples:
        """Return samples with about ``EQUATIONS`` equations for each parameter, spread over all."""
        with torch.no_grad():
            per_sample = equations.residuals(samples.rows(slice(1))).shape[1]
        count = -(-EQUATIONS * len(self.flat()) // per_sample)
        return samples.rows(slice(None, None, max(1, len(samples.q) // count)))


class _Trials(Descent):
    """Trials of one step."""

    def __init__(
        self, owner: LevenbergMarquardt, model: Equations, samples: TrainingSamples
    ) -> None:
        self.start = owner.flat()
        self._owner, self._model, self._samples = owner, model, samples
        self._growth = 2.0
        self._factors: Float[Tensor, " equations"] | None = None
        with torch.no_grad():
            per_sample = model.residuals(samples.rows(slice(1))).shape[1]
        owner.require_memory(len(samples.q) * per_sample, copies=2)
        pieces = [model.linearised(rows, owner.parameters) for rows in _chunks(samples)]
        residuals = torch.cat([piece.residuals.flatten() for piece in pieces])
        jacobians = [piece.parameters.flatten(0, 1) for piece in pieces]
        if owner.huber is not None:
            length = residuals.view(len(samples.q), -1).norm(dim=1)
            factors = weights_beyond(owner.huber * median_of_rows(length), length).sqrt()
            self._factors = factors.repeat_interleave(per_sample)
            residuals = self._factors * residuals
            parts = self._factors.split([len(j) for j in jacobians])
            for jacobian, part in zip(jacobians, parts, strict=True):
                jacobian.mul_(part.unsqueeze(-1))
        self.system = DampedSystem(residuals, jacobians)
        super().__init__(float(self.system.r @ self.system.r), shortest=owner.shortest)

    @override
    def proposed(self) -> Move | None:
        system = self.system
        factor = system.factor(self._owner.damping)
        if factor is None:
            return None
        straight = system.towards_zero(factor, system.r)
        linear = system.change(straight)
        there = system.scale * self.residuals(PROBE * straight)
        bend = (there - system.r - PROBE * linear) / PROBE**2
        correction = system.towards_zero(factor, bend)
        predicted = -float(linear @ (2.0 * system.r + linear))
        return accelerated(straight, bend, correction, predicted, torch.linalg.vector_norm)

    @override
    def take(self, move: Move) -> float:
        return float(self.residuals(move.step).square().mean())

    @override
    def accepted(self, gain: float, *, first: bool) -> None:
        self._owner.damp(max(1.0 / 3.0, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3))

    @override
    def refused(self) -> None:
        self._owner.damp(self._growth)
        self._growth *= 2.0

    @torch.no_grad()
    def residuals(self, step: Tensor) -> Float[Tensor, " equations"]:
        """Return the residuals after a step, which is left in place."""
        self._owner.place(self.start + step)
        pieces = [self._model.residuals(w).flatten() for w in _chunks(self._samples)]
        residuals = torch.cat(pieces)
        return residuals if self._factors is None else self._factors * residuals


def _chunks(samples: TrainingSamples) -> Iterator[TrainingSamples]:
    for start in range(0, len(samples.q), CHUNK):
        yield samples.rows(slice(start, start + CHUNK))
