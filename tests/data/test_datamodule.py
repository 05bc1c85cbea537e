"""Simulated data: reproducible, noisy only in training, and the same for every method."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import lightning
import pytest
import torch

from symo_exp.data import datamodule
from symo_exp.data.base import DataOptions
from symo_exp.data.cache import key
from symo_exp.data.datamodule import TrajectoryData
from symo_exp.data.draws import Independent
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Windows
from symo_exp.systems.base import SamplingBox
from symo_exp.systems.cartpole import Cartpole
from symo_exp.systems.simulation import Solver
from symo_exp.systems.table import system as stated
from symo_exp.thesis.draws import Published
from symo_exp.thesis.solver import SolveIvp
from tests.data.small import ready, small
from tests.trainers import quiet_trainer
from tests.unknown import Unknown


def equal(a: tuple, b: tuple) -> bool:
    return len(a) == len(b) and all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


def test_sets_have_the_requested_sizes_and_types() -> None:
    data = ready()
    assert [tuple(x.shape) for x in data.integration] == [(2, 8, 2), (2, 8, 2), (2, 8, 1)]
    assert data.integration.q.dtype == torch.float64
    assert (data.integration.u == 0).all()
    assert [len(w.q) for w in (data.train, data.val, data.test)] == [16, 12, 16]
    assert data.train.q.dtype == data.test.q.dtype == torch.float32
    assert all(data.trajectories(part)[0].q.dtype == torch.float64 for part in ("train", "test"))
    assert [t.q.shape for t in data.trajectories("train")] == [(6, 2)] * 4
    assert ready(dtype="float64").train.v.dtype == torch.float64


def test_data_are_reproducible_bit_for_bit(tmp_path: Path) -> None:
    made = ready(cache_dir=None)
    again, read = ready(cache_dir=tmp_path), ready(cache_dir=tmp_path)
    for data in (again, read):
        for name in ("train", "val", "test", "integration"):
            assert equal(getattr(made, name), getattr(data, name)), name
        assert all(map(equal, made.trajectories("test"), data.trajectories("test")))


class Stopped(Cartpole):
    """A cartpole whose motions end when the pole is a radian away from the top."""

    ends = ((-9.0, 9.0), (-1.0, 1.0))


def stopped(low: float, high: float, **changes: Any) -> TrajectoryData:
    """Data of motions that begin with the pole at ``low`` to ``high`` [rad]."""
    system = stated("cartpole")
    box = {"q": [[-0.5, 0.5], [low, high]], "v": [[0, 0], [-8, 8]], "u": [[0, 0]]}
    values = {field.name: getattr(system, field.name) for field in dataclasses.fields(system)}
    return ready(system=Stopped(**{**values, "box": box}), cache_dir=None, n_val=4, **changes)


@pytest.mark.parametrize("velocities", ["given", "estimated"])
def test_motions_that_end_before_their_third_node_are_left_out(velocities: str) -> None:
    data = stopped(-1.3, 1.3, n_traj=8, n_train_max=8, held_out=2, velocities=velocities)
    parts = [data.trajectories(part) for part in ("train", "held_out", "val", "test")]
    assert sum(map(len, parts)) < 8 + 4 + 4
    assert all(3 <= len(one.q) <= 6 for part in parts for one in part)
    windows = [sum(len(one.q) - 2 for one in part) for part in parts]
    train, _, val, test = windows
    assert [len(x.q) for x in (data.train, data.val, data.test)] == [train, val, test]
    assert all(one.v.isfinite().all() for part in parts for one in part)


@pytest.mark.parametrize(("low", "count", "part"), [(1.1, 4, "integration"), (-1.3, 1, "train")])
def test_parts_all_of_whose_motions_end_at_once_are_refused(low: float, count: int, part: str):
    with pytest.raises(ConfigError, match=f"for {part} before its third node; set system.limits"):
        stopped(low, 1.3, n_traj=count)


def test_smaller_training_sets_are_prefixes() -> None:
    large = ready(n_traj=8, noise_std=1e-2)
    for n_traj in (1, 3):
        part = ready(n_traj=n_traj, noise_std=1e-2)
        assert equal(part.train, large.train.rows(slice(n_traj * 4)))
        assert equal(part.test, large.test)


def test_the_sets_share_no_start_and_follow_the_seed() -> None:
    data, other = ready(), ready(seed=1)
    sets = [data.trajectories("train"), data.trajectories("val"), data.trajectories("test")]
    sets += [data.integration.each(), other.trajectories("train")]
    rows = torch.stack([trajectory.q[0] for part in sets for trajectory in part])
    assert len(torch.unique(rows, dim=0)) == len(rows)


def test_only_training_data_are_noisy() -> None:
    clean, noisy = ready(), ready(noise_std=1e-2)
    assert not torch.equal(clean.train.q, noisy.train.q)
    assert not torch.equal(clean.train.v, noisy.train.v)
    assert torch.equal(clean.train.u, noisy.train.u)
    for name in ("val", "test", "integration"):
        assert equal(getattr(clean, name), getattr(noisy, name))
    both = ready(noise_std=1e-2, noise_test=True)
    assert equal(both.train, noisy.train)
    assert not torch.equal(both.test.q, clean.test.q)
    assert equal(both.val, clean.val)
    assert equal(both.integration, clean.integration)
    difference = both.trajectories("test")[0].q - clean.trajectories("test")[0].q
    other = noisy.trajectories("train")[0].q - clean.trajectories("train")[0].q
    assert not torch.allclose(difference, other)  # noise of their own


def test_noise_has_its_own_seed_and_comes_after_the_cache(tmp_path: Path) -> None:
    one, two = (
        ready(noise_std=1e-2, noise_seed=seed, cache_dir=tmp_path, shuffle=False) for seed in (1, 2)
    )
    assert not torch.equal(one.train.q, two.train.q)
    assert len(list(tmp_path.glob("*.npz"))) == 1


ARGUMENTS = {
    *datamodule.TrajectoryData.__init__.__annotations__,
    *DataOptions.__annotations__,
} - {"return", "options"}
CHANGES = [
    {"system": stated("acrobot")},
    {"system": stated("cartpole", mass_pole=0.2)},
    {"system": stated("cartpole", time_step=0.04)},
    {"system": stated("cartpole", box=SamplingBox(((0, 1), (0, 1)), ((0, 1), (0, 1)), ((0, 1),)))},
    {"n_train_max": 9},
    {"n_val": 4},
    {"n_test": 5},
    {"n_steps": 5},
    {"n_integration": 3},
    {"integration_steps": 7},
    {"solver": Solver("RK23", 1e-4, 1e-4)},
    {"solver": Solver("RK45", 1e-5, 1e-4)},
    {"solver": Solver("RK45", 1e-4, 1e-5)},
    {"solver": SolveIvp("RK45", 1e-4, 1e-4)},
    {"draws": Published()},
    {"draws": Published(interleaved=True)},
    {"seed": 1},
]
KEPT = [
    {"held_out": 1},
    {"n_traj": 2},
    {"noise_std": 1.0},
    {"input_noise_std": 1.0},
    {"noise_seed": 7},
    {"noise_test": True},
    {"batch_size": 3},
    {"shuffle": False},
    {"dtype": "float64"},
    {"velocities": "estimated"},
    {"monitor": "test"},
    {"monitor_trajectories": 1},
]


def test_the_cache_key_depends_on_everything_that_changes_the_bytes() -> None:
    keys = [key(small(**change).recipe()) for change in [{}, *CHANGES]]
    assert len(set(keys)) == len(keys)
    for change in KEPT:
        assert key(small(**change).recipe()) == keys[0], change
    # Every argument of the constructor is in one of the two lists, or is where the data live.
    covered = {name for change in [*CHANGES, *KEPT] for name in change} | {"cache_dir"}
    assert covered == ARGUMENTS
    assert {f.name for f in dataclasses.fields(Solver)} == {"method", "rtol", "atol"}


def test_the_cache_key_depends_on_versions_and_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    before = key(small().recipe())
    with monkeypatch.context() as patch:
        patch.setattr(datamodule, "GENERATOR_VERSION", 999)
        assert key(small().recipe()) != before
    with monkeypatch.context() as patch:
        patch.setattr(torch, "__version__", "0")
        assert key(small().recipe()) != before
    kind = type(stated("cartpole"))
    edited = kind.potential
    with monkeypatch.context() as patch:
        patch.setattr(kind, "potential", lambda self, q: 1.001 * edited(self, q))
        assert key(small().recipe()) != before
    drawn = Independent.__call__
    with monkeypatch.context() as patch:
        patch.setattr(Independent, "__call__", lambda self, *args: drawn(self, *args[:-1], 5))
        assert key(small().recipe()) != before
    assert key(small().recipe()) == before


def test_batches_hold_every_sample_once_in_an_order_of_seed_and_epoch() -> None:
    assert [len(b.q) for b in ready().batches(3)] == [16]
    data = ready(batch_size=5)
    batches = data.batches(3)
    assert [len(b.q) for b in batches] == [5, 5, 5, 1]
    joined = Windows(*(torch.cat(fields) for fields in zip(*batches, strict=True)))
    order = joined.q_prev[:, 0].argsort()
    expected = data.train.q_prev[:, 0].argsort()
    for found, field in zip(joined, data.train, strict=True):
        assert torch.equal(found[order], field[expected])  # all fields moved together
    assert not torch.equal(joined.q, data.train.q)
    assert not torch.equal(batches[0].q, data.batches(4)[0].q)
    torch.manual_seed(99)  # nobody else's randomness matters
    same = ready(batch_size=5)
    assert all(equal(a, b) for a, b in zip(batches, same.batches(3), strict=True))
    ordered = ready(batch_size=5, shuffle=False)
    assert equal(ordered.batches(0)[0], data.train.rows(slice(5)))


def test_an_epoch_has_eight_steps_whatever_the_size() -> None:
    few = {"n_train_max": 3, "n_val": 1, "n_test": 1, "n_integration": 1}
    for n_traj in (1, 3):
        assert len(ready(n_traj=n_traj, n_steps=32, **few).batches(0)) == 8


def test_loaders_work_without_a_trainer() -> None:
    data = ready(batch_size=4)
    loader = data.train_dataloader()
    for epoch in range(2):
        (found,) = loader
        assert all(equal(a, b) for a, b in zip(found, data.batches(epoch), strict=True))
    (watched,) = data.val_dataloader()
    assert equal(watched, data.val)


def test_validation_uses_the_monitored_part() -> None:
    (watched,) = ready(monitor_trajectories=2).val_dataloader()
    assert equal(watched, ready().val.rows(slice(8)))
    (watched,) = ready(monitor_trajectories=1000).val_dataloader()
    assert equal(watched, ready().val)
    data = ready(monitor="test", monitor_trajectories=3, noise_std=1e-2, noise_test=True)
    (watched,) = data.val_dataloader()
    assert equal(watched, data.test.rows(slice(12)))


class Spy(lightning.LightningModule):
    """Keeps what it is given; ``width`` stands for methods that differ."""

    def __init__(self, width: int) -> None:
        super().__init__()
        torch.manual_seed(width)
        self.net = torch.nn.Linear(2, width)
        self.automatic_optimization = False
        self.seen: list[torch.Tensor] = []
        self.watched: list[torch.Tensor] = []

    def training_step(self, batches: list[Windows], _: int) -> None:
        optimizer = self.optimizers()
        for batch in batches:
            assert isinstance(batch, Windows)
            self.seen.append(batch.q_next.clone())
            optimizer.zero_grad()
            self.net(batch.q).square().mean().backward()
            optimizer.step()
        torch.rand(len(self.net.weight))  # a method may draw as it likes

    def validation_step(self, watched: Windows, _: int) -> None:
        self.watched.append(watched.q.clone())

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=1e-3)


@pytest.mark.filterwarnings("ignore")
def test_every_model_gets_the_same_batches_from_the_trainer(tmp_path: Path) -> None:
    one, two = Spy(1), Spy(7)
    for model in (one, two):
        quiet_trainer(2, tmp_path).fit(model, datamodule=small(batch_size=5))
    assert len(one.seen) == 8
    assert equal(tuple(one.seen), tuple(two.seen))
    data = ready(batch_size=5)
    expected = [batch.q_next for epoch in range(2) for batch in data.batches(epoch)]
    assert equal(tuple(one.seen), tuple(expected))
    assert equal(tuple(one.watched), (data.val.q,) * 2)


SIZES_AND_SEEDS = (
    "n_val", "n_test", "n_steps", "n_integration", "integration_steps", "batch_size", "seed",
    "noise_seed",
)  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_traj": 2.0}, "data.n_traj=2.0: expected a whole number from 1 to 8"),
        ({"n_traj": True}, "data.n_traj=True: expected a whole number from 1 to 8"),
        *(({name: -1}, f"data.{name}=-1: expected a whole number") for name in SIZES_AND_SEEDS),
        ({"monitor": "train"}, "data.monitor='train': expected one of val, test"),
        ({"monitor_trajectories": 0}, "data.monitor_trajectories=0: expected a whole number"),
    ],
)
def test_bad_values_are_refused_before_anything_is_made(changes: dict, message: str) -> None:
    """Others are given to a command in ``cli/test_main``."""
    with pytest.raises(ConfigError) as error:
        small(**changes)
    assert str(error.value).startswith(message)


def test_a_system_whose_equations_are_unknown_cannot_be_simulated() -> None:
    with pytest.raises(ConfigError, match=r"data=simulated.*Unknown.*data=recorded"):
        small(system=Unknown(time_step=0.1))


def test_trajectories_start_where_windows_do() -> None:
    data = ready()
    first = data.trajectories("test")[0]
    torch.testing.assert_close(data.test.q_prev[0].double(), first.q[0])
    torch.testing.assert_close(data.test.v_next[3].double(), first.v[5])


def test_held_out_trajectories_come_from_the_training_budget() -> None:
    whole, data = ready(), ready(held_out=1, monitor="held_out")
    watched = next(iter(data.val_dataloader()))
    for all_, kept, held in zip(whole.train, data.train, watched, strict=True):
        torch.testing.assert_close(torch.cat((kept, held)), all_)
    with pytest.raises(ConfigError, match=r"data\.held_out"):
        small(held_out=0, monitor="held_out")


@pytest.mark.parametrize("monitor", ["val", "held_out"])
def test_a_single_trajectory_cannot_be_held_out(monitor: str) -> None:
    with pytest.raises(ConfigError, match=r"n_traj=1: .*; give 2 or more, or data\.mon"):
        small(n_traj=1, held_out=0.1, monitor=monitor)
    assert small(n_traj=1, held_out=0, monitor="val").held_out == 0


@pytest.mark.parametrize(("n_traj", "share", "count"), [(8, 0.1, 1), (32, 0.1, 3), (4, 0.01, 1)])
def test_a_share_is_held_out(n_traj: int, share: float, count: int) -> None:
    data = small(n_traj=n_traj, n_train_max=n_traj, held_out=share, monitor="held_out")
    assert data.held_out == count
