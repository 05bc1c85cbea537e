"""The folder of a run: atomic files, its lock and its content; and its series."""

import errno
import fcntl
import itertools
import math
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pandas
import pytest
import yaml

from symo_exp.data.cache import Cache
from symo_exp.runs.digest import digest
from symo_exp.runs.folder import About, RunFolder
from symo_exp.runs.outcome import recording_names
from symo_exp.runs.series import Series, read
from tests.limits import no_file_larger_than


@pytest.fixture
def folder(tmp_path):
    return RunFolder(tmp_path / "run")


def test_a_digest_depends_on_values_and_not_on_their_spelling():
    one = {"a": {"x": 1, "y": 1e-3}, "b": [1, 2.0], "c": True, "d": None}
    other = {"d": None, "c": True, "b": [1.0, 2], "a": {"y": 0.001, "x": 1.0}}
    assert digest(one) == digest(other)
    others = [{**one, "c": 1}, {**one, "d": "None"}, {**one, "a": {"x": 2, "y": 1e-3}}]
    assert len({digest(x) for x in (one, *others)}) == 4


def test_settings_that_change_no_number_do_not_change_the_digest():
    settings = {"seed": 0, "data": {"n_traj": 8, "cache_dir": "a"}, "logger": {"x": 1}}
    assert digest(settings) == digest({"seed": 0, "data": {"n_traj": 8, "cache_dir": "b"}})


def test_measures_are_json_even_when_they_are_not_finite(folder):
    folder.write_measures({"a": 1e-9, "b": math.inf, "c": math.nan})
    text = (folder / "metrics.json").read_text()
    assert "Infinity" not in text
    assert "NaN" not in text
    back = folder.measures()
    assert (back["a"], back["b"]) == (1e-9, math.inf)
    assert math.isnan(back["c"])


def test_a_failed_write_leaves_the_old_file_and_no_rubbish(folder):
    folder.write_config({"seed": 0})
    with pytest.raises(yaml.YAMLError):
        folder.write_config({"seed": object()})
    assert [path.name for path in folder.path.iterdir()] == ["config.yaml"]
    assert yaml.safe_load((folder / "config.yaml").read_text()) == {"seed": 0}


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"status": "finished", "x": 1}'])
def test_unreadable_files_count_as_missing(text, folder):
    folder.record("finished")
    (folder / "outcome.json").write_text(text)
    (folder / "run.json").write_text(text)
    (folder / "metrics.json").write_text(text if text.startswith("[") else "")
    assert folder.outcome().status == "waiting"
    assert folder.about() is None
    assert folder.measures() == {}


@pytest.mark.parametrize("text", ["", "garbage", "a: [", "\0"])
def test_a_run_with_unreadable_settings_is_measured_again(text, folder):
    folder.write_config({"seed": 0})
    folder.write_measures({"test_mse": 1.0})
    assert folder.is_measured(None)
    (folder / "config.yaml").write_text(text)
    assert not folder.is_measured(None)
    assert folder.config() == {}


@pytest.mark.parametrize("deletions", range(5))
def test_a_deletion_that_is_killed_leaves_no_finished_run_with_missing_files(
    deletions, folder, monkeypatch
):
    names = "checkpoints", "series.csv", "run.json", "published.json"
    (folder / "checkpoints").mkdir(parents=True)
    for name in names[1:]:
        (folder / name).write_text("{}")
    folder.record("finished")
    done = itertools.count()

    def until_killed(delete):
        def wrapped(*args, **options):
            if next(done) == deletions:
                raise KeyboardInterrupt
            return delete(*args, **options)

        return wrapped

    for home, name in ((shutil, "rmtree"), (pathlib.Path, "unlink")):
        monkeypatch.setattr(home, name, until_killed(getattr(home, name)))
    with pytest.raises(KeyboardInterrupt):
        folder.clear()
    whole = all((folder / name).exists() for name in names)
    assert whole or folder.outcome().status == "waiting"


def test_a_run_that_starts_anew_has_no_results_of_the_former(folder):
    for name in ("studies", "pictures"):
        (folder / name).mkdir(parents=True)
    for name in ("metrics.json", "parameters.csv", "posterior.pt", "rollouts.parquet"):
        (folder / name).write_text("{}")
    folder.clear()
    assert not [path for path in folder.path.rglob("*") if path.suffix or path.is_dir()]


def test_a_run_that_goes_on_is_the_same_run(folder):
    folder.describe(About("first", {"a": 1}))
    first = folder.about()
    folder.describe(About("swept", {"a": 1}, sweep="its first"))
    folder.describe(About("again", {"a": 1}, variant="fast"))
    again = folder.about()
    assert again.sweep == "its first"
    assert (again.identity, again.started) == (first.identity, first.started)
    assert (again.name, again.variant) == ("again", "fast")
    folder.clear()
    folder.describe(About("anew", {"a": 1}))
    assert folder.about().identity != first.identity


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_run_goes_on_where_there_are_no_locks(code, folder, monkeypatch):
    """As on some network disks."""

    def flock(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    with folder.alone():
        folder.record("finished")
    assert not folder.in_use()
    cache, made = Cache(folder / "cache"), {"a": np.ones(3)}
    assert cache.get("name", {}, lambda: made) == made
    monkeypatch.setattr(fcntl, "flock", lambda *_: os.open("/none", os.O_RDONLY))
    with pytest.raises(FileNotFoundError), folder.alone():
        pass


HOLD = """
import sys
from symo_exp.runs.folder import RunFolder
folder = RunFolder(sys.argv[1])
with folder.alone():
    folder.record("running")
    print(flush=True)
    sys.stdin.read()
"""


def test_a_free_lock_and_running_is_dead(folder):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    process.stdout.readline()
    assert folder.in_use()
    assert not folder.died()
    assert folder.outcome().process["pid"] == str(process.pid)
    process.kill()
    process.wait()
    assert not folder.in_use()
    assert folder.died()
    folder.record("finished")
    assert not folder.died()


def test_a_table_is_parquet(folder):
    folder.write_table("x.parquet", {"a": [1, 2], "b": [0.5, math.nan]})
    assert pandas.read_parquet(folder / "x.parquet").a.tolist() == [1, 2]


def test_a_study_is_done_with_its_settings_or_not_at_all(folder):
    asked = {"forced": {"steps": 3, "period": 2.0}}
    assert folder.missing_studies(asked) == ["forced"]
    folder.write_study("forced", asked["forced"], {"forced_x": float("inf")}, {})
    assert folder.missing_studies(asked) == []
    assert folder.missing_studies({"forced": {"steps": 4, "period": 2.0}}) == ["forced"]
    assert folder.measures() == {"forced_x": float("inf")}
    (folder / "studies" / "forced.json").write_text("{")
    assert folder.missing_studies(asked) == ["forced"]


@pytest.mark.parametrize("text", ["", '{"test_mse": 1', "[]", "{}", '{"test_mse": "a"}'])
def test_a_run_with_damaged_measures_is_measured_again(text, folder):
    folder.write_config({"model": {}})
    assert not folder.has_damaged_measures()
    folder.write_measures({"test_mse": 1.0})
    assert folder.is_measured(None)
    (folder / "metrics.json").write_text(text)
    assert folder.has_damaged_measures()
    assert not folder.is_measured(None)


# -- series ------------------------------------------------------------------------------------


@pytest.fixture
def path(tmp_path):
    return tmp_path / "series.csv"


def rows(path):
    return [{k: v for k, v in row.items() if k != "time"} for row in read(path)]


def test_every_number_comes_back_to_the_bit(path):
    values = [0.1, 1 / 3, 1e-300, math.inf, 12345678.9]
    series = Series(path)
    for epoch, value in enumerate(values):
        series.append(epoch, {"x": value})
    assert [row["x"] for row in read(path)] == values


def test_a_quantity_may_come_later_and_not_always(path):
    series = Series(path)
    series.append(0, {"a": 1.0})
    series.append(1, {"a": 2.0, "b": 3.0})
    series.append(2, {"a": 4.0})
    expected = [{"epoch": 0, "a": 1.0}, {"epoch": 1, "a": 2.0, "b": 3.0}, {"epoch": 2, "a": 4.0}]
    assert rows(path) == expected
    again = Series(path)  # another process
    again.append(3, {"b": 5.0})
    assert rows(path) == [*expected, {"epoch": 3, "b": 5.0}]


@pytest.mark.parametrize("before", [0, 1])
def test_a_quantity_that_finds_the_disk_full_comes_later(before, path):
    """The first one, or one that was not there before."""
    series = Series(path)
    for epoch in range(before):
        series.append(epoch, {"a": 1.0})
    with no_file_larger_than(5), pytest.raises(OSError, match="large"):
        series.append(before, {"a": 1.0, "b": 2.0})
    series.append(before + 1, {"a": 1.0})
    both = [{"epoch": before, "a": 1.0, "b": 2.0}, {"epoch": before + 1, "a": 1.0}]
    assert rows(path)[before:] == both


def test_rows_that_are_cut_off_are_written_again(path):
    series = Series(path)
    for epoch in range(5):
        series.append(epoch, {"x": float(epoch)})
    torn = path.read_text() + "5,17"
    path.write_text(torn)
    assert len(read(path)) == 5
    again = Series(path)
    again.cut(3)
    again.append(3, {"x": 9.0})
    assert [row["x"] for row in read(path)] == [0.0, 1.0, 2.0, 9.0]
    Series(path).cut(0)
    assert read(path) == []


@pytest.mark.parametrize("free", [0, 5])
def test_rows_wait_for_a_disk_that_is_full(path, free):
    series = Series(path)
    series.append(0, {"x": 0.0})
    kept = path.read_bytes()
    with no_file_larger_than(len(kept) + free):
        for epoch in (1, 2):
            with pytest.raises(OSError, match="too large"):
                series.append(epoch, {"x": float(epoch)})
    assert path.read_bytes() == kept
    series.append(3, {"x": 3.0})
    assert [row["x"] for row in read(path)] == [0.0, 1.0, 2.0, 3.0]


def test_complete_rows_are_read_wherever_a_kill_cut_the_file(path):
    series = Series(path)
    for epoch in range(3):
        series.append(epoch, {"x": float(epoch)})
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        found = read(path)
        assert [row["x"] for row in found] == [float(k) for k in range(len(found))]


def test_a_folder_is_named_relative_to_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert str(RunFolder(tmp_path / "a" / "b")) == os.path.join("a", "b")


@pytest.mark.parametrize(
    ("path", "names"),
    [
        ("a/my log (1), new.csv", "my log (1), new.csv"),
        (["a/b c.csv", "it's.csv"], "b c.csv, it's.csv"),
        ("[a].csv", "[a].csv"),
        ("logs/", "logs"),
        (".", "."),
        ("2024", "2024"),
    ],
)
def test_recordings_are_named_by_their_files(path, names):
    assert recording_names(path) == recording_names(str(path)) == names


@pytest.mark.parametrize("secret", ["s3cret", "s3cr:et", "s3cret@"])
def test_files_of_a_run_have_no_password_of_a_store(folder, secret):
    uri = f"postgresql+psycopg2://me:{secret}@host:5432/runs"
    folder.write_config({"logger": {"tracking_uri": uri}, "data": {"path": "http://a/b:c@d"}})
    tags = {"symo_exp.command": f"python -m symo_exp logger.tracking_uri={uri} seed=1"}
    folder.describe(About(f"logger.tracking_uri={uri}", {"logger.tracking_uri": uri}, tags=tags))
    for path in folder.path.rglob("*.*"):
        assert "s3c" not in path.read_text(encoding="utf-8"), path
    shown = "postgresql+psycopg2://me:…@host:5432/runs"
    assert folder.config()["logger"]["tracking_uri"] == shown
    assert folder.config()["data"]["path"] == "http://a/b:c@d"
    about = folder.about()
    assert about.parameters == {"logger.tracking_uri": shown}
    assert about.tags["symo_exp.command"].endswith(f"tracking_uri={shown} seed=1")
