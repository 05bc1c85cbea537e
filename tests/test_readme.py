"""What the README tells to type is accepted as it stands."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import torch

import symo_exp
from symo_exp.__main__ import main
from symo_exp.report.__main__ import main as report
from symo_exp.sweep.command import Command
from tests.jobs import jobs_of
from tests.tiny import TINY

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def typed(text: str) -> list[str]:
    """Shell commands: the lines of the blocks and the last cells of the table."""
    blocks = re.findall(r"```sh\n(.*?)```", text, flags=re.S)
    lines = [line.partition("  #")[0].strip() for block in blocks for line in block.splitlines()]
    return lines + re.findall(r"^\|[^|]*\| `([^`]+)` \|$", text, flags=re.M)


START = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for line in dict.fromkeys([*typed(README), *typed(START)])
    if line.startswith("python -m symo_exp")
]
TARGETS = sorted(set(re.findall(r"\bmake ([a-z-]+)", README)) - {"is"})


def test_the_readme_is_short_and_has_commands():
    assert len(README.splitlines()) < 120
    assert len(COMMANDS) >= 10


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_passes_the_checks(command, workplace):
    module, *words = shlex.split(command)[2:]
    if module == "symo_exp.report":
        assert report(["--runs", "none.csv", *words]) == 2  # not a SystemExit for want of an option
        return
    (workplace / "mine.csv").write_text("trajectory,t,q_theta,u_0\n0,0,0,0\n")
    if {"-h", "--help", "search"} & set(words) or not Command(words).runs:
        return  # a search is tried in sweep/test_search
    # every sweep that ships is composed in sweep/test_configs
    assert jobs_of(*words, *["system=pendulum"] * ("-cn" in words))


@pytest.mark.parametrize("target", TARGETS)
def test_a_make_target_exists(target):
    subprocess.run(["make", "--dry-run", target], cwd=ROOT, check=True, capture_output=True)


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


def python(text: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", text, flags=re.S)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run that was trained for the pages that load one."""
    place = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as there:
        there.chdir(place)
        assert main([*TINY, "model=symo", "dissipation=viscous", "logger=none"]) == 0
    (folder,) = (place / "outputs" / "default").glob("symo-*")
    return folder


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "docs/recordings.md",
        pytest.param("docs/use.md", marks=pytest.mark.slow),  # it exports
    ],
)
def test_the_python_runs_as_it_stands(page, trained, workplace, monkeypatch):
    """On a run that was trained for it, put where the page has it."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for path in re.findall(r'load\("(outputs[^"]+)"\)', text):
        shutil.copytree(trained, workplace / path)
    monkeypatch.setattr(symo_exp, "run", lambda *words: symo_exp.Run(trained))
    names = {"symo_exp": symo_exp, "torch": torch, "model": symo_exp.load(trained)}
    names |= dict.fromkeys(("q", "q0", "q_prev", "q_next"), torch.zeros(4, 1))
    names |= dict.fromkeys(("v", "v0", "u", "u_next"), torch.ones(4, 1))
    if page == "docs/recordings.md":
        names |= {"q": torch.zeros(1), "v": torch.ones(1)}  # a single motion, driven
    for block in python(text):
        exec(compile(block, page, "exec"), names)
    if page == "README.md":
        assert names["path"].q.shape == (4, 101, 1)
    for name in re.findall(r"`model\.(\w+)[`(]", text):
        assert hasattr(names["model"], name) or name in ("width", "depth"), name
    for name in re.findall(r"symo_exp\.(\w+)\(", text):
        assert callable(getattr(symo_exp, name)), name


def test_files_named_exist():
    for path in re.findall(r"`((?:conf|src|sweeps|tests|benchmarks)/[\w/.]*)`", README):
        assert (ROOT / path).exists(), path
