"""Checks of a resolved configuration against the constructors that it names."""

from __future__ import annotations

import difflib
import functools
import inspect
import json
import math
import os
import pkgutil
import re
import tempfile
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import typing_extensions
from omegaconf import MISSING
from pydantic import ConfigDict, PydanticUserError, TypeAdapter, ValidationError
from pydantic_core import SchemaError
from typing_extensions import Unpack

from symo_exp import code
from symo_exp.errors import ConfigError, shortened
from symo_exp.job.config import PARTS, Settings
from symo_exp.job.moved import MOVED
from symo_exp.shell import override_value
from symo_exp.shipped import CONF

KINDS = {
    "system": "symo_exp.systems.base.System", "model": "symo_exp.models.base.DynamicsModel"
}  # fmt: skip
"""Classes from which those of parts inherit; to import them takes as long as to import PyTorch."""
LONGEST = 255
"""Bytes of the name of a folder, which file systems allow."""
LEAST_SPACE = 1 << 16
"""Bytes of space on the disk that every run needs."""

_INSTANTIATE_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}
_WANTED = {
    "int_type": "a whole number", "float_type": "a number", "bool_type": "true or false",
    "string_type": "text", "none_required": "null", "dict_type": "a mapping",
    "dataclass_type": "a mapping", "list_type": "a list", "tuple_type": "a list",
    "iterable_type": "a list", "named_tuple_type": "a list or a mapping",
    "callable_type": "a class (_target_)", "needs_python_object": "",
}  # fmt: skip
"""Pydantic's kinds of errors in the words of a command line; that of any class has none."""
_STRICT = ConfigDict(strict=True, arbitrary_types_allowed=True)


def check_parts(settings: Settings) -> None:
    """Refuse a configuration of which a part names no class."""
    for part in PARTS:
        node = settings.values.get(part)
        if not isinstance(node, Mapping) or "_target_" not in node:
            raise ConfigError(f"{part} names no class: its file needs a _target_")


def check_settings(
    node: Mapping[str, Any],
    known: Mapping[str, Any],
    references: Mapping[str, str],
    prefix: str = "",
) -> None:
    """Refuse settings that do not exist, have no value, or a value of the wrong type.

    A node with a ``_target_`` may hold what its constructor takes; any other node, what the files
    have at the same place. A reference is checked where it points to.

    Args:
        node: The settings of a run, or those below a name.
        known: Those of the chosen files alone, unresolved.
        references: As in ``Settings``.
        prefix: The name, with a dot.
    """
    if "_target_" in node:
        made = code.locate(node["_target_"], f"{prefix}_target_")
        _check_kind(prefix.removesuffix("."), made)
        hints = _parameters(made)
    else:
        hints = {key: bool if isinstance(x, bool) else Any for key, x in known.items()}
    for key, value in node.items():
        name = f"{prefix}{key}"
        if key not in _INSTANTIATE_KEYS:
            if key not in hints and key in known and name not in MOVED:
                raise _not_taken(key, node, hints, prefix)
            if key not in hints:
                raise unknown_key(name, {**hints, **known})
            _check_value(references.get(name, name), value, hints[key])
        if name not in references and not _free(hints.get(key)):
            files = known.get(key)
            for item in value if isinstance(value, list) else [value]:
                if isinstance(item, Mapping):
                    there = files if isinstance(files, Mapping) else {}
                    check_settings(item, there, references, f"{name}.")


def _check_value(name: str, value: Any, hint: Any) -> None:
    """Refuse a setting without a value, or with one that does not fit a type annotation.

    The constructor checks what is inside a list or a mapping.
    """
    if value == MISSING:
        raise ConfigError(f"{name} has no value yet; give it one: {name}=...")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{name}={value}: expected a finite number")
    keys = value if isinstance(value, Mapping) else ()
    if "_target_" in keys:
        return  # what a class makes is unknown
    try:
        _adapter(hint).validate_json(json.dumps(value))
    except ValidationError as error:
        found = error.errors()
        if any(isinstance(at, int) or at in keys for one in found for at in one["loc"]):
            return
        if isinstance(value, list) and all(e["type"] == "needs_python_object" for e in found):
            return  # the constructor may make an array of it
        kinds = [_wanted(one["type"], one["loc"], one["msg"]) for one in found]
        wanted = " or ".join(dict.fromkeys(filter(None, kinds))).replace("'", "")
        given = f"{name}={override_value(value)}"
        told = f"{given} has the wrong type: expected {wanted or 'a class (_target_)'}"
        raise ConfigError(told) from error


def _wanted(kind: str, place: tuple[int | str, ...], message: str) -> str:
    """Return what one of Pydantic's errors asks for."""
    if kind in ("missing", "missing_argument"):  # the latter of named tuples, in Pydantic 2.10
        return f"{place[-1]} as well"
    return _WANTED.get(kind, message.removeprefix("Input should be "))


@functools.cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    try:
        return TypeAdapter(hint, config=_STRICT)
    except (PydanticUserError, SchemaError):  # a protocol or a dataclass
        return TypeAdapter(Callable[..., Any] | None)


def _not_taken(
    key: str, node: Mapping[str, Any], hints: Mapping[str, Any], prefix: str
) -> ConfigError:
    """Return the error for a setting of a file, such as a preset, that a class does not take."""
    told = f"{prefix}{key} is set by a file, and {node['_target_']} does not take it"
    made = code.locate(node["_target_"], f"{prefix}_target_")
    if any(key in inspect.get_annotations(kind) for kind in getattr(made, "__mro__", ())):
        return ConfigError(
            f"{told}, although it has this field: write @dataclass(frozen=True, kw_only=True) "
            "above the class"
        )
    others = [k for k in node if k not in hints and k not in _INSTANTIATE_KEYS]
    mend = " ".join(f"~{prefix}{k}" for k in others if node[k] is not None)  # which Hydra deletes
    hint = did_you_mean(key, hints, prefix)
    hint += f"; to leave out what it does not take: {mend}" if mend else ""
    return ConfigError(f"{told}{hint}")


def unknown_key(name: str, there: Mapping[str, Any], maker: str | None = None) -> ConfigError:
    """Return the error for a setting that does not exist, with the closest names.

    Args:
        name: The dotted name.
        there: The settings that exist beside it.
        maker: The class that has them, if it may take others than those in its file.
    """
    if name in MOVED:
        return ConfigError(f"{name} is not a setting any more; write {MOVED[name]}=...")
    parent, dot, leaf = name.rpartition(".")
    there = {key: value for key, value in there.items() if not key.startswith("_")}
    below = [f"{s}.{leaf}" for s, v in there.items() if isinstance(v, Mapping) and leaf in v]
    hint = did_you_mean(leaf, there, f"{parent}{dot}", below)
    if not hint:
        which = f"{parent} has" if parent else "there are"
        hint = f"; {which}: {', '.join(sorted(there)) or 'nothing that can be set'}"
        if others := _choices_with(parent, leaf):
            hint = f"; it belongs to {' and '.join(others)}"
        if maker is not None:
            hint += f"; if {maker} takes it, write +{name}=..."
    return ConfigError(f"{name} is not a setting{hint} (--cfg job shows all)")


def _choices_with(group: str, key: str) -> list[str]:
    """Return the shipped choices of a group whose files have a setting, as overrides."""
    files = sorted((CONF / group).glob("*.yaml")) if group else []
    own = re.compile(rf"^{re.escape(key)}:", re.MULTILINE)
    return [f"{group}={file.stem}" for file in files if own.search(file.read_text("utf-8"))]


def did_you_mean(
    word: str, words: Iterable[str], prefix: str = "", others: Iterable[str] = ()
) -> str:
    """Return the end of a message that names the words most like one, and others."""
    close = [*difflib.get_close_matches(word, list(words), n=2), *others]
    return f"; did you mean {' or '.join(prefix + one for one in close)}?" if close else ""


def _check_kind(part: str, made: Callable[..., Any]) -> None:
    """Refuse a class that does not inherit from that of its part; a function may return any."""
    if part in KINDS and inspect.isclass(made):
        kind: type = pkgutil.resolve_name(KINDS[part])
        if not issubclass(made, kind):
            told = f"{part}._target_={made.__module__}.{made.__qualname__}"
            raise ConfigError(f"{told}: expected a class that inherits from {KINDS[part]}")


def _parameters(made: Callable[..., Any]) -> Mapping[str, Any]:
    """Return the names and type annotations of a constructor's arguments.

    Others that it takes by ``**name`` are those of the class that it inherits from, as a rule.
    """
    try:
        signature = inspect.signature(made, eval_str=True)
    except (NameError, TypeError):  # names that only a type checker imports
        signature = inspect.signature(made)
    hints: dict[str, Any] = {}
    for p in signature.parameters.values():
        known = p.annotation is not p.empty and not isinstance(p.annotation, str)
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY):
            hints[p.name] = p.annotation if known else Any
        elif p.kind is p.VAR_KEYWORD and typing_extensions.get_origin(p.annotation) is Unpack:
            hints |= typing_extensions.get_type_hints(*typing.get_args(p.annotation))
        elif p.kind is p.VAR_KEYWORD and inspect.isclass(made):
            _, *others = (kind for kind in made.__mro__[:-1] if "__init__" in vars(kind))
            hints = {**(_parameters(others[0]) if others else {}), **hints}
    return hints


def _free(hint: Any) -> bool:
    """Return whether a setting is a mapping whose keys are the user's."""
    kinds = {typing.get_origin(option) for option in (hint, *typing.get_args(hint))}
    return Mapping in kinds


def check_names(output_dir: Any, experiment: Any, folder: Any) -> None:
    """Refuse names of folders that are empty or climb out of the output folder."""
    names = {"output_dir": output_dir, "experiment": experiment, "hydra's dir": folder}
    for name, value in names.items():
        if not isinstance(value, str) or not value or "\0" in value:
            plain = isinstance(value, int | float)
            hint = f"; if it is, give \"{name}='{value}'\"" if plain else ""
            raise ConfigError(f"{name}={value!r} is not the name of a folder{hint}")
        if any(len(os.fsencode(part)) > LONGEST for part in Path(value).parts):
            raise ConfigError(f"{name}={shortened(value, 40)}... is longer than {LONGEST} bytes")
    for part in experiment.split("/"):
        if not part or part.startswith(".") or not part.isprintable():
            raise ConfigError(
                f"experiment={experiment!r} names a folder below output_dir: expected printable "
                "parts divided by /, none of which is empty or begins with a dot"
            )


def check_folder(folder: Path) -> None:
    """Refuse an output folder that cannot be made or written."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(bytes(LEAST_SPACE))
    except OSError as error:
        raise ConfigError(
            f"output folder {folder}: {there} cannot be written ({error.strerror}); "
            "choose another output_dir"
        ) from error
