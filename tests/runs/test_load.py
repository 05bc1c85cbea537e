"""A trained model is loaded in another process, from a folder or a run id; nothing else is."""

import copy
import shutil
import subprocess
import sys

import pytest
import torch
import yaml

import symo_exp
from symo_exp.data.base import Once
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Windows
from symo_exp.runs.folder import CHECKPOINT, POSTERIOR, PREVIOUS, About, RunFolder
from symo_exp.runs.instances import arguments_of, instance_of
from symo_exp.runs.load import copy_weights
from symo_exp.tracking.load import load
from symo_exp.tracking.publish import MlflowView
from symo_exp.training.learner import Learner
from symo_exp.use.environments import environment
from tests.tables import stated
from tests.tiny import copy_store
from tests.trainers import quiet_trainer
from tests.training.test_resume import DAMAGE

SYSTEMS = {
    "pendulum": stated("pendulum") | {"mass": 1.5},
    "acrobot": stated("acrobot"),
}
EXPLICIT = {"_target_": "symo_exp.mechanics.explicit.RK4"}
VARIATIONAL = {"_target_": "symo_exp.mechanics.variational.VariationalMidpoint"}
ROOT = {"_target_": "symo_exp.mechanics.roots.Newton", "tolerance": 1e-5, "max_iterations": 10}
NET = {"_target_": "symo_exp.nets.mlp.MLP", "_partial_": True, "width": 8, "depth": 2}
LAGRANGIAN = {
    "_target_": "symo_exp.nets.lagrangians.NetworkLagrangian", "_partial_": True, "width": 8,
}  # fmt: skip
BY_ROOTS = {"lagrangian": LAGRANGIAN, "integrator": VARIATIONAL, "root": ROOT}
MODELS = {
    "node": {"_target_": "symo_exp.models.node.NODE", "net": NET, "integrator": EXPLICIT},
    "l_node": {
        "_target_": "symo_exp.models.l_node.LNODE", "lagrangian": LAGRANGIAN,
        "integrator": EXPLICIT,
    },
    "symo": {"_target_": "symo_exp.models.symo.SyMo", **BY_ROOTS},
    "e2e_symo": {"_target_": "symo_exp.models.e2e_symo.E2ESyMo", **BY_ROOTS},
}  # fmt: skip


def config(model="symo", system="pendulum"):
    return copy.deepcopy({"system": SYSTEMS[system], "model": MODELS[model]})


def made(folder, settings):
    """A run folder as a short training leaves it, and the model that was trained."""
    system = instance_of(settings["system"])
    model = instance_of(settings["model"], **arguments_of(system))
    n, m = system.input_matrix.shape
    samples = Windows(*(0.1 * torch.randn(4, k) for k in (n, n, n, n, n, m, m, m)))
    trainer = quiet_trainer(2, folder)
    learner = Learner(model, optimizer=lambda p: torch.optim.Adam(p, lr=1e-3))
    trainer.fit(learner, train_dataloaders=Once(lambda: [samples]))
    RunFolder(folder).write_config(settings)
    trainer.save_checkpoint(folder / CHECKPOINT)
    return model.eval()


def published(path, directory):
    """The id of the run that a store has of a finished folder."""
    folder = RunFolder(path)
    folder.describe(About("r", {}))
    folder.record("finished")
    MlflowView(experiment="e", directory=directory).publish(folder)
    return folder.published()["run_id"]


def motion(model, n, m):
    q0 = torch.linspace(0.1, 0.4, 2 * n).view(2, n).to(model.input_matrix)
    u = torch.linspace(-1, 1, 2 * 4 * m).view(2, 4, m).to(model.input_matrix)
    return model.rollout(q0, -q0, u)


@pytest.fixture(scope="module")
def directory(tmp_path_factory, database):
    """The tracking store."""
    place = tmp_path_factory.mktemp("place")
    copy_store(database, place)
    return place / "mlruns"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    return tmp_path / "run"


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("model", MODELS)
def test_the_same_model_comes_back(folder, model, system):
    trained = made(folder, config(model, system))
    n, m = trained.input_matrix.shape
    back = load(folder)
    assert not back.training
    starts = [environment(given, 2).reset(seed=0)[0] for given in (back, folder, str(folder))]
    assert all((start == starts[0]).all() for start in starts)
    assert starts[0].shape == (2, 2 * n)
    assert torch.equal(motion(trained, n, m).q, motion(back, n, m).q)
    assert torch.equal(motion(trained, n, m).v, motion(back, n, m).v)


def test_a_model_is_loaded_in_another_process_by_folder_and_by_id(folder, tmp_path, directory):
    expected = motion(made(folder, config()), 1, 1).q
    run_id = published(folder, directory)
    code = (
        "import sys, symo_exp\n"
        "assert 'torch' not in sys.modules\n"
        "run, directory, out = sys.argv[1:]\n"
        "a, b = symo_exp.load(run, directory=directory), symo_exp.load('run')\n"
        "import torch\n"
        "q0 = torch.linspace(0.1, 0.4, 2).view(2, 1)\n"
        "u = torch.linspace(-1, 1, 8).view(2, 4, 1)\n"
        "torch.save([x.rollout(q0, -q0, u).q for x in (a, b)], out)"
    )
    arguments = [run_id, str(directory), str(tmp_path / "q.pt")]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for found in torch.load(tmp_path / "q.pt"):
        assert torch.equal(found, expected)


def test_double_precision_keeps_the_weights_and_does_not_round_the_input_matrix(folder):
    trained = made(folder, config("node"))
    back = load(folder, dtype=torch.float64)
    assert {p.dtype for p in back.parameters()} == {torch.float64}
    for mine, theirs in zip(trained.parameters(), back.parameters(), strict=True):
        assert torch.equal(mine.double(), theirs)
    assert torch.allclose(motion(trained, 1, 1).q.double(), motion(back, 1, 1).q, atol=1e-5)


def test_a_model_that_was_loaded_in_inference_mode_can_be_linearized(folder):
    trained = made(folder, config())
    with torch.inference_mode():
        back = load(folder)
    assert torch.equal(back.linearize([0.1], [0.2]).A, trained.linearize([0.1], [0.2]).A)


def test_the_package_exports_load(folder):
    made(folder, config())
    # the function, whatever module was imported before
    assert callable(symo_exp.load)
    assert symo_exp.load(folder).time_step == 0.1
    assert {"load", "__version__"} <= set(dir(symo_exp))
    assert symo_exp.__version__[0].isdigit()
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        symo_exp.lod  # noqa: B018


def sentence(folder, **options):
    with pytest.raises(ConfigError) as caught:
        load(folder, **options)
    return str(caught.value)


def edited(folder, change):
    made(folder, config())
    settings = config()
    change(settings)
    (folder / "config.yaml").write_text(yaml.safe_dump(settings))
    return sentence(folder)


HARM = {"_target_": "os.mkdir", "path": "harm"}
DETOUR = "symo_exp.systems.mujoco_library.os.mkdir"


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda c: c["model"].update(root=HARM), "os.mkdir is refused"),
        (lambda c: c["model"].update(_target_="subprocess.run"), "subprocess.run is refused"),
        (lambda c: c["model"].update(fallback=[{"deep": HARM}]), "os.mkdir is refused"),
        (lambda c: c["system"].update(HARM), "os.mkdir is refused"),
        (lambda c: c["model"].update(root={**HARM, "_target_": DETOUR}), "os.mkdir is refused"),
        (
            lambda c: c["model"].update(root={"_target_": "symo_exp.mechanics.lagrangian.matvec"}),
            "matvec is refused",
        ),
        (
            lambda c: c["model"].update(root={"_target_": "torch.hub.load", "repo": "x"}),
            "torch.hub.load is refused",
        ),
        (lambda c: c["model"].update(_target_=["os.mkdir"]), "['os.mkdir'] is refused"),
        (
            lambda c: c["model"].update(_target_="symo_exp.models.nothing.Here"),
            "has no attribute 'nothing'",
        ),
        (
            lambda c: c["model"].update(root="${oc.create:{_target_: os.mkdir, path: harm}}"),
            "contains an unresolved setting",
        ),
        (lambda c: c.pop("model"), "it has no model"),
        (lambda c: c.update(system=3), "it has no system"),
    ],
)
def test_a_configuration_runs_nothing_but_models(folder, change, wanted, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert wanted in edited(folder, change)
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize("part", ["system", "model"])
def test_settings_that_another_version_has_are_named(folder, part):
    said = edited(folder, lambda c: c[part].update(later=1))
    assert "config.yaml does not fit this version of symo_exp: " in said
    assert "'later'" in said


def test_weights_of_another_shape_are_refused(folder):
    assert "does not fit" in edited(folder, lambda c: c["model"]["lagrangian"].update(width=9))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weights_are_copied_to_another_model_in_its_own_precision(dtype, folder):
    trained = made(folder, config())
    system = instance_of(SYSTEMS["pendulum"])
    other = instance_of(MODELS["symo"], **arguments_of(system)).to(dtype)
    copy_weights(other, folder)
    for one, copied in zip(trained.parameters(), other.parameters(), strict=True):
        assert copied.dtype == dtype
        torch.testing.assert_close(copied, one.to(dtype), rtol=0, atol=0)


@pytest.mark.parametrize(("model", "system"), [("node", "pendulum"), ("symo", "acrobot")])
def test_weights_of_another_model_are_not_copied(model, system, folder):
    made(folder, config())
    other = instance_of(MODELS[model], **arguments_of(instance_of(SYSTEMS[system])))
    before = [p.detach().clone() for p in other.parameters()]
    with pytest.raises(ConfigError, match="is a run of a model with other parameters"):
        copy_weights(other, folder)
    assert all(torch.equal(p, q) for p, q in zip(other.parameters(), before, strict=True))


def test_a_model_that_is_not_learned_needs_no_weights(folder):
    """The true system as a model: its configuration is all of it."""
    system = SYSTEMS["pendulum"]
    truth = {
        "_target_": "symo_exp.models.true.TrueOde", "integrator": EXPLICIT, "lagrangian": system,
    }  # fmt: skip
    RunFolder(folder).write_config({"system": system, "model": truth})
    model, q0 = load(folder), torch.tensor([[0.3]])
    after = model.step(q0, 0.0 * q0)
    assert model.mass_matrix(q0).item() == pytest.approx(1.5 / 3)
    assert model.energy(after.q, after.v).item() == pytest.approx(model.energy(q0, 0.0 * q0).item())
    assert after.v.item() > 0.1


def test_missing_files_of_a_run_are_named(folder, tmp_path):
    assert "no config.yaml" in sentence(folder)
    RunFolder(folder).write_config(config())
    assert "has the run been trained?" in sentence(folder)
    assert "neither a run folder nor" in sentence("no/such/run")
    for given in (None, 3, b"run", [folder]):
        assert sentence(given).startswith(f"load({type(given).__name__}): expected a run, its")
    assert "no config.yaml, but run in it has one" in sentence(folder.parent)
    (folder.parent / "best").symlink_to(folder.name, target_is_directory=True)
    assert sentence(folder.parent).endswith(f"whose best run is {folder.parent / 'best'}")
    assert "no tracking store" in sentence("0" * 32, directory=tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_the_model_of_a_run_that_has_not_finished_comes_with_a_warning(folder, caplog):
    made(folder, config())
    load(folder)  # as downloaded from a store, without a status
    RunFolder(folder).record("finished")
    load(folder)
    assert "has the status" not in caplog.text
    for status in ("interrupted", "waiting", "running", "failed"):
        RunFolder(folder).record(status)
        load(folder)
        assert f"has the status {status!r}" in caplog.text


def test_an_unknown_precision_or_device_is_refused(folder):
    made(folder, config())
    assert "expected torch.float32 or" in sentence(folder, dtype="float32")
    assert "device=gpu cannot be used" in sentence(folder, device="gpu")
    assert "device=3.5 cannot be used" in sentence(folder, device=3.5)


def test_a_store_that_is_no_text_is_refused():
    assert "tracking_uri=5: expected text" in sentence("0" * 32, tracking_uri=5)
    assert "directory(int): expected the folder" in sentence("0" * 32, directory=5)


def test_a_run_without_a_model_in_the_store_is_refused(folder, directory):
    run_id = published(folder, directory)
    assert "has no model" in sentence("0" * 32, directory=directory)
    assert "has no model" in sentence(run_id, directory=directory)


DAMAGES = ["empty", "half", "flipped", "text", "code", "other"]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_is_one_line_and_nothing_is_unpickled(
    folder, damage, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    made(folder, config())
    DAMAGE[damage](folder / CHECKPOINT, monkeypatch)
    assert "last.ckpt" in sentence(folder)
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize("damage", [*DAMAGES, "none there"])
def test_the_checkpoint_before_a_damaged_one_is_loaded_with_a_warning(
    folder, damage, tmp_path, monkeypatch, caplog
):
    monkeypatch.chdir(tmp_path)
    trained, last = made(folder, config()), folder / CHECKPOINT
    shutil.copy(last, last.with_name(PREVIOUS))
    if damage == "none there":
        last.unlink()
    else:
        DAMAGE[damage](last, monkeypatch)
    assert torch.equal(motion(load(folder), 1, 1).q, motion(trained, 1, 1).q)
    (told,) = [line.getMessage() for line in caplog.records if line.name == "symo_exp.runs.load"]
    assert told.startswith(f"{last} is not used: ")
    assert str(last.with_name(PREVIOUS)) in told
    last.with_name(PREVIOUS).write_bytes(b"")
    assert f"{last} is not a readable checkpoint" in sentence(folder)


@pytest.mark.parametrize("damage", ["half", "flipped", "text", "code"])
def test_a_damaged_posterior_is_refused(folder, damage, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made(folder, config())
    RunFolder(folder).write_posterior({"mean": torch.zeros(8)})
    DAMAGE[damage](folder / POSTERIOR, monkeypatch)
    assert "posterior.pt is not a readable posterior: " in sentence(folder)
    assert not (tmp_path / "harm").exists()
