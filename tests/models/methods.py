"""Small models of every method and integrator that the configuration offers, at any n."""

from collections import Counter
from functools import cache
from typing import Any

import torch
from hydra.utils import get_class
from omegaconf import OmegaConf

from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.nets.structured_lagrangian import QUIET
from tests.tables import CONF, choices, explicit_integrators, variational_integrators

H = 0.05


def learned() -> list[str]:
    """The models that have a net: all but the true ones."""
    return list(_files())


@cache
def _files() -> dict[str, Any]:
    files = {name: OmegaConf.load(CONF / "model" / f"{name}.yaml") for name in choices("model")}
    return {name: file for name, file in files.items() if "width" in file}


def combinations() -> list[tuple[str, str]]:
    """Every pair of method and kind of integrator that exists. Integrators of one class, which
    differ in their order, are one kind: the mechanics' tests tell them apart."""
    return [
        (method, integrator)
        for method, file in _files().items()
        for integrator in _kinds(_integrators_of(file))
    ]


def _kinds(integrators: dict[str, Any]) -> list[str]:
    """The one of the lowest order of each class."""
    by_order = sorted(integrators, key=lambda name: getattr(integrators[name], "order", 0))
    return list({type(integrators[name]): name for name in reversed(by_order)}.values())


def flows() -> list[tuple[str, str]]:
    """The combinations whose flows differ: without methods that are another one but for their
    objective."""
    kinds = {method: get_class(file._target_) for method, file in _files().items()}
    own = [m for m, kind in kinds.items() if not any(k in kind.__mro__[1:] for k in kinds.values())]
    return [(method, integrator) for method, integrator in combinations() if method in own]


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


def make(method: str, integrator: str, n: int, **overrides: Any) -> Any:
    """A model in float64 with an inertia well away from singular."""
    file = _files()[method]
    torch.manual_seed(n)
    arguments: dict[str, Any] = {
        "coordinates": Coordinates(tuple(f"q{i}" for i in range(n)), (True, False, True)[:n]),
        "input_matrix": torch.eye(n, dtype=torch.float64)[:, -1:],
        "time_step": H,
        "width": 8,
    }
    if "integrator" in file:
        arguments["integrator"] = _integrators_of(file)[integrator]
    if "root" in file:
        arguments["root"] = Newton(tolerance=1e-12, max_iterations=50)
    model = get_class(file._target_)(**{**arguments, **overrides}).double()
    if model.lagrangian is not None:
        net = model.lagrangian.net
        with torch.no_grad():  # Xavier's weights again: derivatives that can be told from zero
            net.weights[-1].div_(QUIET)
            net.biases[-1].zero_()[:n] += 1.5
    return model


def windows(n: int, samples: int = 5) -> Windows:
    """Smooth samples: three nodes of a parabola, with their velocities, and varying controls."""
    generator = torch.Generator().manual_seed(11)
    q, v, a = torch.randn(3, samples, n, dtype=torch.float64, generator=generator)
    u = torch.randn(3, samples, 1, dtype=torch.float64, generator=generator)
    v = 0.3 * v  # slow enough for every random inertia to have its roots
    configurations = [q + t * v + 0.5 * t * t * a for t in (-H, 0.0, H)]
    return Windows(*configurations, v, v + H * a, *u)


def reads_back(model: Any) -> bool:
    """Whether its loss looks at a number to know how to go on, as a search for roots does."""
    return not model.objective.branch_free(model.flow)
