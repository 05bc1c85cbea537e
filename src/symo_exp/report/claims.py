"""What the thesis says of its methods, as comparisons that runs can decide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report import published
from symo_exp.report.labels import PAIRS, Pair
from symo_exp.report.ranking import BLOCK, Interval, margin, wide

NODE_MP, NODE_RK4, L_NODE_MP, L_NODE_RK4, SYMO, E2E = PAIRS
NODES, SYMOS = [NODE_MP, NODE_RK4], [SYMO, E2E]


class Claim(NamedTuple):
    """Each of ``lower`` has a smaller ``metric`` than each of ``higher``, by ``times`` at least.

    ``higher_metric``, where it is another one, is that of ``higher``.
    """

    section: str
    text: str
    system: str
    metric: str
    lower: list[Pair]
    higher: list[Pair]
    n_traj: int = 32
    noise_std: float = 0.0
    times: float = 1.0
    higher_metric: str | None = None


def _others(*mine: Pair) -> list[Pair]:
    return [pair for pair in PAIRS if pair not in mine]


def _learning_inertia(*mine: Pair) -> list[Pair]:
    return [pair for pair in _others(*mine) if pair not in NODES]


CLAIMS = [
    Claim("6.4.1", "With few trajectories NODE-RK4 overfits: its test error is 10 times its "
          "training error", "pendulum", "train_mse", [NODE_RK4], [NODE_RK4], 8,
          times=10, higher_metric="test_mse"),
    Claim("6.4.1", "NODE-RK4 needs more trajectories than L-NODE-RK4 and the SyMos for the same "
          "test error", "pendulum", "test_mse", [L_NODE_RK4, *SYMOS], [NODE_RK4], 8),
    Claim("6.4.1", "The SyMos integrate better than L-NODE-RK4", "pendulum", "integration_mse",
          SYMOS, [L_NODE_RK4]),
    Claim("6.4.1", "and by two orders of magnitude", "pendulum", "integration_mse",
          SYMOS, [L_NODE_RK4], times=100),
    Claim("6.4.1", "The explicit midpoint methods fail in long integration", "pendulum",
          "integration_mse", [L_NODE_RK4, *SYMOS], [NODE_MP, L_NODE_MP]),
    Claim("6.4.1", "E2E-SyMo tests better than SyMo, by little", "pendulum", "test_mse",
          [E2E], [SYMO]),
    Claim("6.4.1", "L-NODE-RK4 has the best energy", "pendulum", "energy_mse",
          [L_NODE_RK4], _others(L_NODE_RK4)),
    Claim("6.4.1", "L-NODE-RK4 has the best inertia", "pendulum", "inertia_mse",
          [L_NODE_RK4], _learning_inertia(L_NODE_RK4)),
    Claim("6.4.1", "The SyMos keep the energy better than the explicit midpoint methods",
          "pendulum", "energy_mse", SYMOS, [NODE_MP, L_NODE_MP]),
    Claim("6.5.1", "The NODEs overfit: their test error is 10 times their training error",
          "acrobot", "train_mse", NODES, NODES, times=10, higher_metric="test_mse"),
    Claim("6.5.1", "The NODEs have the largest test error", "acrobot", "test_mse",
          _others(*NODES), NODES),
    Claim("6.5.1", "E2E-SyMo has the best test error", "acrobot", "test_mse", [E2E], _others(E2E)),
    Claim("6.5.1", "E2E-SyMo integrates best from few trajectories", "acrobot", "integration_mse",
          [E2E], _others(E2E), 8),
    Claim("6.5.1", "E2E-SyMo has the best inertia from few trajectories", "acrobot", "inertia_mse",
          [E2E], _learning_inertia(E2E), 8),
    Claim("6.5.1", "L-NODE-RK4 has the lowest integration error", "acrobot", "integration_mse",
          [L_NODE_RK4], _others(L_NODE_RK4)),
    Claim("6.5.1", "L-NODE-RK4 has the best energy", "acrobot", "energy_mse",
          [L_NODE_RK4], _others(L_NODE_RK4)),
    Claim("6.5.1", "L-NODE-RK4 has the best inertia", "acrobot", "inertia_mse",
          [L_NODE_RK4], _learning_inertia(L_NODE_RK4)),
    Claim("6.6.1", "The NODEs test better than the L-NODEs", "cartpole", "test_mse",
          NODES, [L_NODE_MP, L_NODE_RK4]),
    Claim("6.6.1", "The NODEs overfit: their test error is 4 times their training error",
          "cartpole", "train_mse", NODES, NODES, times=4, higher_metric="test_mse"),
    Claim("6.6.1", "The SyMos test best", "cartpole", "test_mse", SYMOS, _others(*SYMOS)),
    Claim("6.6.1", "E2E-SyMo has the best test error", "cartpole", "test_mse", [E2E],
          _others(E2E)),
    Claim("6.6.1", "E2E-SyMo integrates best", "cartpole", "integration_mse", [E2E],
          _others(E2E)),
    Claim("6.6.1", "E2E-SyMo has the best inertia", "cartpole", "inertia_mse", [E2E],
          _learning_inertia(E2E)),
    Claim("6.6.1", "The NODEs do not keep the energy, the SyMos do", "cartpole", "energy_mse",
          SYMOS, NODES, times=10),
    Claim("6.6.4", "E2E-SyMo tests best under little noise (σ = 5e-4)", "cartpole", "test_mse",
          [E2E], _others(E2E), noise_std=5e-4),
    Claim("6.6.4", "E2E-SyMo integrates best under little noise (σ = 5e-4)", "cartpole",
          "integration_mse", [E2E], _others(E2E), noise_std=5e-4),
    Claim("6.6.4", "SyMo fails under much noise (σ = 1e-2)", "cartpole", "test_mse",
          _others(SYMO), [SYMO], noise_std=1e-2, times=10),
    Claim("6.6.4", "Under much noise (σ = 1e-2) E2E-SyMo is worse than NODEs and L-NODEs",
          "cartpole", "test_mse", _others(*SYMOS), [E2E], noise_std=1e-2),
]  # fmt: skip


class Verdict(NamedTuple):
    """``published`` says whether the thesis' own numbers bear the claim out.

    ``margin`` and ``interval`` are factors beyond the claimed one: above 1 the claim holds.
    """

    claim: Claim
    published: str
    ours: str
    margin: float
    interval: Interval
    seeds: int


def judge(measures: pd.DataFrame) -> list[Verdict]:
    """All claims, for the runs of one variant at the step of the thesis."""
    theirs = published.published().assign(seed=0)
    theirs = theirs[theirs.time_step == theirs.system.map(published.TIME_STEPS)]
    metrics = {claim.metric for claim in CLAIMS} | {c.higher_metric or c.metric for c in CLAIMS}
    tables = [{name: wide(source, name) for name in metrics} for source in (theirs, measures)]
    verdicts = []
    for claim in CLAIMS:
        said, _, _ = _decide(claim, tables[0])
        ours, (size, interval), seeds = _decide(claim, tables[1])
        verdicts.append(Verdict(claim, said, ours, size, interval, seeds))
    return verdicts


def _decide(
    claim: Claim, tables: Mapping[str, pd.DataFrame]
) -> tuple[str, tuple[float, Interval], int]:
    small, large = (
        _cell(claim, tables[metric])
        for metric in (claim.metric, claim.higher_metric or claim.metric)
    )
    size, interval, seeds = margin(small, claim.lower, claim.higher, large)
    factors = [10.0**x / claim.times for x in (size, *interval)]
    result = (factors[0], Interval(*factors[1:]))
    if not seeds:
        return "not run", result, 0
    if result[1].low > 1:
        return "holds", result, seeds
    if result[1].high <= 1:
        return "does not hold", result, seeds
    return "undecided", result, seeds


def _cell(claim: Claim, table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the claim's cell, one for each seed."""
    wanted = (claim.system, claim.n_traj, claim.noise_std)
    block = [level for level in BLOCK if level != "seed"]
    at = [tuple(values) == wanted for values in table.index.droplevel("seed")]
    return table[np.array(at, dtype=bool)].droplevel(block)
