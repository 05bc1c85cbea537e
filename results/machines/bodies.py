"""Write recordings of four simulated bodies that turn freely.

Usage: ``python results/machines/bodies.py``. ``top.csv`` has a heavy top on a pivot, with three
torques, ``rod.csv`` a rod on a ball joint, without inputs, ``thrown.csv`` a body that is thrown 24
times, with gravity along -y and a frame 6 cm from its centre of mass, and ``quad.csv`` a quadrotor
with drag that a controller flies along paths, whose four inputs have no SI unit. Attitudes are unit
quaternions of either sign. Noise is 1e-3 [rad] of the first two and 2e-3 of the others, 5e-4 m of
the thrown body and 1e-3 m of the quadrotor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd

STEPS = 4
"""Steps of RK4 between samples."""
GRAVITY = np.array([0.0, 0.0, -9.81])
Array = np.ndarray
Forces = Callable[[Array, Array, Array, Array], tuple[Array, Array]]
"""Accelerations ``(ẍ, ω̇)`` from ``ẋ``, ``R``, ``ω`` and inputs."""


class State(NamedTuple):
    """Positions, velocities, unit quaternions and body rates, a row for each motion."""

    x: Array
    v: Array
    q: Array
    w: Array


def main() -> None:
    """Write all files."""
    rng = np.random.default_rng(0)
    for write in top, rod, thrown, quadrotor:
        write(rng)


def top(rng: np.random.Generator) -> None:
    """Write the motions of a heavy top."""
    inertia = np.array([[0.03, 0.005, 0.0], [0.005, 0.05, 0.0], [0.0, 0.0, 0.02]])
    moment = np.array([0.02, 0.01, -0.12])
    phase, frequency = rng.uniform(0, 6.28, (10, 3, 3)), rng.uniform(0.3, 2.5, (10, 3, 3))

    def forces(v: Array, axes: Array, w: Array, u: Array) -> tuple[Array, Array]:
        torque = u + np.cross(moment, in_body(axes, GRAVITY)) - 0.002 * w
        return 0.0 * v, spun(inertia, torque, w)

    def inputs(t: float, state: State) -> Array:
        return 0.15 * np.sin(2 * np.pi * frequency * t + phase).sum(axis=2) / 2

    still = np.zeros((10, 3))
    start = State(still, still, turned(rng.normal(0, 1.0, (10, 3))), rng.normal(0, 2, (10, 3)))
    record(rng, "top", *simulate(start, 0.005, 6.0, forces, inputs), 0.005, (None, 1e-3))


def rod(rng: np.random.Generator) -> None:
    """Write the motions of a rod on a ball joint."""
    inertia, moment = np.diag([0.021, 0.021, 0.0004]), np.array([0.0, 0.0, -0.1])

    def forces(v: Array, axes: Array, w: Array, u: Array) -> tuple[Array, Array]:
        torque = np.cross(moment, in_body(axes, GRAVITY)) - np.array([0.001, 0.001, 0.0001]) * w
        return 0.0 * v, spun(inertia, torque, w)

    still = np.zeros((10, 3))
    rates = turned(rng.normal(0, 0.7, (10, 3))), rng.normal(0, 1.5, (10, 3)) * [1, 1, 2]
    motion = simulate(State(still, still, *rates), 0.005, 6.0, forces, no_inputs)
    record(rng, "rod", *motion, 0.005, (None, 1e-3))


def thrown(rng: np.random.Generator) -> None:
    """Write the motions of a thrown body, of a point that is not its centre of mass."""
    inertia, point = np.diag([0.0008, 0.0012, 0.0006]), np.array([0.03, -0.02, 0.05])

    def forces(v: Array, axes: Array, w: Array, u: Array) -> tuple[Array, Array]:
        drag = 0.03 * v * np.linalg.norm(v, axis=1, keepdims=True) / 0.4
        return np.array([0.0, -9.81, 0.0]) - drag, spun(inertia, 0.0 * w, w)

    up = np.array([0.0, 1.0, 0.0])
    x, v = rng.normal(0, 0.3, (24, 3)) + up, rng.normal(0, 1.0, (24, 3)) + 5 * up
    start = State(x, v, turned(rng.normal(0, 1.5, (24, 3))), rng.normal(0, 8, (24, 3)))
    (x, v, q, w), u = simulate(start, 1 / 240, 1.2, forces, no_inputs)
    axes = matrices(q.reshape(-1, 4)).reshape(*q.shape[:2], 3, 3)
    motion = State(x + axes @ point, v, q, w), u
    record(rng, "thrown", *motion, 1 / 240, (5e-4, 2e-3))


def quadrotor(rng: np.random.Generator) -> None:
    """Write the flights of a quadrotor along sums of three sines in each direction."""
    mass, inertia = 0.9, np.diag([0.006, 0.007, 0.011])
    lift, lever, turn = 6e-5, 0.2 * 6e-5, 1e-6
    torques = [0, lever, 0, -lever], [-lever, 0, lever, 0], [turn, -turn, turn, -turn]
    matrix = np.array([[lift] * 4, *torques])
    size, frequency = rng.uniform(-1.2, 1.2, (8, 3, 4)), rng.uniform(0.1, 0.4, (8, 3, 4))
    phase = rng.uniform(0, 6.28, (8, 3, 4))

    def forces(v: Array, axes: Array, w: Array, u: Array) -> tuple[Array, Array]:
        wrench, through = u @ matrix.T, in_body(axes, v)
        force = np.concatenate([np.zeros((len(u), 2)), wrench[:, :1]], axis=1)
        force -= 0.25 * through * [1, 1, 0.6]
        torque = wrench[:, 1:] - 0.004 * w
        return in_world(axes, force) / mass + GRAVITY, spun(inertia, torque, w)

    def inputs(t: float, state: State) -> Array:
        axes = matrices(state.q)
        aim = (size * np.sin(2 * np.pi * frequency * t + phase)).sum(axis=2)
        wanted = 2.5 * (aim - state.x) - 2.2 * state.v - GRAVITY
        wanted /= np.maximum(1, np.linalg.norm(wanted, axis=1, keepdims=True) / 18)
        thrust = mass * np.einsum("bi,bi->b", wanted, axes[:, :, 2])
        upright = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
        lean = in_body(axes, np.cross(axes[:, :, 2], upright))
        lean[:, 2] = -0.5 * np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
        torque = lean * [0.5, 0.5, 0.1] - state.w * [0.09, 0.09, 0.06]
        torque += rng.normal(0, 0.01, torque.shape)
        return np.concatenate([thrust[:, None], torque], axis=1) @ np.linalg.inv(matrix).T

    still, attitude = np.zeros((8, 3)), turned(rng.normal(0, 0.1, (8, 3)))
    start = State(rng.normal(0, 1, (8, 3)), still, attitude, still)
    record(rng, "quad", *simulate(start, 0.01, 10.0, forces, inputs), 0.01, (1e-3, 2e-3))


def simulate(
    state: State, h: float, seconds: float, forces: Forces, inputs: Callable[[float, State], Array]
) -> tuple[State, Array]:
    """Return states and inputs ``h`` apart; inputs are held between samples."""
    states, controls, step = [], [], h / STEPS
    for k in range(int(seconds / h)):
        u = inputs(k * h, state)
        states.append(state)
        controls.append(u)

        def rates(at: State, u: Array = u) -> State:
            unit = at.q / np.linalg.norm(at.q, axis=1, keepdims=True)
            a, b = forces(at.v, matrices(unit), at.w, u)
            scalar = np.zeros((len(at.w), 1))
            return State(at.v, a, 0.5 * product(unit, np.concatenate([scalar, at.w], axis=1)), b)

        for _ in range(STEPS):
            one = rates(state)
            two = rates(moved(state, one, step / 2))
            three = rates(moved(state, two, step / 2))
            four = rates(moved(state, three, step))
            slopes = zip(one, two, three, four, strict=True)
            mean = State(*((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in slopes))
            state = moved(state, mean, step)
            state = state._replace(q=state.q / np.linalg.norm(state.q, axis=1, keepdims=True))
    fields = zip(*states, strict=True)
    return State(*(np.stack(field, axis=1) for field in fields)), np.stack(controls, axis=1)


def record(
    rng: np.random.Generator, name: str, state: State, u: Array, h: float,
    noise: tuple[float | None, float],
) -> None:  # fmt: skip
    """Write a table; ``noise`` is that of positions [m], if they are recorded, and attitudes."""
    count, nodes, m = u.shape
    rows, (length, angle) = count * nodes, noise
    q = product(state.q.reshape(-1, 4), turned(angle * rng.normal(size=(rows, 3))))
    q *= np.where(rng.random(count) < 0.5, -1, 1).repeat(nodes)[:, None]
    table = {
        "trajectory": np.repeat(np.arange(count), nodes),
        "t": np.tile(h * np.arange(nodes), count),
    }
    if length is not None:
        for i, axis in enumerate("xyz"):
            table[f"q_{axis}"] = state.x[:, :, i].ravel() + length * rng.normal(size=rows)
    table |= {f"q_R_{part}": q[:, i] for i, part in enumerate("wxyz")}
    table |= {f"u_{i}": u[:, :, i].ravel() for i in range(m)}
    pd.DataFrame(table).to_csv(f"{name}.csv", index=False)


def no_inputs(t: float, state: State) -> Array:
    """Return no inputs."""
    return np.zeros((len(state.q), 0))


def moved(state: State, rates: State, step: float) -> State:
    """Return a state after a step at constant rates."""
    return State(*(x + step * slope for x, slope in zip(state, rates, strict=True)))


def spun(inertia: Array, torque: Array, w: Array) -> Array:
    """Return ``ω̇`` of Euler's equations."""
    return np.asarray(np.linalg.solve(inertia, (torque - np.cross(w, w @ inertia)).T).T)


def in_body(axes: Array, x: Array) -> Array:
    """Return ``Rᵀ x``."""
    return np.asarray(np.einsum("bji,bj->bi", axes, np.broadcast_to(x, axes.shape[:2])))


def in_world(axes: Array, x: Array) -> Array:
    """Return ``R x``."""
    return np.asarray(np.einsum("bij,bj->bi", axes, x))


def product(a: Array, b: Array) -> Array:
    """Return the products of quaternions."""
    p, x, y, z = a.T
    s, u, v, w = b.T
    parts = (
        p * s - x * u - y * v - z * w, p * u + x * s + y * w - z * v,
        p * v - x * w + y * s + z * u, p * w + x * v - y * u + z * s,
    )  # fmt: skip
    return np.stack(parts, axis=1)


def turned(phi: Array) -> Array:
    """Return the unit quaternions of rotation vectors."""
    angle = np.linalg.norm(phi, axis=1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), np.sinc(angle / 2 / np.pi) / 2 * phi], axis=1)


def matrices(q: Array) -> Array:
    """Return the rotation matrices of unit quaternions."""
    w, x, y, z = q.T
    entries = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return np.stack(entries, axis=1).reshape(-1, 3, 3)


if __name__ == "__main__":
    main()
