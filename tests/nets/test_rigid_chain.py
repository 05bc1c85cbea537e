"""The learned chain of rigid bodies: exact representation and settings."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.systems.mujoco import read_mechanism
from symo_exp.systems.multibody import Multibody
from tests.systems import models
from tests.systems.every import points
from tests.systems.models import read
from tests.tables import CONF


def named(angular):
    return Coordinates(tuple(f"q{i}" for i in range(len(angular))), angular)


TRUTHS = {
    "arm": lambda: Multibody(
        mechanism=read_mechanism(CONF / "system" / "arm_of_seven.xml"), time_step=0.05
    ),
    "cart and two links": lambda: read(models.PENDULUMS),
}


def of_truth(system: Multibody) -> RigidChain:
    """The chain of a mechanism without branches and springs, its references zero."""
    found, before = (
        RigidChain(coordinates=system.coordinates).double(),
        torch.zeros(3, dtype=torch.float64),
    )
    with torch.no_grad():
        for i, joint in enumerate(system.joints):
            assert joint.parent == i - 1
            anchor, centre, inertia = (
                torch.tensor(x, dtype=torch.float64)
                for x in (joint.anchor, joint.centre, joint.inertia)
            )
            centre = centre - anchor
            second = 0.5 * inertia.trace() * torch.eye(3, dtype=torch.float64) - inertia
            pseudo = torch.zeros(4, 4, dtype=torch.float64)
            pseudo[:3, :3] = second + joint.mass * torch.outer(centre, centre)
            pseudo[:3, 3] = pseudo[3, :3] = joint.mass * centre
            pseudo[3, 3] = joint.mass
            row, column = torch.tril_indices(4, 4)
            factor = torch.linalg.cholesky(pseudo)[row, column]
            found.moments.view(-1, 10)[i] = factor
            found.axes.view(-1, 3)[i] = torch.tensor(joint.axis, dtype=torch.float64)
            found.places.view(-1, 3)[i] = anchor - before
            found.rotors[i] = joint.armature**0.5
            before = anchor
        found.gravity.copy_(torch.tensor(system.mechanism["gravity"], dtype=torch.float64))
    return found


@pytest.mark.parametrize("name", TRUTHS)
def test_any_chain_of_rigid_bodies_is_represented_exactly(name):
    system = TRUTHS[name]()
    q, *_ = points(system, 6)
    found = of_truth(system)
    torch.testing.assert_close(found.mass_matrix(q), system.mass_matrix(q), rtol=1e-9, atol=1e-9)
    height = found.potential(q) - system.potential(q)  # up to a constant
    torch.testing.assert_close(height, height[:1].expand_as(height), rtol=1e-9, atol=1e-9)


def test_a_negative_initial_inertia_is_refused():
    with pytest.raises(ConfigError, match=r"lagrangian\.initial_inertia=-1"):
        RigidChain(coordinates=named((True,)), initial_inertia=-1.0)


@pytest.mark.parametrize(
    "axes",
    [[[0, 0, 1]], [[0, 0, 1], [0, 1]], [[0, 0, 0], [0, 1, 0]], [1, 2], 3, [["x"] * 3, [0, 1, 0]]],
)
def test_invalid_axes_are_refused(axes):
    with pytest.raises(ConfigError, match="expected 2 rows of three numbers"):
        RigidChain(coordinates=named((True, True)), axes=axes)
