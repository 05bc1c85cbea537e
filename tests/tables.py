"""All choices of the configuration groups; a new file is tested without further work."""

from functools import cache
from typing import Any

from hydra.utils import instantiate
from omegaconf import OmegaConf

from symo_exp.runs.instances import arguments_of as arguments_of
from symo_exp.shipped import CONF
from symo_exp.systems import table
from symo_exp.systems.table import system


@cache
def choices(group: str) -> list[str]:
    """Names of the choices of a group."""
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


@cache
def _integrators(kind: str) -> dict[str, Any]:
    found = {}
    for name in choices("integrator"):
        config = OmegaConf.load(CONF / "integrator" / f"{name}.yaml")
        if config.get(kind) is not None:
            found[name] = instantiate(config[kind])
    return found


def explicit_integrators() -> dict[str, Any]:
    """Name to Runge-Kutta method."""
    return _integrators("explicit")


@cache
def variational_integrators() -> dict[str, Any]:
    """Name to variational integrator, of rollouts and at convergence, as for measures."""
    found = _integrators("variational")
    return {name: rule.of_rollouts().converged() for name, rule in found.items()}


def stated(name: str) -> dict[str, Any]:
    """Return the settings in the file of a system."""
    settings: Any = OmegaConf.to_container(OmegaConf.load(CONF / "system" / f"{name}.yaml").system)
    return settings


@cache
def systems() -> dict[str, Any]:
    """Name to system, of those whose equations are known."""
    return {name: system(name) for name in known_systems()}


@cache
def known_systems() -> list[str]:
    """Names of the systems that a file states whole; others are known by a recording or a model."""
    return list(table.systems())
