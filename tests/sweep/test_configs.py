"""Every file of the configuration composes, passes the checks and builds what it names."""

import contextlib
import itertools

import pytest
import torch

from symo_exp.cli.help import summary
from symo_exp.errors import ConfigError
from symo_exp.job.parts import build
from symo_exp.runs.folder import RunFolder
from symo_exp.shipped import CONF, SWEEPS
from symo_exp.sweep.compose import expand
from symo_exp.thesis.published import published
from tests.jobs import job_of, jobs_of, params_of, settings_of
from tests.systems.models import PENDULUMS
from tests.tables import choices, known_systems, systems, variational_integrators

GROUPS = {f.parent.name for f in CONF.glob("*/*.yaml")} - {"reference", "model"}
"""But for what is built in every combination below."""
BODIES = {"lagrangian": "rigid_body", "dissipation": "body_drag"}
"""Choices for a machine that turns freely."""
ALONE = {"data", "integrator", "objective", "optimizer", "preset", "system"}
"""Groups whose choices call for others."""
CHOICES = [
    [f"{group}={choice}"]
    for group in sorted(ALONE)
    for choice in choices(group)
    if choice not in (known_systems() if group == "system" else ())
]
FREE = [
    [f"{group}={choice}" for choice in choices(group) if choice not in ("gpu", *BODIES.values())]
    for group in sorted(GROUPS - ALONE)
]
TOGETHER = [[word for word in row if word] for row in itertools.zip_longest(*FREE)]
"""Choices that go with those of other groups, one of each group at a time."""
SHIPPED = [*CONF.rglob("*.yaml"), *SWEEPS.glob("*.yaml")]


def build_all(*argv: str, folder) -> list:
    return [build(job.values, RunFolder(folder / str(i))) for i, job in enumerate(jobs_of(*argv))]


BODY = ["system=rigid_body", *(f"{group}={choice}" for group, choice in BODIES.items())]


@pytest.mark.parametrize("words", [*CHOICES, *TOGETHER, BODY], ids=" ".join)
def test_every_choice_builds(words, workplace):
    (group, _, choice), words = words[0].partition("="), [*words]
    if words == ["system=recorded"]:
        words += ["data=recorded", "system.time_step=0.1", "system.angular=all"]
    if words == ["system=mujoco"]:
        (workplace / "robot.xml").write_text(PENDULUMS)
        words.append("system.model=robot.xml")
    if words == ["system=gymnasium"]:
        pytest.importorskip("imageio")  # Gymnasium's own need
    if "data=recorded" in words:
        rows = [f"{i},{0.1 * k},{0.01 * k * (i + 1)},0" for i in range(3) for k in range(5)]
        (workplace / "mine.csv").write_text("\n".join(["trajectory,t,q_theta,u_0", *rows]))
        words.append("data.path=mine.csv")
    if group == "integrator" and choice not in variational_integrators():
        words.append("model=residual" if choice == "none" else "model=node")
    if group == "optimizer":
        words.append("dtype=float64")  # some need it
    (parts,) = build_all(*words, folder=workplace)
    assert parts.model.coordinates == parts.system.coordinates


def test_a_gpu_that_is_not_there_is_refused(workplace):
    missing = pytest.raises(ConfigError, match="no GPU")
    with contextlib.nullcontext() if torch.cuda.is_available() else missing:
        build_all("trainer=gpu", folder=workplace)


PRESETS = "default", "thesis"
ROTATING = [name for name, system in systems().items() if system.coordinates.rotations]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("model", choices("model"))
def test_every_model_builds_for_every_system(model, preset, workplace):
    """Each by one of the presets, in turn; the adjoint of the thesis takes flat coordinates."""
    turn = choices("model").index(model) + PRESETS.index(preset)
    names = known_systems()[turn % 2 :: 2]
    if preset == "thesis":
        names = [name for name in names if name not in ROTATING]
    words = [f"model={model}", f"preset={preset}", f"system={','.join(names)}"]
    parts = build_all(*words, folder=workplace)
    assert len({type(p.system) for p in parts}) == len(names)


ONE_SWEEP = sorted({f.stem for f in SWEEPS.glob("*.yaml")} - {"thesis", "search", "machine"})
"""Without a list of others and those of other sweepers, which their own tests run."""


@pytest.mark.parametrize("sweep", ONE_SWEEP)
def test_every_sweep_has_jobs_that_pass(sweep, workplace):
    """That of the last values of all that it varies."""
    params = params_of(sweep)
    rows = params.pop("model,integrator", [])
    last = [f"{key}={str(values).rpartition(',')[2]}" for key, values in params.items()]
    last += [f"model={model}" for model, _ in rows[-1:]]
    last += [f"integrator={integrator}" for _, integrator in rows[-1:]]
    job = job_of("-cn", sweep, *last)
    assert set(last) <= set(job.overrides)


PAIRS = {"model,integrator": [["node", "rk4"], ["node", "midpoint"], ["symo", "midpoint"]]}


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ([], ["node rk4", "node midpoint", "symo midpoint"]),
        (["model=node"], ["node rk4", "node midpoint"]),
        (["integrator=midpoint"], ["node midpoint", "symo midpoint"]),
        (["model=symo,node", "integrator=midpoint"], ["symo midpoint", "node midpoint"]),
        (["model=node,l_node", "integrator=rk4"], ["node rk4", "l_node rk4"]),
        (["model=residual"], ["residual"]),
    ],
)
def test_pairs_of_a_sweep_agree_with_the_command_line(typed, expected):
    found = expand(["seed=1", *typed], {"data.n_traj": "8", **PAIRS})
    assert {" ".join(one[:1] + one[-1:]) for one in found} == {"data.n_traj=8 seed=1"}
    middle = [" ".join(word.partition("=")[2] for word in one[1:-1]) for one in found]
    assert middle == expected


@pytest.mark.parametrize("rows", ["node,rk4", [["node"]], ["ab"]])
def test_invalid_pairs_are_refused(rows):
    with pytest.raises(ConfigError, match="rows, each of 2 values"):
        expand([], {"model,integrator": rows})


@pytest.mark.parametrize("sweep", ["data_size", "tables", "noise"])
def test_sweeps_share_their_runs(sweep, workplace):
    """A run at 32 trajectories without noise is one run, in every sweep and typed by hand."""
    jobs = jobs_of("-cn", sweep, "system=pendulum", "model=node", "integrator=rk4", "seed=1")
    typed = "experiment=thesis model=node integrator=rk4 system=pendulum data.n_traj=32 seed=1"
    assert job_of(*typed.split()).folder.path in [job.folder.path for job in jobs]


@pytest.mark.parametrize("file", SHIPPED, ids=lambda f: f"{f.parent.name}/{f.stem}")
def test_every_shipped_file_has_a_summary(file):
    assert summary(file)


def test_thesis_and_default_protocol(workplace):
    """The settings that the thesis states, and the ones in which the default differs from it."""
    words = ["model=e2e_symo", "system=acrobot", "-m", "preset=default,thesis"]
    default, thesis = settings_of(*words)
    for config in default, thesis:
        assert config.net.width == 256
        assert config.trainer.max_epochs == 2000
        assert config.data.batch_size is None
        assert (config.scheduler.patience, config.scheduler.factor) == (50, 0.7)
        assert (config.root.training.tolerance, config.root.training.max_iterations) == (1e-5, 10)
    assert (default.learner.scheduler_monitor, default.data.monitor) == ("train_loss", "val")
    assert (thesis.learner.scheduler_monitor, thesis.data.monitor) == ("val_loss", "test")
    assert thesis.trainer.validate_every == 1
    assert (thesis.root.rollout.tolerance, thesis.root.rollout.max_iterations) == (1e-4, 10)
    assert default.root.rollout.tolerance <= 1e-9
    assert thesis.integrator.sensitivity == "adjoint"
    assert (thesis.data.solver.method, thesis.data.solver.rtol) == ("RK45", 1e-3)
    assert job_of("system=pendulum").values["net"]["width"] == 128


RATES = published()[["system", "noise_std", "learning_rate"]].drop_duplicates()


@pytest.mark.parametrize(("system", "noise_std", "learning_rate"), RATES.to_numpy().tolist())
def test_the_learning_rates_are_the_published_ones(system, noise_std, learning_rate, workplace):
    job = job_of(f"system={system}", f"data.noise_std={noise_std}")
    assert job.values["optimizer"]["lr"] == learning_rate
