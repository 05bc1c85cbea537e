"""A composed configuration held against the constructors that it names."""

from __future__ import annotations

import difflib
import inspect
import pkgutil
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from symo_exp.errors import ConfigError

ALLOWED = ("symo_exp", "torch", "lightning")
"""The packages a ``_target_`` may name: a configuration is data and must not run anything else."""

_INSTANTIATE_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}


def check_nodes(config: DictConfig, known: DictConfig | None, path: str = "") -> None:
    """Every key and the type of every value below ``config``.

    A node with a ``_target_`` may hold what its constructor takes; any other node, what the
    files of the configuration (``known``) hold at the same place.
    """
    target = config.get("_target_")
    parameters = None if target is None else _parameters(target, path)
    for key in config:
        name = f"{path}.{key}" if path else str(key)
        if parameters is None:
            if known is None or key not in known:
                raise unknown_key(name, siblings=[] if known is None else map(str, known))
        elif key not in _INSTANTIATE_KEYS:
            if key not in parameters:
                raise unknown_key(name, siblings=parameters)
            _check_type(name, config, str(key), parameters[str(key)])
        if OmegaConf.is_interpolation(config, key):
            continue  # checked where it points to
        value = config[key]
        below = known.get(key) if isinstance(known, DictConfig) else None
        for item in value if isinstance(value, ListConfig) else [value]:
            if isinstance(item, DictConfig):
                check_nodes(item, below if isinstance(below, DictConfig) else None, name)


def unknown_key(name: str, siblings: Iterable[str], everything: Iterable[str] = ()) -> ConfigError:
    """The error for a setting that does not exist, with what may have been meant."""
    parent, _, leaf = name.rpartition(".")
    siblings = sorted(set(siblings))
    meant = [f"{parent}.{s}" if parent else s for s in closest(leaf, siblings)]
    meant += [other for other in everything if other.rpartition(".")[2] == leaf]
    hint = f"did you mean {' or '.join(meant)}?" if meant else f"{parent or 'there'} has: "
    if not meant:
        hint += ", ".join(siblings) or "nothing that can be set"
    return ConfigError(f"{name} is not a setting; {hint} (--cfg job shows all)")


def closest(word: str, words: Iterable[str]) -> list[str]:
    return difflib.get_close_matches(word, list(words), n=2, cutoff=0.6)


def _parameters(target: str, path: str) -> Mapping[str, Any]:
    """Names and type hints of what the constructor takes."""
    made = _locate(target, path)
    call = made.__init__ if inspect.isclass(made) else made  # type: ignore[misc]
    names = [
        p.name
        for p in inspect.signature(made).parameters.values()
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    ]
    try:
        hints = typing.get_type_hints(call)
    except (NameError, TypeError):  # names that only a type checker imports
        hints = {}
    return {name: hints.get(name, Any) for name in names}


def _locate(target: str, path: str) -> Callable[..., Any]:
    where = f"{path}._target_" if path else "_target_"
    allowed = f"it may name something of {', '.join(ALLOWED)}"
    if target.partition(".")[0] not in ALLOWED:
        raise ConfigError(f"{where}={target} is refused: {allowed}")
    try:
        made = pkgutil.resolve_name(target)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"{where}={target} cannot be found: {error}") from error
    home = str(getattr(made, "__module__", "")).partition(".")[0]
    ours = home == "symo_exp" and callable(made)
    if not ours and not (home in ALLOWED and inspect.isclass(made)):
        raise ConfigError(f"{where}={target} is refused: {allowed}, and a class")
    return made  # type: ignore[no-any-return]


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
    if hint in (bool, str):
        return isinstance(value, hint)
    if hint is type(None):
        return value is None
    return value is not None or hint is Any or not inspect.isclass(hint)


def describe(hint: Any) -> str:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(describe(option) for option in typing.get_args(hint))
    if origin is typing.Literal:
        return " or ".join(str(option) for option in typing.get_args(hint))
    words = {bool: "true or false", int: "a whole number", float: "a number", str: "a word"}
    if hint is type(None):
        return "null"
    return words.get(hint) or getattr(hint, "__name__", str(hint))


def _spell(value: Any) -> str:
    return {None: "null", True: "true", False: "false"}.get(value, str(value))
