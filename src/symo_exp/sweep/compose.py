"""The jobs of a sweep: overrides expanded, each job composed once."""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType, ValueType
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict

from symo_exp.errors import ConfigError
from symo_exp.job.config import Settings, resolve, unresolved
from symo_exp.job.job import is_done
from symo_exp.runs.digest import relevant
from symo_exp.runs.folder import RunFolder


class Job(NamedTuple):
    """One job of a sweep.

    ``label`` tells it from the other jobs, ``overrides`` make it, and ``known`` are the settings,
    unresolved, that its choices of files alone would give.
    """

    label: str
    overrides: list[str]
    settings: Settings
    known: dict[str, Any]
    choices: dict[str, Any]
    folder: RunFolder

    @property
    def values(self) -> dict[str, Any]:
        """The settings as plain values."""
        return self.settings.values

    def is_left_out(self) -> bool:
        """Return whether the run has finished before and is not to be started anew."""
        return self.values["resume"] is True and is_done(self.values, self.folder)


def expand(
    arguments: Sequence[str], params: Mapping[str, Any], loader: ConfigLoader | None = None
) -> list[list[str]]:
    """Return the overrides of every combination of the values that are swept.

    Args:
        arguments: Overrides of the command line, which have the last word.
        params: Settings that a sweep file varies. A key such as ``model,integrator`` has a list of
            pairs; of these the ones are taken that agree with the command line, and where none
            agrees, the values of the command line alone.
        loader: Finds the choices that a pattern such as ``model=glob(*node)`` stands for.

    Raises:
        ConfigError: If ``params`` are no mapping, a list of pairs has something else, a value is an
            interval or there twice, or no choice fits a pattern.
    """
    if not isinstance(params, Mapping) or not all(isinstance(key, str) for key in params):
        told = f"hydra.sweeper.params={params}: expected settings with their values"
        raise ConfigError(f"{told}, such as hydra.sweeper.params={{seed: '0,1,2'}}")
    single = {key: value for key, value in params.items() if "," not in key}
    axes: dict[tuple[str, ...], list[list[str]]] = {tuple(key.split(",")): [] for key in params}
    given = [f"{key}={value}" for key, value in single.items()]
    for override in OverridesParser.create(loader).parse_overrides([*given, *arguments]):
        if override.is_interval_sweep():
            told = "only a search such as -cn search takes an interval; give values or range(...)"
            raise ConfigError(f"{override.input_line}: {told}")
        key = override.get_key_element()
        if override.is_sweep_override():
            axes[key,] = [[f"{key}={value}"] for value in _values(override)]
        else:
            axes[key,] = [[str(override.input_line)]]
    for key in params.keys() - single:
        names = tuple(key.split(","))
        typed = [axes.pop((name,)) for name in names if (name,) in axes]
        axes[names] = _agreeing(_rows(names, params[key]), typed)
    return [[word for words in one for word in words] for one in itertools.product(*axes.values())]


def _values(override: Override) -> list[str]:
    """Return the values that an override sweeps, of which there has to be one, and none twice."""
    try:
        values = list(override.sweep_string_iterator())
    except (ValueError, HydraException) as error:  # of Python for whole numbers, else of Hydra
        told = "the step of a range is not 0; write range(start,stop,step)"
        raise ConfigError(f"{override.input_line}: {told}") from error
    twice = [value for place, value in enumerate(values) if value in values[:place]]
    told = f"{twice[0]} is given twice" if twice else ""
    if not values:
        told = "no choice has such a name; -h lists all"
        if override.value_type is ValueType.RANGE_SWEEP:
            told = "no value lies between these limits; write range(start,stop,step)"
    if told:
        raise ConfigError(f"{override.input_line}: {told}")
    return values


def _rows(names: Sequence[str], values: Any) -> list[list[str]]:
    """Return the overrides that each row of values means."""
    for row in values if isinstance(values, list | ListConfig) else [values]:
        if not isinstance(row, list | ListConfig) or len(row) != len(names):
            raise ConfigError(
                f"hydra.sweeper.params.{','.join(names)} has {row}: expected a list of rows, each "
                f"of {len(names)} values"
            )
    return [[f"{n}={v}" for n, v in zip(names, row, strict=True)] for row in values]


def _agreeing(rows: list[list[str]], typed: list[list[list[str]]]) -> list[list[str]]:
    """Return the rows that have one of each ``typed`` values, or those values where no row has."""
    found = []
    for one in itertools.product(*typed):
        words = [word for part in one for word in part]
        found += [row for row in rows if set(words) <= set(row)] or [words]
    return found


def labels(combinations: Sequence[Sequence[str]]) -> list[str]:
    """Return the overrides of each combination that not all have; nothing for a single one."""
    if len(combinations) == 1:
        return [""]
    common = set.intersection(*map(set, combinations))
    return [" ".join([o for o in one if o not in common] or one) for one in combinations]


class Composer:
    """Composes jobs by Hydra.

    Merging files takes a tenth of a second; it is done once for all jobs that choose the same
    files.
    """

    def __init__(self, loader: ConfigLoader, master: DictConfig) -> None:
        self._loader, self._master = loader, master
        self.options = functools.cache(loader.get_group_options)
        """Returns the files of a group, none if the name is a setting."""
        self.files = functools.cache(self._composed)
        """Returns the configuration with choices of files, given as overrides."""

    def job(self, overrides: list[str], label: str) -> Job:
        """Return the job of these overrides."""
        parsed = OverridesParser.create().parse_overrides(overrides)
        choices = [o for o in parsed if self._is_choice(o)]
        values = [o for o in parsed if o not in choices and o.type is OverrideType.CHANGE]
        files = self.files(*(str(o.input_line) for o in choices))
        config = copy.deepcopy(self.files(*(str(o.input_line) for o in parsed if o not in values)))
        for override in values:
            OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
        known = unresolved(files)
        if missing := sorted(known.keys() - config.keys()):
            raise ConfigError(f"{missing[0]} is needed and cannot be deleted")
        chosen = dict(config.hydra.runtime.choices)
        folder = RunFolder(f"{config.hydra.sweep.dir}/{config.hydra.sweep.subdir}")
        return Job(label, overrides, resolve(config), known, chosen, folder)

    def _is_choice(self, override: Override) -> bool:
        """Return whether an override chooses a file of a group, and does not give settings."""
        name = override.key_or_group
        if "." in name or isinstance(override.value(), dict):
            return False  # without looking for a group, which Hydra does slowly
        return bool(self.options(name))

    def choices_with(self, group: str, name: str) -> list[str]:
        """Return the choices of a group that give a setting a value, as overrides."""
        every = [f"{group}={option}" for option in self.options(group)]
        return [one for one in every if OmegaConf.select(self.files(one), name) is not None]

    def check_choices(self, job: Job) -> None:
        """Refuse a choice that lacks what the model refers to."""
        for argument in job.values["model"]:
            name = job.settings.references.get(f"model.{argument}", "")
            group, inside, _ = name.partition(".")
            if not inside or group not in job.choices or job.settings.value(name) is not None:
                continue
            if fits := self.choices_with(group, name):
                raise ConfigError(
                    f"{group}={job.choices[group]} does not fit model={job.choices['model']}; "
                    f"possible: {', '.join(fits)}"
                )

    def unread(self, job: Job, idle: Collection[str] = ()) -> dict[str, str]:
        """Return the overrides of a job that change nothing that its run reads, and their names.

        Args:
            job: The job.
            idle: As in ``Settings.is_read``.
        """
        parsed = OverridesParser.create().parse_overrides(job.overrides)
        choices = [one for one in parsed if self._is_choice(one)]
        every, found = dict(relevant(job.known)), {}
        for override in parsed:
            name = override.key_or_group
            if name.partition(".")[0] not in job.values or job.settings.is_read(name, idle):
                continue
            if override in choices:  # its file may set other nodes too
                files = self.files(*(str(o.input_line) for o in choices if o is not override))
                others = dict(relevant(unresolved(files)))
                changed = [x for x in every | others if every.get(x) != others.get(x)]
                if any(job.settings.is_read(one, idle) for one in changed):
                    continue
            found[str(override.input_line)] = name
        return found

    def _composed(self, *overrides: str) -> DictConfig:
        """Return a configuration; of Hydra's own part only what names a folder is kept."""
        own = self._loader.load_sweep_config(self._master, list(overrides))
        with open_dict(own):
            own.hydra = OmegaConf.masked_copy(own.hydra, ["sweep", "runtime"])
        return own
