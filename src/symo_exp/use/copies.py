"""States, steps and rewards of the copies in an environment, one or many."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

from symo_exp.checks import dictionary, function, instance
from symo_exp.errors import ConfigError
from symo_exp.models.inference import leaves_inference_mode
from symo_exp.systems.base import LagrangianSystem, System
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.words import counted

TimeStep = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
"""Maps ``(q, v, u)`` of a batch to ``(q⁺, v⁺, found)`` one time step later; ``found`` is false in
rows without such a state."""
Reward = Callable[[Tensor, Tensor, Tensor], Any]
"""Maps ``(q⁺, v⁺, u)`` of a batch to the reward of the step that led there: a tensor, an array or a
list with a number for each row, or one number for all."""


class Copies:
    """Any number of copies of a system.

    Args:
        system: Its coordinates, inputs and box.
        motion: The step that moves them.
        reward: The reward of a step; ``None``: the potential energy where it is known, else 0.

    Raises:
        ConfigError: If the system has no box of starts and inputs.
    """

    def __init__(self, system: System, motion: TimeStep, reward: Reward | None) -> None:
        if system.box is None:
            n, m = system.input_matrix.shape
            raise ConfigError(
                f"the ranges of states and inputs of {type(system).__name__} are not known: give "
                f"box=dict(q=..., v=..., u=...), a list of [low, high] for each of "
                f"{counted(n, 'coordinate')} and {counted(m, 'input')}"
            )
        function("motion", motion, "a function of (q, v, u)", None, None, None)
        if reward is not None:
            function("reward", reward, "a function of (q, v, u)", None, None, None)
        self.system, self.box = system, system.box
        self._motion, self._reward = motion, reward or partial(potential_reward, system)
        low, high = np.array(self.box.u, dtype=np.float64).reshape(-1, 2).T
        self.actions = gymnasium.spaces.Box(low, high, dtype=np.float64)
        shape = (system.coordinates.width + system.coordinates.n,)
        self.observations = gymnasium.spaces.Box(-np.inf, np.inf, shape=shape, dtype=np.float64)

    @leaves_inference_mode
    def draw(
        self, random: np.random.Generator, count: int, options: Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Return states (count, N + n) to start from; rotations are drawn as rotation vectors."""
        given = dictionary("options", {} if options is None else options, ("q", "v"))
        parts, space = [], self.system.coordinates.space
        for name in ("q", "v"):
            low, high = np.array(getattr(self.box, name)).T
            drawn = random.uniform(low, high, size=(count, len(low)))
            if name == "q":  # the entries of rotations
                drawn = space.of_vector(torch.from_numpy(drawn)).numpy()
            size = drawn.shape[1]
            try:
                part = np.asarray(given.get(name, drawn), dtype=np.float64)
            except (TypeError, ValueError):
                part = np.array(np.nan)
            if part.shape not in (drawn.shape, (size,)) or not np.isfinite(part).all():
                wanted = counted(size, "finite number")
                raise ConfigError(f"reset option {name}={given[name]}: expected {wanted}")
            if name == "q" and not space.rotates(torch.tensor(part)).all():
                raise ConfigError(
                    f"reset option q={given[name]}: expected rotation matrices, row by row, after "
                    "the lengths and angles"
                )
            parts.append(np.broadcast_to(part, drawn.shape))
        return np.concatenate(parts, axis=1)

    @leaves_inference_mode
    def move(self, states: np.ndarray, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return states, rewards and which copies are lost after a step.

        A lost copy keeps its state.

        Raises:
            ConfigError: If actions or rewards are not numbers of the right shape.
        """
        u = torch.from_numpy(self._clipped(actions, len(states)))
        widths = [self.system.coordinates.width, self.system.coordinates.n]
        q, v = torch.from_numpy(states).split(widths, dim=1)
        with torch.no_grad():
            moved = self._motion(q, v, u)
            parts = moved if isinstance(moved, tuple) else (moved,)
            if len(parts) != 3 or not all(isinstance(x, Tensor) for x in parts):
                told = ", ".join(type(x).__name__ for x in parts)
                raise ConfigError(f"motion returns {told}: expected three tensors (q, v, found)")
            q_next, v_next, found = (x.cpu() for x in parts)
            found = found & q_next.isfinite().all(1) & v_next.isfinite().all(1)
            found = (found & self.system.coordinates.space.rotates(q_next))[:, None]
            q, v = q_next.double().where(found, q), v_next.double().where(found, v)
            reward = np.asarray(self._reward(q, v, u))
        if reward.dtype.kind not in "biuf" or reward.shape not in ((), (len(states),)):
            raise ConfigError(
                f"the reward has shape {reward.shape} and type {reward.dtype}: expected numbers of "
                f"shape ({len(states)}), one for each copy"
            )
        reward = np.broadcast_to(reward.astype(np.float64), len(states)).copy()
        return torch.cat((q, v), dim=1).numpy(), reward, ~found[:, 0].numpy()

    def _clipped(self, actions: Any, count: int) -> np.ndarray:
        """Return actions (count, m) within their range; of one copy or input in any shape."""
        given, shape = np.asarray(actions), (count, *self.actions.shape)
        fits = given.shape == shape or (given.size == math.prod(shape) and min(shape) < 2)
        if given.dtype.kind not in "biuf" or not fits:
            raise ConfigError(
                f"action of shape {given.shape} and type {given.dtype}: expected numbers of shape "
                f"{shape}, a row for each copy"
            )
        given = given.astype(np.float64).reshape(shape)
        if np.isnan(given).any():
            row = int(np.argmax(np.isnan(given).any(axis=1)))
            raise ConfigError(
                f"action {given[row].tolist()} of copy {row}: expected numbers, not nan; check the "
                "policy that computed it"
            )
        return given.clip(self.actions.low, self.actions.high)


def exact(system: System, solver: Solver) -> TimeStep:
    """Return the step of a true system, integrated like simulated data."""
    if not isinstance(system, LagrangianSystem):
        raise ConfigError(f"{type(system).__name__} has no known equations; give a model instead")
    instance("solver", solver, Solver)
    return partial(_exact_step, system, solver)


def _exact_step(
    system: LagrangianSystem, solver: Solver, q: Tensor, v: Tensor, u: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    after = simulate(system, q, v, u, steps=1, solver=solver)
    return after.q[:, 1], after.v[:, 1], torch.ones(len(q), dtype=torch.bool)


def potential_reward(system: System, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    """Return the reward ``V(q)``, 0 where it is not known."""
    return system.potential(q) if isinstance(system, LagrangianSystem) else q.new_zeros(len(q))
