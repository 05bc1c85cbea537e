"""The recipe of a run: build what the configuration names, fit, evaluate, keep."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import lightning
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from symo_exp import studies
from symo_exp.configuration.folders import digest
from symo_exp.data.datamodule import TrajectoryData
from symo_exp.errors import ConfigError
from symo_exp.evaluation.evaluate import Evaluation, evaluate
from symo_exp.evaluation.study import afresh
from symo_exp.models.base import DynamicsModel
from symo_exp.systems.base import System
from symo_exp.tracking import artifacts
from symo_exp.tracking.tracker import Tracker
from symo_exp.trained import load
from symo_exp.training import resuming, stopping
from symo_exp.training.outcome import one_line

log = logging.getLogger(__name__)

CHECKPOINTS = "checkpoints"
"""Where in the folder of a run."""


class Parts(NamedTuple):
    """What a configuration names."""

    system: System
    data: TrajectoryData
    model: DynamicsModel
    tracker: Tracker
    trainer: lightning.Trainer


class Run(NamedTuple):
    parts: Parts
    evaluation: Evaluation


def run(config: DictConfig, folder: Path, choices: Mapping[str, str]) -> Run:
    """One run: its files go to ``folder``, its curves and measures to the tracker.

    It goes on where an earlier start in the same folder was cut. ``choices`` names the files that
    the groups of the configuration come from.
    """
    start = time.perf_counter()
    name = f"{choices['model']} {choices['system']}"
    parts = build(config, folder)
    artifacts.write_config(folder, plain(config))
    with (
        default_dtype(config.dtype),
        parts.tracker.run(name=name, parameters=parameters(config, choices), folder=folder),
    ):
        train(parts, folder / CHECKPOINTS, digest(config))
        evaluation = evaluate(parts.model.cpu(), parts.system, parts.data)
        artifacts.write_measures(folder, evaluation.measures)
        artifacts.write_rollouts(folder, evaluation.rollouts)
        if config.pictures:
            draw(parts, evaluation, choices["model"], name, folder / artifacts.PICTURES)
        found = study(config, folder, parts.model, parts)
        parts.tracker.log_measures(evaluation.measures | found)
        parts.tracker.log_run_folder(folder)
    seconds = time.perf_counter() - start
    where = "; ".join(filter(None, [os.path.relpath(folder), parts.tracker.address]))
    log.info("%s: %s  (%.0f s; %s)", name, one_line(evaluation.measures), seconds, where)
    return Run(parts, evaluation)


def study_finished(config: DictConfig, folder: Path, choices: Mapping[str, str]) -> None:
    """The studies that a finished run lacks, with the model that it left in ``folder``."""
    start = time.perf_counter()
    name = f"{choices['model']} {choices['system']}"
    parts = build(config, folder)
    with (
        default_dtype(config.dtype),
        parts.tracker.run(name=name, parameters=parameters(config, choices), folder=folder),
    ):
        found = study(config, folder, load(folder), parts)
        parts.tracker.log_measures(found)
        parts.tracker.log_run_folder(folder)
    told = "  ".join(f"{key} {value:.3g}" for key, value in found.items())
    seconds = time.perf_counter() - start
    log.info("%s: %s  (%.0f s; %s)", name, told, seconds, os.path.relpath(folder))


def study(config: DictConfig, folder: Path, model: DynamicsModel, parts: Parts) -> dict[str, float]:
    """Do the studies that are asked for and not done; their measures."""
    asked = plain(config)["study"]
    found: dict[str, float] = {}
    cache = getattr(parts.data, "cache", None)  # recorded data have none
    remember = afresh if cache is None else cache.get
    for name in studies.missing(asked, folder):
        finding = _make(config.study, name)(model, parts.system, remember)
        studies.keep(name, asked[name], finding, folder)
        found |= finding.measures
    return found


def train(parts: Parts, folder: Path, run: str) -> None:
    """Fit, from the last sound checkpoint in ``folder`` on if there is one."""
    if not parts.model.learns:
        parts.data.prepare_data()
        parts.data.setup()
        return
    saved = resuming.latest(folder, run, parts.model)
    if saved is not None and saved.complete:
        parts.data.prepare_data()
        parts.data.setup()
        parts.model.load_state_dict(saved.state["state_dict"])
        parts.tracker.load_state_dict(saved.state.get("logger", {}))
        parts.tracker.finalize("success")
        return
    if saved is not None:
        log.info("going on after epoch %d", saved.state["epoch"])
    path = None if saved is None else str(saved.path)
    parts.trainer.fit(parts.model, datamodule=parts.data, ckpt_path=path)
    stopping.raise_if_requested()


def draw(parts: Parts, evaluation: Evaluation, method: str, title: str, folder: Path) -> None:
    """The pictures of a run. Nothing of it is lost if they cannot be drawn."""
    from symo_exp.report.pictures import draw_run

    model = parts.model.for_evaluation()
    try:
        draw_run(
            model, parts.system, evaluation.rollouts, method=method, title=title, folder=folder
        )
    except Exception:
        log.warning("the pictures could not be drawn", exc_info=True)


def build(config: DictConfig, folder: Path) -> Parts:
    """Everything but the data themselves, which are generated by the fit: quick, and so what
    the check of a command does for every job. Raises ``ConfigError``."""
    if not 0 <= config.seed < 2**32:
        raise ConfigError(f"seed={config.seed}: expected a whole number from 0 to {2**32 - 1}")
    lightning.seed_everything(config.seed, verbose=False)
    system = _make(config, "system")
    data = _make(config, "data", system=system)
    with default_dtype(config.dtype):
        model = _make(
            config,
            "model",
            coordinates=system.coordinates,
            input_matrix=system.input_matrix,
            time_step=system.time_step,
        )
    for name in config.study:
        _make(config.study, name)
    tracker = _make(config, "logger")
    where = {"folder": folder / CHECKPOINTS, "run": digest(config)}
    trainer = _make(config, "trainer", **where, logger=tracker)
    try:
        if model.learns:
            model.configure_optimizers()
    except (ValueError, TypeError, RuntimeError) as error:
        raise ConfigError(f"optimizer or scheduler: {error}") from error
    return Parts(system, data, model, tracker, trainer)


def _make(config: DictConfig, group: str, **given: Any) -> Any:
    try:
        return instantiate(config[group], **given)
    except InstantiationException as error:
        cause = error.__cause__ or error
        if isinstance(cause, ConfigError):
            raise cause from error
        raise ConfigError(f"{group}: {' '.join(str(cause).split())}") from error


@contextmanager
def default_dtype(name: str) -> Iterator[None]:
    """The precision of tensors that are made without one."""
    if name not in ("float32", "float64"):
        raise ConfigError(f"dtype={name} is not a choice; possible: float32, float64")
    before = torch.get_default_dtype()
    torch.set_default_dtype(getattr(torch, name))
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def plain(config: DictConfig) -> dict[str, Any]:
    """The configuration with every reference resolved."""
    values = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items()}


def parameters(config: DictConfig, choices: Mapping[str, str]) -> dict[str, Any]:
    """A flat table: the choice of every group and every value, each under one name."""
    groups = {g: c for g, c in choices.items() if not g.startswith("hydra/")}
    values = groups | dict(_values(config))
    # a finished run may be studied further: its parameters are what it was trained with
    return {name: x for name, x in values.items() if name.partition(".")[0] != "study"}


def _values(config: DictConfig, path: str = "") -> Iterator[tuple[str, Any]]:
    for key in map(str, config):
        name = f"{path}.{key}" if path else key
        value = config[key]
        if isinstance(value, DictConfig):
            if not OmegaConf.is_interpolation(config, key):  # told where it stands
                yield from _values(value, name)
        elif key != "_partial_":
            yield name, value
