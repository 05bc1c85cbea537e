"""From a command line to finished runs: check every job, hand them to Hydra, sum up."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest import mock

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from symo_exp.configuration import CONF, SWEEPS
from symo_exp.configuration.command import Command, is_run, jobs_of, one_line, parse
from symo_exp.errors import ConfigError
from symo_exp.training.outcome import Outcome, Status, table

log = logging.getLogger(__name__)


def execute(argv: Sequence[str]) -> int:
    """Do what the command says; the exit code."""
    args = parse(argv)
    # Hydra does not read overrides on both sides of an option
    argv = [*(word for word in argv if word not in args.overrides), *args.overrides]
    if args.config_dir is None:  # the sweeps that ship are names for -cn
        args.config_dir = str(SWEEPS)
        argv = ["--config-dir", args.config_dir, *argv]
    if not is_run(args):
        _hydra(argv)
        return 0
    command = jobs_of(args)
    check(command)
    for job in command.jobs:
        Outcome.forget(job.folder)
    with _parent_run(command, " ".join(args.overrides) or args.config_name or "sweep"):
        try:
            _hydra(argv)
        except Exception as error:  # a launcher that broke: what it finished still counts
            if _debug() or not command.multirun:
                raise
            log.error("the launcher stopped: %s", one_line(error))
    return _sum_up(command)


def _debug() -> bool:
    return os.environ.get("SYMO_EXP_DEBUG") == "1"


def check(command: Command) -> None:
    """Build all that every job names, so that nothing is found wrong when others have run."""
    from symo_exp.recipe import build

    folders: dict[Path, str] = {}
    stores = []
    for job in command.jobs:
        label = f"{job.label}: " if command.multirun else ""
        if job.folder in folders:
            raise ConfigError(f"{label}this is the same run as {folders[job.folder]}")
        folders[job.folder] = job.label
        try:
            _check_folder(job.folder)
            parts = build(job.config, job.folder)
            if job.config.logger not in stores:
                parts.tracker.check()
                stores.append(job.config.logger)
        except ConfigError as error:
            raise ConfigError(f"{label}{error}") from error


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


def _hydra(argv: Sequence[str]) -> None:
    """Compose again and run, by Hydra's launcher or sweeper."""
    entry = hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)
    with (
        mock.patch.object(sys, "argv", [sys.argv[0], *argv]),
        # errors come here instead of being printed
        mock.patch.dict(os.environ, HYDRA_FULL_ERROR="1"),
    ):
        try:
            entry()
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(one_line(error)) from error


def job(config: DictConfig) -> None:
    """One run, in whichever process; how it ended is left in its folder, never raised."""
    from symo_exp.recipe import run

    settings = HydraConfig.get()
    folder = Path(settings.runtime.output_dir)
    start = time.perf_counter()

    def record(status: Status, reason: str = "", measures: dict[str, float] | None = None) -> None:
        Outcome(status, reason, measures or {}, time.perf_counter() - start).write(folder)

    try:
        done = run(config, folder, dict(settings.runtime.choices))
        record("finished", measures=done.evaluation.measures)
    except ConfigError as error:
        log.debug("refused", exc_info=True)
        record("refused", one_line(error))
    except Exception as error:
        log.debug("failed", exc_info=True)  # to the log of the run, not to the terminal
        record("failed", f"{type(error).__name__}: {one_line(error)}")
        if _debug():
            raise
    except SystemExit as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # how Lightning passes Ctrl-C on
            raise KeyboardInterrupt from error
        raise


@contextlib.contextmanager
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
    bad = sum(Outcome.read(job.folder).status != "finished" for job in command.jobs)
    if bad:
        end_parent("FAILED", f"{bad} of {len(command.jobs)} jobs failed")
    end_parent()


def _sum_up(command: Command) -> int:
    outcomes = [Outcome.read(job.folder) for job in command.jobs]
    if not command.multirun:
        (outcome,) = outcomes
        if outcome.status == "refused":
            raise ConfigError(outcome.reason)
        if outcome.status == "failed":
            print(
                f"symo_exp: failed: {outcome.reason} (log: {command.jobs[0].log})", file=sys.stderr
            )
    else:
        print(table([j.label for j in command.jobs], outcomes, [j.log for j in command.jobs]))
    return 0 if all(outcome.status == "finished" for outcome in outcomes) else 1
