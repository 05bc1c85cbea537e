"""Commands and code of the README are accepted as they are written."""

import re
import shlex
import shutil
import subprocess

import pytest
import torch

import symo_exp
from symo_exp.__main__ import main
from symo_exp.cli.command import Command
from symo_exp.report.__main__ import main as report
from tests.jobs import jobs_of
from tests.pages import ROOT, python, typed
from tests.test_commands import ARM
from tests.tiny import TINY

README = (ROOT / "README.md").read_text(encoding="utf-8")


COMMANDS = [
    command.line
    for page in ("README.md", "docs/start.md")
    for command in typed(ROOT / page)
    if command.line.startswith("python -m symo_exp")
]


def test_the_readme_is_short_and_has_commands():
    assert len(README.splitlines()) < 100
    assert len(COMMANDS) >= 10


@pytest.mark.parametrize("command", dict.fromkeys(COMMANDS))
def test_a_command_passes_the_checks(command, workplace):
    module, *words = shlex.split(command)[2:]
    if module == "symo_exp.report":
        assert report(["--runs", "none.csv", *words]) == 2  # not a SystemExit for want of an option
        return
    (workplace / "mine.csv").write_text("trajectory,t,q_theta,u_0\n0,0,0,0\n")
    (workplace / "arm.xml").write_text(ARM)
    if {"-h", "--help", "search", "machine"} & set(words) or not Command(words).runs:
        return  # searches are tried in sweep/test_search and tests/identify
    # every sweep that ships is composed in sweep/test_configs
    assert jobs_of(*words, *["system=pendulum"] * ("-cn" in words))


def test_make_help_lists_every_target():
    out = subprocess.run(
        ["make", "--no-print-directory", "help"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    makefile = (ROOT / "Makefile").read_text()
    targets = re.search(r"^\.PHONY: (.*)$", makefile, flags=re.M).group(1).split()
    assert [line.split()[0] for line in out.stdout.splitlines()] == targets


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run that was trained for the pages that load one."""
    place = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as there:
        there.chdir(place)
        assert main([*TINY, "model=symo", "dissipation=viscous", "logger=none"]) == 0
    (folder,) = (place / "outputs" / "default").glob("symo-*")
    return folder


def test_python_of_the_pages_runs_as_it_stands(trained, workplace):
    """On a run that was trained for it, put where the page has it."""
    (path,) = re.findall(r'load\("(outputs[^"]+)"\)', README)
    shutil.copytree(trained, workplace / path)
    names = {"q0": torch.zeros(4, 1), "v0": torch.ones(4, 1)}
    exec(compile(python(ROOT / "README.md"), "README.md", "exec"), names)
    assert names["path"].q.shape == (4, 101, 1)
    for page in ("README.md", "docs/use.md", "docs/recordings.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        for name in re.findall(r"`model\.(\w+)[`(]", text):
            assert hasattr(names["model"], name) or name in ("width", "depth"), name
        for name in re.findall(r"symo_exp\.(\w+)\(", text):
            assert callable(getattr(symo_exp, name)), name
