"""Errors of Hydra and OmegaConf as one line with the closest names."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Iterable
from typing import Any

from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    MissingConfigException,
    OverrideParseException,
)
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    InterpolationKeyError,
    InterpolationResolutionError,
    OmegaConfBaseException,
)
from yaml import YAMLError

from symo_exp.errors import ConfigError, first_line, one_line
from symo_exp.job.checks import did_you_mean, unknown_key
from symo_exp.job.config import unresolved
from symo_exp.shell import install_command, override_value
from symo_exp.shipped import CONF, SWEEPS

BAD_INPUT = HydraException, OmegaConfBaseException, YAMLError, RecursionError, ValueError
"""Errors caused by an invalid command or configuration file, ``ConfigError`` among them."""
EXTRAS = {"submitit": ("submitit_slurm", "cluster"), "optuna": ("optuna", "optuna")}
"""By the prefix of a choice: a choice that its installed extra provides, and the extra."""


def explained(error: BaseException) -> ConfigError:
    """Return an error of a command or a configuration file as a ``ConfigError``."""
    cause: BaseException | None = error
    while cause is not None:
        for kind, explain in EXPLAINED.items():
            if isinstance(cause, kind) and (told := explain(cause)):
                return told
        cause = cause.__cause__ or cause.__context__
    text = one_line(error).partition(" full_key: ")[0]
    if isinstance(error, OmegaConfBaseException) and error.full_key:
        text = f"{error.full_key}: {first_line(error)}"
    return ConfigError(text.replace("DictConfig", "a mapping").replace("ListConfig", "a list"))


def _unknown_setting(error: ConfigKeyError | ConfigAttributeError) -> ConfigError | None:
    """Return the error for a setting that does not exist."""
    name, parent = error.full_key, error.parent_node
    if not name or not isinstance(parent, DictConfig):
        return None
    groups = [] if "." in name else [x.name for x in CONF.iterdir() if x.is_dir()]
    there = dict.fromkeys(groups) | unresolved(parent)
    return unknown_key(name, there, there.get("_target_"))


def _no_setting(error: InterpolationKeyError) -> ConfigError | None:
    """Return the error for a setting that others refer to and that does not exist."""
    if found := re.search(r"Interpolation key '(\S+)' not found", str(error)):
        name = found[1]
        told = f"{error.full_key} refers to {name}, which is not a setting or deleted by ~{name}"
        return ConfigError(f"{told} (--cfg job shows all)")
    return None


def _no_settings(error: InterpolationResolutionError) -> ConfigError | None:
    """Return the error for a value instead of settings that others refer to."""
    found = re.search(r"trying to access (\S+): node `(\S+)` is not a container", str(error))
    if found is None:
        return None
    setting, node = found.groups()
    return ConfigError(
        f"{node} is not one value: {error.full_key} is that of {setting}; give the settings of "
        f"{node}, such as {setting}=... (--cfg job shows all)"
    )


def _wrong_sign(error: ConfigCompositionException) -> ConfigError | None:
    """Return the error for a ``~`` before what is not there so, a ``+`` before what is there."""
    if found := re.search(r"delete from config. '(\S+)' does not exist", str(error)):
        name = found[1]
        return ConfigError(f"~{name}: {name} is not a setting (--cfg job shows all)")
    if found := re.search(r"value of '(\S+)' is (.*) and not (.*)\.$", str(error)):
        name, value, other = found.groups()
        return ConfigError(f"~{name}={other}: its value is {value}; write ~{name}")
    if found := re.search(r"Either remove \+ prefix: '(.*)'", str(error)):
        word = found[1]
        name = word.partition("=")[0]
        return ConfigError(f"+{word}: {name} has a value already; leave out the +")
    return None


def _unreadable_value(error: OverrideParseException) -> ConfigError:
    """Return the error for a word that Hydra cannot parse, such as a name with brackets."""
    word = str(error.override)
    key, equals, value = word.partition("=")
    if not equals:
        mend = f"data.path={word}" if os.path.exists(word) else f"{word or 'NAME'}=..."
        return ConfigError(f"{word!r} is not a setting with a value: write {mend}")
    if "," in key:
        return ConfigError(
            f"{word}: a command gives one setting in a word, and every combination of their values "
            f"runs; to vary {key} together, write a file like {SWEEPS / 'tables.yaml'}"
        )
    if re.search(r"^,|,,|,$", value):
        return ConfigError(f"{word}: a value is missing at a comma; write {key}=A,B without spaces")
    if re.search(r"\s\S+=", value):
        return ConfigError(f"{word}: give each setting as a word of its own")
    quoted = shlex.quote(f"{key}={override_value([value])[1:-1]}")
    return ConfigError(
        f"{word}: {first_line(error)}; a text with brackets, quotes, commas or the like needs "
        f"quotes of its own: {quoted}"
    )


def _missing_file(error: MissingConfigException) -> ConfigError | None:
    """Return the error for a missing configuration file, of a group or of a sweep."""
    file, options = error.missing_cfg_file or "", error.options or ()
    group, _, value = file.removesuffix(".yaml").rpartition("/")
    for prefix, (needed, extra) in EXTRAS.items():
        if group.startswith("hydra/") and value.startswith(prefix) and needed not in options:
            return ConfigError(f"{group}={value} needs a package: {install_command(extra)}")
    if not (CONF / group).is_dir():
        group = ""  # the path of a sweep
    return unknown_choice(f"{group}={value}" if group else file, group, options) if file else None


def unknown_choice(word: str, group: str, options: Iterable[str] = ()) -> ConfigError:
    """Return the error for a choice that a group does not have, with the closest names.

    Args:
        word: The override.
        group: The name of the group; empty: the sweeps.
        options: Its choices, if Hydra told them; else those that ship.
    """
    folder = CONF / group if group else SWEEPS
    options = options or sorted(choice.stem for choice in folder.glob("*.yaml"))
    value = word.partition("=")[2] if group else word
    told = f"{word} is not a choice; possible: {', '.join(options)}"
    return ConfigError(f"{told}{did_you_mean(value, options)}")


EXPLAINED: dict[type[BaseException], Callable[[Any], ConfigError | None]] = {
    ConfigError: lambda error: error,
    RecursionError: lambda _: ConfigError(
        "a configuration file refers to itself, by an anchor or in its defaults"
    ),
    UnicodeDecodeError: lambda e: ConfigError(f"a configuration file is not UTF-8 text: {e}"),
    OverrideParseException: _unreadable_value,
    ConfigCompositionException: _wrong_sign,
    MissingConfigException: _missing_file,
    InterpolationKeyError: _no_setting,
    InterpolationResolutionError: _no_settings,
    ConfigKeyError: _unknown_setting,
    ConfigAttributeError: _unknown_setting,
}
"""How a kind of error in a chain is told; ``None``: another error of the chain tells it."""
