"""Write recordings of two simulated machines with springs.

Usage: ``python results/machines/elastic.py``. ``elastic_joint.csv`` has a motor that moves a link
through a spring, read by encoders of 4096 steps a turn; ``mass_on_spring.csv`` a mass with viscous
and dry friction that a chirp drives. Both have 60 s.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

SECONDS, ENCODER = 60.0, 2 * np.pi / 4096


def main() -> None:
    """Write both files."""
    elastic_joint().to_csv("elastic_joint.csv", index=False)
    mass_on_spring().to_csv("mass_on_spring.csv", index=False)


def elastic_joint() -> pd.DataFrame:
    """Return the log of a motor [N m] with a link at the other end of a spring [rad]."""
    t, torque = np.arange(0.0, SECONDS, 0.005), []
    random = np.random.default_rng(2)
    while len(torque) < len(t):  # steps of 0.2 to 1.2 s
        torque += [random.uniform(-1.0, 1.0)] * int(random.uniform(40, 240))
    u = np.array(torque[: len(t)])

    def rates(s: float, x: np.ndarray) -> list[float]:
        motor, link, motor_speed, link_speed = x
        twist = 1.4 * (motor - link) + 0.01 * (motor_speed - link_speed)
        friction = 0.05 * motor_speed + 0.05 * np.tanh(motor_speed / 0.02)
        moved = np.interp(s, t, u) - twist - friction
        return [motor_speed, link_speed, moved / 0.012, (twist - 0.004 * link_speed) / 0.008]

    q = ENCODER * np.round(_solved(rates, 4, t)[:2] / ENCODER)
    return pd.DataFrame({"t": t, "q_motor": q[0], "q_link": q[1], "u_motor": u})


def mass_on_spring() -> pd.DataFrame:
    """Return the log of a mass [m] that a force [N] drives."""
    t = np.arange(0.0, SECONDS, 0.01)
    u = 4.0 * np.sin(2 * np.pi * (0.1 * t + 0.02 * t**2))

    def rates(s: float, x: np.ndarray) -> list[float]:
        friction = 2.0 * x[1] + 0.6 * np.tanh(x[1] / 0.01)
        return [x[1], (np.interp(s, t, u) - 30.0 * x[0] - friction) / 1.3]

    noise = 1e-5 * np.random.default_rng(1).normal(size=len(t))
    return pd.DataFrame({"t": t, "q_x": _solved(rates, 2, t)[0] + noise, "u_x": u})


def _solved(rates: object, size: int, t: np.ndarray) -> np.ndarray:
    return np.asarray(solve_ivp(rates, (0.0, SECONDS), [0.0] * size, t_eval=t, max_step=0.002).y)


if __name__ == "__main__":
    main()
