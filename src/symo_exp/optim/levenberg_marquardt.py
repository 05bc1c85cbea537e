"""The Levenberg-Marquardt method on the residuals of all samples."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Windows
from symo_exp.nets.affine import parameter_jacobian
from symo_exp.optim.base import EpochOptimizer, Problem, whole


class LevenbergMarquardt(EpochOptimizer):
    """``(JᵀJ + λ I) δ = −Jᵀ r`` on all samples: one accepted step an epoch (Marquardt 1963).

    ``r`` are the residuals divided by the root of their number, ``J`` their derivatives in the
    parameters, in float64. ``λ`` is divided by ``success`` when a step lowers ``‖r‖²`` and
    multiplied by ``failure`` when it does not; after ``trials`` failures the epoch ends. The
    system is solved by Cholesky in the smaller of two spaces: that of the parameters, or, for a
    wide network, that of the residuals, ``δ = −Jᵀ (J Jᵀ + λ I)⁻¹ r``. ``J`` is made in pieces of
    ``chunk`` samples; in parameter space only ``JᵀJ`` is kept.

    Where no step lowers the loss and ``λ`` passes 1e12, it is ``finished``.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        *,
        damping: float = 1e-3,
        success: float = 3.0,
        failure: float = 4.0,
        trials: int = 8,
        patience: int = 20,
        chunk: int = 1024,
    ) -> None:
        limits = ("damping", damping, 0.0), ("success", success, 1.0), ("failure", failure, 1.0)
        for name, value, low in (*limits, ("trials", trials, 0), ("chunk", chunk, 0)):
            if not value > low:
                raise ConfigError(f"optimizer.{name}={value}: expected a number above {low:g}")
        super().__init__(params, patience=patience)
        if any(p.dtype != torch.float64 for p in self.parameters):
            raise ConfigError(
                "Levenberg-Marquardt squares the condition of the problem: it needs dtype=float64"
            )
        self.success, self.failure, self.trials, self.chunk = success, failure, trials, chunk
        self.memory["damping"] = damping

    @property
    def damping(self) -> float:
        """``λ``."""
        return float(self.memory["damping"])

    def epoch(self, model: Problem, batches: Sequence[Windows]) -> dict[str, Tensor]:
        samples = whole(batches)
        system = self._normal_equations(model, samples)
        start, before, accepted = self.flat(), system.loss, False
        for _ in range(self.trials):
            step = system.step(self.damping)
            if step is not None:
                self.place(start + step)
                accepted = bool(self._loss(model, samples) < before)
            following = self.damping / self.success if accepted else self.damping * self.failure
            self.memory["damping"] = min(max(following, 1e-16), 1e16)
            if accepted:
                break
        if not accepted:
            self.place(start)
            self.finished = self.damping >= 1e12
        return {"train_loss": before, "damping": torch.tensor(self.damping)}

    def _normal_equations(self, model: Problem, samples: Windows) -> _System:
        size = len(self.flat())
        with torch.no_grad():
            per_sample = model.residuals(samples.rows(slice(1))).shape[1]
        equations = len(samples.q) * per_sample
        wide, scale = size > equations, 1.0 / math.sqrt(equations)
        self._require(size, equations, per_sample, wide)
        pieces = (self._linearised(model, rows) for rows in _chunks(samples, self.chunk))
        if wide:
            values, jacobians = (scale * torch.cat(x) for x in zip(*pieces, strict=True))
            return _System(jacobians @ jacobians.T, values, values @ values, jacobians)
        gram = self.parameters[0].new_zeros(size, size)
        gradient = self.parameters[0].new_zeros(size)
        loss = self.parameters[0].new_zeros(())
        for r, jacobian in pieces:
            _add_gram(gram, jacobian)
            gradient += jacobian.T @ r
            loss += r @ r
        gram *= scale * scale
        return _System(gram, gradient * (scale * scale), loss * (scale * scale))

    def _linearised(self, model: Problem, samples: Windows) -> tuple[Tensor, Tensor]:
        """``r`` and ``J``, a row each residual."""
        r, jacobian, _ = parameter_jacobian(lambda: model.residuals(samples), self.parameters)
        return r.flatten(), jacobian.flatten(0, 1)

    def _loss(self, model: Problem, samples: Windows) -> Tensor:
        with torch.no_grad():
            pieces = [model.residuals(w).square() for w in _chunks(samples, 1024)]
        return torch.cat(pieces).mean()

    def _require(self, size: int, equations: int, per_sample: int, wide: bool) -> None:
        """Refuse at once what would not fit into memory."""
        if self.parameters[0].device.type != "cpu":
            return
        rows = equations if wide else min(equations, self.chunk * per_sample)
        side = min(size, equations)
        needed = 8 * (2 * rows * size + 3 * side * side)
        free = available_bytes()
        if free is not None and needed > free:
            raise ConfigError(
                f"Levenberg-Marquardt needs about {needed / 1e9:.1f} GB for {size} parameters and "
                f"{equations} residuals, and {free / 1e9:.1f} GB are free; use a smaller "
                "model.width, fewer trajectories (data.n_traj), or optimizer=adam or lbfgs"
            )


class _System(NamedTuple):
    """``(gram + λ I) x = right``; the step is ``−x``, or ``−Jᵀ x`` in the space of residuals."""

    gram: Tensor
    right: Tensor
    loss: Tensor
    jacobian: Tensor | None = None

    def step(self, damping: float) -> Tensor | None:
        """``δ``, or nothing where the matrix is not positive definite in floating point."""
        damped = self.gram.clone()
        damped.diagonal().add_(damping)
        factor, info = torch.linalg.cholesky_ex(damped)
        if int(info) != 0:
            return None
        x = torch.cholesky_solve(self.right.unsqueeze(-1), factor).squeeze(-1)
        return -x if self.jacobian is None else -(self.jacobian.T @ x)


def _add_gram(gram: Float[Tensor, "p p"], jacobian: Float[Tensor, "rows p"]) -> None:
    """Add the lower triangle of ``JᵀJ``, in blocks: about half of the work of all of it."""
    size = jacobian.shape[1]
    block = max(128, -(-size // 8))
    for start in range(0, size, block):
        end = min(start + block, size)
        gram[start:, start:end].addmm_(jacobian[:, start:].T, jacobian[:, start:end])


def _chunks(samples: Windows, size: int) -> Iterator[Windows]:
    for start in range(0, len(samples.q), size):
        yield samples.rows(slice(start, start + size))


def available_bytes() -> int | None:
    """Physical memory that is free now, or that there is at all; ``None`` where unknown."""
    try:
        free = "SC_AVPHYS_PAGES" in os.sysconf_names
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf(
            "SC_AVPHYS_PAGES" if free else "SC_PHYS_PAGES"
        )
    except (AttributeError, ValueError, OSError):
        return None
