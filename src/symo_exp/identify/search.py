"""The search for the model of a machine: rounds of candidates over folds, a choice, a last fit.

Every fold of every candidate is a run folder, so that an interrupted search resumes and a finished
one is repeated from what is there.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import configure_log
from omegaconf import DictConfig, OmegaConf

from symo_exp.data.folds import POOLED
from symo_exp.data.formats import files
from symo_exp.errors import ConfigError
from symo_exp.evaluation.verdict import comparison, verdict
from symo_exp.identify import plan as plans
from symo_exp.identify.candidates import (
    Candidate,
    distinct_candidates,
    finer,
    joined,
    ladder,
    left_open,
    variations,
    with_less_friction,
)
from symo_exp.identify.doubts import doubts, hopeless
from symo_exp.identify.plan import Plan
from symo_exp.identify.recordings import Machine, examine
from symo_exp.identify.table import candidates_table, write_candidates
from symo_exp.identify.validation import (
    LEAST,
    NOISY,
    WORST,
    Trial,
    baseline_error,
    beats,
    choose,
    fold_error,
    noise_of_fit,
    noisy_folds,
    with_least_noise,
)
from symo_exp.process import phases
from symo_exp.runs.folder import CANDIDATES, SERIES, RunFolder
from symo_exp.runs.series import read
from symo_exp.sweep.sweeper import Sweep

BEST, PLAN = "best", "plan.json"
FILES = [
    "path", "columns", "wrapped", "degrees", "time_unit", "train", "val", "test", "n_val", "n_test",
    "leave_out",
]  # fmt: skip
"""Settings of data that say where recordings are and how they are read."""
EPSILONS = 4
"""Stages of the optimiser after its starts, without late parameters."""
HOPELESS = 4.0
"""A candidate whose error is so many times the best one's is not tried on further folds."""
ITERATIONS = 5
"""Of the fit of starts in validations: more refine those of motions that stick alone."""
FOLD_FITS = 3
"""Fits of a candidate to one fold, at most."""
SEEDS = 1000
"""Difference of the seeds of fits of the same candidate to the same data."""
OVERRUN = 2.0
"""Multiple of the planned time after which further stages of a search are left out."""


class Search:
    """The search of one command.

    Args:
        sweep: Performs the runs.
        master: The composed configuration.
        arguments: The overrides of the command line; they go before those of candidates.
        budget: Wall time, such as ``10min``.
        clock: Whether stages are left out when the search grossly overruns its budget, and
            trainings ended when they take much longer than planned.
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
        self._given = _by_key(arguments)
        self._given.pop("budget", None)
        self._budget = plans.seconds_of(budget)
        if not OmegaConf.is_missing(master.data, "path"):
            OmegaConf.update(master, "experiment", self._experiment)
        self._clock = clock
        self._trials: dict[str, Trial] = {}
        self._baselines: dict[int, float] = {}
        self._folders: dict[tuple[str, int], RunFolder] = {}

    def run(self, *, check_only: bool = False) -> int:
        """Search, print and keep what was found; return the exit code.

        Raises:
            ConfigError: Before anything starts, if the recordings or settings do not allow it.
        """
        self._start = time.monotonic()
        self._machine = machine = self._examine()
        every = ladder(machine)
        candidates = distinct_candidates(every, self._given)
        self._plan = plan = self._planned(candidates)
        if check_only:
            return 0
        configure_log(self._master.hydra.hydra_logging, self._master.hydra.verbose)
        for note in machine.notes:
            print(note)
        if not machine.moves:
            return self._no_model()
        if replaced := self._replaced(every):
            print(f"of every candidate, whatever its name says: {' '.join(replaced)}")
        print(self._told_plan(len(every) - len(candidates)), flush=True)
        chosen = [c for c in candidates if c.name in plan.names]
        self._screen(chosen)
        base = self._choice()
        if base is not None and self._in_time(0.6, "variations"):
            self._vary(base)
        best = self._choice()
        if best is not None and self._in_time(0.8, "less friction"):
            self._reduce_friction(best)
            best = self._choice()
        if best is None:
            return self._no_model()
        return self._finish(best)

    def _replaced(self, candidates: Sequence[Candidate]) -> list[str]:
        """Return the given settings that stand for other ones of candidates."""
        keys = {key for one in candidates for key in one.settings}
        keys |= {key.partition(".")[0] for key in keys} - {"system"}
        return [value for key, value in self._given.items() if key in keys]

    # -- before anything starts --------------------------------------------------------------------

    def _examine(self) -> Machine:
        phases.say("reading the recordings")
        data = self._master.data
        if OmegaConf.is_missing(data, "path"):
            raise ConfigError("data.path has no value yet; give it one: data.path=FILE")
        system = self._master.system
        read = {name: _plain(data.get(name)) for name in FILES}
        for name in {"wrapped", "degrees"} - {key.removeprefix("data.") for key in self._given}:
            read[name] = None  # to be inferred
        return examine(
            read,
            angular=_plain(system.angular),
            input_matrix=_plain(system.input_matrix),
            time_step=None if OmegaConf.is_missing(system, "time_step") else system.time_step,
        )

    def _planned(self, candidates: Sequence[Candidate]) -> Plan:
        """Return the plan that this search began with, or a new one."""
        file = self._folder / PLAN
        key = self._key(candidates)
        found = plans.kept_plan(file, key) if self._master.resume else None
        if found is None:
            phases.say("measuring the speed of this machine")
            cores = _cores(self._master)
            speed = plans.machine_speed()
            found = plans.make_plan(self._machine, candidates, self._budget, cores, speed, key)
            plans.keep_plan(file, found)
        return found

    def _key(self, candidates: Sequence[Candidate]) -> str:
        """Return a digest of what the plan depends on."""
        size = [file.stat().st_size for file in files(_plain(self._master.data.path))]
        tried = [[c.name, *c.overrides()] for c in candidates]
        what = [sorted(self._given.items()), self._budget, size, _cores(self._master), tried]
        return hashlib.sha256(json.dumps(what).encode()).hexdigest()[:10]

    def _told_plan(self, equal: int) -> str:
        """Return a line; ``equal`` candidates are left out."""
        plan = self._plan
        there = self._machine.seconds * (plan.folds - 1) / plan.folds
        share = min(plan.seconds / there, 1.0)
        more = ", the least, more than the budget" if plan.needed > plan.budget else ""
        left = f" ({equal} more are equal with the given settings)" if equal else ""
        return (
            f"plan: {len(plan.names)} candidates{left} and up to {plan.variations} variations over "
            f"{plan.folds} folds, {plan.seconds:.3g} s of data each ({100 * share:.0f} %), "
            f"{plan.effort.epochs} epochs a stage, {plan.cores} runs at a time, about "
            f"{plan.needed / 60:.2g} min{more}"
        )

    # -- rounds ------------------------------------------------------------------------------------

    def _screen(self, candidates: Sequence[Candidate]) -> None:
        """Successive halving: every round has fewer candidates on more folds."""
        plan = self._plan
        self._try(candidates[:1], range(plan.first))  # a first model to use
        rounds = sorted({plan.first, min(plan.folds, plan.first + 2), plan.folds})
        alive = list(candidates)
        for done, folds in enumerate(rounds):
            if done and not self._in_time(0.6, f"folds beyond {rounds[done - 1]}"):
                return
            self._try(alive, range(folds))
            ranked = self._ranked(alive, range(folds))
            best = min((self._trials[c.name].mean(range(folds)) for c in ranked), default=0.0)
            simplest = [c for c in candidates if c in ranked][:1]
            half = ranked[: max(2, math.ceil(len(alive) / 2))]
            alive = [
                c
                for c in (*half, *(c for c in simplest if c not in half))
                if self._trials[c.name].mean(range(folds)) <= HOPELESS * best
            ]

    def _vary(self, base: Trial) -> None:
        """Try variations of the best candidate, what is better together, and this on a simpler one.

        A candidate with many parameters also represents errors of the integrator; a simpler one
        may have the smaller error once these are removed. It is therefore given a finer integration
        also if the best candidate gains nothing by it.
        """
        plan = self._plan
        known = [trial.candidate for trial in self._trials.values()]
        new = distinct_candidates(variations(base.candidate, self._machine), self._given, known)
        tried = new[: plan.affordable(base.candidate, self._machine)]
        first, folds = range(plan.first), range(len(base.errors))
        self._try(tried, first)
        better = [
            c
            for c in self._ranked(tried, first)
            if self._trials[c.name].mean(first) < base.mean(first)
        ]
        self._try(better[: plans.PROMOTED], folds)
        joint = base
        for c in self._ranked(better[: plans.PROMOTED], folds):
            if not self._gains(c, base, folds) or not self._in_time(0.75, "joint variations"):
                break
            if joint is not base:
                c = joined(base.candidate, joint.candidate, c)
                self._try([c], folds)
            if joint is base or self._gains(c, joint, folds):
                joint = self._trials[c.name]
        if self._in_time(0.75, "variations of a simpler candidate"):
            every = [trial.candidate for trial in self._trials.values()]
            simpler = self._simpler(known, base, folds)
            also = [joined(base.candidate, simple, joint.candidate) for simple in simpler]
            if joint is base:
                also = [fine for simple in simpler for fine in finer(simple, self._machine)]
            self._try(distinct_candidates(also, self._given, every)[:1], folds)

    def _reduce_friction(self, best: Trial) -> None:
        """Try viscous friction alone in the best candidate, then none, unless that is worse."""
        if any(key.partition(".")[0] == "dissipation" for key in self._given):
            return
        for less in with_less_friction(best.candidate):
            settings = left_open(less.settings, self._given)
            same = (
                trial.candidate
                for trial in self._trials.values()
                if left_open(trial.candidate.settings, self._given) == settings
            )
            candidate = next(same, less)
            for folds in (range(self._plan.first), range(len(best.errors))):
                self._try([candidate], folds)
                trial = self._trial(candidate)
                if trial.failed or beats(best.errors, trial.errors, folds):
                    return

    def _simpler(
        self, candidates: Sequence[Candidate], base: Trial, folds: Sequence[int]
    ) -> list[Candidate]:
        """Return the candidates that are simpler than one and not hopeless, the best first."""
        ranked = self._ranked([c for c in candidates if c.rank < base.candidate.rank], folds)
        least = HOPELESS * base.mean(folds)
        return [c for c in ranked if self._trials[c.name].mean(folds) <= least]

    def _gains(self, candidate: Candidate, base: Trial, folds: Sequence[int]) -> bool:
        trial = self._trials[candidate.name]
        return not trial.failed and beats(trial.errors, base.errors, folds)

    def _try(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> None:
        """Do the folds that are not done yet, side by side."""
        todo = [
            (candidate, k)
            for candidate in candidates
            for k in folds
            if k not in self._trial(candidate).errors and k not in self._trial(candidate).reasons
        ]
        if not todo:
            return
        names = ", ".join(dict.fromkeys(c.name for c, _ in todo))
        phases.say(f"{len(todo)} runs: {names}")
        for candidate, k, folder in self._fitted(todo):
            self._note(self._trial(candidate), k, folder)
        self._fit_again({c.name: c for c, _ in todo}.values())
        phases.clear()
        self._link_best()
        for name in dict.fromkeys(c.name for c, _ in todo):
            trial = self._trials[name]
            print(f"{name}: {_told(trial)}", flush=True)

    def _fitted(
        self, todo: Sequence[tuple[Candidate, int]], attempt: int = 0
    ) -> list[tuple[Candidate, int, RunFolder | ConfigError]]:
        """Fit candidates to folds side by side, each attempt with a seed of its own."""
        count = self._plan.folds
        words = [self._overrides(c, f"data.fold=[{k},{count}]") for c, k in todo]
        names = [f"{c.name}, fold {k + 1} of {count}" for c, k in todo]
        found = self._sweep.perform([self._seeded(one, attempt) for one in words], names)
        return [(c, k, folder) for (c, k), folder in zip(todo, found, strict=True)]

    def _fit_again(self, candidates: Iterable[Candidate]) -> None:
        """Fit folds again, from other seeds, that ended at another minimum.

        Of all fits to a fold that with the least noise is kept, which takes training data alone.
        """
        candidates = list(candidates)
        for attempt in range(1, FOLD_FITS):
            todo = [(c, k) for c in candidates for k in self._at_other_minima(c)]
            for candidate, k, folder in self._fitted(todo, attempt) if todo else []:
                before = self._folders[candidate.name, k]
                if isinstance(folder, ConfigError) or with_least_noise([before, folder]) is before:
                    continue
                if math.isfinite(fold_error(folder)):
                    self._note(self._trial(candidate), k, folder)

    def _at_other_minima(self, candidate: Candidate) -> list[int]:
        """Return the folds that ended with far more noise than another fold of the candidate.

        None of candidates with one start, which have no other minima, and of those with far more
        noise than another candidate, which do not explain the motion.
        """
        mine = self._noises(candidate)
        if candidate.starts == 1 or not mine:
            return []
        least = min(x for t in self._trials.values() for x in self._noises(t.candidate).values())
        return noisy_folds(mine) if min(mine.values()) <= NOISY * least else []

    def _noises(self, candidate: Candidate) -> dict[int, float]:
        """Return the estimated noise in the folds of a candidate."""
        folds = self._trial(candidate).errors
        return {k: noise_of_fit(self._folders[candidate.name, k]) for k in folds}

    def _note(self, trial: Trial, k: int, folder: RunFolder | ConfigError) -> None:
        """Keep how a fold ended."""
        if isinstance(folder, ConfigError):
            trial.reasons[k] = str(folder)
            return
        outcome = folder.outcome()
        trial.seconds += outcome.seconds
        if outcome.status != "finished":
            trial.reasons[k] = outcome.reason
            return
        mine = fold_error(folder)
        if k not in self._baselines:
            self._baselines[k] = baseline_error(folder)
        mine = min(mine, WORST * self._baselines[k])
        if not math.isfinite(mine):
            trial.reasons[k] = (
                "it was ended before its first validation" if math.isnan(mine)
                else "it diverges, or no window of the held-out part moves"
            )  # fmt: skip
            return
        trial.errors[k] = max(mine, LEAST)
        self._folders[trial.candidate.name, k] = folder
        trial.overran += len(read(folder / SERIES)) < self._epochs(trial.candidate)

    def _ranked(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> list[Candidate]:
        """Return the candidates without failures, the best first."""
        sound = [c for c in candidates if not self._trials[c.name].failed]
        return sorted(sound, key=lambda c: self._trials[c.name].mean(folds))

    def _choice(self) -> Trial | None:
        """Return the simplest of the best candidates, of those with the most folds."""
        sound = [t for t in self._trials.values() if not t.failed]
        folds = max((len(t.errors) for t in sound), default=0)
        return choose(sound, range(folds)) if folds else None

    def _trial(self, candidate: Candidate) -> Trial:
        return self._trials.setdefault(candidate.name, Trial(candidate))

    def _in_time(self, share: float, stage: str) -> bool:
        """Return whether there is time for a stage: the search has not far exceeded this share.

        A stage that is left out is printed and kept in the plan: the same command leaves it out
        again.
        """
        if stage in self._plan.without:
            return False
        elapsed = time.monotonic() - self._start
        planned = max(self._plan.budget, self._plan.needed)
        if not self._clock or elapsed <= OVERRUN * share * planned:
            return True
        print(
            f"after {elapsed / 60:.2g} min, more than {OVERRUN:g} times the time planned, "
            f"{stage} are left out (hydra.sweeper.clock=false lets the plan alone decide)",
            flush=True,
        )
        self._plan = replace(self._plan, without=(*self._plan.without, stage))
        plans.keep_plan(self._folder / PLAN, self._plan)
        return False

    # -- the chosen one ----------------------------------------------------------------------------

    def _finish(self, best: Trial) -> int:
        """Fit the chosen candidate to the training and the validation part, and test it."""
        machine, epochs = self._machine, self._last_epoch(best)
        seconds = self._plan.most_seconds(best.candidate, machine)
        nodes = round(seconds / machine.time_step)
        share = "all" if seconds >= machine.seconds else f"{100 * seconds / machine.seconds:.0f} %"
        print(f"chosen: {best.candidate.name}; fitted to {share} of train and val", flush=True)

        def last(attempt: int, **changed: str | None) -> list[str]:
            found = self._overrides(
                best.candidate,
                f"data.fold={POOLED}",
                f"trainer.max_epochs={epochs}",
                f"trainer.validate_every={epochs}",  # once: nothing is held out
                "optimizer.tolerance=1e9",  # so that the last parameters are kept
                self._limit(best.candidate, nodes),
                data__seconds=f"data.seconds={seconds:g}" if seconds < machine.seconds else None,
                **changed,
            )
            return self._seeded(found, attempt)

        fits = self._last_fits(best, last)
        folder = with_least_noise(list(fits.values()))
        if folder.outcome().status == "finished":  # it alone is tested
            attempt = next(k for k, fit in fits.items() if fit is folder)
            asked = last(attempt, logger=None, pictures="pictures=true", measures="measures=true")
            (tested,) = self._sweep.perform([asked], [best.candidate.name])
            if isinstance(tested, ConfigError):
                raise tested
        self._summary(best)
        if folder.outcome().status != "finished":
            print(f"the last fit {folder.outcome().status}: {folder.outcome().reason}")
            return 1
        if len(fits) > 1:
            print(f"the last fit with the least noise of {len(fits)} is kept")
        if (done := len(read(folder / SERIES))) < epochs:
            print(f"the last fit ran out of time after {done} of {epochs} epochs")
        self._link(folder)
        measures = folder.measures()
        label = verdict(measures) or "not judged"
        if failed := hopeless(measures):
            bad = label.startswith("no")
            label = f"no model; {label if bad else 'hardly better than constant velocity'}"
        print(f"verdict on the test part: {label}")
        if (beside := comparison(measures)) is not None:
            print(f"  {beside}")
        if "open_loop_rmse" in measures:
            whole = measures["open_loop_rmse"]
            print(f"  RMSE over whole test recordings, in open loop from their start: {whole:.2g}")
        if failed or comparison(measures) is None:
            self._print_doubts()
        print(f'the model: symo_exp.load("{os.path.relpath(self._folder / BEST)}")')
        return 0

    def _last_fits(
        self, best: Trial, overrides: Callable[[int], list[str]]
    ) -> dict[int, RunFolder]:
        """Fit the chosen candidate from several seeds, from more if all end with far more noise.

        The folds show its noise.

        Args:
            best: The chosen candidate.
            overrides: Those of the fit of an attempt.

        Returns:
            The fits by their attempts.
        """
        name, fits = best.candidate.name, dict[int, RunFolder]()
        first = self._plan.last_fits(best.candidate)
        enough = NOISY * min(self._noises(best.candidate).values())
        for attempts in (range(first), range(first, plans.MOST_FITS)):
            found = self._sweep.perform(
                [overrides(k) for k in attempts], [f"{name}, fit {k + 1}" for k in attempts]
            )
            for k, fit in zip(attempts, found, strict=True):
                if isinstance(fit, ConfigError):
                    raise fit
                fits[k] = fit
            if first == 1 or min(map(noise_of_fit, fits.values())) <= enough:
                break
        return fits

    def _seeded(self, overrides: Sequence[str], attempt: int) -> list[str]:
        """Return the overrides of an attempt; the first one has the seed of the search."""
        if not attempt:
            return list(overrides)
        seed = f"seed={self._master.seed + SEEDS * attempt}"
        return [seed, *(word for word in overrides if not word.startswith("seed="))]

    def _print_doubts(self) -> None:
        for line in doubts(self._machine):
            print(f"  possible reason: {line}")

    def _no_model(self) -> int:
        if self._trials:
            self._summary(None)
        print("verdict: no model")
        self._print_doubts()
        return 1

    def _last_epoch(self, best: Trial) -> int:
        """Return the epochs after which the folds were best, their median over whole stages."""
        effort = self._plan.effort
        begun = best.candidate.starts * effort.start
        stages = []
        for k in best.errors:
            rows = read(self._folders[best.candidate.name, k] / SERIES)
            losses = [(row["val_loss"], row["epoch"]) for row in rows if "val_loss" in row]
            last = min(losses)[1] + 1 if losses else begun + effort.epochs
            stages.append(max(1, math.ceil((last - begun) / effort.epochs)))
        return int(begun + effort.epochs * round(median(stages)))

    def _epochs(self, candidate: Candidate) -> int:
        """Return how many epochs a run has at least that was not ended."""
        effort = self._plan.effort
        return candidate.starts * effort.start + EPSILONS * effort.epochs

    # -- folders -----------------------------------------------------------------------------------

    @property
    def _experiment(self) -> str:
        if "experiment" in self._given:
            return str(self._master.experiment)
        path = self._master.data.path
        stem = Path(path).stem if isinstance(path, str) else Path(path[0]).parent.name
        return f"machine_{re.sub(r'[^0-9A-Za-z_.-]+', '_', stem).lstrip('.')}"

    @property
    def _folder(self) -> Path:
        return Path(str(self._master.output_dir)).absolute() / self._experiment

    def _overrides(self, candidate: Candidate, *more: str, **changed: str | None) -> list[str]:
        """Return the overrides of a run, those of the command line last."""
        plan, machine = self._plan, self._machine
        nodes = round(plan.seconds / machine.time_step)
        settings = _by_key(
            [
                *machine.settings,
                f"experiment={self._experiment}",
                "logger=none",
                "trainer.compile=false",  # it takes longer than most of these trainings
                "pictures=false",
                "measures=false",
                f"learner.validation.iterations={ITERATIONS}",
                f"data.seconds={plan.seconds:g}",
                self._limit(candidate, nodes),
                *plan.overrides(candidate),
                *candidate.overrides(),
                *more,
            ]
        )
        if candidate.settings["dissipation"] == "none":
            settings = left_open(settings, ["dissipation"]) | {"dissipation": "dissipation=none"}
        for key, value in changed.items():
            name = key.replace("__", ".")
            settings.pop(name, None)
            if value is not None:
                settings[name] = value
        found = {**left_open(settings, self._given), **self._given}
        return sorted(found.values(), key=lambda word: "." in word.partition("=")[0])

    def _limit(self, candidate: Candidate, nodes: int) -> str:
        """Return the setting of the time after which a training is ended."""
        limit = self._plan.limit(candidate, nodes, self._machine)
        return f"trainer.time_limit={limit:.0f}" if self._clock else "trainer.time_limit=null"

    def _link_best(self) -> None:
        """Let the link point to the best run so far, until a fit to all data takes its place."""
        done = [t for t in self._trials.values() if t.errors]
        if not done:
            return
        trial = min(done, key=lambda t: t.mean())
        fold = min(trial.errors, key=lambda k: trial.errors[k])
        self._link(self._folders[trial.candidate.name, fold])

    def _link(self, folder: RunFolder) -> None:
        link, new = self._folder / BEST, self._folder / f".{BEST}.{os.getpid()}"
        new.unlink(missing_ok=True)
        new.symlink_to(os.path.relpath(folder.path, self._folder), target_is_directory=True)
        os.replace(new, link)

    def _summary(self, best: Trial | None) -> None:
        """Print and keep the table of candidates."""
        trials = sorted(self._trials.values(), key=lambda t: t.candidate.rank)
        for trial in trials:
            trial.parameters = self._parameters(trial)
        print(candidates_table(trials, best, self._plan.folds))
        write_candidates(self._folder / CANDIDATES, trials, best)

    def _parameters(self, trial: Trial) -> int | None:
        from symo_exp.runs.load import from_folder

        for k in trial.errors:
            model = from_folder(self._folders[trial.candidate.name, k].path)
            return sum(p.numel() for p in model.parameters())
        return None


def _by_key(overrides: Sequence[str]) -> dict[str, str]:
    """Return the overrides by what they set.

    Raises:
        ConfigError: If one is a sweep.
    """
    found = {}
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        if override.is_sweep_override():
            raise ConfigError(
                f"{override.input_line}: a search takes one value for each setting, and chooses "
                "its candidates itself"
            )
        line = override.input_line
        assert line is not None
        found[override.get_key_element().lstrip("+~")] = line
    return found


def _told(trial: Trial) -> str:
    if trial.reasons:
        return f"failed: {next(iter(trial.reasons.values()))}"
    ended = f", {trial.overran} ran out of time" if trial.overran else ""
    return (
        f"error {trial.mean():.3g} over {len(trial.errors)} fold(s), {trial.seconds:.0f} s{ended}"
    )


def _cores(master: DictConfig) -> int:
    """Return how many runs the launcher does at a time."""
    jobs = int(master.hydra.launcher.get("n_jobs") or 1)
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    if "basic_launcher" in str(master.hydra.launcher._target_):
        return 1
    return jobs if jobs > 0 else there or 1


def _plain(value: Any) -> Any:
    return OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
