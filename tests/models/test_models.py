"""The four methods: gradients against oracles and properties that all share."""

import copy
import dataclasses

import numpy as np
import pandas as pd
import pytest
import torch
from hydra.utils import instantiate
from torch.nn.utils import parameters_to_vector

from symo_exp.errors import ConfigError
from symo_exp.mechanics.explicit import RK4, ClassicalRK4, DormandPrince5
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import Broyden, Newton
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.mechanics.units import Units
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import ExplicitFlow, VariationalFlow
from symo_exp.models.objectives import PreconditionedResidual, Residual
from symo_exp.models.true import TrueVariational
from symo_exp.nets.affine import parameter_jacobian
from symo_exp.training.learner import Learner
from tests.differences import assert_gradients
from tests.models.methods import (
    H,
    combinations,
    flows,
    learner,
    make,
    make_small,
    one_each,
    pairwise,
    windows,
)
from tests.tables import arguments_of, stated, variational_integrators

ALL = pytest.mark.parametrize(("method", "integrator"), combinations())
PAIRWISE = pytest.mark.parametrize(("method", "integrator", "n"), pairwise())
FLOWS = pytest.mark.parametrize(("method", "integrator", "n"), pairwise(flows()))


@PAIRWISE
def test_gradient_of_the_loss_against_finite_differences(method, integrator, n):
    model, data = learner(method, integrator, n), windows(n)
    parameters = [p for p in model.parameters() if p.requires_grad]
    assert_gradients(lambda: model.loss(data), parameters, eps=1e-6, atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("objective", [Residual, PreconditionedResidual])
@pytest.mark.parametrize("integrator", variational_integrators())
def test_consecutive_windows_give_the_residuals_of_single_windows(objective, integrator):
    """In any order, with derivatives, although intervals that they share are solved once."""
    model = learner("symo", integrator, 2, objective=objective())
    parameters, generator = list(model.parameters()), torch.Generator().manual_seed(5)
    shape = {"dtype": torch.float64, "generator": generator}
    bends = H * H * torch.randn(8, 2, **shape)
    q, u = torch.randn(2, **shape) + bends.cumsum(0).cumsum(0), torch.randn(8, 1, **shape)
    order = torch.randperm(6, generator=generator)
    q_prev, q, q_next, u_prev, u, u_next = (x[k : k + 6][order] for x in (q, u) for k in range(3))
    data = Windows(q_prev, q, q_next, torch.zeros_like(q), torch.zeros_like(q), u_prev, u, u_next)

    def linearised(rows):
        nodes = [x.clone().requires_grad_() for x in rows[:3]]
        return parameter_jacobian(
            lambda: model.residuals(Windows(*nodes, *rows[3:])), parameters, nodes
        )

    together = linearised(data)
    with torch.no_grad():
        torch.testing.assert_close(model.residuals(data), together.residuals)
    for k in range(6):
        alone = linearised(data.rows(slice(k, k + 1)))
        for x, y in zip(_tensors(together), _tensors(alone), strict=True):
            torch.testing.assert_close(x[k : k + 1], y, rtol=1e-9, atol=1e-11)


def _tensors(linearised):
    return linearised.residuals, linearised.parameters, *linearised.inputs


@FLOWS
def test_a_step_is_differentiable_in_state_and_control(method, integrator, n):
    model, data = make(method, integrator, n), windows(n, samples=2)

    def outcome(q, v, u, u_next):
        step = model.step(q, v, u, u_next)
        return step.q, step.v

    inputs = [x.clone().requires_grad_() for x in (data.q, data.v, data.u, data.u_next)]
    assert torch.autograd.gradcheck(outcome, inputs, eps=1e-6, atol=1e-5, rtol=1e-4, fast_mode=True)


@FLOWS
@torch.no_grad()
def test_rollout_is_repeated_steps(method, integrator, n):
    model, data = make(method, integrator, n), windows(n)
    u = torch.randn(len(data.q), 5, 1, dtype=torch.float64)
    rollout = model.rollout(data.q, data.v, u)
    q, v = data.q, data.v
    for k in range(4):
        q, v, converged, _ = model.step(q, v, u[:, k], u[:, k + 1])
        assert converged.all()
        torch.testing.assert_close(rollout.q[:, k + 1], q)
        torch.testing.assert_close(rollout.v[:, k + 1], v)
    assert rollout.converged.shape == (len(q), 4)
    torch.testing.assert_close(rollout.v[:, 0], data.v)


@FLOWS
def test_a_rollout_of_no_steps_is_the_start(method, integrator, n):
    model, data = make(method, integrator, n), windows(n)
    for given in ({"steps": 0}, {"u": data.u[:, None]}):
        rollout = model.rollout(data.q, data.v, **given)
        assert torch.equal(rollout.q, data.q[:, None])
        torch.testing.assert_close(rollout.v, data.v[:, None])
        assert rollout.converged.shape == (len(data.q), 0)


@pytest.mark.parametrize("method", ["node", "l_node"])
@torch.no_grad()
def test_rollouts_may_have_an_integrator_of_their_own(method):
    """Training and one-step measures keep the integrator."""
    one, other = (make(method, name, 2) for name in ("rk4", "dopri5"))
    both = make(method, "rk4", 2, rollout_integrator=other.flow.integrator)
    data = windows(2)
    q, v, u = data.q, data.v, torch.stack((data.u_prev, data.u, data.u_next), 1)
    assert torch.equal(both.rollout(q, v, u).q, other.rollout(q, v, u).q)
    assert torch.equal(both.step(q, v).q, one.step(q, v).q)
    assert not torch.equal(both.step(q, v).q, other.step(q, v).q)


@ALL
@torch.no_grad()
def test_prediction_is_a_step_from_the_initial_velocity(method, integrator):
    """That velocity is measured if the method reads it, and estimated otherwise."""
    model, data = make(method, integrator, 2), windows(2)
    predicted = model.predict(data)
    stepped = model.step(data.q, model.initial_velocity(data), data.u, data.u_next)
    torch.testing.assert_close(predicted.q, stepped.q)
    torch.testing.assert_close(predicted.v, stepped.v)
    moved = data._replace(v=data.v + 1.0)
    assert torch.equal(predicted.q, model.predict(moved).q) != model.reads_velocity


def test_a_flow_that_reads_no_velocity_needs_an_estimate_of_its_own():
    class Forgetful(ExplicitFlow):
        reads_velocity = False

    flow = make("node", "rk4", 2).flow
    flow.__class__ = Forgetful
    with pytest.raises(ConfigError, match="Forgetful has reads_velocity = False, but no initial"):
        flow.predict(windows(2))


@pytest.mark.parametrize(("method", "integrator"), [("l_node", "rk4"), ("symo", "midpoint")])
@torch.no_grad()
def test_without_a_control_the_motion_is_unforced_and_one_control_is_held(method, integrator):
    model, data = make(method, integrator, 2), windows(2)
    zero = torch.zeros_like(data.u)
    torch.testing.assert_close(
        model.step(data.q, data.v).q, model.step(data.q, data.v, zero, zero).q
    )
    held = model.step(data.q, data.v, data.u)
    torch.testing.assert_close(held.q, model.step(data.q, data.v, data.u, data.u).q)
    rolled = model.rollout(data.q, data.v, steps=3)
    forced = model.rollout(data.q, data.v, torch.zeros(len(data.q), 4, 1, dtype=torch.float64))
    torch.testing.assert_close(rolled.q, forced.q)
    assert not torch.allclose(held.q, model.step(data.q, data.v).q)


@pytest.mark.parametrize(("method", "integrator"), [("node", "rk4"), ("symo", "galerkin4")])
def test_the_evaluation_copy_is_in_double_precision(method, integrator):
    model = make(method, integrator, 2).float()
    twin = model.for_evaluation()
    assert {p.dtype for p in twin.parameters()} == {torch.float64}
    assert {p.dtype for p in model.parameters()} == {torch.float32}
    assert not any(p.requires_grad for p in twin.parameters())
    assert all(p.requires_grad for p in model.parameters())


@ALL
def test_single_precision_follows_double(method, integrator):
    root = {"root": Newton()} if not make(method, integrator, 2).reads_velocity else {}
    model, data = make(method, integrator, 2, **root), windows(2, samples=64)
    single = copy.deepcopy(model).float()
    double, low = model.predict(data).q, single.predict(type(data)(*(x.float() for x in data))).q
    torch.testing.assert_close(low.double(), double, atol=1e-4, rtol=1e-4)


@ALL
def test_a_diverging_rollout_raises_no_exception(method, integrator):
    model = make(method, integrator, 1)
    q0 = torch.tensor([[float("nan")], [0.1]], dtype=torch.float64)
    rollout = model.flow.rollout(q0, torch.zeros_like(q0), torch.zeros(2, 4, 1).to(q0))
    assert rollout.q[0].isnan().all()
    assert rollout.q[1].isfinite().all()


def test_a_rollout_needs_controls_or_a_number_of_steps():
    model = make("symo", "midpoint", 1)
    q = torch.zeros(1, 1, dtype=torch.float64)
    for given in ({}, {"u": [[0.0], [0.0]], "steps": 1}):
        with pytest.raises(ConfigError, match="either u"):
            model.rollout(q, q, **given)


@pytest.mark.parametrize(("method", "n"), [("node", 3), ("l_node", 2)])
def test_adjoint_gradients_approach_the_direct_ones_as_the_step_shrinks(method, n):
    data, errors = windows(n), []
    for h in (0.004, 0.002):
        gradients = []
        for sensitivity in ("direct", "adjoint"):
            model = make(method, "rk4", n, time_step=h, sensitivity=sensitivity)
            weight = list(model.parameters())[1]
            total = model.flow.step(data.q, data.v, data.u, data.u).q.sum()
            gradients.append(torch.autograd.grad(total, weight)[0])
        direct, adjoint = gradients
        errors.append(((direct - adjoint).norm() / direct.norm()).item())
    assert 0.0 < errors[1] < 0.2 * errors[0] < 1e-3


@pytest.mark.parametrize("follows", [lambda u: u, lambda u: u.clone(), lambda u: 2.0 * u])
def test_adjoint_gradients_in_the_control_approach_the_direct_ones(follows):
    data, gradients = windows(2), []
    for sensitivity in ("direct", "adjoint"):
        model = make("l_node", "rk4", 2, time_step=0.002, sensitivity=sensitivity)
        u = data.u.clone().requires_grad_()
        total = model.step(data.q, data.v, u, follows(u)).v.sum()
        gradients.append(torch.autograd.grad(total, u)[0])
    torch.testing.assert_close(*gradients, rtol=1e-3, atol=0.0)


def test_an_adjoint_step_has_the_value_of_the_direct_one():
    data = windows(2)
    direct, adjoint = (
        make("l_node", "rk4", 2, sensitivity=s).step(data.q, data.v, data.u, data.u_next)
        for s in ("direct", "adjoint")
    )
    torch.testing.assert_close(direct.q, adjoint.q)


@pytest.mark.parametrize("method", [DormandPrince5(), ClassicalRK4()])
def test_adjoint_gradients_of_methods_without_a_single_step_of_torchdiffeq_are_refused(method):
    field = make("l_node", "rk4", 1).flow.field
    with pytest.raises(ConfigError, match="choose integrator=midpoint or rk4"):
        ExplicitFlow(field, method, 0.1, sensitivity="adjoint")


def test_rows_without_a_root_are_counted_and_do_not_spoil_the_gradient():
    model, data = make("e2e_symo", "midpoint", 2), windows(2)
    model.flow.root = Newton(tolerance=1e-300, max_iterations=1)
    residuals = model.objective(model.flow, data)
    gradients = torch.autograd.grad(residuals.loss, list(model.lagrangian.net.parameters()))
    assert residuals.statistics["newton_failed"] == 1.0
    assert all(g.isfinite().all() for g in gradients)
    expected, _ = PreconditionedResidual()(model.flow, data)
    torch.testing.assert_close(residuals.values, expected)


@pytest.mark.parametrize("integrator", variational_integrators())
def test_the_guess_of_the_root_does_not_change_the_gradient(integrator):
    data, seen = windows(2), []
    for guess in ("datum", "inertial"):
        model = make("e2e_symo", integrator, 2, guess=guess)
        parameters = list(model.lagrangian.net.parameters())
        loss = Learner(model).loss(data)
        seen.append((loss.detach(), torch.autograd.grad(loss, parameters)))
    torch.testing.assert_close(*seen, rtol=1e-7, atol=1e-12)


def test_the_gradient_does_not_vanish_below_the_tolerance_of_the_root():
    exact, loose = (
        learner("e2e_symo", "midpoint", 2, root=Newton(tolerance=t)) for t in (1e-12, 9.0)
    )
    data = windows(2)
    data = data._replace(q_next=exact.model.predict(data).q.detach() + 1e-6)
    torch.testing.assert_close(loose.residuals(data), exact.residuals(data), rtol=1e-3, atol=0)
    gradients = [
        parameters_to_vector(torch.autograd.grad(m.loss(data), [*m.model.lagrangian.net.weights]))
        for m in (loose, exact)
    ]
    assert (gradients[0] - gradients[1]).norm() < 1e-2 * gradients[1].norm()


def test_an_unknown_guess_is_refused():
    with pytest.raises(ValueError, match="guess='nearest': expected one of datum, inertial"):
        make("e2e_symo", "midpoint", 2, guess="nearest")


@ALL
def test_a_model_has_no_loss_on_its_own_motions(method, integrator):
    """A sign error would show."""
    model, data = make(method, integrator, 3), windows(3)
    step = model.predict(data)
    exact = data._replace(q_next=step.q.detach(), v_next=step.v.detach())
    assert Learner(model).loss(data) > 1e-8
    assert Learner(model).loss(exact) < 1e-20


FORMS = {
    "float64": lambda x: x,
    "float32": lambda x: x.float(),
    "NumPy": lambda x: x.numpy(),
    "lists": lambda x: x.tolist(),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("method", "integrator"), [("node", "rk4"), ("symo", "midpoint")])
def test_states_may_be_tensors_arrays_or_lists_single_or_batched(method, integrator, form):
    given, samples = FORMS[form], windows(2)
    root = {} if method == "node" else {"root": Newton()}
    u = torch.randn(len(samples.q), 4, 1, dtype=torch.float64)
    for model in (make(method, integrator, 2, **root), make(method, integrator, 2, **root).float()):
        near = {"atol": 1e-5, "rtol": 1e-5, "check_dtype": False}
        step = model.step(*map(given, (samples.q, samples.v, samples.u, samples.u_next)))
        alone = model.step(*(given(x[1]) for x in (samples.q, samples.v, samples.u)))
        assert step.q.dtype == alone.q.dtype == model.input_matrix.dtype
        exact = model.flow.step(*(x.to(step.q) for x in samples[1:2] + samples[3:4] + samples[6:8]))
        torch.testing.assert_close(step, exact, **near)
        held = model.step(samples.q, samples.v, samples.u)
        torch.testing.assert_close(alone, type(held)(*(x[1] for x in held)), **near)
        path = model.rollout(*map(given, (samples.q, samples.v, u)))
        single = model.rollout(given(samples.q[1]), given(samples.v[1]), given(u[1]))
        torch.testing.assert_close(single, type(path)(*(x[1] for x in path)), **near)
        assert single.q.shape == (4, 2)
        assert single.converged.shape == (3,)
        if model.lagrangian is not None:
            q, v = given(samples.q[1]), given(samples.v[1])
            assert model.mass_matrix(q).shape == (2, 2)
            assert model.energy(q, v).shape == model.potential(q).shape == ()
            assert model.momentum(q, v).shape == (2,)


def unforced(model, q):
    """The end of a rollout, as a number."""
    return model.rollout(q, q, steps=1).q.sum()


def turned(model, q):
    """The control that keeps a model at rest."""
    return model.inverse_dynamics(q, q, q)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m: m.step([0.0], [0.0, 0.0]), r"q has shape \(1,\): expected \(2\) for a"),
        (lambda m: m.step([[0.0, 0.0]] * 3, [[0.0, 0.0]] * 2), r"expected \(3, 2\) for 3 states"),
        (lambda m: m.step([0.0, 0.0], [0.0, 0.0], 1.0), r"u has shape \(\): expected \(1\) for"),
        (lambda m: m.rollout([0.0, 0.0], [0.0, 0.0], [1.0]), r"u has .*: expected \(nodes, 1\)"),
        (lambda m: m.rollout([0.0, 0.0], [0.0, 0.0], np.zeros((0, 1))), "u has no nodes: expected"),
        (lambda m: torch.func.jacfwd(lambda q: m.step(q, q).q)(torch.zeros(2)), "use linearize"),
        (lambda m: torch.func.vmap(lambda q: m.step(q, q).q)(torch.zeros(3, 2)), "a batch of"),
        (lambda m: torch.func.jacrev(lambda q: m.step(q, q).q)(torch.zeros(2)), "use linearize"),
        (lambda m: torch.func.grad(lambda q: unforced(m, q))(torch.zeros(2)), "use linearize"),
        (lambda m: torch.func.jacrev(lambda q: m.linearize(q, q).A)(torch.zeros(2)), "transformed"),
        (lambda m: torch.func.vmap(lambda q: turned(m, q))(torch.zeros(3, 2)), "transformed"),
        (lambda m: torch.func.jvp(m.potential, (torch.zeros(2),), (torch.ones(2),)), "tangent"),
        (lambda m: m.rollout([0.0, 0.0], [0.0, 0.0], steps=-1), "steps=-1: expected a whole"),
        (lambda m: m.rollout([0.0, 0.0], [0.0, 0.0], steps=2.0), "steps=2.0: expected a whole"),
        (lambda m: m.rollout([0.0, 0.0], [0.0, 0.0], steps=True), "steps=True: expected a whole"),
        (lambda m: m.rollout("still", [0.0, 0.0], steps=1), "q is not an array of numbers"),
        (lambda m: m.rollout([0.0, 1j], [0.0, 0.0], steps=1), "numbers: its type is complex"),
        (lambda m: m.mass_matrix([0.0] * 5), r"expected \(2\) for a single state, or \(batch, 2\)"),
    ],
)
def test_invalid_states_are_refused_in_one_line(call, said):
    with pytest.raises(ConfigError, match=said):
        call(make("symo", "midpoint", 2))


def test_energy_inertia_and_momentum_can_be_transformed():
    """By ``vmap``, ``grad`` and ``jacrev`` of ``torch.func``."""
    model, data = make("symo", "midpoint", 2), windows(2)
    q, v = data.q, data.v
    for quantity in (model.energy, model.momentum):
        torch.testing.assert_close(torch.func.vmap(quantity)(q, v), quantity(q, v))
    slopes = torch.func.vmap(torch.func.grad(model.energy, argnums=1))(q, v)
    torch.testing.assert_close(slopes, model.momentum(q, v))
    inertia = torch.func.vmap(torch.func.jacrev(model.momentum, argnums=1))(q, v)
    torch.testing.assert_close(inertia, model.mass_matrix(q))


@pytest.mark.parametrize("method", ["node", "l_node", "symo"])
def test_results_carry_a_gradient_only_where_an_argument_asks(method):
    model, data = make(method, "midpoint", 2), windows(2)
    calls = {
        "step": lambda q, v: model.step(q, v, data.u).q,
        "rollout": lambda q, v: model.rollout(q, v, steps=2).q,
    }
    if model.lagrangian is not None:
        calls |= {"energy": model.energy, "mass_matrix": lambda q, v: model.mass_matrix(q)}
    for name, call in calls.items():
        call(data.q, data.v).numpy()
        call(data.q.numpy(), data.v.tolist()).numpy()
        tracked = call(data.q.clone().requires_grad_(), data.v)
        assert tracked.requires_grad == (name != "rollout"), name
        with torch.no_grad():
            call(data.q.clone().requires_grad_(), data.v).numpy()


@pytest.mark.parametrize(
    ("method", "integrator"), [("node", "rk4"), ("l_node", "midpoint"), ("symo", "galerkin4")]
)
def test_results_are_the_same_in_inference_mode(method, integrator):
    """Also from tensors that were made in it, such as the outputs of a policy."""
    model, data = make(method, integrator, 2), windows(2)

    def results(q, v, u):
        step = model.step(q, v, u)
        yield from (step.q, step.v, model.rollout(q, v, steps=2).q, *model.linearize(q, v, u))
        yield model.inverse_dynamics(q, step.q, model.step(step.q, step.v, u).q)
        yield model.for_evaluation().linearize(q, v, u).A
        if model.lagrangian is not None:
            yield model.energy(q, v)

    wanted = list(results(data.q, data.v, data.u))
    with torch.inference_mode():
        found = list(results(*(x.clone() for x in (data.q, data.v, data.u))))
    for a, b in zip(found, wanted, strict=True):
        assert not a.requires_grad
        assert torch.equal(a, b)


def test_lists_and_arrays_of_any_layout_are_read_to_all_digits():
    model, q = make("symo", "midpoint", 2), [[0.1, 0.2], [0.3, 0.4]]
    wanted = model.potential(torch.tensor(q, dtype=torch.float64))
    turned = np.array(q[::-1])[::-1]
    for given in (q, list(map(torch.DoubleTensor, q)), turned, np.array(q, dtype=">f8")):
        assert torch.equal(model.potential(given), wanted)
    assert model.rollout(q, q, steps=np.int64(3)).q.shape == (2, 4, 2)
    assert model.rollout(turned[:0], turned[:0], steps=3).q.shape == (0, 4, 2)


def test_states_may_be_data_frames():
    model, data = make("symo", "midpoint", 2), windows(2)
    q, v = (pd.DataFrame(x.numpy(), columns=["q_a", "q_b"]) for x in (data.q, data.v))
    assert torch.equal(model.energy(q, v), model.energy(data.q, data.v))
    assert torch.equal(model.energy(q.iloc[0], v.iloc[0]), model.energy(data.q[0], data.v[0]))


@FLOWS
def test_a_batch_may_be_empty(method, integrator, n):
    model, none = make(method, integrator, n), torch.zeros(0, n)
    assert model.rollout(none, none, steps=12).q.shape == (0, 13, n)
    assert model.step(none, none).q.shape == (0, n)
    assert model.linearize(none, none).A.shape == (0, 2 * n, 2 * n)
    assert model.inverse_dynamics(none, none, none).shape == (0, 1)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_rollout_from_a_start_that_is_not_finite_is_refused(bad):
    model, data = make("node", "midpoint", 2), windows(2)
    for name in ("q0", "v0"):
        start = {"q0": data.q.clone(), "v0": data.v.clone()}
        start[name][1, 0] = bad
        with pytest.raises(ConfigError, match=f"{name} is not finite in row 1"):
            model.rollout(**start, steps=3)
        with pytest.raises(ConfigError, match=f"{name} is not finite: "):
            model.rollout(**{key: x[1] for key, x in start.items()}, steps=3)


class Plain(Lagrangian):
    """Masses and springs, without parameters to train."""

    def __init__(self, *, coordinates):
        super().__init__()
        self.n = coordinates.n

    def mass_matrix(self, q):
        return torch.eye(self.n, dtype=q.dtype).expand(len(q), -1, -1)

    def potential(self, q):
        return q.square().sum(-1)


class Masses(torch.nn.Module, Plain):
    """The same with a mass to train."""

    def __init__(self, *, coordinates):
        super().__init__()
        self.n, self.mass = coordinates.n, torch.nn.Parameter(torch.ones(()))

    def mass_matrix(self, q):
        return self.mass * super().mass_matrix(q)


WIDE = type("Wide", (Masses,), {"potential": lambda self, q: q})
VECTOR = type("Vector", (Masses,), {"mass_matrix": lambda self, q: torch.ones(self.n)})
TURNED = Coordinates.of(rotations=("R",))


@pytest.mark.parametrize("method", ["l_node", "symo", "e2e_symo"])
@pytest.mark.parametrize(
    ("kind", "told", "changes"),
    [
        (Plain, r"lagrangian: Plain has to inherit from torch\.nn\.Module and symo_exp\..*", {}),
        (WIDE, r"Wide\.potential\(q\) has shape .* expected \(4,\)", {}),
        (VECTOR, r"Vector\.mass_matrix\(q\) has shape \(2,\)", {}),
        (Masses, "Masses.space is .*define a property space", {"coordinates": TURNED}),
    ],
)
def test_a_lagrangian_of_a_user_that_cannot_be_learned_is_refused(method, kind, told, changes):
    assert make(method, "midpoint", 2, lagrangian=Masses).learns
    with pytest.raises(ConfigError, match=told):
        make(method, "midpoint", 2, lagrangian=kind, **changes)


def test_an_integrator_of_another_kind_is_refused():
    node, symo = (make(method, "midpoint", 2) for method in ("node", "symo"))
    with pytest.raises(ConfigError, match=r"VariationalMidpoint: expected a .*\.RungeKutta$"):
        ExplicitFlow(node.flow.field, VariationalMidpoint(), H)
    with pytest.raises(
        ConfigError, match=r"integrator is RK4: expected a .*\.VariationalIntegrator$"
    ):
        VariationalFlow(symo.lagrangian, RK4(), H, symo.input_matrix, root=symo.flow.root)


@pytest.mark.parametrize("name", ["galerkin4", "galerkin6", "galerkin10"])
def test_a_prediction_counts_as_found_only_from_a_motion_that_was_found(name):
    """Turned by more than a revolution in a step, a light link has no motion that is found."""
    link = {"length_2": 0.05, "centre_2": 0.025, "inertia_2": 0.01}
    system = instantiate(stated("acrobot") | link)
    (q, v, u), h = system.points(64, seed=5), system.time_step
    settings = {"integrator": variational_integrators()[name], "root": Newton(tolerance=1e-8)}
    model = TrueVariational(system, **arguments_of(system), **settings).for_evaluation()
    for speed, all_found in ((1.0, True), (15.0, False)):
        before = q - speed * h * v
        samples = Windows(before, q, q, v, v, u, u, u)
        at = model.flow.expand_before(samples)
        found = at.stationarity.abs().amax((0, -1)) < 1e-9
        assert bool(found.all()) == all_found
        assert not model.predict(samples).converged[~found].any()
        assert model.predict(samples).converged[found].any()
        assert torch.equal(model.initial_velocity(samples).isnan().any(1), ~found)


ROOTS = {
    "newton": Newton(tolerance=1e-11, max_iterations=50),
    "broyden": Broyden(tolerance=1e-11, max_iterations=100),
}


@pytest.mark.parametrize(("dtype", "error"), [(torch.float64, 1e-9), (torch.float32, 2e-3)])
@pytest.mark.parametrize("length", [1.0, 0.01])
@pytest.mark.parametrize(
    ("name", "root"),
    [("midpoint", "newton"), ("galerkin6", "broyden"),
     *(pytest.param(*x, marks=pytest.mark.slow)
       for x in (("midpoint", "broyden"), ("galerkin6", "newton")))],
)  # fmt: skip
@torch.no_grad()
def test_light_machines_are_as_accurate_as_heavy_ones(name, root, length, dtype, error):
    """Every pendulum of this length moves alike under torques in proportion to its inertia."""
    v = torch.tensor([[0.0], [3.0], [-2.0]]).double() / length**0.5
    q = torch.tensor([[0.3], [2.0], [0.001]]).double()
    push = torch.arange(21).double().sin()[None, :, None].expand(3, -1, -1)
    found = []
    for mass in (1.0, 1e-9, 1e-4, 1e3):
        system = dataclasses.replace(
            instantiate(stated("pendulum")),
            mass=mass,
            length=length,
            time_step=0.05 * length**0.5,
        )
        model = TrueVariational(
            system,
            integrator=variational_integrators()[name],
            root=ROOTS[root],
            **arguments_of(system),
        ).to(dtype)
        u = mass * length**2 * push
        paths = model.rollout(q, v, u), model.for_evaluation().step(q, v, u[:, 3], u[:, 4])
        assert all(path.converged.all() for path in paths)
        found.append([path.q.double() for path in paths])
    for one in found[1:]:
        for mine, other in zip(one, found[0], strict=True):
            torch.testing.assert_close(mine, other, atol=error, rtol=0.0)


@pytest.mark.parametrize("units", [Units(1e-6, 1e-3, 1e-6), Units(1e3, 10.0, 1e3)])
@pytest.mark.parametrize("name", ["midpoint", "galerkin6"])
@torch.no_grad()
def test_true_models_move_alike_in_any_units(name, units):
    """A cartpole of micrometres or kilometres moves as one of metres does in its own units."""
    paths, one = [], instantiate(stated("cartpole"))
    q, v, u = one.points(5, seed=2)
    for scale in (Units(), units):
        system = dataclasses.replace(
            one,
            time_step=one.time_step * scale.time,
            gravity=one.gravity * scale.size("m/s^2"),
            mass_cart=one.mass_cart * scale.mass,
            mass_pole=one.mass_pole * scale.mass,
            half_length=one.half_length * scale.length,
        )
        coordinates = system.coordinates._replace(units=scale)
        model = TrueVariational(
            system,
            integrator=variational_integrators()[name],
            root=Newton(tolerance=1e-10, max_iterations=50),
            **arguments_of(system) | {"coordinates": coordinates},
        ).double()
        sizes, push = coordinates.sizes, u[:, None].expand(-1, 21, -1) * scale.size("N")
        path = model.rollout(q * sizes, v * sizes / scale.time, push)
        assert path.converged.all()
        paths.append(path.q / sizes)
    torch.testing.assert_close(paths[1], paths[0], atol=1e-10, rtol=0.0)


@pytest.mark.parametrize(("method", "integrator"), one_each())
@pytest.mark.parametrize("n", [1, 2, 3])
def test_every_method_predicts_alike_in_any_units(method, integrator, n):
    """A machine of micrometres moves as one of metres with the same weights."""
    model, (small, sizes) = make(method, integrator, n), make_small(method, integrator, n)
    data = windows(n)
    scaled = Windows(*(x * sizes for x in data[:5]), *data[5:])
    found, expected = small.predict(scaled), model.predict(data)
    torch.testing.assert_close(found.q / sizes, expected.q)
    torch.testing.assert_close(found.v / sizes, expected.v)
    losses = (one.objective(one.flow, x).loss for one, x in ((small, scaled), (model, data)))
    torch.testing.assert_close(*losses)


@pytest.mark.parametrize("integrator", ["midpoint", "galerkin4"])
def test_a_method_of_a_user_moves_in_the_units_of_its_coordinates(integrator):
    symo, sizes = make_small("symo", integrator, 2)
    root = Newton(tolerance=1e-12, max_iterations=50)
    rule, matrix = variational_integrators()[integrator], symo.input_matrix
    flow = VariationalFlow(symo.lagrangian, rule, symo.time_step, matrix, root=root)
    mine = DynamicsModel(flow, coordinates=symo.coordinates).double()
    q, v = windows(2).q * sizes, windows(2).v * sizes
    assert torch.equal(mine.rollout(q, v, steps=20).q, symo.rollout(q, v, steps=20).q)
    assert torch.equal(mine.step(q, v).v, symo.step(q, v).v)
    assert root.tolerance == 1e-12
    assert rule.sizes is None
