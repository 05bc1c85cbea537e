"""The request for a search: its settings, checked, and the recorded machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from symo_exp.checks import real
from symo_exp.errors import ConfigError
from symo_exp.identify.recordings import Machine, examine
from symo_exp.process import phases
from symo_exp.sweep.sweeper import Sweep
from symo_exp.systems.base import System
from symo_exp.systems.recorded import scale_of

FILES = [
    "path", "columns", "wrapped", "degrees", "time_unit", "sample_time", "train", "val", "test",
    "n_val", "n_test", "leave_out", "input_delay", "input_lag",
]  # fmt: skip
"""Settings of data that say where recordings are and how they are read."""
INFERRED = {"wrapped", "degrees", "input_delay", "input_lag"}
"""Those whose defaults stand for nothing: they are inferred where they are not given."""

NEEDED = {
    "data": ("data.wrapped", "learns from recordings"),
    "model": ("model.dissipation", "compares Lagrangians and friction"),
    "objective": ("learner.validation.iterations", "estimates the noise of recordings"),
    "optimizer": ("optimizer.starts", "estimates the noise of recordings in stages"),
}
"""By group: a setting that its choice has to have, and why."""
OWN = {
    "data.monitor": ("val", "holds out folds itself"),
    "data.fold": (None, "holds out folds itself"),
    "start_from": (None, "compares models that are trained anew"),
}
"""Settings of a search that cannot have other values, with these and the reason."""


class Request:
    """The settings of a search.

    Args:
        sweep: Performs the runs.
        master: The composed configuration.
        given: Overrides of the command line by what they set.

    Raises:
        ConfigError: For choices of files, and settings, with which nothing can be searched.
    """

    def __init__(self, sweep: Sweep, master: DictConfig, given: Mapping[str, str]) -> None:
        self._sweep, self._master, self._given = sweep, master, given
        for group, (name, reason) in NEEDED.items():
            above, _, setting = name.rpartition(".")
            if setting not in list(OmegaConf.select(master, above) or ()):
                raise self._unsuitable(name, group, reason)
        for name, (value, reason) in OWN.items():
            if OmegaConf.select(master, name) != value:
                raise self._unsuitable(name, "data", reason)

    def machine(self) -> Machine:
        """Read the recordings and return the machine that they show.

        Raises:
            ConfigError: If they, or settings of how they are read, do not allow it.
        """
        phases.say("reading the recordings")
        data = self._master.data
        if OmegaConf.is_missing(data, "path"):
            raise ConfigError("data.path has no value yet; give it one: data.path=FILE")
        system = self._master.system
        known = self._known()
        chosen = "system.time_step" in self._given or (
            known is None and not OmegaConf.is_missing(system, "time_step")
        )
        read = {name: plain_value(data.get(name)) for name in FILES}
        for name in INFERRED - {key.removeprefix("data.") for key in self._given}:
            read[name] = None
        return examine(
            read,
            angular=plain_value(system.get("angular")),
            input_matrix=plain_value(system.get("input_matrix")),
            time_step=real("system.time_step", system.time_step, above=0) if chosen else None,
            rotations=plain_value(system.get("rotations", [])),
            scale={} if known else self._scale(),
            known=known,
        )

    def _scale(self) -> dict[str, float]:
        """Return the units of parameters that are given."""
        units = scale_of(plain_value(self._master.system.scale))._asdict()
        given = self._given.keys()
        return {x: units[x] for x in units if {"system.scale", f"system.scale.{x}"} & given}

    def _known(self) -> System | None:
        """Return the system if its equations are known, ``None`` if its recordings alone are.

        Raises:
            ConfigError: If it has no constants that can be learned.
        """
        if "scale" in self._master.system:
            return None
        system = self._sweep.system()
        if getattr(system, "constants", None):
            return system
        raise self._unsuitable("system.scale", "system", "learns the constants of known equations")

    def _unsuitable(self, name: str, group: str, reason: str) -> ConfigError:
        """Return the error of the word of the command line that decides a setting."""
        parts = name.split(".")
        above = [".".join(parts[:end]) for end in range(len(parts), 0, -1)]
        chosen = f"{group}={self._master.hydra.runtime.choices[group]}"
        words = [self._given[key] for key in (*above, group, "preset") if key in self._given]
        word = next(iter(words), chosen)
        mend = "leave it out"
        if word == chosen:
            mend = f"possible: {', '.join(self._sweep.composer.choices_with(group, name))}"
        return ConfigError(f"{word} does not suit a search, which {reason}; {mend}")


def plain_value(value: Any) -> Any:
    """Return a setting without the containers of OmegaConf."""
    return OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
