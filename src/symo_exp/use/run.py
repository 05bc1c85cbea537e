"""Runs from Python, equal to those of the command line."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from symo_exp import code as own
from symo_exp.checks import path_text
from symo_exp.cli.command import Command, execute_all
from symo_exp.errors import ConfigError
from symo_exp.models.base import DynamicsModel
from symo_exp.runs.folder import LOG, MEASURES, PARAMETERS, PICTURES, ROLLOUTS, RunFolder
from symo_exp.runs.load import require_run
from symo_exp.shell import override_value
from symo_exp.sweep.sweeper import watched
from symo_exp.tracking.load import load


class Run:
    """A finished run, by its folder.

    Args:
        folder: The folder.
        code: A folder with the user's own classes of a system or a method, as ``load`` takes it.
    """

    def __init__(
        self, folder: str | os.PathLike[str], *, code: str | os.PathLike[str] | None = None
    ) -> None:
        own.add(code)
        path = Path(path_text("Run", folder, "the folder of a run")).expanduser()
        require_run(path)
        self.folder = path.absolute()

    def __repr__(self) -> str:
        return f"Run({os.path.relpath(self.folder)!r})"

    def __fspath__(self) -> str:
        return str(self.folder)

    @cached_property
    def model(self) -> DynamicsModel:
        """The trained model: ``symo_exp.load``."""
        return load(self.folder)

    @cached_property
    def measures(self) -> dict[str, float]:
        """Measures by name, those of studies included: docs/metrics.md."""
        folder = RunFolder(self.folder)
        if folder.outcome().status != "finished":  # with measures=false there are none
            self._file(MEASURES)
        if folder.has_damaged_measures():
            told = "is damaged; give the command of the run again, which computes it anew"
            raise ConfigError(f"{self.folder / MEASURES} {told}")
        return folder.measures()

    @cached_property
    def rollouts(self) -> pd.DataFrame:
        """Predicted and true motions, a row per node."""
        return pd.read_parquet(self._file(ROLLOUTS))

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Physical parameters, a row each: docs/uncertainty.md; empty if the model has none."""
        path = self.folder / PARAMETERS
        if not path.exists():
            self._file(MEASURES)  # both are written at the end
            return pd.DataFrame()
        return pd.read_csv(path)

    def figure(self, name: str) -> Image.Image:
        """Return a picture of the run by name, such as ``trajectories`` or ``phase_portrait``."""
        found = {path.stem: path for path in sorted((self.folder / PICTURES).glob("*"))}
        if name not in list(found):  # a name that is no text may have no hash
            there = ", ".join(found) or "none, as with pictures=false or before it has finished"
            raise ConfigError(f"there is no figure {name}; the run has: {there}")
        return Image.open(found[name])

    def _file(self, name: str) -> Path:
        """Return a file of the run; refuse one that is not there."""
        path = self.folder / name
        if not path.is_file():
            outcome = RunFolder(self.folder).outcome()
            raise ConfigError(f"{path} does not exist; the status of the run is {outcome.status!r}")
        return path


def run(*words: str, **settings: Any) -> Run | list[Run]:
    """Run the command ``python -m symo_exp WORDS`` in this process.

    A run that is finished already is not repeated::

        symo_exp.run("model=symo", "data.n_traj=16")
        symo_exp.run(model="symo", **{"data.n_traj": 16})

    Args:
        *words: Words of the command line.
        **settings: Settings and choices of files by name; numbers, truth values, ``None``, lists,
            arrays, dictionaries and paths are written as on the command line, strings are
            unchanged.

    Returns:
        The run; with ``-m``, or if ``-cn NAME`` makes several, a list of all runs in order.

    Raises:
        ConfigError: For invalid input, before anything runs.
        RuntimeError: If a run fails.
        KeyboardInterrupt: If it is interrupted.
    """
    for word in words:
        if not isinstance(word, str):
            raise ConfigError(f"run({word!r}): expected words of a command, as run('model=symo')")
    command = Command(
        [*words, *(f"{key}={override_value(value)}" for key, value in settings.items())]
    )
    if not command.runs:
        raise ConfigError(f"{' '.join(command.options)}: expected a command that starts a run")
    commands = command.checked()
    with watched() as folders:
        codes = execute_all(commands)
    if any(code > 128 for code in codes):
        raise KeyboardInterrupt
    for folder in folders:
        outcome = folder.outcome()
        if outcome.status != "finished":
            raise RuntimeError(f"{folder} {outcome.status}: {outcome.reason} ({folder / LOG})")
    runs = [Run(folder.path) for folder in folders]
    return runs[0] if len(runs) == 1 and not command.multirun else runs
