"""Baseline (b): the same mathematics in `jax.jit`, as a user who knows JAX would write it.

Functions of one sample, `jax.vmap` over the batch, `jax.value_and_grad` of the loss, Newton in a
`lax.while_loop`, the gradient of the root by the implicit function theorem, Adam by hand, and one
`jax.jit` around the whole optimiser step. float32 unless JAX is told otherwise. Parameters are a
list of (weight (in, out), bias (out)).

Import this module before JAX is used elsewhere: it sets XLA to one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from benchmarks.cases import Case, Layer
from symo_exp.mechanics.types import Windows

EPSILON = 1e-9
TOLERANCE = 1e-5
MAX_ITERATIONS = 10

Parameters = list[tuple[Array, Array]]


class Samples(NamedTuple):
    """`Windows` as JAX arrays (a pytree)."""

    q_prev: Array
    q: Array
    q_next: Array
    v: Array
    v_next: Array
    u_prev: Array
    u: Array
    u_next: Array


class Adam(NamedTuple):
    """First and second moments, and the number of steps taken."""

    first: Parameters
    second: Parameters
    count: Array


def to_parameters(layers: Sequence[Layer]) -> Parameters:
    """The weights, transposed to (in, out), in JAX's default precision."""
    return [(jnp.asarray(w.numpy().T), jnp.asarray(b.numpy())) for w, b in layers]


def to_arrays(parameters: Parameters) -> list[np.ndarray]:
    """[weight (out, in), bias, ...]: the order of a PyTorch module's parameters."""
    return [np.asarray(x).T for layer in parameters for x in layer]


def to_samples(windows: Windows) -> Samples:
    """The windows in JAX's default precision."""
    return Samples(*(jnp.asarray(x.numpy()) for x in windows))


def mlp(parameters: Parameters, x: Array) -> Array:
    """Affine, tanh, affine, tanh, affine, of one sample."""
    for weight, bias in parameters[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = parameters[-1]
    return x @ weight + bias


def solve(matrix: Array, vector: Array) -> Array:
    """matrix^{-1} vector for one sample; by hand for one or two unknowns, where LAPACK is slow."""
    n = len(vector)
    if n == 1:
        return vector / matrix[0]
    if n == 2:
        (a, b), (c, d) = matrix
        x, y = vector
        return jnp.stack([d * x - b * y, a * y - c * x]) / (a * d - b * c)
    return jnp.linalg.solve(matrix, vector)


class Method:
    """One method as pure functions of (parameters, samples), jitted."""

    def __init__(
        self,
        name: str,
        case: Case,
        *,
        integrator: str = "rk4",
        lr: float = 1e-3,
        tolerance: float = TOLERANCE,
        max_iterations: int = MAX_ITERATIONS,
    ):
        self.n, self.h = case.n, case.time_step
        self.angular = np.array(case.angular)
        self.input_matrix = np.array(case.input_matrix)
        self.integrator, self.lr = integrator, lr
        self.tolerance, self.max_iterations = tolerance, max_iterations
        residuals, predict, rollout = {
            "symo": (self.del_residuals, self.root, self.variational_rollout),
            "e2e_symo": (self.root_residuals, self.root, self.variational_rollout),
            "l_node": (self.state_residuals, self.next_configuration, self.explicit_rollout),
            "node": (self.state_residuals, self.next_configuration, self.explicit_rollout),
        }[name]
        self.acceleration = self.network_acceleration if name == "node" else self.euler_lagrange
        self._residuals = residuals
        self.loss_and_gradient = jax.jit(jax.value_and_grad(self.loss))
        self.train_step = jax.jit(self._train_step, donate_argnums=(0, 1))
        self.predict = jax.jit(predict)
        self.rollout = jax.jit(rollout, static_argnums=2)
        self.newton_iterations = jax.jit(lambda p, s: self.newton(p, s)[2])

    # --- one sample -------------------------------------------------------------------------

    def embedding(self, q: Array) -> Array:
        """s(q) = (r, cos phi, sin phi)."""
        phi = q[self.angular]
        return jnp.concatenate([q[~self.angular], jnp.cos(phi), jnp.sin(phi)])

    def mass_and_potential(self, parameters: Parameters, q: Array) -> tuple[Array, Array]:
        """H(q) = L L^T + eps I (n, n) and V(q)."""
        n = self.n
        out = mlp(parameters, self.embedding(q))
        factor = jnp.diag(jax.nn.softplus(out[:n]))
        factor = factor.at[np.tril_indices(n, -1)].set(out[n:-1])
        return factor @ factor.T + EPSILON * jnp.eye(n), out[-1]

    def lagrangian(self, parameters: Parameters, q: Array, v: Array) -> Array:
        """1/2 v^T H(q) v - V(q)."""
        mass, potential = self.mass_and_potential(parameters, q)
        return 0.5 * v @ mass @ v - potential

    def discrete_lagrangian(self, parameters: Parameters, q0: Array, q1: Array) -> Array:
        """L_d(q0, q1) = h Lagrangian((q0 + q1)/2, (q1 - q0)/h)."""
        return self.h * self.lagrangian(parameters, (q0 + q1) / 2, (q1 - q0) / self.h)

    def d1(self, parameters: Parameters, q0: Array, q1: Array) -> Array:
        """D1 L_d."""
        return jax.grad(self.discrete_lagrangian, 1)(parameters, q0, q1)

    def known_half(self, parameters: Parameters, s: Samples) -> Array:
        """Return the part of g without q_{k+1}: D2 L_d(q_{k-1}, q_k) and the forces."""
        d2 = jax.grad(self.discrete_lagrangian, 2)(parameters, s.q_prev, s.q)
        return d2 + self.h / 4 * self.input_matrix @ (s.u_prev + 2 * s.u + s.u_next)

    def euler_lagrange(self, parameters: Parameters, q: Array, v: Array, u: Array) -> Array:
        """v' = H^{-1} (B u - Hdot v + dLagrangian/dq)."""

        def momentum(q: Array) -> Array:
            return self.mass_and_potential(parameters, q)[0] @ v

        mass = self.mass_and_potential(parameters, q)[0]
        mass_rate_v = jax.jvp(momentum, (q,), (v,))[1]
        lagrangian_q = jax.grad(self.lagrangian, 1)(parameters, q, v)
        return solve(mass, self.input_matrix @ u - mass_rate_v + lagrangian_q)

    def network_acceleration(self, parameters: Parameters, q: Array, v: Array, u: Array) -> Array:
        """v' = MLP(s(q), v, u)."""
        return mlp(parameters, jnp.concatenate([self.embedding(q), v, u]))

    def explicit_step(
        self, parameters: Parameters, q: Array, v: Array, u: Array
    ) -> tuple[Array, Array]:
        """(q, v) one step later, the input held: midpoint rule or Runge-Kutta's 3/8 rule."""
        h, n = self.h, self.n

        def rate(x: Array) -> Array:
            return jnp.concatenate([x[n:], self.acceleration(parameters, x[:n], x[n:], u)])

        x = jnp.concatenate([q, v])
        k1 = rate(x)
        if self.integrator == "midpoint":
            x = x + h * rate(x + h / 2 * k1)
        else:
            k2 = rate(x + h / 3 * k1)
            k3 = rate(x + h * (k2 - k1 / 3))
            k4 = rate(x + h * (k1 - k2 + k3))
            x = x + h / 8 * (k1 + 3 * (k2 + k3) + k4)
        return x[:n], x[n:]

    # --- a batch ----------------------------------------------------------------------------

    def newton(self, parameters: Parameters, s: Samples) -> tuple[Array, Array, Array]:
        """Roots q_{k+1} of g, the Jacobian there, and the number of iterations.

        From 2 q_k - q_{k-1} until ||g||_F <= tol sqrt(B n), one rule for the whole batch.
        """
        known = jax.vmap(partial(self.known_half, parameters))(s)

        @jax.vmap
        def value_and_jacobian(known: Array, q: Array, q_next: Array) -> tuple[Array, Array]:
            def g(x: Array) -> tuple[Array, Array]:
                value = known + self.d1(parameters, q, x)
                return value, value

            slope, value = jax.jacfwd(g, has_aux=True)(q_next)
            return value, slope

        enough = self.tolerance * s.q.size**0.5

        def unfinished(state: tuple) -> Array:
            _, g, _, iterations = state
            return (jnp.linalg.norm(g) > enough) & (iterations < self.max_iterations)

        def iterate(state: tuple) -> tuple:
            q_next, g, slope, iterations = state
            q_next = q_next - jax.vmap(solve)(slope, g)
            return q_next, *value_and_jacobian(known, s.q, q_next), iterations + 1

        guess = 2 * s.q - s.q_prev
        start = guess, *value_and_jacobian(known, s.q, guess), 0
        q_next, _, slope, iterations = lax.while_loop(unfinished, iterate, start)
        return q_next, slope, iterations

    def del_residuals(self, parameters: Parameters, s: Samples) -> Array:
        """g(q_{k+1}), the residual of the discrete Euler-Lagrange equations."""

        def g(s: Samples) -> Array:
            return self.known_half(parameters, s) + self.d1(parameters, s.q, s.q_next)

        return jax.vmap(g)(s)

    def root(self, parameters: Parameters, s: Samples) -> Array:
        """The root without a gradient."""
        return self.newton(parameters, s)[0]

    def root_residuals(self, parameters: Parameters, s: Samples) -> Array:
        """q* - q_{k+1}, with q* - J^{-1} g(q*; theta), J constant, for q*: implicit function."""
        q_next, slope, _ = lax.stop_gradient(self.newton(lax.stop_gradient(parameters), s))
        g = self.del_residuals(parameters, s._replace(q_next=q_next))
        return q_next - jax.vmap(solve)(slope, g) - s.q_next

    def state_residuals(self, parameters: Parameters, s: Samples) -> Array:
        """(q, v) predicted less (q, v) seen."""
        q, v = jax.vmap(partial(self.explicit_step, parameters))(s.q, s.v, s.u)
        return jnp.concatenate([q - s.q_next, v - s.v_next], axis=1)

    def next_configuration(self, parameters: Parameters, s: Samples) -> Array:
        """One-step prediction of q_{k+1}."""
        return jax.vmap(partial(self.explicit_step, parameters))(s.q, s.v, s.u)[0]

    def variational_rollout(self, parameters: Parameters, s: Samples, steps: int) -> Array:
        """Configurations after 1..steps steps under the input held at u, (B, steps, n)."""
        s = s._replace(u_prev=s.u, u_next=s.u)

        def advance(configurations: tuple, _: None) -> tuple[tuple, Array]:
            q_prev, q = configurations
            q_next = self.root(parameters, s._replace(q_prev=q_prev, q=q))
            return (q, q_next), q_next

        return lax.scan(advance, (s.q_prev, s.q), None, length=steps)[1].swapaxes(0, 1)

    def explicit_rollout(self, parameters: Parameters, s: Samples, steps: int) -> Array:
        """Configurations after 1..steps steps under the input held at u, (B, steps, n)."""
        step = jax.vmap(partial(self.explicit_step, parameters))

        def advance(state: tuple, _: None) -> tuple[tuple, Array]:
            q, v = step(*state, s.u)
            return (q, v), q

        return lax.scan(advance, (s.q, s.v), None, length=steps)[1].swapaxes(0, 1)

    # --- training ---------------------------------------------------------------------------

    def loss(self, parameters: Parameters, s: Samples) -> Array:
        """Mean square of the residuals."""
        return jnp.mean(self._residuals(parameters, s) ** 2)

    def start(self, parameters: Parameters) -> Adam:
        """Adam before its first step."""
        zeros: Callable = partial(jax.tree.map, jnp.zeros_like)
        return Adam(zeros(parameters), zeros(parameters), jnp.zeros((), jnp.int32))

    def _train_step(
        self, parameters: Parameters, adam: Adam, s: Samples
    ) -> tuple[Parameters, Adam, Array]:
        """Loss, gradient and Adam (beta 0.9, 0.999, eps 1e-8, as PyTorch's)."""
        loss, slope = jax.value_and_grad(self.loss)(parameters, s)
        count = adam.count + 1
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, adam.first, slope)
        second = jax.tree.map(lambda m, g: 0.999 * m + 0.001 * g * g, adam.second, slope)
        rate, scale = self.lr / (1 - 0.9**count), jnp.sqrt(1 - 0.999**count)
        parameters = jax.tree.map(
            lambda p, m, v: p - rate * m / (jnp.sqrt(v) / scale + 1e-8), parameters, first, second
        )
        return parameters, Adam(first, second, count), loss
