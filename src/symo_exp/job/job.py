"""One job of a command, in any process."""

from __future__ import annotations

import logging
import math
import os
import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from symo_exp import code
from symo_exp.errors import ConfigError, Refused, debugging, first_line, one_line, place_in_code
from symo_exp.imports import first_import
from symo_exp.job.config import Settings, resolve
from symo_exp.job.lines import brief, run_line
from symo_exp.job.variant import differences
from symo_exp.process import phases, stopping
from symo_exp.report.looks import look
from symo_exp.runs.folder import PICTURES, SERIES, About, RunFolder
from symo_exp.runs.outcome import Status
from symo_exp.runs.series import read
from symo_exp.tracking.page import COMMAND
from symo_exp.tracking.revision import revision_tags

log = logging.getLogger(__name__)

SWEEP, VARIED = "SYMO_EXP_SWEEP", "SYMO_EXP_VARIED"
"""Environment variables: the identity of the sweep that a job belongs to, and what it varies."""
NAMED = "model=", "system=", "data.n_traj="
"""Settings that are in the name of every run."""
OURS = "hydra_plugins.symo_exp_sweeper.SymoExpSweeper"
READS_FOLDERS = "hydra_plugins.symo_exp_"
"""Prefix of the sweepers that read a run's folder and not the number that it returns."""


def job(config: DictConfig) -> float | None:
    """Do one run: the function that Hydra calls for each job.

    The outcome is recorded in the run folder, where our sweeper reads it. Nothing happens if the
    command was asked to stop, or if another process has finished the run.

    Returns:
        The ``optimized_metric`` for a sweeper that searches; the worst value for a run that failed
        or was refused, and where the metric is not a number, with which Optuna would end.

    Raises:
        Refused: For bad input in the first run of another sweeper than ours.
        Interrupted: If a signal ended the run, under another sweeper than ours.
    """
    hydras = HydraConfig.get()
    folder = RunFolder(hydras.runtime.output_dir)
    logging.raiseExceptions = debugging()  # a log that cannot be written: no traceback of that
    stopping.install()
    stopping.end_with_parent()
    if stopping.requested():
        return None
    settings = resolve(config)
    ours = hydras.sweeper._target_.startswith(READS_FOLDERS)
    if not (ours or settings.values["resume"]):
        told = f"resume=false: {hydras.sweeper._target_} goes on with its trials; give"
        raise Refused(ConfigError(f"{told} experiment=NAME for a new search"))
    try:
        failure = _do(settings, folder, hydras)
    except stopping.Interrupted as error:  # before the run, or after its outcome was recorded
        failure = error
    phases.clear()
    if failure is not None and debugging():
        raise failure
    if ours:
        return None
    if isinstance(failure, ConfigError) and hydras.job.num == 0:
        raise Refused(failure)  # that of a later trial is caused by what the search varies
    if isinstance(failure, stopping.Interrupted):
        raise failure
    trials = hydras.sweeper.get("n_trials")
    log.info("%s%s", f"trial {hydras.job.num + 1} of {trials}: " * bool(trials), run_line(folder))
    value = math.nan
    if failure is None:
        value = optimized(settings.values["optimized_metric"], folder)
    maximize = "maximize" in str(hydras.sweeper.get("direction"))
    worst = -math.inf if maximize else math.inf
    return worst if math.isnan(value) else value


def optimized(name: str, folder: RunFolder) -> float:
    """Return the measure of that name, else the last value of that series."""
    rows = [*read(folder / SERIES), folder.measures()]
    values = [row[name] for row in rows if name in row]
    if not values:
        there = ", ".join(sorted({key for row in rows for key in row}))
        told = f"optimized_metric={name}: no such measure or series; a run has: {there}"
        raise Refused(ConfigError(told))
    return values[-1]


def is_done(settings: Mapping[str, Any], folder: RunFolder) -> bool:
    """Return whether the run is finished and nothing else that was asked for is missing."""
    if folder.outcome().status != "finished":
        return False
    drawn = not settings["pictures"] or (folder / PICTURES).exists()
    measured = not settings["measures"] or folder.is_measured(settings.get("reference"))
    return drawn and measured and not folder.missing_studies(settings["study"])


def recordings_of(settings: Mapping[str, Any]) -> str:
    """Return a digest of the content of a run's recordings, nothing if there are none to read."""
    path = settings["data"].get("path")
    if path is None:
        return ""
    from symo_exp.data.paths import content_of, files  # pandas and SciPy

    with suppress(ConfigError, OSError):  # to read them tells the user why
        found = files(path)
        return content_of(found) if all(one.exists() for one in found) else ""
    return ""


def changed_recordings(
    settings: Mapping[str, Any], folder: RunFolder, *, restarts: bool
) -> ConfigError | None:
    """Return the refusal to continue with results of other recordings, ``None`` if there are none.

    Args:
        settings: Resolved settings of the job.
        folder: Its folder, whose name does not depend on the content of recordings.
        restarts: Whether the command starts a run anew with ``resume=false``.
    """
    if settings["data"].get("path") is None or not folder.has_results():
        return None
    before = folder.about()
    if before is None or not before.recordings:  # of a version that kept none
        return None
    if recordings_of(settings) in ("", before.recordings):
        return None
    from symo_exp.data.paths import shown  # pandas and SciPy

    anew = "resume=false to start this run anew, or " * restarts
    return ConfigError(
        f"{shown(settings['data']['path'])}: the recordings have changed since {folder} was "
        f"started; give {anew}experiment=NAME for a run beside it"
    )


def _do(settings: Settings, folder: RunFolder, hydras: Any) -> BaseException | None:
    """Do what is left of the run and return what ended it early, if anything did."""
    tracker: Any = None
    time_is_up = False
    with stopping.urgent(), folder.alone():
        start = time.perf_counter()  # of the work: another process may have held the lock for long
        trained = folder.outcome().status == "finished"
        restarts = hydras.sweeper._target_.startswith(READS_FOLDERS)
        refusal = changed_recordings(settings.values, folder, restarts=restarts)
        if refusal is not None:
            if not trained:  # else its results stay those of a finished run
                folder.record("refused", one_line(refusal))
            return refusal
        if is_done(settings.values, folder):
            return None
        failure: BaseException | None = None
        status: Status = "finished"
        reason = ""
        try:
            folder.record("running")
            folder.mark_published(None)
            with first_import("symo_exp.job.recipe"):
                from symo_exp.job.parts import build
                from symo_exp.job.recipe import perform

            with stopping.urgent(False):  # OmegaConf would make an error of its own of the signal
                parts = build(settings.values, folder)
                tracker = parts.tracker
                words = typed(hydras) if hydras.sweeper._target_ == OURS else None
                choices, asked = dict(hydras.runtime.choices), list(hydras.overrides.task)
                about = describe_job(settings, choices, asked, words, own_folder(hydras))
            stopping.raise_if_requested()
            perform(parts, settings.values, folder, about, trained=trained)
        except stopping.Interrupted as error:
            time_is_up = error.signum == stopping.TIME_IS_UP
            failure, status, reason = error, "interrupted", str(error)
            if time_is_up:
                status, reason = "waiting", "its time was up; it is queued again"
        except Exception as error:
            # to the log of the run, not to the terminal
            log.debug("the run ended here", exc_info=True)
            failure, status = error, "failed"
            reason = f"{type(error).__name__}: {one_line(error)}{place_in_code(error)}"
            if isinstance(error, ConfigError):
                status, reason = "refused", one_line(error)
        end(folder, tracker, status, reason, time.perf_counter() - start)
    if time_is_up:
        try:
            stopping.make_way()
        except Exception as error:
            end(folder, tracker, "interrupted", f"its time was up: {one_line(error)}")
    return failure


def end(folder: RunFolder, tracker: Any, status: Status, reason: str, seconds: float = 0.0) -> None:
    """Record how a run or a sweep ended and publish it, or log that a full disk forbids it.

    Args:
        folder: Its folder.
        tracker: The store; ``None``: it is published later.
        status: How it ended.
        reason: Why it did not finish.
        seconds: Of work since the last record.
    """
    try:
        folder.record(status, reason, seconds)
    except OSError as error:  # a full disk
        told = f"{status}: {reason}" if reason else status
        log.error("%s: the status of the run (%s) cannot be written: %s", folder, told, error)
        with suppress(OSError):
            folder.forget_outcome()
        return
    if tracker is not None:
        publish(tracker, folder)


def publish(tracker: Any, folder: RunFolder) -> None:
    """Update the store, or leave it for the next command."""
    try:
        tracker.publish(folder)
    except Exception as error:
        if isinstance(error, OSError) and Path(error.filename or "/").is_relative_to(folder.path):
            log.warning(
                "%s cannot be written (%s): the next command uploads the run again",
                folder, error.strerror,
            )  # fmt: skip
        else:
            log.warning(
                "%s: the tracking store is unavailable (%s); the run is uploaded when the command "
                "is given again", folder, first_line(error),
            )  # fmt: skip


def spelled(words: Sequence[str]) -> str:
    """Return a command as it is kept with a run or a sweep."""
    return shlex.join(["python", "-m", "symo_exp", *words])


def typed(hydras: Any) -> list[str]:
    """Return the words of the command of a job, or of a sweep, by Hydra's part of its settings."""
    words = []
    if hydras.job.config_name != "config":
        words += ["-cn", hydras.job.config_name]
    return [*words, *own_folder(hydras), *hydras.overrides.task]


def own_folder(hydras: Any) -> list[str]:
    """Return the words that add the user's own configuration, by Hydra's part of the settings."""
    own = [x.path for x in hydras.runtime.config_sources if x.provider == "command-line"]
    return [word for path in own for word in ("--config-dir", path)]


def describe_job(
    settings: Settings,
    choices: dict[str, Any],
    asked: Sequence[str],
    words: Sequence[str] | None = None,
    own: Sequence[str] = (),
) -> About:
    """Describe the run; its name contains what its sweep varied: ``E2E-SyMo acrobot n=16``.

    Args:
        settings: Resolved settings of the job.
        choices: The choice of each group.
        asked: Overrides on the command line.
        words: Words of its command; ``None``: those that repeat it without its sweep.
        own: Words that add the user's own configuration, for ``None``.
    """
    found = differences(settings, choices)
    words = [*own, *found.words] if words is None else words
    groups = {g: c for g, c in choices.items() if not g.startswith(("hydra/", "study"))}
    varied = [o for o in asked if o.partition("=")[0] in os.environ.get(VARIED, "").split(",")]
    told = [brief(o) for o in varied if not o.startswith(NAMED)]
    size = settings.value("data.n_traj")
    name = [look(choices["model"]).label, choices["system"], f"n={size}" * bool(size), *told]
    return About(
        name=" ".join(filter(None, name)),
        parameters=groups | dict(_parameters(settings.values, settings)),
        variant=found.variant,
        sweep=os.environ.get(SWEEP, ""),
        tags={**revision_tags(), COMMAND: spelled(words)},
        recordings=recordings_of(settings.values),
        code=code.digests(settings.values["code"]),
    )


def _parameters(
    node: Mapping[str, Any], settings: Settings, prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield every setting but those of studies, each under the name where it is written."""
    for key, value in node.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            if name != "study" and name not in settings.references:
                yield from _parameters(value, settings, f"{name}.")
        elif key != "_partial_":
            yield name, value
