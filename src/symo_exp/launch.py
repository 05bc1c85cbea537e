"""From a command line to finished runs: check every job, have them done, sum up."""

from __future__ import annotations

import copy
import logging
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path

from omegaconf import DictConfig

from symo_exp import studies
from symo_exp.configuration import SWEEPS
from symo_exp.configuration.command import Command, Job, is_run, jobs_of, parse
from symo_exp.configuration.several import sweeps_of
from symo_exp.errors import ConfigError
from symo_exp.handover import compose_and_run, launch
from symo_exp.imports import first_import
from symo_exp.job import asked_of
from symo_exp.tracking import memory, spool
from symo_exp.tracking.process import is_dead
from symo_exp.training import stopping
from symo_exp.training.outcome import Outcome, one_line, table
from symo_exp.training.watch import Watch

log = logging.getLogger(__name__)

KILLED = "its process was killed, perhaps for want of memory"


def execute(argv: Sequence[str]) -> int:
    """Do what the command says; the exit code.

    What is finished already is not done again: the same command goes on where it was cut.
    """
    args = parse(argv)
    names = sweeps_of(args) if is_run(args) else []
    if names:
        return _one_after_another(argv, args.config_name, names)
    # Hydra does not read overrides on both sides of an option
    argv = [*(word for word in argv if word not in args.overrides), *args.overrides]
    if args.config_dir is None:  # the sweeps that ship are names for -cn
        args.config_dir = str(SWEEPS)
        argv = ["--config-dir", args.config_dir, *argv]
    if not is_run(args):
        compose_and_run(argv)
        return 0
    command = jobs_of(args, passed=_is_finished)
    _refuse_twins(command)
    finished = [job for job in command.jobs if _is_finished(job)]
    there = {job.folder for job in finished}
    jobs = [job for job in command.jobs if job.folder not in there]
    check(jobs, labelled=command.multirun, elsewhere=command.elsewhere)
    for job in jobs:
        _clear(job)
    for job in finished:
        if spool.waits(job.folder):
            _deliver(job)
    done = len(finished)
    if command.multirun and done:
        print(f"{done} of {len(command.jobs)} jobs are finished already", flush=True)
    if jobs:
        with stopping.command():
            _do(argv, command, jobs, " ".join(args.overrides) or args.config_name or "sweep")
            return _sum_up(command, done)
    return _sum_up(command, done)


def _one_after_another(argv: Sequence[str], name: str, sweeps: Sequence[str]) -> int:
    """The exit code of the first that did not end well; only a signal keeps the others away."""
    commands = [[one if word == name else word for word in argv] for one in sweeps]
    for command in commands:  # a word that one of them cannot take is found before anything runs
        args = parse(command)
        args.config_dir = args.config_dir or str(SWEEPS)
        jobs_of(args, passed=_is_finished)
    codes = []
    for one, command in zip(sweeps, commands, strict=True):
        print(f"== {one}", flush=True)
        codes.append(execute(command))
        if stopping.requested() is not None:
            break
    return next((code for code in codes if code), 0)


def _is_finished(job: Job) -> bool:
    """Whether nothing is left to do for this job, not a study either."""
    done = job.config.get("resume", True) and Outcome.read(job.folder).status == "finished"
    return done and not studies.missing(asked_of(job.config), job.folder)


def _refuse_twins(command: Command) -> None:
    folders: dict[Path, str] = {}
    for job in command.jobs:
        if job.folder in folders:
            raise ConfigError(f"{job.label}: this is the same run as {folders[job.folder]}")
        folders[job.folder] = job.label


def check(jobs: Sequence[Job], *, labelled: bool, elsewhere: bool = False) -> None:
    """Build all that every job names, so that nothing is found wrong when others have run.

    What the jobs need ``elsewhere``, a graphics processor, is not asked for on this machine.
    """
    if not jobs:
        return  # without the seconds of the import
    with first_import("symo_exp.recipe"):
        from symo_exp.recipe import build

    stores = []
    for job in jobs:
        try:
            _check_folder(job.folder)
            parts = build(_as_here(job.config) if elsewhere else job.config, job.folder)
            if job.config.logger not in stores:
                parts.tracker.check()
                stores.append(job.config.logger)
        except ConfigError as error:
            raise ConfigError(f"{job.label}: {error}" if labelled else str(error)) from error


def _as_here(config: DictConfig) -> DictConfig:
    here = copy.deepcopy(config)
    here.trainer.accelerator = "cpu"
    return here


def _check_folder(folder: Path) -> None:
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir():
        raise ConfigError(f"output folder {folder}: {there} is a file; choose another output_dir")
    try:
        probe = there / f".symo_exp.{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(
            f"output folder {folder}: {there} cannot be written ({error.strerror}); "
            "choose another output_dir"
        ) from error


def _clear(job: Job) -> None:
    """Forget how an earlier start ended and, with ``resume=false``, all that could be continued."""
    before = Outcome.read(job.folder)
    if before.status == "running" and not is_dead(before.process):
        return  # another command may be at it
    if before.status == "finished" and job.config.get("resume", True):
        return  # it is only studied further
    Outcome.forget(job.folder)
    if not job.config.get("resume", True):
        from symo_exp.recipe import CHECKPOINTS

        shutil.rmtree(job.folder / CHECKPOINTS, ignore_errors=True)
        memory.forget(job.folder)
        spool.remove(job.folder)


def _deliver(job: Job) -> None:
    """Tell the tracker what it could not be told when the run was finished."""
    with first_import("symo_exp.recipe"):
        from symo_exp.recipe import build

    build(job.config, job.folder).tracker.deliver(job.folder)


def _do(argv: Sequence[str], command: Command, jobs: Sequence[Job], name: str) -> None:
    watch = Watch([job.folder for job in command.jobs]) if command.multirun else nullcontext()
    with _parent_run(command, name), watch:
        launch(argv, jobs, multirun=command.multirun)
        for job in jobs:
            _settle(job)


def _settle(job: Job) -> None:
    """A run whose process has died without a word has failed, unless it was to stop."""
    outcome = Outcome.read(job.folder)
    if outcome.status != "running" or not is_dead(outcome.process):
        return
    if stopping.requested():
        Outcome("interrupted", "its process was ended").write(job.folder)
        return
    Outcome("failed", KILLED).write(job.folder)
    logger = job.config.logger
    if "tracking_uri" in logger:
        from symo_exp.tracking.runs import fail
        from symo_exp.tracking.store import find

        fail(job.folder, find(logger.tracking_uri, logger.directory), KILLED)


@contextmanager
def _parent_run(command: Command, name: str) -> Iterator[None]:
    """The run of the tracker under which the jobs of a sweep appear."""
    logger = command.jobs[0].config.logger
    if not command.multirun or "tracking_uri" not in logger:
        yield
        return
    from symo_exp.tracking.parent import end_parent, start_parent

    store = {key: logger[key] for key in ("experiment", "tracking_uri", "directory", "timeout")}
    start_parent(**store, name=name, parameters={"jobs": len(command.jobs)})
    try:
        yield
    except BaseException as error:
        end_parent("FAILED" if isinstance(error, Exception) else "KILLED", repr(error))
        raise
    signum = stopping.requested()
    if signum is not None:
        end_parent("KILLED", str(stopping.Interrupted(signum)))
    bad = sum(Outcome.read(job.folder).status != "finished" for job in command.jobs)
    if bad:
        end_parent("FAILED", f"{bad} of {len(command.jobs)} jobs failed")
    end_parent()


def _sum_up(command: Command, done: int) -> int:
    outcomes = [Outcome.read(job.folder) for job in command.jobs]
    logs = [job.log for job in command.jobs]
    if command.multirun:
        print(table([job.label for job in command.jobs], outcomes, logs))
    else:
        ((outcome,), (job,)) = (outcomes, command.jobs)
        if outcome.status == "refused":
            raise ConfigError(outcome.reason)
        if done:
            where = os.path.relpath(job.folder)
            print(
                f"{one_line(outcome.measures)}  (finished already: {where}; resume=false repeats)"
            )
        elif outcome.status != "finished":
            print(f"symo_exp: {outcome.status}: {outcome.reason} (log: {job.log})", file=sys.stderr)
    signum = stopping.requested()
    if signum is not None:
        return 128 + signum
    return 0 if all(outcome.status == "finished" for outcome in outcomes) else 1
