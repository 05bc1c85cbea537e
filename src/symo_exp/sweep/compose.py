"""The jobs of a sweep: overrides expanded, and each composed once."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf, open_dict

from symo_exp.errors import ConfigError
from symo_exp.runs.digest import digest
from symo_exp.runs.folder import RunFolder


class Job(NamedTuple):
    """``label`` tells it from the other jobs of its sweep, ``overrides`` make it; ``files`` is the
    configuration that its choices of files alone would give."""

    label: str
    overrides: list[str]
    config: DictConfig
    files: DictConfig
    choices: dict[str, Any]
    folder: RunFolder


def expand(arguments: Sequence[str], params: Mapping[str, Any] | None = None) -> list[list[str]]:
    """Every combination of the values that are swept; ``params`` are those of a sweep's file, over
    which the command line has the last word."""
    given = [f"{key}={value}" for key, value in (params or {}).items()]
    choices: dict[str, list[str]] = {}
    for override in OverridesParser.create().parse_overrides([*given, *arguments]):
        key = override.get_key_element()
        if override.is_sweep_override():
            choices[key] = [f"{key}={value}" for value in override.sweep_string_iterator()]
        else:
            choices[key] = [override.input_line or f"{key}={override.get_value_element_as_str()}"]
    return [list(combination) for combination in itertools.product(*choices.values())]


def labels(combinations: Sequence[Sequence[str]]) -> list[str]:
    """What each combination has that not all of them have."""
    common = set.intersection(*map(set, combinations))
    return [" ".join([o for o in one if o not in common] or one) for one in combinations]


class Composer:
    """Composes by Hydra. What it takes a tenth of a second for, merging files, is done once for all
    jobs that choose the same files; values are set on copies, as Hydra sets them."""

    def __init__(self, loader: ConfigLoader, master: DictConfig) -> None:
        self.loader, self.master = loader, master
        self._options: dict[str, list[str]] = {}
        self._merged: dict[tuple[str, ...], DictConfig] = {}

    def job(self, overrides: list[str], label: str) -> Job:
        parsed = OverridesParser.create().parse_overrides(overrides)
        chosen = [o for o in parsed if self.options(o.key_or_group)]
        files = self._merge([str(o.input_line) for o in chosen])
        if all(o in chosen or _is_value(o) for o in parsed):
            config = copy.deepcopy(files)
            for override in (o for o in parsed if o not in chosen):
                OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
        else:
            config = copy.deepcopy(self._merge(overrides))
        choices = dict(config.hydra.runtime.choices)
        folder = RunFolder(f"{config.hydra.sweep.dir}/{config.hydra.sweep.subdir}")
        with open_dict(config):
            del config["hydra"]
        return Job(label, overrides, config, files, choices, folder)

    def options(self, group: str) -> list[str]:
        """The files of a group; none if it is a setting, whose name may have a dot."""
        if group not in self._options:
            dotted = "." in group
            self._options[group] = [] if dotted else self.loader.get_group_options(group)
        return self._options[group]

    def files(self, *choices: str) -> DictConfig:
        """The configuration with these choices of files."""
        return self._merge(choices)

    def _merge(self, overrides: Sequence[str]) -> DictConfig:
        """Of Hydra's own part only what names a folder is kept: jobs are copies of this."""
        key = tuple(overrides)
        if key not in self._merged:
            own = self.loader.load_sweep_config(self.master, list(overrides))
            sweep, runtime = (own.hydra[k] for k in ("sweep", "runtime"))
            raw = {"sweep": _raw(sweep), "runtime": {"choices": _raw(runtime.choices)}}
            with open_dict(own):
                del own["hydra"]
                own["hydra"] = raw
            self._merged[key] = own
        return self._merged[key]


def _raw(config: DictConfig) -> Any:
    return OmegaConf.to_container(config, resolve=False)


def _is_value(override: Override) -> bool:
    return not (override.is_add() or override.is_force_add() or override.is_delete())


def plain(config: DictConfig) -> dict[str, Any]:
    """The configuration with every reference resolved."""
    values = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items() if key != "hydra"}


def run_folder(*, _root_: DictConfig) -> str:
    """The name of a run's folder: what was run, and a digest of what shapes its result."""
    choices = _root_.hydra.runtime.choices
    nodes = {str(key): value for key, value in _root_.items() if key != "hydra"}
    values: Any = {
        key: OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
        for key, value in nodes.items()
    }
    return f"{choices.model}-{choices.system}-{digest(values)}"


def recorded_columns(kind: str, *, _root_: DictConfig) -> list[str]:
    """The names of a recording's coordinates ("q") or inputs ("u"), none without a recording.

    So the configuration of a run is whole, and a trained model is loaded without its data."""
    from symo_exp.data.header import header, names

    data = _root_.data
    if "path" not in data:
        return []
    return list(names(kind, header(data.path, data.get("columns"))))


def mechanism(kind: str, name: str | None) -> dict[str, Any]:
    """What a MuJoCo model says: that of a file ("model") or of a Gymnasium environment ("id").

    It is part of the configuration for the same reason: a run needs neither file nor MuJoCo."""
    from symo_exp.systems import mujoco

    if name is None:
        raise ConfigError("system.model has no value yet; give it one: system.model=robot.xml")
    return mujoco.mechanism(name) if kind == "model" else mujoco.environment(name)


OmegaConf.register_new_resolver("mechanism", mechanism, replace=True)
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("recorded_columns", recorded_columns, replace=True)
OmegaConf.register_new_resolver(
    "if", lambda condition, then, otherwise: then if condition else otherwise, replace=True
)
