"""The words of a command: options of Hydra, overrides in any order, names of several sweeps."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import yaml

from symo_exp.errors import ConfigError, Refused
from symo_exp.process import phases, stopping
from symo_exp.shipped import CONF, SWEEPS

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override

SWITCHES = (
    "-m --multirun", "-r --run", "--hydra-help", "--resolve", "-sc --shell-completion", "-h --help",
)  # fmt: skip
WITH_A_VALUE = "-cn --config-name", "-cd --config-dir", "-cp --config-path", "-p --package"
CFG = "job", "hydra", "all"
INFO = "all", "config", "defaults", "defaults-tree", "plugins", "searchpath"
"""Options of Hydra, and the values of two of them."""
CHECK_ONLY = "hydra.callbacks.search.check_only=true"


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"{message}; -h lists all options")


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
        parser.add_argument("-c", "--cfg", choices=CFG)
        parser.add_argument("-i", "--info", nargs="?", const="all", choices=INFO)
        parser.add_argument("overrides", nargs="*")
        self._given = parser.parse_intermixed_args(list(argv))
        self.overrides: list[str] = self._given.overrides
        self.options = [word for word in argv if word not in self.overrides]
        self.multirun: bool = self._given.multirun
        self.name: str = (self._given.config_name or "config").removesuffix(".yaml")
        self.help: bool = self._given.help
        folder = self._given.config_dir
        self.folders = [] if folder is None else [Path(folder).absolute()]
        """The user's own configuration, which is added to ours."""
        self._require_other_names()
        self._parsed = _parsed(self.overrides)

    def _require_other_names(self) -> None:
        """Refuse a file of the user's with the name of one of ours, which Hydra would take."""
        for folder in self.folders:
            for home in (CONF, SWEEPS):
                for ours in home.glob("**/*.yaml"):
                    if (file := folder / ours.relative_to(home)).is_file():
                        raise ConfigError(f"{file} has the name of a file of symo_exp; rename it")

    @property
    def runs(self) -> bool:
        """Return whether the command asks for runs, not for information."""
        given = self._given
        others = given.cfg, given.info, given.hydra_help, given.shell_completion, given.help
        return not any(others)

    def several(self) -> list[Command]:
        """Return one command per sweep if ``-cn NAME`` is a file that lists sweeps."""
        places = [folder / f"{self.name}.yaml" for folder in (SWEEPS, *self.folders)]
        file = next((place for place in places if place.is_file()), None)
        if file is None or not self.runs:
            return []
        names = _listed_sweeps(file)
        return [Command([*self.options, "-cn", name, *self.overrides]) for name in names]

    def checked(self) -> list[Command]:
        """Return the command itself, or the sweeps that it names, all of whose jobs are checked.

        Raises:
            ConfigError: For a word that one of the sweeps cannot take.
        """
        several = self.several()
        for one in several:
            one.execute(CHECK_ONLY)
        return several or [self]

    def execute(self, *extra: str) -> int:
        """Run the command by Hydra and return the exit code.

        Raises:
            ConfigError: For bad input, which Hydra would otherwise print before it exits.
        """
        if self.runs:
            phases.say("reading the configuration")
        import hydra

        from symo_exp.cli.explain import BAD_INPUT, explained
        from symo_exp.job.job import job

        os.environ["HYDRA_FULL_ERROR"] = "1"  # else Hydra prints an error itself and exits
        entry = hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)
        before = sys.argv
        sys.argv = [before[0], *self.options, *self._per_job(), *extra]
        try:
            with stopping.deaf_children():  # also to the signal for launchers of other sweepers
                entry()
        except SystemExit as end:
            return int(end.code or 0)
        except Refused as refused:
            raise refused.error from refused
        except BAD_INPUT as error:
            raise explained(error) from error
        finally:
            sys.argv = before
            phases.clear()
        return 0

    def _per_job(self) -> list[str]:
        """Return the overrides, settings of a swept group as sweeps of one value.

        Hydra applies others when it chooses the file, where the setting may not exist.
        """
        swept = {one.key_or_group for one in self._parsed if one.is_sweep_override()}
        words = list(self.overrides)
        for place, one in enumerate(self._parsed):
            group, dot, _ = one.key_or_group.partition(".")
            single = not (one.is_delete() or one.is_sweep_override())
            if dot and group in swept and single and (value := one.get_value_string()):
                words[place] = f"{one.get_key_element()}=choice({value})"
        return words


def execute_all(commands: Sequence[Command]) -> list[int]:
    """Run commands, of several each beneath its name, and return their exit codes.

    After a signal the rest is left out.
    """
    codes: list[int] = []
    for one in commands:
        if len(commands) > 1:
            print(f"== {one.name}", flush=True)
        codes.append(one.execute())
        if codes[-1] > 128:
            break
    return codes


def _parsed(words: Sequence[str]) -> list[Override]:
    """Return the overrides that words are, and refuse groups without a choice.

    Raises:
        ConfigError: For a word that is none, or whose meaning Hydra would tell in internal words.
    """
    if not words:
        return []  # without the seconds of the import
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import OverrideParseException

    from symo_exp.cli.explain import explained, unknown_choice

    try:
        overrides = OverridesParser.create().parse_overrides(list(words))
    except OverrideParseException as error:
        raise explained(error) from error
    for word, one in zip(words, overrides, strict=True):
        group, names = one.key_or_group, one.value()
        if not group:
            raise ConfigError(f"{word} is not a setting with a value: write NAME=VALUE")
        if group == "hydra.mode" and names != "MULTIRUN":
            raise ConfigError(f"{word} goes around the checks; leave it out: one run needs no -m")
        if group == "hydra.run.dir":
            raise ConfigError(f"{word} has no effect; give output_dir=FOLDER or experiment=NAME")
        if group == "query" and "COMP_LINE" not in os.environ:
            raise ConfigError(f"{word} answers a shell that completes a line; leave it out")
        if group in ("hydra.launcher", "hydra.sweeper") and not isinstance(names, dict):
            file = group.replace(".", "/")
            raise ConfigError(f"{word} gives settings one value; choose a file by {file}=NAME")
        settings = isinstance(names, dict) and names
        if one.is_sweep_override() or settings or not any((CONF / group).glob("*.yaml")):
            continue
        if one.is_add() or one.is_force_add():
            raise ConfigError(f"{word}: {group} has a choice already; leave out the +")
        if one.is_delete():
            raise unknown_choice(f"~{group}", group)
        listed = names if group == "study" and isinstance(names, list) else [names]
        if not listed or not all(isinstance(name, str) for name in listed):
            raise unknown_choice(word, group)
    return overrides


def _listed_sweeps(file: Path) -> list[str]:
    """Return the names that a file lists under ``sweeps``, none if it is itself a sweep."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{file} cannot be read: {error}") from error
    keys = set(content) if isinstance(content, dict) else set()
    if not keys & {"defaults", "sweeps"}:
        raise ConfigError(
            f"{file} is not a sweep: expected defaults: [config, _self_] and settings, or a list "
            "of names under sweeps"
        )
    if keys != {"sweeps"}:
        return []
    names = content["sweeps"]
    if not isinstance(names, list) or not names:
        raise ConfigError(f"{file}: expected a list of names under sweeps")
    others = [path.stem for path in file.parent.glob("*.yaml") if path != file]
    for name in names:
        if name not in others:
            raise ConfigError(f"{file} names the sweep {name}, which is not in {file.parent}")
    return names
