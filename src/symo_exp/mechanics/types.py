"""Named tuples that the packages exchange."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class Coordinates(NamedTuple):
    """Generalised coordinates of a system: their names, and which of them are angles [rad]."""

    names: tuple[str, ...]
    angular: tuple[bool, ...]

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""
        return len(self.names)


class Windows(NamedTuple):
    """Samples of three consecutive nodes ``k-1, k, k+1``, one time step apart.

    ``v`` belongs to node ``k`` and ``v_next`` to node ``k+1``. Every method sees these samples:
    SyMo and E2E-SyMo read the configurations, NODE and L-NODE the states at ``k`` and ``k+1``.
    """

    q_prev: Float[Tensor, "samples n"]
    q: Float[Tensor, "samples n"]
    q_next: Float[Tensor, "samples n"]
    v: Float[Tensor, "samples n"]
    v_next: Float[Tensor, "samples n"]
    u_prev: Float[Tensor, "samples m"]
    u: Float[Tensor, "samples m"]
    u_next: Float[Tensor, "samples m"]

    def rows(self, index: Tensor | slice) -> Windows:
        """Return the given samples."""
        return Windows(*(field[index] for field in self))


class Trajectories(NamedTuple):
    """Trajectories of ``nodes`` nodes each, one time step apart."""

    q: Float[Tensor, "trajectories nodes n"]
    v: Float[Tensor, "trajectories nodes n"]
    u: Float[Tensor, "trajectories nodes m"]

    def each(self) -> list[Trajectory]:
        """Return the trajectories one by one."""
        return [Trajectory(*fields) for fields in zip(*self, strict=True)]


class Trajectory(NamedTuple):
    """One motion: its nodes are one time step apart."""

    q: Float[Tensor, "nodes n"]
    v: Float[Tensor, "nodes n"]
    u: Float[Tensor, "nodes m"]


class Stretches(NamedTuple):
    """Samples of many consecutive nodes of configurations and controls, one time step apart."""

    q: Float[Tensor, "samples nodes n"]
    u: Float[Tensor, "samples nodes m"]
    start: Float[Tensor, "samples 2*n"]
    """``(q, v)`` near that at the first node, from where a fit begins; not finite if unknown."""
    weight: Float[Tensor, "samples nodes n"]
    """Weight of each squared error."""

    def rows(self, index: Tensor | slice) -> Stretches:
        """Return the given samples."""
        return Stretches(*(field[index] for field in self))


TrainingSamples = Windows | Stretches
