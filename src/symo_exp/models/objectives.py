"""Objectives: what of a flow is made small in training. The loss is the mean square of

=============================  ================================================  ================
``StateError``                 ``(q̂_{k+1} − q_{k+1}, v̂_{k+1} − v_{k+1})``         NODE, L-NODE
``Residual``                   ``g(q_{k−1}, q_k, q_{k+1})``                      SyMo
``PreconditionedResidual``     ``h H⁻¹ g(q_{k−1}, q_k, q_{k+1})``                SyMo
``RootError``                  ``q*_{k+1} − q_{k+1}``, ``g(…, q*_{k+1}) = 0``    E2E-SyMo
=============================  ================================================  ================

with the flow's prediction ``(q̂, v̂)``, the discrete Euler-Lagrange residual ``g``, the learned
inertia ``H`` and the data ``q``, ``v``. An objective of your own is one class here or elsewhere and
a file in ``conf/objective`` that names it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.euler_lagrange import generalised_force
from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import DiscreteExpansion, Forces, differentiable_root
from symo_exp.models.flows import Flow, VariationalFlow

Statistics = Mapping[str, Tensor]
NOTHING: Statistics = MappingProxyType({})


class Residuals(NamedTuple):
    """What an objective finds on a batch of windows."""

    values: Float[Tensor, "samples residuals"]
    statistics: Statistics = NOTHING
    """Numbers worth a curve, logged as means over the steps of an epoch."""

    @property
    def loss(self) -> Float[Tensor, ""]:
        """The mean square."""
        return self.values.square().mean()


class Objective(ABC):
    """``(flow, windows) → residuals``, differentiable in the parameters of the flow."""

    @abstractmethod
    def __call__(self, flow: Any, windows: Windows) -> Residuals:
        """The residuals of each sample; ``flow`` is of the kind that the objective is for."""

    def branch_free(self, flow: Any) -> bool:
        """Whether no operation depends on the value of a number, so that all of it can be compiled;
        no, unless an objective says so."""
        return False


class StateError(Objective):
    """``(q̂_{k+1} − q_{k+1}, v̂_{k+1} − v_{k+1})``: the error of the predicted state."""

    def __call__(self, flow: Flow, windows: Windows) -> Residuals:
        q, v, *_ = flow.predict(windows)
        return Residuals(torch.cat((q - windows.q_next, v - windows.v_next), dim=1))

    def branch_free(self, flow: Flow) -> bool:
        return flow.branch_free


class Residual(Objective):
    """``g = D₂L_d(q_{k−1}, q_k) + D₁L_d(q_k, q_{k+1}) + f⁺ + f⁻`` at the data [N s].

    The discrete Euler-Lagrange residual of the thesis (5.20). It scales with the learned inertia,
    so that under noise ``H → 0`` solves it.
    """

    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        q_prev, q, q_next, _, _, *controls = windows
        f_prev, f, f_next = (generalised_force(flow.input_matrix, u) for u in controls)
        before, after = Forces(f_prev, f), Forces(f, f_next)
        return Residuals(flow.discrete.residual(q_prev, q, q_next, before, after))

    def branch_free(self, flow: VariationalFlow) -> bool:
        return not flow.integrator.iterates


class PreconditionedResidual(Residual):
    """``h H⁻¹ g`` with ``H`` at ``(q_k + q_{k+1})/2``, in the units of the coordinates.

    One step of Newton's method from the datum ``q_{k+1}`` with ``−H/h``, the limit of the Jacobian
    for small steps: to first order the error of the root, without finding it. ``H`` is
    differentiated like everything else; held fixed, ``H → 0`` would remain a way out.
    """

    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        g, _ = super().__call__(flow, windows)
        mass = flow.lagrangian.mass_matrix(0.5 * (windows.q + windows.q_next))
        return Residuals(flow.time_step * solve(mass, g))


class RootError(Objective):
    """``q*_{k+1} − q_{k+1}`` with ``g(q_{k−1}, q_k, q*_{k+1}) = 0`` (thesis (5.28)).

    The root is differentiated by the implicit function theorem. The search starts from the
    configuration that it is to meet, ``guess="datum"``: the nearer the model is to the truth the
    fewer steps it takes, soon one. ``guess="inertial"``, uniform motion, is that of the thesis and
    of every prediction.

    A row whose root is not found has no implicit gradient. With ``fallback`` its residual is the
    preconditioned one: the error of the root to first order. Without it the last iterate is taken
    for a root, as in the thesis.
    """

    def __init__(
        self, *, guess: Literal["datum", "inertial"] = "datum", fallback: bool = True
    ) -> None:
        if guess not in ("datum", "inertial"):
            raise ValueError(f"guess must be datum or inertial, got {guess}")
        self.guess, self.fallback = guess, fallback

    def __call__(self, flow: VariationalFlow, windows: Windows) -> Residuals:
        impulse = self.impulse(flow, windows, flow.expand_before(windows))
        problem = flow.matching(windows.q, impulse, flow.forces(windows.u, windows.u_next))
        root = flow.root.solve(problem, problem.start(self.initial_guess(windows)))
        at, ok = root.evaluation.expansion, root.converged
        x = root.x[:, : windows.q.shape[1]]
        statistics = {
            "newton_iterations": root.iterations.float().mean(),
            "newton_failed": (~ok).float().mean(),
        }
        if not self.fallback or bool(ok.all()):
            return Residuals(self.error(flow, windows, impulse, x, at, at.d2d1()), statistics)
        # Every row goes both ways, so that each of them remains a row to whoever differentiates.
        jacobian = torch.where(ok[:, None, None], at.d2d1(), torch.eye(x.shape[1]).to(x))
        known = self.error(flow, windows, impulse, x, at, jacobian)
        instead, _ = PreconditionedResidual()(flow, windows)
        return Residuals(torch.where(ok[:, None], known, instead), statistics)

    def initial_guess(self, windows: Windows) -> Tensor:
        """Where the search starts."""
        inertial = self.guess == "inertial"
        return 2.0 * windows.q - windows.q_prev if inertial else windows.q_next

    def impulse(self, flow: VariationalFlow, windows: Windows, at: DiscreteExpansion) -> Tensor:
        """``p_k + f⁻``, which does not depend on ``q_{k+1}``; ``at`` expands ``L_d`` before it."""
        forces = flow.forces(windows.u, windows.u_next)
        f_minus, _ = flow.discrete.impulses(forces)
        return flow.momentum_before(windows, at) + f_minus

    def error(
        self, flow: VariationalFlow, windows: Windows, impulse: Tensor,
        x: Tensor, at: DiscreteExpansion, jacobian: Tensor,
    ) -> Tensor:  # fmt: skip
        """That of the root ``x``, around which ``L_d`` was expanded, with implicit derivatives."""
        forces = flow.forces(windows.u, windows.u_next)
        root = differentiable_root(x, at, jacobian, windows.q, impulse, forces)
        return root - windows.q_next
