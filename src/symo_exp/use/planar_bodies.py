"""Rigid bodies that move as learned links in a plane do.

Vectors of the plane are complex numbers. With the vector ``l_k`` from joint ``k`` to the next one,
the first moment ``s_k`` of all that joint ``k`` carries, and gravity ``γ``, rigid links have

    H_kl = Re(C_kl exp(i (ψ_l − ψ_k))),  C_kl = l̄_k s_l, or i s_l of a slide k along the first axis,
    V = Re Σ_l w_l exp(i ψ_l),  w_l = −γ̄ s_l.

``C`` and ``w`` are learned. They leave each mass an interval and, without a slide, the unit of
length to choose; all choices move alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import Vector, link
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.embedding import directions
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.systems.base import Linkage

EARTH = 9.81
"""Gravity where data leave it open [m/s²]."""
FAR = 100.0
"""Largest length of a pendulum that is as slow as the links under this gravity, and largest radius
of gyration of a link where its mass is left open, in units of length of the coordinates."""
AGREEMENT = 1e-9
"""Differences of ``C`` and ``w`` from those of rigid links, relative to their sizes, that are due
to rounding."""
NEAR = 0.1
"""Largest such difference of links that rigid ones approximate."""


class _Learned(NamedTuple):
    products: list[list[complex]]
    """``C``."""
    inertias: list[float]
    """``H_kk`` without rotors."""
    weights: list[complex]
    """``w`` of hinges; of slides the slope of ``V``."""
    rotors: list[float]
    slides: int
    """Number of slides, which are the first joints."""

    @property
    def n(self) -> int:
        return len(self.inertias)


def planar_bodies(links: PlanarLinks, coordinates: Coordinates) -> Linkage:
    """Return rigid bodies with the inertia and potential of learned links, or near them.

    Constant forces along slides are not in them (``constant_forces``), and of three links or more
    what is not that of rigid ones (``distance_from_rigid``).

    Raises:
        ConfigError: If the learned inertia is not near one of rigid bodies.
    """
    distance = distance_from_rigid(links, coordinates)
    if distance > NEAR:
        raise ConfigError(
            f"the learned links differ from rigid bodies by {distance:.2g} of their inertia or "
            "weight, which is possible with three or more joints of lagrangian=planar; learn with "
            "lagrangian=rigid, or write .pt2"
        )
    learned = _read(links, coordinates)
    gravity, moments = _gravity_and_moments(learned, coordinates)
    vectors = [_vector(learned, moments, k) for k in range(learned.n)]
    carried = [*_carried(learned, moments, vectors), 0.0]
    joints, at = [], 0j
    for k, name in enumerate(coordinates.names):
        mass, beyond = carried[k] - carried[k + 1], carried[k + 1]
        centre = (moments[k] - beyond * vectors[k]) / mass
        about = learned.inertias[k] - beyond * abs(vectors[k]) ** 2 - mass * abs(centre) ** 2
        slides = k < learned.slides
        moment = mass if slides else about  # the same about all axes: a plane asks for no more
        joint = link(
            name,
            mass,
            _in_space(at + centre),
            (moment, moment, moment),
            anchor=_in_space(at),
            axis=(1.0, 0.0, 0.0) if slides else (0.0, -1.0, 0.0),
            parent=k - 1,
            slides=slides,
        )
        joints.append(joint._replace(armature=learned.rotors[k]))
        at += vectors[k]
    matrix = torch.linalg.inv(directions(coordinates.angular).double()) @ links.turn.double()
    return Linkage(joints, _in_space(gravity), matrix)


def constant_forces(links: PlanarLinks, coordinates: Coordinates) -> list[float]:
    """Return the force along each joint that is not the weight of what it carries, zero of hinges.

    It is in the units of the coordinates.
    """
    learned = _read(links, coordinates)
    gravity, _ = _gravity_and_moments(learned, coordinates)
    forces = [0.0] * learned.n
    for k in range(learned.slides):
        forces[k] = -learned.weights[k].real - gravity.real * learned.inertias[k]
    return forces


def distance_from_rigid(links: PlanarLinks, coordinates: Coordinates) -> float:
    """Return the largest difference of ``C`` and ``w`` from those of ``planar_bodies``.

    It is relative to their sizes, and zero if it is due to rounding, as that of one or two links.
    """
    learned = _read(links, coordinates)
    gravity, moments = _gravity_and_moments(learned, coordinates)
    heaviest = max(map(abs, learned.weights))
    found = 0.0
    for k in range(learned.slides, learned.n):
        if heaviest:
            apart = abs(learned.weights[k] + gravity.conjugate() * moments[k])
            found = max(found, apart / heaviest)
        vector = _vector(learned, moments, k)
        for j in range(k + 1, learned.n):
            apart = abs(learned.products[k][j] - vector.conjugate() * moments[j])
            found = max(found, apart / math.sqrt(learned.inertias[k] * learned.inertias[j]))
    return found if found > AGREEMENT else 0.0


def _read(links: PlanarLinks, coordinates: Coordinates) -> _Learned:
    angular, n = coordinates.angular, coordinates.n
    slides = n - sum(angular)
    if slides > 1 or any(angular[:slides]):
        raise ConfigError(
            "lagrangian=planar does not determine the order of several slides, or which bodies a "
            "slide after a hinge moves, as .xml and .urdf require; learn with lagrangian=rigid"
        )
    x, y = links.points.detach().double().view(n, 2, n).unbind(1)
    points = torch.complex(x, y)
    products = points.conj() @ points.T
    inertias = products.diagonal().real + links.inertias.detach().double().square()
    weights = torch.complex(*links.weights.detach().double().view(2, n))
    rotors = [0.0] * n
    if links.rotors is not None:
        rotors[slides + 1 :] = links.rotors.detach().double().square().tolist()
    return _Learned(products.tolist(), inertias.tolist(), weights.tolist(), rotors, slides)


def _gravity_and_moments(
    learned: _Learned, coordinates: Coordinates
) -> tuple[complex, list[complex]]:
    """Return ``γ`` and ``s``; ``s`` of slides is zero.

    Without a slide, ``γ`` is that of the earth, or less where the links hardly have a weight, as on
    vertical axes: bodies with so small moments under it would be thousands of kilometres long.
    """
    hinges = range(learned.slides, learned.n)
    if not learned.slides:
        earth = EARTH / coordinates.units.size("m/s^2")
        squared = max(abs(w) / h for w, h in zip(learned.weights, learned.inertias, strict=True))
        if 0.0 < FAR * squared < earth:
            earth = squared  # that of a pendulum with the unit length
        return -1j * earth, [1j * w / earth for w in learned.weights]
    moments = [0j] * learned.slides + [-1j * learned.products[0][k] for k in hinges]
    power = sum(abs(s) ** 2 for s in moments)
    if not power:
        return complex(-learned.weights[0].real / learned.inertias[0]), moments
    matched = sum(learned.weights[k] * moments[k].conjugate() for k in hinges)
    return -(matched / power).conjugate(), moments


def _vector(learned: _Learned, moments: list[complex], k: int) -> complex:
    """Return ``l_k`` by least squares; zero of a slide and of the last link."""
    beyond = range(k + 1, learned.n)
    power = sum(abs(moments[j]) ** 2 for j in beyond)
    if k < learned.slides or not power:
        return 0j
    matched = sum(learned.products[k][j] * moments[j].conjugate() for j in beyond)
    return (matched / power).conjugate()


def _carried(learned: _Learned, moments: list[complex], vectors: list[complex]) -> list[float]:
    """Return the mass that each joint carries: twice the least possible one, or near it.

    From the last link inwards: a link has a positive inertia about its centre if its mass is large
    enough, and leaves one to the link before if it is small enough. The least possible mass of a
    balanced link is almost zero.
    """
    found: list[float] = []
    for k in reversed(range(learned.slides, learned.n)):
        beyond = found[0] if found else 0.0
        own = learned.inertias[k] - beyond * abs(vectors[k]) ** 2
        least = beyond + abs(moments[k] - beyond * vectors[k]) ** 2 / own
        most = math.inf
        if k == learned.slides == 1:
            most = learned.inertias[0]
        elif k > learned.slides and vectors[k - 1]:
            most = learned.inertias[k - 1] / abs(vectors[k - 1]) ** 2
        if not least < most:
            raise ConfigError(
                "the learned inertia of lagrangian=planar is not one of rigid bodies, which .xml "
                "and .urdf require; learn with lagrangian=rigid, or write .pt2"
            )
        if least > beyond:
            chosen = min(max(2.0 * least, own / FAR**2), math.sqrt(least * most))
        else:  # a link without a first moment of its own: any mass
            chosen = beyond + (0.5 * (most - beyond) if math.isfinite(most) else own)
        found.insert(0, chosen)
    return learned.inertias[: learned.slides] + found


def _in_space(x: complex) -> Vector:
    """Return a vector of the plane, of which the second axis is vertical."""
    return x.real, 0.0, x.imag
