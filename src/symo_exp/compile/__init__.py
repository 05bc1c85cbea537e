"""Compiled training and rollouts.

If the compiler fails, a line is logged and computation continues uncompiled. Errors of the
functions that are compiled are raised.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from torch import Tensor

from symo_exp.compile.inductor import CompilerError, compiler_available, kernel_cache
from symo_exp.compile.newton import RootLoss, VariationalAdvance
from symo_exp.compile.program import Program
from symo_exp.compile.trainable import Trainable
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Windows
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import ExplicitFlow, VariationalFlow
from symo_exp.models.objectives import NOTHING, RootError, Statistics

__all__ = [
    "compile_rollout",
    "compile_training",
    "compiler_available",
    "kernel_cache",
    "trains_compiled",
]

log = logging.getLogger(__name__)


def trains_compiled(learner: Trainable) -> bool:
    """Return whether the loss of a learner can be compiled."""
    return _loss(learner, gradients=False) is not None


def compile_training(learner: Trainable, *, validation: bool = False) -> None:
    """Compile the training step of a learner at its next call.

    Args:
        learner: The learner.
        validation: Whether to compile the validation loss, too.
    """
    step, loss = _loss(learner, gradients=True), _loss(learner, gradients=False)
    assert step is not None
    assert loss is not None
    _install(learner.compiled, "training step", step, learner.uncompiled_training)
    if validation:
        _install(learner.compiled, "validation", lambda windows: loss(windows)[0], learner.loss)


def compile_rollout(model: DynamicsModel) -> None:
    """Compile the steps of ``model.rollout`` at its next call.

    Compilation takes up to a minute for each new number of trajectories and precision, some seconds
    in later processes; steps then take a fraction of their time. The motion is the same to the
    tolerance of the roots. If a step cannot be compiled, a line is logged and nothing changes.
    """
    flow = model.flow
    advance: Callable[..., Any] | None = None
    if model.learns and isinstance(flow, ExplicitFlow):
        advance = Program(model, flow.advance)
    elif model.learns and isinstance(flow, VariationalFlow) and _branch_free(flow):
        advance = VariationalAdvance(model, flow)
    if advance is None:
        log.warning("a step of this rollout is not a fixed sequence of operations: not compiled")
        return

    def contiguous(*arguments: Tensor) -> Any:  # kernels belong to one layout of each tensor
        return advance(*(x.contiguous() for x in arguments))

    _install(model.compiled, "rollout", contiguous, flow.advance)


def _branch_free(flow: VariationalFlow) -> bool:
    """Return whether steps without branches are known: rotations have none."""
    return isinstance(flow.rollout_root, Newton) and not flow.space.rotations


def _install(
    place: dict[str, Callable[..., Any]],
    what: str,
    compiled: Callable[..., Any],
    other: Callable[..., Any],
) -> None:
    """Put a compiled function in place, or the other one for good if the compiler fails."""

    def call(*arguments: Any) -> Any:
        nonlocal compiled
        try:
            return compiled(*arguments)
        except CompilerError as error:
            log.warning("the %s is not compiled: %s", what, error)
            compiled = other
            return other(*arguments)

    place[what] = call


def _loss(
    learner: Trainable, *, gradients: bool
) -> Callable[[Windows], tuple[Tensor, Statistics]] | None:
    """Return the compiled map from windows to loss and statistics, ``None`` if there is none.

    With ``gradients`` a call leaves them in the parameters.
    """
    model, objective = learner.model, learner.objective
    flow = model.flow
    if isinstance(objective, RootError) and isinstance(flow, VariationalFlow):
        if not isinstance(flow.root, Newton) or flow.integrator.iterates:
            return None
        return RootLoss(learner, flow, objective, gradients=gradients)
    if not objective.branch_free(flow):
        return None

    def loss(windows: Windows) -> tuple[Tensor, dict[str, Tensor]]:
        residuals = objective(flow, windows)
        return residuals.loss, dict(residuals.statistics)

    program = Program(model, loss, gradients=gradients)

    def call(windows: Windows) -> tuple[Tensor, Statistics]:
        value, statistics = program(windows)
        return value, statistics.open() if statistics.tensors else NOTHING

    return call
