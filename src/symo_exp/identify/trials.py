"""Trials of candidates on folds: their results, and the time that they took."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from symo_exp.errors import ConfigError
from symo_exp.identify import plan as plans
from symo_exp.identify.candidates import Candidate
from symo_exp.identify.fits import Fits
from symo_exp.identify.validation import (
    LEAST,
    NOISY,
    WORST,
    Trial,
    baseline_error,
    choose,
    fold_error,
    likelier,
    noisy_folds,
    parameters_of,
    ran_out_of_time,
    with_least_noise,
)
from symo_exp.process import phases
from symo_exp.runs.folder import RunFolder
from symo_exp.words import counted

FASTEST = 0.25
"""Ratio of the time that runs take to the planned one, at least."""
FOLD_FITS = 3
"""Fits of a candidate to one fold, at most."""


class Trials:
    """The candidates of a search that were tried, within the time of its plan.

    Args:
        fits: Fits candidates to the recordings of a machine by a plan.
        progressed: Called with the best fit and all trials when some were added.
    """

    def __init__(
        self, fits: Fits, progressed: Callable[[RunFolder, Sequence[Trial]], object]
    ) -> None:
        self._fits, self._progressed = fits, progressed
        self._machine, self._plan = fits.machine, fits.plan
        self._nodes = round(fits.plan.seconds / fits.machine.time_step)  # of a fold
        self._spent = 0.0  # planned time of the runs so far, one after another [s]
        self._screened = 0.0  # that of the first rounds
        self._trials: dict[str, Trial] = {}
        self._baselines: dict[int, float] = {}

    @property
    def candidates(self) -> list[Candidate]:
        """The candidates, in the order of their first trials."""
        return [trial.candidate for trial in self._trials.values()]

    def of(self, candidate: Candidate) -> Trial:
        """Return the trial of a candidate, without results at first."""
        return self._trials.setdefault(candidate.name, Trial(candidate))

    def by_simplicity(self) -> list[Trial]:
        """Return all trials, that of the simplest candidate first."""
        return sorted(self._trials.values(), key=lambda t: t.candidate.rank)

    def best(self) -> Trial | None:
        """Return the simplest of the best candidates, of those with the most folds."""
        sound = [t for t in self._trials.values() if not t.failed]
        folds = max((len(t.errors) for t in sound), default=0)
        return choose(sound, range(folds)) if folds else None

    def run(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> list[Candidate]:
        """Do the folds that are not done yet, side by side, and return ``ranked`` candidates."""
        if todo := [(c, k) for c in candidates for k in self._undone(c, folds)]:
            self._run(todo)
        return self.ranked(candidates, folds)

    def _run(self, todo: Sequence[tuple[Candidate, int]]) -> None:
        self._spend(todo)
        names = ", ".join(dict.fromkeys(c.name for c, _ in todo))
        phases.say(f"{counted(len(todo), 'run')}: {names}")
        for candidate, k, folder in self._fits.to_folds(todo):
            self._note(candidate, k, folder)
        self._fit_again({c.name: c for c, _ in todo}.values())
        phases.clear()
        if (best := self._best_fit()) is not None:
            self._progressed(best, self.by_simplicity())
        for name in dict.fromkeys(c.name for c, _ in todo):
            print(f"{name}: {self._trials[name].told()}", flush=True)

    def ranked(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> list[Candidate]:
        """Return the candidates without failures, the best first."""
        sound = [c for c in candidates if not self.of(c).failed]
        return sorted(sound, key=lambda c: self.of(c).mean(folds))

    def baseline(self, folds: Sequence[int]) -> float:
        """Return the geometric mean of the errors of constant velocity."""
        return math.exp(sum(math.log(self._baselines[k]) for k in folds) / len(folds))

    def likelier(self, one: Trial, other: Trial, folds: Sequence[int], more: int) -> bool:
        """Return whether data are likelier by one trial, whose model has ``more`` parameters."""
        count = self._nodes * self._machine.coordinates.n
        return likelier(one.noises(), other.noises(), folds, more, count)

    def reserve(self) -> None:
        """Keep the time that the plan has reserved for the stages after the runs so far."""
        self._screened = self._spent

    def affordable(
        self, candidates: Sequence[Candidate], best: Trial, keep: float = 0.0
    ) -> list[Candidate]:
        """Return the candidates, the best first, that there is time for, and print the others.

        There is time for the first folds of each, and for all folds of the costliest ``PROMOTED``,
        before the last fits of the ``best`` one; at least the time that the plan has reserved.
        Of the planned time, ``keep`` [s] is left for what follows.
        """
        first, others = range(plans.FIRST), range(plans.FIRST, len(best.errors))

        def needed(tried: Sequence[Candidate]) -> float:
            costliest = sorted(self._time_on(c, others) for c in tried)[-plans.PROMOTED :]
            return sum(self._time_on(c, first) for c in tried) + sum(costliest)

        reserved = self._plan.reserved - (self._spent - self._screened)
        found = _fitting(candidates, needed, max(self._left(best) - keep, reserved))
        if missed := [c.name for c in candidates if c not in found]:
            base = f"{best.candidate.name}, "
            varied = all(name.startswith(base) for name in missed)
            of = f", variations of {best.candidate.name}" if varied else ""
            names = (name.removeprefix(base) if varied else name for name in missed)
            print(f"left out for lack of time{of}: {'; '.join(names)}", flush=True)
        return found

    def in_time_for(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> list[Candidate]:
        """Return the candidates, the best first, that there is time for on all of some folds.

        The others are printed. The time that the plan has reserved for later stages is kept.
        """

        def needed(tried: Sequence[Candidate]) -> float:
            return sum(self._time_on(c, folds) for c in tried)

        left = self._left(self._trials[candidates[0].name]) if candidates else 0.0
        found = _fitting(candidates, needed, left - self._plan.reserved)
        if missed := [c.name for c in candidates if c not in found]:
            kept = "to keep time for other candidates"
            print(f"not yet on {len(folds)} folds, {kept}: {'; '.join(missed)}", flush=True)
        return found

    def planned(self, candidate: Candidate) -> float:
        """Return the planned time of a fold [s]."""
        return self._plan.expected(candidate, self._nodes, self._machine)

    def _left(self, best: Trial) -> float:
        """Return the planned time that is left before the last fits of a candidate [s]."""
        return self._plan.search_time(best.candidate, self._machine, self._pace()) - self._spent

    def _pace(self) -> float:
        """Return how many times longer than planned the runs so far took."""
        if not self._fits.clock:
            return 1.0
        took = sum(trial.seconds for trial in self._trials.values())
        return max(FASTEST, took / self._spent)

    def _time_on(self, candidate: Candidate, folds: Sequence[int]) -> float:
        """Return the planned time of the folds that are not done yet, one after another [s]."""
        return len(self._undone(candidate, folds)) * self.planned(candidate)

    def _undone(self, candidate: Candidate, folds: Sequence[int]) -> list[int]:
        trial = self._trials.get(candidate.name, Trial(candidate))
        return [k for k in folds if k not in trial.errors and k not in trial.reasons]

    def _spend(self, runs: Iterable[tuple[Candidate, int]]) -> None:
        """Count the planned time of runs as spent."""
        self._spent += sum(self.planned(candidate) for candidate, _ in runs)

    def _best_fit(self) -> RunFolder | None:
        """Return the best fold of the candidate with the least error so far."""
        done = [t for t in self._trials.values() if t.errors]
        if not done:
            return None
        trial = min(done, key=lambda t: t.mean())
        fold = min(trial.errors, key=lambda k: trial.errors[k])
        return trial.folders[fold]

    def _fit_again(self, candidates: Iterable[Candidate]) -> None:
        """Fit folds that ended at another minimum again, from other seeds.

        The fit to a fold with the least noise is kept, which depends on training data alone.
        """
        candidates = list(candidates)
        for attempt in range(1, FOLD_FITS):
            todo = [(c, k) for c in candidates for k in self._at_other_minima(c)]
            self._spend(todo)
            for candidate, k, folder in self._fits.to_folds(todo, attempt) if todo else []:
                before = self.of(candidate).folders[k]
                if isinstance(folder, ConfigError):
                    continue
                quieter = with_least_noise([before, folder]) is folder
                if quieter and math.isfinite(fold_error(folder)):
                    self._note(candidate, k, folder)
                else:
                    self.of(candidate).seconds += folder.outcome().seconds

    def _at_other_minima(self, candidate: Candidate) -> list[int]:
        """Return the folds that ended with far more noise than another fold of the candidate.

        There are none for candidates whose start is not drawn, which have no other minima, and for
        those with far more noise than another candidate, which do not explain the motion.
        """
        mine = self.of(candidate).noises()
        if not candidate.has_minima or not mine:
            return []
        least = min(x for t in self._trials.values() for x in t.noises().values())
        return noisy_folds(mine) if min(mine.values()) <= NOISY * least else []

    def _note(self, candidate: Candidate, k: int, folder: RunFolder | ConfigError) -> None:
        """Keep how a fold ended."""
        trial = self.of(candidate)
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
                else "no window of the held-out part moves"
            )  # fmt: skip
            return
        trial.errors[k] = max(mine, LEAST)
        trial.folders[k] = folder
        if trial.parameters is None:
            trial.parameters = parameters_of(folder)
        if ran_out_of_time(folder):
            trial.overran.add(k)
        else:
            trial.overran.discard(k)  # the fold was fitted again, and that fit is kept


def _fitting(
    candidates: Sequence[Candidate], needed: Callable[[Sequence[Candidate]], float], left: float
) -> list[Candidate]:
    """Return the candidates, in their order, that together need no more time than is left."""
    found: list[Candidate] = []
    for candidate in candidates:
        if needed([*found, candidate]) <= left:
            found.append(candidate)
    return found
