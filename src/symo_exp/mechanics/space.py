"""Configuration spaces: flat coordinates and rotations.

A configuration is stored as ``N`` numbers, the flat coordinates (lengths and angles) and the nine
entries of each rotation matrix, row by row. Velocities, momenta and forces have ``n`` components,
those of the flat coordinates and three for each rotation, in body axes: ``Ṙ = R [ω]``, with
``[ω] x = ω × x``. So ``N = n + 6 r`` with ``r`` rotations.

The chart at a configuration ``R₀`` is the exponential map, ``R = R₀ exp φ``; flat coordinates are
their own chart. With ``Jr`` the right Jacobian of ``exp``

    ω = Jr(φ) φ̇        Jr = I − a [φ] + b [φ]²        Jr⁻¹ = I + ½ [φ] + γ [φ]²

``a`` and ``b`` are entire functions of ``s = |φ|²``, computed by their series: they and their
derivatives are smooth at 0. ``γ``, smooth up to a whole turn, follows from theirs at ``φ/2``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

LOOSE = 0.01
"""Largest entry of ``R Rᵀ − I`` of a matrix that is taken for a rotation: single precision loses
1e-7 in a step."""
TURN = 2.0 * math.pi
"""A whole turn [rad]."""
TERMS = 16
"""Terms of a series, four times four: exact to rounding up to half a turn, to 1e-12 up to a whole
one."""


class ExponentialMap(NamedTuple):
    """``exp`` at a batch of rotation vectors, with its coefficients in ``s`` and their slopes."""

    phi: Float[Tensor, "rows 3"]
    hat: Float[Tensor, "rows 3 3"]
    """``[φ]``."""
    square: Float[Tensor, "rows 3 3"]
    """``[φ]²``."""
    sinc: Float[Tensor, "rows 1 1"]
    """``sin θ / θ``."""
    a: Float[Tensor, "rows 1 1"]
    """``(1 − cos θ) / θ²``."""
    a1: Float[Tensor, "rows 1 1"]
    """``da/ds``."""
    a2: Float[Tensor, "rows 1 1"]
    """``d²a/ds²``."""
    b: Float[Tensor, "rows 1 1"]
    """``(θ − sin θ) / θ³``."""
    b1: Float[Tensor, "rows 1 1"]
    """``db/ds``."""
    b2: Float[Tensor, "rows 1 1"]
    """``d²b/ds²``."""

    @staticmethod
    def of(phi: Float[Tensor, "rows 3"]) -> ExponentialMap:
        """Evaluate the map."""
        hat = cross(phi)
        s = phi.square().sum(-1)
        square = s * s
        low = torch.stack((torch.ones_like(s), s, square, square * s), dim=-1)
        high = low.square().square()  # s⁰, s⁴, s⁸, s¹²
        powers = (high.unsqueeze(-1) * low.unsqueeze(-2)).flatten(1)
        coefficients = (powers @ _table(phi.dtype, phi.device))[:, :, None, None]
        return ExponentialMap(phi, hat, torch.bmm(hat, hat), *coefficients.unbind(1))

    def turn(self) -> Float[Tensor, "rows 3 3"]:
        """Return ``exp [φ]``, Rodrigues' formula."""
        return self._polynomial(self.sinc, self.a)

    def jacobian(self) -> Float[Tensor, "rows 3 3"]:
        """Return ``Jr``."""
        return self._polynomial(-self.a, self.b)

    def inverse_of_twice(self) -> Float[Tensor, "rows 3 3"]:
        """Return ``Jr(2φ)⁻¹ = I + [φ] + 4 γ(2φ) [φ]²``, with ``4 γ(2φ) = (a − b) / sinc``."""
        return self._polynomial(1.0, (self.a - self.b) / self.sinc)

    def jacobian_slope(self, x: Float[Tensor, "rows 3"]) -> Float[Tensor, "rows 3 3"]:
        """Return ``∂(Jr x)/∂φ``."""
        change = self.b1 * self.square - self.a1 * self.hat
        return self._slope(cross(x), -self.a, self.b, torch.bmm(change, x.unsqueeze(-1)))

    def transposed_slope(self, x: Float[Tensor, "rows 3"]) -> Float[Tensor, "rows 3 3"]:
        """Return ``∂(Jrᵀ x)/∂φ``."""
        change = self.b1 * self.square + self.a1 * self.hat
        return self._slope(cross(x), self.a, self.b, torch.bmm(change, x.unsqueeze(-1)))

    def inverse_of_twice_slope(self, x: Float[Tensor, "rows 3"]) -> Float[Tensor, "rows 3 3"]:
        """Return ``∂(Jr(2φ)⁻¹ x)/∂φ``."""
        g = (self.a - self.b) / self.sinc
        g1 = torch.addcmul((self.a1 - self.b1) / self.sinc, g, g, value=0.5)
        return self._slope(cross(x), 1.0, g, g1 * torch.bmm(self.square, x.unsqueeze(-1)))

    def jacobian_bend(
        self, p: Float[Tensor, "rows 3"], x: Float[Tensor, "rows 3"]
    ) -> Float[Tensor, "rows 3 3"]:
        """Return ``∂²(p · Jr x)/∂φ²``.

        ``p · Jr x = p·x − a φ·c + ½ b φᵀQφ`` with ``c = x × p``, ``Q = [p][x] + [x][p]``.
        """
        column, row = self.phi.unsqueeze(-1), self.phi.unsqueeze(-2)
        product = torch.bmm(cross(p), cross(x))
        form, c = product + product.mT, torch.linalg.cross(x, p).unsqueeze(-1)
        formed = form @ column
        g, along = 0.5 * (row @ formed), row @ c
        own = self.b1 * formed - self.a1 * c + (self.b2 * g - self.a2 * along) * column
        mixed = (2.0 * own) @ row
        one, _ = _constants(p.dtype, p.device)
        even = 2.0 * (self.b1 * g - self.a1 * along) * one
        return self.b * form + mixed + mixed.mT + even

    def _polynomial(
        self, first: Tensor | float, second: Float[Tensor, "rows 1 1"]
    ) -> Float[Tensor, "rows 3 3"]:
        """Return ``I + f [φ] + g [φ]²``."""
        one, _ = _constants(self.phi.dtype, self.phi.device)
        along = torch.addcmul(one, first, self.hat) if isinstance(first, Tensor) else one + self.hat
        return torch.addcmul(along, second, self.square)

    def _slope(
        self,
        turned: Float[Tensor, "rows 3 3"],
        first: Tensor | float,
        second: Float[Tensor, "rows 1 1"],
        change: Float[Tensor, "rows 3 1"],
    ) -> Float[Tensor, "rows 3 3"]:
        """Return ``∂/∂φ`` of ``(I + f [φ] + g [φ]²) x``, given ``[x]``.

        That is ``g ([x][φ] − 2 [φ][x]) − f [x] + 2 (df/ds [φ] x + dg/ds [φ]² x) φᵀ``; ``change`` is
        the bracket at the end.
        """
        square = torch.baddbmm(torch.bmm(turned, self.hat), self.hat, turned, alpha=-2.0)
        even = second * square
        if isinstance(first, Tensor):
            fixed = torch.addcmul(even, first, turned, value=-1.0)
        else:
            fixed = torch.add(even, turned, alpha=-first)
        return torch.baddbmm(fixed, change, self.phi.unsqueeze(-2), alpha=2.0)


@cache
def _table(dtype: torch.dtype, device: torch.device) -> Float[Tensor, "terms coefficients"]:
    """Return the coefficients of the series, one in a column."""
    sinc, a, b = (
        [(-1.0) ** k / math.factorial(2 * k + i) for k in range(TERMS + 2)] for i in (1, 2, 3)
    )

    def slope(f: list[float]) -> list[float]:
        return [k * x for k, x in enumerate(f)][1:]

    columns = (sinc, a, slope(a), slope(slope(a)), b, slope(b), slope(slope(b)))
    rows = list(zip(*(column[:TERMS] for column in columns), strict=True))
    return torch.tensor(rows, dtype=torch.float64).to(dtype=dtype, device=device)


@dataclass(frozen=True)
class Space:
    """Flat coordinates, then ``rotations`` rotations.

    Attributes:
        rotations: Number of rotations.
    """

    rotations: int = 0

    def stored(self, n: int) -> int:
        """Return the width ``N`` of configurations with ``n`` degrees of freedom."""
        return n + 6 * self.rotations

    # Maps between configurations and charts

    def chart(
        self, base: Float[Tensor, "*batch N"], q: Float[Tensor, "*batch N"]
    ) -> Float[Tensor, "*batch n"]:
        """Return the coordinates ``(x, log R₀ᵀR)`` of configurations in the charts at ``base``."""
        if not self.rotations:
            return q
        flat, turn = self._split(q)
        relative = self._split(base)[1].mT @ turn
        return with_rotations(flat, rotation_vector(relative).flatten(-2))

    def point(
        self, base: Float[Tensor, "*batch N"], x: Float[Tensor, "*batch n"]
    ) -> Float[Tensor, "*batch N"]:
        """Return the configurations at coordinates ``x`` of the charts at ``base``."""
        return self.turned(base, x, exponential(self._parts(x)[1])) if self.rotations else x

    def turned(
        self,
        base: Float[Tensor, "*batch N"],
        x: Float[Tensor, "*batch n"],
        turn: Float[Tensor, "*batch r 3 3"],
    ) -> Float[Tensor, "*batch N"]:
        """Return ``point`` where ``turn``, ``exp φ``, is known."""
        flat, turned = self._parts(x)[0], self._split(base)[1] @ turn
        return with_rotations(flat, turned.flatten(-3))

    def origin(self, base: Float[Tensor, "*batch N"]) -> Float[Tensor, "*batch n"]:
        """Return the coordinates of ``base`` in its own chart."""
        if not self.rotations:
            return base
        flat = base[..., : base.shape[-1] - 9 * self.rotations]
        return with_rotations(flat, base.new_zeros(*base.shape[:-1], 3 * self.rotations))

    def retract(
        self, q: Float[Tensor, "*batch N"], step: Float[Tensor, "*batch n"]
    ) -> Float[Tensor, "*batch N"]:
        """Return ``q + step``, rotations ``R exp step``."""
        return self.point(q, self.origin(q) + step)

    def difference(
        self, start: Float[Tensor, "*batch N"], end: Float[Tensor, "*batch N"]
    ) -> Float[Tensor, "*batch n"]:
        """Return the step that ``retract`` takes from ``start`` to ``end``."""
        return self.chart(start, end) - self.origin(start)

    def extrapolated(
        self, before: Float[Tensor, "*batch N"], q: Float[Tensor, "*batch N"]
    ) -> Float[Tensor, "*batch N"]:
        """Return the configuration that follows two others in uniform motion."""
        if not self.rotations:
            return 2.0 * q - before
        return self.retract(q, self.difference(before, q))

    def middle(
        self, start: Float[Tensor, "*batch N"], end: Float[Tensor, "*batch N"]
    ) -> Float[Tensor, "*batch N"]:
        """Return the configuration half-way."""
        if not self.rotations:
            return 0.5 * (start + end)
        return self.retract(start, 0.5 * self.difference(start, end))

    def of_vector(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch N"]:
        """Return configurations of flat coordinates and rotation vectors ``φ``, ``R = exp φ``.

        Rotation vectors may have any length; whole turns are subtracted beyond the first one.
        """
        if not self.rotations:
            return x
        flat, phi = self._parts(x)
        size = phi.norm(dim=-1, keepdim=True)
        long = size > TURN
        size = torch.where(long, size, 1.0)
        whole = torch.where(long, TURN * (size / TURN).round(), 0.0)
        return with_rotations(flat, exponential(phi * (1.0 - whole / size)).flatten(-3))

    def of_quaternions(self, x: Float[Tensor, "*batch K"]) -> Float[Tensor, "*batch N"]:
        """Return configurations of flat coordinates and quaternions, the scalar first."""
        if not self.rotations:
            return x
        flat = x.shape[-1] - 4 * self.rotations
        turn = of_quaternion(x[..., flat:].unflatten(-1, (self.rotations, 4)))
        return with_rotations(x[..., :flat], turn.flatten(-3))

    def to_quaternions(self, q: Float[Tensor, "*batch N"]) -> Float[Tensor, "*batch K"]:
        """Return flat coordinates and quaternions of configurations."""
        if not self.rotations:
            return q
        flat, turn = self._split(q)
        return with_rotations(flat, quaternion(turn).flatten(-2))

    def along(self, q: Float[Tensor, "*batch nodes N"]) -> Float[Tensor, "*batch nodes n"]:
        """Return the nodes of motions in the charts at their first ones."""
        return self.chart(q[..., :1, :].expand_as(q), q)

    def unrolled(self, q: Float[Tensor, "*batch nodes N"]) -> Float[Tensor, "*batch nodes n"]:
        """Return flat coordinates, and the sums of the turns between the nodes of motions.

        Turns of less than half a turn in a step add up beyond a whole one.
        """
        if not self.rotations:
            return q
        start = self.origin(q[..., :1, :])
        steps = self.difference(q[..., :-1, :], q[..., 1:, :])
        return torch.cat((start, start + steps.cumsum(-2)), dim=-2)

    def shown(self, q: Float[Tensor, "*batch N"]) -> Float[Tensor, "*batch n"]:
        """Return flat coordinates, and roll, pitch and yaw [rad] of rotations, to be drawn.

        ``R`` turns by yaw about z, then by pitch about the new y and by roll about the new x.
        """
        if not self.rotations:
            return q
        flat, turn = self._split(q)
        roll = torch.atan2(turn[..., 2, 1], turn[..., 2, 2])
        pitch = -torch.asin(turn[..., 2, 0].clamp(-1.0, 1.0))
        yaw = torch.atan2(turn[..., 1, 0], turn[..., 0, 0])
        return with_rotations(flat, torch.stack((roll, pitch, yaw), -1).flatten(-2))

    def rotates(self, q: Float[Tensor, "*batch N"]) -> Bool[Tensor, "*batch"]:
        """Return which configurations have rotation matrices, up to ``LOOSE``."""
        turn = self.rotation_matrices(q)
        off = (turn @ turn.mT - torch.eye(3).to(turn)).abs().amax((-2, -1))
        return ((off < LOOSE) & (torch.linalg.det(turn) > 0.0)).all(-1)

    def normalised(self, q: Float[Tensor, "*batch N"]) -> Float[Tensor, "*batch N"]:
        """Return configurations with the rotations next to their nine entries."""
        if not self.rotations:
            return q
        flat, turn = self._split(q)
        left, _, right = torch.linalg.svd(turn)
        sign = torch.ones_like(turn[..., 0])
        sign[..., 2] = torch.linalg.det(left @ right)
        nearest = (left * sign.unsqueeze(-2)) @ right
        return with_rotations(flat, nearest.flatten(-3))

    # Velocities and gradients

    def push(
        self, q: Float[Tensor, "*batch N"], v: Float[Tensor, "*batch n"]
    ) -> Float[Tensor, "*batch N"]:
        """Return the rates of the stored numbers, ``(ẋ, R [ω])``."""
        if not self.rotations:
            return v
        flat, omega = self._parts(v)
        rate = self._split(q)[1] @ cross(omega)
        return with_rotations(flat, rate.flatten(-3))

    def velocity(
        self, q: Float[Tensor, "*batch N"], rate: Float[Tensor, "*batch N"]
    ) -> Float[Tensor, "*batch n"]:
        """Return the velocity that belongs to rates of the stored numbers, inverse to ``push``."""
        if not self.rotations:
            return rate
        flat, omega = self._parts(self.pull(q, rate))
        return with_rotations(flat, 0.5 * omega.flatten(-2))

    def pull(
        self, q: Float[Tensor, "*batch N"], gradient: Float[Tensor, "*batch N"]
    ) -> Float[Tensor, "*batch n"]:
        """Return the derivatives along ``retract`` of a function with these partial derivatives."""
        if not self.rotations:
            return gradient
        flat, by_turn = self._split(gradient)
        return with_rotations(flat, torques(self._split(q)[1], by_turn).flatten(-2))

    def chart_rate(
        self, x: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``φ̇ = Jr(φ)⁻¹ ω`` in a chart at coordinates ``x``, flat rates as they are."""
        if not self.rotations:
            return v
        flat, omega = self._parts(v)
        inverse = ExponentialMap.of(0.5 * self.vectors(x)).inverse_of_twice()
        rate = (inverse @ omega.reshape(-1, 3, 1)).view(v.shape[0], 3 * self.rotations)
        return with_rotations(flat, rate)

    def coadjoint(
        self, v: Float[Tensor, "batch n"], p: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``ω × p`` of the rotations, zero elsewhere: ``ṗ + ω × p`` is the torque."""
        (flat, omega), (_, spin) = self._parts(v), self._parts(p)
        turning = torch.linalg.cross(omega, spin)
        return with_rotations(torch.zeros_like(flat), turning.flatten(1))

    # Parts

    def rotation_matrices(self, q: Float[Tensor, "*batch N"]) -> Float[Tensor, "*batch r 3 3"]:
        """Return the rotations of configurations."""
        return self._split(q)[1]

    def _split(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return flat coordinates and rotations of stored numbers."""
        flat = q.shape[-1] - 9 * self.rotations
        turns = q[..., flat:].reshape(*q.shape[:-1], self.rotations, 3, 3)
        return q[..., :flat], turns

    def _parts(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the flat part and the vectors of the rotations of a tangent."""
        flat = x.shape[-1] - 3 * self.rotations
        return x[..., :flat], x[..., flat:].reshape(*x.shape[:-1], self.rotations, 3)

    def turns(self, x: Float[Tensor, "*batch n"]) -> Bool[Tensor, " n"]:
        """Return which components of tangents are of rotations."""
        n = x.shape[-1]
        return torch.arange(n, device=x.device) >= n - 3 * self.rotations

    def vectors(self, x: Float[Tensor, "rows n"]) -> Float[Tensor, "rows*r 3"]:
        """Return the vectors of all rotations of tangents, a row each."""
        return x[:, x.shape[1] - 3 * self.rotations :].reshape(-1, 3)

    def blocks(
        self, rotations: Float[Tensor, "rows*r 3 3"], n: int, diagonal: float
    ) -> Float[Tensor, "rows n n"]:
        """Return block diagonal matrices: a number for flat coordinates, a block a rotation."""
        r, flat = self.rotations, n - 3 * self.rotations
        if n == 3:
            return rotations
        found = rotations.new_zeros(rotations.shape[0] // r, n, n)
        if diagonal:
            found.diagonal(dim1=1, dim2=2)[:, :flat] = diagonal
        for i, block in enumerate(rotations.unflatten(0, (-1, r)).unbind(1)):
            at = slice(flat + 3 * i, flat + 3 * i + 3)
            found[:, at, at] = block
        return found


FLAT = Space()
"""Any number of lengths and angles."""


def space_of(q: Float[Tensor, "*batch N"], v: Float[Tensor, "*batch n"]) -> Space:
    """Return the space of configurations and velocities of these widths."""
    return Space((q.shape[-1] - v.shape[-1]) // 6)


def with_rotations(
    flat: Float[Tensor, "*batch a"], rest: Float[Tensor, "*batch b"]
) -> Float[Tensor, "*batch a+b"]:
    """Return what belongs to flat coordinates, if there are any, and to rotations."""
    return torch.cat((flat, rest), dim=-1) if flat.shape[-1] else rest


def cross(x: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Return ``[x]``, the matrix of ``x ×``."""
    return (x @ _constants(x.dtype, x.device)[1]).view(*x.shape, 3)


@cache
def _constants(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the identity, and the entries of ``[e₁]``, ``[e₂]`` and ``[e₃]``, a row each."""
    one = torch.eye(3, dtype=dtype, device=device)
    return one, torch.linalg.cross(one.unsqueeze(1), one.unsqueeze(0)).mT.flatten(1)


def torques(
    turn: Float[Tensor, "*batch 3 3"], by_turn: Float[Tensor, "*#batch 3 3"]
) -> Float[Tensor, "*batch 3"]:
    """Return the derivatives along ``R exp φ`` of a function with derivatives ``C`` in ``R``.

    That is the sum of ``c × r`` over the rows of ``C`` and ``R``.
    """
    return torch.linalg.cross(by_turn, turn).sum(-2)


def exponential(phi: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Return ``exp [φ]``."""
    return ExponentialMap.of(phi.reshape(-1, 3)).turn().view(*phi.shape, 3)


def rotation_vector(turn: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Return ``φ`` with ``exp [φ]`` the rotation and ``|φ| ≤ π``, smooth at the identity.

    That is ``2 atan2(|v|, w) v / |v|`` of a quaternion ``(w, v)`` of any length. Where ``|v|`` is
    small, with any other number as small for it the factor of ``v`` is the same to rounding.
    """
    w, v = _quaternion(turn).split((1, 3), dim=-1)
    least = 4.0 * torch.finfo(turn.dtype).eps
    size = v.square().sum(-1, keepdim=True).clamp_min(least).sqrt()
    factor = 2.0 * torch.atan2(size, w.abs()) / size
    return torch.where(w < 0, -factor, factor) * v


def quaternion(turn: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Return the unit quaternion ``(w, x, y, z)``, ``w ≥ 0``, of a rotation."""
    found = _quaternion(turn)
    found = torch.where(found[..., :1] < 0, -found, found)
    return found / found.norm(dim=-1, keepdim=True)


def _quaternion(turn: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Return a quaternion of a rotation, of either sign and a length from 2 to 4.

    It is a column of ``4 q qᵀ``, which is linear in the rotation, the one with the largest
    diagonal entry (Shepperd 1978).
    """
    rows = turn.flatten(-2) @ _table_of_products(turn.dtype, turn.device)
    table = rows.unflatten(-1, (4, 4)) + torch.eye(4, dtype=turn.dtype, device=turn.device)
    place = table.detach().diagonal(dim1=-2, dim2=-1).argmax(-1)
    index = place[..., None, None].expand(*place.shape, 4, 1)
    return table.gather(-1, index).squeeze(-1)


@cache
def _table_of_products(dtype: torch.dtype, device: torch.device) -> Float[Tensor, "9 16"]:
    """Return the map from the entries of a rotation to those of ``4 q qᵀ − I``."""
    found = torch.zeros(3, 3, 4, 4, dtype=dtype, device=device)
    for i in range(3):
        found[i, i] = torch.diag(torch.tensor([1.0, *(1.0 if i == k else -1.0 for k in range(3))]))
        j, k = (i + 1) % 3, (i + 2) % 3
        for row, column in ((0, i + 1), (i + 1, 0)):  # w times x is that of zy − yz
            found[k, j, row, column], found[j, k, row, column] = 1.0, -1.0
        for row, column in ((j + 1, k + 1), (k + 1, j + 1)):
            found[j, k, row, column] = found[k, j, row, column] = 1.0
    return found.flatten(2).flatten(0, 1)


def of_quaternion(q: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Return the rotation of a quaternion ``(w, x, y, z)`` of any length but 0."""
    w, x, y, z = (q / q.norm(dim=-1, keepdim=True)).unbind(-1)
    return torch.stack(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
         2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
         2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        dim=-1,
    ).unflatten(-1, (3, 3))  # fmt: skip
