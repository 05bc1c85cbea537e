"""Recordings of a Gymnasium environment: ``python -m symo_exp record ENV``."""

from __future__ import annotations

import argparse
import itertools
import runpy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from symo_exp.checks import whole_number
from symo_exp.errors import ConfigError, shortened, with_place
from symo_exp.files import write_frame
from symo_exp.shell import override_value, python_command
from symo_exp.words import counted

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.systems.base import System

Policy = Callable[[np.ndarray], np.ndarray]
"""Maps an observation to an action."""


SHORT, FEW = 1.0, 20
"""Length [s] and number of nodes that the median episode needs at least to be learned from."""


class Plant(NamedTuple):
    """The part of an environment that is recorded.

    Attributes:
        system: Its coordinates and inputs.
        now: Returns the current ``(t, q, v)``.
        applied: Returns the input of the last step for its action.
    """

    system: System
    now: Callable[[], tuple[float, np.ndarray, np.ndarray]]
    applied: Callable[[np.ndarray], np.ndarray]


def main(argv: Sequence[str]) -> int:
    """Run the command line and return its exit code."""
    parser = argparse.ArgumentParser(
        prog=python_command("symo_exp", "record"),
        description="Record the motions of a Gymnasium environment as a table to learn from.",
    )
    parser.add_argument(
        "env", metavar="ENV", help="the environment, such as Swimmer-v5 or symo_exp/Acrobot-v0"
    )
    parser.add_argument(
        "--policy",
        default="random",
        metavar="random|FILE",
        help="a .py file with policy(observation); default: random actions",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("recording.parquet"), metavar="FILE",
        help="a .parquet or .csv file; default: %(default)s",
    )  # fmt: skip
    for name, default, told in (
        ("--episodes", 16, "number of episodes"),
        ("--steps", 200, "largest number of steps in an episode"),
        ("--seed", 0, "of the environment and of random actions"),
    ):
        told += "; default: %(default)s"
        parser.add_argument(name, type=int, default=default, metavar="N", help=told)
    options = parser.parse_args(argv)
    for name, low in (("episodes", 1), ("steps", 2), ("seed", 0)):
        whole_number(f"--{name}", getattr(options, name), low=low)
    if options.out.suffix not in (".parquet", ".csv"):
        raise ConfigError(f"--out {options.out}: expected a file that ends in .parquet or .csv")
    if not options.out.parent.is_dir():  # before minutes of recording
        raise ConfigError(f"--out {options.out} cannot be written (no folder {options.out.parent})")
    env = _made(options.env)
    try:
        plant = _plant(env, options.env)
        _refuse_rotations(options.env, plant.system.coordinates.rotations)
        policy = _policy(options.policy, env, options.seed)
        episodes = [
            record_episode(env, plant, policy, options.steps, options.seed + k)
            for k in range(options.episodes)
        ]
    finally:
        env.close()
    table = write_episodes(options.out, episodes)
    print(_told(options.out, plant.system, table))
    return 0


def record_episode(env: Any, plant: Plant, policy: Policy, steps: int, seed: int) -> pd.DataFrame:
    """Return one episode, until it ends by itself or after ``steps`` steps.

    It has a row for each node. An input is held from its node to the next, the last is repeated.
    """
    import pandas as pd

    observation, _ = env.reset(seed=seed)
    nodes, inputs = [plant.now()], []
    for _ in range(steps):
        try:
            action = np.asarray(policy(observation), dtype=np.float64)
        except Exception as error:  # a user's own code
            raise ConfigError(f"the policy fails: {with_place(error)}") from error
        if action.shape != env.action_space.shape or not np.isfinite(action).all():
            wanted = counted(env.action_space.shape[0], "finite number")
            raise ConfigError(f"the policy returned {action.tolist()}: expected {wanted}")
        action = np.clip(action, env.action_space.low, env.action_space.high)
        observation, _, terminated, truncated, _ = env.step(action)
        nodes.append(plant.now())
        inputs.append(plant.applied(action))
        if terminated or truncated:
            break
    t, q, v = (np.array(field) for field in zip(*nodes, strict=True))
    coordinates = plant.system.coordinates.names
    named = ("q", coordinates), ("v", coordinates), ("u", plant.system.inputs)
    columns = ["t", *(f"{kind}_{name}" for kind, names in named for name in names)]
    return pd.DataFrame(np.column_stack([t - t[0], q, v, [*inputs, inputs[-1]]]), columns=columns)


def write_episodes(path: Path, episodes: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Write episodes as a table of recordings (docs/recordings.md) and return it."""
    import pandas as pd

    parts = [episode.assign(trajectory=k) for k, episode in enumerate(episodes)]
    table = pd.concat(parts)[["trajectory", *episodes[0]]]
    try:
        write_frame(path, table)
    except OSError as error:
        raise ConfigError(f"--out {path} cannot be written ({error.strerror or error})") from None
    return table


def _made(name: str) -> Any:
    import gymnasium

    import symo_exp.use.environments  # noqa: F401 (registers the environments of this package)

    try:
        return gymnasium.make(name)
    except Exception as error:  # an environment is anybody's code
        raise ConfigError(f"record {name}: Gymnasium cannot make it: {shortened(error)}") from None


def _plant(env: Any, name: str) -> Plant:
    from symo_exp.use.environments import Environment

    base = env.unwrapped
    if isinstance(base, Environment):
        h, steps = base.system.time_step, itertools.count()

        def now() -> tuple[float, np.ndarray, np.ndarray]:
            q, v = (x[0].numpy() for x in base.state())
            return next(steps) * h, q, v

        return Plant(base.system, now, lambda action: action)
    data: Any = getattr(base, "data", None)
    if not hasattr(base, "model") or not hasattr(data, "qpos"):
        raise ConfigError(
            f"record {name}: its coordinates are unknown; environments with a MuJoCo model "
            "and those of this package have them"
        )
    from symo_exp.systems.mujoco import environment_mechanism
    from symo_exp.systems.multibody import Multibody

    return Plant(
        Multibody(mechanism=environment_mechanism(name), time_step=base.model.opt.timestep),
        lambda: (float(data.time), data.qpos.copy(), data.qvel.copy()),
        lambda _: data.ctrl.copy(),
    )


def _refuse_rotations(name: str, rotations: Sequence[str]) -> None:
    """Refuse ball joints and free bodies, which have more positions than velocities."""
    if rotations:
        raise ConfigError(
            f"record {name}: this command does not write rotations ({', '.join(rotations)}); write "
            "such motions yourself, in the columns of docs/rotations.md"
        )


def _policy(given: str, env: Any, seed: int) -> Policy:
    if given == "random":
        env.action_space.seed(seed)
        return lambda _: env.action_space.sample()
    if Path(given).suffix != ".py":
        raise ConfigError(
            f"--policy {given}: expected random or a .py file with policy(observation)"
        )
    if not Path(given).is_file():
        raise ConfigError(f"--policy {given}: there is no such file")
    try:
        found = runpy.run_path(given).get("policy")
    except (Exception, SystemExit) as error:  # a user's own code
        raise ConfigError(f"--policy {given} fails: {with_place(error)}") from error
    if not callable(found):
        raise ConfigError(f"--policy {given} has no function policy(observation)")
    made: Policy = found
    return made


def _told(path: Path, system: System, table: pd.DataFrame) -> str:
    """Return a summary of the recording and the command that learns from it."""
    times = table.groupby("trajectory").t
    h, sizes = float(times.diff().median()), times.size()
    names, turns = system.coordinates.names, system.coordinates.angular
    angles = list(itertools.compress(names, turns))
    angular = {0: "none", len(names): "all"}.get(len(angles), f"[{','.join(angles)}]")
    matrix = str(system.input_matrix.tolist()).replace(" ", "")
    nodes = int(sizes.median())
    short = nodes < FEW or (nodes - 1) * h < SHORT
    warning = (
        f"warning: the median episode has {nodes} nodes ({(nodes - 1) * h:.2g} s), too short to "
        f"learn from: {FEW} nodes and {SHORT:g} s are the least; take more --steps, or a --policy "
        "that keeps the environment from ending the episode\n"
    )
    return (
        f"{path}: {counted(len(sizes), 'trajectory')}, {len(table)} rows, a node every {h:g} s\n"
        + warning * short
        + python_command(
            "symo_exp", "data=recorded", f"data.path={override_value(path)}", "system=recorded",
            f"system.angular={angular}", f"system.time_step={h:g}",
            f"system.input_matrix={matrix}", "preset=recorded",
        )
    )  # fmt: skip
