"""Models with the posterior of their parameters: samples and intervals of rollouts."""

from __future__ import annotations

import copy
import logging
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from symo_exp.checks import real, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.roots import absolute
from symo_exp.models.flows import Flow
from symo_exp.models.starts import Fit
from symo_exp.optim.posterior import Posterior

log = logging.getLogger(__name__)

Module = TypeVar("Module", bound=nn.Module)
SAMPLES = 48
"""Rollouts behind an interval: two for each direction of a posterior, or so many samples."""
SEED = 0
SMALL = 1e-5
"""Length of a step in parameters beyond which rollouts are extrapolated from a shorter one.

Directions that the data hardly determine are long, and rollouts hardly change along them to first
order; a longer step would take the second order, which the posterior does not describe, for it."""

START_TIME = 0.2
"""Time [s] from which a start is known: its velocity is off by the error of a configuration over
this time."""


class Interval(NamedTuple):
    """Configurations between which a motion lies with the probability asked for."""

    lower: Float[Tensor, "*batch nodes n"]
    upper: Float[Tensor, "*batch nodes n"]


@dataclass(frozen=True)
class ModelPosterior:
    """The posterior of a model's parameters, and its error beyond it.

    Attributes:
        parameters: Posterior of all parameters, in their order.
        relative_error: Standard deviation (nodes, n) of recorded motions about the model's that the
            parameters do not explain, over the sensitivity of the rollout, by node; ``None`` where
            they explain the motions or none were held out.
    """

    parameters: Posterior
    relative_error: Float[Tensor, "nodes n"] | None = None

    def state(self) -> dict[str, Any]:
        """Return it as plain values and tensors."""
        return {**self.parameters._asdict(), "relative_error": self.relative_error}

    @staticmethod
    def of_state(state: dict[str, Any]) -> ModelPosterior:
        """Return it from what ``state`` gave."""
        fields = {name: state[name] for name in Posterior._fields if name in state}
        if state.get("error") is not None:
            log.warning(
                "intervals of this run, of an earlier version, are those of the parameters alone; "
                "train it again with resume=false to have them widened by the errors of recordings"
            )
        return ModelPosterior(Posterior(**fields), state.get("relative_error"))


@torch.no_grad()
def place(module: Module, flat: Float[Tensor, " p"]) -> Module:
    """Put a vector of parameters in place."""
    parameters = list(module.parameters())
    for p, part in zip(parameters, flat.split([p.numel() for p in parameters]), strict=True):
        p.copy_(part.view_as(p))
    return module


def sample(module: Module, posterior: ModelPosterior, count: int, seed: int) -> list[Module]:
    """Return copies of a module with parameters drawn from its posterior."""
    seed = whole_number("seed", seed, low=0, high=2**63 - 1)
    generator = torch.Generator().manual_seed(seed)
    drawn = posterior.parameters.samples(count, generator)
    return [place(copy.deepcopy(module), flat) for flat in drawn]


def known(posterior: ModelPosterior | None) -> ModelPosterior:
    """Return the posterior; refuse a model without one."""
    if posterior is None:
        raise ConfigError(
            "this model has no posterior: a run keeps one with optimizer=total_least_squares, "
            "levenberg_marquardt or adam_then_lm in float64, with the exceptions in "
            "docs/uncertainty.md"
        )
    return posterior


@torch.no_grad()
def interval(
    flow: Flow,
    posterior: ModelPosterior,
    q: Tensor,
    v: Tensor,
    u: Float[Tensor, "batch nodes m"],
    level: float,
) -> Interval:
    """Return the interval of rollouts, by linearisation or by samples, widened by the error.

    It is that of the posterior's mean in float64, whatever the parameters and the precision of the
    flow: its differences of rollouts would be lost in the rounding errors of float32.
    """
    level = real("level", level, above=0.0, below=1.0)
    mean = place(copy.deepcopy(flow).double(), posterior.parameters.mean)
    start = q.double(), v.double(), u.double()
    middle, _, converged = mean.rollout(*start)
    width = quantile(level) * variance(mean, posterior, *start, middle).sqrt()
    lost = (~(converged & middle[:, 1:].isfinite().all(2))).cumsum(1) > 0
    width[:, 1:] = width[:, 1:].masked_fill(lost.unsqueeze(2), torch.inf)
    middle = middle.where(middle.isfinite(), 0.0)
    return Interval((middle - width).to(q), (middle + width).to(q))


def quantile(level: float) -> float:
    """Return how many standard deviations on both sides hold this probability."""
    return float(torch.special.ndtri(torch.tensor(0.5 + 0.5 * level, dtype=torch.float64)))


def extended(error: Float[Tensor, "nodes n"], nodes: int) -> Float[Tensor, "nodes n"]:
    """Return an error for so many nodes; beyond its last node it continues to grow linearly."""
    last = len(error) - 1
    if nodes <= len(error) or last == 0:
        return error[:nodes] if nodes <= len(error) else error[-1:].expand(nodes, -1)
    beyond = torch.arange(last + 1, nodes).to(error).unsqueeze(1) / last
    return torch.cat((error, error[-1:] * beyond))


@torch.no_grad()
def variance(
    flow: Flow,
    posterior: ModelPosterior,
    q: Tensor,
    v: Tensor,
    u: Tensor,
    middle: Tensor,
    most: int = SAMPLES,
) -> Float[Tensor, "batch nodes n"]:
    """Return the variance of motions about rollouts: of the parameters, and the error beyond.

    The arguments are those of ``spread``.
    """
    found = spread(flow, posterior.parameters, q, v, u, middle, most)
    if posterior.relative_error is None:
        return found
    error = extended(posterior.relative_error, u.shape[1]).to(middle)
    return found + (error * sensitivity(flow, q, v, u, middle)).square()


@torch.no_grad()
def sensitivity(
    flow: Flow, q: Tensor, v: Tensor, u: Tensor, middle: Tensor
) -> Float[Tensor, "batch nodes n"]:
    """Return the standard deviation of rollouts from starts that are off by one unit.

    Each configuration is off by the unit ``ℓ`` of its coordinate and each velocity by
    ``ℓ / START_TIME``, independently. Rollouts that diverge have zero. The arguments are those of
    ``spread``.
    """
    fit = Fit(flow, middle, u, torch.ones_like(middle), sizes=flow.sizes)
    slopes = absolute(fit.at(torch.cat((q, v), dim=1)).slopes, flow.sizes)
    by_q, by_v = slopes.unflatten(1, middle.shape[1:]).chunk(2, dim=3)
    found = (by_q.square().sum(3) + by_v.square().sum(3) / START_TIME**2).sqrt()
    return absolute(found, flow.sizes)


@torch.no_grad()
def spread(
    flow: Flow,
    posterior: Posterior,
    q: Tensor,
    v: Tensor,
    u: Tensor,
    middle: Tensor,
    most: int = SAMPLES,
) -> Float[Tensor, "batch nodes n"]:
    """Return the variance of rollouts under the posterior; infinite where they diverge.

    Args:
        flow: The flow with the parameters of the posterior's mean.
        posterior: Posterior of its parameters.
        q: Configurations to start from.
        v: Velocities to start from.
        u: Controls at all nodes.
        middle: The rollouts of ``flow``.
        most: Number of rollouts, at most: two for each direction, or samples.
    """
    twin = copy.deepcopy(flow)
    total = torch.zeros_like(middle)
    linear = 2 * posterior.directions.shape[1] <= most
    if linear:
        steps = [step for way in posterior.informed().T for step in (way, -way)]
    else:
        drawn = posterior.samples(most, torch.Generator().manual_seed(SEED))
        steps = [*(drawn - posterior.mean)]
    for step in steps:
        share = min(1.0, SMALL / max(float(step.norm()), SMALL))
        path = place(twin, posterior.mean + share * step).rollout(q, v, u).q
        total = total + ((path - middle) / share).square()
    total = total / (2.0 if linear else len(steps))
    return total.nan_to_num(torch.inf, torch.inf)
