"""The error over many steps from fitted starts, robustly weighted (``objective=horizon``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import real, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.chart import Ends
from symo_exp.mechanics.roots import relative
from symo_exp.mechanics.rows import take_rows
from symo_exp.mechanics.types import Stretches, Trajectory
from symo_exp.mechanics.windows import cut_stretches
from symo_exp.models.flows import Flow, chained
from symo_exp.models.objectives import Objective, Residuals
from symo_exp.models.starts import State, closest_start, fitted_start
from symo_exp.nets.affine import Linearised
from symo_exp.optim.base import EpochOptimizer, concatenated
from symo_exp.optim.robust import huber_weights

LOST = 10.0
"""An error beyond which a motion does not follow the data any more [units of coordinates]."""
ROUNDS = 3
"""Fits of the starts, each with the weights that the last one gave."""
ITERATIONS = 6
"""Iterations of a fit at most; the next one goes on from where it ended."""
ROWS = 4096
"""Steps that are linearised at once."""


class HorizonError(Objective):
    """``√w_k (q̂_k − q_k)`` over stretches of ``N`` steps, from the start that fits each best.

    ``min_θ Σ_stretches min_{q₀, v₀} Σ_{k=0}^{N} w_k |q̂_k(q₀, v₀; θ) − q_k|²``

    Configurations alone are read, by every method. The error of a rotation is a rotation vector,
    and errors are in the units of the coordinates.
    The weights ``w`` are those of Huber's loss at the start of an epoch, with a threshold of
    ``huber`` standard deviations of the errors of each coordinate (``robust.huber_weights``).

    The starts are unknowns of their own, eliminated stretch by stretch (variable projection, Golub
    and Pereyra 1973): their derivatives are ``(I − P) J_θ``, with ``P`` the projection on the
    columns of ``J_{q₀, v₀}`` (Kaufman 1975). This makes the gradient of the loss exact.
    Gauss-Newton steps have ``J`` from the derivatives of single steps by the chain rule, forwards
    along each stretch; gradients alone are found backwards.

    A stretch whose motion is lost (an error above 10, or a step without a root) has constant
    residuals; ``lost`` is their share.

    Args:
        horizon: Steps ``N`` of a stretch, at least 2: a start alone fits two nodes exactly.
        stride: Steps between the starts of stretches; ``None``: ``horizon``.
        huber: Threshold in standard deviations; ``None``: all weights are one.
        grow: Epochs after which the steps double, from 2 on up to ``horizon``: an untrained model
            follows no motion for long. 0: ``horizon`` steps from the first epoch on.

    Raises:
        ConfigError: If a number is out of range.
    """

    consecutive = False

    def __init__(
        self,
        *,
        horizon: int = 10,
        stride: int | None = None,
        huber: float | None = 1.345,
        grow: int = 5,
    ) -> None:
        if horizon < 2:
            raise ConfigError(
                f"objective.horizon={horizon}: expected 2 steps or more, since a start alone fits "
                "two nodes exactly"
            )
        if stride is not None:
            whole_number("objective.stride", stride)
        if huber is not None:
            real("objective.huber", huber, above=0)
        whole_number("objective.grow", grow, low=0)
        self.horizon, self.stride = horizon, stride or horizon
        self.huber, self.grow = huber, grow

    @override
    def require(self, parameters: Sequence[Tensor], optimizer: object) -> None:
        if isinstance(optimizer, EpochOptimizer) and optimizer.reads_trajectories:
            raise ConfigError(
                f"objective=horizon: {type(optimizer).__name__} takes residuals of three nodes; "
                "choose optimizer=levenberg_marquardt, adam_then_lm, lbfgs or adam"
            )
        if any(p.dtype != torch.float64 for p in parameters):
            raise ConfigError(
                "objective=horizon fits starts by differences: it needs dtype=float64"
            )

    @override
    def cut(self, trajectories: Sequence[Trajectory]) -> Stretches:
        found = cut_stretches(trajectories, self.horizon, self.stride)
        if len(found.q) == 0:
            longest = max(len(one.q) for one in trajectories) - 1
            raise ConfigError(
                f"objective.horizon={self.horizon}: the longest of these trajectories has "
                f"{longest} steps; choose at most objective.horizon={longest}"
            )
        return found

    def steps(self, epoch: int) -> int:
        """Return the steps that count in an epoch; the first epoch is 0."""
        doublings = min(epoch // self.grow, 60) if self.grow else 60
        return min(self.horizon, 2 ** (1 + doublings))

    @override
    def prepare(self, flow: Flow, batches: Sequence[Stretches], epoch: int) -> list[Stretches]:
        """Return the stretches of an epoch with their weights and the starts that fits begin from.

        Starts and weights are found in turns: a start that fits an outlier hides it.
        """
        nodes = 1 + self.steps(epoch)
        counts = [len(batch.q) for batch in batches]
        q, u, start, weight = concatenated(batches)
        whole = Stretches(q[:, :nodes], u[:, :nodes], start, weight[:, :nodes])
        for _ in range(1 if self.huber is None else ROUNDS):
            found = _fit(flow, whole)
            place = flow.space.chart(whole.q[:, 0], found.start.q)
            whole = whole._replace(start=torch.cat((place, found.start.v), dim=1))
            if self.huber is not None:
                whole = whole._replace(weight=huber_weights(found.errors, self.huber))
        fields = zip(*(field.split(counts) for field in whole), strict=True)
        return [Stretches(*batch) for batch in fields]

    @override
    def __call__(self, flow: Flow, windows: Stretches) -> Residuals:
        found = _fit(flow, windows)
        values = found.values()
        kept = found.follows.nonzero().squeeze(-1)
        if torch.is_grad_enabled() and len(kept):
            values = values.index_copy(0, kept, self._backwards(flow, take_rows(found, kept)))
        return Residuals(values, {"lost": (~found.follows).double().mean()})

    @override
    def linearised(
        self, flow: Flow, windows: Stretches, parameters: Sequence[Tensor]
    ) -> Linearised:
        found = _fit(flow, windows)
        values = found.values()
        size = sum(p.numel() for p in parameters)
        jacobian = values.new_zeros(*values.shape, size)
        for kept in found.follows.nonzero().squeeze(-1).split(max(1, ROWS // self.horizon)):
            by_start, by_theta = _forwards(flow, take_rows(found, kept), parameters)
            jacobian[kept] = by_theta - _projected(by_start, by_theta)
        return Linearised(values, jacobian, ())

    def _backwards(self, flow: Flow, found: _Fitted) -> Float[Tensor, "stretches errors"]:
        """Return residuals with a graph of their motions."""
        by_start, _ = _forwards(flow, found, ())
        # step by step, since several steps solved at once have no graph
        path, *_ = Flow.advance_all(flow, found.start.q, flow.encode(*found.start), found.u)
        errors = flow.space.difference(found.measured, path)
        values = (found.root * relative(errors, flow.sizes)).flatten(1)
        change = (values - values.detach()).unsqueeze(-1)
        return values.detach() + (change - _projected(by_start, change)).squeeze(-1)


class _Fitted(NamedTuple):
    """Motions of a flow that fit stretches best."""

    start: State
    q: Float[Tensor, "stretches nodes n"]
    v: Float[Tensor, "stretches nodes n"]
    u: Float[Tensor, "stretches nodes m"]
    measured: Float[Tensor, "stretches nodes n"]
    """``q``."""
    errors: Float[Tensor, "stretches nodes n"]
    """``q̂ − q`` in the units of the coordinates, bounded."""
    root: Float[Tensor, "stretches nodes n"]
    """``√w``."""
    follows: Bool[Tensor, " stretches"]
    """Stretches that are not lost."""

    def values(self) -> Float[Tensor, "stretches errors"]:
        """Return the residuals ``√w (q̂ − q)``."""
        return (self.root * self.errors).flatten(1)


@torch.no_grad()
def _fit(flow: Flow, stretches: Stretches) -> _Fitted:
    q, u, begin, weight = stretches
    if not begin.isfinite().all():
        begin = closest_start(flow, q, u, flow.space, flow.sizes)
    start = fitted_start(flow, q, u, ITERATIONS, weight, begin, flow.space, flow.sizes)
    path = flow.rollout(*start, u)
    errors = relative(flow.space.difference(q, path.q), flow.sizes)
    follows = path.converged.all(1) & (errors.abs() < LOST).flatten(1).all(1)
    bounded = errors.nan_to_num(LOST, LOST, -LOST).clamp(-LOST, LOST)
    return _Fitted(start, path.q, path.v, u, q, bounded, weight.sqrt(), follows)


def _projected(
    columns: Float[Tensor, "stretches errors k"], changes: Float[Tensor, "stretches errors p"]
) -> Float[Tensor, "stretches errors p"]:
    """Return the orthogonal projection on the columns."""
    basis = torch.linalg.qr(columns)[0]
    return basis @ (basis.mT @ changes)


def _forwards(
    flow: Flow, found: _Fitted, parameters: Sequence[Tensor]
) -> tuple[Float[Tensor, "stretches errors 2*n"], Float[Tensor, "stretches errors p"]]:
    """Return the derivatives of residuals in the starts ``(q₀, y₀)`` and in the parameters.

    The steps ``x_{k+1} = F(x_k, θ)`` of the state ``x = (q, y)`` that a rollout carries are
    linearised all at once, along rotations; then ``S_{k+1} = F_x S_k + F_θ``, from
    ``S₀ = (I, 0)`` on. The projection that follows does not depend on the coordinates of the
    start, ``y₀`` or ``v₀``.
    """
    space, (count, nodes, n) = flow.space, found.v.shape
    by_state, by_theta = flow.step_slopes(found.q, found.v, found.u, parameters)
    identity = torch.eye(2 * n).to(found.q).expand(count, -1, -1)
    start = chained(by_state, identity)
    theta = chained(by_state, torch.zeros_like(by_theta[:, 0]), by_theta)
    motions = (x[:, :, :n] for x in (start, theta))
    if not space.rotations:
        by_start, by_parameters = motions
    else:  # of errors along the step from the data
        turned = Ends.of(space, found.errors.flatten(0, 1)).inverse.unflatten(0, (count, nodes))
        by_start, by_parameters = (turned @ x for x in motions)
    root = relative(found.root, flow.sizes).flatten(1).unsqueeze(-1)
    return root * by_start.flatten(1, 2), root * by_parameters.flatten(1, 2)
