"""The jobs that a command asks for, each composed and checked before the first one starts."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path, get_args_parser
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from symo_exp.configuration import CONF, folders
from symo_exp.configuration.checks import check_nodes, closest, unknown_key
from symo_exp.errors import ConfigError

assert folders  # registers the resolver that names the folder of a run


class Job(NamedTuple):
    config: DictConfig  # with Hydra's own node
    overrides: list[str]

    @property
    def folder(self) -> Path:
        hydra = self.config.hydra
        return Path(hydra.run.dir).absolute()


class Command(NamedTuple):
    jobs: list[Job]
    multirun: bool


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Hydra's own options and the overrides."""
    return get_args_parser().parse_args(list(argv))  # type: ignore[no-any-return]


def is_run(args: argparse.Namespace) -> bool:
    """Whether the command asks for runs, not for information."""
    return not (args.cfg or args.info or args.hydra_help or args.shell_completion or args.help)


def jobs_of(args: argparse.Namespace) -> Command:
    """Compose and check every job of the command; raise ``ConfigError`` for the first bad one."""
    composer = _Composer(args)
    try:
        return composer.command()
    finally:
        GlobalHydra.instance().clear()


class _Composer:
    def __init__(self, args: argparse.Namespace) -> None:
        GlobalHydra.instance().clear()
        path = create_config_search_path(str(Path(args.config_path or CONF).absolute()))
        if args.config_dir is not None:
            folder = Path(args.config_dir).absolute()
            if not folder.is_dir():
                raise ConfigError(f"--config-dir {args.config_dir} is not a folder")
            path.prepend(provider="command-line", path=f"file://{folder}")
        self.hydra = Hydra.create_main_hydra2("symo_exp", path)
        self.parser = OverridesParser.create(config_loader=self.hydra.config_loader)
        self.args = args
        self.name: str = args.config_name or "config"
        self.known: dict[tuple[str, ...], DictConfig] = {}

    def command(self) -> Command:
        given: list[str] = self.args.overrides
        multirun = self.args.multirun or self._mode(given) == RunMode.MULTIRUN
        if not multirun:
            return Command([self._job(given, where="")], multirun=False)
        master = self._compose([o for o in given if not self._is_sweep(o)])
        sweeper = master.hydra.sweeper
        if not str(sweeper.get("_target_", "")).endswith("BasicSweeper"):
            return Command([self._job([o for o in given if not self._is_sweep(o)], "")], True)
        params = [f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()]
        combinations = self._expand(params + [o for o in given if not o.startswith("hydra.")])
        hydra = [o for o in given if o.startswith("hydra.")]
        jobs = [
            self._job(hydra + o, f"job {i + 1} of {len(combinations)} ({' '.join(o)}): ")
            for i, o in enumerate(combinations)
        ]
        return Command(jobs, multirun=True)

    def _mode(self, overrides: list[str]) -> RunMode | None:
        return self.hydra.get_mode(self.name, overrides)  # type: ignore[no-any-return]

    def _parse(self, overrides: Sequence[str]) -> list[Override]:
        try:
            return self.parser.parse_overrides(list(overrides))  # type: ignore[no-any-return]
        except HydraException as error:
            raise ConfigError(one_line(error)) from error

    def _is_sweep(self, override: str) -> bool:
        return bool(self._parse([override])[0].is_sweep_override())

    def _expand(self, overrides: Sequence[str]) -> list[list[str]]:
        try:
            return BasicSweeper.split_arguments(self._parse(overrides), None)[0]
        except HydraException as error:
            raise ConfigError(one_line(error)) from error

    def _job(self, overrides: list[str], where: str) -> Job:
        try:
            parsed = self._parse(overrides)
            self._check_overrides(parsed)
            config = self._compose(overrides)
            own = OmegaConf.masked_copy(config, [key for key in config if key != "hydra"])
            check_nodes(own, self._files_alone(parsed))
        except (ConfigError, HydraException, OmegaConfBaseException) as error:
            raise ConfigError(where + one_line(error)) from error
        return Job(config, overrides)

    def _compose(self, overrides: Sequence[str]) -> DictConfig:
        return self.hydra.compose_config(self.name, list(overrides), RunMode.RUN)  # type: ignore[no-any-return]

    def _files_alone(self, overrides: Sequence[Override]) -> DictConfig:
        """The configuration with the choices of files made, and no single value changed."""
        choices = tuple(o.input_line for o in overrides if self._options(o) and o.input_line)
        if choices not in self.known:
            self.known[choices] = self._compose(choices)
        return self.known[choices]

    def _options(self, override: Override) -> list[str]:
        group: str = override.key_or_group
        return self.hydra.config_loader.get_group_options(group)  # type: ignore[no-any-return]

    def _check_overrides(self, overrides: Sequence[Override]) -> None:
        for override in overrides:
            name = override.key_or_group
            options = self._options(override)
            if options:
                _check_choice(name, override.value(), options)
        known = self._files_alone(overrides)
        for override in overrides:
            name = override.key_or_group
            new = override.is_add() or override.is_delete()
            if not new and not self._options(override) and not name.startswith("hydra"):
                _check_key(name, known, groups=self.hydra.config_loader.list_groups(""))


def _check_choice(group: str, value: object, options: Sequence[str]) -> None:
    if not isinstance(value, str) or value in options:
        return
    meant = closest(value, options)
    hint = f"; did you mean {meant[0]}?" if meant else ""
    raise ConfigError(f"{group}={value} is not a choice; possible: {', '.join(options)}{hint}")


def _check_key(name: str, known: DictConfig, groups: Sequence[str]) -> None:
    node = known
    parts = name.split(".")
    for depth, part in enumerate(parts):
        if not isinstance(node, DictConfig) or part not in node:
            siblings = [str(k) for k in node] if isinstance(node, DictConfig) else []
            siblings = [s for s in siblings if s != "hydra" and not s.startswith("_")]
            here = ".".join(parts[: depth + 1])
            everything = [k for k in _leaves(known) if not k.startswith("hydra.")]
            raise unknown_key(here, siblings + (list(groups) if depth == 0 else []), everything)
        node = node._get_node(part)
        if isinstance(node, DictConfig) and node._is_interpolation():
            node = node._dereference_node()


def _leaves(config: DictConfig, path: str = "") -> Iterator[str]:
    for key in config:
        name = f"{path}.{key}" if path else str(key)
        yield name
        if not OmegaConf.is_interpolation(config, key) and OmegaConf.is_dict(config._get_node(key)):
            if not config._get_node(key)._is_none():
                yield from _leaves(config[key], name)


def one_line(error: BaseException) -> str:
    """The message of an error in a line, with that of its cause where it adds something."""
    cause = error.__cause__
    text = str(error)
    if not isinstance(error, ConfigError) and cause is not None and str(cause) not in text:
        text = f"{text}: {cause}"
    return " ".join(text.split())
