"""Commands that messages name: the running interpreter, quoted for a shell."""

import os
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser

from symo_exp.shell import override_value, python_command, text_value


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """Run from an environment in the working directory, whose interpreter is a link."""
    home = tmp_path / ".venv" / "bin"
    home.mkdir(parents=True)
    for name in ("python", "python3"):
        (home / name).symlink_to(os.path.realpath(sys.executable))
    monkeypatch.setattr(sys, "executable", str(home / "python3"))
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.chdir(tmp_path)
    return home


def test_an_interpreter_below_the_working_directory_is_named_relative_to_it(environment):
    assert python_command("symo_exp.report") == ".venv/bin/python3 -m symo_exp.report"


def test_from_elsewhere_an_interpreter_is_named_by_its_whole_path(environment, monkeypatch):
    monkeypatch.chdir(environment.parent)
    assert shlex.split(python_command("symo_exp"))[0] == "bin/python3"
    (environment / "below").mkdir()
    monkeypatch.chdir(environment / "below")
    assert shlex.split(python_command("symo_exp"))[0] == str(environment / "python3")


def test_python_is_enough_only_where_it_is_the_interpreter_that_runs(
    environment, tmp_path, monkeypatch
):
    monkeypatch.setenv("PATH", str(environment))
    assert python_command("symo_exp") == "python -m symo_exp"
    other = tmp_path / "bin"  # that of the system, to which the environment's is a link
    other.mkdir()
    (other / "python").symlink_to(os.path.realpath(sys.executable))
    monkeypatch.setenv("PATH", str(other))
    assert python_command("symo_exp") == ".venv/bin/python3 -m symo_exp"


def test_a_shell_takes_the_words_as_they_are():
    words = ["data.path=my file.csv", "system.input_matrix=[[1.0],[0.0]]", "a={b: c}", "x=~/*?"]
    assert shlex.split(python_command("symo_exp", *words))[3:] == words


@pytest.mark.parametrize(
    "value",
    [
        1,
        0,
        1.5,
        1e-7,
        True,
        None,
        "my file.csv",
        ["a b", "c'\"d", "größe", "C:\\a\\b", "\\", 'a\\"b'],
        {"q": "x y"},
        {"a": [1, None]},
    ],
)
def test_a_value_is_spelled_as_the_command_line_reads_it(value):
    (override,) = OverridesParser.create().parse_overrides([f"key={override_value(value)}"])
    assert override.value() == value
    assert type(override.value()) is type(value)


@pytest.mark.parametrize(
    "value", [np.eye(2, 3), np.arange(2), np.float64(1e-7), np.bool_(True), torch.ones(1, 2)]
)
def test_arrays_and_tensors_are_lists(value):
    (override,) = OverridesParser.create().parse_overrides([f"key={override_value([value])}"])
    assert override.value() == [value.tolist()]


@pytest.mark.parametrize(
    "text",
    ["logs/my file, größe.csv", "logs/mine.csv", "a=b/[1].csv", "2024", "null", "NaN", "Inf", ".5",
     "../x-1:2.csv", "nullable", "it's \"q\"", "~"],
)  # fmt: skip
def test_a_path_or_a_text_is_read_as_it_is(text):
    for written in (override_value(Path(text)), text_value(text)):
        words = [f"key={written}", f"key={{name: {written}}}"]
        alone, nested = OverridesParser.create().parse_overrides(words)
        assert alone.value() == text
        assert nested.value() == {"name": text}
        assert not alone.is_sweep_override()


def test_plain_words_have_no_quotes():
    for text in ("logs/mine.csv", "recorded", "_x.1", "a:b"):
        assert text_value(text) == text
