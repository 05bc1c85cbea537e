"""Root finders: convergence, its report, and rows that do not disturb each other."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.roots import Broyden, Newton, attach_root


class At:
    """A row-wise function at one batch of points."""

    def __init__(self, problem, x, index, residual):
        self.problem, self.x, self.index, self.residual = problem, x, index, residual

    def jacobian(self):
        with torch.enable_grad():
            x = self.x.clone().requires_grad_()
            g = self.problem.function(x, self.index)
            rows = [
                torch.autograd.grad(g[:, i].sum(), x, retain_graph=True)[0]
                for i in range(g.shape[1])
            ]
        return torch.stack(rows, 1)

    def rows(self, index):
        return At(self.problem, self.x[index], self.index[index], self.residual[index])

    def replace(self, index, other):
        x, residual = (
            mine.index_copy(0, index, new)
            for mine, new in ((self.x, other.x), (self.residual, other.residual))
        )
        return At(self.problem, x, self.index, residual)


class Problem:
    def __init__(self, function, index=None, counts=None):
        self.function, self.index, self.counts = function, index, counts or []

    def at(self, x):
        self.counts.append(len(x))
        index = torch.arange(len(x)) if self.index is None else self.index
        return At(self, x, index, self.function(x, index))

    def rows(self, index):
        mine = index if self.index is None else self.index[index]
        return Problem(self.function, mine, self.counts)


FINDERS = {
    "newton": Newton(tolerance=1e-12, max_iterations=30),
    "newton-batch": Newton(tolerance=1e-12, max_iterations=30, stopping="batch"),
    "broyden": Broyden(tolerance=1e-12, max_iterations=60),
}


def coupled(x, index):
    """A smooth system with a different right-hand side in every row."""
    target = 0.1 * (index.to(x.dtype).unsqueeze(1) + 1.0)
    return x + 0.2 * torch.sin(x.flip(1)) - target


@pytest.mark.parametrize("name", FINDERS)
@pytest.mark.parametrize("n", [1, 2, 3])
def test_every_finder_reaches_the_root(name, n):
    root = FINDERS[name].solve(Problem(coupled), torch.zeros(9, n, dtype=torch.float64))
    assert root.converged.all()
    assert coupled(root.x, torch.arange(9)).abs().max() < 1e-11
    torch.testing.assert_close(root.evaluation.residual, coupled(root.x, torch.arange(9)))


@pytest.mark.parametrize("name", FINDERS)
def test_failure_is_reported_row_by_row(name):
    """``x² + 1`` has no root; its neighbours have."""

    def function(x, index):
        bad = (index == 1).unsqueeze(1)
        return torch.where(bad, x.square() + 1.0, x - 2.0)

    root = FINDERS[name].solve(Problem(function), torch.ones(3, 1, dtype=torch.float64))
    assert root.converged.tolist() == [True, False, True]
    assert torch.equal(root.x[[0, 2]], torch.full((2, 1), 2.0, dtype=torch.float64))


@pytest.mark.parametrize("name", FINDERS)
def test_not_a_number_is_a_failure(name):
    start = torch.tensor([[0.0], [float("nan")]], dtype=torch.float64)
    root = FINDERS[name].solve(Problem(coupled), start)
    assert not root.converged[1]


def test_a_steep_secant_far_from_a_root_is_no_root():
    """From 0 the first step ends at a pole at 1, and the secant there returns to 0."""

    def function(x, index):
        return x / ((1.0 - x).abs() + 1e-20) - 1.0

    root = FINDERS["broyden"].solve(Problem(function), torch.zeros(1, 1, dtype=torch.float64))
    assert root.evaluation.residual.abs().item() > 0.5
    assert not root.converged.item()


def test_a_row_without_a_root_does_not_slow_the_others():
    def function(x, index):
        return torch.where((index == 0).unsqueeze(1), x.square() + 1.0, x.exp() - 2.0)

    start = torch.zeros(100, 1, dtype=torch.float64) + 0.3
    by_row, by_batch = Problem(function), Problem(function)
    finder = {"tolerance": 1e-10, "max_iterations": 20}
    root = Newton(**finder).solve(by_row, start)
    iterations = root.iterations
    Newton(**finder, stopping="batch").solve(by_batch, start)
    assert root.converged.tolist() == [False] + [True] * 99
    assert iterations[0] < 20  # given up: no damping helps
    assert iterations[1:].max() <= 6
    assert sum(by_batch.counts) > 2 * sum(by_row.counts)


def test_damping_rescues_a_start_from_which_newton_diverges():
    def function(x, index):
        return torch.atan(x)

    start = torch.tensor([[3.0]], dtype=torch.float64)
    assert not Newton(max_iterations=8, stopping="batch").solve(Problem(function), start).converged
    assert Newton(max_iterations=20).solve(Problem(function), start).converged


def test_the_batch_stops_by_the_rule_of_the_thesis():
    """All rows go on until ``‖g‖_F ≤ tolerance √(B n)``, converged ones included."""
    start = torch.tensor([[0.0], [5.0]], dtype=torch.float64)

    def function(x, index):
        return x.square() - 4.0 + x

    root = Newton(tolerance=1e-3, stopping="batch").solve(Problem(function), start + 2.0)
    assert root.iterations[0] == root.iterations[1] > 1
    assert root.evaluation.residual.norm() <= 1e-3 * 2**0.5


@pytest.mark.parametrize("name", FINDERS)
@pytest.mark.parametrize("n", [1, 2, 3])
def test_implicit_derivative_of_any_residual_by_any_finder(name, n):
    theta = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)

    def root_of(theta):
        def function(x, index):
            return x.pow(3) + theta * x - torch.arange(1.0, n + 1, dtype=x.dtype) + 0.1 * x.flip(1)

        with torch.no_grad():
            start = torch.full((4, n), 0.9, dtype=torch.float64)
            root = FINDERS[name].solve(Problem(function), start)
        assert root.converged.all()
        return attach_root(root.x, function(root.x, None), root.evaluation.jacobian())

    (gradient,) = torch.autograd.grad(root_of(theta).sum(), theta)
    eps = 1e-6
    with torch.no_grad():
        slope = (root_of(theta + eps).sum() - root_of(theta - eps).sum()) / (2 * eps)
    torch.testing.assert_close(gradient, slope, atol=1e-7, rtol=1e-7)


@pytest.mark.parametrize(
    "arguments", [{"tolerance": 0.0}, {"max_iterations": 0}, {"stopping": "x"}]
)
def test_invalid_settings_are_refused(arguments):
    with pytest.raises(ConfigError, match=f"{next(iter(arguments))}=.*: expected"):
        Newton(**arguments)
