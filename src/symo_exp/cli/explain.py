"""Errors of Hydra and OmegaConf as one line with the closest names."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    ConfigTypeError,
    OmegaConfBaseException,
)
from yaml import YAMLError

from symo_exp.errors import ConfigError, first_line, one_line
from symo_exp.job.checks import did_you_mean, similar, unknown_key
from symo_exp.job.config import unresolved
from symo_exp.shell import install_command, override_value
from symo_exp.shipped import CONF, SWEEPS

BAD_INPUT = HydraException, OmegaConfBaseException, YAMLError, RecursionError, ValueError
"""Errors caused by an invalid command or configuration file, ``ConfigError`` among them."""
EXTRAS = {"submitit": ("submitit_slurm", "cluster"), "optuna": ("optuna", "optuna")}
"""By the prefix of a choice: a choice that its installed extra provides, and the extra."""

TWICE = re.compile(r"Multiple values for (\S+)\. |(\S+) appears more than once in the final")
"""Hydra's errors of a group that is given a second choice."""

CHOICES = "hydra.runtime.choices."


def explained(error: BaseException) -> ConfigError:
    """Return an error of a command or a configuration file as a ``ConfigError``."""
    if isinstance(error, RecursionError):
        return ConfigError("a configuration file refers to itself, by an anchor or in its defaults")
    if isinstance(error, UnicodeDecodeError):
        return ConfigError(f"a configuration file is not UTF-8 text: {error}")
    cause: BaseException | None = error
    while cause is not None:
        if told := _explained_alone(cause):
            return told
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, OmegaConfBaseException) and error.full_key:
        return ConfigError(f"{error.full_key}: {first_line(error)}")
    return ConfigError(one_line(error))


def _explained_alone(error: BaseException) -> ConfigError | None:
    """Return the refusal that one error of a chain means, ``None`` for any other error."""
    if isinstance(error, ConfigError):
        return error
    if twice := TWICE.match(str(error)):
        (group,) = filter(None, twice.groups())
        return ConfigError(f"+{group}=...: {group} has a choice already; leave out the +")
    if isinstance(error, OverrideParseException):
        return _unreadable_value(error)
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _unknown_choice(error.missing_cfg_file, error.options)
    if isinstance(error, ConfigAttributeError | ConfigKeyError):
        name, parent = error.full_key, error.parent_node
        if name and name.startswith(CHOICES):
            group = name.removeprefix(CHOICES)
            return ConfigError(f"{group} is one choice, and cannot be a list: {group}=NAME")
        if name and isinstance(parent, DictConfig):
            groups = [] if "." in name else [x.name for x in CONF.iterdir() if x.is_dir()]
            there = dict.fromkeys(groups) | unresolved(parent)
            return unknown_key(name, there, there.get("_target_"))
    if isinstance(error, ConfigTypeError) and error.full_key and "merge" in str(error):
        wanted, given = ("list", "mapping") if error.object_type is list else ("mapping", "list")
        return ConfigError(f"{error.full_key} is a {wanted}, and cannot be a {given}")
    return None


def _unreadable_value(error: OverrideParseException) -> ConfigError:
    """Return the error for a setting that Hydra cannot parse, such as a name with brackets."""
    key, _, value = str(error.override).partition("=")
    if re.search(r"\s\S+=", value):
        return ConfigError(f"{error.override}: give each setting as a word of its own")
    quoted = shlex.quote(f"{key}={override_value([value])[1:-1]}")
    return ConfigError(
        f"{error.override}: {first_line(error)}; a text with brackets, quotes, commas or the like "
        f"needs quotes of its own: {quoted}"
    )


def _unknown_choice(file: str, options: Sequence[str] | None) -> ConfigError:
    """Return the error for a missing configuration file, ``group/value`` or the name of a sweep."""
    group, _, value = file.removesuffix(".yaml").rpartition("/")
    if not group:
        sweeps = sorted(sweep.stem for sweep in SWEEPS.glob("*.yaml"))
        told = f"there is no {value}.yaml; the sweeps are: {', '.join(sweeps)}"
        return ConfigError(f"{told}{did_you_mean(similar(value, sweeps))}")
    if not options:  # of a list of choices, such as study=[forced,drift]
        options = sorted(choice.stem for choice in (CONF / group).glob("*.yaml"))
    for prefix, (needed, extra) in EXTRAS.items():
        if group.startswith("hydra/") and value.startswith(prefix) and needed not in options:
            return ConfigError(f"{group}={value} needs a package: {install_command(extra)}")
    hint = did_you_mean(similar(value, options))
    return ConfigError(f"{group}={value} is not a choice; possible: {', '.join(options)}{hint}")
