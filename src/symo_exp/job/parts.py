"""The parts of a run: the objects that its configuration names."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import lightning
import torch
from torch.optim.lr_scheduler import ReduceLROnPlateau

from symo_exp import code
from symo_exp.checks import instance, one_of, real, whole_number
from symo_exp.errors import ConfigError, first_line, place_in_code
from symo_exp.evaluation.references import check_fit
from symo_exp.evaluation.study import check_study
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import check_objective
from symo_exp.optim.base import EpochOptimizer
from symo_exp.runs.digest import digest, kernels
from symo_exp.runs.folder import CHECKPOINTS, SERIES, RunFolder
from symo_exp.runs.instances import arguments_of, instance_of
from symo_exp.runs.load import copy_weights
from symo_exp.runs.series import Series
from symo_exp.systems.base import System
from symo_exp.systems.box import SamplingBox
from symo_exp.training.learner import SCHEDULE
from symo_exp.training.recording import SeriesRecorder

LEAST = {"T_max": 1, "patience": 0, "cooldown": 0}
"""The smallest values of settings of PyTorch's schedulers, which do not check them."""
CALL = r"(?P<made>[\w.<>]+?)(?:\.__init__)?\(\) "
MISSING = re.compile(CALL + r"missing \d+ required [\w-]+(?: [\w-]+)* arguments?: (?P<names>.+)")
UNEXPECTED = re.compile(CALL + r"got an unexpected keyword argument '(?P<name>\w+)'")
"""Python's words on an argument that is missing, and on one that a constructor does not take."""


class Parts(NamedTuple):
    """The objects that a configuration names."""

    system: Any
    data: Any
    model: Any
    learner: Any
    tracker: Any
    trainer: lightning.Trainer
    reference: Any
    run: str
    """Digest of the settings, which checkpoints carry."""
    idle: Collection[str]
    """Dotted names of settings that have no effect on this run."""


def build(settings: Mapping[str, Any], folder: RunFolder) -> Parts:
    """Build everything but the data, which the training simulates or reads.

    It is fast, so that a command checks every job by it.

    Raises:
        ConfigError: For arguments that a constructor refuses.
    """
    code.add(settings["code"])
    seed = settings["seed"]
    whole_number("seed", seed, low=0, high=2**32 - 1)
    lightning.seed_everything(seed, verbose=False)
    system = make(settings, "system")
    instance("system", system, System)
    if not isinstance(system.box, SamplingBox | None):
        raise ConfigError(
            f"{type(system).__name__}.__post_init__ does not call super().__post_init__()"
        )
    data = make(settings, "data", system=system)
    dtype = settings["dtype"]
    if (given := settings["data"].get("dtype", dtype)) != dtype:
        raise ConfigError(f"data.dtype={given}: training has dtype={dtype}; give dtype={given}")
    with default_dtype(dtype):
        model = make(settings, "model", **arguments_of(system))
    instance("model", model, DynamicsModel)
    if not hasattr(model, "flow"):
        raise ConfigError(
            f"{type(model).__name__}.__init__ does not call super().__init__(flow, coordinates=...)"
        )
    if model.learns and (start := settings["start_from"]) is not None:
        try:
            copy_weights(model, Path(str(start)).expanduser())
        except ConfigError as error:
            raise ConfigError(f"start_from: {error}") from error
    learner = make(settings, "learner", model=model) if model.learns else None
    reference = _reference(settings, system, data) if "reference" in settings else None
    for name in settings["study"]:
        check_study(f"study={name}", make(settings["study"], name))
    tracker = make(settings, "logger")
    recorder = SeriesRecorder(
        Series(folder / SERIES), lambda: tracker.publish(folder), tracker.flush_seconds
    )
    idle: Collection[str] = ["learner", "start_from"]
    if learner is not None:
        check_objective(learner.objective, model)
        optimizer = _optimizer(learner, settings["trainer"].get("accelerator", "cpu"))
        whole = isinstance(optimizer, EpochOptimizer)
        idle = [f"learner.{name}" for name in SCHEDULE] if whole else []
    run, compiled = digest(settings), kernels(settings)
    trainer = make(
        settings,
        "trainer",
        folder=folder / CHECKPOINTS,
        run=run,
        kernels=compiled,
        callbacks=[recorder],
    )
    return Parts(system, data, model, learner, tracker, trainer, reference, run, idle)


def _optimizer(learner: Any, accelerator: str) -> Any:
    """Return the optimiser of a learner, checked with its schedule."""
    try:
        (optimizer,), schedulers = learner.configure_optimizers()
    except ConfigError:
        raise
    except Exception as error:  # the optimiser may be a user's
        raise ConfigError(
            f"optimizer or scheduler: {first_line(error)}{place_in_code(error)}"
        ) from error
    for scheduler in schedulers:
        if isinstance(scheduler, ReduceLROnPlateau):
            real("scheduler.factor", scheduler.factor, above=0)
            real("scheduler.threshold", scheduler.threshold, low=0)
            real("scheduler.min_lr", min(scheduler.min_lrs), low=0)
            one_of("scheduler.mode", scheduler.mode, ["min"])  # of a loss
        for name, low in LEAST.items():
            if hasattr(scheduler, name):
                whole_number(f"scheduler.{name}", getattr(scheduler, name), low=low)
    if accelerator != "cpu" and isinstance(optimizer, EpochOptimizer) and optimizer.processor_only:
        raise ConfigError(
            f"trainer.accelerator={accelerator}: {type(optimizer).__name__} works on the processor "
            "only; give trainer=cpu, or an optimizer that works on both, such as adam"
        )
    return optimizer


def _reference(settings: Mapping[str, Any], system: Any, data: Any) -> Any:
    reference = make(settings, "reference")
    if not data.recorded:
        raise ConfigError(
            "reference: only models of recordings have one; give data=recorded or reference=none"
        )
    check_fit(reference, *system.input_matrix.shape)
    return reference


def make(settings: Mapping[str, Any], group: str, **given: Any) -> Any:
    """Instantiate a node of the configuration with further arguments."""
    if not isinstance(settings[group], Mapping):
        raise ConfigError(f"{group}: expected a class (_target_)")
    try:
        return instance_of(settings[group], **given)
    except ConfigError:
        raise
    except Exception as error:
        told = _told_call(str(error)) if isinstance(error, TypeError) else None
        reason = told or str(error) or type(error).__name__
        raise ConfigError(f"{group}: {reason}{place_in_code(error)}") from error


def _told_call(message: str) -> str | None:
    """Return Python's message about arguments of a constructor as what to do, if it is one."""
    if found := MISSING.match(message):
        names = found["names"].replace("'", "")
        return (
            f"{found['made']} needs {names}, which its settings do not have; write it in its file, "
            "beside _target_"
        )
    if found := UNEXPECTED.match(message):
        return (
            f"{found['made']} is given {found['name']}, which it does not take; add it to the "
            "arguments of its __init__"
        )
    return None


@contextmanager
def default_dtype(name: str) -> Iterator[None]:
    """Set PyTorch's default precision meanwhile."""
    one_of("dtype", name, ("float32", "float64"))
    before = torch.get_default_dtype()
    torch.set_default_dtype(getattr(torch, name))
    try:
        yield
    finally:
        torch.set_default_dtype(before)
