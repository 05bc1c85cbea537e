"""Compiled training and rollouts agree with the uncompiled ones."""

import copy
import pickle
from functools import partial
from typing import Any

import pytest
import torch
import torch._inductor
from torch.fx.experimental.proxy_tensor import make_fx

from symo_exp.compile import (
    compile_rollout,
    compile_training,
    kernels,
    program,
    trains_compiled,
)
from symo_exp.compile.inductor import CompilerError, compiler_available, flatten, lower, unflatten
from symo_exp.mechanics.lagrangian import AutodiffExpansion
from symo_exp.mechanics.roots import Broyden, Newton
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units
from symo_exp.models.learned import learned_lagrangian
from symo_exp.models.objectives import Objective, Residual, Residuals
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.springs import LinearSprings
from symo_exp.systems.chain import ChainPendulum
from tests.models.methods import (
    combinations,
    flows,
    learned,
    learner,
    make,
    pairwise,
    windows,
)


def said(caplog):
    """Return the messages of the project, without those of the compiler."""
    return [r.getMessage() for r in caplog.records if r.name.startswith("symo_exp")]


needs_compiler = pytest.mark.skipif(not compiler_available(), reason="no C++ compiler")
SLOW = [
    pytest.param(*case, marks=pytest.mark.slow)
    for case in [
        ("symo", "midpoint", 1, "row", False),
        ("symo", "midpoint", 2, "row", True),
        ("node", "rk4", 2, "row", True),
        ("l_node", "rk4", 2, "row", True),
        ("e2e_symo", "midpoint", 2, "row", True),
        ("e2e_symo", "midpoint", 2, "batch", True),
    ]
]


@needs_compiler
@pytest.mark.parametrize(
    ("method", "integrator", "n", "stopping", "validation"),
    [("node", "midpoint", 1, "row", False), *SLOW],
)
def test_loss_gradients_and_the_step_they_lead_to_are_the_uncompiled_ones(
    method, integrator, n, stopping, validation
):
    """At sizes where narrow products are turned, and by an optimiser that reads memory."""
    model, data = learner(method, integrator, n, width=64), windows(n, samples=64)
    if not model.reads_velocity:
        model.model.flow.root = Newton(tolerance=1e-8, stopping=stopping)
    before = copy.deepcopy(model.state_dict())

    def step():
        loss = model.loss_and_gradients(data)
        gradients = [parameter.grad.clone() for parameter in model.parameters()]
        torch.optim.SGD(model.parameters(), lr=1e-3, fused=True).step()
        return loss, gradients, copy.deepcopy(model.state_dict())

    expected = step()
    compile_training(model, validation=validation)
    with torch.no_grad():  # a batch of another size comes first
        model.validation_loss(windows(n, samples=9))
    model.loss_and_gradients(windows(n, samples=9))
    for _ in range(2):
        model.load_state_dict(before)
        with torch.no_grad():
            validated = model.validation_loss(data)
        torch.testing.assert_close(validated, expected[0], atol=0, rtol=1e-9)
        found = step()
        torch.testing.assert_close(found[0], expected[0], atol=0, rtol=1e-9)
        torch.testing.assert_close(found[1:], expected[1:], atol=1e-10, rtol=1e-7)


@pytest.mark.slow
@needs_compiler
def test_a_batch_that_newton_cannot_finish_is_left_to_the_safeguards(caplog):
    model, data = learner("e2e_symo", "midpoint", 2), windows(2, samples=8)
    model.model.flow.root = Newton(tolerance=1e-300, max_iterations=2)
    expected = model.loss_and_gradients(data)
    compile_training(model, validation=True)
    torch.testing.assert_close(model.loss_and_gradients(data), expected)
    with torch.no_grad():
        torch.testing.assert_close(model.validation_loss(data), expected)
    assert said(caplog) == []


@pytest.fixture
def traced_only(monkeypatch):
    """Graphs are run as they are traced: all that is ours without the minutes of a compiler.

    As kernels are, they are for one layout of each tensor.
    """

    def layouts(tensors):
        return [
            [step for step, n in zip(x.stride(), x.shape, strict=True) if n > 1] for x in tensors
        ]

    graphs = []

    def lower(graph, example):
        def kernel(*tensors):
            assert layouts(tensors) == layouts(example)
            return graph(*tensors)

        graphs.append(graph)
        return kernel

    monkeypatch.setattr(program, "lower", lower)
    return graphs


LONG = {
    ("l_node", "dopri5"), ("l_node", "rk4"),
    ("symo", "galerkin4"), ("symo", "midpoint"), ("symo", "refined_midpoint"),
}  # fmt: skip
"""Those that take longest; other cases have the field or the integrator with another partner, and
``test_rows_that_a_compiled_rollout_cannot_finish_are_as_uncompiled`` has roots."""


@pytest.mark.usefixtures("traced_only")
@pytest.mark.parametrize(
    ("method", "integrator", "n"),
    [
        pytest.param(*case, marks=pytest.mark.slow if case[:2] in LONG else [])
        for case in pairwise(flows())
    ],
)
def test_a_compiled_rollout_is_the_uncompiled_one(method, integrator, n):
    """Rollouts have several lengths and initial states several memory layouts."""
    model, data = make(method, integrator, n), windows(n)
    u = torch.randn(len(data.q), 4, 1, dtype=torch.float64)
    starts = (data.q, data.v, u), (data.q.T.contiguous().T, data.v, u[:, 1:])
    assert compile_rollout(model) is model
    expected = [make(method, integrator, n).rollout(*start) for start in starts]
    found = [model.rollout(*start) for start in starts]
    torch.testing.assert_close(found, expected, atol=1e-9, rtol=1e-9)
    for other in (model.for_evaluation(), pickle.loads(pickle.dumps(model))):
        assert not other.compiled
        torch.testing.assert_close(other.rollout(*starts[0]), expected[0])


@pytest.mark.slow
@pytest.mark.parametrize("method", learned())
def test_one_graph_is_for_any_number_of_rows_and_another_for_one_row(method, traced_only):
    model = learner(method, dict(combinations())[method], 1)

    def at(samples):
        loss = model.loss_and_gradients(windows(1, samples=samples))
        return loss, [parameter.grad.clone() for parameter in model.parameters()]

    sizes = (64, 5, 2, 1)
    expected = [at(samples) for samples in sizes]
    compile_training(model)
    found = [at(sizes[0])]
    pieces = len(traced_only)
    found += [at(samples) for samples in sizes[1:]]
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=1e-7)
    assert len(traced_only) == 2 * pieces


class OwnExpansion(AutodiffExpansion):
    """An expansion of a user's own."""


class OwnLinks(PlanarLinks):
    """A Lagrangian of a user's own, with its expansions."""

    def expand(self, q, v):
        return OwnExpansion(self, q.detach(), v.detach())


PARTS: dict[str, dict[str, Any]] = {
    "network, springs and friction": {
        "springs": LinearSprings,
        "dissipation": partial(LearnedDissipation, coulomb=True, width=4),
    },
    "links in space with motors": {
        "lagrangian": RigidChain,
        "dissipation": partial(MachineFriction, stribeck=True),
    },
    "links in a plane": {"lagrangian": PlanarLinks, "dissipation": LearnedDissipation},
    "known": {"lagrangian": partial(KnownLagrangian, system=ChainPendulum(1))},
    "a user's own": {"lagrangian": OwnLinks, "springs": LinearSprings},
}
"""What a Lagrangian may consist of, of one coordinate: tracing a chain takes long."""


@pytest.mark.parametrize("units", [SI, Units(0.5, 0.8, 1.5)])
@pytest.mark.parametrize("parts", PARTS)
def test_expansions_that_pieces_pass_on_consist_of_tensors(parts, units):
    coordinates = Coordinates(("theta_1",), (True,), units=units)
    made = {"lagrangian": partial(NetworkLagrangian, width=4), "dissipation": None, "springs": None}
    lagrangian = learned_lagrangian(coordinates, **made | PARTS[parts])
    at = lagrangian.expand(torch.zeros(3, 1), torch.ones(3, 1))
    tensors, structure = flatten(at)
    assert all(isinstance(x, torch.Tensor) for x in tensors)
    torch.testing.assert_close(unflatten(tensors, structure).curvature(), at.curvature())


QUICK = {("links in a plane", "l_node")}
"""The others and other methods are among the long proofs."""


@pytest.mark.usefixtures("traced_only")
@pytest.mark.parametrize(
    ("parts", "method"),
    [
        pytest.param(parts, method, marks=[] if (parts, method) in QUICK else pytest.mark.slow)
        for parts in PARTS
        for method in ("l_node", "e2e_symo")
    ],
)
def test_every_lagrangian_is_compiled(parts, method):
    model = learner(method, dict(combinations())[method], 1, **PARTS[parts])
    if not model.reads_velocity:
        model.model.flow.root = Newton(tolerance=1e-8)
    data = windows(1)
    loss = model.loss_and_gradients(data)
    expected = [torch.zeros_like(p) if p.grad is None else p.grad for p in model.parameters()]
    model.zero_grad()
    compile_training(model)
    torch.testing.assert_close(model.loss_and_gradients(data), loss, atol=1e-12, rtol=1e-7)
    found = [p.grad for p in model.parameters()]
    torch.testing.assert_close(found, expected, atol=1e-10, rtol=1e-6)


class Weighted(Residual):
    """An objective of a user's own, which depends on the number of rows."""

    def __call__(self, flow, windows):
        values, _ = super().__call__(flow, windows)
        return Residuals(values * torch.arange(1, len(values) + 1).to(values)[:, None], {})


@pytest.mark.slow
def test_what_depends_on_the_number_of_rows_has_a_graph_for_each(traced_only):
    model = learner("symo", "midpoint", 1, objective=Weighted())
    batches = [windows(1, samples=samples) for samples in (5, 7, 5, 1)]
    expected = [model.loss_and_gradients(batch) for batch in batches]
    compile_training(model)
    found = [model.loss_and_gradients(batch) for batch in batches]
    torch.testing.assert_close(found, expected, atol=0, rtol=1e-9)
    assert len(traced_only) == 3


class Keeping(Residual):
    """An objective that makes a constant at its first call and keeps it."""

    def __init__(self):
        self.constant = None

    def __call__(self, flow, windows):
        values, _ = super().__call__(flow, windows)
        if self.constant is None:
            self.constant = torch.ones(values.shape[1], dtype=values.dtype)
        return Residuals(values * self.constant, {})


@pytest.mark.usefixtures("traced_only")
def test_a_constant_that_is_kept_while_a_function_is_compiled_has_data():
    objective = Keeping()
    model = learner("symo", "midpoint", 1, objective=objective)
    compile_training(model)
    model.loss_and_gradients(windows(1, samples=5))
    assert objective.constant.tolist() == [1.0]


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("method", ["l_node", "symo"])
def test_a_rollout_by_compiled_kernels_is_the_uncompiled_one(method, caplog):
    integrator = "midpoint" if method == "symo" else "rk4"
    model, data = make(method, integrator, 2), windows(2)
    u = torch.randn(len(data.q), 30, 1, dtype=torch.float64)
    expected = [model.rollout(data.q, data.v, x) for x in (u, u[:, :20])]
    compile_rollout(model)
    found = [model.rollout(data.q, data.v, x) for x in (u, u[:, :20])]
    assert said(caplog) == []
    torch.testing.assert_close(found, expected, atol=1e-8, rtol=1e-8)


@pytest.mark.usefixtures("traced_only")
@pytest.mark.slow
def test_rows_that_a_compiled_rollout_cannot_finish_are_as_uncompiled():
    """One row is lost from the start, one is too fast for a root: its neighbours keep theirs."""
    root = Newton(tolerance=1e-12, max_iterations=15)
    model, data = make("symo", "midpoint", 1, root=root), windows(1)
    v = data.v.clone()
    v[0], v[1] = 1e200, 80.0
    u = torch.randn(len(v), 4, 1, dtype=torch.float64)
    one, three = (model.rollout(data.q, v, x) for x in (u[:, :2], u))
    assert not one.converged[:2].any()
    assert three.converged[2:].all()
    compile_rollout(model)
    torch.testing.assert_close(model.rollout(data.q, v, u[:, :2]), one, equal_nan=True)
    for found, expected in zip(model.rollout(data.q, v, u), three, strict=True):
        torch.testing.assert_close(found[2:], expected[2:])


def test_a_rollout_that_cannot_be_compiled_is_reported(caplog):
    model, data = make("symo", "midpoint", 2, root=Broyden(tolerance=1e-12)), windows(2)
    compile_rollout(model)
    (line,) = said(caplog)
    assert line.endswith("not compiled")
    assert model.rollout(data.q, data.v, steps=2).converged.all()


@pytest.fixture
def broken_compiler(monkeypatch):
    def lower(graph, example):
        raise CompilerError("no such compiler")

    monkeypatch.setattr(program, "lower", lower)


@pytest.mark.usefixtures("broken_compiler")
def test_a_compiler_that_fails_is_reported_once_and_not_needed(caplog):
    fit, data = learner("node", "midpoint", 1), windows(1)
    model = fit.model
    expected = fit.loss_and_gradients(data)
    rolled = model.rollout(data.q, data.v, steps=3)
    compile_training(fit, validation=True)
    compile_rollout(model)
    for _ in range(2):
        torch.testing.assert_close(fit.loss_and_gradients(data), expected)
        torch.testing.assert_close(fit.validation_loss(data).detach(), expected)
        torch.testing.assert_close(model.rollout(data.q, data.v, steps=3), rolled)
    for what, line in zip(("training step", "validation", "rollout"), said(caplog), strict=True):
        assert what in line
        assert "no such compiler" in line


def test_every_failure_of_the_compiler_is_one_error_of_one_line(monkeypatch):
    def compile(*_, **__):
        raise OSError("no space left on device\nand a long tail")

    monkeypatch.setattr(torch._inductor, "standalone_compile", compile)
    with pytest.raises(CompilerError) as caught:
        lower(torch.fx.symbolic_trace(torch.nn.Identity()), [torch.zeros(1)])
    assert str(caught.value) == "no space left on device"


class Faulty(Objective):
    """One whose author errs."""

    def __call__(self, flow, windows):
        raise RuntimeError("a fault of ours")

    def branch_free(self, flow):
        return True


def test_a_fault_of_ours_is_raised_and_not_taken_for_one_of_the_compiler(caplog):
    model, data = learner("symo", "midpoint", 2, objective=Faulty()), windows(2)
    compile_training(model, validation=True)
    for computed in (model.loss_and_gradients, model.validation_loss):
        with pytest.raises(RuntimeError, match="a fault of ours"):
            computed(data)
    assert said(caplog) == []


def test_operations_that_depend_on_values_are_not_compiled(caplog):
    """As those of a network of a user's own may."""
    model, data = make("node", "midpoint", 1), windows(1)
    net = model.flow.field.net
    forward = net.forward
    net.forward = lambda x: forward(x) if (x < 1e3).any() else x
    expected = model.rollout(data.q, data.v, steps=3)
    compile_rollout(model)
    torch.testing.assert_close(model.rollout(data.q, data.v, steps=3), expected)
    assert said(caplog) == ["the rollout is not compiled: its operations depend on values"]


class Counted(Residual):
    """An objective of a user's own, with a statistic."""

    def __call__(self, flow, windows):
        values, _ = super().__call__(flow, windows)
        return Residuals(values, {"largest": values.abs().max()})


STATISTICS: list[Any] = [
    ("symo", {"objective": Counted()}),
    *(
        pytest.param("e2e_symo", options, marks=pytest.mark.slow)
        for options in (
            {"guess": "datum"},
            {"guess": "inertial", "root": Newton(tolerance=1e-6, stopping="batch")},
        )
    ),
]


def roots_among(method, options):
    """Return a learner and a batch, some of whose rows are roots from the start."""
    model, data = learner(method, "midpoint", 1, **options), windows(1, samples=8)
    reached = model.model.predict(data).q.detach()
    return model, data._replace(
        q_next=torch.where(torch.arange(8)[:, None] < 3, reached, data.q_next)
    )


@pytest.mark.usefixtures("traced_only")
@pytest.mark.parametrize(("method", "options"), STATISTICS)
def test_compiled_statistics_and_validation_are_the_uncompiled_ones(method, options):
    """Statistics are means over rows."""
    model, data = roots_among(method, options)
    _, expected = model.uncompiled_training(data)
    with torch.no_grad():
        loss = model.validation_loss(data)
    compile_training(model, validation=True)
    _, found = model.compiled["training step"](data)
    assert expected
    torch.testing.assert_close(dict(found), dict(expected), check_dtype=False)
    with torch.no_grad():
        torch.testing.assert_close(model.validation_loss(data), loss, atol=0, rtol=1e-9)


@pytest.mark.parametrize(
    ("method", "integrator", "options", "possible"),
    [
        ("node", "rk4", {}, True),
        ("node", "rk4", {"sensitivity": "adjoint"}, False),
        ("symo", "midpoint", {}, True),
        ("symo", "galerkin4", {}, False),
        ("e2e_symo", "midpoint", {}, True),
        ("e2e_symo", "midpoint", {"root": Newton(stopping="batch")}, True),
        ("e2e_symo", "midpoint", {"root": Broyden()}, False),
    ],
)
def test_only_what_is_a_fixed_sequence_of_operations_is_compiled(
    method, integrator, options, possible
):
    assert trains_compiled(learner(method, integrator, 1, **options)) == possible


def test_the_compiled_tanh_is_right_to_single_precision():
    x = torch.cat((torch.linspace(-12.0, 12.0, 200_001), torch.logspace(-30, 1, 10_001)))
    exact = torch.tanh(x.double())
    assert ((kernels.tanh(x) - exact).abs() / exact.abs().clamp(min=1e-37)).max() < 5e-7
    ends = torch.tensor([torch.inf, -torch.inf, torch.nan])
    torch.testing.assert_close(kernels.tanh(ends), torch.tanh(ends), equal_nan=True)
    assert kernels.tanh(x.double()) is NotImplemented


@pytest.mark.parametrize("shape", [(64, 64, 4), (64, 64, 9), (5, 64, 4), (64, 3, 2), (1, 1, 1)])
def test_a_narrow_product_is_the_product(shape):
    rows, inner, columns = shape
    a, b, x = torch.randn(rows, inner), torch.randn(inner, columns), torch.randn(columns)

    def both(a, b, x):
        return a @ b, torch.addmm(x, a, b)

    traced = make_fx(both, decomposition_table=kernels.CHEAPER)(a, b, x)
    torch.testing.assert_close(traced(a, b, x), both(a, b, x))
    turned = "permute" in traced.code or ".t." in traced.code
    assert turned == (shape == (64, 64, 4))


def test_sums_of_columns_are_the_sums():
    x, whole = torch.randn(64, 5), torch.arange(12).view(3, 4)

    def sums(x, whole):
        plain = x.sum(0), x.sum(0, keepdim=True), x.view(8, 8, 5).sum(0)
        return *plain, x.sum(1), x.sum((0, 1)), x.sum(0, dtype=torch.float64), whole.sum(0)

    traced = make_fx(sums, decomposition_table=kernels.CHEAPER)(x, whole)
    torch.testing.assert_close(traced(x, whole), sums(x, whole))
    assert traced.code.count("aten.mm") == 2
