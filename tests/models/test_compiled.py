"""What is compiled follows what is not."""

import copy
import pickle

import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx

from symo_exp.mechanics.roots import Broyden, Newton
from symo_exp.models import compiled
from symo_exp.training.compiling import compiler_available
from tests.models.methods import combinations, make, windows

needs_compiler = pytest.mark.skipif(not compiler_available(), reason="no C++ compiler")
SLOW = [
    pytest.param(*case, marks=pytest.mark.slow)
    for case in [
        ("node", "rk4", "row"),
        ("l_node", "rk4", "row"),
        ("e2e_symo", "midpoint", "row"),
        ("e2e_symo", "midpoint", "batch"),
    ]
]


@needs_compiler
@pytest.mark.parametrize(("method", "integrator", "stopping"), [("symo", "midpoint", "row"), *SLOW])
def test_loss_gradients_and_the_step_they_lead_to_are_the_uncompiled_ones(
    method, integrator, stopping
):
    """At sizes where narrow products are turned, and by an optimiser that reads memory."""
    model, data = make(method, integrator, 2, width=64), windows(2, samples=64)
    if not model.reads_velocity:
        model.root = Newton(tolerance=1e-8, stopping=stopping)
    before = copy.deepcopy(model.state_dict())

    def step():
        loss = model.loss_and_gradients(data)
        gradients = [parameter.grad.clone() for parameter in model.parameters()]
        torch.optim.SGD(model.parameters(), lr=1e-3, fused=True).step()
        return loss, gradients, copy.deepcopy(model.state_dict())

    expected = step()
    model.compile_training(validation=True)
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
def test_a_batch_that_newton_cannot_finish_is_left_to_the_safeguards():
    model, data = make("e2e_symo", "midpoint", 2), windows(2, samples=8)
    model.root = Newton(tolerance=1e-300, max_iterations=2)
    expected = model.loss_and_gradients(data)
    model.compile_training(validation=True)
    torch.testing.assert_close(model.loss_and_gradients(data), expected)
    with torch.no_grad():
        torch.testing.assert_close(model.validation_loss(data), expected)
    assert model._program is not None


@pytest.fixture
def traced_only(monkeypatch):
    """Graphs are run as they are traced: all that is ours without the minutes of a compiler.

    As kernels are, they are for one layout of each tensor.
    """

    def layouts(tensors):
        return [
            [step for step, n in zip(x.stride(), x.shape, strict=True) if n > 1] for x in tensors
        ]

    def compile(graph, example, **_):
        def kernel(*tensors):
            assert layouts(tensors) == layouts(example)
            return graph(*tensors)

        return kernel

    monkeypatch.setattr(compiled, "standalone_compile", compile)


@pytest.mark.usefixtures("traced_only")
@pytest.mark.parametrize(("method", "integrator"), combinations())
def test_a_compiled_rollout_is_the_uncompiled_one(method, integrator):
    """Whatever the lengths of the rollouts and the layouts of what they start from."""
    model, data = make(method, integrator, 3), windows(3)
    u = torch.randn(len(data.q), 4, 1, dtype=torch.float64)
    starts = (data.q, data.v, u), (data.q.T.contiguous().T, data.v, u[:, 1:])
    expected = [model.rollout(*start) for start in starts]
    model.compile_rollout()
    found = [model.rollout(*start) for start in starts]
    assert (model._rollout_program is not None) == model.rollout_can_be_compiled
    torch.testing.assert_close(found, expected, atol=1e-9, rtol=1e-9)
    for other in (model.for_evaluation(), pickle.loads(pickle.dumps(model))):
        assert other._rollout_program is None
        torch.testing.assert_close(other.rollout(*starts[0]), expected[0])


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("method", ["l_node", "symo"])
def test_a_rollout_by_compiled_kernels_is_the_uncompiled_one(method):
    integrator = "midpoint" if method == "symo" else "rk4"
    model, data = make(method, integrator, 2), windows(2)
    u = torch.randn(len(data.q), 30, 1, dtype=torch.float64)
    expected = [model.rollout(data.q, data.v, x) for x in (u, u[:, :20])]
    model.compile_rollout()
    found = [model.rollout(data.q, data.v, x) for x in (u, u[:, :20])]
    assert model._rollout_program is not None
    torch.testing.assert_close(found, expected, atol=1e-8, rtol=1e-8)


@pytest.mark.usefixtures("traced_only")
def test_rows_that_a_compiled_rollout_cannot_finish_are_as_uncompiled():
    """One row is lost from the start, one is too fast for a root: its neighbours keep theirs."""
    model, data = make("symo", "midpoint", 2), windows(2)
    v = data.v.clone()
    v[0], v[1] = torch.nan, 80.0
    one, three = (model.rollout(data.q, v, steps=steps) for steps in (1, 3))
    assert not one.converged[:2].any()
    assert three.converged[2:].all()
    model.compile_rollout()
    torch.testing.assert_close(model.rollout(data.q, v, steps=1), one, equal_nan=True)
    for found, expected in zip(model.rollout(data.q, v, steps=3), three, strict=True):
        torch.testing.assert_close(found[2:], expected[2:])


def test_what_cannot_be_compiled_is_said(caplog):
    model, data = make("symo", "midpoint", 2, root=Broyden(tolerance=1e-12)), windows(2)
    model.compile_rollout()
    (said,) = caplog.messages
    assert said.endswith("not compiled")
    assert model.rollout(data.q, data.v, steps=2).converged.all()


def test_a_compiler_that_fails_is_said_and_done_without(caplog):
    model, data = make("symo", "midpoint", 2), windows(2)
    expected = model.loss_and_gradients(data)

    def broken(windows):
        raise RuntimeError("no such compiler\nand a long tail")

    for computed in (model.loss_and_gradients, model.validation_loss):
        model._program = model._validation_program = broken
        torch.testing.assert_close(computed(data).detach(), expected)
        assert caplog.messages == ["the training step is not compiled: no such compiler"]
        assert model._program is model._validation_program is None
        caplog.clear()


def test_a_rollout_that_the_compiler_fails_is_done_without(caplog, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("no such compiler")

    model, data = make("symo", "midpoint", 2), windows(2)
    expected = model.rollout(data.q, data.v, steps=3)
    monkeypatch.setattr(compiled, "standalone_compile", broken)
    model.compile_rollout()
    torch.testing.assert_close(model.rollout(data.q, data.v, steps=3), expected)
    assert caplog.messages == ["the rollout is not compiled: no such compiler"]


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
    assert make(method, integrator, 1, **options).can_be_compiled == possible


def test_the_compiled_tanh_is_right_to_single_precision():
    x = torch.cat((torch.linspace(-12.0, 12.0, 200_001), torch.logspace(-30, 1, 10_001)))
    exact = torch.tanh(x.double())
    assert ((compiled.tanh(x) - exact).abs() / exact.abs().clamp(min=1e-37)).max() < 5e-7
    ends = torch.tensor([torch.inf, -torch.inf, torch.nan])
    torch.testing.assert_close(compiled.tanh(ends), torch.tanh(ends), equal_nan=True)
    assert compiled.tanh(x.double()) is NotImplemented


@pytest.mark.parametrize("shape", [(64, 64, 4), (64, 64, 9), (5, 64, 4), (64, 3, 2), (1, 1, 1)])
def test_a_narrow_product_is_the_product(shape):
    rows, inner, columns = shape
    a, b, x = torch.randn(rows, inner), torch.randn(inner, columns), torch.randn(columns)

    def both(a, b, x):
        return a @ b, torch.addmm(x, a, b)

    traced = make_fx(both, decomposition_table=compiled.CHEAPER)(a, b, x)
    torch.testing.assert_close(traced(a, b, x), both(a, b, x))
    turned = "permute" in traced.code or ".t." in traced.code
    assert turned == (shape == (64, 64, 4))


def test_sums_of_columns_are_the_sums():
    x, whole = torch.randn(64, 5), torch.arange(12).view(3, 4)

    def sums(x, whole):
        plain = x.sum(0), x.sum(0, keepdim=True), x.view(8, 8, 5).sum(0)
        return *plain, x.sum(1), x.sum((0, 1)), x.sum(0, dtype=torch.float64), whole.sum(0)

    traced = make_fx(sums, decomposition_table=compiled.CHEAPER)(x, whole)
    torch.testing.assert_close(traced(x, whole), sums(x, whole))
    assert traced.code.count("aten.mm") == 2
