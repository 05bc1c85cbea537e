"""The interface of everything that is measured, and the two baselines.

A contender is built from a method, a case and the shared weights; it keeps its own parameters,
optimiser and precision. Batches are prepared once, outside the clock.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch

from benchmarks import baseline_autograd
from benchmarks.cases import Case, Layer
from symo_exp.mechanics.types import Windows


class Contender(Protocol):
    """Interface of an implementation to the benchmarks; `batch` is a result of `prepare`."""

    def prepare(self, windows: Windows) -> Any:
        """The windows in this implementation's arrays and precision."""

    def loss_and_gradient(self, batch: Any) -> tuple[float, list[np.ndarray]]:
        """Loss and its gradient, [weight (out, in), bias, ...]."""

    def train_step(self, batch: Any) -> None:
        """One optimiser step, finished when it returns."""

    def predict(self, batch: Any) -> np.ndarray:
        """One-step prediction of q_{k+1}."""

    def rollout(self, batch: Any, steps: int) -> np.ndarray:
        """Configurations after 1..steps steps under the input held at u, (B, steps, n)."""

    def iterations(self, batch: Any, *, training: bool = False) -> int | None:
        """The most Newton iterations that a row took, where roots are found."""


class Autograd:
    """Baseline (a)."""

    def __init__(
        self,
        method: str,
        case: Case,
        layers: Sequence[Layer],
        *,
        dtype: torch.dtype = torch.float32,
        lr: float = 1e-3,
        **options: Any,
    ):
        self.dtype = dtype
        self.model = baseline_autograd.CLASSES[method](case, layers, dtype, **options)
        self.optimizer = torch.optim.Adam(self.model.parameters(), lr=lr)

    def prepare(self, windows: Windows) -> Windows:
        return Windows(*(x.to(self.dtype) for x in windows))

    def loss_and_gradient(self, batch: Windows) -> tuple[float, list[np.ndarray]]:
        loss = self.model.loss(batch)
        slope = torch.autograd.grad(loss, list(self.model.parameters()), materialize_grads=True)
        return loss.item(), [g.numpy() for g in slope]

    def train_step(self, batch: Windows) -> None:
        loss = self.model.loss(batch)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()

    def predict(self, batch: Windows) -> np.ndarray:
        return self.model.predict(batch).numpy()

    def rollout(self, batch: Windows, steps: int) -> np.ndarray:
        return self.model.rollout(batch, steps).numpy()

    def iterations(self, batch: Windows, *, training: bool = False) -> int | None:
        if not isinstance(self.model, baseline_autograd.SyMo):
            return None
        self.model.predict(batch)
        return self.model.iterations


class Jax:
    """Baseline (b); float64 inside `jax.enable_x64`."""

    def __init__(
        self,
        method: str,
        case: Case,
        layers: Sequence[Layer],
        *,
        lr: float = 1e-3,
        **options: Any,
    ):
        from benchmarks import baseline_jax

        self.module = baseline_jax
        self.finds_roots = method in ("symo", "e2e_symo")
        self.method = baseline_jax.Method(method, case, lr=lr, **options)
        self.parameters = baseline_jax.to_parameters(layers)
        self.adam = self.method.start(self.parameters)

    def prepare(self, windows: Windows) -> Any:
        return self.module.to_samples(windows)

    def loss_and_gradient(self, batch: Any) -> tuple[float, list[np.ndarray]]:
        loss, slope = self.method.loss_and_gradient(self.parameters, batch)
        return float(loss), self.module.to_arrays(slope)

    def train_step(self, batch: Any) -> None:
        self.parameters, self.adam, loss = self.method.train_step(self.parameters, self.adam, batch)
        loss.block_until_ready()

    def predict(self, batch: Any) -> np.ndarray:
        return np.asarray(self.method.predict(self.parameters, batch))

    def rollout(self, batch: Any, steps: int) -> np.ndarray:
        return np.asarray(self.method.rollout(self.parameters, batch, steps))

    def iterations(self, batch: Any, *, training: bool = False) -> int | None:
        if not self.finds_roots:
            return None
        return int(self.method.newton_iterations(self.parameters, batch))


def jax_is_installed() -> bool:
    """Return whether baseline (b) can run."""
    return importlib.util.find_spec("jax") is not None
