"""Gymnasium environments of any system, moved by its own equations or by a model of it.

Importing this module registers one environment for each system of ``conf/system``::

    import gymnasium
    import symo_exp.use.environments

    env = gymnasium.make("symo_exp/Acrobot-v0", render_mode="rgb_array")
    envs = gymnasium.make_vec("symo_exp/Acrobot-v0", num_envs=1000)

For one copy and for many:

- Action: the control ``u`` (m,), float64 [N or N m], held over ``system.time_step``; clipped to the
  range that data are drawn from (``system.box.u``).
- Observation: ``(q, v)`` (2n,), float64. Angles are not wrapped: they count turns.
- Reward: the true potential energy ``V(q)`` [J] of the state reached, where it is known: greatest
  where the masses are highest, so that swinging up is rewarded. Otherwise 0, unless a reward is
  given.
- An episode is truncated after its largest number of steps, and terminated only where a model finds
  no next state, at the last one it had.
- ``reset`` draws the state uniformly from the system's box, or takes
  ``options={"q": [...], "v": [...]}``, either of which may be left out.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
from collections.abc import Mapping
from functools import partial
from typing import Any, final

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import dictionary, instance, whole_number
from symo_exp.errors import ConfigError
from symo_exp.models.base import DynamicsModel
from symo_exp.models.inference import leaves_inference_mode
from symo_exp.systems.base import LagrangianSystem, System
from symo_exp.systems.render import SIZE, Window, draw_skeleton
from symo_exp.systems.simulation import Solver
from symo_exp.systems.table import system as stated
from symo_exp.systems.table import systems
from symo_exp.tracking.load import model_of
from symo_exp.use.copies import Copies, Reward, TimeStep, exact
from symo_exp.words import counted

MAX_EPISODE_STEPS = 500
SOLVER = Solver(method="RK45", rtol=1e-8, atol=1e-8)


@final
class Environment(gymnasium.Env[np.ndarray, np.ndarray]):
    """One copy of a system.

    Args:
        system: Its coordinates, inputs, box and picture.
        solver: How the true system is integrated.
        motion: The step that moves it; ``None``: the true system's.
        reward: The reward of a step; ``None``: the potential energy.
        render_mode: ``human``, ``rgb_array`` or ``None``.
        max_episode_steps: Steps after which an episode is truncated; ``None``: never.
    """

    def __init__(
        self,
        system: System,
        *,
        solver: Solver = SOLVER,
        motion: TimeStep | None = None,
        reward: Reward | None = None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ) -> None:
        self.metadata = {
            "render_modes": ["human", "rgb_array"],
            "render_fps": max(1, round(1 / system.time_step)),
        }
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode={render_mode!r}: expected human, rgb_array or None")
        self.system, self.solver, self.render_mode = system, solver, render_mode
        self._copies = Copies(system, motion or exact(system, solver), reward)
        self.action_space, self.observation_space = self._copies.actions, self._copies.observations
        self._last, self._age = _limit(max_episode_steps), 0
        self._state: np.ndarray | None = None
        self._window: Window | None = None

    @override
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._age = 0
        return self._arrive(self._copies.draw(self.np_random, 1, options)), {}

    @override
    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        states, rewards, lost = self._copies.move(self._now(), np.asarray(action)[None])
        self._age += 1
        truncated = self._age >= self._last
        return self._arrive(states), float(rewards[0]), bool(lost[0]), truncated, {}

    @override
    def render(self) -> Any:
        return self._draw() if self.render_mode == "rgb_array" else None

    @override
    def close(self) -> None:
        if self._window is not None:
            self._window.close()
            self._window = None

    def _arrive(self, state: np.ndarray) -> np.ndarray:
        self._state = state
        if self.render_mode == "human":
            self._draw()
        return state[0].copy()

    def state(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the current ``q`` and ``v``, (1, n) each."""
        widths = [self.system.coordinates.width, self.system.coordinates.n]
        q, v = torch.from_numpy(self._now()).split(widths, dim=1)
        return q, v

    def _now(self) -> np.ndarray:
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._state

    def _draw(self) -> np.ndarray | None:
        name, q = type(self.system).__name__, self.state()[0][0]
        picture = self.system.picture(q, SIZE)
        if picture is None:
            figure = self.system.skeleton(q)
            if figure is None:
                raise ConfigError(f"{name} cannot be drawn: its class has no skeleton(q)")
            picture = draw_skeleton(figure)
        if self.render_mode == "rgb_array":
            return picture
        if self._window is None:
            self._window = Window(self.metadata["render_fps"], name)
        self._window.show(picture)
        return None


@final
class VectorEnvironment(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Copies of a system that move together, in one batch.

    A copy whose episode is over is reset by the next step, which ignores its action and has the
    reward 0.

    Args:
        system: Its coordinates, inputs and box.
        num_envs: Number of copies.
        solver: How the true system is integrated.
        motion: The step that moves them; ``None``: the true system's.
        reward: The reward of a step; ``None``: the potential energy.
        max_episode_steps: Steps after which an episode is truncated; ``None``: never.
    """

    def __init__(
        self,
        system: System,
        num_envs: int,
        *,
        solver: Solver = SOLVER,
        motion: TimeStep | None = None,
        reward: Reward | None = None,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
    ) -> None:
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs, self.system = whole_number("copies", num_envs), system
        self._copies = Copies(system, motion or exact(system, solver), reward)
        self.single_action_space = self._copies.actions
        self.single_observation_space = self._copies.observations
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._last = _limit(max_episode_steps)
        self._state: np.ndarray | None = None
        self._age, self._over = np.zeros(num_envs), np.zeros(num_envs, dtype=bool)

    @override
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._age[:], self._over[:] = 0, False
        self._state = self._copies.draw(self.np_random, self.num_envs, options)
        return self._state.copy(), {}

    @override
    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        self._state, reward, lost = self._copies.move(self._state, actions)
        self._age += 1
        anew = self._over
        self._state[anew] = self._copies.draw(self.np_random, int(anew.sum()))
        self._age[anew], reward[anew], lost[anew] = 0, 0.0, False
        truncated = self._age >= self._last
        self._over = lost | truncated
        return self._state.copy(), reward, lost, truncated, {}


def _limit(steps: int | None) -> float:
    return np.inf if steps is None else whole_number("max_episode_steps", steps)


@leaves_inference_mode
def environment(
    subject: System | DynamicsModel | str | os.PathLike[str],
    copies: int | None = None,
    *,
    system: System | None = None,
    box: Any = None,
    **options: Any,
) -> Environment | VectorEnvironment:
    """Return a Gymnasium environment that a system's own equations or a model moves.

    Args:
        subject: A system, or a model that moves it, also by its run, the folder of the run or the
            id of an MLflow run.
        copies: Number of copies in a ``gymnasium.vector.VectorEnv``; ``None``: a single
            ``gymnasium.Env``.
        system: The system of a model; ``None``: that of its run.
        box: Ranges ``dict(q=..., v=..., u=...)`` of starts and inputs; ``None``: the system's.
        options: ``reward``, ``motion``, ``solver``, ``max_episode_steps`` (500) and, of a single
            one, ``render_mode``.

    Raises:
        ConfigError: If the system of a model is not known, or it has neither equations nor a box.
    """
    kind = Environment if copies is None else VectorEnvironment
    dictionary("options", options, inspect.getfullargspec(kind.__init__).kwonlyargs)
    if isinstance(subject, System):
        system = subject
    else:
        model = model_of(subject, "environment", "a system, ")
        system = model.system if system is None else system
        if system is None:
            raise ConfigError(
                "the system of this model is not known: give it, environment(model, system=...)"
            )
        instance("system", system, System)
        _require_same_sizes(model, system)
        options = {"motion": partial(_model_step, model), **options}
    if box is not None:
        system = dataclasses.replace(system, box=box)
    options = {"max_episode_steps": MAX_EPISODE_STEPS, **options}
    if copies is None:
        return Environment(system, **options)
    return VectorEnvironment(system, copies, **options)


def _require_same_sizes(model: DynamicsModel, system: System) -> None:
    sizes = [
        (x.coordinates.width, x.coordinates.n, x.input_matrix.shape[1]) for x in (model, system)
    ]
    if sizes[0] != sizes[1]:
        (_, n, m), (_, others, inputs) = sizes
        raise ConfigError(
            f"{type(system).__name__} has {counted(others, 'coordinate')} and "
            f"{counted(inputs, 'input')}: expected the system of the model, which has {n} "
            f"and {m} and the same rotations"
        )


def _model_step(
    model: DynamicsModel, q: Tensor, v: Tensor, u: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    path = model.rollout(q, v, torch.stack((u, u), dim=1))
    return path.q[:, 1], path.v[:, 1], path.converged[:, 0]


@leaves_inference_mode
def make_environment(
    system: str,
    parameters: Mapping[str, Any] | None = None,
    solver: Mapping[str, Any] | None = None,
    num_envs: int | None = None,
    **options: Any,
) -> Environment | VectorEnvironment:
    """Return the environment of a system of ``conf/system``; Gymnasium calls this.

    Args:
        system: Its name.
        parameters: Fields of the system that differ from its file.
        solver: Fields of ``Solver``.
        num_envs: Number of copies; ``None``: a single environment.
        options: Those of ``environment``.
    """
    options = {"max_episode_steps": None, **options}  # Gymnasium's own limit, of one copy
    changes = dictionary("parameters", parameters or {}, _fields(systems()[system]))
    chosen = dataclasses.replace(SOLVER, **dictionary("solver", solver or {}, _fields(Solver)))
    return environment(stated(system, **changes), num_envs, solver=chosen, **options)


def _fields(kind: type[LagrangianSystem | Solver]) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


for _name, _kind in systems().items():
    gymnasium.register(
        f"symo_exp/{_kind.__name__}-v0",
        entry_point="symo_exp.use.environments:make_environment",
        vector_entry_point="symo_exp.use.environments:make_environment",
        max_episode_steps=MAX_EPISODE_STEPS,
        kwargs={"system": _name},
    )
