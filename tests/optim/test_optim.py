"""Optimisers of whole epochs: steps against linear algebra, stopping, resuming, every method."""

import copy
import math
import os
from itertools import pairwise

import pytest
import torch
from torch import nn

from symo_exp.errors import ConfigError
from symo_exp.nets.affine import Linearised, linear, parameter_jacobian
from symo_exp.optim import base, descent, free_memory, levenberg_marquardt
from symo_exp.optim.chained import Chained
from symo_exp.optim.lbfgs import LBFGS
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.optim.total_least_squares import TotalLeastSquares
from tests.models.methods import learner, one_each, windows
from tests.trainers import quiet_trainer


def halves(n, samples=24):
    data = windows(n, samples)
    return [data.rows(slice(samples // 2)), data.rows(slice(samples // 2, None))]


class Products:
    """Residuals quadratic in the parameters: ``(W q)₁ (W q)₂ − 1`` and ``(W q)₃ (W q)₄``."""

    gradient_clip, reads_velocity = None, False

    def __init__(self, n):
        self.weight = nn.Parameter(torch.randn(4, n, dtype=torch.float64))

    def parameters(self):
        return [self.weight]

    def residuals(self, windows):
        return self.of(linear(windows.q, self.weight))

    def linearised(self, windows, parameters):
        return parameter_jacobian(lambda: self.residuals(windows), parameters)

    @staticmethod
    def of(y):
        return torch.stack((y[:, 0] * y[:, 1] - 1.0, y[:, 2] * y[:, 3]), dim=1)


@pytest.mark.parametrize("wide", [False, True], ids=["parameters", "residuals"])
def test_a_step_solves_the_damped_normal_equations(wide, monkeypatch):
    """In both spaces, to second order, against dense derivatives."""
    torch.manual_seed(0)
    model, data, damping = Products(3), windows(3, 4 if wide else 20), 3.0
    assert (model.weight.numel() > 2 * len(data.q)) == wide

    def residuals(flat):
        return model.of(data.q @ flat.view(4, 3).T).flatten() / math.sqrt(2 * len(data.q))

    def along(function, way):
        return lambda x: torch.func.jvp(function, (x,), (way,))[1]

    start = model.weight.detach().flatten().clone()
    jacobian = torch.func.jacrev(residuals)(start)
    gram = jacobian.T @ jacobian
    matrix = gram + damping * gram.diagonal().amax() * torch.eye(len(gram), dtype=gram.dtype)
    straight = -torch.linalg.solve(matrix, jacobian.T @ residuals(start))
    bend = 0.5 * along(along(residuals, straight), straight)(start)
    aside = -torch.linalg.solve(matrix, jacobian.T @ bend)
    monkeypatch.setattr(levenberg_marquardt, "CHUNK", 3)
    optimizer = LevenbergMarquardt([model.weight], damping=damping)
    optimizer.epoch(model, [data.rows(slice(2)), data.rows(slice(2, None))])
    torch.testing.assert_close(optimizer.flat() - start, straight + aside, rtol=1e-9, atol=1e-12)
    assert (
        aside.abs().max() > 1e-3 * straight.abs().max()
    )  # otherwise the second order is not tested


def test_geodesic_acceleration_takes_fewer_steps(monkeypatch):
    def epochs():
        torch.manual_seed(1)
        model, data = Products(3), windows(3, 40)
        optimizer = LevenbergMarquardt([model.weight])
        losses = [optimizer.epoch(model, [data])["train_loss"].item() for _ in range(60)]
        return sum(loss > losses[-1] * (1 + 1e-9) for loss in losses), losses[-1]

    bent, reached = epochs()
    monkeypatch.setattr(descent, "LONGEST", -1.0)
    straight, same = epochs()
    assert reached <= same * (1 + 1e-9)
    assert bent < straight


class Gram:
    """Residuals ``⟨A, X Xᵀ⟩ − y``, which determine some directions a thousand times better."""

    def __init__(self, n, seed, wrong=0):
        torch.manual_seed(seed)
        root, start, left, right = (
            torch.randn(size, size, dtype=torch.float64) for size in (n, n, 3 * n * n, n * n)
        )
        scales = torch.logspace(0, -3, n * n, dtype=torch.float64)
        left, right = torch.linalg.qr(left)[0][:, : n * n], torch.linalg.qr(right)[0]
        rows, self.true = left * scales @ right, root @ root.T
        y = rows @ self.true.flatten()
        y[:wrong] += 10.0
        self.samples = windows(1, len(rows))._replace(q=torch.cat((rows, y[:, None]), dim=1))
        self.x = nn.Parameter(torch.eye(n, dtype=torch.float64) + 0.1 * start)

    def as_forces(self, windows):
        return None

    def residuals(self, windows):
        return windows.q[:, :-1] @ (self.x @ self.x.T).view(-1, 1) - windows.q[:, -1:]

    def linearised(self, windows, parameters):
        matrices = windows.q[:, :-1].unflatten(1, self.x.shape)
        slopes = (matrices + matrices.mT) @ self.x.detach()
        return Linearised(self.residuals(windows).detach(), slopes.flatten(1).unsqueeze(1), ())

    def fitted(self, epochs, **settings):
        """Return the losses of some epochs, to the first that is zero but for rounding."""
        optimizer, losses = LevenbergMarquardt([self.x], **settings), [math.inf]
        while losses[-1] > 1e-20 and len(losses) <= epochs:
            losses.append(float(optimizer.epoch(self, [self.samples])["train_loss"]))
        return losses


@pytest.mark.parametrize("n", [2, 3, 6])
def test_shortened_steps_take_fewer_epochs(n):
    def epochs(shortest):
        found = [Gram(n, seed).fitted(60, shortest=shortest) for seed in range(4)]
        assert max(losses[-1] for losses in found) < 1e-20
        return sum(map(len, found))

    assert epochs(0.03) < 0.9 * epochs(1.0)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_few_wrong_samples_do_not_decide(n):
    wrong = n * n // 3
    errors = {}
    for huber in (None, 3.0):
        problem = Gram(n, 0, wrong=wrong)
        problem.fitted(100, huber=huber)
        errors[huber] = float((problem.x @ problem.x.T - problem.true).detach().abs().max())
    assert errors[3.0] < 1e-6
    assert errors[None] > 1e-2


@pytest.mark.parametrize("n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 3))])
@pytest.mark.parametrize(("method", "integrator"), one_each())
@pytest.mark.parametrize("kind", [LevenbergMarquardt, LBFGS])
def test_every_method_learns(kind, method, integrator, n):
    model = learner(method, integrator, n)
    optimizer, batches = kind(model.parameters()), halves(n)
    start = model.loss(windows(n, 24)).item()
    losses = [optimizer.epoch(model, batches)["train_loss"].item() for _ in range(10)]
    assert losses[0] == pytest.approx(start)
    assert all(b <= a for a, b in pairwise(losses))
    assert losses[-1] < 0.5 * losses[0]


def chained(model):
    return Chained(
        model.parameters(),
        first=lambda p: torch.optim.Adam(p, lr=1e-3),
        epochs=2,
        then=LevenbergMarquardt,
    )


@pytest.mark.parametrize("make_optimizer", [lambda m: LevenbergMarquardt(m.parameters()), chained,
                                            lambda m: LBFGS(m.parameters())])  # fmt: skip
@pytest.mark.parametrize("stop", [1, 3])
def test_a_resumed_run_gives_the_same_bits(make_optimizer, stop, tmp_path):
    def run(model, optimizer, epochs):
        for _ in range(epochs):
            optimizer.epoch(model, halves(2))
            optimizer.validated(model.loss(windows(2)))

    whole, part = (learner("symo", "midpoint", 2) for _ in range(2))
    run(whole, make_optimizer(whole), 4)
    first = make_optimizer(part)
    run(part, first, stop)
    torch.save((part.state_dict(), first.state_dict()), tmp_path / "state")
    again = learner("symo", "midpoint", 2)
    second = make_optimizer(again)
    weights, state = torch.load(tmp_path / "state", weights_only=True)
    again.load_state_dict(weights)
    second.load_state_dict(copy.deepcopy(state))
    run(again, second, 4 - stop)
    for a, b in zip(whole.parameters(), again.parameters(), strict=True):
        assert torch.equal(a, b)


def test_training_stops_by_held_out_losses_and_keeps_the_best():
    p = nn.Parameter(torch.zeros(1, dtype=torch.float64))
    optimizer = LevenbergMarquardt([p], patience=2)
    for value, loss in [(1.0, 0.5), (2.0, 0.3), (3.0, 0.4), (4.0, 0.6)]:
        assert not optimizer.finished
        p.data.fill_(value)
        optimizer.validated(torch.tensor(loss))
    assert optimizer.finished
    optimizer.ended()
    assert p.item() == 2.0


def test_training_does_not_stop_while_its_loss_falls():
    torch.manual_seed(1)
    model, data = Products(3), windows(3, 40)
    optimizer, losses = LevenbergMarquardt([model.weight], patience=1), []
    optimizer.validated(torch.tensor(1.0))
    while not optimizer.finished:
        losses.append(optimizer.epoch(model, [data])["train_loss"].item())
        optimizer.validated(torch.tensor(1.0))
    assert len(losses) > 3
    assert all(b < 0.9 * a for a, b in pairwise(losses[:-1]))
    assert losses[-1] >= 0.9 * losses[-2]


def test_with_a_tolerance_the_last_of_the_nearly_best_is_kept():
    p = nn.Parameter(torch.zeros(1, dtype=torch.float64))
    optimizer = TotalLeastSquares([p], tolerance=0.3)
    for value, loss in [(1.0, 0.5), (2.0, 0.3), (3.0, 0.38), (4.0, 0.4), (5.0, float("inf"))]:
        p.data.fill_(value)
        optimizer.validated(torch.tensor(loss))
    optimizer.ended()
    assert p.item() == 3.0


def test_missing_memory_is_reported_before_the_first_step(monkeypatch):
    model = learner("symo", "midpoint", 2)
    monkeypatch.setattr(base, "available_bytes", lambda: 1000)
    with pytest.raises(ConfigError, match=r"needs about .* GB .* free"):
        LevenbergMarquardt(model.parameters()).epoch(model, halves(2))


def test_memory_of_the_step_before_counts_as_free(monkeypatch):
    """The process may keep it: what has been solved is solved again, and nothing larger."""
    model, free = learner("symo", "midpoint", 2), [10**9]
    monkeypatch.setattr(base, "available_bytes", lambda: free[0])
    optimizer = LevenbergMarquardt(model.parameters())
    optimizer.epoch(model, halves(2))
    free[0] = 1000
    optimizer.epoch(model, halves(2))
    with pytest.raises(ConfigError, match=r"needs about .* GB .* free"):
        optimizer.epoch(model, halves(2, samples=48))


def test_files_in_memory_count_as_free(monkeypatch, tmp_path):
    told = "MemTotal: 3000 kB\nMemFree: 10 kB\nMemAvailable: 2000 kB\nHugePages_Total: 0\n"
    (tmp_path / "meminfo").write_text(told)
    monkeypatch.setattr(free_memory, "MEMORY", tmp_path / "meminfo")
    monkeypatch.setattr(free_memory, "GROUPS", tmp_path / "none")
    assert free_memory.available_bytes() == 2000 * 1024
    monkeypatch.setattr(free_memory, "MEMORY", tmp_path / "none")
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert free_memory.available_bytes() == total


@pytest.mark.parametrize(
    ("told", "home", "limit", "use", "prefix"),
    [
        ("0::/job/step", "", "memory.max", "memory.current", ""),
        ("3:cpu:/x\n4:memory:/job/step\n0::/", "memory", "memory.limit_in_bytes",
         "memory.usage_in_bytes", "total_"),
    ],
)  # fmt: skip
def test_what_a_container_or_a_job_of_a_cluster_may_not_take_is_not_free(
    told, home, limit, use, prefix, monkeypatch, tmp_path
):
    def group(path, most, used):
        (tmp_path / home / path).mkdir(parents=True, exist_ok=True)
        kept = f"{prefix}inactive_file 200\n{prefix}active_file 100\nother 7"
        for name, text in ((limit, most), (use, used), ("memory.stat", kept)):
            (tmp_path / home / path / name).write_text(f"{text}\n")

    (tmp_path / "cgroup").write_text(f"{told}\n")
    monkeypatch.setattr(free_memory, "GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(free_memory, "MOUNTED", tmp_path)
    of_machine = free_memory.available_bytes()
    for path in ("", "job", "job/step"):
        group(path, "max" if prefix == "" else 2**63 - 4096, 5000)
    assert free_memory.available_bytes() == pytest.approx(of_machine, rel=0.5)
    group("job", 6000, 5000)
    assert free_memory.available_bytes() == 1300
    group("job/step", 5100, 5000)
    assert free_memory.available_bytes() == 400
    group("", 5100, 6000)
    assert free_memory.available_bytes() == 0


@pytest.mark.parametrize("kind", [LevenbergMarquardt, TotalLeastSquares])
def test_single_precision_is_refused(kind):
    with pytest.raises(ConfigError, match="dtype=float64"):
        kind(learner("node", "rk4", 1).float().parameters())


@pytest.mark.parametrize(("count", "warned"), [(5000, False), (5001, True)])
@pytest.mark.parametrize("kind", [LevenbergMarquardt, TotalLeastSquares])
def test_normal_equations_of_many_parameters_are_warned_of(kind, count, warned, caplog):
    kind([torch.zeros(count, dtype=torch.float64, requires_grad=True)])
    assert ("takes minutes" in caplog.text) == warned


@pytest.mark.parametrize(("name", "value"), [("iterations", 0), ("history", -1), ("history", 0)])
def test_lbfgs_needs_steps_and_a_history(name, value):
    with pytest.raises(ConfigError, match=f"optimizer.{name}={value}: expected a whole number"):
        LBFGS([torch.zeros(1, requires_grad=True)], **{name: value})


def test_a_training_stops_when_the_optimizer_is_finished(tmp_path):
    torch.manual_seed(0)
    model = learner(
        "symo", "midpoint", 2, optimizer=lambda p: LevenbergMarquardt(p, patience=1), scheduler=None
    )
    parts = [halves(2)], [windows(2, 7)]
    trainer = quiet_trainer(200, tmp_path)
    loaders = [torch.utils.data.DataLoader(x, batch_size=None) for x in parts]
    before = model.loss(windows(2, 7)).item()
    trainer.fit(model, *loaders)
    assert trainer.current_epoch < 200
    best = model.trainer.optimizers[0].memory["best"]
    assert model.loss(windows(2, 7)).item() == pytest.approx(best)
    assert best < before
