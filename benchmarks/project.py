"""The project as a contender; no other file here uses its models."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import lightning
import numpy as np
import torch

from benchmarks.cases import (
    CASES,
    TRAINING_ROWS,
    Case,
    Layer,
    calm_weights,
    initial_weights,
    layers_of,
    system_windows,
    training_batch,
)
from symo_exp.compile import compile_rollout, compile_training
from symo_exp.compile.inductor import compiler_available as compiler_available
from symo_exp.data.base import Once
from symo_exp.mechanics.explicit import RK4, Midpoint
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.base import DynamicsModel
from symo_exp.models.e2e_symo import E2ESyMo
from symo_exp.models.l_node import LNODE
from symo_exp.models.node import NODE
from symo_exp.models.objectives import RootError
from symo_exp.models.symo import SyMo
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.mlp import MLP
from symo_exp.optim.base import minibatches
from symo_exp.optim.direct import direct_step
from symo_exp.runs.folder import About, RunFolder
from symo_exp.runs.series import Series
from symo_exp.tracking.publish import MlflowView
from symo_exp.training import learner as learning
from symo_exp.training.learner import Learner
from symo_exp.training.recording import SeriesRecorder
from symo_exp.training.trainer import make_trainer

CLASSES = {"e2e_symo": E2ESyMo, "l_node": LNODE, "symo": SyMo, "node": NODE}
CHUNK = 1024
"""Rows of an evaluation at a time, as `symo_exp.evaluation` takes them."""


def build(
    method: str,
    case: Case,
    layers: Sequence[Layer],
    dtype: torch.dtype,
    *,
    integrator: str = "rk4",
    tolerance: float = 1e-5,
    max_iterations: int = 10,
    stopping: str = "row",
    guess: str = "datum",
    **training: Any,
) -> Learner:
    """Return a learner of the project whose model has the given weights."""
    options: dict[str, Any] = {
        "coordinates": Coordinates(tuple(f"q{i}" for i in range(case.n)), case.angular),
        "input_matrix": torch.tensor(case.input_matrix),
        "time_step": case.time_step,
    }
    if method == "node":
        options["net"] = partial(MLP, width=case.width, depth=2)
    else:
        options["lagrangian"] = partial(NetworkLagrangian, width=case.width)
    if method in ("symo", "e2e_symo"):
        options["integrator"] = VariationalMidpoint()
        options["root"] = Newton(
            tolerance=tolerance,
            max_iterations=max_iterations,
            stopping=stopping,  # type: ignore[arg-type]
        )
    else:
        options["integrator"] = {"rk4": RK4, "midpoint": Midpoint}[integrator]()
    if method == "e2e_symo":
        options["guess"] = guess
    model: DynamicsModel = CLASSES[method](**options).to(dtype)
    with torch.no_grad():
        for parameter, value in zip(parameters(model), flatten(layers), strict=True):
            parameter.copy_(value)
    return Learner(model, **training)


def flatten(layers: Sequence[Layer]) -> list[torch.Tensor]:
    """[weight, bias, weight, ...]."""
    return [x for layer in layers for x in layer]


def parameters(model: DynamicsModel) -> list[torch.nn.Parameter]:
    """The model's parameters in that order (it keeps weights and biases apart)."""
    holder: Any = model.lagrangian or model.flow.field
    net = holder.net
    return [p for pair in zip(net.weights, net.biases, strict=True) for p in pair]


class Project:
    """The project's model with its default optimiser, fused Adam."""

    def __init__(
        self,
        method: str,
        case: Case,
        layers: Sequence[Layer],
        *,
        dtype: torch.dtype = torch.float32,
        lr: float = 1e-3,
        compiled: bool = False,
        device: str = "cpu",
        **options: Any,
    ):
        self.dtype, self.device = dtype, device
        self.learner = build(method, case, layers, dtype, **options).to(device)
        self.model = self.learner.model
        if compiled:
            compile_training(self.learner)
            compile_rollout(self.model)
        self.optimizer = torch.optim.Adam(self.model.parameters(), lr=lr, fused=True)
        self._step = direct_step(self.optimizer)

    def prepare(self, windows: Windows) -> Windows:
        return Windows(*(x.to(self.device, self.dtype) for x in windows))

    def loss_and_gradient(self, batch: Windows) -> tuple[float, list[np.ndarray]]:
        loss = self.learner.loss_and_gradients(batch)
        slope = [p.grad for p in parameters(self.model)]
        return loss.item(), [g.numpy().copy() for g in slope if g is not None]

    def train_step(self, batch: Windows) -> None:
        self.learner.loss_and_gradients(batch)
        self._step()

    @torch.no_grad()
    def predict(self, batch: Windows) -> np.ndarray:
        rows = range(0, len(batch.q), CHUNK)
        return torch.cat(
            [self.model.predict(batch.rows(slice(i, i + CHUNK))).q for i in rows]
        ).numpy()

    @torch.no_grad()
    def rollout(self, batch: Windows, steps: int) -> np.ndarray:
        held = batch.u.unsqueeze(1).expand(-1, steps + 1, -1)
        batch = batch._replace(u_prev=batch.u)
        start = self.model.initial_velocity(batch)
        return self.model.rollout(batch.q, start, held).q[:, 1:].numpy()

    @torch.no_grad()
    def iterations(self, batch: Windows, *, training: bool = False) -> int | None:
        """The most Newton iterations that a row took, where roots are found."""
        objective, flow = self.learner.objective, self.model.flow
        if flow.reads_velocity:
            return None
        if not training or not isinstance(objective, RootError):
            return int(flow.predict(batch).iterations.max())
        impulse = objective.impulse(flow, batch, flow.expand_before(batch))
        problem = flow.matching(batch.q, impulse, flow.forces(batch.u, batch.u_next))
        return int(flow.root.solve(problem, objective.initial_guess(flow, batch)).iterations.max())


def trained_weights(name: str, method: str) -> list[Layer]:
    """E2E-SyMo after 2000 steps on 32 trajectories; a training takes 16,000 larger ones.

    Its Lagrangian serves every method that has one. NODE keeps its initial weights, which decide
    nothing about its cost.
    """
    return initial_weights(CASES[name], method) if method == "node" else _trained_lagrangian(name)


@cache
def _trained_lagrangian(name: str, steps: int = 2000) -> list[Layer]:
    case = CASES[name]
    contender = Project("e2e_symo", case, calm_weights(case, "e2e_symo"), lr=2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(contender.optimizer, steps)
    windows = contender.prepare(system_windows(name, TRAINING_ROWS))
    for step in range(steps):
        start = 32 * step % TRAINING_ROWS
        contender.train_step(windows.rows(slice(start, start + 32)))
        schedule.step()
    return layers_of(parameters(contender.model))


class _Samples(lightning.LightningDataModule):
    """Samples in memory, an item an epoch, as the project's own data."""

    def __init__(self, windows: Windows, batch: int):
        super().__init__()
        self.windows, self.batch = windows, batch

    def batches(self) -> list[Windows]:
        mixed = self.windows.rows(torch.randperm(len(self.windows.q)))
        return [mixed.rows(slice(i, i + self.batch)) for i in range(0, len(mixed.q), self.batch)]

    def train_dataloader(self) -> Once[list[Windows]]:
        return Once(self.batches)

    def val_dataloader(self) -> Once[Windows]:
        return Once(lambda: self.windows.rows(slice(512)))

    def transfer_batch_to_device(
        self, batch: Any, device: torch.device, dataloader_idx: int
    ) -> Any:
        return batch


@contextmanager
def whole_fit(
    method: str,
    case: Case,
    layers: Sequence[Layer],
    batch: int,
    *,
    epochs: int,
    seconds: float,
    clock: Callable[[], float],
) -> Iterator[Callable[[], tuple[float, float]]]:
    """`Trainer.fit` for some epochs of 8 steps: a call returns the seconds that one of its steps
    took, and all it took divided by their number.

    Both are of the same minute: on a busy machine the next one may be a quarter slower. The fit
    tracks and keeps checkpoints as a run does; the run is open before it and after it. It lasts at
    least so many `epochs` and `seconds`: a short one pays for its start and for the first hundred
    epochs, which are all sent to MLflow. The learning rate is 0: every fit is the same.
    """
    bare = Project(method, case, layers, lr=0.0)
    samples = _Samples(bare.prepare(training_batch(case.name, 8 * batch)), batch)
    for _ in range(2):  # the first makes room
        began = time.perf_counter()
        for part in samples.batches():
            bare.train_step(part)
    epochs = max(epochs, round(seconds / (time.perf_counter() - began)))

    def fit() -> tuple[float, float]:
        learner = build(
            method,
            case,
            layers,
            torch.float32,
            optimizer=lambda p: torch.optim.Adam(p, lr=0.0, fused=True),
            scheduler=lambda o: torch.optim.lr_scheduler.ReduceLROnPlateau(o, patience=50),
        )
        trainer = make_trainer(
            accelerator="cpu",
            max_epochs=epochs,
            validate_every=10,
            checkpoint_every=60.0,
            progress=True,
            threads=1,
            compile=False,
            folder=run.path,
            callbacks=[SeriesRecorder(Series(run / "series.csv"), lambda: view.publish(run), 10.0)],
        )
        in_steps = 0.0

        def timed(*arguments: Any) -> Any:
            nonlocal in_steps
            began = clock()
            results = minibatches(*arguments)
            in_steps += clock() - began
            return results

        with mock.patch.object(learning, "minibatches", timed):
            began = clock()
            trainer.fit(learner, samples)
            whole = clock() - began
        return in_steps / (8 * epochs), whole / (8 * epochs)

    with tempfile.TemporaryDirectory() as name:
        run, view = RunFolder(Path(name) / "run"), MlflowView(directory=Path(name) / "mlruns")
        run.describe(About("fit", {}))
        run.record("running")
        view.publish(run)
        yield fit
