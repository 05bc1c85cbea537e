"""Disks that are full, read-only, or without permission."""

import errno
import json
import os
import subprocess
from contextlib import contextmanager

import pytest

from symo_exp.report.__main__ import main as report
from tests.faults.commands import Command, go
from tests.faults.test_kills import WORDS as KEPT
from tests.faults.test_kills import left
from tests.jobs import refusal
from tests.report.stores import add_folder
from tests.tiny import TINY

WORDS = [*KEPT, "model=symo", "trainer.max_epochs=12"]


@contextmanager
def mounted(folder, *options):
    folder.mkdir(exist_ok=True)
    done = subprocess.run(["mount", *options, str(folder)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of the run on a disk with space."""
    folder = tmp_path_factory.mktemp("whole")
    code, said = go(folder, *WORDS)
    assert code == 0, said
    return left(folder)


@pytest.fixture
def disk(tmp_path):
    with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=8m", "tmpfs") as folder:
        yield folder


def fill(disk, free=0):
    """Leave at most so many bytes and return the file to remove.

    A run that goes on may take space in between, so that less is left than there was.
    """
    there = os.statvfs(disk)
    filler = disk / "filler"
    try:
        filler.write_bytes(bytes(max(there.f_bavail * there.f_frsize - free, 0)))
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
    return filler


@pytest.mark.slow
@pytest.mark.parametrize("free", [0, 16, 64, 256, 1024, 1100, 1536, 2048, 2560])
def test_a_run_on_a_full_disk_leaves_whole_files_and_ends_the_same(free, disk, whole):
    filler = fill(disk, free * 1024)
    command = Command(disk, *WORDS, output=disk.parent / "output")
    code = command.wait()
    assert "Traceback" not in command.said
    if code:
        assert code in (1, 2)
        assert [line for line in command.said.splitlines() if "space" in line or "full" in line]
    for path in disk.rglob("*"):  # what is there is whole
        if path.suffix == ".json" and path.parent.name != "cache":
            json.loads(path.read_text())
    filler.unlink()
    code, said = go(disk, *WORDS)
    assert code == 0, said
    assert left(disk) == whole


@pytest.mark.slow
def test_a_run_fails_on_a_full_disk_and_resumes(disk, whole):
    words = [*WORDS, "trainer.max_epochs=600", "trainer.compile=false"]
    command = Command(disk, *words, output=disk.parent / "output")
    command.wait_for(lambda: [*disk.rglob("last.ckpt")])
    filler = fill(disk)
    code = command.wait()
    assert code == 1, command.said
    assert "No space left" in command.said
    filler.unlink()
    code, said = go(disk, *words)
    assert code == 0, said
    assert "resuming after epoch" in said


def test_a_report_on_a_full_disk_leaves_the_one_before(disk, tmp_path, capsys):
    add_folder(tmp_path / "runs" / "0")
    words = [str(tmp_path / "runs"), "--out", str(disk / "report")]
    assert report(words) == 0
    before = {path: path.read_bytes() for path in disk.rglob("*.*")}
    for seed in range(1, 60):
        add_folder(tmp_path / "runs" / str(seed), seed=seed)
    fill(disk)
    assert report(words) == 2
    assert "No space left" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.slow
def test_a_read_only_cache_is_enough_if_it_has_the_data(tmp_path, disk):
    words = [*TINY, "model=node", "logger=none", "pictures=false", f"data.cache_dir={disk}"]
    assert go(tmp_path, *words)[0] == 0
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    assert go(tmp_path, *words, "model=symo")[0] == 0  # all it wants is there
    code, said = go(tmp_path, *words, "seed=1")
    assert code == 2
    (line,) = [line for line in said.splitlines() if line.startswith("symo_exp")]
    assert "data.cache_dir" in line
    assert str(disk) in line


@pytest.mark.parametrize("what", ["output_dir", "logger.directory"])
def test_a_read_only_place_is_refused(what, workplace, disk):
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    line = refusal(*WORDS, f"{what}={disk}")
    assert "\n" not in line
    assert str(disk) in line
