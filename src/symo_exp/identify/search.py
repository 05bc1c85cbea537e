"""The search for the model of a machine: rounds of candidates over folds, a choice, a last fit.

Every fold of every candidate is a run folder, so that an interrupted search resumes and a finished
one is repeated from what is there.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

from hydra.core.utils import configure_log
from joblib import effective_n_jobs
from omegaconf import DictConfig, OmegaConf

from symo_exp.data.paths import content_of, files, shown
from symo_exp.errors import ConfigError
from symo_exp.files import read_json
from symo_exp.identify import plan as plans
from symo_exp.identify.answer import Answer
from symo_exp.identify.candidates import Candidate, distinct_candidates, with_lagrangian
from symo_exp.identify.fits import Fits, by_key
from symo_exp.identify.plan import Plan
from symo_exp.identify.request import Request, plain_value
from symo_exp.identify.rounds import Rounds
from symo_exp.identify.speed import machine_speed
from symo_exp.identify.structures import ladder
from symo_exp.identify.trials import Trials
from symo_exp.identify.validation import (
    Trial,
    epochs_of_last_fit,
    noise_of_fit,
    with_least_noise,
)
from symo_exp.process import phases
from symo_exp.runs.folder import SERIES
from symo_exp.runs.series import read
from symo_exp.sweep.sweeper import Sweep
from symo_exp.words import counted

PLAN = "plan.json"


class Search:
    """The search of one command.

    Args:
        sweep: Performs the runs.
        master: The composed configuration.
        arguments: The overrides of the command line; they go before those of candidates.
        budget: Wall time, such as ``10min``.
        clock: Whether the time that runs take counts, not the planned time alone: what is tried
            depends on it, and trainings are ended when they take much longer than planned.
    """

    def __init__(
        self,
        sweep: Sweep,
        master: DictConfig,
        arguments: Sequence[str],
        budget: str | float,
        *,
        clock: bool = True,
    ) -> None:
        self._sweep, self._master = sweep, master
        self._given = by_key(arguments)
        self._given.pop("budget", None)
        self._request = Request(sweep, master, self._given)
        self._budget = plans.seconds_of(budget)
        if not OmegaConf.is_missing(master.data, "path"):
            self._files = files(plain_value(master.data.path))
            OmegaConf.update(master, "experiment", self._experiment)
        self._clock = clock

    def run(self, *, check_only: bool = False) -> int:
        """Search, print and keep what was found; return the exit code.

        Raises:
            ConfigError: Before anything starts, if the recordings or settings do not allow it.
        """
        self._machine = machine = self._request.machine()
        every = with_lagrangian(ladder(machine), self._given)
        candidates = distinct_candidates(every, self._given)
        recordings = content_of(self._files)
        key = self._key(candidates, recordings)
        self._check_kept(recordings)
        kept = plans.kept_plan(self._folder / PLAN, key) if self._master.resume else None
        self._plan = plan = kept or self._new_plan(candidates, key, recordings)
        answer = Answer(self._folder, machine, plan.folds)
        planned = [c for c in candidates if c.name in plan.names]
        others = [c for c in candidates if c.name not in plan.names]
        fits = Fits(
            self._sweep, machine, plan, self._given,
            experiment=self._experiment, seed=self._master.seed, clock=self._clock,
        )  # fmt: skip
        if kept is None:  # a kept plan is that of a search that has begun
            fits.check(planned)
        configure_log(self._master.hydra.hydra_logging, self._master.hydra.verbose)
        phases.clear()
        for note in machine.notes:
            print(note)
        if not machine.moves:
            return answer.give_up()
        if replaced := self._replaced(every):
            print(f"of every candidate, whatever its name says: {' '.join(replaced)}")
        print(self._told_plan(len(candidates), len(every) - len(candidates)), flush=True)
        if check_only:
            return 0
        if kept is None:
            plans.keep_plan(self._folder / PLAN, plan)
        trials = Trials(fits, answer.keep)
        rounds = Rounds(fits, trials)
        rounds.screen(planned)
        rounds.deepen(others)
        if (best := rounds.refine()) is None:
            answer.summarise(trials.by_simplicity(), None)
            return answer.give_up()
        code = self._conclude(fits, trials.by_simplicity(), best, answer)
        tried = {candidate.name for candidate in trials.candidates}
        if untried := [c.name for c in others if c.name not in tried]:
            print(f"with a larger budget, the search also tries: {'; '.join(untried)}")
        return code

    def _conclude(self, fits: Fits, trials: Sequence[Trial], best: Trial, answer: Answer) -> int:
        """Fit the chosen candidate to all data, test it and print what was found."""
        plan, machine = self._plan, self._machine
        folds = list(best.folders.values())
        epochs = epochs_of_last_fit(folds)
        seconds = plan.most_seconds(best.candidate, machine)
        share = "all" if seconds >= machine.seconds else f"{100 * seconds / machine.seconds:.0f} %"
        print(f"chosen: {best.candidate.name}; fitted to {share} of train and val", flush=True)
        last = fits.last(best.candidate, epochs, folds)
        folder = with_least_noise(list(last))
        if folder.outcome().status == "finished":  # it alone is tested
            folder.write_folds(folds)  # their errors widen its intervals
            fits.test(best.candidate, epochs, last[folder])
        answer.summarise(trials, best)
        if folder.outcome().status != "finished":
            print(f"the last fit {folder.outcome().status}: {folder.outcome().reason}")
            return 1
        if len(last) > 1:
            print(f"the last fit with the least noise of {len(last)} is kept")
        if (done := len(read(folder / SERIES))) < epochs:
            print(f"the last fit ran out of time after {done} of {epochs} epochs")
        return answer.judge(folder.measures(), noise_of_fit(folder), answer.link(folder))

    def _replaced(self, candidates: Sequence[Candidate]) -> list[str]:
        """Return the given settings that replace those of candidates."""
        keys = {key for one in candidates for key in one.settings}
        keys |= {key.partition(".")[0] for key in keys} - {"system"}
        return [value for key, value in self._given.items() if key in keys]

    def _check_kept(self, recordings: str) -> None:
        """Refuse to continue with runs of other recordings, whose folders have the same names."""
        if read_json(self._folder / PLAN).get("recordings") in (None, "", recordings):
            return
        raise ConfigError(
            f"{shown(plain_value(self._master.data.path))}: {os.path.relpath(self._folder)} has a "
            "search of other recordings, or of these before they were changed; give "
            "experiment=NAME, or delete this folder"
        )

    def _new_plan(self, candidates: Sequence[Candidate], key: str, recordings: str) -> Plan:
        phases.say("measuring the speed of this machine")
        cores, speed = _cores(self._master), machine_speed()
        return plans.make_plan(
            self._machine, candidates, self._budget, cores, speed, key, recordings
        )

    def _key(self, candidates: Sequence[Candidate], recordings: str) -> str:
        """Return a digest of what the plan depends on."""
        tried = [[c.name, *c.overrides()] for c in candidates]
        what = [sorted(self._given.items()), self._budget, recordings, _cores(self._master), tried]
        if self._machine.known:
            what.append(OmegaConf.to_container(self._master.system, resolve=True))
        return hashlib.sha256(json.dumps(what).encode()).hexdigest()[:10]

    def _told_plan(self, possible: int, equal: int) -> str:
        """Return a line; ``equal`` candidates are left out of those that are ``possible``."""
        plan = self._plan
        there = self._machine.seconds * (plan.folds - 1) / plan.folds
        share = min(plan.seconds / there, 1.0)
        if plan.needed > plan.budget:
            time = f"about {plan.needed / 60:.2g} min, the least, more than the budget"
        else:
            time = f"{plan.needed / 60:.2g} to {plan.budget / 60:.2g} min"
        left = f" ({equal} more are equal with the given settings)" if equal else ""
        return (
            f"plan: {len(plan.names)} of {counted(possible, 'candidate')}{left} over "
            f"{counted(plan.folds, 'fold')}, {plan.seconds:.3g} s of data each "
            f"({100 * share:.0f} %), {counted(plan.effort.epochs, 'epoch')} a stage, "
            f"{counted(plan.cores, 'run')} at a time, {time}"
        )

    @property
    def _experiment(self) -> str:
        if "experiment" in self._given:
            return str(self._master.experiment)
        path = plain_value(self._master.data.path)
        first = Path(path if isinstance(path, str) else path[0]).absolute()
        several = not isinstance(path, str) or glob.has_magic(first.name)
        stem = first.parent.name if several else first.stem
        return f"machine_{re.sub(r'[^0-9A-Za-z_.-]+', '_', stem).lstrip('.')}"

    @property
    def _folder(self) -> Path:
        return Path(str(self._master.output_dir)).expanduser().absolute() / self._experiment


def _cores(master: DictConfig) -> int:
    """Return how many runs the launcher does at a time."""
    jobs = int(master.hydra.launcher.get("n_jobs") or 1)
    if "basic_launcher" in str(master.hydra.launcher._target_):
        return 1
    return int(effective_n_jobs(jobs))  # a container may have fewer cores than the computer
