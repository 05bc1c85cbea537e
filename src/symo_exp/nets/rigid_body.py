"""The learned Lagrangian of one rigid body, on a pivot or moving freely."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import real, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import Curvature, Gradients, Rates, jacobian, matvec
from symo_exp.mechanics.rigid_body import BodyParameters, RigidBodyLagrangian, in_world
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import by_sample, linear, repeated, transposed
from symo_exp.nets.embedding import require_one_body
from symo_exp.nets.mlp import MLP
from symo_exp.nets.roles import mark
from symo_exp.nets.triangle import Triangle
from symo_exp.words import counted


class LearnedRigidBody(RigidBodyLagrangian, nn.Module):
    """A rigid body with 10 inertial parameters, gravity and inputs, learned.

    ``Λ Λᵀ``, 4 x 4, is its pseudo-inertia about the origin, second moments, mass times centre and
    mass (Wensing, Kim and Slotine 2018), so that every ``Λ`` is a possible body. ``Λ``, the gravity
    ``γ`` and, where they are learned, the input matrix in body axes are parameters. On a pivot only
    products of ``γ`` and the first moment are determined; if there are no inputs, or these are
    learned, everything is determined only up to a common factor. On a pivot ``γ`` is zero at the
    start: gravity along the axis of a pendulum has no torque about this axis, and its torques about
    the others are hidden by a large inertia.

    Networks of the position and the nine entries of the rotation can replace the potential of
    gravity and the constant input matrix.

    Args:
        coordinates: A rotation, or a position of three lengths and a rotation.
        initial_inertia: Inertia at the start of training [kg, kg radius²]; 1 if null.
        learned_inputs: Number of inputs whose matrix is learned; 0: the system's is taken.
        potential_width: Hidden units of a network for the potential; 0: gravity.
        input_width: Hidden units of a network for the input matrix; 0: it is constant.
        radius: Radius of gyration near which training starts [m]: the unit of length of the
            parameters, so that those of a small body are about as large as each other.
    """

    lengths: Tensor
    units: Tensor

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        initial_inertia: float | None = 1.0,
        learned_inputs: int = 0,
        potential_width: int = 0,
        input_width: int = 0,
        radius: float = 1.0,
    ) -> None:
        super().__init__()
        require_one_body(coordinates, "lagrangian=rigid_body", "another lagrangian")
        if initial_inertia is not None:
            real("lagrangian.initial_inertia", initial_inertia, above=0)
        real("lagrangian.radius", radius, above=0)
        whole_number("lagrangian.learned_inputs", learned_inputs, low=0)
        if input_width and not learned_inputs:
            raise ConfigError(
                f"lagrangian.input_width={input_width}: a network for the input matrix needs the "
                "number of inputs; set lagrangian.learned_inputs"
            )
        self.coordinates, self.learned_inputs = coordinates, learned_inputs
        self._triangle = Triangle(4)
        lengths = torch.tensor([radius, radius, radius, 1.0])
        self.register_buffer("lengths", lengths, persistent=False)
        units = torch.ones(coordinates.n)
        units[-3:] = radius**2
        self.register_buffer("units", units, persistent=False)
        root = math.sqrt(0.5 * (initial_inertia or 1.0))  # J = 2 Λ Λᵀ of equal second moments
        moments = 0.1 * root * torch.randn(self._triangle.entries)
        moments[self._triangle.flat(torch.eye(4)).bool()] += root
        self.moments = nn.Parameter(moments)
        coefficients = [self.moments]
        self.gravity = self.inputs = self.potential_net = self.input_net = None
        if potential_width:
            self.potential_net = MLP(
                inputs=coordinates.width, outputs=1, width=potential_width, depth=1
            )
        else:
            down = torch.tensor([0.0, 0.0, -9.81])
            self.gravity = nn.Parameter(down if coordinates.n > 3 else torch.zeros(3))
            coefficients.append(self.gravity)
        size = coordinates.n * learned_inputs
        if input_width:
            self.input_net = MLP(inputs=9, outputs=size, width=input_width, depth=1)
        elif learned_inputs:
            self.inputs = nn.Parameter(0.1 * torch.randn(size))
            coefficients.append(self.inputs)
        mark(coefficients, "coefficient")

    @override
    def rigid_body(self, like: Float[Tensor, "batch N"]) -> BodyParameters:
        batch = like.shape[0] if by_sample() else 1
        factor = self.factor(repeated(self.moments, batch))
        gravity = factor.new_zeros(batch, 3)
        if self.gravity is not None:
            gravity = repeated(self.gravity, batch)
        return BodyParameters.of_pseudo_inertia(factor @ factor.mT, gravity)

    def factor(self, moments: Float[Tensor, "*batch entries"]) -> Float[Tensor, "*batch 4 4"]:
        """Return ``Λ`` [√kg m, last row √kg] of the pseudo-inertia ``Λ Λᵀ``."""
        return self._triangle.square(moments) * self.lengths.unsqueeze(1)

    @override
    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        if not self.learned_inputs:
            return self.coordinates.input_force(input_matrix, q, u)
        if u.shape[1] != self.learned_inputs:
            there = counted(u.shape[1], "input")
            raise ConfigError(
                f"lagrangian.learned_inputs={self.learned_inputs}: the system has {there}"
            )
        if self.input_net is not None:
            entries = self.input_net(q[:, -9:])
        else:
            assert self.inputs is not None
            entries = repeated(self.inputs, q.shape[0])
        wrench = matvec(entries.unflatten(1, (-1, u.shape[1])), u)
        return in_world(q, self.units * wrench)

    def learned_matrix(self) -> Float[Tensor, "n m"]:
        """Return the learned input matrix in body axes, if it is constant."""
        assert self.inputs is not None
        return self.units.unsqueeze(1) * self.inputs.detach().view(-1, self.learned_inputs)

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        if self.potential_net is None:
            return super().potential(q)
        found: Tensor = self.potential_net(q)[:, 0]
        return found

    @override
    def gradients(
        self,
        q: Float[Tensor, "batch N"],
        v: Float[Tensor, "batch n"],
        body: BodyParameters | None = None,
    ) -> Gradients:
        found = super().gradients(q, v, body)
        return found._replace(q=self._with_network(found.q, q))

    @override
    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        found = super().rates(q, v)
        return found._replace(q=self._with_network(found.q, q))

    def _with_network(self, dq: Tensor, q: Tensor) -> Tensor:
        """Return ``∂ℒ/∂q`` with the network of the potential, if there is one."""
        if self.potential_net is None:
            return dq
        return dq - self.space.pull(q, _slope(self.potential_net, q))

    @override
    def curvature(
        self,
        q: Float[Tensor, "batch N"],
        v: Float[Tensor, "batch n"],
        body: BodyParameters | None = None,
    ) -> Curvature:
        found = super().curvature(q, v, body)
        if self.potential_net is None:
            return found
        with torch.enable_grad():
            at = q.detach().requires_grad_()
            slope = self.space.pull(at, _slope(self.potential_net, at))
            bend = self.space.pull(q.unsqueeze(1), jacobian(slope, at).detach())
        return found._replace(qq=found.qq - bend)


def _slope(net: MLP, x: Float[Tensor, "batch inputs"]) -> Float[Tensor, "batch inputs"]:
    """Return the gradient of a network with one output, differentiable once more."""
    *hidden, (last, _) = net.layers()
    values = []
    for weight, bias in hidden:
        x = torch.tanh(linear(x, weight, bias))
        values.append(x)
    slope = transposed(torch.ones_like(x[:, :1]), last)
    for (weight, _), h in zip(reversed(hidden), reversed(values), strict=True):
        slope = transposed(slope * (1.0 - h * h), weight)
    return slope
