"""Compiled training and rollouts.

If the compiler fails, a line is logged and computation continues uncompiled. Errors of the
functions that are compiled are raised.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

from torch import Tensor

from symo_exp.checks import instance
from symo_exp.compile.inductor import CompilerError, OpenRowsError
from symo_exp.compile.newton import RootLoss, Trainable, VariationalAdvance
from symo_exp.compile.program import Program
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Windows
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import ExplicitFlow, VariationalFlow
from symo_exp.models.objectives import NOTHING, RootError, Statistics

log = logging.getLogger(__name__)


def trains_compiled(learner: Trainable) -> bool:
    """Return whether the loss of a learner can be compiled."""
    flow, objective = learner.model.flow, learner.objective
    if isinstance(objective, RootError) and isinstance(flow, VariationalFlow):
        return isinstance(flow.root, Newton) and not flow.integrator.iterates
    return objective.branch_free(flow)


def compile_training(learner: Trainable, *, validation: bool = False) -> None:
    """Compile the training step of a learner at its next call.

    Args:
        learner: The learner; ``trains_compiled`` is true of it.
        validation: Whether to compile the validation loss as well.
    """

    def loss(*, open_rows: bool) -> Callable[..., Any]:
        found = _loss(learner, gradients=False, open_rows=open_rows)
        return lambda windows: found(windows)[0]

    step = partial(_loss, learner, gradients=True)
    _install(learner.compiled, "training step", step, learner.uncompiled_training)
    if validation:
        _install(learner.compiled, "validation", loss, learner.loss)


def compile_rollout(model: DynamicsModel) -> DynamicsModel:
    """Compile the steps of ``model.rollout`` at its next call, and return the same model.

    Compilation takes up to a minute for one trajectory or for several, in each precision, and some
    seconds in later processes; steps then take a fraction of their time. The motion is the same to
    the tolerance of the roots. If a step cannot be compiled, a line is logged and nothing changes.
    """
    instance("model", model, DynamicsModel)
    flow = model.flow
    variational = isinstance(flow, VariationalFlow) and isinstance(flow.rollout_root, Newton)
    known = isinstance(flow, ExplicitFlow) or (variational and not flow.space.rotations)
    if not (model.learns and known):
        log.warning("a step of this rollout is not a fixed sequence of operations: not compiled")
        return model

    def step(*, open_rows: bool) -> Callable[..., Any]:
        advance: Callable[..., Any]
        if isinstance(flow, VariationalFlow):
            advance = VariationalAdvance(model, flow, open_rows=open_rows)
        else:
            advance = Program(model, flow.advance, open_rows=open_rows)
        # Kernels belong to one layout of each tensor.
        return lambda *arguments: advance(*(x.contiguous() for x in arguments))

    _install(model.compiled, "rollout", step, flow.advance)
    return model


def _install(
    place: dict[str, Callable[..., Any]],
    what: str,
    build: Callable[..., Callable[..., Any]],
    other: Callable[..., Any],
) -> None:
    """Put a compiled function in place, or the other one for good if the compiler fails.

    One that cannot be compiled for all numbers of rows at once is compiled for each of them.
    """
    compiled = build(open_rows=True)

    def call(*arguments: Any) -> Any:
        nonlocal compiled
        try:
            return compiled(*arguments)
        except OpenRowsError:
            compiled = build(open_rows=False)
            return call(*arguments)
        except CompilerError as error:
            log.warning("the %s is not compiled: %s", what, error)
            compiled = other
            return other(*arguments)

    place[what] = call


def _loss(
    learner: Trainable, *, gradients: bool, open_rows: bool
) -> Callable[[Windows], tuple[Tensor, Statistics]]:
    """Return the compiled map from windows to loss and statistics.

    With ``gradients`` a call leaves them in the parameters.
    """
    model, objective = learner.model, learner.objective
    flow = model.flow
    if isinstance(objective, RootError) and isinstance(flow, VariationalFlow):
        return RootLoss(learner, flow, objective, gradients=gradients, open_rows=open_rows)

    def loss(windows: Windows) -> tuple[Tensor, dict[str, Tensor]]:
        residuals = objective(flow, windows)
        return residuals.loss, dict(residuals.statistics)

    program = Program(model, loss, gradients=gradients, open_rows=open_rows)

    def call(windows: Windows) -> tuple[Tensor, Statistics]:
        value, statistics = program(windows)
        return value, statistics.open() if statistics.tensors else NOTHING

    return call
