"""One job of a command, in whichever process."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from symo_exp import studies
from symo_exp.configuration.command import one_line
from symo_exp.errors import ConfigError
from symo_exp.imports import first_import
from symo_exp.tracking.process import identity
from symo_exp.training import stopping
from symo_exp.training.outcome import Outcome, Status

log = logging.getLogger(__name__)


def job(config: DictConfig) -> None:
    """One run; how it ended is left in its folder, never raised.

    Nothing happens when the command was asked to stop, or when another has finished the run.
    """
    settings = HydraConfig.get()
    folder = Path(settings.runtime.output_dir)
    start = time.perf_counter()

    def record(status: Status, reason: str = "", measures: dict[str, float] | None = None) -> None:
        outcome = Outcome(status, reason, measures or {}, time.perf_counter() - start)
        try:
            outcome.write(folder)
        except OSError as error:  # a full disk
            log.error("%s: how the run ended (%s) is not kept: %s", folder, status, error)
            with suppress(OSError):
                Outcome.forget(folder)

    logging.raiseExceptions = debugging()  # a log that cannot be written: no traceback of that
    stopping.install()
    if stopping.requested():
        return
    try:
        with stopping.urgent(), _alone_in(folder):
            before = Outcome.read(folder)
            choices = dict(settings.runtime.choices)
            if before.status == "finished":
                if studies.missing(asked_of(config), folder):
                    with first_import("symo_exp.recipe"):
                        from symo_exp.recipe import study_finished

                    study_finished(config, folder, choices)
                return
            Outcome("running", process=identity()).write(folder)
            with first_import("symo_exp.recipe"):
                from symo_exp.recipe import run

            done = run(config, folder, choices)
            record("finished", measures=done.evaluation.measures)
    except stopping.Interrupted as error:
        if error.signum == stopping.TIME_IS_UP:
            record("waiting", "its time was up; it is queued again")
            try:
                stopping.make_way()
            except Exception as refused:
                record("interrupted", f"its time was up: {one_line(refused)}")
        else:
            record("interrupted", str(error))
    except ConfigError as error:
        log.debug("refused", exc_info=True)
        record("refused", one_line(error))
    except Exception as error:
        log.debug("failed", exc_info=True)  # to the log of the run, not to the terminal
        record("failed", f"{type(error).__name__}: {one_line(error)}")
        if debugging():
            raise


def asked_of(config: DictConfig) -> studies.Settings:
    """The settings of the studies that a job asks for."""
    asked: studies.Settings = OmegaConf.to_container(config.study, resolve=True)  # type: ignore[assignment]
    return asked


def debugging() -> bool:
    return os.environ.get("SYMO_EXP_DEBUG") == "1"


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Wait while another process works on the same run."""
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        log.info("%s: another process works on this run; waiting for it", os.path.relpath(folder))
        lock.acquire(poll_interval=0.5)
    except NotImplementedError:  # a file system without locks
        yield
        return
    try:
        yield
    finally:
        lock.release()
