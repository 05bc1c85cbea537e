"""The evaluation of models whose errors are known."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest
import torch

from symo_exp.data.draws import generate, uniform
from symo_exp.data.recorded import RecordedData
from symo_exp.evaluation.evaluate import Evaluation, evaluate
from symo_exp.evaluation.learned import LearnedQuantities
from symo_exp.evaluation.motion import Motion
from symo_exp.evaluation.rollouts import CHUNK, Rollouts, along, roll_out
from symo_exp.evaluation.study import Finding, afresh
from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.l_node import LNODE
from symo_exp.models.node import NODE
from symo_exp.models.true import TrueOde
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.mlp import MLP
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.simulation import Solver
from tests.data.small import ready, write_recordings
from tests.oscillator import Exact, Midpoint, Oscillator, data, oscillator
from tests.pages import ROOT
from tests.tables import arguments_of
from tests.unknown import Unknown

H = 0.1
NAMES = {
    "coordinates", "angles", "test_relative",
    "train_mse", "test_mse", "integration_mse", "integration_std", "integration_diverged",
    "integration_mse_100", "valid_steps",
    "energy_mse", "energy_std", "test_mse_state", "integration_mse_state",
}  # fmt: skip
INERTIA = {"inertia_mse", "inertia_std", "inertia_mse_aligned"}
VARIATIONAL = {"energy_mse_fd", "test_newton_failed", "integration_newton_failed"}


def undefined(names: Iterable[str]) -> set[str]:
    """The measures without a definition in the documentation, which has ``…_1s`` for others."""
    page = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    plain = (re.sub(r"^constant_velocity_|_measured$", "", name) for name in names)
    return {name for name in plain if f"`{re.sub('_[12]s$', '_0.5s', name)}`" not in page}


def test_every_measure_is_defined_in_the_documentation():
    assert not undefined(NAMES | INERTIA | VARIATIONAL)


def test_the_error_of_a_rotation_does_not_jump_at_a_half_turn():
    """A yaw that is always 0.01 rad ahead passes π, where its angle jumps to −π."""
    turning, z = Coordinates.of(rotations=("R",)), torch.tensor([0.0, 0.0, 1.0]).double()
    yaw = torch.linspace(3.0, 3.3, 100).double().view(1, -1, 1)
    q, q_true = (turning.space.of_vector(angle * z) for angle in (yaw + 0.01, yaw))
    still = torch.zeros(1, 100, 3).double()
    rolled = Rollouts(turning, H, q, still, None, q_true, still, None, torch.ones(1, 99).bool())
    columns = rolled.columns()
    assert (columns["q_R_z"] - columns["q_true_R_z"]).abs().max() > 6.0
    error = columns["squared_error"]
    torch.testing.assert_close(error, torch.full_like(error, 1e-4 / 3), rtol=1e-9, atol=0.0)


def result(model: Exact) -> Evaluation:
    return evaluate(model, model.system, data(model.system, H))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_exact_flow_has_no_error(n: int):
    system = oscillator(n)
    evaluation = result(Exact(system, system, H))
    assert set(evaluation.measures) == NAMES | INERTIA
    errors = dict(evaluation.measures)
    assert errors.pop("valid_steps") == evaluation.rollouts.q.shape[1] - 1
    assert (errors.pop("coordinates"), errors.pop("angles")) == (n, 0)
    assert errors.pop("test_relative") < 1e-12
    assert all(value < 1e-20 for value in errors.values()), errors


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_constant_bias_is_the_one_step_error(n: int):
    system = oscillator(n)
    evaluation = result(Exact(system, system, H, bias=1e-3))
    found = evaluation.measures
    moved = cut_windows(data(system, H).trajectories("test"))
    motion = (moved.q_next - moved.q).square().mean().sqrt().item()
    assert found["test_relative"] == pytest.approx(1e-3 / motion)
    assert found["test_mse"] == pytest.approx(1e-6)
    assert found["train_mse"] == pytest.approx(1e-6)
    assert found["test_mse_state"] == pytest.approx(0.5e-6)  # the velocity is right
    assert found["integration_mse"] > 1e-6
    assert found["energy_mse"] > 1e-9


def test_the_error_of_the_state_is_that_of_configurations_and_velocities_together():
    system = oscillator(2)
    evaluation = result(Midpoint(system, system, H))
    motion = evaluation.rollouts
    pairs = torch.cat((motion.q - motion.q_true, motion.v - motion.v_true), dim=-1)
    expected = pairs[:, 1:].square().mean().item()
    assert evaluation.measures["integration_mse_state"] == pytest.approx(expected)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_midpoint_rule_keeps_the_energy_of_legendre_but_not_of_finite_differences(n: int):
    """Implicit midpoint conserves quadratic energies; the start is off by O(h²) only."""
    system = oscillator(n)
    evaluation = result(Midpoint(system, system, H, reads_velocity=False))
    found = evaluation.measures
    assert set(found) == NAMES | INERTIA | VARIATIONAL
    drift = evaluation.rollouts.energy - evaluation.rollouts.energy[:, :1]
    assert drift.abs().max() < 1e-12
    assert 1e-12 < found["energy_mse"] < 1e-2 * found["energy_mse_fd"]
    q, expected = evaluation.rollouts.q, evaluation.rollouts.energy_true[:, :1]
    error = along(system.energy, q[:, 1:], q.diff(dim=1) / H) - expected
    assert found["energy_mse_fd"] == pytest.approx(error.square().mean().item())
    assert 0 < found["test_mse"] < 1e-6
    assert found["test_newton_failed"] == found["integration_newton_failed"] == 0.0


def test_the_inertia_error_compares_learned_and_true_mass_matrices():
    system = oscillator(2)
    wrong = Oscillator(system.mass + torch.tensor([0.2, 0.4]), system.stiffness)
    found = result(Exact(wrong, system, H)).measures
    assert found["inertia_mse"] == pytest.approx((0.04 + 0.16) / 4)
    assert found["inertia_mse_aligned"] == pytest.approx((0.04 + 0.16) / 4)
    assert found["inertia_std"] == pytest.approx(0.0, abs=1e-12)


def test_a_method_without_a_lagrangian_has_no_inertia():
    system = oscillator(2)
    assert set(result(Exact(None, system, H)).measures) == NAMES


def test_diverged_rollouts_have_infinite_errors_and_are_counted():
    system = oscillator(2)
    model = Exact(system, system, H, reads_velocity=False, fails_from=20)
    found = result(model).measures
    lost = ("integration_mse", "integration_mse_state", "energy_mse", "energy_mse_fd")
    for name in (*lost, "inertia_mse"):
        assert found[name] == math.inf, name
    assert math.isnan(found["integration_std"])
    assert found["integration_diverged"] == 1.0
    assert found["integration_newton_failed"] == pytest.approx(10 / 30)
    assert found["test_newton_failed"] == 0.0
    assert found["test_mse"] < 1e-20
    assert found["inertia_mse_aligned"] < 1e-20


def test_a_rollout_starts_at_node_one_with_the_model_s_own_velocity():
    system = oscillator(1)
    sets = data(system, H)
    motion = evaluate(Midpoint(system, system, H, reads_velocity=False), system, sets).rollouts
    assert torch.equal(motion.q[:, 0], sets.integration.q[:, 1])
    assert torch.equal(motion.q_true, sets.integration.q[:, 1:])
    assert not torch.equal(motion.v[:, 0], sets.integration.v[:, 1])
    assert motion.q.shape == motion.q_true.shape
    assert motion.converged.shape == (3, 30)


def test_measures_do_not_depend_on_the_chunk_size(monkeypatch: pytest.MonkeyPatch):
    model = Exact(oscillator(2), oscillator(2), H, bias=1e-2)
    whole = result(model).measures
    assert len(cut_windows(data(model.system, H).trajectories("test")).q) < CHUNK
    for module in ("evaluate", "rollouts"):
        monkeypatch.setattr(f"symo_exp.evaluation.{module}.CHUNK", 7)
    assert result(model).measures == pytest.approx(whole, rel=1e-12)


def test_measures_do_not_depend_on_the_precision_of_the_training():
    sets = [ready(dtype=dtype, noise_std=1e-3) for dtype in ("float32", "float64")]
    system = sets[0].system
    true = TrueOde(
        system, coordinates=system.coordinates, input_matrix=system.input_matrix,
        time_step=system.time_step, integrator=RK4(),
    )  # fmt: skip
    single, double = (evaluate(true, system, one).measures for one in sets)
    assert single == double


def test_the_energy_error_uses_the_true_lagrangian():
    system = oscillator(1)
    right = Exact(system, system, H)
    wrong = replace(right, lagrangian=Oscillator(system.mass * 3, system.stiffness))
    assert result(right).measures["energy_mse"] == result(wrong).measures["energy_mse"]


def test_driven_rollouts_have_no_energy_error():
    model = Midpoint(oscillator(1), oscillator(1), H, reads_velocity=False)
    sets = data(model.system, H)
    driven = sets.integration._replace(u=torch.ones_like(sets.integration.u))
    found = evaluate(model, model.system, sets._replace(integration=driven)).measures
    energy = {"energy_mse", "energy_std", "energy_mse_fd"}
    assert set(found) == (NAMES | INERTIA | VARIATIONAL) - energy


@pytest.mark.parametrize(
    "model",
    [
        partial(LNODE, lagrangian=partial(NetworkLagrangian, width=4)),
        partial(NODE, net=partial(MLP, width=4, depth=2)),
    ],
)
def test_unknown_systems_have_no_measures_of_the_truth(model: partial, tmp_path: Path):
    """A recording is enough: nothing but coordinates, inputs and a time step is known."""
    chain, system = ChainPendulum(2), Unknown(time_step=0.05)
    starts = uniform(chain.box, 4, 0)
    path = tmp_path / "mine.parquet"
    truth = generate(chain, starts, steps=30, forced=True, solver=Solver())
    write_recordings(path, truth, chain.coordinates, chain.time_step)
    sets = RecordedData(system=system, path=path)
    sets.setup()
    learned = model(integrator=RK4(), **arguments_of(system))
    found = evaluate(learned, system, sets)
    windows = {*found.recorded.model.measures()}
    windows |= {f"constant_velocity_{name}" for name in windows} | {"windows", "window_s"}
    windows |= {f"{name}_measured" for name in windows} | {"noise"}
    own = ("usable_s", "open_loop_rmse")
    windows |= {f"{who}{name}" for who in ("", "constant_velocity_") for name in own}
    assert set(found.measures) == windows | NAMES - {"energy_mse", "energy_std"}
    assert not undefined(found.measures)
    assert all(math.isfinite(value) for value in found.measures.values())
    assert found.rollouts.energy is found.rollouts.energy_true is None
    assert not [name for name in found.rollouts.columns() if "energy" in name]
    assert LearnedQuantities(name="x", steps=3)(learned, system, sets) == Finding()
    study = Motion(name="x", steps=3)
    assert study(learned, system, sets) == Finding()
    alone = study(learned, Unknown(time_step=0.05, box=chain.box), sets)
    volume = {"x_volume"} if learned.lagrangian else set()
    assert set(alone.measures) == volume
    assert not [name for name in alone.columns if "energy" in name or "true" in name]


@dataclass(frozen=True, kw_only=True)
class Worst:
    """A study of a user: the largest error."""

    name: str

    def __call__(self, model, system, data, *, remember=afresh):
        motion = roll_out(model.for_evaluation(), system.lagrangian, data.integration)
        worst = (motion.q - motion.q_true).abs().max().item()
        return Finding(measures={f"{self.name}_error": worst})


def test_a_study_can_be_written_by_a_user():
    model = Exact(oscillator(2), oscillator(2), H, bias=1e-2)
    found = Worst(name="worst")(model, model.system, data(model.system, H)).measures
    expected = result(model).rollouts
    assert found == {"worst_error": (expected.q - expected.q_true).abs().max().item()}
