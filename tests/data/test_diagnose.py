"""Diagnosis of recordings before training, tested on motions of known systems."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
import torch

from symo_exp.data.diagnose import Diagnosis, diagnose
from symo_exp.data.explained import contradiction, explained_power, input_gains, spring_slopes
from symo_exp.data.sensors import encoder_of, noise_of
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.simulation import Solver, simulate

H = 0.02


@cache
def motions(n: int, torque: float, count: int = 5, nodes: int = 120, size: float = 1.0):
    """Of a chain that is driven by smooth torques."""
    system = ChainPendulum(n, time_step=H)
    q0, v0, _ = system.box.points(count, 1)
    wave = torch.arange(1, count * n + 1).reshape(count, n).double()

    def drive(t: float) -> torch.Tensor:
        return torque * torch.sin(2 * t * (1 + 0.3 * wave) + wave)

    solver = Solver("DOP853", 1e-6, 1e-6)
    q, _, u = simulate(system, 0.5 * size * q0, 0.3 * size * v0, drive, nodes, solver)
    return system, [(a.numpy(), b.numpy()) for a, b in zip(q, u, strict=True)]


def found(n: int, torque: float, noise: float = 0.0, told: float = 1.0) -> Diagnosis:
    system, clean = motions(n, torque)
    rng = np.random.default_rng(0)
    noisy = [(q + noise * rng.standard_normal(q.shape), told * u) for q, u in clean]
    return diagnose(noisy, [q for q, _ in noisy], system.coordinates, H)


@pytest.mark.parametrize("n", [1, 2])
def test_inputs_that_move_a_machine_explain_its_motion(n: int) -> None:
    driven, untold = found(n, 5.0), found(n, 5.0, told=0.0)
    assert driven.explained > 0.95
    assert driven.free < driven.explained - 0.1
    assert driven.fixes_scale
    assert untold.explained == pytest.approx(driven.free)
    assert not untold.driven
    assert not untold.fixes_scale


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("told", [1.0, 1e-3])
def test_the_gains_of_inputs_tell_the_inertia_that_they_move(n: int, told: float) -> None:
    """Within a factor of 3; it is that of the lightest coordinates."""
    system, clean = motions(n, 5.0)
    q = torch.tensor(np.concatenate([q for q, _ in clean]))
    true = (torch.linalg.inv(system.mass_matrix(q)) @ system.input_matrix).mean(0)
    idle = [(q, np.concatenate([told * u, 0.0 * u], axis=1)) for q, u in clean]
    gains, none = np.split(input_gains(idle, system.coordinates, H), 2, axis=1)
    assert not none.any()
    assert gains.shape == true.shape
    assert 1 / 3 < told * np.linalg.norm(gains) / float(true.norm()) < 3


MIXED = {"gains": [[1.0, 0.0], [0.0, 4.0]], "coupled": [[1.0, 0.4], [-0.5, 0.8]]}


@pytest.mark.parametrize("mixed", MIXED)
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_motions_contradict_a_wrong_input_matrix_and_no_right_one(mixed: str, noise: float) -> None:
    """Inputs that were recorded in other units, or drive each other's coordinates."""
    system, clean = motions(2, 5.0, count=20, size=0.5)
    rng = np.random.default_rng(0)
    inverse = np.linalg.inv(MIXED[mixed]).T
    recorded = [(q + noise * rng.standard_normal(q.shape), u @ inverse) for q, u in clean]
    true = system.input_matrix.numpy() @ MIXED[mixed]
    given = recorded, system.coordinates, H
    right, wrong = contradiction(*given, true), contradiction(*given, system.input_matrix.numpy())
    assert right is not None
    assert wrong is not None
    assert right < 1.3
    assert wrong > 2.0


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_an_input_of_a_coordinate_that_never_moves_contradicts_nothing() -> None:
    system, clean = motions(2, 5.0, count=20, size=0.5)
    names, angular = system.coordinates.names, system.coordinates.angular
    both = Coordinates((names[0], "x", names[1]), (angular[0], False, angular[1]))
    held = [
        (np.insert(q, 1, 0.3, axis=1), np.insert(u, 1, u[:, 0] - u[:, 1] ** 2, axis=1))
        for q, u in clean
    ]
    plain = contradiction(clean, system.coordinates, H, np.array(MIXED["coupled"]))
    matrix = np.insert(np.insert(MIXED["coupled"], 1, 0.0, axis=0), 1, 0.0, axis=1)
    matrix[1, 1] = 1.0
    assert plain is not None
    assert contradiction(held, both, H, matrix) == pytest.approx(plain)


def test_one_driven_coordinate_contradicts_no_input_matrix() -> None:
    system, clean = motions(2, 5.0)
    given = [(q, u[:, :1]) for q, u in clean], system.coordinates, H
    assert contradiction(*given, np.array([[1.0], [0.0]])) is None


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_free_motion_is_explained_without_inputs_and_fixes_no_scale(n: int) -> None:
    free = found(n, 0.0)
    assert free.explained > 0.9
    assert not free.fixes_scale
    assert "no inputs" in free.lines()[-1]
    assert "%" not in free.lines()[0]


def test_inputs_of_another_machine_explain_nothing() -> None:
    system, clean = motions(1, 5.0)
    inputs = [np.random.default_rng(k).standard_normal(u.shape) for k, (_, u) in enumerate(clean)]
    mixed = [(q, u) for (q, _), u in zip(clean, inputs, strict=True)]
    wrong = diagnose(mixed, [q for q, _ in mixed], system.coordinates, H)
    assert wrong.explained < wrong.free + 0.05
    assert not wrong.fixes_scale
    assert "doubtful" in wrong.lines()[-1]


@pytest.mark.parametrize("std", [1e-4, 1e-3, 1e-2])
def test_noise_is_estimated(std: float) -> None:
    np.testing.assert_allclose(found(2, 5.0, std).noise, std, rtol=0.15)


@pytest.mark.parametrize("size", [1e-7, 1.0, 1e6])
def test_only_quantised_signals_have_an_encoder(size: float) -> None:
    q = np.sin(np.linspace(0, 20, 4000))
    assert encoder_of([size * q]) == 0
    step = 0.003 * size
    assert encoder_of([np.round(size * q / step) * step]) == pytest.approx(step)
    assert noise_of([size * q]) < 1e-9 * size
    assert encoder_of([np.zeros(9)]) == 0


def test_a_time_step_is_judged_by_how_far_angles_turn() -> None:
    good = found(1, 0.0)
    assert "suits" in good.lines()[2]
    assert "is fine" in found(1, 0.0, 3e-2).lines()[2]
    coarse = dataclasses.replace(good, turn=np.array([1.0]))
    assert "is coarse" in coarse.lines()[2]
    slides = dataclasses.replace(coarse, coordinates=Coordinates(("x",), (False,)))
    assert "suits" in slides.lines()[2]


def test_too_few_samples_have_no_diagnosis() -> None:
    tiny = diagnose(
        [(np.zeros((3, 1)), np.zeros((3, 0)))], [np.zeros((3, 1))], Coordinates(("x",), (True,)), H
    )
    assert tiny.explained is None
    assert len(tiny.lines()) == 4


def test_nothing_is_told_of_a_machine_at_rest() -> None:
    rest = np.zeros((999, 1))
    found = diagnose([(rest, rest + 0.5)], [rest], Coordinates(("x",), (True,)), H)
    inputs, *_, scale = found.lines()
    assert "too little motion" in inputs
    assert "too little motion" in scale


@pytest.mark.parametrize("torque", [0.0, 5.0])
@pytest.mark.parametrize("n", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("size", [1.0, pytest.param(0.1, marks=pytest.mark.slow)])
def test_angles_in_degrees_are_suspected(n: int, torque: float, size: float) -> None:
    system, clean = motions(n, size * torque, 5, 120, size)
    rng = np.random.default_rng(0)
    told = {}
    for unit, scale in {"radians": 1.0, "degrees": 180 / np.pi}.items():
        noisy = [(scale * (q + 1e-5 * rng.standard_normal(q.shape)), u) for q, u in clean]
        lines = diagnose(noisy, [q for q, _ in noisy], system.coordinates, H).lines()
        told[unit] = any("data.degrees=true" in line for line in lines)
    assert told == {"radians": False, "degrees": True}


@pytest.mark.parametrize("place", [0.0, 0.3, 1e4])
@pytest.mark.parametrize("n", [1, 2])
def test_coordinates_that_never_move_change_nothing_for_the_others(n: int, place: float) -> None:
    system, clean = motions(n, 5.0)
    rng = np.random.default_rng(0)
    rounding = place * np.finfo(float).eps
    columns = [place + rounding * rng.standard_normal((len(q), 1)) for q, _ in clean]
    beside = [(np.hstack([q, x]), u) for (q, u), x in zip(clean, columns, strict=True)]
    both = Coordinates((*system.coordinates.names, "x"), (*system.coordinates.angular, False))
    for driven in (True, False):
        share = explained_power(beside, both, H, driven=driven)
        assert share == pytest.approx(
            explained_power(clean, system.coordinates, H, driven=driven), abs=0.02
        )
    gains, plain = input_gains(beside, both, H), input_gains(clean, system.coordinates, H)
    np.testing.assert_allclose(gains[:n], plain, rtol=0.1, atol=0.1 * np.abs(plain).max())
    assert not gains[n:].any()


def test_springs_are_found_beside_a_coordinate_that_never_moves() -> None:
    t = H * np.arange(400)
    q = np.stack([np.cos(3.0 * t) * np.exp(-0.05 * t), np.full(len(t), 0.3)], axis=1)
    given = [((1 + 0.2 * k) * q, np.zeros((len(t), 0))) for k in range(3)]
    slopes = spring_slopes(given, Coordinates(("x", "y"), (False, False)), H)
    assert slopes is not None
    np.testing.assert_allclose(slopes, [[-9.0, 0.0], [0.0, 0.0]], rtol=0.05)
