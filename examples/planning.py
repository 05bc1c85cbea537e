"""Plan and follow motions of a model: iterative LQR with bounded inputs, time-varying LQR, LQR.

States are ``x = (q, v)`` and costs ``Σ h (δxᵀ Q δx + uᵀ R u) + δx_Tᵀ F δx_T``, with ``δx`` the
distance from the goal. All derivatives come from ``model.linearize``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor

HOLD = 2
"""Number of time steps for which a plan holds an input."""
ALPHAS = 0.5 ** torch.arange(10, dtype=torch.float64)
"""Step lengths that the line search tries, in one batch."""


class Plan(NamedTuple):
    """States (steps + 1, 2n), inputs (steps, m) and cost."""

    x: Tensor
    u: Tensor
    cost: float


class Planner:
    """Planner from ``start`` to ``goal`` in ``steps`` time steps, with inputs within ``±limit``.

    Args:
        model: A model with ``rollout`` and ``linearize``.
        start: Initial state (2n,).
        goal: Final state (2n,), an equilibrium.
        steps: Time steps of the plan.
        limit: Bound of the inputs.
        running: Diagonal of ``Q`` (2n,), per second.
        effort: Diagonal of ``R``, per second.
    """

    def __init__(
        self, model: Any, start: Tensor, goal: Tensor, *, steps: int, limit: float,
        running: Tensor, effort: float,
    ) -> None:  # fmt: skip
        self.model, self.start, self.goal, self.limit = model, start, goal, limit
        self.n, self.m = model.input_matrix.shape
        self.holds = steps // HOLD
        self.running = model.time_step * torch.diag(running)
        self.effort = model.time_step * effort * torch.eye(self.m, dtype=torch.float64)

    def improve(self, plan: Plan | None, final: Tensor, most: int) -> Plan:
        """Improve a plan for the final cost ``F``, by at most ``most`` iterations."""
        if plan is None:
            x = self.start.expand(self.holds * HOLD + 1, -1)
            plan = Plan(x, torch.zeros(len(x) - 1, self.m, dtype=torch.float64), 0.0)
        zero = torch.zeros(self.holds, self.m, 2 * self.n, dtype=torch.float64)
        plan, damping = self._forward(plan, final, zero[..., 0], zero), 1e-3
        for _ in range(most):
            found = self._forward(plan, final, *self._backward(plan, final, damping))
            gained = plan.cost - found.cost
            if gained > 0:
                plan, damping = found, max(0.3 * damping, 1e-6)
            else:
                damping *= 10.0
            if damping > 1e8 or 0 < gained < 1e-5 * plan.cost:
                break
        return plan

    def _forward(self, plan: Plan, final: Tensor, k: Tensor, feedback: Tensor) -> Plan:
        """Return the best plan of a line search along the gains."""
        x = self.start.expand(len(ALPHAS), -1)
        xs, us, lost = [x[:, None]], [], torch.zeros(len(ALPHAS), dtype=torch.bool)
        for t in range(self.holds):
            change = ALPHAS[:, None] * k[t] + (x - plan.x[HOLD * t]) @ feedback[t].T
            u = (plan.u[HOLD * t] + change).clamp(-self.limit, self.limit)
            held = u[:, None].expand(-1, HOLD + 1, -1)
            path = self.model.rollout(*x.split(self.n, dim=1), held)
            xs.append(torch.cat((path.q, path.v), dim=2)[:, 1:])
            us.append(held[:, 1:])
            x, lost = xs[-1][:, -1], lost | ~path.converged.all(1)
        x, u = torch.cat(xs, dim=1), torch.cat(us, dim=1)
        off = x - self.goal
        cost = _square(off[:, :-1], self.running).sum(1) + _square(u, self.effort).sum(1)
        cost += _square(off[:, -1], final)
        best = int(cost.where(~lost, torch.inf).nan_to_num(torch.inf).argmin())
        return Plan(x[best], u[best], float(cost[best]))

    def _backward(self, plan: Plan, final: Tensor, damping: float) -> tuple[Tensor, Tensor]:
        """Return the steps ``k`` and feedback gains ``K`` of all holds, by Riccati's recursion.

        ``a`` and ``b`` are the derivatives of a state within a hold with respect to the state and
        the input at its start.
        """
        derivatives, off = self.derivatives(plan), plan.x - self.goal
        value, slope = final, final @ off[-1]
        identity = torch.eye(2 * self.n, dtype=torch.float64)
        ks: list[Tensor] = []
        feedbacks: list[Tensor] = []
        for t in range(len(plan.u) - HOLD, -1, -HOLD):
            a, b = identity, torch.zeros_like(derivatives[1][0])
            effort, q_u = HOLD * self.effort, HOLD * self.effort @ plan.u[t]
            q_x, q_xx, q_ux, q_uu = 0.0, 0.0, 0.0, effort
            for s in range(t, t + HOLD + 1):
                here, there = self.running, self.running @ off[s]
                if s == t + HOLD:
                    here, there = value, slope
                q_x, q_u = q_x + a.T @ there, q_u + b.T @ there
                q_xx, q_ux = q_xx + a.T @ here @ a, q_ux + b.T @ here @ a
                q_uu = q_uu + b.T @ here @ b
                if s < t + HOLD:
                    a, b = derivatives[0][s] @ a, derivatives[0][s] @ b + derivatives[1][s]
            damped = q_uu + damping * b.T @ b
            k = torch.linalg.solve(damped, -q_u)
            feedback = torch.linalg.solve(damped, -(q_ux + damping * b.T @ a))
            inside = (plan.u[t] + k).clamp(-self.limit, self.limit) - plan.u[t]
            feedback = feedback * (inside == k)[:, None]  # an input at its limit cannot react
            slope = q_x + feedback.T @ (q_uu @ inside + q_u) + q_ux.T @ inside
            cross = feedback.T @ q_ux
            value = q_xx + feedback.T @ q_uu @ feedback + cross + cross.T
            ks.insert(0, inside)
            feedbacks.insert(0, feedback)
        return torch.stack(ks), torch.stack(feedbacks)

    def derivatives(self, plan: Plan) -> tuple[Tensor, Tensor]:
        """Return ``A`` and ``B`` for every time step of a plan."""
        a, b = self.model.linearize(*plan.x[:-1].split(self.n, dim=1), plan.u)
        return a, b

    def hold(self) -> tuple[Tensor, Tensor]:
        """Return the LQR gain at the goal, and ``F``, the total cost of a distance from it."""
        a, b = self.model.linearize(*self.goal.split(self.n))
        weights = (x.numpy() for x in (a, b, self.running, self.effort))
        value = torch.from_numpy(solve_discrete_are(*weights))
        return self._gain(a, b, value), value

    def follow(self, plan: Plan, value: Tensor) -> list[Tensor]:
        """Return the gains of time-varying LQR along a plan, one per time step."""
        gains: list[Tensor] = []
        for a, b in zip(*(x.flip(0) for x in self.derivatives(plan)), strict=True):
            k = self._gain(a, b, value)
            value = self.running + a.T @ value @ (a - b @ k)
            gains.insert(0, k)
        return gains

    def _gain(self, a: Tensor, b: Tensor, value: Tensor) -> Tensor:
        """Return ``K`` of ``u = −K δx``."""
        return torch.linalg.solve(self.effort + b.T @ value @ b, b.T @ value @ a)


def _square(x: Tensor, weight: Tensor) -> Tensor:
    return ((x @ weight) * x).sum(-1)
