"""What the README tells to type is accepted as it stands."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

import symo_exp
from symo_exp.configuration import SWEEPS
from symo_exp.configuration.command import is_run, jobs_of, parse

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def typed() -> list[str]:
    """Shell commands: the lines of the blocks and the last cells of the table."""
    blocks = re.findall(r"```sh\n(.*?)```", README, flags=re.S)
    lines = [line.partition("  #")[0].strip() for block in blocks for line in block.splitlines()]
    return lines + re.findall(r"^\|[^|]*\| `([^`]+)` \|$", README, flags=re.M)


COMMANDS = [line for line in typed() if line.startswith("python -m symo_exp")]
TARGETS = sorted(set(re.findall(r"\bmake ([a-z-]+)", README)) - {"is"})


def test_the_readme_is_short_and_has_commands():
    assert len(README.splitlines()) < 120
    assert len(COMMANDS) >= 10


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_passes_the_checks(command, workplace):
    args = parse(shlex.split(command)[3:])
    if args.help or not is_run(args):
        return
    args.config_dir = args.config_dir or str(SWEEPS)
    assert jobs_of(args).jobs


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


def test_the_python_names_exist():
    block = re.search(r"```python\n(.*?)```", README, flags=re.S).group(1)
    compile(block, "README.md", "exec")
    from symo_exp.models.base import DynamicsModel

    assert callable(symo_exp.load)
    for name in re.findall(r"`?model\.(\w+)", block + README):
        if name not in ("width", "depth"):
            assert hasattr(DynamicsModel, name), name


def test_files_named_exist():
    for path in re.findall(r"`((?:conf|src|sweeps|tests|benchmarks)/[\w/.]*)`", README):
        assert (ROOT / path).exists(), path
