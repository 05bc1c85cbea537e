"""A resumed training ends with the same bits, whatever files are left."""

import os
import shutil
import signal
import zipfile
from contextlib import nullcontext
from unittest import mock

import pytest
import torch

import symo_exp
from symo_exp.process import stopping
from symo_exp.runs.series import EPOCH, read
from symo_exp.training import resuming
from symo_exp.training.checkpoint import WholeFiles
from symo_exp.training.divergence import DivergenceError
from symo_exp.training.learner import Learner
from tests.limits import no_file_larger_than, no_more_files
from tests.models.methods import learned
from tests.tables import choices
from tests.training.runs import CLOCKS, Cut, cut, go, same, state

SYMO = "model=symo"
SHORT = {
    "adam_then_lm": "optimizer.epochs=3",
    "total_least_squares": "optimizer.starts=1 optimizer.start=2 optimizer.epochs=2"
    " optimizer.epsilons=[1.0,0.3]",
}
"""Settings with which an optimiser does all that it does in six epochs."""
STOPPING = f"{SYMO} optimizer=lbfgs scheduler=none optimizer.patience=1 data.monitor=held_out" + (
    " data.held_out=1 data.monitor_trajectories=null"
)
EVERY = [
    *(f"model={name}" for name in learned()),
    *(
        f"{SYMO} dtype=float64 scheduler=none optimizer={name} {SHORT.get(name, '')}".strip()
        for name in choices("optimizer")
        if name != "adam"  # the usual one
    ),
    "model=node scheduler=cosine",
    STOPPING,
]


@pytest.fixture(autouse=True)
def _hear(caplog):
    caplog.set_level("INFO", logger="symo_exp")


def resumed(caplog):
    found = [r.message for r in caplog.records if r.message.startswith("resuming after epoch")]
    return [int(message.split()[-1]) for message in found]


def refused(caplog):
    return [r.message for r in caplog.records if "is not used" in r.message]


def is_quick(words):
    """An optimiser that stops, and the one with the most state."""
    return words == STOPPING or "total_least" in words


@pytest.mark.parametrize(
    "words",
    [x if is_quick(x) else pytest.param(x, marks=pytest.mark.slow) for x in EVERY],
    ids=lambda words: words.replace(" ", ","),
)
def test_a_training_interrupted_twice_ends_with_the_same_bits(
    words, workplace, monkeypatch, caplog
):
    whole = go(words, workplace / "whole")
    for epoch in (1, 4):
        cut(words, workplace / "cut", epoch, monkeypatch)
        torch.manual_seed(99)  # what another process would draw
    assert go(words, workplace / "cut") == whole
    assert resumed(caplog) == [1, 4]
    assert same(state(workplace / "cut"), state(workplace / "whole"))
    assert series(workplace / "cut") == series(workplace / "whole")


def series(folder):
    """Return all rows without times."""
    rows = read(folder / "series.csv")
    assert [row[EPOCH] for row in rows] == list(range(len(rows)))
    return [{name: value for name, value in row.items() if name not in CLOCKS} for row in rows]


@pytest.mark.parametrize(
    ("epoch", "validate_every"),
    [
        (1, 2),
        (2, 3),
        (4, 2),
        *(pytest.param(*x, marks=pytest.mark.slow) for x in ((2, 2), (3, 3), (5, 3))),
    ],
)
def test_a_training_may_be_interrupted_in_any_epoch(
    validate_every, epoch, whole, folder, monkeypatch
):
    shutil.rmtree(folder)
    words = f"{SYMO} trainer.validate_every={validate_every}"
    cut(words, folder, epoch, monkeypatch)
    assert go(words, folder) == whole


class Pickled:
    def __reduce__(self):
        return os.mkdir, ("harm",)


def flip(path):
    """One bit of the largest part of the file."""
    with zipfile.ZipFile(path) as archive:
        part = max((archive.read(name) for name in archive.namelist()), key=len)
    whole = bytearray(path.read_bytes())
    whole[whole.index(part) + len(part) // 2] ^= 1
    path.write_bytes(whole)


def without_prefix(path):
    """The weights named as by versions in which the model was the learner."""
    state = torch.load(path, weights_only=True)
    state["state_dict"] = {k.removeprefix("model."): x for k, x in state["state_dict"].items()}
    torch.save(state, path)


def another(path, other, monkeypatch):
    cut(other, path.parents[2] / "other", 1, monkeypatch)
    shutil.copy(path.parents[2] / "other" / "checkpoints" / "last.ckpt", path)


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """A run that ended, with its measures, and the same run, cut."""
    folder = tmp_path_factory.mktemp("example")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        whole = go(SYMO, folder / "whole")
        cut(SYMO, folder / "cut", 3, patch)
    return folder, whole


@pytest.fixture
def whole(example):
    return example[1]


@pytest.fixture
def folder(example, workplace):
    """The run that was cut, to be damaged and resumed; beside it the one that ended."""
    shutil.copytree(example[0], workplace, dirs_exist_ok=True)
    return workplace / "cut"


DAMAGE = {
    "empty": lambda path, _: path.write_bytes(b""),
    "half": lambda path, _: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "flipped": lambda path, _: flip(path),
    "text": lambda path, _: path.write_text("my diary"),
    "code": lambda path, _: torch.save(Pickled(), path),
    "other": lambda path, _: torch.save({"state_dict": {"a": 1}}, path),
    "another version": lambda path, _: without_prefix(path),
    "another seed": lambda path, m: another(path, f"{SYMO} seed=1", m),
    "another model": lambda path, m: another(path, f"{SYMO} net.width=6", m),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_checkpoint_is_reported_and_the_previous_one_used(
    damage, whole, folder, workplace, monkeypatch, caplog
):
    DAMAGE[damage](folder / "checkpoints" / "last.ckpt", monkeypatch)
    caplog.clear()
    assert go(SYMO, folder) == whole
    (line,) = refused(caplog)
    assert str(folder / "checkpoints" / "last.ckpt") in line
    assert "\n" not in line
    assert resumed(caplog) == [2]
    assert same(state(folder), state(workplace / "whole"))
    assert not (workplace / "harm").exists()


def test_without_a_valid_checkpoint_training_starts_anew(whole, folder, caplog):
    for name in ("last.ckpt", "previous.ckpt"):
        (folder / "checkpoints" / name).write_bytes(b"")
    assert go(SYMO, folder) == whole
    assert len(refused(caplog)) == 2
    assert resumed(caplog) == []


def no_memory():
    """Loading takes more memory than there is."""
    return mock.patch("torch.load", side_effect=MemoryError)


@pytest.mark.parametrize(("lacks", "error"), [(no_more_files, OSError), (no_memory, MemoryError)])
def test_a_checkpoint_that_cannot_be_read_for_now_stays(
    lacks, error, whole, folder, monkeypatch, caplog
):
    latest = resuming.latest

    def latest_now(*given):
        with lacks():
            return latest(*given)

    with monkeypatch.context() as patch:
        patch.setattr(resuming, "latest", latest_now)
        with pytest.raises(error):
            go(SYMO, folder)
    assert refused(caplog) == []
    assert go(SYMO, folder) == whole
    assert resumed(caplog) == [3]


def test_after_training_only_the_evaluation_is_repeated(whole, folder, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("symo_exp.job.recipe.evaluate", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            go(SYMO, folder)
    monkeypatch.setattr("lightning.Trainer.fit", lambda *_, **__: pytest.fail("it trains again"))
    assert go(SYMO, folder) == whole


def test_a_stop_after_the_last_epoch_waits_for_the_last_checkpoint(whole, workplace, monkeypatch):
    """What follows training is interrupted at once, but not before its result is on the disk."""
    end, folder = Learner.on_train_end, workplace / "run"

    def end_stopped(model):
        end(model)
        os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patch, stopping.command(), stopping.urgent():
        patch.setattr(Learner, "on_train_end", end_stopped)
        with pytest.raises(stopping.Interrupted):
            go(SYMO, folder)
    assert not (folder / "metrics.json").exists()
    monkeypatch.setattr("lightning.Trainer.fit", lambda *_, **__: pytest.fail("it trains again"))
    assert go(SYMO, folder) == whole


def test_a_training_that_stopped_early_is_not_repeated(workplace, monkeypatch):
    words = f"{STOPPING} trainer.max_epochs=500"
    go(words, workplace / "run")
    monkeypatch.setattr("lightning.Trainer.fit", lambda *_, **__: pytest.fail("it trains again"))
    go(words, workplace / "run")


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_training_may_be_interrupted_at_every_replacement_of_a_file(
    when, whole, folder, monkeypatch, caplog
):
    shutil.rmtree(folder)
    replace = os.replace
    for moment in range(1000):
        count = 0

        def cut_replace(old, new):
            nonlocal count
            last, count = count == moment, count + 1  # noqa: B023
            if last and when == "before":
                raise Cut
            replace(old, new)
            if last:
                raise Cut

        with monkeypatch.context() as patch:
            patch.setattr("os.replace", cut_replace)
            try:
                found = go(SYMO, folder)
            except Cut:
                continue
            break
    assert moment >= 7
    assert found == whole
    assert same(state(folder), state(folder.parent / "whole"))
    assert refused(caplog) == []


def test_a_disk_that_is_full_for_a_while_costs_only_checkpoints(
    whole, workplace, monkeypatch, caplog
):
    replace, count = os.replace, 0

    def full(old, new):
        nonlocal count
        count += "last.ckpt" in str(new)
        if "last.ckpt" in str(new) and count in (2, 3):
            raise OSError(28, "No space left on device")
        replace(old, new)

    monkeypatch.setattr("os.replace", full)
    assert go(SYMO, workplace / "run") == whole
    assert sum("No space left" in r.message for r in caplog.records) == 2


def test_a_checkpoint_that_is_cut_short_costs_nothing_else(whole, workplace, monkeypatch, caplog):
    save, count = WholeFiles.save_checkpoint, 0

    def cut_short(*given, **options):
        nonlocal count
        count += 1
        with no_file_larger_than(4096) if count in (2, 3) else nullcontext():
            save(*given, **options)

    monkeypatch.setattr(WholeFiles, "save_checkpoint", cut_short)
    assert go(SYMO, workplace / "run") == whole
    assert sum(r.message.startswith("no checkpoint: ") for r in caplog.records) == 2


def test_a_training_that_diverges_keeps_the_last_good_weights(workplace, monkeypatch, caplog):
    step = Learner.training_step

    def poisoned(model, batches, index):
        if model.current_epoch == 3:
            for parameter in model.parameters():
                parameter.data.mul_(float("nan"))
        step(model, batches, index)

    monkeypatch.setattr(Learner, "training_step", poisoned)
    for attempt in range(3):
        caplog.clear()
        with pytest.raises(DivergenceError, match=r"after epoch 4 .* try a smaller optimizer.lr"):
            go("model=node learner.gradient_clip=null", workplace / "run")
        weights = symo_exp.load(workplace / "run").state_dict().values()
        assert all(bool(value.isfinite().all()) for value in weights)
        assert resumed(caplog) == ([3] if attempt else [])
        assert len(refused(caplog)) == (attempt > 0)
