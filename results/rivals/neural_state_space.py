"""jax-sysid: state-space models by L-BFGS after Adam, linear or with networks.

The state is that of the machine, ``x = (q, v)`` in units of its standard deviations, and the angles
are the outputs. Three forms of ``x_{k+1} = f(x_k, u_k)`` are tried: linear; a network of state and
inputs (a recurrent network); and a network of sines, cosines, velocities and inputs for the
velocities' change, ``q_{k+1} = q_k + h v_{k+1}``. Training recordings are cut into windows that
begin in states of their own, the measured ones at first; all windows make one state, so that the
package sees a single experiment.
"""

import itertools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

os.environ.setdefault(  # before JAX: one core, like all others
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import jax
import jax.numpy as jnp
import numpy as np
import torch
from jax_sysid.models import Model
from machines import TIME_STEP, Machine
from torch import Tensor

from symo_exp.mechanics.types import Trajectories
from symo_exp.models.starts import RollsOut

NAME, GIVEN = "jax-sysid", "angles are angles; velocities"
ADAM, LBFGS, RATE = 500, 2000, 3e-3
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platform_name", "cpu")

Step = Callable[[Any, Any, Any], Any]
"""``f(x, u, params)`` of states (rows, 2n) and inputs (rows, m)."""


def layers(sizes: list[int]) -> list[Any]:
    """Weights by PyTorch's seed and offsets, the last ones zero: a step that changes nothing."""
    keys = jax.random.split(jax.random.PRNGKey(torch.initial_seed()), len(sizes))
    found = []
    for key, size, out in zip(keys, sizes[:-1], sizes[1:], strict=False):
        found += [jax.random.normal(key, (size, out)) / jnp.sqrt(size), jnp.zeros(out)]
    found[-2] = 0.0 * found[-2]
    return found


def network(z: Any, params: Any) -> Any:
    for i in range(0, len(params) - 2, 2):
        z = jnp.tanh(z @ params[i] + params[i + 1])
    return z @ params[-2] + params[-1]


def form(kind: str, n: int, m: int, hidden: list[int], scale: Any) -> tuple[Step, list[Any]]:
    """Return a form and its initial parameters."""
    if kind == "linear":
        return (
            lambda x, u, p: x + x @ p[0] + u @ p[1] + p[2],
            [jnp.zeros((2 * n, 2 * n)), jnp.zeros((m, 2 * n)), jnp.zeros(2 * n)],
        )
    if kind == "recurrent":
        return (
            lambda x, u, p: x + network(jnp.concatenate((x, u), 1), p),
            layers([2 * n + m, *hidden, 2 * n]),
        )

    def step(x: Any, u: Any, p: Any) -> Any:
        q = x[:, :n] * scale[:n]
        v = x[:, n:] + network(jnp.concatenate((jnp.sin(q), jnp.cos(q), x[:, n:], u), 1), p)
        return jnp.concatenate((x[:, :n] + TIME_STEP * v * scale[n:] / scale[:n], v), 1)

    return step, layers([3 * n + m, *hidden, n])


@dataclass
class StateSpace:
    """A fitted step of states and inputs, in units of ``scale`` and ``effort``."""

    step: Step
    params: list[Any]
    scale: Any
    effort: Any
    time_step = TIME_STEP

    def __post_init__(self) -> None:
        def rolled(x: Any, u: Any) -> Any:
            def body(x: Any, u: Any) -> Any:
                x = self.step(x, u, self.params)
                return x, x

            return jax.lax.scan(body, x, u)[1]

        self.rolled = jax.jit(rolled)

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> Trajectories:
        (rows, n), room = q0.shape, 1 << (len(q0) - 1).bit_length()  # few shapes to compile
        start = torch.cat((q0, v0), dim=1)
        held = np.zeros((u.shape[1] - 1, room, u.shape[2]))
        held[:, :rows] = u[:, :-1].numpy().swapaxes(0, 1) / self.effort
        first = np.zeros((room, 2 * n))
        first[:rows] = start.numpy() / self.scale
        found = np.array(self.rolled(first, held))[:, :rows] * np.asarray(self.scale)
        path = torch.cat((start[None], torch.from_numpy(found))).transpose(0, 1)
        return Trajectories(path[..., :n], path[..., n:], u)


def fitted(
    machine: Machine, *, kind: str, hidden: list[int], seconds: float, decay: float
) -> StateSpace:
    n, m, steps = machine.n, machine.m, round(seconds / TIME_STEP)
    whole = torch.cat([torch.cat((t.q, t.v), dim=1) for t in machine.train]).numpy()
    scale = jnp.asarray(whole.std(0))
    effort = jnp.asarray(torch.cat([t.u for t in machine.train]).numpy().std(0).clip(1e-12))
    parts = [
        (t.q[k : k + steps + 1].numpy(), t.v[k].numpy(), t.u[k : k + steps].numpy() / effort)
        for t in machine.train
        for k in range(0, len(t.q) - steps, steps)
    ]
    q, v, u = (np.stack(x) for x in zip(*parts, strict=True))
    count = len(q)
    step, params = form(kind, n, m, hidden, scale)

    def state_fcn(x: Any, u: Any, params: Any) -> Any:
        rows = step(x.reshape(count, 2 * n), u.reshape(count, m), params)
        return rows.reshape(-1)

    def output_fcn(x: Any, u: Any, params: Any) -> Any:
        return x.reshape(count, 2 * n)[:, :n].reshape(-1)

    model = Model(2 * n * count, n * count, m * count, state_fcn=state_fcn, output_fcn=output_fcn)
    start = np.concatenate((q[:, 0], v), axis=1) / scale
    model.init(params=params, x0=jnp.asarray(start).reshape(-1))
    model.loss(rho_x0=0.0, rho_th=decay)
    model.optimization(adam_eta=RATE, adam_epochs=ADAM, lbfgs_epochs=LBFGS, iprint=-1)
    outputs = (q / np.asarray(scale)[:n]).swapaxes(0, 1).reshape(steps + 1, -1)
    inputs = np.concatenate((u, u[:, -1:]), axis=1).swapaxes(0, 1).reshape(steps + 1, -1)
    model.fit(outputs, inputs)
    return StateSpace(step, [jnp.asarray(p) for p in model.params], scale, effort)


def candidates(machine: Machine) -> Iterator[tuple[str, Callable[[], RollsOut]]]:
    kinds: list[tuple[str, list[int]]] = [
        ("network", [16]), ("linear", []), ("recurrent", [16]), ("network", [16, 16]),
        ("network", [32]), ("network", [8]), ("network", [32, 32]), ("recurrent", [32]),
    ]  # fmt: skip
    for decay, seconds in itertools.product((1e-6, 1e-4, 1e-8), (0.5, 1.0)):
        for kind, hidden in kinds:
            settings = {"kind": kind, "hidden": hidden, "seconds": seconds, "decay": decay}
            words = (
                f"{kind}{''.join(f' {size}' for size in hidden)}, windows of {seconds:g} s, "
                f"decay {decay:g}"
            )
            yield words, lambda settings=settings: fitted(machine, **settings)
