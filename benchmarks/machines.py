"""`python -m benchmarks.machines`: random machines, each identified by the one command.

Chains and carts in a plane, of one to three coordinates, with friction over three decades, noise,
encoders, irregular clocks, driven or free. For each a row with how the command ended, the errors of
the model, of constant velocity and of the true system in the same windows, and the time it took. A
table that is there already is continued.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

GRAVITY = 9.81
HARDLY = "no model; "
"""The beginning of the verdict on a model that was tested."""
COLUMNS = (
    "machine", "coordinates", "cart", "relative", "driven", "log", "noise", "encoder", "rate",
    "viscous", "coulomb", "code", "verdict", "chosen", "rmse_0.5s", "rmse_1s", "rmse_2s",
    "constant_velocity_rmse_0.5s", "constant_velocity_rmse_1s", "constant_velocity_rmse_2s",
    "true_rmse_0.5s", "true_rmse_1s", "true_rmse_2s", "seconds",
)  # fmt: skip


@dataclass(frozen=True)
class RandomMachine:
    """A cart, or none, and links in a plane below it.

    Args:
        number: Seed of everything.
    """

    number: int

    @cached_property
    def _rng(self) -> np.random.Generator:
        return np.random.default_rng([2024, self.number])

    @cached_property
    def settings(self) -> dict[str, float]:
        """Return what distinguishes the machine in the table."""
        rng = self._rng
        n = int(rng.integers(1, 4))
        cart = bool(n > 1 and rng.random() < 0.4)
        return {
            "coordinates": n,
            "cart": cart,
            "relative": bool(rng.random() < 0.5),
            "driven": bool(rng.random() < 0.5),
            "log": bool(rng.random() < 0.25),
            "noise": 10 ** rng.uniform(-4, math.log10(3e-3)),
            "encoder": 2 * math.pi / 2 ** rng.integers(12, 16) if rng.random() < 0.3 else 0.0,
            "rate": float(rng.choice([100, 200, 250, 500])),
            "viscous": 10 ** rng.uniform(-3, 0),
            "coulomb": 10 ** rng.uniform(-3, 0) if rng.random() < 0.6 else 0.0,
        }

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self.settings["coordinates"])

    @cached_property
    def sizes(self) -> dict[str, np.ndarray]:
        """Masses, lengths, centres, inertias of the links; friction of the joints."""
        settings, rng = self.settings, np.random.default_rng([2025, self.number])
        links = self.n - int(settings["cart"])
        mass, length = rng.uniform(0.1, 1.0, links), rng.uniform(0.15, 0.5, links)
        centre = length * rng.uniform(0.4, 0.9, links)
        inertia = mass * length**2 * rng.uniform(0.02, 0.12, links)
        tail = np.append(np.cumsum(mass[::-1])[::-1][1:], 0.0)
        # friction is a share of the torque that holds the links level, over three decades
        scale = np.full(self.n, GRAVITY * float(mass @ centre))
        vary = rng.uniform(0.5, 2.0, (2, self.n))
        return {
            "mass": mass,
            "length": length,
            "moment": mass * centre + length * tail,
            "inertia": inertia + mass * centre**2 + length**2 * tail,
            "cart": np.array([rng.uniform(0.3, 2.0)]),
            "viscous": 0.1 * settings["viscous"] * scale * vary[0],
            "coulomb": 0.2 * settings["coulomb"] * scale * vary[1],
        }

    @cached_property
    def joints(self) -> np.ndarray:
        """Return the matrix from speeds of absolute coordinates to those of the joints."""
        first = int(self.settings["cart"])
        found = np.eye(self.n)
        for i in range(first + 1, self.n):
            found[i, i - 1] = -1.0
        return found

    @cached_property
    def actuated(self) -> np.ndarray:
        """Return which joints have a motor."""
        rng = np.random.default_rng([2026, self.number])
        if not self.settings["driven"]:
            return np.zeros(self.n, dtype=bool)
        chosen = rng.random(self.n) < 0.7
        chosen[0] = True
        return np.asarray(chosen)

    @property
    def to_absolute(self) -> np.ndarray:
        """Return the matrix from recorded to absolute coordinates."""
        return np.linalg.inv(self.joints) if self.settings["relative"] else np.eye(self.n)

    @property
    def input_matrix(self) -> np.ndarray:
        """Return ``B`` in the recorded coordinates."""
        return (self.joints @ self.to_absolute).T[:, self.actuated]

    def accelerate(self, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return accelerations of absolute coordinates, rows each, under torques of the joints."""
        s, first = self.sizes, int(self.settings["cart"])
        phi, rate = q[:, first:], v[:, first:]
        difference = phi[:, :, None] - phi[:, None, :]
        order = np.arange(phi.shape[1])
        low, high = np.minimum.outer(order, order), np.maximum.outer(order, order)
        coupling = s["length"][low] * s["moment"][high]
        np.fill_diagonal(coupling, s["inertia"])
        mass = np.zeros((len(q), self.n, self.n))
        force = np.zeros_like(q)
        mass[:, first:, first:] = coupling * np.cos(difference)
        force[:, first:] = -(coupling * np.sin(difference) * rate[:, None, :] ** 2).sum(2)
        force[:, first:] -= GRAVITY * s["moment"] * np.sin(phi)
        if first:
            mass[:, 0, 0] = s["cart"][0] + s["mass"].sum()
            mass[:, 0, 1:] = mass[:, 1:, 0] = s["moment"] * np.cos(phi)
            force[:, 0] = (s["moment"] * np.sin(phi) * rate**2).sum(1)
        turn = v @ self.joints.T
        friction = s["viscous"] * turn + s["coulomb"] * np.tanh(turn / 0.02)
        force += (torque - friction) @ self.joints
        return np.asarray(np.linalg.solve(mass, force[..., None])[..., 0])

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """Return accelerations of the recorded coordinates: a ``Reference``."""
        away, torque = self.to_absolute, np.zeros((len(q), self.n))
        torque[:, self.actuated] = u.numpy()
        found = self.accelerate(q.numpy() @ away.T, v.numpy() @ away.T, torque)
        return torch.from_numpy(found @ np.linalg.inv(away).T)

    def record(self) -> pd.DataFrame:
        """Return the recordings: motions of a few seconds, or one long log."""
        rng, s = np.random.default_rng([2027, self.number]), self.settings
        count, seconds = (1, 60.0) if s["log"] else (int(rng.integers(6, 13)), rng.uniform(4, 8))
        return pd.concat([self._motion(rng, i, seconds) for i in range(count)])

    def _motion(self, rng: np.random.Generator, index: int, seconds: float) -> pd.DataFrame:
        s, n, first = self.settings, self.n, int(self.settings["cart"])
        t = np.arange(0.0, seconds, 1 / s["rate"])
        holding = GRAVITY * float(self.sizes["moment"].max())
        size = self.actuated * holding * rng.uniform(0.2, 0.7, n) * (1.0 if s["driven"] else 0.0)
        frequency, phase = rng.uniform(0.3, 8.0, (4, n)), rng.uniform(0, 2 * np.pi, (4, n))

        def torque(at: float, x: np.ndarray) -> np.ndarray:
            found = size * np.sin(frequency * at + phase).sum(0) / 2
            if first and self.actuated[0]:  # it is held about the middle
                found[0] -= 10.0 * holding * x[0] + 2.0 * holding * x[n]
            return np.asarray(found)

        def slope(at: float, x: np.ndarray) -> np.ndarray:
            q, v = x[None, :n], x[None, n:]
            return np.concatenate([x[n:], self.accelerate(q, v, torque(at, x)[None])[0]])

        reach = 2.5 if not s["driven"] else 1.0
        start = np.concatenate([rng.uniform(-reach, reach, n), rng.normal(0, 0.5, n)])
        if first:
            start[0], start[n] = rng.uniform(-0.2, 0.2), 0.0
        done = solve_ivp(slope, (0.0, t[-1]), start, "LSODA", t, rtol=1e-8, atol=1e-9)
        q = done.y[:n].T @ np.linalg.inv(self.to_absolute).T
        q = q + s["noise"] * rng.normal(size=q.shape)
        if s["encoder"]:
            q = np.round(q / s["encoder"]) * s["encoder"]
        names = [f"q_{'cart' if first and i == 0 else f'theta_{i}'}" for i in range(n)]
        columns = {"trajectory": index, "t": t, **dict(zip(names, q.T, strict=True))}
        u = np.stack([torque(at, x) for at, x in zip(t, done.y.T, strict=True)])[:, self.actuated]
        for i, values in enumerate(u.T):
            columns[f"u_{i}"] = values
        return pd.DataFrame(columns)

    def words(self) -> list[str]:
        """Return what nobody could infer."""
        if not self.settings["driven"]:
            return []
        rows = [[float(x) for x in row] for row in self.input_matrix]
        return [f"system.input_matrix={str(rows).replace(' ', '')}"]


def true_errors(machine: RandomMachine, table: Path, folder: Path) -> dict[str, float]:
    """Return the errors of the true system in the windows in which the model was tested."""
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from symo_exp.evaluation.horizon import HORIZONS, cut, median, predict
    from symo_exp.evaluation.references import Continuous

    config = OmegaConf.load(folder / "config.yaml")
    system = instantiate(config.system)
    data = instantiate(config.data, _partial_=True, path=str(table))(system=system)
    data.setup()
    windows = cut(data.trajectories("test"), system.time_step, run_in=True)
    if windows is None:
        return {}
    found = predict(Continuous(machine, system.time_step), windows)
    return {f"true_rmse_{s:g}s": median(found.rmse(s)) for s in HORIZONS}


def identify(number: int, folder: Path, budget: str, extra: list[str]) -> dict[str, object]:
    """Return the row of a machine."""
    machine = RandomMachine(number)
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "machine.parquet"
    machine.record().to_parquet(table, index=False)
    words = ["-cn", "machine", "data.path=machine.parquet", f"budget={budget}", *machine.words()]
    command = [sys.executable, "-m", "symo_exp", *words, "logger=none", *extra]
    began = time.perf_counter()
    with (folder / "log").open("w") as log:
        done = subprocess.run(
            command, cwd=folder, stdout=log, stderr=subprocess.STDOUT, check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    row: dict[str, object] = {"machine": number, **machine.settings, "code": done.returncode}
    row["seconds"] = round(time.perf_counter() - began)
    said = (folder / "log").read_text(encoding="utf-8").splitlines()
    for line in said:
        if line.startswith("verdict"):
            row["verdict"] = line.partition(": ")[2]
        if line.startswith("chosen: "):
            row["chosen"] = line.removeprefix("chosen: ").partition(";")[0]
    best = folder / "outputs" / "machine_machine" / "best"
    if done.returncode == 0 or str(row.get("verdict")).startswith(HARDLY):
        from symo_exp.runs.folder import RunFolder

        found = RunFolder(best).measures() | true_errors(machine, table, best)
        row = {**found, **row}  # the noise of the machine, not its estimate
    return {name: row.get(name, "") for name in COLUMNS}


def summary(table: pd.DataFrame) -> str:
    """Return how many machines have a verdict, and errors at 0.5 s over those of the truth."""
    tested = (table.code == 0) | table.verdict.astype(str).str.startswith(HARDLY)
    found = table[tested].set_index("machine")
    if found.empty:
        return f"0 of {len(table)} machines have a verdict"
    worse = found.index[~(found["rmse_0.5s"] < found["constant_velocity_rmse_0.5s"])]
    times = (found["rmse_0.5s"] / found["true_rmse_0.5s"]).sort_values()
    largest = ", ".join(f"{ratio:.2g} (machine {i})" for i, ratio in times[::-1][:5].items())
    without = int(found.verdict.str.startswith("no model").sum())
    return (
        f'{len(found)} of {len(table)} machines have a verdict, {without} of them "no model"; no '
        f"better than constant velocity at 0.5 s: "
        f"{', '.join(f'machine {i}' for i in worse) or 'none'}\n"
        f"error at 0.5 s over that of the true system: median {times.median():.2g}, "
        f"largest {largest}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Identify machines one after another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--budget", default="2min")
    parser.add_argument("--folder", type=Path, default=Path("outputs/machines"))
    parser.add_argument("--table", type=Path, default=Path("outputs/machines/random.csv"))
    parser.add_argument("extra", nargs="*", help="further settings of the command")
    given = parser.parse_args(arguments)
    done = set(pd.read_csv(given.table).machine) if given.table.exists() else set()
    given.table.parent.mkdir(parents=True, exist_ok=True)
    for number in range(given.first, given.first + given.count):
        if number in done:
            continue
        row = identify(number, given.folder / str(number), given.budget, given.extra)
        with given.table.open("a", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, COLUMNS)
            if not done:
                table.writeheader()
            table.writerow(row)
        done.add(number)
        print(f"{number}: {row['verdict'] or row['code']}, {row['chosen']}", flush=True)
    print(summary(pd.read_csv(given.table)))


if __name__ == "__main__":
    main()
