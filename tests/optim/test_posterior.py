"""The posterior of a linear problem against its closed form, and estimates of the noise."""

import pytest
import torch

from symo_exp.mechanics.types import Trajectory
from symo_exp.nets.affine import repeated
from symo_exp.optim.posterior import posterior

H, NODES = 0.1, 400


class Falling:
    """``q'' = θ₁ s(q) + θ₂`` in second differences: residuals linear in the parameters."""

    def __init__(self, size=2):
        self.theta = torch.zeros(size, dtype=torch.float64, requires_grad=True)

    def residuals(self, windows):
        second = windows.q_next - 2.0 * windows.q + windows.q_prev
        theta = repeated(self.theta, len(windows.q))
        return second - H**2 * (theta[:, :1] * windows.u + theta[:, 1:2])


def motions(sigma, tau, count=3, seed=0, nodes=NODES):
    generator = torch.Generator().manual_seed(seed)
    found = []
    for k in range(count):
        t = H * torch.arange(nodes).double()
        u = torch.sin((1.0 + k) * t)
        q, v = torch.zeros(nodes).double(), 0.3
        for i in range(1, nodes):
            kick = (
                H**2 * (2.0 * u[i - 1] - 0.5) + tau * torch.randn(1, generator=generator).double()
            )
            step = (q[i - 1] - q[i - 2] if i > 1 else H * v) + kick
            q[i] = q[i - 1] + step
        y = q + sigma * torch.randn(nodes, generator=generator).double()
        found.append(Trajectory(y[:, None], torch.zeros(nodes, 1).double(), u[:, None]))
    return found


@pytest.mark.parametrize(("sigma", "tau"), [(1e-2, 0.0), (1e-2, 2e-3), (1e-5, 2e-3)])
def test_noise_of_nodes_and_of_the_model_are_told_apart(sigma, tau):
    problem = Falling()
    with torch.no_grad():
        problem.theta.copy_(torch.tensor([2.0, -0.5]))
    found = posterior(problem.residuals, [problem.theta], motions(sigma, tau), epsilon=0.1)
    if sigma > tau:
        assert found.noise == pytest.approx(sigma, rel=0.1)
    if tau:
        assert found.model_noise == pytest.approx(tau, rel=0.2)
    else:
        assert found.model_noise < 0.01 * sigma


def test_noise_is_proportional_to_the_data():
    """However small they are: the likelihood is not rounded to single precision."""
    problem, data, size = Falling(), motions(1e-2, 2e-3), 1e-20
    found = []
    for scale in (1.0, size):
        with torch.no_grad():
            problem.theta.copy_(torch.tensor([2.0, -0.5 * scale]))
        scaled = [Trajectory(scale * q, v, scale * u) for q, v, u in data]
        found.append(posterior(problem.residuals, [problem.theta], scaled, epsilon=0.1))
    expected, small = found
    assert small.noise / size == pytest.approx(expected.noise, rel=1e-3)
    assert small.model_noise / size == pytest.approx(expected.model_noise, rel=1e-3)


@pytest.mark.parametrize("epsilon", [None, 0.1, pytest.param(1.0, marks=pytest.mark.slow)])
def test_the_covariance_is_that_of_estimates(epsilon):
    """The scatter of estimates from many sets of noise is that of one posterior."""
    sigma, tau, estimates, covariances = 1e-2, 1e-3, [], []
    for seed in range(40):
        data = motions(sigma, tau, count=1, seed=seed, nodes=100)
        problem = Falling()
        with torch.no_grad():  # residuals are linear: one step is the estimate
            problem.theta.copy_(_estimate(problem, data, epsilon))
        at = posterior(problem.residuals, [problem.theta], data, epsilon=epsilon)
        estimates.append(at.mean - torch.tensor([2.0, -0.5]).double())
        covariances.append(at.directions @ at.directions.T)
    scatter = torch.stack([torch.outer(e, e) for e in estimates]).mean(0)
    expected = torch.stack(covariances).mean(0)
    ratio = scatter.diagonal() / expected.diagonal()
    assert (ratio > 0.5).all()
    assert (ratio < 1.9).all()


def _estimate(problem, data, epsilon):
    """The minimum over parameters, and over nodes where there is an ``ε``, by linear algebra."""
    (motion,) = data
    y, u = motion.q[:, 0], motion.u[:, 0]
    n = len(y)
    difference = torch.zeros(n - 2, n).double()
    for k in range(n - 2):
        difference[k, k : k + 3] = torch.tensor([1.0, -2.0, 1.0]).double()
    e = difference @ y
    slopes = H**2 * torch.stack((u[1:-1], torch.ones(n - 2).double()), 1)
    weight = torch.eye(n - 2).double()
    if epsilon is not None:
        weight = torch.linalg.inv(difference @ difference.T + epsilon**2 * weight)
    return torch.linalg.solve(slopes.T @ weight @ slopes, slopes.T @ weight @ e)


@pytest.mark.parametrize("of", ["residuals", "parameters", "nodes"])
@pytest.mark.parametrize("epsilon", [None, 0.1])
def test_there_is_none_where_a_residual_or_a_derivative_is_not_finite(of, epsilon):
    class Broken(Falling):
        def residuals(self, windows):
            found = super().residuals(windows)
            theta = repeated(self.theta, len(windows.q))[:, :1]
            zero = {"residuals": None, "parameters": 0.0 * theta, "nodes": 0.0 * windows.q}[of]
            at = torch.arange(len(found)).unsqueeze(1) == 3
            return found + at * (torch.nan if zero is None else zero.sqrt())

    problem = Broken()
    data = motions(1e-2, 1e-3, count=1, nodes=20)
    assert posterior(problem.residuals, [problem.theta], data, epsilon=epsilon) is None


def test_parameters_without_effect_are_free_directions():
    problem = Falling(3)
    found = posterior(problem.residuals, [problem.theta], motions(1e-2, 0.0), epsilon=0.1)
    torch.testing.assert_close(found.free.abs(), torch.tensor([[0.0], [0.0], [1.0]]).double())
    assert found.directions.shape == (3, 2)
    assert found.samples(5, torch.Generator().manual_seed(0))[:, 2].abs().max() == 0.0


@pytest.mark.parametrize("effect", [1e-20, 1e-60])
@pytest.mark.parametrize("epsilon", [None, 0.1])
def test_parameters_with_the_effect_of_rounding_are_free_directions(effect, epsilon):
    class Hardly(Falling):
        def residuals(self, windows):
            last = repeated(self.theta, len(windows.q))[:, 2:]
            return super().residuals(windows) + effect * windows.q * last

    data = motions(1e-2, 1e-3)
    problem, without = Hardly(3), Falling()
    found = posterior(problem.residuals, [problem.theta], data, epsilon=epsilon)
    expected = posterior(without.residuals, [without.theta], data, epsilon=epsilon)
    assert found.free.abs()[:, 0].tolist() == pytest.approx([0.0, 0.0, 1.0])
    informed = found.informed()
    covariance = expected.directions @ expected.directions.T  # of one more degree of freedom
    torch.testing.assert_close((informed @ informed.T)[:2, :2], covariance, rtol=1e-3, atol=0.0)
    assert float(informed[2].abs().max()) < 1e-9


def test_a_prior_determines_parameters_that_data_do_not():
    problem = Falling(3)
    alpha = torch.tensor([0.0, 0.0, 4.0]).double()
    found = posterior(
        problem.residuals, [problem.theta], motions(1e-2, 0.0), epsilon=0.1, precision=alpha
    )
    assert found.free.shape[1] == 1  # of the data
    assert found.directions[2].norm() == pytest.approx(0.5)


@pytest.mark.parametrize("own", [1e-2, 1.0, 1e3])
def test_without_its_prior_a_parameter_is_as_uncertain_as_if_it_had_none(own):
    """``own`` is the precision of the prior of one parameter over that of the data."""
    problem, data = Falling(), motions(1e-2, 2e-3)
    with torch.no_grad():
        problem.theta.copy_(torch.tensor([2.0, -0.5]))

    def of(precision):
        alpha = torch.tensor([precision, 0.0]).double()
        return posterior(problem.residuals, [problem.theta], data, epsilon=0.2, precision=alpha)

    free = of(0.0).directions.norm(dim=1)
    held = of(own / float(free[0]) ** 2)
    assert held.directions.norm(dim=1)[0] < free[0] * (1.0 + own) ** -0.45
    torch.testing.assert_close(held.without_prior().norm(dim=1), free, rtol=0.05, atol=0.0)
