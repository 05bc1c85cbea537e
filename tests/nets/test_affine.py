"""The Jacobian by samples of every method and integrator against one backward pass a sample."""

import pytest
import torch

from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Windows
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.nets.affine import parameter_jacobian
from tests.learned import assert_jacobian
from tests.models.methods import learner, pairwise, windows

CASES = [
    *((*case, {}) for case in pairwise()),
    *((*case, {"objective": PreconditionedResidual()}) for case in pairwise() if "symo" in case),
]


@pytest.mark.parametrize(("method", "integrator", "n", "overrides"), CASES)
def test_the_jacobian_by_samples_is_that_of_backward_passes(method, integrator, n, overrides):
    model, data = learner(method, integrator, n, **overrides), windows(n)
    assert_jacobian(lambda: model.residuals(data), list(model.parameters()))


def test_the_jacobian_by_samples_is_right_where_some_have_no_root():
    fit, data = learner("e2e_symo", "midpoint", 2), windows(2)
    model = fit.model
    hard = data._replace(q_next=data.q_next + 1e-3)  # a row that needs more than one step
    data = Windows(*(torch.cat((a[:2], b[2:])) for a, b in zip(hard, data, strict=True)))
    data.q_next[2:] = model.predict(data).q[2:].detach()
    model.flow.root = Newton(tolerance=1e-9, max_iterations=1)
    failed = model.objective(model.flow, data).statistics["newton_failed"]
    assert 0 < failed < 1
    assert_jacobian(lambda: fit.residuals(data), list(fit.parameters()))


def test_a_parameter_used_outside_of_tracked_functions_is_refused():
    model, data = learner("node", "rk4", 2), windows(2)

    def function():
        return model.residuals(data) + model.model.flow.field.net.biases[-1].sum()

    with pytest.raises(RuntimeError, match=r"outside nets\.affine"):
        parameter_jacobian(function, list(model.parameters()))
    model.loss(data).backward()  # no hook is left
    assert all(p.grad is not None for p in model.parameters())
