"""Random machines: mechanics that are right, recordings that the one command answers."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.integrate import solve_ivp

from benchmarks.machines import COLUMNS, GRAVITY, RandomMachine, identify, main, summary
from symo_exp.evaluation.references import check_fit
from tests.pages import ROOT

EVERY = range(12)


def without_friction(number):
    machine = RandomMachine(number)
    machine.sizes["viscous"] *= 0.0
    machine.sizes["coulomb"] *= 0.0
    return machine


def energy(machine, q, v):
    """Sum over bodies, each from the motion of its own centre."""
    s, first = machine.sizes, int(machine.settings["cart"])
    links = machine.n - first
    moments = s["moment"] - s["length"] * np.append(np.cumsum(s["mass"][::-1])[::-1][1:], 0.0)
    speed = np.array([v[0] if first else 0.0, 0.0])
    height, total = 0.0, 0.5 * s["cart"][0] * speed[0] ** 2 if first else 0.0
    tail = np.append(np.cumsum(s["mass"][::-1])[::-1][1:], 0.0)
    for i in range(links):
        mass, length, centre = s["mass"][i], s["length"][i], moments[i] / s["mass"][i]
        phi, rate = q[first + i], v[first + i]
        along = rate * np.array([np.cos(phi), np.sin(phi)])
        own = s["inertia"][i] - length**2 * tail[i] - mass * centre**2
        total += 0.5 * mass * ((speed + centre * along) ** 2).sum() + 0.5 * own * rate**2
        total += mass * GRAVITY * (height - centre * np.cos(phi))
        speed, height = speed + length * along, height - length * np.cos(phi)
    return total


@pytest.mark.parametrize("number", EVERY)
def test_energy_is_conserved_without_friction_and_inputs(number):
    machine, n = without_friction(number), RandomMachine(number).n
    start = np.random.default_rng(number).normal(size=2 * n)

    def slope(_, x):
        return np.r_[x[n:], machine.accelerate(x[None, :n], x[None, n:], np.zeros((1, n)))[0]]

    path = solve_ivp(slope, (0.0, 1.0), start, rtol=1e-10, atol=1e-10).y
    before, after = (energy(machine, x[:n], x[n:]) for x in (path[:, 0], path[:, -1]))
    assert after == pytest.approx(before, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("number", EVERY)
def test_friction_takes_power(number):
    machine, n = RandomMachine(number), RandomMachine(number).n
    smooth = without_friction(number)
    rng = np.random.default_rng(number)
    q, v = rng.normal(size=(2, 5, n))
    none = np.zeros((5, n))
    change = machine.accelerate(q, v, none) - smooth.accelerate(q, v, none)
    step = 1e-6
    for row in range(5):
        power = energy(machine, q[row], v[row] + step * change[row]) - energy(
            machine, q[row], v[row]
        )
        assert power < 0.0


@pytest.mark.parametrize("number", EVERY)
def test_the_true_system_is_a_reference_in_the_recorded_coordinates(number):
    machine = RandomMachine(number)
    check_fit(machine, machine.n, int(machine.actuated.sum()))
    rng = np.random.default_rng(number)
    q, v = rng.normal(size=(2, 4, machine.n))
    u = rng.normal(size=(4, int(machine.actuated.sum())))
    found = machine.acceleration(*(torch.from_numpy(x) for x in (q, v, u)))
    away = machine.to_absolute
    torque = np.zeros((4, machine.n))
    torque[:, machine.actuated] = u
    absolute = machine.accelerate(q @ away.T, v @ away.T, torque)
    assert found.numpy() @ away.T == pytest.approx(absolute)


@pytest.mark.parametrize("code", [0, 1])
def test_the_summary_counts_failures_and_ranks_errors_over_those_of_the_truth(code):
    """Also of tables whose searches ended with 0 whatever their verdicts."""
    rows = [
        (3, 0, "good", 2.0, 9.0, 1.0), (4, 1, "", np.nan, np.nan, np.nan),
        (5, code, "no model; not usable", 6.0, 5.0, 1.5), (6, 1, "no model", *[np.nan] * 3),
    ]  # fmt: skip
    errors = ["rmse_0.5s", "constant_velocity_rmse_0.5s", "true_rmse_0.5s"]
    said = summary(pd.DataFrame(rows, columns=["machine", "code", "verdict", *errors]))
    assert said.startswith('2 of 4 machines have a verdict, 1 of them "no model"')
    assert "at 0.5 s: machine 5\n" in said
    assert said.endswith("median 3, largest 4 (machine 5), 2 (machine 3)")


def test_the_summary_of_failures_alone_has_no_errors():
    table = pd.DataFrame({name: [np.nan] for name in COLUMNS} | {"machine": [4], "code": [1]})
    assert summary(table) == "0 of 1 machines have a verdict"


def test_a_machine_of_the_kept_table_can_be_run_again(tmp_path, monkeypatch):
    kept = ROOT / "results" / "machines" / "random.csv"
    (tmp_path / "results" / "machines").mkdir(parents=True)
    copy = shutil.copy(kept, tmp_path / "results" / "machines")
    monkeypatch.chdir(tmp_path)
    row = pd.read_csv(kept).set_index("machine", drop=False).loc[11].to_dict()
    monkeypatch.setattr("benchmarks.machines.identify", lambda *given: row)
    main(["--first", "11", "--count", "1"])
    assert list(pd.read_csv("outputs/machines/random.csv").machine) == [11]
    assert Path(copy).read_bytes() == kept.read_bytes()


def test_machines_cover_the_range_and_are_the_same_every_time():
    machines = [RandomMachine(number).settings for number in range(200)]
    for name in ("cart", "relative", "driven", "log"):
        assert 10 < sum(bool(s[name]) for s in machines) < 190
    for n in (1, 2, 3):
        assert sum(s["coordinates"] == n for s in machines) > 40
    assert min(s["noise"] for s in machines) < 2e-4
    assert max(s["noise"] for s in machines) > 2e-3
    assert max(s["viscous"] for s in machines) > 300 * min(s["viscous"] for s in machines)
    assert machines[7] == RandomMachine(7).settings
    one, other = (RandomMachine(3).record() for _ in range(2))
    assert one.equals(other)
    assert bool(np.isfinite(one.to_numpy(dtype=float)).all())


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, 2])
def test_the_command_ends_with_a_model_better_than_constant_velocity(number, tmp_path: Path):
    row = identify(number, tmp_path, "20s", ["hydra/launcher=basic", "pictures=false"])
    assert set(row) == set(COLUMNS)
    assert row["code"] == 0
    assert float(str(row["rmse_0.5s"])) < float(str(row["constant_velocity_rmse_0.5s"]))
    assert float(str(row["true_rmse_0.5s"])) < float(str(row["constant_velocity_rmse_0.5s"]))
