"""Small models of every method and integrator that the configuration offers, at any n."""

from typing import Any

import torch
from hydra.utils import get_class
from omegaconf import OmegaConf

from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.models.variational import VariationalModel
from symo_exp.nets.structured_lagrangian import QUIET
from tests.tables import CONF, choices, explicit_integrators, variational_integrators

H = 0.05


def learned() -> list[str]:
    """The models that have a net: all but the true ones."""
    return list(_classes())


def _classes() -> dict[str, Any]:
    files = {name: OmegaConf.load(CONF / "model" / f"{name}.yaml") for name in choices("model")}
    return {name: get_class(file._target_) for name, file in files.items() if "width" in file}


def combinations() -> list[tuple[str, str]]:
    """Every pair of method and integrator that exists."""
    return [
        (method, integrator)
        for method, cls in _classes().items()
        for integrator in _integrators_of(cls)
    ]


def _integrators_of(cls: Any) -> dict[str, Any]:
    variational = issubclass(cls, VariationalModel)
    return variational_integrators() if variational else explicit_integrators()


def make(method: str, integrator: str, n: int, **overrides: Any) -> Any:
    """A model in float64 with an inertia well away from singular."""
    cls = _classes()[method]
    torch.manual_seed(n)
    arguments: dict[str, Any] = {
        "coordinates": Coordinates(tuple(f"q{i}" for i in range(n)), (True, False, True)[:n]),
        "input_matrix": torch.eye(n, dtype=torch.float64)[:, -1:],
        "time_step": H,
        "width": 8,
        "integrator": _integrators_of(cls)[integrator],
    }
    if issubclass(cls, VariationalModel):
        arguments["root"] = Newton(tolerance=1e-12, max_iterations=50)
    model = cls(**{**arguments, **overrides}).double()
    if model.lagrangian is not None:
        net = model.lagrangian.net
        with torch.no_grad():  # Xavier's weights again: derivatives that can be told from zero
            net.weights[-1].div_(QUIET)
            net.biases[-1].zero_()[:n] += 1.5
    return model


def windows(n: int, samples: int = 5) -> Windows:
    """Smooth samples: three poses of a parabola, with their velocities, and varying controls."""
    generator = torch.Generator().manual_seed(11)
    q, v, a = torch.randn(3, samples, n, dtype=torch.float64, generator=generator)
    u = torch.randn(3, samples, 1, dtype=torch.float64, generator=generator)
    v = 0.3 * v  # slow enough for every random inertia to have its roots
    poses = [q + t * v + 0.5 * t * t * a for t in (-H, 0.0, H)]
    return Windows(*poses, v, v + H * a, *u)


def reads_back(model: Any) -> bool:
    """Whether its loss looks at a number to know how to go on, as a search for roots does."""
    model.loss(windows(model.coordinates.n))
    return not model.can_be_compiled or "newton_iterations" in model._statistics
