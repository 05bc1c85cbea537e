"""The words of a command: options of Hydra, overrides in any order, names of several sweeps."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import yaml

from symo_exp.errors import ConfigError, Refused
from symo_exp.process import phases
from symo_exp.shipped import CONF, SWEEPS

SWITCHES = "-m --multirun", "-r --run", "--hydra-help", "--resolve", "-sc --shell-completion"
WITH_A_VALUE = (
    "-cn --config-name", "-cd --config-dir", "-cp --config-path", "-c --cfg", "-p --package",
)  # fmt: skip
"""Options of Hydra."""
CHECK_ONLY = "hydra.sweeper.check_only=true"


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"{message}; -h shows what can be typed")


class Command:
    """A command line: ``options`` are Hydra's (``-m``), ``overrides`` are settings.

    Args:
        argv: The words after ``python -m symo_exp``.

    Raises:
        ConfigError: For a word that is neither an option nor an override.
    """

    def __init__(self, argv: Sequence[str]) -> None:
        parser = _Parser(add_help=False, allow_abbrev=False)
        for flags in SWITCHES:
            parser.add_argument(*flags.split(), action="store_true")
        for flags in WITH_A_VALUE:
            parser.add_argument(*flags.split())
        parser.add_argument("-i", "--info", nargs="?", const="all")
        parser.add_argument("overrides", nargs="*")
        self._given = parser.parse_intermixed_args(list(argv))
        self.overrides: list[str] = self._given.overrides
        self.options = [word for word in argv if word not in self.overrides]
        self.name: str | None = self._given.config_name
        for override in self.overrides:
            if "=" not in override and not override.startswith("~"):
                raise ConfigError(f"{override} is not a setting with a value: write {override}=...")
            group, _, value = override.partition("=")
            if value == "null" and (CONF / group).is_dir():
                raise ConfigError(f"{override} is not a choice; -h lists those of {group}")

    @property
    def folder(self) -> Path | None:
        """Return the folder of the user's own configuration, which is added to ours."""
        given = self._given.config_dir
        return None if given is None else Path(given).absolute()

    @property
    def runs(self) -> bool:
        """Return whether the command asks for runs, not for information."""
        given = self._given
        return not (given.cfg or given.info or given.hydra_help or given.shell_completion)

    def named(self, name: str) -> Command:
        """Return the same command for another sweep."""
        words = [name if word == self.name else word for word in self.options]
        return Command([*words, *self.overrides])

    def several(self) -> list[Command]:
        """Return one command per sweep if ``-cn NAME`` is a file that lists sweeps."""
        file = (self.folder or SWEEPS) / f"{self.name}.yaml"
        if self.name is None or not self.runs or not file.is_file():
            return []
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise ConfigError(f"{file} cannot be read: {' '.join(str(error).split())}") from error
        if not isinstance(content, dict) or set(content) != {"sweeps"}:
            return []
        names = content["sweeps"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"{file}: expected a list of names under sweeps")
        for name in names:
            if name == self.name or not file.with_name(f"{name}.yaml").is_file():
                raise ConfigError(f"{file} names the sweep {name}, which is not in {file.parent}")
        return [self.named(name) for name in names]

    def execute(self, *extra: str) -> int:
        """Run the command by Hydra and return the exit code.

        Raises:
            ConfigError: If a job under another sweeper than ours is refused.
            Exception: Any error of Hydra, which would otherwise print it and exit.
        """
        if self.runs:
            phases.say("reading the configuration")
        import hydra

        from symo_exp.job.job import job

        os.environ.setdefault("HYDRA_FULL_ERROR", "1")
        entry = hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)
        before = sys.argv
        sys.argv = [before[0], *self._with_sweeps(), *self._per_job(), *extra]
        try:
            entry()
        except SystemExit as end:
            return int(end.code or 0)
        except Refused as refused:
            raise refused.error from refused
        finally:
            sys.argv = before
            phases.clear()
        return 0

    def _per_job(self) -> list[str]:
        """Return the overrides, settings of a swept group as sweeps of one value.

        Hydra applies others when it chooses the file, where the setting may not exist.
        """
        swept = {w.partition("=")[0] for w in self.overrides if "," in w}
        words = []
        for word in self.overrides:
            key, _, value = word.partition("=")
            group, dot, _ = key.partition(".")
            per_job = dot and group in swept and value and not value.endswith(")")
            words.append(f"{key}=choice({value})" if per_job else word)
        return words

    def _with_sweeps(self) -> list[str]:
        """Return the options with the folder of the shipped sweeps.

        Hydra takes one folder besides its own. Where the user's is needed there, ours is left out,
        or the user's becomes an entry of the search path.
        """
        theirs = ["--config-dir", str(SWEEPS)]
        if self.folder is None:
            return [*self.options, *theirs]
        ships, own = ((f / f"{self.name}.yaml").is_file() for f in (SWEEPS, self.folder))
        if own or not ships:
            return self.options
        given = {self._given.config_dir, "--config-dir", "-cd"}
        rest = [word for word in self.options if word not in given]
        return [*rest, *theirs, f"hydra.searchpath=['file://{self.folder}']"]
