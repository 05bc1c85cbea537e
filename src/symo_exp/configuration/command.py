"""The jobs that a command asks for, each composed and checked before the first one starts."""

from __future__ import annotations

import argparse
import copy
import functools
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import hydra
from hydra._internal.config_loader_impl import ConfigLoaderImpl
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
from yaml import YAMLError

from symo_exp.configuration import CONF, folders
from symo_exp.configuration.checks import check_nodes, check_parts, closest, has, unknown_key
from symo_exp.configuration.places import check_places
from symo_exp.errors import ConfigError

assert folders  # registers the resolver that names the folder of a run


class Job(NamedTuple):
    """``label`` tells it from the other jobs of its sweep, ``overrides`` make it."""

    label: str
    config: DictConfig
    folder: Path
    log: Path
    overrides: list[str]


class Command(NamedTuple):
    """``elsewhere``: other machines than this one do the jobs."""

    jobs: list[Job]
    multirun: bool
    elsewhere: bool = False


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Hydra's own options and the overrides, in any order."""

    def refuse(message: str) -> NoReturn:
        raise ConfigError(f"{message}; -h shows what can be typed")

    parser = get_args_parser()
    parser.error = refuse  # type: ignore[method-assign]
    return parser.parse_intermixed_args(list(argv))


def is_run(args: argparse.Namespace) -> bool:
    """Whether the command asks for runs, not for information."""
    return not (args.cfg or args.info or args.hydra_help or args.shell_completion or args.help)


def jobs_of(args: argparse.Namespace, passed: Callable[[Job], bool] = lambda job: False) -> Command:
    """Compose and check every job of the command; raise ``ConfigError`` for the first bad one.

    The check imports PyTorch, for seconds. It is left out for jobs that have ``passed``.
    """
    hydra.version.setbase("1.3")
    try:
        return _Composer(args, passed).command()
    except ConfigError:
        raise
    except RecursionError as error:
        raise ConfigError("a file of the configuration refers to itself") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"a file of the configuration is no UTF-8 text: {error}") from error
    except (HydraException, OmegaConfBaseException, YAMLError, ValueError) as error:
        raise ConfigError(one_line(error)) from error
    finally:
        GlobalHydra.instance().clear()


class _Composer:
    def __init__(self, args: argparse.Namespace, passed: Callable[[Job], bool]) -> None:
        GlobalHydra.instance().clear()
        path = create_config_search_path(str(Path(args.config_path or CONF).absolute()))
        if args.config_dir is not None:
            folder = Path(args.config_dir).absolute()
            if not folder.is_dir():
                raise ConfigError(f"--config-dir {args.config_dir} is not a folder")
            path.prepend(provider="command-line", path=f"file://{folder}")
        self.hydra = Hydra.create_main_hydra2("symo_exp", path)
        self.parser = OverridesParser.create(config_loader=self.hydra.config_loader)
        self.args, self.passed = args, passed
        self.name: str = args.config_name or "config"

    def command(self) -> Command:
        given: list[str] = self.args.overrides
        parsed = self._parse(given)
        sweeps = [o.input_line for o in parsed if o.is_sweep_override()]
        own = [o for o in parsed if o.is_hydra_override() and o.input_line not in sweeps]
        master = self._compose_and_check(own)
        if not (self.args.multirun or master.hydra.mode == RunMode.MULTIRUN):
            if sweeps:
                raise ConfigError(f"{sweeps[0]} is a sweep: add -m (--multirun) to run it")
            return Command([self._job(given, 0, "the run", "")], multirun=False)
        elsewhere = _check_launcher(master)
        sweeper = master.hydra.sweeper
        if not str(sweeper.get("_target_", "")).endswith(".BasicSweeper"):
            # what another sweeper will choose is not known: check at least what is fixed
            fixed = [o for o in given if o not in sweeps]
            return Command([self._job(fixed, 0, "the sweep", "")], True, elsewhere)
        params = [f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()]
        kept = [str(o.input_line) for o in own]
        combinations = self._expand(params + [o for o in given if o not in kept])
        common = set.intersection(*map(set, combinations))
        labels = [" ".join([o for o in c if o not in common] or c) for c in combinations]
        jobs = [
            self._job(kept + combination, number, label, "sweep")._replace(overrides=combination)
            for number, (combination, label) in enumerate(zip(combinations, labels, strict=True))
        ]
        return Command(jobs, True, elsewhere)

    def _parse(self, overrides: Sequence[str]) -> list[Override]:
        for override in overrides:
            if "=" not in override and not override.startswith("~"):
                raise ConfigError(f"{override} is no setting with a value: write {override}=...")
        try:
            return self.parser.parse_overrides(list(overrides))
        except HydraException as error:
            raise ConfigError(one_line(error)) from error

    def _expand(self, overrides: Sequence[str]) -> list[list[str]]:
        try:
            return BasicSweeper.split_arguments(self._parse(overrides), None)[0]
        except HydraException as error:
            raise ConfigError(one_line(error)) from error

    def _job(self, overrides: list[str], number: int, label: str, kind: str) -> Job:
        try:
            parsed = self._parse(overrides)
            config = self._compose_and_check(parsed)
            config.hydra.job.num, config.hydra.job.id = number, str(number)
            own = OmegaConf.masked_copy(config, [key for key in map(str, config) if key != "hydra"])
            place = config.hydra.sweep if kind == "sweep" else config.hydra.run
            folder = Path(place.dir, place.get("subdir", "")).absolute()
            log = folder / f"{config.hydra.job.name}.log"
            job = Job(label, own, folder, log, overrides)
            check_places(own, place)
            if not self.passed(job):
                check_parts(own)
                self._check_pairs(config)
                check_nodes(own, self._files(parsed))
        except (ConfigError, HydraException, OmegaConfBaseException) as error:
            where = f"{label}: " if kind == "sweep" else ""
            raise ConfigError(where + one_line(error)) from error
        return job

    def _compose_and_check(self, overrides: Sequence[Override]) -> DictConfig:
        """What Hydra composes; values are set when all files are merged."""
        files = self._files(overrides)
        self._check_keys(overrides, files)
        config = copy.deepcopy(files)
        values = [o for o in overrides if not self._options(o.key_or_group)]
        ConfigLoaderImpl._apply_overrides_to_config(values, config)
        return config

    def _files(self, overrides: Sequence[Override]) -> DictConfig:
        """The configuration with the choices of files made, and no single value changed."""
        choices = [o for o in overrides if self._options(o.key_or_group)]
        for choice in choices:
            options = self._options(choice.key_or_group)
            _check_choice(choice.key_or_group, choice.value(), options)
            _check_installed(choice.key_or_group, choice.value(), options)
        return self._compose(tuple(str(o.input_line) for o in choices))

    @functools.cache  # noqa: B019 - it lives as long as the command is checked
    def _compose(self, overrides: tuple[str, ...]) -> DictConfig:
        """Half a second, so the jobs of a sweep share what they have in common."""
        return self.hydra.compose_config(self.name, list(overrides), RunMode.RUN)

    @functools.cache  # noqa: B019
    def _options(self, group: str) -> list[str]:
        return self.hydra.config_loader.get_group_options(group)

    def _check_keys(self, overrides: Sequence[Override], files: DictConfig) -> None:
        for override in overrides:
            name = override.key_or_group
            new = override.is_add() or override.is_delete()
            if not new and not self._options(name) and not name.startswith("hydra"):
                _check_key(name, files, groups=self.hydra.config_loader.list_groups(""))

    def _check_pairs(self, config: DictConfig) -> None:
        """Refuse a choice that has nothing for this model: SyMo has no Runge-Kutta method."""
        choices = config.hydra.runtime.choices
        references = OmegaConf.to_container(config.model, resolve=False)
        assert isinstance(references, dict)
        for reference in references.values():
            name = str(reference).strip("${}")
            group = name.partition(".")[0]
            here = OmegaConf.select(config, name, default="nothing")  # null, not nothing
            if group == name or group not in choices or here is not None:
                continue
            others = [f"{group}={option}" for option in self._options(group)]
            fits = [o for o in others if OmegaConf.select(self._compose((o,)), name) is not None]
            if fits:
                raise ConfigError(
                    f"{group}={choices[group]} does not go with model={choices.model}; "
                    f"what does: {', '.join(fits)}"
                )


def _check_launcher(config: DictConfig) -> bool:
    """Whether the launcher has other machines do the jobs; refuse it where it cannot."""
    elsewhere = str(config.hydra.launcher._target_).endswith(".SlurmLauncher")
    if elsewhere and shutil.which("sbatch") is None:
        name = config.hydra.runtime.choices["hydra/launcher"]
        raise ConfigError(f"hydra/launcher={name}: there is no SLURM here (no command sbatch)")
    return elsewhere


def _check_choice(group: str, value: object, options: Sequence[str]) -> None:
    if isinstance(value, list):
        for one in value:
            _check_choice(group, one, options)
        return
    if value in options:
        return
    value = "null" if value is None else str(value)
    meant = closest(value, options)
    hint = f"; did you mean {meant[0]}?" if meant else ""
    raise ConfigError(f"{group}={value} is not a choice; possible: {', '.join(options)}{hint}")


def _check_installed(group: str, value: object, options: Sequence[str]) -> None:
    """Refuse our presets of a launcher that is an extra."""
    ours = group == "hydra/launcher" and str(value).startswith("submitit_")
    if ours and "submitit_slurm" not in options:
        raise ConfigError(f"{group}={value} needs submitit: pip install 'symo_exp[cluster]'")


def _check_key(name: str, known: DictConfig, groups: Sequence[str]) -> None:
    node: Any = known
    parts = name.split(".")
    for depth, part in enumerate(parts):
        if not isinstance(node, DictConfig) or not has(node, part):
            siblings = [str(key) for key in node] if isinstance(node, DictConfig) else []
            siblings = [s for s in siblings if s != "hydra" and not s.startswith("_")]
            top = list(groups) if depth == 0 else []
            everything = (n for n in _names(known) if not n.startswith("hydra"))
            raise unknown_key(".".join(parts[: depth + 1]), siblings + top, everything)
        node = None if OmegaConf.is_missing(node, part) else node[part]


def _names(config: DictConfig, path: str = "") -> Iterator[str]:
    """The dotted names of all settings, each where it is written."""
    for key in map(str, config):
        name = f"{path}.{key}" if path else key
        yield name
        if not OmegaConf.is_missing(config, key) and not OmegaConf.is_interpolation(config, key):
            value = config[key]
            if isinstance(value, DictConfig):
                yield from _names(value, name)


def one_line(error: BaseException) -> str:
    """The message of an error in a line, with that of its cause where it adds something."""
    cause = error.__cause__
    text = str(error)
    if not isinstance(error, ConfigError) and cause is not None and str(cause) not in text:
        text = f"{text}: {cause}"
    return " ".join(text.split())
