"""A sweep: all jobs are composed and checked before the first one starts.

Finished jobs are left out, the others launched, jobs lost with a killed worker started again, and
all are summed up. Hydra finds it through ``hydra_plugins.symo_exp_sweeper``; a single run is a
sweep of one.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from hydra.core.utils import configure_log
from hydra.types import HydraContext, TaskFunction
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from symo_exp import code
from symo_exp.cli.explain import BAD_INPUT, explained
from symo_exp.errors import ConfigError
from symo_exp.imports import first_import
from symo_exp.job.checks import check_folder, check_names, check_parts, check_settings
from symo_exp.job.job import changed_recordings, publish, spelled, typed
from symo_exp.process import phases, stopping
from symo_exp.runs.folder import LOG, RunFolder
from symo_exp.shell import python_command
from symo_exp.sweep.compose import Composer, Job, expand, labels
from symo_exp.sweep.launching import Launches
from symo_exp.sweep.parent import parent, parent_folder
from symo_exp.sweep.table import Watch, table
from symo_exp.words import counted

log = logging.getLogger(__name__)


_watching: list[list[RunFolder]] = []


@contextmanager
def watched() -> Iterator[list[RunFolder]]:
    """Collect the folders of all runs that commands of this process ask for meanwhile."""
    _watching.append([])
    try:
        yield _watching[-1]
    finally:
        _watching.pop()


class Sweep:
    """All jobs of one command.

    Args:
        context: How Hydra composes configurations.
        task: The function that does a job.
        master: The configuration of the command.

    Raises:
        ConfigError: If the launcher is to do no job at a time, or jobs in other folders.
    """

    def __init__(self, context: HydraContext, task: TaskFunction, master: DictConfig) -> None:
        if master.hydra.launcher.get("n_jobs") == 0:
            told = "expected the number of jobs at a time, or -1 for one on each core"
            raise ConfigError(f"hydra.launcher.n_jobs=0: {told}")
        if master.hydra.job.chdir:
            raise ConfigError(
                "hydra.job.chdir=true: relative paths, such as that of the store, begin in the "
                "folder of the command; leave it out"
            )
        self._context, self._task, self._master = context, task, master
        self.composer = Composer(context.config_loader, master)
        self.launches = Launches(context, task, master)
        self._idle: dict[Path, Collection[str]] = {}  # settings without effect, of checked jobs

    def run(
        self, arguments: Sequence[str], params: Mapping[str, Any], *, check_only: bool = False
    ) -> int:
        """Run the sweep and return the exit code.

        Raises:
            ConfigError: For a job that cannot run, before anything starts.
        """
        jobs = self.plan(arguments, params)
        for folders in _watching:
            folders += [job.folder for job in jobs]
        finished = [job for job in jobs if job.is_left_out()]
        todo = [job for job in jobs if job not in finished]
        self.check(todo)
        if check_only:
            return 0
        configure_log(self._master.hydra.hydra_logging, self._master.hydra.verbose)
        for word, name in self.unread(jobs, arguments, params).items():
            told = "%s has no effect: no part of the run uses %s (--cfg job prints it)"
            log.warning(told, word, name)
        sweep = [(jobs[0], parent_folder(jobs))] if finished and len(jobs) > 1 else []
        for job, folder in [*sweep, *((job, job.folder) for job in finished)]:
            tracker = instantiate(job.values["logger"])
            # the store may lack some, as far as is known without MLflow
            if not tracker.is_published(folder):
                publish(tracker, folder)
        _warn_of_code([job for job in jobs if job.values["resume"]])
        if finished and len(jobs) > 1:
            print(f"{len(finished)} of {len(jobs)} runs are finished already", flush=True)
        if not todo:
            return self._sum_up(jobs, finished)
        for job in todo:
            _clear(job)
        with stopping.command():
            self._do(jobs, todo)
            return self._sum_up(jobs, finished)

    def perform(
        self, combinations: Sequence[list[str]], labels: Sequence[str]
    ) -> list[RunFolder | ConfigError]:
        """Do the jobs of a search and return their folders; how each ended stands in its own.

        Jobs that cannot be composed are returned as their error. Nothing is printed.

        Raises:
            Interrupted: If the command was asked to stop.
        """
        found: list[RunFolder | ConfigError] = []
        todo: dict[Path, Job] = {}
        for overrides, label in zip(combinations, labels, strict=True):
            try:
                job = self._composed(overrides, label)
                if not job.is_left_out():
                    todo[job.folder.path] = job
                found.append(job.folder)
            except BAD_INPUT as error:
                found.append(explained(error))
        for folders in _watching:
            folders += [folder for folder in found if isinstance(folder, RunFolder)]
        for job in todo.values():
            _clear(job)
        if todo:
            with stopping.command():
                self.launches.run(list(todo.values()))
                stopping.raise_if_requested()
        return found

    # -- before anything starts ------------------------------------------------------------------

    def plan(self, arguments: Sequence[str], params: Mapping[str, Any]) -> list[Job]:
        """Return the jobs of overrides and of a sweep file's ``params``, composed and checked.

        Raises:
            ConfigError: For a job with invalid settings, or one that is there twice.
        """
        combinations = expand(arguments, params, self._context.config_loader)
        jobs: dict[Path, Job] = {}
        for overrides, label in zip(combinations, labels(combinations), strict=True):
            try:
                job = self._composed(overrides, label)
            except BAD_INPUT as error:
                raise _labelled(explained(error), label) from error
            same = jobs.setdefault(job.folder.path, job)
            if same is not job:
                raise ConfigError(f"{label}: this is the same run as {same.label}")
        return list(jobs.values())

    def _composed(self, overrides: list[str], label: str) -> Job:
        """Return a job whose places and, unless it is done, settings are checked."""
        job = self.composer.job(overrides, label)
        values = job.values
        code.add(values["code"])  # also of finished runs, which may be loaded afterwards
        check_parts(job.settings)
        check_names(values["output_dir"], values["experiment"], self._master.hydra.sweep.dir)
        if values["resume"]:
            refusal = changed_recordings(values, job.folder, restarts=True)
            if refusal is not None:
                raise refusal
        if not job.is_left_out():
            self.composer.check_choices(job)
            check_settings(job.values, job.known, job.settings.references)
        return job

    def unread(
        self, jobs: Sequence[Job], arguments: Sequence[str], params: Mapping[str, Any]
    ) -> dict[str, str]:
        """Return the words of a command that have no effect in any of its jobs, and their names.

        Args:
            jobs: All jobs of the command.
            arguments: Overrides of the command line.
            params: As in ``run``; words that replace values of these are not returned.
        """
        asked = {argument.lstrip("+~").partition("=")[0] for argument in arguments}
        asked -= {name for key in params for name in key.split(",")}
        unread: dict[str, str] = {}
        read: set[str] = set()
        for job in jobs:
            without = self.composer.unread(job, self._idle.get(job.folder.path, ()))
            unread |= without
            read |= set(job.overrides) - without.keys()
        return {word: name for word, name in unread.items() if name in asked and word not in read}

    def check(self, jobs: Sequence[Job]) -> None:
        """Build the parts of every job, so that no mistake is found after others have run.

        Raises:
            ConfigError: For invalid settings; the message begins with the label of the job.
        """
        if not jobs:
            return  # without the seconds of the import
        phases.say("importing PyTorch and Lightning")
        with first_import("symo_exp.job.parts"):
            from symo_exp.job.parts import build
        stores = []
        for place, job in enumerate(jobs, 1):
            phases.say(f"checking run {place} of {len(jobs)}")
            try:
                check_folder(job.folder.path)
                values = job.values
                if self.launches.cluster:  # only its nodes may have a graphics processor
                    here = {**values["trainer"], "accelerator": "cpu"}
                    values = values | {"trainer": here}
                parts = build(values, job.folder)
                self._idle[job.folder.path] = parts.idle
                if values["logger"] not in stores:
                    parts.tracker.check()
                    stores.append(values["logger"])
            except ConfigError as error:
                raise _labelled(error, job.label) from error

    def system(self) -> Any:
        """Return the system of the command.

        Raises:
            ConfigError: If its settings are invalid.
        """
        from symo_exp.job.parts import make

        return make({"system": OmegaConf.to_container(self._master.system, resolve=True)}, "system")

    def refusal(self, overrides: list[str]) -> ConfigError | None:
        """Return why a job of a search cannot be done, or nothing."""
        try:
            self.check([self._composed(overrides, "")])
        except BAD_INPUT as error:
            return explained(error)
        return None

    # -- having them done --------------------------------------------------------------------------

    def _do(self, jobs: Sequence[Job], todo: Sequence[Job]) -> None:
        on_stop = self.launches.cluster.stop if self.launches.cluster else None
        phases.say("opening the store")
        tracker = instantiate(todo[0].values["logger"])
        tracker.close_dead()
        with ExitStack() as stack:
            if len(jobs) > 1:
                hydras = self._master.hydra
                name = " ".join(hydras.overrides.task or [hydras.job.config_name])
                stack.enter_context(parent(jobs, name, spelled(typed(hydras)), tracker))
            folders = [job.folder for job in jobs]
            stack.enter_context(Watch(folders, on_stop, apart=self.launches.apart))
            for job in self.launches.run(todo):
                publish(tracker, job.folder)

    def _sum_up(self, jobs: Sequence[Job], finished: Sequence[Job]) -> int:
        """Print what came of the command and return its exit code."""
        phases.clear()
        if len(jobs) == 1:
            _tell_one(jobs[0].folder, was_finished=bool(finished))
        else:
            print(table([job.label for job in jobs], [job.folder for job in jobs]))
            # to look for it takes the seconds of an import
            if len(finished) < len(jobs) and (page := instantiate(jobs[0].values["logger"]).page()):
                print(f"To compare them: {python_command('symo_exp.report')}")
                print(f"To look at them: {page}")
        signum = stopping.requested()
        if signum is not None:
            return 128 + signum
        return 0 if all(job.folder.outcome().status == "finished" for job in jobs) else 1


def _warn_of_code(jobs: Sequence[Job]) -> None:
    """Log which results are, or begin, with modules of the user that have changed since."""
    old, files = 0, set()
    for job in jobs:
        about = job.folder.about() if job.folder.has_results() else None
        changed = code.changed(job.values["code"], about.code) if about and about.code else []
        old += bool(changed)
        files.update(changed)
    if old:
        log.warning(
            "%s: changed since the start of %s; resume=false starts them anew, "
            "experiment=NAME makes others beside them", ", ".join(sorted(files)),
            counted(old, "run"),
        )  # fmt: skip


def _tell_one(folder: RunFolder, *, was_finished: bool) -> None:
    """Print the measures of a single run, or why it has none."""
    outcome, about = folder.outcome(), folder.about()
    if outcome.status == "refused":
        raise ConfigError(outcome.reason)
    if outcome.status == "finished":
        print(table([about.name if about else ""], [folder]))
        print(f"{folder}" + " (finished already; resume=false repeats)" * was_finished)
    else:
        told = f"{outcome.status}: {outcome.reason} (log: {folder / LOG})"
        print(f"symo_exp: {told}", file=sys.stderr)


def _labelled(error: ConfigError, label: str) -> ConfigError:
    named = not label or str(error).startswith(f"{label}: ")
    return ConfigError(error if named else f"{label}: {error}")


def _clear(job: Job) -> None:
    """Forget how the run ended before and, with ``resume=false``, all that could be resumed."""
    if job.folder.in_use():
        return  # another command is at it
    if not job.values["resume"]:
        job.folder.clear()
    elif job.folder.outcome().status != "finished":  # else it is only studied further
        job.folder.await_start()
