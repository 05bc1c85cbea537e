"""Angles that count in the other direction than the first one."""

import itertools

import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.identify.senses import reversed_angles
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.planar_links import PlanarLinks
from tests.logs import examined

H, FINE, SECONDS, COUNT = 0.02, 4, 3.0, 16
MACHINES = {
    "two relative angles": (("a", "b"), (True, True), True),
    "two angles from the world": (("a", "b"), (True, True), False),
    "three relative angles": (("a", "b", "c"), (True, True, True), True),
    "a cart with two links": (("x", "a", "b"), (False, True, True), True),
}


def swings(names, angular, relative, *, driven, coupled=True):
    """Motions of links at random, with viscous friction, and the matrix of their inputs."""
    torch.manual_seed(0)
    coordinates = Coordinates(names, angular)
    links = PlanarLinks(coordinates=coordinates, relative=relative).double()
    n = len(names)
    with torch.no_grad():
        links.weights.copy_(5.0 * torch.randn(2 * n))
        links.weights.mul_(torch.tensor(angular).repeat(2))
        if not coupled:
            links.points.zero_()
            links.inertias.fill_(1.0)
            links.rotors.zero_()
    rates = torch.linspace(1.0, 6.0, COUNT * n).view(COUNT, n)
    step = H / FINE

    @torch.no_grad()
    def slope(t, q, v):
        mass, changed, force = links.rates(q, v)
        u = 3.0 * torch.sin(rates * t) * driven
        return v, torch.linalg.solve(mass, u + force - changed - 0.1 * v), u

    q, v = torch.randn(2, COUNT, n, dtype=torch.float64)
    found = []
    for k in range(round(SECONDS / step)):
        t = k * step
        dq, dv, u = slope(t, q, v)
        if k % FINE == 0:
            found.append(torch.stack((q, u)))
        mq, mv, _ = slope(t + step / 2, q + step / 2 * dq, v + step / 2 * dv)
        q, v = q + step * mq, v + step * mv
    motions = torch.stack(found, dim=2).numpy()
    return list(zip(*motions, strict=True)), coordinates, np.eye(n) if driven else None


@pytest.mark.parametrize(
    ("kind", "driven"),
    [pytest.param(kind, driven, marks=[pytest.mark.slow] * (driven != (k % 2 > 0)))
     for k, kind in enumerate(MACHINES) for driven in (True, False)],
)  # fmt: skip
def test_angles_that_count_in_the_other_direction_are_found(kind, driven):
    motions, coordinates, matrix = swings(*MACHINES[kind], driven=driven)
    angles = np.flatnonzero(coordinates.angular)
    for signs in itertools.product((1.0, -1.0), repeat=len(angles)):
        turn = np.ones(coordinates.n)
        turn[angles] = signs
        seen = [(q * turn, u) for q, u in motions]
        acting = None if matrix is None else turn[:, None] * matrix
        wanted = [coordinates.names[i] for i in angles if turn[i] != turn[angles[0]]]
        assert reversed_angles(seen, coordinates, H, acting) == wanted


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_search_says_which_angle_counts_in_the_other_direction(sign, workplace):
    motions, _, _ = swings(("a", "b"), (True, True), True, driven=True)
    names = ["q_a", "q_b", "u_a", "u_b"]
    table = pd.concat(
        pd.DataFrame(np.hstack(one), columns=names).assign(
            t=H * np.arange(len(one[0])), trajectory=i
        )
        for i, one in enumerate(motions)
    )
    table["q_b"] *= sign
    notes = examined(table, time_step=H).notes
    assert any("q_b counts in the other direction" in note for note in notes) == (sign < 0.0)


def test_the_direction_of_angles_that_do_not_depend_on_each_other_is_open():
    motions, coordinates, matrix = swings(
        ("a", "b"), (True, True), False, driven=True, coupled=False
    )
    for turn in ([1.0, 1.0], [1.0, -1.0]):
        seen = [(q * turn, u * turn) for q, u in motions]
        assert not reversed_angles(seen, coordinates, H, matrix)


@pytest.mark.parametrize("shift", [0.0, 0.4])
def test_motions_that_links_do_not_explain_tell_no_direction(shift):
    """Also those of one angle, and motions shorter than a regression needs."""
    motions, coordinates, matrix = swings(("a", "b"), (True, True), True, driven=True)
    late = [(q, np.roll(u, round(shift / H), axis=0)) for q, u in motions]
    turned = [(q * [1.0, -1.0], u * [1.0, -1.0]) for q, u in late]
    assert bool(reversed_angles(turned, coordinates, H, matrix)) == (shift == 0.0)
    assert not reversed_angles([(q[:12], u[:12]) for q, u in turned], coordinates, H, matrix)
    one = [(q[:, :1], u[:, :1]) for q, u in turned]
    assert not reversed_angles(one, Coordinates(("a",), (True,)), H, matrix[:1, :1])
