"""Write recordings of eighteen simulated machines, most of them no chains of links in a plane.

Usage: ``python results/machines/others.py``. ``furuta.csv`` has a pendulum on an arm that turns
about a vertical axis, ``wheel.csv`` a pendulum with a reaction wheel, ``ball.csv`` a ball on a
beam, ``crane.csv`` a load on a rope whose length changes, ``masses.csv`` two masses on springs,
``duffing.csv`` a mass on a spring that stiffens, ``crank.csv`` a slider-crank, ``segway.csv`` a
body on two wheels that a controller balances, ``spring_pendulum.csv`` a mass on an elastic rope,
``scara.csv`` two horizontal links with a vertical slide, ``bistable.csv`` a magnet between two
others, and ``coupled.csv`` two pendulums with a spring between them. ``heli.csv`` has a helicopter
on a stand whose rotors each pitch and turn it, in volts, ``magnet.csv`` a ball below a magnet with
the current as input, ``lagged.csv`` a pendulum whose motor follows its voltage with a lag of 40 ms,
``torsion.csv`` a torsion pendulum with quadratic drag, ``stop.csv`` a mass on a spring between two
hard stops, and ``mems.csv`` a resonator of 2 kHz that moves by micrometres. Each has ten motions of
6 s, sampled every 5 ms with a noise of 3e-4 [rad, m], if not stated otherwise. Inputs [N m, N] are
sums of four sines and what a controller adds that keeps the machine in its range. They are held
between samples, as digital controllers hold them. All coordinates have viscous friction, some also
dry friction.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import sympy

COUNT, SECONDS, SAMPLE, STEPS, NOISE = 10, 6.0, 0.005, 4, 3e-4
"""Motions, their length, distance of samples [s], steps of RK4 in between, noise [rad, m]."""
GRAVITY = 9.81
Array = np.ndarray
Symbols = Sequence[Any]


class Simulated(NamedTuple):
    """A machine.

    Attributes:
        names: Of the coordinates.
        lagrangian: From symbols of coordinates and velocities.
        driven: Coordinates on which the inputs act.
        viscous: Coefficients of viscous friction.
        dry: Dry friction.
        low: Least starting configurations.
        high: Largest starting configurations.
        speed: Standard deviation of starting velocities.
        forces: Amplitudes of the inputs.
        control: Further inputs (rows, m), from coordinates and velocities (rows, n).
        acting: Generalised forces (rows, n), from coordinates, velocities and inputs; ``None``:
            the inputs themselves, on the driven coordinates.
        lag: Time constant with which inputs act [s].
        noise: Noise of the samples [rad, m].
        sample: Distance of the samples [s].
        seconds: Length of a motion [s].
    """

    names: Sequence[str]
    lagrangian: Callable[[Symbols, Symbols], Any]
    driven: Sequence[int]
    viscous: Sequence[float]
    dry: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]
    speed: float
    forces: Sequence[float]
    control: Callable[[Array, Array], Array] | None = None
    acting: Callable[[Array, Array, Array], Array] | None = None
    lag: float = 0.0
    noise: float = NOISE
    sample: float = SAMPLE
    seconds: float = SECONDS


def furuta(q: Symbols, v: Symbols) -> Any:
    arm = (0.014 + 0.00225 * sympy.sin(q[1]) ** 2) * v[0] ** 2 / 2
    both = 0.003 * sympy.cos(q[1]) * v[0] * v[1]
    return arm + both + 0.00305 * v[1] ** 2 / 2 + 0.015 * GRAVITY * sympy.cos(q[1])


def wheel(q: Symbols, v: Symbols) -> Any:
    return 0.01 * v[0] ** 2 + 0.0005 * (v[0] + v[1]) ** 2 + 0.7 * sympy.cos(q[0])


def ball(q: Symbols, v: Symbols) -> Any:
    rolling = (0.1 + 2e-5 / 0.015**2) * v[0] ** 2 / 2
    turning = (0.02 + 0.1 * q[0] ** 2) * v[1] ** 2 / 2
    return rolling + turning - 0.1 * GRAVITY * q[0] * sympy.sin(q[1])


def crane(q: Symbols, v: Symbols) -> Any:
    across = v[0] + v[1] * sympy.sin(q[2]) + q[1] * v[2] * sympy.cos(q[2])
    down = v[1] * sympy.cos(q[2]) - q[1] * v[2] * sympy.sin(q[2])
    return v[0] ** 2 + 0.4 * (across**2 + down**2) + 0.8 * GRAVITY * q[1] * sympy.cos(q[2])


def masses(q: Symbols, v: Symbols) -> Any:
    springs = 50.0 * q[0] ** 2 + 30.0 * (q[1] - q[0]) ** 2
    return v[0] ** 2 / 2 + 0.5 * v[1] ** 2 / 2 - springs / 2


def duffing(q: Symbols, v: Symbols) -> Any:
    return 1.5 * v[0] ** 2 / 2 - 20.0 * q[0] ** 2 / 2 - 400.0 * q[0] ** 4 / 4


def crank(q: Symbols, v: Symbols) -> Any:
    radius, rod = 0.05, 0.15
    slider = radius * sympy.cos(q[0]) + sympy.sqrt(rod**2 - (radius * sympy.sin(q[0])) ** 2)
    sliding = 0.5 * (sympy.diff(slider, q[0]) * v[0]) ** 2 / 2
    return 0.0006 * v[0] ** 2 / 2 + sliding - 0.5 * GRAVITY * slider


def segway(q: Symbols, v: Symbols) -> Any:
    radius, mass, height = 0.05, 0.6, 0.12
    wheels, lean = v[0] + v[1], v[1]  # the motor turns the wheels relative to the body
    forward = radius * wheels + height * lean * sympy.cos(q[1])
    body = mass * (forward**2 + (height * lean * sympy.sin(q[1])) ** 2) + 0.002 * lean**2
    rolling = (0.25 * radius**2 + 1e-4) * wheels**2
    return (rolling + body) / 2 - mass * GRAVITY * height * sympy.cos(q[1])


def spring_pendulum(q: Symbols, v: Symbols) -> Any:
    moving = 0.5 * (v[0] ** 2 + q[0] ** 2 * v[1] ** 2) / 2
    return moving - 60.0 * (q[0] - 0.4) ** 2 / 2 + 0.5 * GRAVITY * q[0] * sympy.cos(q[1])


def scara(q: Symbols, v: Symbols) -> Any:
    shoulder = (0.12 + 0.06 * sympy.cos(q[1])) * v[0] ** 2 / 2
    links = shoulder + (0.03 * sympy.cos(q[1]) + 0.02) * v[0] * v[1] + 0.02 * v[1] ** 2 / 2
    return links + 1.2 * v[2] ** 2 / 2 - 1.2 * GRAVITY * q[2]


def bistable(q: Symbols, v: Symbols) -> Any:
    return 0.02 * v[0] ** 2 / 2 - 0.25 * sympy.cos(2 * q[0]) - 0.1 * sympy.cos(q[0] - 0.3)


def coupled(q: Symbols, v: Symbols) -> Any:
    gravity = 0.6 * sympy.cos(q[0]) + 0.8 * sympy.cos(q[1])
    return (0.03 * v[0] ** 2 + 0.05 * v[1] ** 2) / 2 + gravity - 0.4 * (q[0] - q[1]) ** 2 / 2


def heli(q: Symbols, v: Symbols) -> Any:
    pitching = 0.04 * v[0] ** 2 / 2 + 0.25 * sympy.cos(q[0] - 0.1)
    return pitching + (0.012 + 0.03 * sympy.cos(q[0]) ** 2) * v[1] ** 2 / 2


def rotors(q: Array, v: Array, u: Array) -> Array:
    """Torques by the voltages of two rotors, each of which pitches and turns the body."""
    return u @ np.array([[0.10, -0.03], [0.015, 0.06]])


def magnet(q: Symbols, v: Symbols) -> Any:
    return 0.05 * v[0] ** 2 / 2 + 0.05 * GRAVITY * q[0]


def attraction(q: Array, v: Array, u: Array) -> Array:
    """Force by the current of a coil, upwards, which holds a ball 1 cm below it with 1 A."""
    return -4.905e-5 * u**2 / np.maximum(q, 3e-3) ** 2


def lagged(q: Symbols, v: Symbols) -> Any:
    return 0.02 * v[0] ** 2 / 2 + 0.4 * sympy.cos(q[0])


def torsion(q: Symbols, v: Symbols) -> Any:
    return 0.02 * v[0] ** 2 / 2 - 0.5 * q[0] ** 2 / 2


def stop(q: Symbols, v: Symbols) -> Any:
    return 0.5 * v[0] ** 2 / 2 - 8.0 * q[0] ** 2 / 2


def stopped(q: Array, v: Array, u: Array) -> Array:
    """Force by an input and by stops at 12 cm, which do not pull."""
    beyond, side = np.maximum(np.abs(q) - 0.12, 0.0), np.sign(q)
    return u - side * np.maximum(8e3 * beyond + 8.0 * side * v * (beyond > 0.0), 0.0)


def mems(q: Symbols, v: Symbols) -> Any:
    mass, stiffness = 1e-9, 1e-9 * (2 * np.pi * 2e3) ** 2
    return mass * v[0] ** 2 / 2 - stiffness * (q[0] ** 2 / 2 + q[0] ** 4 / (4e-6) ** 2 / 4)


MACHINES = {
    "furuta": Simulated(
        ("arm", "pendulum"), furuta, [0], (0.002, 0.0002), (0.004, 0.0),
        (-1.0, -2.5), (1.0, 2.5), 0.5, [0.06],
        lambda q, v: -0.05 * q[:, :1] - 0.01 * v[:, :1],
    ),
    "wheel": Simulated(
        ("theta", "wheel"), wheel, [1], (0.003, 0.0005), (0.0, 0.003),
        (-2.0, -2.0), (2.0, 2.0), 0.5, [0.1],
        lambda q, v: -0.0005 * v[:, 1:],
    ),
    "ball": Simulated(
        ("ball", "beam"), ball, [1], (0.02, 0.01), (0.0, 0.002),
        (-0.2, -0.2), (0.2, 0.2), 0.05, [0.15],
        lambda q, v: q @ [[2.581], [-2.0]] + v @ [[1.0], [-0.25]],
    ),
    "crane": Simulated(
        ("cart", "rope", "theta"), crane, [0, 1], (2.0, 3.0, 0.01), (0.5, 0.5, 0.0),
        (-0.2, 0.5, -0.6), (0.2, 0.8, 0.6), 0.1, [8.0, 3.0],
        lambda q, v: (q[:, :2] - [0.0, 0.65]) * [-20.0, -60.0]
        + v[:, :2] * [-8.0, -10.0] - [0.0, 0.8 * GRAVITY],
    ),
    "masses": Simulated(
        ("x_a", "x_b"), masses, [0], (0.4, 0.2), (0.1, 0.0), (-0.2, -0.2), (0.2, 0.2), 0.3, [5.0],
    ),
    "duffing": Simulated(("x",), duffing, [0], (0.5,), (0.2,), (-0.3,), (0.3,), 0.5, [6.0]),
    "crank": Simulated(("crank",), crank, [0], (0.003,), (0.01,), (-3.0,), (3.0,), 2.0, [0.25]),
    "segway": Simulated(
        ("motor", "lean"), segway, [0], (0.002, 0.001), (0.01, 0.0),
        (-1.0, -0.15), (1.0, 0.15), 0.3, [0.25],
        lambda q, v: q @ [[0.02], [3.02]] + v @ [[0.03], [0.38]],
    ),
    "spring_pendulum": Simulated(
        ("r", "theta"), spring_pendulum, [], (0.1, 0.003), (0.0, 0.0),
        (0.4, -1.0), (0.6, 1.0), 0.4, [],
    ),
    "scara": Simulated(
        ("shoulder", "elbow", "z"), scara, [0, 1, 2], (0.1, 0.05, 3.0), (0.1, 0.05, 1.0),
        (-1.0, -1.5, -0.1), (1.0, 1.5, 0.1), 0.3, [1.5, 0.6, 6.0],
        lambda q, v: q * [-1.0, -0.3, -40.0] + v * [-0.05, -0.02, -4.0]
        + [0.0, 0.0, 1.2 * GRAVITY],
    ),
    "bistable": Simulated(
        ("theta",), bistable, [0], (0.002,), (0.0,), (-2.0,), (2.0,), 1.0, [0.25],
    ),
    "coupled": Simulated(
        ("one", "two"), coupled, [], (0.002, 0.003), (0.0, 0.0), (-1.5, -1.5), (1.5, 1.5), 1.0, [],
    ),
    "heli": Simulated(
        ("pitch", "yaw"), heli, [0, 1], (0.008, 0.01), (0.003, 0.004),
        (-0.3, -1.0), (0.5, 1.0), 0.2, [3.0, 3.0],
        lambda q, v: (q - [0.1, 0.0]) * [-1.0, -0.8] + v * [-0.2, -0.4],
        acting=rotors,
    ),
    "magnet": Simulated(
        ("x",), magnet, [0], (0.01,), (0.0,), (0.009,), (0.011,), 0.01, [0.08],
        lambda q, v: 1.0 + 260.0 * (q - 0.01) + 4.0 * v,
        acting=attraction, noise=2e-6, sample=0.001,
    ),
    "lagged": Simulated(
        ("pendulum",), lagged, [0], (0.004,), (0.01,), (-1.5,), (1.5,), 1.0, [3.0],
        acting=lambda q, v, u: 0.2 * u, lag=0.04,
    ),
    "torsion": Simulated(
        ("theta",), torsion, [], (0.0005,), (0.0,), (-2.5,), (2.5,), 4.0, [],
        acting=lambda q, v, u: -0.004 * np.abs(v) * v,
    ),
    "stop": Simulated(
        ("slide",), stop, [0], (0.3,), (0.1,), (-0.1,), (0.1,), 0.3, [3.5], acting=stopped,
    ),
    "mems": Simulated(
        ("x",), mems, [0], (1e-9 * 2 * np.pi * 2e3 / 40,), (0.0,), (-2e-6,), (2e-6,), 0.01, [5e-8],
        noise=2e-9, sample=1e-5, seconds=0.02,
    ),
}  # fmt: skip


def main() -> None:
    """Write all files."""
    argparse.ArgumentParser(description=__doc__).parse_args()  # -h, and nothing else
    for name, machine in MACHINES.items():
        recorded(machine).to_csv(f"{name}.csv", index=False)


def recorded(machine: Simulated) -> pd.DataFrame:
    """Return the recordings of a machine."""
    rng, n, m = np.random.default_rng(0), len(machine.names), len(machine.driven)
    q = rng.uniform(machine.low, machine.high, (COUNT, n))
    v = rng.normal(0.0, machine.speed, (COUNT, n))
    frequency = rng.uniform(0.3, 4.0, (4, COUNT, m))
    phase = rng.uniform(0.0, 2 * np.pi, (4, COUNT, m))
    size = np.array(machine.forces) * rng.uniform(0.4, 1.0, (COUNT, 1))
    slope, table = slopes(machine), []
    h, held = machine.sample / STEPS, np.zeros((COUNT, m))
    frequency = frequency * SECONDS / machine.seconds
    for t in np.arange(0.0, machine.seconds, machine.sample):
        u = size * np.sin(np.pi * frequency * t + phase).sum(0) / 2
        if machine.control is not None:
            u = u + machine.control(q, v)
        read = q + machine.noise * rng.normal(size=q.shape)
        table.append(np.column_stack([np.arange(COUNT), np.full(COUNT, t), read, u]))
        for _ in range(STEPS):
            f, held = held, _after(held, u, h, machine.lag)
            a = slope(q, v, _after(f, u, 0.0, machine.lag))
            b = slope(q + h / 2 * v, v + h / 2 * a, _after(f, u, h / 2, machine.lag))
            c = slope(q + h / 2 * v + h**2 / 4 * a, v + h / 2 * b, _after(f, u, h / 2, machine.lag))
            d = slope(q + h * v + h**2 / 2 * b, v + h * c, held)
            q, v = q + h * v + h**2 / 6 * (a + b + c), v + h / 6 * (a + 2 * b + 2 * c + d)
    columns = ["trajectory", "t", *(f"q_{name}" for name in machine.names)]
    columns += [f"u_{i}" for i in range(m)]
    rows = np.concatenate(table)
    found = pd.DataFrame(rows, columns=columns).astype({"trajectory": int})
    return found.sort_values(["trajectory", "t"])


def _after(held: Array, u: Array, t: float, lag: float) -> Array:
    """Return what acts ``t`` [s] after an input ``u`` was set, ``held`` having acted before."""
    return u + (held - u) * np.exp(-t / lag) if lag else u


def slopes(machine: Simulated) -> Callable[[Array, Array, Array], Array]:
    """Return the accelerations of rows of states under inputs, by the Euler-Lagrange equations."""
    n = len(machine.names)
    q, v = (list(sympy.symbols(f"{x}:{n}", real=True)) for x in "qv")
    found = machine.lagrangian(q, v)
    momentum = [sympy.diff(found, x) for x in v]
    inertia = [sympy.diff(p, x) for p in momentum for x in v]
    turning = [sum(sympy.diff(p, x) * y for x, y in zip(q, v, strict=True)) for p in momentum]
    force = [sympy.diff(found, x) - y for x, y in zip(q, turning, strict=True)]
    both = sympy.lambdify([q, v], [*inertia, *force], "numpy", cse=True)
    viscous, dry = np.array(machine.viscous), np.array(machine.dry)

    def slope(q: Array, v: Array, u: Array) -> Array:
        numbers = np.stack([np.broadcast_to(x, len(q)) for x in both(q.T, v.T)], axis=1)
        moved = numbers[:, n * n :] - viscous * v - dry * np.tanh(v / 0.02)
        if machine.acting is None:
            moved[:, machine.driven] += u
        else:
            moved += machine.acting(q, v, u)
        mass = numbers[:, : n * n].reshape(-1, n, n)
        return np.asarray(np.linalg.solve(mass, moved[..., None])[..., 0])

    return slope


if __name__ == "__main__":
    main()
