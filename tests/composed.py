"""Compositions of a process, made once: Hydra reads and merges every file anew for each command.

That takes a third of a second, up to five times in a command. Processes that a test starts compose
without this.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.utils import JobRuntime
from hydra.types import RunMode
from omegaconf import open_dict

from symo_exp.shipped import CONF, SWEEPS

SHIPPED = {("pkg", "hydra.conf"), ("file", str(CONF)), ("file", str(SWEEPS)), ("structured", "")}
"""Folders that no test writes to."""


@contextmanager
def once() -> Iterator[None]:
    """Have a file read once and the files that ship merged once for the same words.

    The store of Hydra's own files, which no command changes, is not copied for each question.
    """
    with initialize_config_dir(str(CONF), version_base="1.3"):
        loader: Any = GlobalHydra.instance().config_loader()
    loaders, repositories = type(loader), type(loader.repository)
    compose, read = loaders.load_configuration, repositories.load_config
    composed: dict[bytes, bytes] = {}
    files: dict[tuple[Any, ...], bytes] = {}

    def compose_once(self: Any, config_name: Any, overrides: list[str], **options: Any) -> Any:
        sources = [(source.scheme(), source.path) for source in self.repository.get_sources()]
        if not SHIPPED.issuperset(sources) or any("searchpath" in word for word in overrides):
            return compose(self, config_name, overrides, **options)
        name, told = JobRuntime.instance().get("name"), {**options}
        if options["run_mode"] == RunMode.MULTIRUN and not any("hydra" in x for x in overrides):
            told.pop("validate_sweep_overrides", None)  # which validates settings of Hydra only
        key = pickle.dumps((config_name, overrides, sorted(told.items()), sources, name))
        if key not in composed:
            composed[key] = pickle.dumps(compose(self, config_name, overrides, **options))
        config = pickle.loads(composed[key])
        with open_dict(config.hydra):
            config.hydra.runtime.cwd = os.getcwd()
        return config

    def read_once(self: Any, config_path: str) -> Any:
        source = next((one for one in self.get_sources() if one.is_config(config_path)), None)
        if source is None or source.scheme() == "structured":
            return read(self, config_path)
        state: tuple[int, ...] = ()
        if source.scheme() == "file":
            name = config_path if config_path.endswith(".yaml") else f"{config_path}.yaml"
            file = Path(source.path, name).stat()
            state = file.st_mtime_ns, file.st_size
        key = (source.scheme(), source.path, source.provider, config_path, *state)
        if key not in files:
            files[key] = pickle.dumps(read(self, config_path))
        return pickle.loads(files[key])

    with (
        mock.patch.object(loaders, "load_configuration", compose_once),
        mock.patch.object(repositories, "load_config", read_once),
        mock.patch.object(ConfigStore, "__deepcopy__", lambda store, _: store, create=True),
    ):
        yield
