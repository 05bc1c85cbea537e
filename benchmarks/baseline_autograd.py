"""Baseline (a): the four methods in plain PyTorch, every derivative by automatic differentiation.

The methods of the thesis are written as their equations: the Lagrangian is a scalar function, its
derivatives are `torch.autograd.grad(create_graph=True)`, and the Jacobian of Newton's method takes
n further backward passes an iteration. L-NODE and NODE use torchdiffeq's adjoint, and a rollout
follows one trajectory at a time.

Notation: q, v (B, n), u (B, m), step h; H(q) = L L^T + eps I, Lagrangian 1/2 v^T H v - V;
discrete Lagrangian L_d(q0, q1) = h Lagrangian((q0 + q1)/2, (q1 - q0)/h).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchdiffeq import odeint, odeint_adjoint

from benchmarks.cases import Case, Layer
from symo_exp.mechanics.types import Windows

EPSILON = 1e-9
TOLERANCE = 1e-5
MAX_ITERATIONS = 10
INTEGRATORS = ("rk4", "midpoint")  # torchdiffeq's "rk4" is the 3/8 rule


def mlp(layers: Sequence[Layer], dtype: torch.dtype) -> nn.Sequential:
    """Affine, tanh, affine, tanh, affine, with the given weights."""
    modules: list[nn.Module] = []
    for weight, bias in layers:
        linear = nn.Linear(weight.shape[1], weight.shape[0], dtype=dtype)
        with torch.no_grad():
            linear.weight.copy_(weight)
            linear.bias.copy_(bias)
        modules += [linear, nn.Tanh()]
    return nn.Sequential(*modules[:-1])


def gradient(output: Tensor, wrt: Tensor) -> Tensor:
    """d(sum of output)/d wrt, itself differentiable; the rows of a batch do not mix."""
    return torch.autograd.grad(output.sum(), wrt, create_graph=True)[0]


def jacobian(output: Tensor, wrt: Tensor) -> Tensor:
    """J_ij = d output_i / d wrt_j, one backward pass for each of the n rows: (B, n, n)."""
    return torch.stack([gradient(output[:, i], wrt) for i in range(output.shape[1])], dim=1)


class Method(nn.Module):
    """Base of the four methods: the embedding of the coordinates and the input."""

    input_matrix: Tensor

    def __init__(self, case: Case, layers: Sequence[Layer], dtype: torch.dtype = torch.float32):
        super().__init__()
        self.angular = list(case.angular)
        self.translational = [not a for a in case.angular]
        self.n, self.h = case.n, case.time_step
        self.register_buffer("input_matrix", torch.tensor(case.input_matrix, dtype=dtype))
        self.net = mlp(layers, dtype)

    def embedding(self, q: Tensor) -> Tensor:
        """s(q) = (r, cos phi, sin phi)."""
        phi = q[:, self.angular]
        return torch.cat([q[:, self.translational], torch.cos(phi), torch.sin(phi)], dim=1)

    def force(self, u: Tensor) -> Tensor:
        """B u."""
        return u @ self.input_matrix.T

    def residuals(self, windows: Windows) -> Tensor:
        """Return the residuals that training minimises, (B, k)."""
        raise NotImplementedError

    def loss(self, windows: Windows) -> Tensor:
        """Mean square of the residuals."""
        return self.residuals(windows).square().mean()

    def predict(self, windows: Windows) -> Tensor:
        """One-step prediction of q_{k+1}, (B, n)."""
        raise NotImplementedError

    def rollout(self, windows: Windows, steps: int) -> Tensor:
        """Configurations after 1..steps steps with u held, (B, steps, n), row by row."""
        raise NotImplementedError


class LagrangianMethod(Method):
    """A learned Lagrangian: the network gives the Cholesky factor of H, and V."""

    def mass_and_potential(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """H(q) (B, n, n) and V(q) (B,)."""
        out = self.net(self.embedding(q))
        factor = torch.diag_embed(nn.functional.softplus(out[:, : self.n]))
        rows, columns = torch.tril_indices(self.n, self.n, -1)
        factor[:, rows, columns] = out[:, self.n : -1]
        identity = torch.eye(self.n, dtype=q.dtype)
        return factor @ factor.transpose(1, 2) + EPSILON * identity, out[:, -1]

    def lagrangian(self, q: Tensor, v: Tensor) -> Tensor:
        """1/2 v^T H(q) v - V(q), (B,)."""
        mass, potential = self.mass_and_potential(q)
        return 0.5 * torch.einsum("bi,bij,bj->b", v, mass, v) - potential


class SyMo(LagrangianMethod):
    """Trained on the residual of the discrete Euler-Lagrange equations; predicts by Newton."""

    def __init__(
        self,
        case: Case,
        layers: Sequence[Layer],
        dtype: torch.dtype = torch.float32,
        *,
        tolerance: float = TOLERANCE,
        max_iterations: int = MAX_ITERATIONS,
    ):
        super().__init__(case, layers, dtype)
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.iterations = 0  # of the last call of `newton`

    def discrete_lagrangian(self, q0: Tensor, q1: Tensor) -> Tensor:
        """L_d(q0, q1), midpoint rule, (B,)."""
        return self.h * self.lagrangian((q0 + q1) / 2, (q1 - q0) / self.h)

    def discrete_euler_lagrange(self, windows: Windows, q_next: Tensor) -> Tensor:
        """g = D2 L_d(q_{k-1}, q_k) + D1 L_d(q_k, q_{k+1}) + h/4 B (u_{k-1} + 2 u_k + u_{k+1})."""
        with torch.enable_grad():
            q = windows.q.detach().requires_grad_()
            d2 = gradient(self.discrete_lagrangian(windows.q_prev, q), q)
            d1 = gradient(self.discrete_lagrangian(q, q_next), q)
        inputs = windows.u_prev + 2 * windows.u + windows.u_next
        return d2 + d1 + self.h / 4 * self.force(inputs)

    def newton(self, windows: Windows) -> Tensor:
        """Root q_{k+1} of g from 2 q_k - q_{k-1} until ||g||_F <= tol sqrt(B n): one rule for all.

        The result carries no graph.
        """
        q_next = 2 * windows.q - windows.q_prev
        enough = self.tolerance * q_next.numel() ** 0.5
        for iteration in range(self.max_iterations + 1):
            self.iterations = iteration
            with torch.enable_grad():
                q_next = q_next.detach().requires_grad_()
                g = self.discrete_euler_lagrange(windows, q_next)
            if g.norm() <= enough or iteration == self.max_iterations:
                break
            with torch.enable_grad():
                slope = jacobian(g, q_next)
            q_next = q_next.detach() - torch.linalg.solve(slope.detach(), g.detach())
        return q_next.detach()

    def residuals(self, windows: Windows) -> Tensor:
        return self.discrete_euler_lagrange(windows, windows.q_next)

    def predict(self, windows: Windows) -> Tensor:
        return self.newton(windows)

    def rollout(self, windows: Windows, steps: int) -> Tensor:
        trajectories = []
        for row in range(len(windows.q)):
            w, configurations = windows.rows(slice(row, row + 1)), []
            w = w._replace(u_prev=w.u, u_next=w.u)
            for _ in range(steps):
                q_next = self.newton(w)
                w = w._replace(q_prev=w.q, q=q_next)
                configurations.append(q_next)
            trajectories.append(torch.stack(configurations, dim=1))
        return torch.cat(trajectories)


class E2ESyMo(SyMo):
    """Trained on the root itself, through the implicit function theorem."""

    def root(self, windows: Windows) -> Tensor:
        """q* - J^{-1} g(q*; theta) with J constant: the value of the root, and its gradient."""
        q_next = self.newton(windows).requires_grad_()
        g = self.discrete_euler_lagrange(windows, q_next)
        slope = jacobian(g, q_next).detach()
        return q_next.detach() - torch.linalg.solve(slope, g)

    def residuals(self, windows: Windows) -> Tensor:
        return self.root(windows) - windows.q_next


class OdeMethod(Method):
    """x = (q, v, u), x' = (v, acceleration, 0), integrated over one step h by torchdiffeq."""

    def __init__(
        self,
        case: Case,
        layers: Sequence[Layer],
        dtype: torch.dtype = torch.float32,
        *,
        integrator: str = "rk4",
        adjoint: bool = True,
    ):
        super().__init__(case, layers, dtype)
        self.integrator, self.solve = integrator, odeint_adjoint if adjoint else odeint
        self.register_buffer("times", torch.tensor([0.0, case.time_step], dtype=dtype))

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """v', (B, n)."""
        raise NotImplementedError

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        """The augmented dynamics, as torchdiffeq wants them."""
        q, v, u = x[:, : self.n], x[:, self.n : 2 * self.n], x[:, 2 * self.n :]
        return torch.cat([v, self.acceleration(q, v, u), torch.zeros_like(u)], dim=1)

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q, v) one step later, the input held."""
        x = self.solve(self, torch.cat([q, v, u], dim=1), self.times, method=self.integrator)[-1]
        return x[:, : self.n], x[:, self.n : 2 * self.n]

    def residuals(self, windows: Windows) -> Tensor:
        q, v = self.step(windows.q, windows.v, windows.u)
        return torch.cat([q - windows.q_next, v - windows.v_next], dim=1)

    @torch.no_grad()
    def predict(self, windows: Windows) -> Tensor:
        return self.step(windows.q, windows.v, windows.u)[0]

    @torch.no_grad()
    def rollout(self, windows: Windows, steps: int) -> Tensor:
        trajectories = []
        for row in range(len(windows.q)):
            w, configurations = windows.rows(slice(row, row + 1)), []
            q, v = w.q, w.v
            for _ in range(steps):
                q, v = self.step(q, v, w.u)
                configurations.append(q)
            trajectories.append(torch.stack(configurations, dim=1))
        return torch.cat(trajectories)


class LNODE(OdeMethod, LagrangianMethod):
    """v' = H^{-1} (B u - Hdot v + dLagrangian/dq)."""

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        with torch.enable_grad():
            if not q.requires_grad:
                q = q.detach().requires_grad_()
            mass, potential = self.mass_and_potential(q)
            momentum = torch.einsum("bij,bj->bi", mass, v)
            lagrangian = 0.5 * (v * momentum).sum(dim=1) - potential
            lagrangian_q = gradient(lagrangian, q)
            mass_rate_v = torch.einsum("bij,bj->bi", jacobian(momentum, q), v)
            return torch.linalg.solve(mass, self.force(u) - mass_rate_v + lagrangian_q)


class NODE(OdeMethod):
    """v' = MLP(s(q), v, u)."""

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return self.net(torch.cat([self.embedding(q), v, u], dim=1))


CLASSES: dict[str, type[Method]] = {
    "e2e_symo": E2ESyMo,
    "l_node": LNODE,
    "symo": SyMo,
    "node": NODE,
}
