"""The makers' models: equations of motion, and the errors that they have on their recordings."""

import math

import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from hydra.utils import instantiate

from symo_exp.errors import ConfigError
from symo_exp.evaluation.horizon import HORIZONS, cut, predict
from symo_exp.evaluation.references import ConstantVelocity, Continuous
from symo_exp.mechanics.lagrangian import Lagrangian, solve
from symo_exp.mechanics.types import Trajectory
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.rigs import FreeChain
from tests.pages import ROOT
from tests.tables import CONF

RECORDINGS = ROOT / "recordings"
SETTINGS = {
    file.stem: settings
    for file in sorted((CONF / "reference").glob("*.yaml"))
    if (settings := yaml.safe_load(file.read_text(encoding="utf-8")))  # not those of none
}
H = 0.02
SHARES = {
    ("makers", "fitted"): 0.1,
    ("constant velocity", "fitted"): 0.08,
    ("makers", "measured"): 1.5,
    ("constant velocity", "measured"): 0.15,
}
"""Tolerances: velocities were resampled differently for the published values."""
EACH = pytest.mark.parametrize("name", SETTINGS)


def rig(name: str):
    return instantiate(SETTINGS[name])


def points(name: str, count: int = 20) -> torch.Tensor:
    """``q``, ``v`` and ``u``."""
    n = len(np.atleast_1d(SETTINGS[name].get("inertia")))
    generator = torch.Generator().manual_seed(0)
    return torch.randn(3, count, n, dtype=torch.float64, generator=generator)


@EACH
def test_acceleration_obeys_the_euler_lagrange_equations(name):
    """Compared with automatic differentiation and the power balance ``Ė = vᵀ F``."""
    model, (q, v, u) = rig(name), points(name)
    found, force = model.acceleration(q, v, u), model.force(v, u)
    rates = Lagrangian.rates(model, q, v)
    assert torch.allclose(found, solve(rates.mass, force - rates.mass_rate_v + rates.q))
    rate = torch.func.jvp(model.energy, (q, v), (v, found))[1]
    assert torch.allclose(rate, (v * force).sum(1))


@EACH
def test_friction_dissipates(name):
    model, (_, v, u) = rig(name), points(name)
    friction = model.force(v, 0.0 * u) - model.force(0.0 * v, 0.0 * u)
    assert ((v * friction).sum(1) < 0).all()


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_free_chain_of_point_masses_is_the_chain_pendulum(n):
    chain = ChainPendulum(n, mass=0.7, length=0.4)
    model = FreeChain(
        mass=(0.7,) * n, centre=(0.4,) * n, length=(0.4,) * (n - 1), inertia=(0.0,) * n,
        friction=(0.0,) * n,
    )  # fmt: skip
    q, v = torch.randn(2, 5, n, dtype=torch.float64)
    assert torch.allclose(model.mass_matrix(q), chain.mass_matrix(q))
    assert torch.allclose(model.acceleration(q, v, v), chain.acceleration(q, v, 0.0 * v))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"mass": [0.1, "heavy"]}, r"reference\.mass='heavy': expected a finite number"),
        ({"length": []}, r"reference\.length=\[\]: expected 1 value for 2 links"),
    ],
)
def test_invalid_parameters_are_refused(changed, said):
    settings = {k: x for k, x in SETTINGS["free_double_pendulum"].items() if k != "_target_"}
    with pytest.raises(ConfigError, match=said):
        FreeChain(**(settings | changed))


def resampled(name: str) -> list[Trajectory]:
    """The test trajectories at equal steps, nodes in the middle of steps: configurations and
    velocities linearly, inputs averaged over the step around a node."""
    table = pd.read_parquet(RECORDINGS / f"{name}.parquet")
    found = []
    for _, rows in table[table.split == "test"].groupby("trajectory", sort=False):
        t = rows.t.to_numpy()
        edges = H * np.arange(int((t[-1] - t[0]) / H + 1e-6) + 1)
        nodes = 0.5 * (edges[1:] + edges[:-1])
        q, v = (
            np.stack([np.interp(nodes, t, rows[c]) for c in rows if c.startswith(letter)], 1)
            for letter in ("q_", "v_")
        )
        u = [_means(t, rows[c].to_numpy(), edges) for c in rows if c.startswith("u_")]
        inputs = np.stack(u, 1) if u else np.zeros((len(nodes), 1))
        found.append(Trajectory(*(torch.from_numpy(x) for x in (q, v, inputs))))
    return found


def _means(t: np.ndarray, x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means between ``edges`` of the line through the samples."""
    fine = np.union1d(t, edges)
    line = np.interp(fine, t, x)
    area = np.concatenate(([0.0], np.cumsum(0.5 * (line[1:] + line[:-1]) * np.diff(fine))))
    return np.diff(np.interp(edges, fine, area)) / np.diff(edges)


@pytest.mark.slow
@pytest.mark.skipif(not RECORDINGS.exists(), reason="the recordings are not here")
@pytest.mark.parametrize("start", ["fitted", "measured"])
@EACH
def test_errors_are_those_published(name, start):
    published = pd.read_csv(RECORDINGS / "reference.csv").set_index(["recording", "model", "start"])
    windows = cut(resampled(name), H, run_in=start == "fitted")
    rivals = {"makers": Continuous(rig(name), H), "constant velocity": ConstantVelocity(H)}
    for who, model in rivals.items():
        row = published.loc[name, who, start]
        found = predict(model, windows)
        measures = found.measures()
        assert len(windows.q) == row.windows
        assert H * (found.q.shape[1] - 1) == pytest.approx(row.span_s)
        for measure in (f"{kind}rmse_{x:g}s" for x in HORIZONS for kind in ("", "pooled_")):
            times = measures[measure] / row[measure.replace("pooled_rmse", "pooled")]
            assert abs(math.log(times)) < math.log(1.0 + SHARES[who, start]), (who, measure, times)
        assert measures["valid_s"] == pytest.approx(row.valid_s, rel=0.1, abs=1.01 * H), who
