"""Swing a pole up with a model learned from a few trajectories.

Record short motions of the true system under constant inputs, learn a model, plan on the model,
follow the plan and hold the upright position. All gains come from ``model.linearize``. The
controller is tested in the true environment; it has seen only the recorded motions of it::

    python examples/swing_up.py --system cartpole --seed 0 --model symo --animation cartpole.webp
    python examples/swing_up.py --table results/control  # both systems, three methods, ten seeds
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from PIL import Image
from planning import Plan, Planner

import symo_exp

HORIZON, DURATION = 8.0, 25.0
"""Duration of the plan and of the trial [s]."""
BY, NEAR = 10.0, 0.1
"""Upright means: all angles are within ``NEAR`` [rad] of the goal from the time ``BY`` [s] on."""
LEARN = {
    "symo": ["model=symo"],
    "node": ["model=node", "integrator=dopri5", "objective=plain"],
    "l_node": ["model=l_node", "integrator=dopri5", "objective=plain"],
}
SEEDS = range(10)


class Task(NamedTuple):
    """A swing-up: states ``(q, v)`` and costs per second, in SI units."""

    start: tuple[float, ...]
    goal: tuple[float, ...]
    trajectories: int
    limit: float
    """Bound of the input, in the recorded motions and in the trial [N or N m]."""
    running: tuple[float, ...]
    effort: float
    final: tuple[float, ...]
    """Final cost of the first plan; that of the second comes from LQR."""
    iterations: tuple[int, int]


TASKS = {
    "cartpole": Task(
        (0.0, np.pi, 0.0, 0.0), (0.0,) * 4, 8, 2.0,
        (1.0, 0.1, 0.1, 0.1), 0.1, (100.0,) * 4, (40, 20),
    ),
    "acrobot": Task(
        (0.0,) * 4, (np.pi, 0.0, 0.0, 0.0), 32, 5.0,
        (0.1, 0.1, 0.1, 0.1), 0.02, (100.0, 100.0, 10.0, 10.0), (60, 60),
    ),
}  # fmt: skip


class Trial(NamedTuple):
    """A row of the table."""

    system: str
    model: str
    seed: int
    success: bool
    upright: float
    """Time from which the system was upright [s]; infinite if it was not upright at the end."""
    deviation: float
    """Largest deviation of a coordinate from the plan [rad or m]."""
    reach: float
    """Largest displacement of a coordinate that is not an angle [m]; 0 without one."""
    learned: float
    planned: float
    """Time of learning and planning [s]; learning is 0 if the run existed."""

    def line(self) -> str:
        ends = f"upright from {self.upright:.1f} s" if self.success else "not upright"
        moved = f", moved by {self.reach:.2f} m" if self.reach else ""
        return (
            f"{self.system} {self.model} seed {self.seed}: {ends}, {self.deviation:.1e} off the "
            f"plan{moved}; learned in {self.learned:.0f} s, planned in {self.planned:.0f} s"
        )


def learn(system: str, method: str, seed: int) -> symo_exp.Run:
    """Learn a model from short motions of the true system."""
    task = TASKS[system]
    run = symo_exp.run(
        *LEARN[method], f"system={system}", f"seed={seed}", "preset=fast", "experiment=swing_up",
        f"data.n_traj={task.trajectories}", f"system.box.u=[[-{task.limit},{task.limit}]]",
        "logger=none", "pictures=false", "data.n_integration=2",
    )  # fmt: skip
    assert isinstance(run, symo_exp.Run)
    return run


def plan(model: Any, task: Task) -> tuple[Planner, Plan]:
    """Plan in two stages: first to the goal, then so that LQR can hold it there."""
    start, goal, running, final = (
        torch.tensor(x, dtype=torch.float64)
        for x in (task.start, task.goal, task.running, task.final)
    )
    planner = Planner(
        model, start, goal, steps=round(HORIZON / model.time_step), limit=task.limit,
        running=running, effort=task.effort,
    )  # fmt: skip
    first, second = task.iterations
    rough = planner.improve(None, torch.diag(final), first)
    return planner, planner.improve(rough, planner.hold()[1], second)


def drive(env: Any, planner: Planner, planned: Plan) -> tuple[np.ndarray, list[Any]]:
    """Return the states (nodes, 2n) of a trial in the true environment, and its pictures."""
    hold, value = planner.hold()
    gains = planner.follow(planned, value)
    start = planner.start.split(planner.n)
    x, _ = env.reset(options={"q": start[0].numpy(), "v": start[1].numpy()})
    states, frames = [x], [env.render()]
    for k in range(round(DURATION / planner.model.time_step)):
        now = torch.from_numpy(x)
        if k < len(gains):
            u = planned.u[k] - gains[k] @ (now - planned.x[k])
        else:
            u = -hold @ (now - planner.goal)
        x, *_ = env.step(u.numpy())
        states.append(x)
        frames.append(env.render())
    return np.stack(states), frames


def trial(system: str, method: str, seed: int, animation: Path | None = None) -> Trial:
    """Learn, plan and test."""
    begun = time.perf_counter()
    run = learn(system, method, seed)
    learned = time.perf_counter()
    model = run.model.for_evaluation()
    symo_exp.compile_rollout(model)
    try:
        planner, planned = plan(model, TASKS[system])
    except np.linalg.LinAlgError:  # LQR cannot hold the goal of this model
        took = time.perf_counter() - learned
        return Trial(system, method, seed, False, np.inf, np.inf, 0.0, learned - begun, took)
    took = time.perf_counter() - learned
    env = symo_exp.environment(run.model.system, render_mode="rgb_array" if animation else None)
    states, frames = drive(env, planner, planned)
    if animation is not None:
        pictures = [Image.fromarray(frame).resize((240, 240)) for frame in frames[::2]]
        pause = round(2000 * model.time_step)
        pictures[0].save(animation, save_all=True, append_images=pictures[1:], duration=pause)
    angular = np.array(model.coordinates.angular)
    q = states[:, : planner.n]
    off = np.abs(q - planner.goal[: planner.n].numpy())[:, angular].max(1)
    late = np.flatnonzero(off > NEAR)[-1:] + 1  # first node after the last deviation
    upright = float(late[0] * model.time_step) if late[0] < len(off) else np.inf
    deviation = np.abs(q[: len(planned.x)] - planned.x[:, : planner.n].numpy()).max()
    reach = np.abs(q[:, ~angular]).max(initial=0.0)
    return Trial(
        system, method, seed, upright <= BY, upright, float(deviation), float(reach),
        learned - begun, took,
    )  # fmt: skip


def table(folder: Path) -> str:
    """Run the trials that are missing in ``runs.csv``, and return a table of all trials."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "runs.csv"
    done = pd.read_csv(file) if file.exists() else pd.DataFrame(columns=list(Trial._fields))
    known = set(zip(done.system, done.model, done.seed, strict=True))
    for system, method, seed in itertools.product(TASKS, LEARN, SEEDS):
        if (system, method, seed) not in known:
            first = folder / f"{system}.webp" if (method, seed) == ("symo", 0) else None
            found = trial(system, method, seed, first)
            print(found.line(), flush=True)
            done = pd.concat([done, pd.DataFrame([found])], ignore_index=True)
            done.to_csv(file, index=False)
    lines = [
        "| | | upright | deviation from plan, median | learning | planning |",
        "|---|---|---|---|---|---|",
    ]
    for (system, method), rows in done.groupby(["system", "model"], sort=False):
        lines.append(
            f"| {system} | {method} | {int(rows.success.sum())} of {len(rows)} "
            f"| {rows.deviation.median():.1e} | {rows.learned.median():.0f} s "
            f"| {rows.planned.median():.0f} s |"
        )
    (folder / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--system", choices=TASKS, default="cartpole", help="default: %(default)s")
    parser.add_argument(
        "--model", choices=LEARN, default="symo", help="method; default: %(default)s"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of recordings and weights; default: %(default)s"
    )
    parser.add_argument("--animation", type=Path, help="file to write, .webp or .gif")
    parser.add_argument("--table", type=Path, help="run all trials; folder of their table")
    given = parser.parse_args()
    if given.seed < 0:
        parser.error(f"--seed {given.seed}: expected a whole number of at least 0")
    if given.table is not None:
        print(table(given.table))
    else:
        print(trial(given.system, given.model, given.seed, given.animation).line())


if __name__ == "__main__":
    main()
