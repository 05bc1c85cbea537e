"""A real nano-quadrotor: recorded flights as a table, and the errors of models on them.

python results/rigid/nanobench.py convert nanobench.parquet flights.parquet
python results/rigid/nanobench.py errors flights.parquet outputs/flights --part val
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from scipy.optimize import least_squares
from torch import Tensor

import symo_exp
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.evaluation.horizon import Predictions, cut, predict
from symo_exp.evaluation.references import ConstantVelocity, Continuous
from symo_exp.mechanics.space import Space, rotation_vector
from symo_exp.mechanics.types import Trajectory
from symo_exp.models.starts import RollsOut

TIME_STEP, HORIZON = 0.02, 0.5
"""Step of the models and length of a prediction [s]."""
FULL, LAG, TRIM = 65535.0, 0.04, 2.0
"""PWM of a rotor at full voltage, time constants of the rotors and of running means [s]."""
MASS, INERTIA, ARM = 0.027, (16.57e-6, 16.66e-6, 29.26e-6), 0.046
"""Of a Crazyflie 2: kg (as the makers of the data say), kg m² (Förster 2015), m."""
SIDES = np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0]])
"""Signs of the torques of the rotors about the body axes; they are numbered clockwise, the first in
front on the right, and turn in turns."""
SPACE = Space(rotations=1)


def convert(source: Path, target: Path) -> None:
    """Write the flights as a table of recordings.

    A rotor lifts with ``V²``, its voltage ``V`` the PWM times the battery's, behind a lag of first
    order. The unit of lift is its running mean over the past: batteries and rotors wear, and in the
    mean a flight carries its weight. The inputs are ``u_lift``, the mean of the four rotors,
    ``u_roll``, ``u_pitch`` and ``u_yaw``, their differences without their own running mean (every
    flight needs others to fly straight), and ``u_one``, 1, for a constant force and torque.
    """
    given = pd.read_parquet(source)
    parts = []
    for _, flight in given.groupby("trajectory", sort=False):
        t = flight.t.to_numpy()
        columns = {"trajectory": flight.trajectory, "split": flight.split, "t": t}
        columns |= {f"q_{a}": flight[f"p_{a}"] for a in "xyz"}
        columns |= {f"q_R_{a}": flight[f"quat_{a}"] for a in "wxyz"}
        columns |= {f"v_{a}": flight[f"v_{a}"] for a in "xyz"}
        columns |= {f"v_R_{a}": flight[f"w_{a}"] for a in "xyz"}
        voltage = flight[[f"u_{i}" for i in range(1, 5)]].to_numpy(float) / FULL
        lift = lagged(t, voltage * flight.vbat.to_numpy(float)[:, None], LAG) ** 2
        lift /= lagged(t, lift.mean(1, keepdims=True), TRIM)
        sides = lift @ SIDES.T / 4
        sides -= lagged(t, sides, TRIM)
        columns |= {"u_lift": lift.mean(1)}
        columns |= {f"u_{a}": x for a, x in zip(("roll", "pitch", "yaw"), sides.T, strict=True)}
        columns["u_one"] = 1.0
        parts.append(pd.DataFrame(columns))
    table = pd.concat(parts)
    numbers = table.columns[2:]
    table.astype(dict.fromkeys(numbers, float)).to_parquet(target, index=False)
    print(f"{target}: {len(parts)} flights")


def lagged(t: np.ndarray, x: np.ndarray, lag: float) -> np.ndarray:
    """Return ``y`` of ``lag ẏ = x − y`` (T, m), with ``x`` linear between samples.

    It begins with the mean of ``x`` over the first lag.
    """
    y = x.copy()
    y[0] = x[t <= t[0] + lag].mean(0)
    for k, h in enumerate(np.diff(t)):
        rise = lag * (x[k + 1] - x[k]) / h
        y[k + 1] = x[k + 1] - rise + (y[k] - x[k] + rise) * np.exp(-h / lag)
    return y


def read(source: Path) -> RecordedData:
    """Return the flights at the nodes of the models."""
    system = recorded_system(
        source, time_step=TIME_STEP, angular="none", rotations=["R"],
        input_matrix=np.zeros((6, 5)),
    )  # fmt: skip
    data = RecordedData(system=system, path=source)
    data.setup()
    return data


class PhysicalModel:
    """A Crazyflie of known mass, inertia and arms.

    Args:
        lift: Thrust of a rotor whose lift is 1 [N].
        share: Of the torques of the rotors that acts.
        turn: Torque of a rotor about its axis over its thrust [m].
    """

    def __init__(self, lift: float, share: float, turn: float) -> None:
        self._lift, lever = 4.0 * lift, ARM / 2**0.5
        torques = torch.tensor([lever, lever, turn], dtype=torch.float64)
        self._torques = share * self._lift * torques
        self._inertia = torch.tensor(INERTIA, dtype=torch.float64)

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """Return ``v̇`` and ``ω̇``."""
        up, spin = q[:, 3:].unflatten(1, (3, 3))[:, :, 2], v[:, 3:]
        weight = torch.tensor([0.0, 0.0, -9.81]).to(q)
        linear = up * u[:, :1] * self._lift / MASS + weight
        torque = u[:, 1:4] * self._torques - torch.linalg.cross(spin, self._inertia * spin)
        return torch.cat((linear, torque / self._inertia), dim=1)


def fitted_physics(flights: Sequence[Trajectory]) -> Continuous:
    """Return the physical model whose rotors fit rollouts of 0.5 s from measured states best.

    Least squares of position [m] and attitude [rad] with Huber's loss.
    """
    steps = round(HORIZON / TIME_STEP)
    windows = [
        Trajectory(*(x[k : k + steps + 1] for x in flight))
        for flight in flights
        for k in range(0, len(flight.q) - steps, steps)
    ]
    q, v, u = (torch.stack(x).double() for x in zip(*windows, strict=True))
    start = np.array([MASS * 9.81 / 4, 0.05, 0.006])

    def model(x: np.ndarray) -> Continuous:
        return Continuous(PhysicalModel(*(start * x)), TIME_STEP, 1, SPACE)

    def residuals(x: np.ndarray) -> np.ndarray:
        moved = model(x).rollout(q[:, 0], v[:, 0], u).q
        return SPACE.difference(q, moved).flatten().numpy()

    found = least_squares(residuals, np.ones(3), loss="huber", f_scale=0.05)
    print(
        "physical model: lift {:.4g} N, share of the torques {:.3g}, turn {:.3g} m".format(
            *start * found.x
        )
    )
    return model(found.x)


def errors(source: Path, folder: Path | None, part: str) -> None:
    """Print the errors of the baselines and of each run in a folder."""
    data = read(source)
    windows = cut(data.trajectories(part), TIME_STEP, run_in=True)
    assert windows is not None
    print(f"{part}: {len(windows.q)} windows")
    models: dict[str, RollsOut] = {"constant velocity": ConstantVelocity(TIME_STEP, SPACE)}
    models["physical"] = fitted_physics(data.trajectories("train"))
    for path in sorted(folder.glob("*/config.yaml")) if folder else []:
        models[path.parent.name] = symo_exp.load(path.parent).for_evaluation()
    for name, model in models.items():
        show(name, predict(model, windows))


def show(name: str, found: Predictions) -> None:
    """Print the errors to 0.5 s: position, velocity, attitude and body rates.

    The median over windows of the root mean square over time, and that over all windows.
    """
    until = slice(1, 1 + round(HORIZON / TIME_STEP))
    q, v = found.q[:, until], found.v[:, until]
    true, rate = found.q_true[:, until], found.v_true[:, until]
    turn, true_turn = (x[..., 3:].unflatten(-1, (3, 3)) for x in (q, true))
    squares = (
        (q - true)[..., :3].square().sum(-1),
        (v - rate)[..., :3].square().sum(-1),
        rotation_vector(true_turn.mT @ turn).square().sum(-1),
        (v - rate)[..., 3:].square().sum(-1),
    )
    medians = [float(x.mean(1).sqrt().median()) for x in squares]
    pooled = [float(x.mean().sqrt()) for x in squares]
    print(f"{name:40}", *(f"{x:.4f}" for x in medians), "|", *(f"{x:.4f}" for x in pooled))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=["convert", "errors"])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path, nargs="?")
    parser.add_argument("--part", default="val", choices=["val", "test"])
    given = parser.parse_args()
    if given.what == "convert":
        convert(given.first, given.second)
    else:
        errors(given.first, given.second, given.part)
