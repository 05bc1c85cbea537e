"""Every command on a page, in a docstring or in a printed hint runs as it is written.

``make test-commands`` runs the commands of each page in order, in one folder that is empty but for
what the page says is there: the folders of a copy of the repository and the user's own files. Long
runs take a short form, by the table ``SHORT``, which changes budgets only. Commands in ``NOT_RUN``
need what a test does not have.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from symo_exp.systems.simulation import Solver, simulate
from tests import pages
from tests.pages import PAGES, ROOT, SOURCES, Command
from tests.systems import models

NOT_RUN = {
    "submitit_slurm": "needs SLURM: `make test-slurm`",
    "http://SERVER": "needs a tracking server: `make test-server`",
    "sudo -u postgres": "needs PostgreSQL: `make test-server`",
    "mlflow server": "runs until it is stopped",
    "python -m venv": "installs: `.ci/run` does it",
    ".ci/run": "runs this test's own suite",
    "-m pip install": "installs: `.ci/run` does it",
    "-m benchmarks": "takes the machine for itself for minutes to an hour, to measure it",
    "results/hardware/refit.py": "takes half an hour and has no budget to cut",
    "results/rivals/run.py": "needs the packages of `make rivals` in an environment of their own",
    "results/growth/whips.py": "needs a run of seven links, which takes minutes",
    "results/rivals/inverse_dynamics.py": "needs the packages of `make rivals`, and a recording",
    "results/uncertainty/coverage.py": "takes minutes to an hour and has no budget to cut",
    "results/uncertainty/recordings.py": "needs a run with a posterior, which takes minutes",
    "import drifts": "takes ten minutes for each order",
    "results/machines/drift.py": "needs a recording that is not in this repository",
    "[SETTING=VALUE ...] RUN": "results/noise/README.md gives it with runs",
    "results/thesis/draws.py": "simulates 256 long trajectories; tests/test_results.py runs it",
}
"""Parts of commands that are not run here, and why."""

SHORT = [
    # epochs; of simulated data: trajectories and steps of rollouts; of searches: trials
    (r"-m symo_exp (?!record)(?!.*-cn machine)", "trainer.max_epochs=2 trainer.validate_every=1"),
    (r"-m symo_exp (?!record)(?!.*(data=(?!simulated)|-cn machine|draws=published|preset=thesis))",
     "data.n_traj=8 data.n_train_max=8 data.n_val=4 data.n_test=4 data.n_integration=2 "
     "data.integration_steps=30 data.monitor_trajectories=null"),
    (r"-cn search|hydra/sweeper=optuna", "hydra.sweeper.n_trials=2"),
    (r"-cn machine", "budget=90s"),
]  # fmt: skip
"""Settings appended to a command in which the pattern is found.

Of a list of numbers or systems to sweep, only the first stays.
"""

PRELUDE = {
    "README.md": "import torch; q0 = v0 = torch.ones(4, 1)",
    "docs/use.md": """
import torch, symo_exp
model = symo_exp.load("outputs/default/symo-pendulum-0123456789")
q_prev = q = q_next = torch.zeros(4, 1)
v = u = u_next = torch.ones(4, 1)
""",
    "docs/uncertainty.md": """
import symo_exp
run = symo_exp.run("model=symo", "preset=rigid", "lagrangian=known", "system=pendulum",
                   "lagrangian.fixed=[gravity]", "data.n_traj=4", "pictures=false").folder
q, v, u = [1.0], [0.0], [[0.0]] * 11
""",
}
"""Names that the Python code of a page takes for granted."""

SHORT_PYTHON = """
import symo_exp
_run = symo_exp.run
symo_exp.run = lambda *words: _run(*words, "trainer.max_epochs=2", "trainer.validate_every=1")
"""

ARM = """<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="1"/>
      <body name="lower" pos="0 0 -0.5">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" ctrlrange="-1 1"/>
    <motor joint="elbow" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""
CONTROLLER = "import numpy as np\n\n\ndef policy(observation):\n    return 0.1 * np.ones(2)\n"
HINT = re.compile(r"(?:\S*/)?python\S* -m symo_exp[.\w]*(?: [^\n]*)?")
FORMS = {
    "SYSTEM ...": "pendulum",
    "MACHINE...": "motor_pendulum",
    "METHOD": "e2e_symo",
    "RUN": "outputs/default/symo-recorded-0123456789",
    "FILE": "file",
    "record ENV": "record Swimmer-v5 --episodes 4 --steps 50",
    "symo_exp WORDS": "symo_exp model=symo",
}
"""Words in capitals that stand for the reader's own."""


def on_pages() -> Iterator[Command]:
    """All commands of pages and sources."""
    for page in PAGES:
        yield from pages.typed(page)
    for source in SOURCES:
        yield from pages.told(source)


EVERY = list(on_pages())


def reason(line: str) -> str | None:
    """Return the reason why a command is not run, ``None`` if it is."""
    return next((why for part, why in NOT_RUN.items() if part in line), None)


def test_pages_have_commands():
    assert len({c.page for c in EVERY}) > 20
    assert len(EVERY) > 120


@pytest.mark.parametrize("part", NOT_RUN)
def test_commands_that_are_not_run_are_on_a_page(part):
    assert any(part in command.line for command in EVERY)


TARGETS = sorted({c.line.split()[1] for c in EVERY if c.line.startswith("make ")})


@pytest.mark.parametrize("target", TARGETS)
def test_a_make_target_exists(target):
    subprocess.run(["make", "--dry-run", target], cwd=ROOT, check=True, capture_output=True)


def test_extras_that_pages_name_exist():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for command in EVERY:
        for extra in re.findall(r"symo_exp\[(\w+)\]", command.line):
            assert re.search(rf"^{extra} = \[", text, flags=re.M), command


@pytest.fixture(scope="session")
def home(tmp_path_factory):
    """The home of a user who has just come."""
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="session")
def trained(tmp_path_factory, home):
    """Runs in the place of those whose folders pages name."""
    place = tmp_path_factory.mktemp("trained")
    write_log(place / "mine.csv")
    simulated = "model=symo system=pendulum dissipation=viscous net.width=8"
    recorded = (
        "data=recorded data.path=mine.csv system=recorded system.angular=all system.time_step=0.02 "
        "preset=recorded reference=free_single_pendulum"
    )
    turning = "preset=fast model=symo system=rigid_body lagrangian=rigid_body data.n_traj=4"
    named = {"pendulum": simulated, "recorded": recorded, "rigid_body": turning}
    for name, words in named.items():
        words += f" logger=none pictures=false {SHORT[0][1]}"
        done = shell(f"python -m symo_exp {words}", place, home)
        assert done.returncode == 0, done.stdout + done.stderr
        (folder,) = (place / "outputs" / "default").glob(f"symo-{name}-*")
        folder.rename(folder.with_name(f"symo-{name}-0123456789"))
    shutil.copytree(place / "outputs" / "default", place / "outputs" / "demo")
    return place / "outputs"


@pytest.fixture
def folder(tmp_path, trained):
    """A copy of the repository with files of a reader's own and a run."""
    for name in ("recordings", "examples", "benchmarks"):
        (tmp_path / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "results", tmp_path / "results")
    shutil.copytree(trained, tmp_path / "outputs")
    write_log(tmp_path / "mine.csv")
    write_log_of_arm(tmp_path / "log.csv")
    write_flight(tmp_path / "flight.csv")
    write_archives(tmp_path)
    write_nanobench(tmp_path / "nanobench.parquet")
    for name in ("arm.xml", "robot.xml"):
        (tmp_path / name).write_text(ARM)
    (tmp_path / "controller.py").write_text(CONTROLLER)
    return tmp_path


def write_log(file: Path) -> None:
    """Write motions of a pendulum with friction, every 0.02 s."""
    rows, h = [], 0.02
    for trajectory in range(6):
        q, v = 0.3 + 0.3 * trajectory, 0.0
        for k in range(150):
            rows.append({"trajectory": trajectory, "t": h * k, "q_theta": q})
            for _ in range(20):
                v += h / 20 * (-9.8 * np.sin(q) - 0.2 * v)
                q += h / 20 * v
    noise = np.random.default_rng(0).normal(scale=1e-4, size=len(rows))
    pd.DataFrame(rows).assign(q_theta=lambda table: table.q_theta + noise).to_csv(file, index=False)


def write_log_of_arm(file: Path) -> None:
    """Write motions of ``ARM`` with friction, every 0.02 s."""
    arm = models.read(ARM, time_step=0.02, viscous=(0.2, 0.2))
    path = simulate(arm, *arm.box.points(6, 1), 150, Solver())
    noise = np.random.default_rng(0).normal(scale=1e-4, size=path.q.shape)
    rows = [
        {
            "trajectory": k,
            "t": 0.02 * i,
            "q_shoulder": a,
            "q_elbow": b,
            "u_shoulder": c,
            "u_elbow": d,
        }
        for k, (angles, torques) in enumerate(
            zip(path.q.numpy() + noise, path.u.numpy(), strict=True)
        )
        for i, ((a, b), (c, d)) in enumerate(zip(angles, torques, strict=True))
    ]
    pd.DataFrame(rows).to_csv(file, index=False)


def write_flight(file: Path) -> None:
    """Write flights of a body that turns about its vertical axis under a torque, every 0.02 s."""
    random, t = np.random.default_rng(0), 0.02 * np.arange(60)
    flights = []
    for trajectory in range(6):
        speed, torque = random.normal(size=(3, 1)), random.normal()
        x, y, z = speed * t - 0.5 * 9.81 * np.array([[0.0], [0.0], [1.0]]) * t**2
        half = 0.5 * (2.0 * t + 0.5 * torque * t**2)
        flights.append(pd.DataFrame({
            "trajectory": trajectory, "t": t, "q_x": x, "q_y": y, "q_z": z, "q_R_w": np.cos(half),
            "q_R_x": 0.0, "q_R_y": 0.0, "q_R_z": np.sin(half), "u_yaw": torque,
        }))  # fmt: skip
    pd.concat(flights).to_csv(file, index=False)


def write_archives(place: Path) -> None:
    """Write motions in the layout of SE3HamDL: turning about z, and rising without turning."""
    random = np.random.default_rng(0)
    for name, h, nodes, flat in (("pendulum", 0.05, 20, 0), ("quadrotor", 1 / 240, 5, 3)):
        t, arrays = h * np.arange(nodes)[:, None], {}
        for part in ("x", "test_x"):
            u = random.normal(size=(2, 1, 16))
            turn = np.zeros((2, nodes, 16, 3, 3))
            theta = 0.0 * u * t if flat else 0.5 * u * t**2 + random.normal(size=(2, 1, 16))
            turn[..., 0, 0] = turn[..., 1, 1] = np.cos(theta)
            turn[..., 1, 0], turn[..., 0, 1], turn[..., 2, 2] = np.sin(theta), -np.sin(theta), 1.0
            x, v, w = (
                np.zeros((2, nodes, 16, flat)),
                np.zeros((2, nodes, 16, flat)),
                0.0 * turn[..., 0],
            )
            controls = np.zeros((2, nodes, 16, 4 if flat else 1))
            controls[..., 0] = u
            if flat:
                x[..., 2], v[..., 2] = 1.0 + 0.5 * u * t * (t + h), u * t
            else:
                w[..., 2] = u * t
            arrays[part] = np.concatenate(
                (x, turn.reshape(*w.shape[:3], 9), v, w, controls), axis=3
            )
        np.savez(place / f"se3hamdl_{name}.npz", t=t[:, 0], **arrays)


def write_nanobench(file: Path) -> None:
    """Write flights in the layout of NanoBench: up and down without turning, every 0.01 s."""
    t, flights = 0.01 * np.arange(400), []
    for k, part in enumerate(("train", "train", "val", "test")):
        rate = 4.0 + k
        columns = {"trajectory": f"flight{k}", "split": part, "t": t, "vbat": 3.7, "quat_w": 1.0}
        columns |= dict.fromkeys(("p_x", "p_y", "quat_x", "quat_y", "quat_z", "v_x", "v_y"), 0.0)
        columns |= dict.fromkeys(("w_x", "w_y", "w_z"), 0.0)
        columns |= {"p_z": 1.0 + 0.2 * np.sin(rate * t), "v_z": 0.2 * rate * np.cos(rate * t)}
        force = 1.0 - 0.2 * rate**2 * np.sin(rate * t) / 9.81
        columns |= {f"u_{i}": 40000.0 * np.sqrt(force) for i in range(1, 5)}
        flights.append(pd.DataFrame(columns))
    pd.concat(flights).to_parquet(file, index=False)


def shell(line: str, place: Path, home: Path) -> subprocess.CompletedProcess[str]:
    """Run a line as typed in a terminal of the environment."""
    keep = {k: os.environ[k] for k in ("LANG", "TMPDIR", "OMP_NUM_THREADS") if k in os.environ}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", line], cwd=place, env={**keep, "HOME": str(home), "PATH": path},
        capture_output=True, text=True, timeout=1800,
    )  # fmt: skip


def shortened(line: str) -> str:
    """The short form of a command."""
    line = re.sub(r" \[--[^]]*\]", "", line)  # options that a docstring leaves open
    for form, own in FORMS.items():
        line = line.replace(form, own)
    line, *into = line.split(" > ")
    information = {"-h", "--help", "--cfg", "--version", "--info"} & set(line.split())
    if re.search(r"-m symo_exp( |$)", line) and not information:
        words = [first_number(word) for word in line.split(" ")]
        found = [settings for pattern, settings in SHORT if re.search(pattern, f"{line} ")]
        more = " ".join(found).split()
        more += [word for word in swept(line) if not keys([word]) & keys([*words, *more])]
        line = " ".join([*(word for word in words if not keys([word]) & keys(more)), *more])
    if "results/hardware/by_hand.sh" in line:
        line = re.sub(r"^SETTINGS=\S+ ", "", re.sub(r" \d[\d,]* ", " 0 ", line))
        line = f"SETTINGS='{SHORT[0][1]}' {line}"
    if re.search("results/(machines|hardware)/run.sh", line):
        line = "results/machines/run.sh 20s 0 recordings/motor_pendulum.parquet"
    return " > ".join([line, *into])


def keys(words: list[str]) -> set[str]:
    """The settings that words give."""
    return {word.partition("=")[0] for word in words if "=" in word}


def first_number(word: str) -> str:
    """``seed=0,1,2`` is ``seed=0``, as with systems; other names are all kept."""
    key, equals, values = word.partition("=")
    several = re.fullmatch(r"[-+.\de]+(,[-+.\de]+)+", values) or key == "system"
    return f"{key}={values.split(',')[0]}" if equals and several else word


def swept(line: str) -> list[str]:
    """The first of the numbers that a kept sweep goes through."""
    name = re.search(r"-cn (\w+)", line)
    file = ROOT / "sweeps" / f"{name.group(1)}.yaml" if name else None
    if file is None or "-cn search" in line:
        return []
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    params = content.get("hydra", {}).get("sweeper", {}).get("params", {})
    cut = {key: first_number(f"{key}={values}") for key, values in params.items()}
    return [word for key, word in cut.items() if word != f"{key}={params[key]}"]


def recipe(line: str) -> list[str]:
    """The runs that a make target starts; the rest of a target is for `.ci/run`."""
    done = subprocess.run(
        ["make", "--dry-run", *line.split()[1:2]], cwd=ROOT, capture_output=True, text=True
    )
    found = re.findall(r"python (-m symo_exp .*)$", done.stdout, flags=re.M)
    return [f"python {words}" for words in found]


def hints(output: str) -> list[str]:
    """The commands that a command prints."""
    found = []
    for line in output.splitlines():
        for hint in HINT.findall(line):
            hint = re.sub(r"(\. [A-Z]| \(| {2,}|; ).*", "", hint).rstrip(".`")
            found.append(re.sub(r"^\S*python\S*", "python", hint))
    return found


def failures(lines: list[str], place: Path, home: Path) -> list[str]:
    """Run lines in order, each followed by the commands that it prints; return the failures."""
    failed, done = [], set()
    queue = list(lines)
    while queue:
        line = queue.pop(0)
        if line in done or reason(line) or line.startswith("pip install"):
            continue
        done.add(line)
        if line.startswith("make "):
            queue[:0] = recipe(line)
            continue
        if line == ". .venv/bin/activate":
            continue  # its effect is the PATH of `shell`
        result = shell(shortened(line), place, home)
        output = result.stdout + result.stderr
        print(f"$ {shortened(line)}\n{output}")
        if result.returncode or "Traceback" in output:
            failed.append(f"{line}\n    {shortened(line)}\n{output[-1500:]}")
        elif not {"-h", "--help"} & set(line.split()):
            queue[:0] = hints(output)
    return failed


@pytest.mark.commands
@pytest.mark.parametrize("page", [p for p in PAGES if pages.typed(p)], ids=pages.relative)
def test_commands_of_a_page(page, folder, home):
    for path, content in pages.files(page).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(content)
    found = failures([command.line for command in pages.typed(page)], folder, home)
    assert not found, "\n\n".join(found)


ON_PAGES = {command.line for command in EVERY if command.page.endswith(".md")}
IN_SOURCES = [command for command in EVERY if not command.page.endswith(".md")]


@pytest.mark.commands
@pytest.mark.parametrize("command", [c for c in IN_SOURCES if c.line not in ON_PAGES], ids=str)
def test_a_command_in_a_source(command, folder, home):
    found = failures([command.line], folder, home)
    assert not found, "\n\n".join(found)


@pytest.mark.commands
@pytest.mark.parametrize(
    "page",
    [p for p in [*PAGES, ROOT / "docs" / "tutorial.ipynb"] if pages.python(p)],
    ids=pages.relative,
)
def test_python_of_a_page(page, folder, home):
    short = SHORT_PYTHON if page.suffix == ".md" else ""  # the tutorial tells what comes out
    code = "\n".join([short, PRELUDE.get(pages.relative(page), ""), pages.python(page)])
    (folder / "page.py").write_text(code)
    done = shell("MPLBACKEND=agg python page.py", folder, home)
    assert done.returncode == 0, done.stdout + done.stderr
