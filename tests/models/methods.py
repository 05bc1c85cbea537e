"""Small models of every method and integrator that the configuration offers, at any n."""

import inspect
from collections import Counter
from functools import cache, partial
from typing import Any

import torch
from hydra.utils import get_class
from omegaconf import OmegaConf

from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.mechanics.units import Units
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.mlp import MLP
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.structured_lagrangian import QUIET
from symo_exp.training.learner import Learner
from tests.tables import CONF, choices, explicit_integrators, variational_integrators

H = 0.05


def learned() -> list[str]:
    """The models that learn: all but the true ones."""
    return list(_files())


@cache
def _files() -> dict[str, Any]:
    files: dict[str, Any] = {
        name: OmegaConf.to_container(OmegaConf.load(CONF / "model" / f"{name}.yaml"))
        for name in choices("model")
    }
    return {name: file for name, file in files.items() if file.keys() & {"net", "dissipation"}}


def combinations() -> list[tuple[str, str]]:
    """Every pair of method and kind of integrator that exists. Integrators of one class, which
    differ in their order, are one kind: the mechanics' tests tell them apart."""
    return [
        (method, integrator)
        for method, file in _files().items()
        for integrator in _kinds(_integrators_of(file))
    ]


def one_each() -> list[tuple[str, str]]:
    """Every method with one of its integrators."""
    return list(dict(combinations()).items())


def _kinds(integrators: dict[str, Any]) -> list[str]:
    """The one of the lowest order of each class."""
    by_order = sorted(integrators, key=lambda name: getattr(integrators[name], "order", 0))
    return list({type(integrators[name]): name for name in reversed(by_order)}.values())


def flows() -> list[tuple[str, str]]:
    """The combinations whose flows differ, with one method for each kind of flow."""
    kinds = {}
    for method, integrator in combinations():
        flow = make(method, integrator, 1).flow
        kinds[type(flow), type(getattr(flow, "field", None))] = method
    return [pair for pair in combinations() if pair[0] in kinds.values()]


def pairwise(of: list[tuple[str, str]] | None = None) -> list[tuple[str, str, int]]:
    """Every combination at one of n = 1, 2, 3, in a Latin square: a method and an integrator have
    each another n in every pair. If only some are wanted they have the n that they have among all.
    """
    methods = list(_files())
    turns: Counter[str] = Counter()
    cases = []
    for method, integrator in combinations():
        cases.append((method, integrator, 1 + (methods.index(method) + turns[method]) % 3))
        turns[method] += 1
    return [case for case in cases if of is None or case[:2] in of]


def _integrators_of(file: Any) -> dict[str, Any]:
    if "integrator" not in file:
        return {"none": None}
    return variational_integrators() if "root" in file else explicit_integrators()


def make(method: str, integrator: str, n: int, *, width: int = 8, **overrides: Any) -> Any:
    """A model in float64 with an inertia well away from singular."""
    file = _files()[method]
    torch.manual_seed(n)
    arguments: dict[str, Any] = {
        "coordinates": Coordinates(tuple(f"q{i}" for i in range(n)), (True, False, True)[:n]),
        "input_matrix": torch.eye(n, dtype=torch.float64)[:, -1:],
        "time_step": H,
    }
    if "net" in file:
        arguments["net"] = partial(MLP, width=width, depth=2)
    if "lagrangian" in file:
        coordinates = overrides.get("coordinates", arguments["coordinates"])
        one = len(coordinates.rotations) == 1 and not any(coordinates.angular)
        network = partial(NetworkLagrangian, width=width)
        arguments["lagrangian"] = LearnedRigidBody if one else network
    if "integrator" in file:
        arguments["integrator"] = _integrators_of(file)[integrator]
    if "root" in file:
        arguments["root"] = Newton(tolerance=1e-12, max_iterations=50)
    model = get_class(file["_target_"])(**{**arguments, **overrides}).double()
    learned = getattr(model.lagrangian, "inner", model.lagrangian)
    net = getattr(learned, "net", None)
    if net is not None:
        with torch.no_grad():  # Xavier's weights again: derivatives that can be told from zero
            net.weights[-1].div_(QUIET)
            net.biases[-1].zero_()[:n] += 1.5
    return model


def make_small(method: str, integrator: str, n: int, **overrides: Any) -> tuple[Any, torch.Tensor]:
    """The same machine with lengths of about 1 µm instead of 1 m, and the units of coordinates."""
    model = make(method, integrator, n, **overrides)
    coordinates = model.coordinates._replace(units=Units(length=2.0**-20))
    force = coordinates.units.size("N m") / coordinates.sizes[:, None]
    matrix = force * model.input_matrix
    overrides |= {"coordinates": coordinates, "input_matrix": matrix}
    return make(method, integrator, n, **overrides), coordinates.sizes


def learner(method: str, integrator: str, n: int, **overrides: Any) -> Learner:
    """The learner of such a model; ``overrides`` are of either."""
    own = {key: overrides.pop(key) for key in inspect.signature(Learner).parameters
           if key in overrides and key != "objective"}  # fmt: skip
    return Learner(make(method, integrator, n, **overrides), **own)


def windows(n: int, samples: int = 5) -> Windows:
    """Smooth samples: three nodes of a parabola, with their velocities, and varying controls."""
    generator = torch.Generator().manual_seed(11)
    q, v, a = torch.randn(3, samples, n, dtype=torch.float64, generator=generator)
    u = torch.randn(3, samples, 1, dtype=torch.float64, generator=generator)
    v = 0.3 * v  # slow enough for every random inertia to have its roots
    configurations = [q + t * v + 0.5 * t * t * a for t in (-H, 0.0, H)]
    return Windows(*configurations, v, v + H * a, *u)


def reads_back(model: Any) -> bool:
    """Return whether the loss of a model branches on values, as a root finder does."""
    return not model.objective.branch_free(model.flow)
