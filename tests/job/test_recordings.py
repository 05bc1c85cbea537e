"""Runs on recordings: measured window by window and compared with a reference."""

import json
import math
import os
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import symo_exp
from symo_exp.__main__ import main
from symo_exp.data.paths import content_of
from symo_exp.errors import ConfigError
from symo_exp.evaluation.references import Continuous
from symo_exp.job.job import changed_recordings
from symo_exp.runs.folder import RunFolder
from tests.jobs import job_of, jobs_of, refusal

WORDS = [
    "system=pendulum", "system.time_step=0.02", "data=recorded", "data.path=mine.csv",
    "model=node", "net.width=8", "trainer.max_epochs=2", "logger=none",
]  # fmt: skip


@pytest.fixture
def recordings(workplace):
    """Four swings of 2.4 s of a pendulum, somebody's."""
    t = 0.02 * np.arange(121)
    swings = [a * np.cos(5.0 * t + a) for a in (1.0, 1.2, 1.4, 1.6)]
    tables = [
        pd.DataFrame({"trajectory": i, "t": t, "q_theta": q, "u_0": 0.1 * np.sin(t)})
        for i, q in enumerate(swings)
    ]
    pd.concat(tables).to_csv("mine.csv", index=False)
    return workplace


def only(workplace) -> RunFolder:
    (path,) = (workplace / "outputs" / "default").glob("*-*")
    return RunFolder(path)


@pytest.mark.slow
def test_another_reference_measures_a_finished_run_again_and_does_not_train_it(
    recordings, monkeypatch, capsys
):
    monkeypatch.setattr(
        "symo_exp.evaluation.recordings.Continuous", partial(Continuous, substeps=1)
    )
    assert main([*WORDS, "pictures=false"]) == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if "verdict: " in line]
    assert "constant velocity" in said
    assert "noise" in said
    folder = only(recordings)
    before = folder.measures()
    assert before["rmse_2s"] > 0.0
    assert before["windows"] >= 1.0
    assert not [name for name in before if name.startswith("reference")]
    trained = (folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns

    held = [*WORDS, "pictures=false", "reference=motor_pendulum"]
    assert main(held) == 0
    after = only(recordings).measures()
    assert after["reference_rmse_2s"] > 0.0
    assert {name: after[name] for name in before} == pytest.approx(before, nan_ok=True)
    assert (folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns == trained
    measured = (folder / "metrics.json").stat().st_mtime_ns
    assert main(held) == 0
    assert (folder / "metrics.json").stat().st_mtime_ns == measured

    table = pd.read_parquet(folder / "windows.parquet")
    assert list(table) == [
        "window", "trajectory", "start", "t",
        "q_theta", "v_theta", "q_true_theta", "v_true_theta", "q_reference_theta",
        "error", "error_reference",
    ]  # fmt: skip
    predicted = table[table.t > 0]
    for who in ("", "reference_"):
        error = (predicted[f"q_{who}theta"] - predicted.q_true_theta) ** 2
        assert after[f"{who}pooled_rmse_2s"] == pytest.approx(math.sqrt(error.mean()))


@pytest.mark.parametrize(
    "status", [pytest.param("finished", marks=pytest.mark.slow), "interrupted"]
)
def test_results_of_other_recordings_are_refused_and_kept(status, recordings, capsys):
    words = [*WORDS, "measures=false", "pictures=false"]
    assert main(words) == 0
    folder = only(recordings)
    folder.record(status)
    trained = (folder / "checkpoints" / "last.ckpt").read_bytes()
    os.utime("mine.csv")  # the content is the same
    assert changed_recordings(job_of(*words).values, folder, restarts=True) is None
    text = Path("mine.csv").read_text()
    Path("mine.csv").write_text(text.replace("\n0,0.02,", "\n0,0.021,"))
    capsys.readouterr()
    for more in ([], ["study=drift"]):
        assert main([*words, *more]) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert "data.path=mine.csv: the recordings have changed since outputs/default/" in said
        assert "give resume=false to start this run anew, or experiment=NAME" in said
    assert folder.outcome().status == status
    assert (folder / "checkpoints" / "last.ckpt").read_bytes() == trained
    about = json.loads((folder / "run.json").read_text())
    del about["recordings"]  # as of an earlier version
    (folder / "run.json").write_text(json.dumps(about))
    assert not refused(*words)
    (folder / "run.json").write_text(json.dumps(about | {"recordings": "0123456789"}))
    for more in (["resume=false"], ["experiment=other"]):
        assert main([*words, *more]) == 0
    assert not refused(*words)
    Path("mine.csv").unlink()
    assert not refused(*words)


def refused(*words: str) -> bool:
    """Whether the command of a run whose folder exists is refused."""
    try:
        jobs_of(*words)
    except ConfigError:
        return True
    return False


def test_the_content_of_recordings_is_read_once_a_version(workplace, monkeypatch):
    file, read, found = Path("log.csv"), [], []
    monkeypatch.setattr(Path, "open", lambda *x, inner=Path.open: read.append(1) or inner(*x))
    for text in ("a", "b", "b"):
        with open(file, "w") as opened:
            opened.write(text)
        os.utime(file, ns=(0, len(found)))
        found += [content_of([file]), content_of([file.absolute()])]
    assert found[0] == found[1] != found[2] == found[3] == found[4] == found[5]
    assert len(read) == 3


@pytest.mark.parametrize("names", [[], ["system.names=[arm]", "system.inputs=[motor]"]])
def test_columns_with_names_of_their_own_are_learned_from(names, recordings):
    table = pd.read_csv("mine.csv")
    table.rename(columns={"q_theta": "angle", "u_0": "volt"}).to_csv("foreign.csv", index=False)
    words = [
        "system=recorded", "system.angular=all", "system.time_step=0.02", "data=recorded",
        "data.path=foreign.csv", "data.columns={q_arm: angle, u_motor: volt}", *WORDS[4:],
    ]  # fmt: skip
    assert main([*words, *names, "measures=false", "pictures=false"]) == 0
    model = symo_exp.load(only(recordings).path)
    assert model.coordinates.names == ("arm",)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["reference=motor_double_pendulum"], "does not fit a system of 1 coordinate and "),
        (["reference=free_triple_pendulum"], "does not fit a system of 1 coordinate and "),
        (["reference=motor_pendulum", "reference.inertia=heavy"], "reference.inertia"),
        (["reference=motor_pendulum", "reference.gears=2"], "reference.gears"),
        (["reference=pendulum"], "motor_pendulum"),
        (["reference=motor_pendulum", "data=simulated"], "data=recorded"),
    ],
)
def test_an_invalid_reference_is_refused_before_any_work(words, wanted, recordings):
    given = WORDS if "data=simulated" not in words else [*WORDS[:2], *WORDS[4:]]
    assert wanted in refusal(*given, *words)
    assert not [*recordings.glob("outputs/*/*/*.ckpt")]
