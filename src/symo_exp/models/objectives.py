"""Residuals minimised in training; the loss is their mean square.

=============================  ================================================  ================
``StateError``                 ``(q̂_{k+1} − q_{k+1}, v̂_{k+1} − v_{k+1})``         NODE, L-NODE
``Residual``                   ``g(q_{k−1}, q_k, q_{k+1})``                      SyMo
``PreconditionedResidual``     ``h H⁻¹ g(q_{k−1}, q_k, q_{k+1})``                SyMo
``RootError``                  ``q*_{k+1} − q_{k+1}``, ``g(…, q*_{k+1}) = 0``    E2E-SyMo
``horizon.HorizonError``       ``q̂_k − q_k`` over many steps, from fitted starts  all but SyMo
=============================  ================================================  ================

Here ``(q̂, v̂)`` is the flow's prediction, ``g`` the discrete Euler-Lagrange residual, ``H`` the
learned inertia, and ``q``, ``v`` are the data. Residuals are in units of coordinates or of momenta
(``system.scale``), which set the weight of lengths relative to angles. A further objective is one
class and a file in ``conf/objective`` that names it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import instance, one_of
from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.returned import checked_tensor, returned
from symo_exp.mechanics.roots import relative
from symo_exp.mechanics.types import TrainingSamples, Trajectory, Windows
from symo_exp.mechanics.variational import DiscreteExpansion, Forces, differentiable_root
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.flows import Flow, VariationalFlow
from symo_exp.nets.affine import Linearised, parameter_jacobian

Statistics = Mapping[str, Tensor]
NODES = 5
"""Nodes of the motion on which an objective is tried: no number of coordinates."""
NOTHING: Statistics = MappingProxyType({})


class Residuals(NamedTuple):
    """Residuals of a batch of windows.

    Attributes:
        values: A row for each sample.
        statistics: Further numbers, logged as means over the steps of an epoch.
    """

    values: Float[Tensor, "samples residuals"]
    statistics: Statistics = NOTHING

    @property
    def loss(self) -> Float[Tensor, ""]:
        """Their mean square."""
        return self.values.square().mean()


class Objective(ABC):
    """``(flow, windows) → residuals``, differentiable in the parameters of the flow."""

    consecutive: ClassVar[bool] = True
    """True if samples are windows of three consecutive nodes."""

    @abstractmethod
    def __call__(self, flow: Any, windows: Any) -> Residuals:
        """Return the residuals of each sample, for a flow of the kind that the objective needs."""

    def linearised(self, flow: Any, windows: Any, parameters: Sequence[Tensor]) -> Linearised:
        """Return the residuals of each sample with their derivatives in the parameters."""
        return parameter_jacobian(lambda: self(flow, windows).values, parameters)

    def cut(self, trajectories: Sequence[Trajectory]) -> TrainingSamples:
        """Return the samples of some trajectories."""
        return cut_windows(trajectories)

    def prepare(self, flow: Any, batches: Sequence[Any], epoch: int) -> Sequence[Any]:
        """Return the mini batches of an epoch; what stays the same over it is set."""
        return batches

    def require(self, parameters: Sequence[Tensor], optimizer: object) -> None:  # noqa: B027
        """Refuse parameters or an optimiser with which the objective does not work."""

    def branch_free(self, flow: Any) -> bool:
        """Return whether no operation depends on values, so that the loss can be compiled."""
        return False

    def as_forces(self, flow: Any, windows: Any) -> Objective | None:
        """Return the objective for the same equations as forces, ``None`` if it does not suit."""
        return None


def check_objective(objective: Any, model: Any) -> None:
    """Refuse an objective that fails for a body at rest, or returns no residuals.

    Args:
        objective: The objective, which may be a user's.
        model: The model to be trained.

    Raises:
        ConfigError: If it is none, or does not suit the method.
    """
    instance("objective", objective, Objective)
    if not objective.consecutive:
        return  # its samples extend over a number of nodes that only it knows
    flow, matrix = model.flow, model.input_matrix
    n, m = matrix.shape
    v, u = matrix.new_zeros(NODES, n), matrix.new_zeros(NODES, m)
    windows = cut_windows([Trajectory(flow.space.of_vector(v), v, u)])
    told = f"{type(objective).__name__}.__call__(flow, windows)"
    found = returned(told, objective, flow, windows)
    instance(f"the result of {told}", found, Residuals)
    count = len(windows.v)
    size = found.values.shape[1:] if isinstance(found.values, Tensor) else ()
    shape = (count, *(size if len(size) == 1 else (n,)))
    checked_tensor(f"values of {told}", found.values, shape, v.dtype, f"{count} windows")


class StateError(Objective):
    """``(q̂_{k+1} − q_{k+1}, v̂_{k+1} − v_{k+1})``: the error of the predicted state."""

    @override
    def __call__(self, flow: Flow, windows: Windows) -> Residuals:
        q, v, *_ = flow.predict(windows)
        error = flow.space.difference(windows.q_next, q)
        return Residuals(relative(torch.cat((error, v - windows.v_next), dim=1), flow.sizes))

    @override
    def branch_free(self, flow: Flow) -> bool:
        return flow.branch_free


class Residual(Objective):
    """``g = D₂L_d(q_{k−1}, q_k) + D₁L_d(q_k, q_{k+1}) + f⁺ + f⁻`` at the data [N s, N m s].

    The discrete Euler-Lagrange residual of the thesis (5.20). It scales with the learned inertia,
    so that under noise ``H → 0`` solves it.
    """

    @override
    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        return Residuals(relative(self.imbalance(flow, windows), flow.momentum_sizes))

    def imbalance(self, flow: VariationalFlow, windows: Windows) -> Float[Tensor, "samples n"]:
        """Return ``g`` [N s, N m s]."""
        if not isinstance(flow, VariationalFlow):
            raise ConfigError(
                f"{type(self).__name__} is a residual of variational integrators, which this "
                "method does not have; give model=symo or model=e2e_symo, or another objective"
            )
        q_prev, q, q_next, _, _, *controls = windows
        f_prev, f, f_next = map(flow.force, controls)
        before, after = Forces(f_prev, f), Forces(f, f_next)
        return flow.discrete.residual(q_prev, q, q_next, before, after)

    @override
    def branch_free(self, flow: VariationalFlow) -> bool:
        return not flow.integrator.iterates


class RelativeResidual(Residual):
    """``g`` over an impulse ``scale`` (n) [N s, N m s]: without it strong joints hide weak ones."""

    def __init__(self, scale: Float[Tensor, " n"]) -> None:
        self.scale = scale

    @override
    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        return Residuals(super().__call__(flow, windows).values / self.scale)


class PreconditionedResidual(Residual):
    """``h H⁻¹ g`` with ``H`` at ``(q_k + q_{k+1})/2``, in the units of the coordinates.

    This is one step of Newton's method from the datum ``q_{k+1}`` with ``−H/h``, the limit of the
    Jacobian for small steps: to first order the error of the root, without finding it. ``H`` is
    differentiated too; if it were held fixed, ``H → 0`` would remain a solution.
    """

    @override
    def as_forces(self, flow: VariationalFlow, windows: Windows) -> Residual | None:
        """Return ``g`` relative to the inputs where these act: without them ``H → 0`` solves it."""
        if flow.space.rotations:
            return None
        impulse = relative(flow.time_step * flow.force(windows.u), flow.momentum_sizes)
        scale = impulse.square().mean(0).sqrt()
        if not bool(scale.any()):
            return None
        return RelativeResidual(scale.where(scale > 0.0, scale.max()))

    @override
    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        g = self.imbalance(flow, windows)
        mass = flow.lagrangian.mass_matrix(flow.space.middle(windows.q, windows.q_next))
        return Residuals(relative(flow.time_step * solve(mass, g), flow.sizes))


class RootError(Objective):
    """``q*_{k+1} − q_{k+1}`` with ``g(q_{k−1}, q_k, q*_{k+1}) = 0`` (thesis (5.28)).

    The root is differentiated by the implicit function theorem.

    Args:
        guess: Start of the search. ``"datum"`` is the configuration to be predicted: the more
            accurate the model, the fewer iterations follow, in the end one. ``"inertial"``,
            uniform motion, is the start in the thesis and in all predictions.
        fallback: Whether the residual of a row without a root, which has no implicit gradient, is
            the preconditioned one, the error to first order. Otherwise the last iterate is taken
            for a root, as in the thesis.
    """

    def __init__(
        self, *, guess: Literal["datum", "inertial"] = "datum", fallback: bool = True
    ) -> None:
        one_of("model.guess", guess, ("datum", "inertial"))
        self.guess, self.fallback = guess, fallback

    @override
    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        impulse = self.impulse(flow, windows, flow.expand_before(windows))
        problem = flow.matching(windows.q, impulse, flow.forces(windows.u, windows.u_next))
        root = flow.root.solve(problem, problem.start(self.initial_guess(flow, windows)))
        at, ok = root.evaluation.expansion, root.converged
        x = root.x[:, : impulse.shape[1]]
        statistics = {
            "newton_iterations": root.iterations.float().mean(),
            "newton_failed": (~ok).float().mean(),
        }
        if not self.fallback or bool(ok.all()):
            return Residuals(self.error(flow, windows, impulse, x, at, at.d2d1()), statistics)
        # Both residuals are computed for all rows, so that rows can be differentiated separately.
        jacobian = torch.where(ok[:, None, None], at.d2d1(), torch.eye(x.shape[1]).to(x))
        known = self.error(flow, windows, impulse, x, at, jacobian)
        instead, _ = PreconditionedResidual()(flow, windows)
        return Residuals(torch.where(ok[:, None], known, instead), statistics)

    def initial_guess(self, flow: VariationalFlow, windows: Windows) -> Tensor:
        """Return the start of the search."""
        inertial = self.guess == "inertial"
        return flow.space.extrapolated(windows.q_prev, windows.q) if inertial else windows.q_next

    def impulse(self, flow: VariationalFlow, windows: Windows, at: DiscreteExpansion) -> Tensor:
        """Return ``p_k + f⁻``, given the expansion of ``L_d`` around ``(q_{k−1}, q_k)``."""
        forces = flow.forces(windows.u, windows.u_next)
        f_minus, _ = flow.discrete.impulses(forces)
        return flow.momentum_before(windows, at) + f_minus

    def error(
        self, flow: VariationalFlow, windows: Windows, impulse: Tensor,
        x: Tensor, at: DiscreteExpansion, jacobian: Tensor,
    ) -> Tensor:  # fmt: skip
        """Return the error of the root ``x``, around which ``L_d`` is expanded."""
        forces = flow.forces(windows.u, windows.u_next)
        root = differentiable_root(x, at, jacobian, windows.q, impulse, flow.space, forces)
        return relative(flow.space.difference(windows.q_next, root), flow.sizes)
