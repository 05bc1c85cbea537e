"""The search for the model of a machine: rounds of candidates over folds, a choice, a last fit.

Every fold of every candidate is a run folder, so that an interrupted search resumes and a finished
one is repeated from what is there.
"""

from __future__ import annotations

import glob
import hashlib
import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hydra.core.utils import configure_log
from joblib import effective_n_jobs
from omegaconf import DictConfig, OmegaConf

from symo_exp.checks import real
from symo_exp.data.formats import content_of, files, shown
from symo_exp.errors import ConfigError
from symo_exp.evaluation.verdict import comparison, verdict
from symo_exp.files import read_json
from symo_exp.identify import plan as plans
from symo_exp.identify.candidates import Candidate, distinct_candidates, with_lagrangian
from symo_exp.identify.doubts import doubts, hopeless, missed
from symo_exp.identify.fits import Fits, by_key
from symo_exp.identify.plan import Plan
from symo_exp.identify.recordings import Machine, examine
from symo_exp.identify.rounds import Rounds
from symo_exp.identify.speed import machine_speed
from symo_exp.identify.structures import ladder
from symo_exp.identify.table import candidates_table, unit_of_held_out, write_candidates
from symo_exp.identify.validation import (
    NOISY,
    Trial,
    latest_stage,
    noise_of_fit,
    with_least_noise,
)
from symo_exp.process import phases
from symo_exp.runs.folder import BEST, CANDIDATES, SERIES, RunFolder
from symo_exp.runs.series import read
from symo_exp.sweep.sweeper import Sweep
from symo_exp.systems.base import System

PLAN = "plan.json"
FILES = [
    "path", "columns", "wrapped", "degrees", "time_unit", "train", "val", "test", "n_val", "n_test",
    "leave_out",
]  # fmt: skip
"""Settings of data that say where recordings are and how they are read."""

NEEDED = {
    "data": ("data.wrapped", "learns from recordings"),
    "model": ("model.dissipation", "compares Lagrangians and friction"),
    "objective": ("learner.validation.iterations", "estimates the noise of recordings"),
    "optimizer": ("optimizer.starts", "estimates the noise of recordings in stages"),
}
"""By group: a setting that its choice has to have, and why."""
OWN = {"data.monitor": "val", "data.fold": None}
"""Settings of a search that cannot have other values."""


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
        self._check_choices()
        self._budget = plans.seconds_of(budget)
        if not OmegaConf.is_missing(master.data, "path"):
            self._files = files(_plain(master.data.path))
            OmegaConf.update(master, "experiment", self._experiment)
        self._clock = clock

    def run(self, *, check_only: bool = False) -> int:
        """Search, print and keep what was found; return the exit code.

        Raises:
            ConfigError: Before anything starts, if the recordings or settings do not allow it.
        """
        self._machine = machine = self._examine()
        every = with_lagrangian(ladder(machine), self._given)
        candidates = distinct_candidates(every, self._given)
        recordings = content_of(self._files)
        key = self._key(candidates, recordings)
        self._check_kept(recordings)
        kept = plans.kept_plan(self._folder / PLAN, key) if self._master.resume else None
        self._plan = plan = kept or self._new_plan(candidates, key, recordings)
        planned = [c for c in candidates if c.name in plan.names]
        others = [c for c in candidates if c.name not in plan.names]
        fits = Fits(
            self._sweep, machine, plan, self._given,
            experiment=self._experiment, seed=self._master.seed, clock=self._clock,
        )  # fmt: skip
        if kept is None:  # a kept plan is that of a search that has begun
            fits.check(planned)
        configure_log(self._master.hydra.hydra_logging, self._master.hydra.verbose)
        for note in machine.notes:
            print(note)
        if not machine.moves:
            return self._no_model()
        if replaced := self._replaced(every):
            print(f"of every candidate, whatever its name says: {' '.join(replaced)}")
        print(self._told_plan(len(candidates), len(every) - len(candidates)), flush=True)
        if check_only:
            return 0
        if kept is None:
            plans.keep_plan(self._folder / PLAN, plan)
        rounds = Rounds(fits, self._keep)
        rounds.screen(planned)
        rounds.deepen(others)
        if (best := rounds.refine()) is None:
            self._summary(rounds.trials, None)
            return self._no_model()
        code = self._conclude(fits, rounds, best)
        tried = {trial.candidate.name for trial in rounds.trials}
        if code == 0 and (untried := [c.name for c in others if c.name not in tried]):
            print(f"with a larger budget, the search also tries: {'; '.join(untried)}")
        return code

    def _conclude(self, fits: Fits, rounds: Rounds, best: Trial) -> int:
        """Fit the chosen candidate to all data, test it and print what was found."""
        plan, machine = self._plan, self._machine
        folds = list(best.folders.values())
        epochs = self._last_epoch(best.candidate, folds)
        seconds = plan.most_seconds(best.candidate, machine)
        share = "all" if seconds >= machine.seconds else f"{100 * seconds / machine.seconds:.0f} %"
        print(f"chosen: {best.candidate.name}; fitted to {share} of train and val", flush=True)
        last = self._last_fits(fits, best.candidate, epochs, min(best.noises().values()))
        folder = with_least_noise(list(last.values()))
        if folder.outcome().status == "finished":  # it alone is tested
            folder.write_folds(folds)  # their errors widen its intervals
            attempt = next(k for k, fit in last.items() if fit is folder)
            fits.test(best.candidate, epochs, attempt)
        self._summary(rounds.trials, best)
        if folder.outcome().status != "finished":
            print(f"the last fit {folder.outcome().status}: {folder.outcome().reason}")
            return 1
        if len(last) > 1:
            print(f"the last fit with the least noise of {len(last)} is kept")
        if (done := len(read(folder / SERIES))) < epochs:
            print(f"the last fit ran out of time after {done} of {epochs} epochs")
        self._print_verdict(folder.measures(), noise_of_fit(folder), self._link(folder))
        return 0

    def _replaced(self, candidates: Sequence[Candidate]) -> list[str]:
        """Return the given settings that replace those of candidates."""
        keys = {key for one in candidates for key in one.settings}
        keys |= {key.partition(".")[0] for key in keys} - {"system"}
        return [value for key, value in self._given.items() if key in keys]

    # -- before anything starts --------------------------------------------------------------------

    def _check_choices(self) -> None:
        """Refuse choices of files, and settings, with which nothing can be searched."""
        for group, (name, reason) in NEEDED.items():
            above, _, setting = name.rpartition(".")
            if setting not in list(OmegaConf.select(self._master, above) or ()):
                raise self._unsuitable(name, group, reason)
        for name, value in OWN.items():
            if OmegaConf.select(self._master, name) != value:
                raise self._unsuitable(name, "data", "holds out folds itself")

    def _unsuitable(self, name: str, group: str, reason: str) -> ConfigError:
        """Return the error of the word of the command line that decides a setting."""
        parts = name.split(".")
        above = [".".join(parts[:end]) for end in range(len(parts), 1, -1)]
        chosen = f"{group}={self._master.hydra.runtime.choices[group]}"
        words = [self._given[key] for key in (*above, group, "preset") if key in self._given]
        word = next(iter(words), chosen)
        mend = "leave it out"
        if word == chosen:
            mend = f"possible: {', '.join(self._sweep.composer.choices_with(group, name))}"
        return ConfigError(f"{word} does not suit a search, which {reason}; {mend}")

    def _examine(self) -> Machine:
        phases.say("reading the recordings")
        data = self._master.data
        if OmegaConf.is_missing(data, "path"):
            raise ConfigError("data.path has no value yet; give it one: data.path=FILE")
        system = self._master.system
        known = self._known()
        chosen = "system.time_step" in self._given or (
            known is None and not OmegaConf.is_missing(system, "time_step")
        )
        read = {name: _plain(data.get(name)) for name in FILES}
        for name in {"wrapped", "degrees"} - {key.removeprefix("data.") for key in self._given}:
            read[name] = None  # to be inferred
        return examine(
            read,
            angular=_plain(system.get("angular")),
            input_matrix=_plain(system.get("input_matrix")),
            time_step=real("system.time_step", system.time_step, above=0) if chosen else None,
            rotations=_plain(system.get("rotations", [])),
            known=known,
        )

    def _known(self) -> System | None:
        """Return the system if its equations are known, ``None`` if its recordings alone are.

        Raises:
            ConfigError: If it has no constants that can be learned.
        """
        if "scale" in self._master.system:
            return None
        system = self._sweep.system()
        if getattr(system, "constants", None):
            return system
        raise self._unsuitable("system.scale", "system", "learns the constants of known equations")

    def _check_kept(self, recordings: str) -> None:
        """Refuse to continue with runs of other recordings, whose folders have the same names."""
        if read_json(self._folder / PLAN).get("recordings") in (None, "", recordings):
            return
        raise ConfigError(
            f"{shown(_plain(self._master.data.path))}: {os.path.relpath(self._folder)} has a "
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
            f"plan: {len(plan.names)} of {possible} candidates{left} over {plan.folds} folds, "
            f"{plan.seconds:.3g} s of data each ({100 * share:.0f} %), "
            f"{plan.effort.epochs} epochs a stage, {plan.cores} runs at a time, {time}"
        )

    # -- the chosen one ----------------------------------------------------------------------------

    def _last_fits(
        self, fits: Fits, candidate: Candidate, epochs: int, noise: float
    ) -> dict[int, RunFolder]:
        """Return fits of the chosen candidate from several seeds, by their attempts.

        There are more seeds if all end with far more than the ``noise`` of the quietest fold.
        """
        first = self._plan.last_fits(candidate, self._machine)
        found = fits.to_all(candidate, epochs, range(first))
        if first > 1 and min(map(noise_of_fit, found.values())) > NOISY * noise:
            found |= fits.to_all(candidate, epochs, range(first, plans.MOST_FITS))
        return found

    def _print_verdict(self, measures: Mapping[str, float], error: float, model: Path) -> None:
        label = verdict(measures) or "not judged"
        if failed := hopeless(measures, self._machine.horizon):
            bad = label.startswith("no")
            label = f"no model; {label if bad else 'hardly better than constant velocity'}"
        print(f"verdict on the test part: {label}")
        beside = comparison(measures, self._unit)
        if beside is not None:
            print(f"  {beside}")
        if "open_loop_rmse" in measures:
            whole = f"{measures['open_loop_rmse']:.2g} {self._unit}"
            print(f"  RMSE over whole test recordings, in open loop from their start: {whole}")
        if not label.startswith("good"):
            reasons = [*missed(self._machine, error, self._unit_of_held_out)]
            self._tell([*doubts(self._machine), *reasons] if failed or beside is None else reasons)
        print(f'the model: symo_exp.load("{os.path.relpath(model)}")')

    @property
    def _unit(self) -> str:
        """The unit of errors."""
        return ", ".join(self._machine.coordinates.units_of_errors)

    @staticmethod
    def _tell(reasons: Iterable[str]) -> None:
        for line in reasons:
            print(f"  possible reason: {line}")

    def _no_model(self) -> int:
        print("verdict: no model")
        self._tell(doubts(self._machine))
        return 1

    def _last_epoch(self, candidate: Candidate, folds: Sequence[RunFolder]) -> int:
        """Return the epochs of the last stage that no other one surpasses in the folds."""
        each = self._plan.effort.epochs
        begun = self._plan.effort.begun(candidate)
        losses = []
        for fold in folds:
            ends = [(r["epoch"] + 1 - begun, r["val_loss"]) for r in read(fold / SERIES)
                    if "val_loss" in r]  # fmt: skip
            losses.append({math.ceil(end / each): loss for end, loss in ends if end > 0})
        return begun + each * latest_stage(losses)

    # -- folders -----------------------------------------------------------------------------------

    @property
    def _experiment(self) -> str:
        if "experiment" in self._given:
            return str(self._master.experiment)
        path = _plain(self._master.data.path)
        first = Path(path if isinstance(path, str) else path[0]).absolute()
        several = not isinstance(path, str) or glob.has_magic(first.name)
        stem = first.parent.name if several else first.stem
        return f"machine_{re.sub(r'[^0-9A-Za-z_.-]+', '_', stem).lstrip('.')}"

    @property
    def _folder(self) -> Path:
        return Path(str(self._master.output_dir)).absolute() / self._experiment

    def _keep(self, fit: RunFolder, trials: Sequence[Trial]) -> None:
        """Keep the best fit and the candidates so far."""
        self._link(fit)
        with suppress(OSError):  # a full disk; the table is written again
            write_candidates(self._folder / CANDIDATES, trials, None, self._unit_of_held_out)

    def _link(self, folder: RunFolder) -> Path:
        """Link ``BEST`` to a run and return it; where that is impossible, name and return the run.

        There may be a folder of that name, as in a copy of a search, or links may be impossible.
        """
        link, new = self._folder / BEST, self._folder / f".{BEST}.{os.getpid()}"
        try:
            new.unlink(missing_ok=True)
            new.symlink_to(os.path.relpath(folder.path, self._folder), target_is_directory=True)
            os.replace(new, link)
        except OSError as error:
            new.unlink(missing_ok=True)
            print(f"{os.path.relpath(link)} is no link ({error.strerror}); the best is {folder}")
            return folder.path
        return link

    def _summary(self, trials: Sequence[Trial], best: Trial | None) -> None:
        """Print and keep the table of candidates."""
        print(candidates_table(trials, best, self._plan.folds, self._unit_of_held_out))
        write_candidates(self._folder / CANDIDATES, trials, best, self._unit_of_held_out)

    @property
    def _unit_of_held_out(self) -> str:
        """The unit of held-out errors."""
        return unit_of_held_out(self._machine.coordinates, self._machine.units)


def _cores(master: DictConfig) -> int:
    """Return how many runs the launcher does at a time."""
    jobs = int(master.hydra.launcher.get("n_jobs") or 1)
    if "basic_launcher" in str(master.hydra.launcher._target_):
        return 1
    return int(effective_n_jobs(jobs))  # a container may have fewer cores than the computer


def _plain(value: Any) -> Any:
    return OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
