"""A composed configuration held against the constructors that it names."""

from __future__ import annotations

import difflib
import inspect
import pkgutil
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePath
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from symo_exp import code
from symo_exp.errors import ConfigError
from symo_exp.job.moved import MOVED

ALLOWED = ("symo_exp", "torch", "lightning")
"""The packages a ``_target_`` may name besides those of ``code=FOLDER``: a configuration is data
and must not run anything else."""

_INSTANTIATE_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}


PARTS = ("system", "data", "model", "learner", "trainer", "logger")
"""What every run is made of: each of them names a class."""


def check(config: DictConfig, files: DictConfig) -> None:
    """Refuse a configuration that names no such parts, or gives them other settings.

    Args:
        config: The configuration of a run.
        files: The configuration that its choices of files alone would give.
    """
    code.add(config.code)
    check_parts(config)
    check_nodes(config, files)


def check_parts(config: DictConfig) -> None:
    """Every part is there, with the class that makes it."""
    for part in PARTS:
        node = config.get(part)
        if not isinstance(node, DictConfig) or "_target_" not in node:
            raise ConfigError(f"{part} names no class: its file needs a _target_")


def check_nodes(config: DictConfig, known: DictConfig | None, path: str = "") -> None:
    """Every key and the type of every value below ``config``.

    A node with a ``_target_`` may hold what its constructor takes; any other node, what the
    files of the configuration (``known``) hold at the same place.
    """
    target = config.get("_target_")
    if "_target_" in config and not isinstance(target, str):
        raise ConfigError(f"{path}._target_={target} is no name of a class")
    parameters = None if target is None else _parameters(target, path)
    for key in map(str, config):
        name = f"{path}.{key}" if path else key
        if parameters is None:
            if known is None or not has(known, key):
                raise unknown_key(name, siblings=[] if known is None else map(str, known))
            if isinstance(known.get(key), bool) and not isinstance(config[key], bool):
                raise ConfigError(f"{name}={_spell(config[key])} has to be true or false")
        elif key not in _INSTANTIATE_KEYS:
            if key not in parameters:
                raise unknown_key(name, siblings=parameters)
            if OmegaConf.is_missing(config, key):
                raise ConfigError(f"{name} has no value yet; give it one: {name}=...")
            _check_type(name, config, key, parameters[key])
        if OmegaConf.is_interpolation(config, key):
            continue  # checked where it points to
        value = config[key]
        if parameters is not None and _free(parameters.get(key)):
            continue
        below = known.get(key) if known is not None and key in known else None
        for item in value if isinstance(value, ListConfig) else [value]:
            if isinstance(item, DictConfig):
                check_nodes(item, below if isinstance(below, DictConfig) else None, name)


def unknown_key(name: str, siblings: Iterable[str], everything: Iterable[str] = ()) -> ConfigError:
    """The error for a setting that does not exist, with what may have been meant."""
    if name in MOVED:
        return ConfigError(f"{name} is not a setting any more; write {MOVED[name]}=...")
    parent, _, leaf = name.rpartition(".")
    siblings = sorted(set(siblings))
    meant = [f"{parent}.{s}" if parent else s for s in closest(leaf, siblings)]
    meant += [other for other in everything if other.rpartition(".")[2] == leaf]
    hint = f"did you mean {' or '.join(meant)}?" if meant else f"{parent or 'there'} has: "
    if not meant:
        hint += ", ".join(siblings) or "nothing that can be set"
    return ConfigError(f"{name} is not a setting; {hint} (--cfg job shows all)")


def has(config: DictConfig, key: str) -> bool:
    """Whether the key is there, if only waiting for a value (``???``)."""
    return key in config or OmegaConf.is_missing(config, key)


def closest(word: str, words: Iterable[str]) -> list[str]:
    return difflib.get_close_matches(word, list(words), n=2, cutoff=0.6)


def _parameters(target: str, path: str) -> Mapping[str, Any]:
    """Names and type hints of what the constructor takes.

    One that takes ``**base`` hands it to the constructor of the class above.
    """
    made = _locate(target, path)
    calls: list[Callable[..., Any]] = [made]
    if inspect.isclass(made) and made.__init__ is not object.__init__:
        calls = [vars(c)["__init__"] for c in made.__mro__ if "__init__" in vars(c)]
    hints: dict[str, Any] = {}
    for call in calls:
        parameters = inspect.signature(call).parameters.values()
        types_ = _hints(call)
        for p in parameters:
            if p.name != "self" and p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY):
                hints.setdefault(p.name, types_.get(p.name, Any))
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            break
    return hints


def _hints(call: Callable[..., Any]) -> dict[str, Any]:
    try:
        return typing.get_type_hints(call)
    except (NameError, TypeError):  # names that only a type checker imports
        return {}


def _free(hint: Any) -> bool:
    """Whether a setting is a mapping whose keys are the user's."""
    kinds = {typing.get_origin(option) for option in (hint, *typing.get_args(hint))}
    return Mapping in kinds


def _locate(target: str, path: str) -> Callable[..., Any]:
    where = f"{path}._target_" if path else "_target_"
    packages = (*ALLOWED, *code.modules())
    allowed = f"it may name something of {', '.join(packages)}"
    if target.partition(".")[0] not in packages:
        raise ConfigError(f"{where}={target} is refused: {allowed} (your own: code=FOLDER)")
    try:
        made = pkgutil.resolve_name(target)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"{where}={target} cannot be found: {error}") from error
    home = str(getattr(made, "__module__", "")).partition(".")[0]
    ours = callable(made) and (home == "symo_exp" or code.owns(made))
    if not ours and not (home in ALLOWED and inspect.isclass(made)):
        raise ConfigError(f"{where}={target} is refused: {allowed}, and a class")
    return typing.cast("Callable[..., Any]", made)


def _check_type(name: str, config: DictConfig, key: str, hint: Any) -> None:
    value = config[key]
    if conforms(value, hint):
        return
    raw = OmegaConf.to_container(config, resolve=False)
    assert isinstance(raw, dict)
    source = raw[key]
    if isinstance(source, str) and source.startswith("${") and source.endswith("}"):
        name = source[2:-1]
    raise ConfigError(f"{name}={_spell(value)} has the wrong type: {describe(hint)} is wanted")


def conforms(value: Any, hint: Any) -> bool:
    """Whether a scalar fits its annotation; structures are left to the constructor."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return any(conforms(value, option) for option in typing.get_args(hint))
    if origin is typing.Literal:
        return value in typing.get_args(hint)
    if isinstance(value, DictConfig | ListConfig):
        return hint not in (bool, int, float, str, type(None))
    if hint is float:
        return isinstance(value, float | int) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is type(None) or value is None:
        return value is None and hint in (type(None), Any)
    if hint is Any:
        return True
    if inspect.isclass(hint):  # no word or number is an object of any other class
        return isinstance(value, hint) or (isinstance(value, str) and issubclass(hint, PurePath))
    return True


def describe(hint: Any) -> str:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(describe(option) for option in typing.get_args(hint))
    if origin is typing.Literal:
        return " or ".join(str(option) for option in typing.get_args(hint))
    words = {bool: "true or false", int: "a whole number", float: "a number", str: "a word"}
    if hint is type(None):
        return "null"
    return str(words.get(hint) or getattr(hint, "__name__", hint))


def _spell(value: Any) -> str:
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)
