"""Noise, windows and batches of simulated and recorded data."""

from __future__ import annotations

import itertools
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, Generic, Literal, NamedTuple, TypedDict, TypeVar

import lightning
import torch
from torch import Tensor

from symo_exp.checks import one_of, real, whole_number
from symo_exp.data.noise import add_noise
from symo_exp.errors import ConfigError
from symo_exp.mechanics.space import Space, space_of
from symo_exp.mechanics.types import TrainingSamples, Trajectories, Trajectory
from symo_exp.mechanics.windows import NODES, cut_windows

Item = TypeVar("Item")
Kind = TypeVar("Kind", bound=TrainingSamples)

log = logging.getLogger(__name__)


class Splits(NamedTuple):
    """The trajectories of an experiment, float64 and without added noise."""

    train: list[Trajectory]
    val: list[Trajectory]
    test: list[Trajectory]
    integration: Trajectories


class DataOptions(TypedDict, total=False):
    """Arguments of ``DataModule`` that every kind of data has."""

    noise_std: float
    input_noise_std: float
    noise_test: bool
    shuffle: bool
    seed: int
    noise_seed: int
    dtype: str | torch.dtype
    monitor: Literal["val", "test", "held_out"]
    monitor_trajectories: int | None
    held_out: float
    velocities: Literal["given", "estimated"]


class DataModule(lightning.LightningDataModule, ABC):
    """Windows of trajectories in memory, in an order that depends on the seed alone.

    After ``setup()`` there are ``train``, ``val`` and ``test`` (``Windows`` in ``dtype``), the
    ``trajectories`` that they were cut from, of any lengths, and ``integration``, both float64. A
    Trainer is not needed.

    Args:
        time_step: Distance of the nodes [s].
        n_traj: Number of training trajectories, the first ones.
        noise_std: Standard deviation of the noise that is added to the training data.
        input_noise_std: That of the noise added to its inputs.
        noise_test: Whether noise is also added to the test data; validation data stay clean.
        batch_size: Samples in a batch; ``None``: ``4 n_traj``.
        shuffle: Whether every epoch has a new order.
        seed: Decides the order.
        noise_seed: Decides the noise.
        dtype: Precision of the windows.
        monitor: Trajectories whose windows are watched during training. With ``"held_out"`` a
            stopping rule needs no data beyond ``n_traj``.
        monitor_trajectories: At most the first so many of them; ``None``: all.
        held_out: Number of trajectories taken out of the training set, its last ones; below 1,
            their share (at least one).
        velocities: ``"estimated"`` replaces the velocities of the training data by central
            differences of the configurations, noise included.
    """

    recorded: ClassVar[bool] = False
    """True if the motions were measured."""
    test_names: Sequence[str] = ()
    """Names of the recordings that are for test."""
    cut: Callable[[Sequence[Trajectory]], TrainingSamples]
    """Makes the samples of the loaders."""

    def __init__(
        self,
        *,
        time_step: float,
        n_traj: int,
        noise_std: float = 0.0,
        input_noise_std: float = 0.0,
        noise_test: bool = False,
        batch_size: int | None = None,
        shuffle: bool = True,
        seed: int = 0,
        noise_seed: int = 0,
        dtype: str | torch.dtype = "float32",
        monitor: Literal["val", "test", "held_out"] = "val",
        monitor_trajectories: int | None = None,
        held_out: float = 0,
        velocities: Literal["given", "estimated"] = "given",
    ) -> None:
        super().__init__()
        self.time_step = time_step
        self.velocities = one_of("data.velocities", velocities, ("given", "estimated"))
        self.n_traj = whole_number("data.n_traj", n_traj)
        self.noise_std = real("data.noise_std", noise_std, low=0)
        self.input_noise_std = real("data.input_noise_std", input_noise_std, low=0)
        self.noise_test = noise_test
        self.batch_size = whole_number(
            "data.batch_size", 4 * n_traj if batch_size is None else batch_size
        )
        self.shuffle = shuffle
        self.seed = whole_number("data.seed", seed, low=0, high=2**32 - 1)
        self.noise_seed = whole_number("data.noise_seed", noise_seed, low=0, high=2**32 - 1)
        name = one_of("data.dtype", str(dtype).removeprefix("torch."), ("float32", "float64"))
        self.dtype: torch.dtype = getattr(torch, name)
        one_of("data.monitor", monitor, ("val", "test", "held_out"))
        self.monitor = monitor
        if n_traj == 1 and (held_out or monitor == "held_out"):
            raise ConfigError(
                f"data.n_traj=1: data.monitor={monitor} with data.held_out={held_out} leaves no "
                "trajectory to train on; give 2 or more, or data.monitor=val data.held_out=0"
            )
        if 0.0 < held_out < 1.0:
            held_out = max(1, round(held_out * n_traj))
        low = 1 if monitor == "held_out" else 0
        self.held_out = whole_number("data.held_out", held_out, low=low, high=n_traj - 1)
        if monitor_trajectories is not None:
            whole_number("data.monitor_trajectories", monitor_trajectories)
        self.monitor_trajectories = monitor_trajectories
        self.cut = cut_windows
        self._on_device: dict[str, tuple[torch.device, TrainingSamples]] = {}

    @abstractmethod
    def load(self) -> Splits:
        """Return all trajectories, with the whole training set, the same at every call."""

    def lines(self) -> Sequence[str]:
        """Return lines for the log on the data."""
        return ()

    def setup(self, stage: str | None = None) -> None:
        """Log ``lines()``, add noise and cut windows, unless that is done."""
        if hasattr(self, "train"):
            return
        for line in self.lines():
            log.info(line)
        splits = self.load()
        train = add_noise(
            splits.train[: self.n_traj], self.noise_std, [self.noise_seed, 0], self.input_noise_std
        )
        kept = self.n_traj - self.held_out
        std = self.noise_std if self.noise_test else 0.0
        parts = {
            "train": train[:kept],
            "held_out": train[kept:],
            "val": splits.val,
            "test": add_noise(splits.test, std, [self.noise_seed, 1]),
        }
        self._parts = {name: usable(name, part) for name, part in parts.items()}
        if self.velocities == "estimated":
            for name in ("train", "held_out"):
                self._parts[name] = [
                    t._replace(v=central_differences(t.q, self.time_step, space_of(t.q, t.v)))
                    for t in self._parts[name]
                ]
        self.integration = splits.integration
        self.train, self.val, self.test = (
            _converted(cut_windows(self._parts[name]), self.dtype)
            for name in ("train", "val", "test")
        )

    def trajectories(self, part: Literal["train", "held_out", "val", "test"]) -> list[Trajectory]:
        """Return the trajectories of a part, in float64; "train" excludes "held_out"."""
        return self._parts[part]

    def batches(self, epoch: int) -> list[TrainingSamples]:
        """Return the mini-batches of an epoch, permuted by the seed and the epoch."""
        samples = self._placed("train", lambda: self._samples(self.trajectories("train")))
        if self.shuffle:
            generator = torch.Generator().manual_seed(self.seed * 1_000_003 + epoch)
            order = torch.randperm(len(samples.q), generator=generator)
            rows = order.to(samples.q.device)
            samples = samples.rows(rows)
        parts = (field.split(self.batch_size) for field in samples)
        return [type(samples)(*fields) for fields in zip(*parts, strict=True)]

    def train_dataloader(self) -> Once[list[TrainingSamples]]:
        """Return a loader of one item an epoch: all its mini-batches."""
        alone = itertools.count()
        return Once(
            lambda: self.batches(self.trainer.current_epoch if self.trainer else next(alone))
        )

    def val_dataloader(self) -> Once[TrainingSamples]:
        """Return a loader of one item: the samples that are watched during training."""
        watched = self.trajectories(self.monitor)[: self.monitor_trajectories]
        return Once(lambda: self._placed("watched", lambda: self._samples(watched)))

    def transfer_batch_to_device(
        self, batch: Any, device: torch.device, dataloader_idx: int
    ) -> Any:
        """Return the batch: loaders gather on the device."""
        return batch

    def _samples(self, trajectories: Sequence[Trajectory]) -> TrainingSamples:
        return _converted(self.cut(trajectories), self.dtype)

    def _placed(self, name: str, make: Callable[[], TrainingSamples]) -> TrainingSamples:
        """Return samples on the trainer's device, moved there once."""
        device = self.trainer.strategy.root_device if self.trainer else torch.device("cpu")
        where, samples = self._on_device.get(name, (None, None))
        if samples is None or where != device:
            samples = _converted(make(), device)
            self._on_device[name] = (device, samples)
        return samples


def usable(part: str, trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Return the trajectories of a part that have a sample.

    Raises:
        ConfigError: If there are trajectories, and none has.
    """
    found = [one for one in trajectories if len(one.q) >= NODES]
    if trajectories and not found:
        raise ConfigError(
            f"joint limits end every motion for {part} before its third node; set "
            "system.limits=off or choose a narrower system.box"
        )
    return found


def _converted(samples: Kind, to: torch.dtype | torch.device) -> Kind:
    """Return samples in a precision, or on a device."""
    return type(samples)(*(field.to(to) for field in samples))


def stacked(trajectories: Sequence[Trajectory], nodes: int) -> Trajectories:
    """Return the first nodes of trajectories that have at least so many."""
    fields = zip(*trajectories, strict=True)
    return Trajectories(*(torch.stack([x[:nodes] for x in field]) for field in fields))


def central_differences(q: Tensor, h: float, space: Space) -> Tensor:
    """Return ``(q_{k+1} − q_{k−1}) / 2h``, one-sided of second order at both ends.

    Of a rotation it is the mean of the body rates over both steps. There are at least three nodes.
    """
    if not space.rotations:
        return torch.gradient(q, spacing=h, dim=0, edge_order=2)[0]
    rates = space.difference(q[:-1], q[1:]) / h
    inner = 0.5 * (rates[1:] + rates[:-1])
    first, last = 2.0 * rates[0] - inner[0], 2.0 * rates[-1] - inner[-1]
    return torch.cat((first.unsqueeze(0), inner, last.unsqueeze(0)))


class Once(Generic[Item]):
    """A loader of one item, which is made on iteration."""

    def __init__(self, make: Callable[[], Item]) -> None:
        self._make = make

    def __len__(self) -> int:
        return 1

    def __iter__(self) -> Iterator[Item]:
        yield self._make()
