"""What Hydra reads and merges is kept in a process: it does so anew for each command.

That takes a third of a second, up to five times in a command. Values of a command are set each
time. Processes that a test starts compose without this.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from hydra import initialize_config_dir
from hydra._internal import defaults_list
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra

from symo_exp.shipped import CONF, SWEEPS

SHIPPED = {("pkg", "hydra.conf"), ("file", str(CONF)), ("file", str(SWEEPS)), ("structured", "")}
"""Places of files that no test writes to."""


@contextmanager
def once() -> Iterator[None]:
    """Have a file read once, and files found and merged once for the same choices.

    The store of Hydra's own files, which no command changes, is not copied for each question.
    """
    with initialize_config_dir(str(CONF), version_base="1.3"):
        loader: Any = GlobalHydra.instance().config_loader()
    loaders, repositories = type(loader), type(loader.repository)
    find, merge = defaults_list._create_defaults_list, loaders._compose_config_from_defaults_list
    read = repositories.load_config
    kept: dict[object, bytes] = {}

    def once_for(key: tuple[object, ...], make: Callable[[], Any]) -> Any:
        if key not in kept:
            kept[key] = pickle.dumps(make())
        return pickle.loads(kept[key])

    def find_once(repo: Any, config_name: Any, overrides: Any, **options: Any) -> Any:
        def choices() -> dict[str, Any]:
            return {name: x for name, x in vars(overrides).items() if name != "config_overrides"}

        def found() -> Any:
            return find(repo, config_name, overrides, **options), choices()

        key = "find", _places(repo), config_name, repr(choices()), repr(options)
        files, after = once_for(key, found)
        vars(overrides).update(after)
        return files

    def merge_once(self: Any, defaults: Any, repo: Any) -> Any:
        key = "merge", _places(repo), repr(defaults)
        return once_for(key, lambda: merge(self, defaults, repo))

    def read_once(self: Any, config_path: str) -> Any:
        source = next((one for one in self.get_sources() if one.is_config(config_path)), None)
        if source is None or source.scheme() == "structured":
            return read(self, config_path)
        state: tuple[object, ...] = ()
        if source.scheme() == "file":
            name = config_path if config_path.endswith(".yaml") else f"{config_path}.yaml"
            state = _state(Path(source.path, name))
        key = ("read", source.scheme(), source.path, source.provider, config_path, *state)
        return once_for(key, lambda: read(self, config_path))

    with (
        mock.patch.object(defaults_list, "_create_defaults_list", find_once),
        mock.patch.object(loaders, "_compose_config_from_defaults_list", merge_once),
        mock.patch.object(repositories, "load_config", read_once),
        mock.patch.object(ConfigStore, "__deepcopy__", lambda store, _: store, create=True),
    ):
        yield


def _places(repo: Any) -> tuple[object, ...]:
    """Return where files are looked for, with the state of those that a test may have written."""
    places = [(source.scheme(), source.path) for source in repo.get_sources()]
    own = [
        path for place in places if place not in SHIPPED for path in Path(place[1]).rglob("*.yaml")
    ]
    return *places, *map(_state, sorted(own))


def _state(file: Path) -> tuple[object, ...]:
    found = file.stat()
    return str(file), found.st_mtime_ns, found.st_size
