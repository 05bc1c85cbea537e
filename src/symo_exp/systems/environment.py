"""A Gymnasium environment over any system: ``symo_exp/Pendulum-v0`` and so on.

Importing this module registers one environment for each system of ``conf/system``::

    import gymnasium
    import symo_exp.systems.environment

    env = gymnasium.make("symo_exp/Acrobot-v0", render_mode="rgb_array")
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, final

import gymnasium
import numpy as np
import torch

from symo_exp.errors import ConfigError
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.render import Renderer
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated
from symo_exp.systems.table import systems

MAX_EPISODE_STEPS = 500
SOLVER = Solver(method="RK45", rtol=1e-8, atol=1e-8)


@final
class Environment(gymnasium.Env[np.ndarray, np.ndarray]):
    """A step is ``system.time_step`` of exact motion under a held control.

    - Action: the control ``u`` (m,), float64 [N or N m]; clipped to the range the data are drawn
      from (``system.box.u``).
    - Observation: ``(q, v)`` (2n,), float64. Angles are not wrapped: they count turns.
    - Reward: the potential energy ``V(q)`` [J] of the state reached, which is greatest where the
      masses are highest: swinging up pays.
    - An episode has no end of its own; ``gymnasium.make`` truncates it after 500 steps.
    - ``reset`` draws the state uniformly from the system's box, or takes
      ``options={"q": [...], "v": [...]}``, either of which may be left out.
    - The integrator is SciPy's RK45 unless ``solver`` says otherwise; the data sets are made by
      the same function.
    """

    def __init__(
        self, system: LagrangianSystem, *, solver: Solver = SOLVER, render_mode: str | None = None
    ) -> None:
        self.metadata = {
            "render_modes": ["human", "rgb_array"],
            "render_fps": max(1, round(1 / system.time_step)),
        }
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode={render_mode!r}: expected human, rgb_array or None")
        self.system, self.solver, self.render_mode = system, solver, render_mode
        low, high = np.array(system.box.u).T
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float64)
        self.observation_space = gymnasium.spaces.Box(
            -np.inf, np.inf, shape=(2 * system.coordinates.n,), dtype=np.float64
        )
        self._state: np.ndarray | None = None
        self._renderer: Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        given = options or {}
        if unknown := set(given) - {"q", "v"}:
            raise ConfigError(f"reset options {sorted(unknown)}: expected q and v")
        parts = []
        for name in ("q", "v"):
            drawn = self.np_random.uniform(*np.array(getattr(self.system.box, name)).T)
            part = np.asarray(given.get(name, drawn), dtype=np.float64)
            if part.shape != drawn.shape or not np.isfinite(part).all():
                raise ConfigError(
                    f"reset option {name}={given[name]}: expected {len(drawn)} finite number(s)"
                )
            parts.append(part)
        return self._arrive(np.concatenate(parts)), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        space = self.action_space
        assert isinstance(space, gymnasium.spaces.Box)
        u = torch.from_numpy(np.clip(np.asarray(action, dtype=np.float64), space.low, space.high))
        after = simulate(self.system, *self.state(), u.reshape(1, -1), steps=1, solver=self.solver)
        reward = float(self.system.potential(after.q[:, 1]))
        state = torch.cat([after.q[0, 1], after.v[0, 1]]).numpy()
        return self._arrive(state), reward, False, False, {}

    def render(self) -> Any:
        return self._draw() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _arrive(self, state: np.ndarray) -> np.ndarray:
        self._state = state
        if self.render_mode == "human":
            self._draw()
        return state.copy()

    def state(self) -> tuple[torch.Tensor, torch.Tensor]:
        """``q`` and ``v`` now, (1, n) each."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        q, v = torch.from_numpy(self._state).unsqueeze(0).split(self.system.coordinates.n, dim=1)
        return q, v

    def _draw(self) -> np.ndarray | None:
        assert self.render_mode is not None
        name, figure = type(self.system).__name__, self.system.skeleton(self.state()[0][0])
        if figure is None:
            raise ConfigError(f"{name} cannot be drawn: its class has no skeleton(q)")
        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"], name)
        return self._renderer.draw(figure)


def make(
    system: str,
    parameters: Mapping[str, Any] | None = None,
    render_mode: str | None = None,
    solver: Mapping[str, Any] | None = None,
) -> Environment:
    """The environment of a system of ``conf/system``, with parameters other than its own.

    ``parameters`` are fields of the system, ``solver`` fields of ``Solver``.
    """
    chosen = dataclasses.replace(SOLVER, **(solver or {}))
    return Environment(stated(system, **(parameters or {})), solver=chosen, render_mode=render_mode)


for _name, _kind in systems().items():
    gymnasium.register(
        f"symo_exp/{_kind.__name__}-v0",
        entry_point="symo_exp.systems.environment:make",
        max_episode_steps=MAX_EPISODE_STEPS,
        kwargs={"system": _name},
    )
