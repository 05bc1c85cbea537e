"""The dynamics model: a flow with an interface for states in any form."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Literal

import torch
from torch import Tensor, nn

from symo_exp.checks import instance, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.mechanics.units import SI
from symo_exp.models.control import Linear, inverse_dynamics, linearize
from symo_exp.models.flows import Flow, Rollout, Step
from symo_exp.models.inference import leaves_inference_mode
from symo_exp.models.inputs import Array, Inputs
from symo_exp.models.objectives import Objective
from symo_exp.models.uncertainty import Interval, ModelPosterior, interval, known, sample


class DynamicsModel(nn.Module):
    """A model of a mechanical system with coordinates ``q`` (n) and controls ``u`` (m).

    Of a system with rotations, configurations ``q`` have N numbers, the nine entries of each
    rotation after the lengths and angles, row by row; ``v`` has n, body rates for a rotation.

    Methods map a batch, ``q`` and ``v`` (B, n), ``u`` (B, m), to a batch, and a single state,
    ``q`` and ``v`` (n,), ``u`` (m,), to a single result. Arguments are tensors, NumPy arrays,
    DataFrames or lists in SI units, of any precision; results are tensors in the precision and on
    the device of the model. They carry a gradient only if an argument is a tensor that requires
    one; otherwise they convert to NumPy directly.

    Args:
        flow: The map of a state over one time step.
        coordinates: Coordinates of the system.
        objective: Residuals that training minimises; ``None`` for a model that is not trained.
        evaluation_dtype: Precision of the copy for evaluation.
    """

    def __init__(
        self,
        flow: Flow,
        *,
        coordinates: Coordinates,
        objective: Objective | None = None,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        super().__init__()
        instance("flow", flow, Flow)
        instance("coordinates", coordinates, Coordinates)
        self.flow, self.coordinates, self.time_step = flow, coordinates, flow.time_step
        if coordinates.units != SI:
            self.flow.set_units(coordinates)
        self.objective = objective
        self._evaluation_dtype: torch.dtype = getattr(torch, evaluation_dtype)
        self.compiled: dict[str, Callable[..., Any]] = {}
        """Functions that replace uncompiled ones: "rollout" replaces ``flow.advance``."""
        self.posterior: ModelPosterior | None = None
        """Posterior of the parameters, if they were estimated by least squares."""
        self.system: Any = None
        """The system of a model that was loaded from a run."""

    @property
    def learns(self) -> bool:
        """True if there is anything to train."""
        return any(True for _ in self.parameters())

    @property
    def reads_velocity(self) -> bool:
        """True if predictions start from measured velocities."""
        return self.flow.reads_velocity

    @property
    def input_matrix(self) -> Tensor:
        """``B`` (n, m) of the generalised force ``F = B u``."""
        return self.flow.input_matrix

    @property
    def lagrangian(self) -> Lagrangian | None:
        """The learned Lagrangian, if the method has one."""
        return self.flow.lagrangian

    @property
    def dissipation(self) -> Dissipation | None:
        """The learned dissipation, if there is one."""
        return getattr(self.lagrangian, "dissipation", None)

    @leaves_inference_mode
    def step(self, q: Array, v: Array, u: Array = None, u_next: Array = None) -> Step:
        """Return the state one time step later, differentiable in all arguments.

        Args:
            q: Configurations (B, n) or (n,).
            v: Velocities, of the same shape.
            u: Controls (B, m) or (m,) at the start of the step; zero if left out.
            u_next: Controls at its end, reached linearly; ``u`` if left out.
        """
        given = Inputs(self.input_matrix, q, self.flow.space)
        v, u = given.state("v", v), given.control("u", u)
        u_next = u if u_next is None else given.control("u_next", u_next)
        with given.gradients():
            step = self.flow.step(given.q, v, u, u_next)
        return Step(*(x[0] for x in step)) if given.single else step

    @leaves_inference_mode
    def rollout(
        self, q0: Array, v0: Array, u: Array = None, *, steps: int | None = None
    ) -> Rollout:
        """Return the trajectory from ``(q0, v0)``, without gradients.

        A trajectory that diverges ends in non-finite numbers.

        Args:
            q0: Initial configurations (B, n) or (n,).
            v0: Initial velocities, of the same shape.
            u: Controls (B, T+1, m) or (T+1, m) at all nodes, first to last.
            steps: The number T of steps of an unforced motion, instead of ``u``.

        Returns:
            ``q`` and ``v`` (B, T+1, n) and ``converged`` (B, T), without B for a single state.

        Raises:
            ConfigError: If a start is not finite or has a rotation that is none.
        """
        given = Inputs(self.input_matrix, q0, self.flow.space)
        v, controls = given.finite("v0", given.state("v0", v0)), given.controls(u, steps)
        rollout = self.flow.rollout(given.start("q0"), v, controls, self.compiled.get("rollout"))
        return Rollout(*(x[0] for x in rollout)) if given.single else rollout

    def rollout_slopes(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor] | None:
        """Return the configurations of rollouts and their derivatives in ``(q, v)``.

        See ``Flow.rollout_slopes``.
        """
        return self.flow.rollout_slopes(*(x.to(self.input_matrix) for x in (q, v, u)))

    @leaves_inference_mode
    def rollout_interval(
        self,
        q0: Array,
        v0: Array,
        u: Array = None,
        *,
        steps: int | None = None,
        level: float = 0.9,
    ) -> Interval:
        """Return bounds between which the configurations lie with probability ``level``.

        The interval is that of the posterior of the parameters about the motion of their mean, by
        linearisation or, of more than 24 parameters, by samples; where errors of recordings exceed
        it, widened by these. It is computed in float64.

        Args:
            q0: Configuration to start from.
            v0: Velocity to start from.
            u: Control at every node; see ``rollout``.
            steps: Number of time steps, without ``u``.
            level: Probability at each node and coordinate.

        Returns:
            ``lower`` and ``upper``, (B, T+1, n), or (T+1, n) from a single state; infinite after a
            step whose root is not found or whose result is not finite.
        """
        if self.flow.space.rotations:
            raise ConfigError(
                "intervals are computed for lengths and angles only, and this model has rotations"
            )
        given = Inputs(self.input_matrix, q0, self.flow.space)
        v, controls = given.finite("v0", given.state("v0", v0)), given.controls(u, steps)
        q = given.finite("q0", given.q)
        found = interval(self.flow, known(self.posterior), q, v, controls, level)
        return Interval(*(x[0] for x in found)) if given.single else found

    @leaves_inference_mode
    def sample(self, count: int, *, seed: int = 0) -> list[DynamicsModel]:
        """Return ``count`` models with parameters drawn from the posterior.

        Those of a network may be far off: some of its weights are so uncertain that predictions are
        not linear in them, as ``rollout_interval`` takes them to be.
        """
        count = whole_number("count", count, low=0)
        return sample(self, known(self.posterior), count, seed)

    @leaves_inference_mode
    def linearize(self, q: Array, v: Array, u: Array = None) -> Linear:
        """Return the derivatives of ``(q, v)`` one time step later, in the state and the control.

        Those in a rotation are along ``R exp φ``. All are exact, by the implicit function theorem
        where a root is found, and ``nan`` in rows without a root. They have no gradients
        themselves.

        Args:
            q: Configurations (B, n) or (n,).
            v: Velocities, of the same shape.
            u: Controls (B, m) or (m,), held over the step; zero if left out.

        Returns:
            ``A`` (B, 2n, 2n) and ``B`` (B, 2n, m), without B for a single state.
        """
        given = Inputs(self.input_matrix, q, self.flow.space)
        found = linearize(self.flow, given.q, given.state("v", v), given.control("u", u))[1]
        return Linear(*(x[0] for x in found)) if given.single else found

    @leaves_inference_mode
    def inverse_dynamics(self, q_prev: Array, q: Array, q_next: Array) -> Tensor:
        """Return the held control (B, m) behind three configurations, one time step apart.

        Of all motions of the model through ``q_prev`` and ``q`` it belongs to the one that comes
        closest to ``q_next``, which it reaches where there is a control for each coordinate. With
        fewer controls (underactuated) the root mean square distance, in the units of the
        coordinates, is least; with more, ``u`` has the least norm. Rows for which no such motion is
        found are ``nan``.

        Args:
            q_prev: Configurations (B, n) or (n,) at the first node.
            q: Configurations at the second node.
            q_next: Configurations at the third node.
        """
        given = Inputs(self.input_matrix, q_prev, self.flow.space)
        q = given.configuration("q", q)
        q_next = given.configuration("q_next", q_next)
        u = inverse_dynamics(self.flow, given.q, q, q_next)
        return u[0] if given.single else u

    @leaves_inference_mode
    def initial_velocity(self, windows: Windows) -> Tensor:
        """Return the velocity (samples, n) at node ``k`` with which a prediction starts.

        In evaluation, rows in which no motion between nodes is found are NaN.
        """
        return self.flow.initial_velocity(windows)

    @leaves_inference_mode
    def predict(self, windows: Windows) -> Step:
        """Return the one-step prediction of node ``k+1``, which all measures use."""
        return self.flow.predict(windows)

    def energy(self, q: Array, v: Array) -> Tensor:
        """Return the learned total energy (B,) [J, up to a constant]."""
        return self._learned("energy", q, v)

    def mass_matrix(self, q: Array) -> Tensor:
        """Return the learned inertia ``H(q)`` (B, n, n)."""
        return self._learned("mass_matrix", q)

    def potential(self, q: Array) -> Tensor:
        """Return the learned potential energy (B,) [J, up to a constant]."""
        return self._learned("potential", q)

    def momentum(self, q: Array, v: Array) -> Tensor:
        """Return the learned momentum ``p = H(q) v`` (B, n)."""
        return self._learned("momentum", q, v)

    @leaves_inference_mode
    def _learned(self, quantity: str, q: Array, *v: Array) -> Tensor:
        if self.lagrangian is None:
            raise AttributeError(f"{type(self).__name__} learns no Lagrangian")
        given = Inputs(self.input_matrix, q, self.flow.space, transforms=True)
        velocity = [given.state("v", x) for x in v]
        with given.gradients():
            value = getattr(self.lagrangian, quantity)(given.q, *velocity)
        return value[0] if given.single else value

    @leaves_inference_mode
    def for_evaluation(self) -> DynamicsModel:
        """Return a copy for evaluation, by default in double precision with converged roots."""
        twin = copy.deepcopy(self)
        twin.flow = twin.flow.converged()
        return twin.to(self._evaluation_dtype).eval().requires_grad_(False)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out compiled functions, which belong to this instance and cannot be pickled."""
        return {**self.__dict__, "compiled": {}}
