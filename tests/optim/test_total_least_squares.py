"""Total least squares: banded systems, recovery from noise, stages, and resuming."""

import copy
import math
from functools import partial

import pytest
import torch
from torch import nn
from torch.nn.utils import parameters_to_vector

from benchmarks.machines import RandomMachine
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import DissipativeLagrangian, Friction
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Trajectory
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.l_node import LNODE
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.models.symo import SyMo
from symo_exp.models.true import TrueVariational
from symo_exp.nets.affine import linear, repeated
from symo_exp.nets.dissipation import LearnedDissipation
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.roles import mark, mark_squares
from symo_exp.optim import base
from symo_exp.optim.banded import Chain
from symo_exp.optim.total_least_squares import TotalLeastSquares
from symo_exp.systems.chain import ChainPendulum
from symo_exp.training.learner import Learner
from tests import pages
from tests.learned import double_precision
from tests.tables import arguments_of, explicit_integrators

RECORDING = pages.ROOT / "recordings" / "motor_double_pendulum.parquet"
H = 0.05
NOISE = 5e-3
ROOT = Newton(tolerance=1e-11, max_iterations=30)


def lengths(*nodes, n=2, noise=0.0):
    """Trajectories of a damped chain under a constant torque, of these lengths."""
    truth = DissipativeLagrangian(
        ChainPendulum(n), Friction(0.2 * torch.eye(n).double(), torch.full((n,), 0.3), 0.1)
    )
    system = ChainPendulum(n, time_step=H)
    model = TrueVariational(
        lagrangian=truth, integrator=Galerkin(stages=2), root=ROOT, **arguments_of(system)
    ).double()
    generator = torch.Generator().manual_seed(7)
    q, v, u = torch.randn(3, len(nodes), n, dtype=torch.float64, generator=generator)
    inputs = (3.0 * u).unsqueeze(1).expand(-1, max(nodes), -1)
    path = model.rollout(q, v, inputs)
    error = noise * torch.randn(path.q.shape, dtype=torch.float64, generator=generator)
    found = zip(path.q + error, path.v, inputs, nodes, strict=True)
    return [Trajectory(q[:k], v[:k], u[:k]) for q, v, u, k in found]


def symo(n=2, **settings):
    torch.manual_seed(0)
    with double_precision():
        return SyMo(
            objective=PreconditionedResidual(), integrator=Galerkin(stages=2), root=ROOT,
            lagrangian=partial(NetworkLagrangian, width=4, depth=1, harmonics=2),
            **arguments_of(ChainPendulum(n, time_step=H)), **settings,
        )  # fmt: skip


def friction(**settings):
    return lambda *, coordinates: LearnedDissipation(
        coordinates=coordinates, viscous=True, coulomb=True, **settings
    )


@pytest.mark.parametrize("d", [1, 2, 3])
def test_the_band_is_that_of_the_whole_matrix(d):
    """``J Jᵀ + ε² I`` over trajectories of several lengths, and its Cholesky factor."""
    trajectories = [
        Trajectory(*(torch.randn(k, w, dtype=torch.float64) for w in (d, d, 0)))
        for k in (3, 7, 1, 2, 4)
    ]
    chain = Chain.of(trajectories, velocities=False)
    windows, k = len(chain.centre), 2
    jacobians = [torch.randn(windows, k, d, dtype=torch.float64) for _ in range(3)]
    whole = torch.zeros(windows, k, len(chain.x), d, dtype=torch.float64)
    for shift, jacobian in zip((-1, 0, 1), jacobians, strict=True):
        whole[torch.arange(windows), :, chain.centre + shift] = jacobian
    matrix = whole.flatten(2).flatten(0, 1)
    assert windows == 1 + 5 + 2
    x, y = torch.randn_like(chain.x), torch.randn(windows, k, dtype=torch.float64)
    torch.testing.assert_close(chain.apply(jacobians, x).flatten(), matrix @ x.flatten())
    torch.testing.assert_close(chain.spread(jacobians, y).flatten(), matrix.T @ y.flatten())
    full = matrix @ matrix.T + 0.09 * torch.eye(len(matrix), dtype=torch.float64)
    factor = chain.factor(jacobians, 0.09)
    torch.testing.assert_close(factor.solve(y).flatten(), torch.linalg.solve(full, y.flatten()))
    white = factor.whiten(torch.eye(len(matrix), dtype=torch.float64).view(windows, k, -1))
    torch.testing.assert_close(white, torch.linalg.cholesky(full).inverse(), atol=1e-9, rtol=1e-9)


def train(model, trajectories, **settings):
    problem = Learner(model) if isinstance(model, SyMo | LNODE) else model
    optimizer = TotalLeastSquares(model.parameters(), **settings)
    found = []
    while not optimizer.finished:
        found.append(optimizer.epoch(problem, trajectories))
    return optimizer, found


def test_missing_memory_is_reported_before_the_first_step(monkeypatch):
    monkeypatch.setattr(base, "available_bytes", lambda: 1000)
    with pytest.raises(ConfigError, match=r"TotalLeastSquares needs about .* GB .* free"):
        train(symo(1), lengths(10, n=1), start=1, epochs=1)


@pytest.fixture(scope="module")
def smoothed():
    """A pendulum learned from noisy configurations: data without and with noise, and the result."""
    nodes = (60, 80, 50, 70)
    clean, noisy = lengths(*nodes, n=1), lengths(*nodes, n=1, noise=NOISE)
    model = symo(1, dissipation=friction())
    optimizer, found = train(model, noisy, epsilons=(0.3, 0.1), start=8, epochs=4, warm_up=60)
    return model, clean, noisy, optimizer, found


def test_friction_and_noise_are_recovered_from_configurations_alone(smoothed):
    """D = 0.2 and c = 0.3; forced, so that the scale is determined."""
    model, *_, found = smoothed
    assert float(found[-1]["noise_estimate"]) == pytest.approx(NOISE, rel=0.3)
    v = torch.tensor([[1.0], [3.0]], dtype=torch.float64)
    force = model.dissipation.force(torch.zeros_like(v), v)
    torch.testing.assert_close(force, -0.2 * v - 0.3, rtol=0.05, atol=0)


def test_the_nodes_are_nearer_to_the_truth_than_the_data(smoothed):
    _, clean, noisy, optimizer, _ = smoothed
    truth, data = (torch.cat([t.q for t in x]) for x in (clean, noisy))
    error, before = (optimizer.memory["nodes"] - truth).std(), (data - truth).std()
    assert error < 0.5 * before


def test_steps_never_raise_the_objective_and_stages_end():
    _, found = train(symo(1), lengths(20, 20, n=1), epsilons=(1.0,), start=6, epochs=4, warm_up=20)
    assert len(found) == 6 + 6 + 4  # two starts, and one epsilon
    losses = [float(x["train_loss"]) for x in found]
    for start in (losses[:6], losses[6:12]):
        assert start == sorted(start, reverse=True)


class Falling(nn.Module):
    """Accelerations ``exp(b) − s² cos 5q``, of which data may want a negative ``s²``."""

    reads_velocity = False

    def __init__(self, n, squares):
        super().__init__()
        self.sizes = torch.ones(n)
        self.log = nn.Parameter(torch.full((n,), -1.0, dtype=torch.float64))
        self.root = nn.Parameter(torch.full((n,), 0.1, dtype=torch.float64)) if squares else None
        if self.root is not None:
            mark_squares(self.root)
        mark(self.parameters(), "coefficient")

    def residuals(self, windows):
        rise = repeated(self.log, len(windows.q)).exp()
        if self.root is not None:
            square = repeated(self.root, len(windows.q)).square()
            rise = rise - square * torch.cos(5.0 * windows.q)
        return windows.q_prev - 2.0 * windows.q + windows.q_next - H**2 * rise


@pytest.mark.skipif(not RECORDING.exists(), reason="the recordings are not here")
@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 5])
def test_stages_go_on_where_machines_stick(seed, caplog):
    """Curved steps of the nodes had every step refused, though straight ones are downhill."""
    system = recorded_system(RECORDING, time_step=0.02, angular="all")
    data = RecordedData(system=system, path=RECORDING, dtype="float64", seconds=12.0)
    data.setup()
    torch.manual_seed(seed)
    with double_precision():
        model = SyMo(
            objective=PreconditionedResidual(), integrator=Galerkin(stages=1), root=ROOT,
            lagrangian=PlanarLinks, dissipation=friction(), **arguments_of(system),
        )  # fmt: skip
    settings = {"starts": 1, "start": 10, "epochs": 20, "seed": seed}
    _, found = train(model, data.trajectories("train"), **settings)
    assert "no step lowers" not in caplog.text
    assert float(found[-1]["noise_estimate"]) < 0.015


@pytest.fixture(scope="module")
def sticking(tmp_path_factory):
    """A motor whose dry friction is nearly as large as its torque, with noise of 2e-4 rad."""
    machine, path = RandomMachine(65), tmp_path_factory.mktemp("sticking") / "machine.parquet"
    machine.record().to_parquet(path, index=False)
    matrix = machine.input_matrix.tolist()
    system = recorded_system(path, time_step=0.02, angular="all", input_matrix=matrix)
    data = RecordedData(system=system, path=path, dtype="float64", fold=(1, 3), seconds=16.0)
    data.setup()
    return system, data.trajectories("train")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_inertia_does_not_run_away_while_friction_is_small(seed, sticking):
    """Where it is large, inputs do not matter, and residuals without friction are smaller."""
    system, trajectories = sticking
    torch.manual_seed(seed)
    with double_precision():
        model = SyMo(
            objective=PreconditionedResidual(), integrator=VariationalMidpoint(), root=ROOT,
            lagrangian=partial(PlanarLinks, initial_inertia=0.02),
            dissipation=partial(LearnedDissipation, coulomb=True, start=2e-4),
            **arguments_of(system),
        )  # fmt: skip
    _, found = train(model, trajectories, start=10, epochs=10, seed=seed)
    assert float(found[-1]["noise_estimate"]) < 1.5e-3


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_square_that_data_want_to_be_negative_keeps_nothing_else_from_them(n):
    """It ends at zero, after as many epochs as a model takes that does not have it."""
    path = torch.rand(2, n, dtype=torch.float64, generator=torch.Generator().manual_seed(n))
    for _ in range(60):
        force = 2.0 + 0.5 * torch.cos(5.0 * path[-1])
        path = torch.cat((path, (2.0 * path[-1] - path[-2] + H**2 * force)[None]))
    data = [Trajectory(path, torch.zeros_like(path), torch.zeros(len(path), 0))]
    with_square, without = Falling(n, True), Falling(n, False)
    for model in (with_square, without):
        train(model, data, epsilons=(0.3,), starts=1, start=2, epochs=8)
    torch.testing.assert_close(with_square.log, without.log, atol=2e-3, rtol=0)
    assert float(with_square.root.square().max()) < 1e-2


def test_training_continues_from_the_best_start():
    """Seen in the parameters that hardly move in a first step with much damping."""
    model, trajectories = symo(1), lengths(20, 20, n=1)
    optimizer = TotalLeastSquares(
        model.parameters(), epsilons=(1.0,), starts=3, start=3, epochs=1, damping=1e9, warm_up=20
    )
    ends = []
    for _ in range(9):
        optimizer.epoch(Learner(model), trajectories)
        ends.append((float(optimizer.memory["loss"]), optimizer.flat().clone()))
    losses, places = zip(*ends[2::3], strict=True)
    optimizer.epoch(Learner(model), trajectories)
    away = [(optimizer.flat() - place).norm().item() for place in places]
    assert len(set(losses)) == 3
    assert away.index(min(away)) == losses.index(min(losses))
    assert sorted(away)[0] < 1e-3 * sorted(away)[1]


@pytest.mark.parametrize("broken", [0, 1])
def test_a_start_whose_residuals_are_not_numbers_is_not_continued_from(broken):
    model, trajectories = symo(1), lengths(6, n=1)
    optimizer = TotalLeastSquares(
        model.parameters(), epsilons=(1.0,), start=1, epochs=1, damping=1e9, warm_up=3
    )
    learner, ends = Learner(model), []
    right = learner.residuals
    for start in range(2):
        factor = torch.nan if start == broken else 1.0
        learner.residuals = lambda windows, factor=factor: factor * right(windows)
        optimizer.epoch(learner, trajectories)
        ends.append(optimizer.flat().clone())
        learner.residuals = right
    optimizer.epoch(learner, trajectories)
    away = [(optimizer.flat() - end).norm().item() for end in ends]
    assert away.index(max(away)) == broken


def test_late_parameters_are_zero_until_their_stage():
    model = symo(1, dissipation=friction(width=3))
    net = list(model.dissipation.net.parameters())
    optimizer = TotalLeastSquares(
        model.parameters(), epsilons=(1.0, 0.3), start=2, epochs=2, warm_up=5
    )
    trajectories, seen = lengths(6, 6, n=1), []
    while not optimizer.finished:
        optimizer.epoch(Learner(model), trajectories)
        seen.append(any(bool(p.any()) for p in net))
    assert seen == [False] * (2 * 2 + 2 * 2) + [True] * 2


def test_without_starts_training_continues_from_the_given_parameters():
    """All of them move from the first epoch on, and none is reset."""
    trajectories = lengths(20, 20, n=1, noise=1e-3)
    model = symo(1, dissipation=friction(width=3))
    _, found = train(model, trajectories, epsilons=(0.3,), start=5, epochs=15, warm_up=5)
    net = parameters_to_vector(model.dissipation.net.parameters()).detach()
    again, more = train(model, trajectories, epsilons=(0.3,), starts=0, epochs=5)
    assert len(more) == again.total_epochs == 5
    losses = [[float(x["train_loss"]) for x in one] for one in (found, more)]
    assert max(losses[1]) < 0.1 * losses[0][0]
    assert losses[1][-1] < 10.0 * losses[0][-1]
    assert not torch.equal(parameters_to_vector(model.dissipation.net.parameters()), net)


def test_a_resumed_training_ends_with_the_same_bits():
    trajectories = lengths(6, 7, n=1, noise=1e-3)
    settings = {"epsilons": (1.0, 0.3), "start": 2, "epochs": 2, "warm_up": 5}
    model = symo(1, dissipation=friction(width=2))
    optimizer = TotalLeastSquares(model.parameters(), **settings)
    kept = None
    while not optimizer.finished:
        if optimizer.memory["epoch"] == 5:  # after both starts, before the last stage
            kept = copy.deepcopy((optimizer.state_dict(), model.state_dict()))
        optimizer.epoch(Learner(model), trajectories)
    again = symo(1, dissipation=friction(width=2))
    resumed = TotalLeastSquares(again.parameters(), **settings)
    again.load_state_dict(kept[1])
    resumed.load_state_dict(kept[0])
    while not resumed.finished:
        resumed.epoch(Learner(again), trajectories)
    assert torch.equal(resumed.flat(), optimizer.flat())
    assert torch.equal(resumed.memory["nodes"], optimizer.memory["nodes"])


def test_methods_that_read_velocities_have_states_as_nodes():
    torch.manual_seed(0)
    model = LNODE(
        lagrangian=partial(NetworkLagrangian, width=4),
        coordinates=Coordinates(("a", "b"), (True, True)), time_step=H,
        input_matrix=ChainPendulum(2).input_matrix, integrator=explicit_integrators()["rk4"],
    ).double()  # fmt: skip
    trajectories = lengths(20, 20, noise=1e-3)
    optimizer, found = train(model, trajectories, epsilons=(1.0,), start=4, epochs=3, warm_up=10)
    assert optimizer.memory["nodes"].shape == (40, 4)
    assert float(found[-1]["train_loss"]) < float(found[0]["train_loss"])


def test_inputs_with_errors_are_estimated():
    """They end nearer to the truth than they were measured, the rest of the model where it was."""
    noise = NOISE / 20
    clean = lengths(60, 50, n=1, noise=noise)
    generator = torch.Generator().manual_seed(1)
    errors = [torch.randn(t.u.shape, dtype=torch.float64, generator=generator) for t in clean]
    noisy = [t._replace(u=t.u + e) for t, e in zip(clean, errors, strict=True)]
    settings = {"epsilons": (0.3,), "starts": 1, "start": 15, "epochs": 10}
    optimizer, found = train(symo(1), noisy, input_weight=1.0 / noise, **settings)
    u = torch.cat([t.u for t in clean])
    assert (optimizer.memory["nodes"][:, 1:] - u).std() < 0.8 * torch.cat(errors).std()
    assert float(found[-1]["noise_estimate"]) == pytest.approx(noise, rel=0.3)


class Springs:
    """Residuals ``k q_k + f(q_{k+1})`` twice over, of which ``f`` may be anything."""

    gradient_clip, reads_velocity, sizes = None, False, torch.ones(1)

    def __init__(self, f):
        self.f, self.stiffness = f, nn.Parameter(torch.ones(1, 1, dtype=torch.float64))

    def parameters(self):
        return [self.stiffness]

    def residuals(self, windows):
        r = linear(windows.q, self.stiffness) + self.f(windows.q_next)
        return torch.cat((r, r), dim=1)

    def loss_and_gradients(self, windows):
        self.stiffness.grad = None
        loss = self.residuals(windows).square().mean()
        loss.backward()
        return loss.detach()


ILL_CONDITIONED = {
    "indefinite": lambda q: 1e12 * q,
    "overflow": lambda q: 1e200 * q,
    "infinite derivative": lambda q: (q - q.detach()).abs().sqrt(),
    "not a number": lambda q: q / (q - q),
    "not a number near zero": lambda q: (q - 0.5).sqrt(),
}


@pytest.mark.parametrize("f", ILL_CONDITIONED.values(), ids=ILL_CONDITIONED)
def test_a_matrix_that_cannot_be_factored_is_a_rejected_trial(f, caplog, recwarn):
    """Parameters stay finite, residuals end no larger; stages that cannot move end with a line."""
    generator = torch.Generator().manual_seed(0)
    q = torch.rand(30, 1, dtype=torch.float64, generator=generator)
    model, settings = Springs(f), {"starts": 2, "start": 3, "epochs": 3, "warm_up": 3}
    optimizer, found = train(model, [Trajectory(q, q, q[:, :0])], epsilons=(1.0, 0.1), **settings)
    assert len(found) == optimizer.total_epochs
    assert all(bool(p.isfinite().all()) for p in model.parameters())
    assert optimizer.memory["nodes"].isfinite().all()
    losses = [float(x["train_loss"]) for x in found]
    assert losses[-1] <= losses[0] or not math.isfinite(losses[0])
    assert math.isfinite(losses[0]) or "the best so far is kept" in caplog.text
    assert not [x for x in recwarn if "lr_scheduler" in str(x.message)]


BAD = (
    {"epsilons": (1.0, 0.0)},
    {"start": 0},
    {"starts": -1},
    {"velocity_weight": -1},
    {"input_weight": -1},
    {"tolerance": -1},
    {"late_from": 0.0},
    {"warm_up": -5},
)


@pytest.mark.parametrize("wrong", BAD)
def test_invalid_settings_are_refused(wrong):
    with pytest.raises(ConfigError, match=f"optimizer.{next(iter(wrong))}=.*expected"):
        TotalLeastSquares(symo().parameters(), **wrong)


@pytest.mark.parametrize(
    ("losses", "epsilon"),
    [((3.0, 1.0, 2.0), 1.0), ((3.0, 2.0, 1.0), 0.1), ((1.9, 2.0, 3.0), 1.0)],
)
def test_the_estimate_has_the_epsilon_of_the_parameters_that_are_kept(losses, epsilon):
    """Its scatter, and so every interval, depends on it."""
    parameter = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    optimizer = TotalLeastSquares([parameter], epsilons=(1.0, 0.1), starts=1, start=2, epochs=3)
    for epochs, loss in zip((2, 5, 8), losses, strict=True):
        optimizer.memory["epoch"] = epochs
        optimizer.validated(torch.tensor(loss))
    other = TotalLeastSquares([parameter], epsilons=(1.0, 0.1), starts=1, start=2, epochs=3)
    other.load_state_dict(optimizer.state_dict())
    assert optimizer.estimate()["epsilon"] == other.estimate()["epsilon"] == epsilon


def test_a_start_is_kept_only_where_it_is_better_by_far():
    parameter = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    for start, kept in ((0.95, 1.0), (0.5, 0.0)):
        optimizer = TotalLeastSquares([parameter], epsilons=(1.0,), starts=1, start=2, epochs=3)
        for epochs, loss, value in ((2, start, 0.0), (5, 1.0, 1.0)):
            optimizer.place(torch.full((1,), value).double())
            optimizer.memory["epoch"] = epochs
            optimizer.validated(torch.tensor(loss))
        optimizer.ended()
        assert parameter.item() == kept
        assert (optimizer.estimate() is None) == (kept == 0.0)
