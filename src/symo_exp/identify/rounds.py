"""Rounds of a search over folds: candidates, combinations, variations, simplifications."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from symo_exp.errors import ConfigError
from symo_exp.identify import plan as plans
from symo_exp.identify.candidates import (
    Candidate,
    distinct_candidates,
    exclude,
    joined,
    left_open,
    structure_of,
)
from symo_exp.identify.fits import Fits
from symo_exp.identify.structures import structures
from symo_exp.identify.validation import (
    LEAST,
    NOISY,
    WORST,
    Trial,
    baseline_error,
    beats,
    choose,
    fold_error,
    likelier,
    noisy_folds,
    parameters_of,
    with_least_noise,
)
from symo_exp.identify.variations import (
    finer,
    of_higher_order,
    variations,
    with_friction_of,
    with_half_the_step,
    with_less_friction,
    without_springs,
)
from symo_exp.process import phases
from symo_exp.runs.folder import SERIES, RunFolder
from symo_exp.runs.series import read

HOPELESS = 4.0
"""A candidate whose error is so many times the best one's is not tried on further folds."""
POOR = 0.02
"""Error over that of constant velocity beyond which a candidate does not suit the machine."""
SIMPLER = 2
"""Simpler structures that are given the friction or the variations of the best candidate."""
FASTEST = 0.25
"""Ratio of the time that runs take to the planned one, at least."""
FOLD_FITS = 3
"""Fits of a candidate to one fold, at most."""


class Rounds:
    """The candidates of a search and the results of their folds.

    Args:
        fits: Fits candidates to the recordings of a machine by a plan.
        progressed: Called with the best fit and the candidates so far after every round.
    """

    def __init__(
        self, fits: Fits, progressed: Callable[[RunFolder, Sequence[Trial]], object]
    ) -> None:
        self._fits, self._progressed = fits, progressed
        self._machine, self._plan, self._given = fits.machine, fits.plan, fits.given
        self._nodes = round(fits.plan.seconds / fits.machine.time_step)  # of a fold
        self._spent = 0.0  # planned time of the runs so far, one after another [s]
        self._screened = 0.0  # that of the first rounds
        self._trials: dict[str, Trial] = {}
        self._baselines: dict[int, float] = {}

    @property
    def trials(self) -> list[Trial]:
        """All candidates that were tried, the simplest first."""
        return sorted(self._trials.values(), key=lambda t: t.candidate.rank)

    def best(self) -> Trial | None:
        """Return the simplest of the best candidates, of those with the most folds."""
        sound = [t for t in self._trials.values() if not t.failed]
        folds = max((len(t.errors) for t in sound), default=0)
        return choose(sound, range(folds)) if folds else None

    def screen(self, candidates: Sequence[Candidate]) -> None:
        """Successive halving: every round has fewer candidates on more folds."""
        plan = self._plan
        self._try(candidates[:1], range(plan.first))  # a first model to use
        rounds = sorted({plan.first, min(plan.folds, plan.first + 2), plan.folds})
        alive = list(candidates)
        for folds in map(range, rounds):
            if self._screened:
                alive = self._in_time_for(alive, folds)
            self._try(alive, folds)
            self._screened = self._spent
            ranked = self._ranked(alive, folds)
            best = min((self._mean(c, folds) for c in ranked), default=0.0)
            simplest = [c for c in candidates if c in ranked][:1]
            half = ranked[: max(2, math.ceil(len(alive) / 2))]
            kept = distinct_candidates((*half[:1], *simplest, *half[1:]), self._given)
            alive = [c for c in kept if not self._hopeless(c, best, folds)]

    def deepen(self, candidates: Sequence[Candidate]) -> None:
        """Try candidates that the plan left out, if those that it has do not suit the machine."""
        first = range(self._plan.first)
        if (best := self.best()) is None or best.mean(first) <= POOR * self._baseline(first):
            return
        if further := self._affordable(candidates, best):
            print("further candidates, since none so far suits the machine", flush=True)
        self._promote(further, best)

    def refine(self) -> Trial | None:
        """Do all stages after the first rounds; return what is chosen, nothing if all failed."""
        for stage in (self.combine, self.vary, self.halve):
            if (best := self.best()) is not None:
                stage(best)
        if (best := self.best()) is None:
            return None
        return self.raise_order(self.reduce_structure(self.reduce_forces(best)))

    def combine(self, best: Trial) -> None:
        """Give the friction of the best candidate to simpler structures, the best of them.

        The candidates of the first round do not combine every structure with every friction, so
        that a network may be the best one for its friction alone, or because it also represents
        errors of the integrator. The best combination is therefore integrated more finely as well.
        """
        first, known = range(self._plan.first), [t.candidate for t in self._trials.values()]
        structures = {structure_of(best.candidate): best.candidate}
        for simple in self._simpler(known, best, first):
            structures.setdefault(structure_of(simple), simple)
        simpler = [c for c in structures.values() if c is not best.candidate]
        given = (with_friction_of(simple, best.candidate) for simple in simpler)
        folds = range(len(best.errors))
        tried = self._affordable(distinct_candidates(given, self._given, known)[:SIMPLER], best)
        self._try(tried, first)
        ranked, least = self._ranked(tried, first), best.mean(first)
        promising = [c for c in ranked if not self._hopeless(c, least, first)]
        for simple in promising[:1]:
            self._try([simple], folds)
            finest = distinct_candidates(finer(simple, self._machine), self._given, known)[:1]
            self._promote(self._affordable(finest, best), self._trials[simple.name])

    def vary(self, base: Trial) -> None:
        """Try variations of the best candidate, and those that are better together."""
        known = [trial.candidate for trial in self._trials.values()]
        new = distinct_candidates(variations(base.candidate, self._machine), self._given, known)
        folds = range(len(base.errors))
        tried = self._affordable(new, base, keep=len(folds) * self._planned(base.candidate))
        joint = base
        for c in self._ranked(self._promote(tried, base), folds):
            if not self._gains(c, base, folds):
                break
            if joint is not base:
                if exclude(base.candidate, joint.candidate, c):
                    continue
                c = joined(base.candidate, joint.candidate, c)
                if not self._affordable([c], base):
                    break
                self._try([c], folds)
            if joint is base or self._gains(c, joint, folds):
                joint = self._trials[c.name]

    def halve(self, best: Trial) -> None:
        """Halve time steps that the best candidate has halved, as long as its error decreases.

        Motors that stick and slip do so within a step.
        """
        if "system.time_step" not in best.candidate.settings:
            return
        halved = with_half_the_step(best.candidate, self._machine)
        tried = self._affordable(distinct_candidates(halved, self._given), best)
        for fine in self._promote(tried, best):
            if self._gains(fine, best, range(len(best.errors))):
                self.halve(self._trials[fine.name])

    def reduce_forces(self, best: Trial) -> Trial:
        """Return the best candidate with fewer forces, unless that is worse.

        It is tried without springs, then with viscous friction alone, then without friction.
        """
        given = {key.partition(".")[0] for key in self._given}
        for key, fewer in ("springs", without_springs), ("dissipation", with_less_friction):
            for less in fewer(best.candidate) if key not in given else ():
                trial = self._at_least_as_good(less, best, self._worse)
                if trial is None:
                    break
                best = trial
        return best

    def reduce_structure(self, best: Trial) -> Trial:
        """Return the best candidate with a simpler structure, unless that is worse for certain.

        Structures with more parameters also represent errors of the integrator. If the best
        candidate is in the midpoint rule, a simpler structure is therefore integrated more finely
        as well. Where the best candidate has no springs, simpler structures are tried without them.
        """

        def like_best(structure: Candidate) -> Candidate:
            sprung = "springs" in best.candidate.settings
            return structure if sprung else next(without_springs(structure), structure)

        tried = [c for c in structures(self._machine) if c.name in self._trials]
        named = f"{best.candidate.name}, "
        mine = [c for c in tried if named.startswith(f"{like_best(c).name}, ")]
        if not mine:
            return best
        base = max(mine, key=lambda c: len(c.name))
        simpler = self._simpler(tried, self._trials[base.name], range(self._plan.first))
        simplest = sorted(simpler, key=lambda c: c.rank)[:1]
        for structure in distinct_candidates([*simplest, *simpler[:SIMPLER]], self._given):
            given = joined(like_best(base), like_best(structure), best.candidate)
            fine = finer(given, self._machine) if given.settings["integrator"] == "midpoint" else ()
            for candidate in (given, *list(fine)[:1]):
                trial = self._at_least_as_good(candidate, best, self._beaten)
                if trial is not None:
                    return self.reduce_structure(trial)
        return best

    def raise_order(self, best: Trial) -> Trial:
        """Return the best candidate with an integrator of higher order, if data are likelier.

        It has as many parameters. Held-out errors of short and noisy recordings are those of the
        starts of the predictions, and do not show that it is more accurate.
        """
        if "integrator" in self._given:
            return best
        for fine in of_higher_order(best.candidate, self._machine):
            if (better := self._at_least_as_good(fine, best, self._no_better)) is not None:
                return self.raise_order(better)
        return best

    def _promote(self, tried: Sequence[Candidate], base: Trial) -> list[Candidate]:
        """Try candidates on the first folds, and the best ones on all folds of another candidate.

        Returns:
            Those tried on all folds: ``PROMOTED`` at most, each better on the first than ``base``.
        """
        first = range(self._plan.first)
        self._try(tried, first)
        better = [c for c in self._ranked(tried, first) if self._mean(c, first) < base.mean(first)]
        self._try(better[: plans.PROMOTED], range(len(base.errors)))
        return better[: plans.PROMOTED]

    def _at_least_as_good(
        self,
        candidate: Candidate,
        best: Trial,
        worse: Callable[[Trial, Trial, Sequence[int]], bool],
    ) -> Trial | None:
        """Return the trial of a candidate, nothing if it fails or is worse in some folds or all."""
        settings = left_open(candidate.settings, self._given)
        same = (
            trial.candidate
            for trial in self._trials.values()
            if left_open(trial.candidate.settings, self._given) == settings
        )
        candidate = next(same, candidate)
        if not self._affordable([candidate], best):
            return None
        trial = self._trial(candidate)
        for folds in (range(self._plan.first), range(len(best.errors))):
            self._try([candidate], folds)
            if trial.failed or worse(trial, best, folds):
                return None
        return trial

    def _beaten(self, simple: Trial, best: Trial, folds: Sequence[int]) -> bool:
        """Return whether a simpler structure has larger errors for certain."""
        return beats(best.errors, simple.errors, folds)

    def _worse(self, less: Trial, more: Trial, folds: Sequence[int]) -> bool:
        """Return whether a simpler model is less likely and has no smaller errors for certain."""
        parameters = (more.parameters or 0) - (less.parameters or 0)
        return self._likelier(more, less, folds, parameters) and not beats(
            less.errors, more.errors, folds
        )

    def _no_better(self, fine: Trial, coarse: Trial, folds: Sequence[int]) -> bool:
        """Return whether a finer integration has larger errors for certain, or is not likelier.

        A gain in likelihood that a useless parameter would also give does not count.
        """
        return beats(coarse.errors, fine.errors, folds) or self._likelier(coarse, fine, folds, -1)

    def _likelier(self, one: Trial, other: Trial, folds: Sequence[int], more: int) -> bool:
        count = self._nodes * self._machine.coordinates.n
        return likelier(one.noises(), other.noises(), folds, more, count)

    def _simpler(
        self, candidates: Sequence[Candidate], base: Trial, folds: Sequence[int]
    ) -> list[Candidate]:
        """Return the candidates that are simpler than one and not hopeless, the best first."""
        ranked = self._ranked([c for c in candidates if c.rank < base.candidate.rank], folds)
        return [c for c in ranked if not self._hopeless(c, base.mean(folds), folds)]

    def _hopeless(self, candidate: Candidate, least: float, folds: Sequence[int]) -> bool:
        return self._mean(candidate, folds) > HOPELESS * least

    def _gains(self, candidate: Candidate, base: Trial, folds: Sequence[int]) -> bool:
        trial = self._trials[candidate.name]
        return not trial.failed and beats(trial.errors, base.errors, folds)

    def _affordable(
        self, candidates: Sequence[Candidate], best: Trial, keep: float = 0.0
    ) -> list[Candidate]:
        """Return the candidates, the best first, that there is time for, and print the others.

        There is time for the first folds of each, and for all folds of the costliest ``PROMOTED``,
        before the last fits of the ``best`` one; at least the time that the plan has reserved.
        Of the planned time, ``keep`` [s] is left for what follows.
        """
        first, others = range(self._plan.first), range(self._plan.first, len(best.errors))

        def needed(tried: Sequence[Candidate]) -> float:
            costliest = sorted(self._time_on(c, others) for c in tried)[-plans.PROMOTED :]
            return sum(self._time_on(c, first) for c in tried) + sum(costliest)

        reserved = self._plan.reserved - (self._spent - self._screened)
        found = _fitting(candidates, needed, max(self._left(best) - keep, reserved))
        if missed := [c.name for c in candidates if c not in found]:
            base = f"{best.candidate.name}, "
            varied = all(name.startswith(base) for name in missed)
            of = f" variations of {best.candidate.name}" if varied else ""
            names = (name.removeprefix(base) if varied else name for name in missed)
            print(f"no time left for{of}: {'; '.join(names)}", flush=True)
        return found

    def _in_time_for(
        self, candidates: Sequence[Candidate], folds: Sequence[int]
    ) -> list[Candidate]:
        """Return the candidates, the best first, that there is time for on all of some folds.

        The others are printed. The time that the plan has reserved for later stages is kept.
        """

        def needed(tried: Sequence[Candidate]) -> float:
            return sum(self._time_on(c, folds) for c in tried)

        left = self._left(self._trials[candidates[0].name]) if candidates else 0.0
        found = _fitting(candidates, needed, left - self._plan.reserved)
        if missed := [c.name for c in candidates if c not in found]:
            print(f"no time left for {len(folds)} folds of {'; '.join(missed)}", flush=True)
        return found

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
        return len(self._undone(candidate, folds)) * self._planned(candidate)

    def _planned(self, candidate: Candidate) -> float:
        """Return the planned time of a fold [s]."""
        return self._plan.expected(candidate, self._nodes, self._machine)

    def _undone(self, candidate: Candidate, folds: Sequence[int]) -> list[int]:
        trial = self._trials.get(candidate.name, Trial(candidate))
        return [k for k in folds if k not in trial.errors and k not in trial.reasons]

    def _try(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> None:
        """Do the folds that are not done yet, side by side."""
        todo = [(c, k) for c in candidates for k in self._undone(c, folds)]
        if not todo:
            return
        self._spend(todo)
        names = ", ".join(dict.fromkeys(c.name for c, _ in todo))
        phases.say(f"{len(todo)} runs: {names}")
        for candidate, k, folder in self._fits.to_folds(todo):
            self._note(candidate, k, folder)
        self._fit_again({c.name: c for c, _ in todo}.values())
        phases.clear()
        if (best := self._best_fit()) is not None:
            self._progressed(best, self.trials)
        for name in dict.fromkeys(c.name for c, _ in todo):
            print(f"{name}: {self._trials[name].told()}", flush=True)

    def _spend(self, runs: Iterable[tuple[Candidate, int]]) -> None:
        """Count the planned time of runs as spent."""
        self._spent += sum(self._planned(candidate) for candidate, _ in runs)

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
                before = self._trial(candidate).folders[k]
                if isinstance(folder, ConfigError):
                    continue
                quieter = with_least_noise([before, folder]) is folder
                if quieter and math.isfinite(fold_error(folder)):
                    self._note(candidate, k, folder)
                else:
                    self._trial(candidate).seconds += folder.outcome().seconds

    def _at_other_minima(self, candidate: Candidate) -> list[int]:
        """Return the folds that ended with far more noise than another fold of the candidate.

        There are none for candidates whose start is not drawn, which have no other minima, and for
        those with far more noise than another candidate, which do not explain the motion.
        """
        mine = self._trial(candidate).noises()
        if not candidate.has_minima or not mine:
            return []
        least = min(x for t in self._trials.values() for x in t.noises().values())
        return noisy_folds(mine) if min(mine.values()) <= NOISY * least else []

    def _note(self, candidate: Candidate, k: int, folder: RunFolder | ConfigError) -> None:
        """Keep how a fold ended."""
        trial = self._trial(candidate)
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
        if len(read(folder / SERIES)) < self._plan.effort.fewest(candidate):
            trial.overran.add(k)
        else:
            trial.overran.discard(k)  # the fold was fitted again, and that fit is kept

    def _ranked(self, candidates: Sequence[Candidate], folds: Sequence[int]) -> list[Candidate]:
        """Return the candidates without failures, the best first."""
        sound = [c for c in candidates if not self._trials[c.name].failed]
        return sorted(sound, key=lambda c: self._mean(c, folds))

    def _mean(self, candidate: Candidate, folds: Sequence[int]) -> float:
        return self._trials[candidate.name].mean(folds)

    def _baseline(self, folds: Sequence[int]) -> float:
        """Return the geometric mean of the errors of constant velocity."""
        return math.exp(sum(math.log(self._baselines[k]) for k in folds) / len(folds))

    def _trial(self, candidate: Candidate) -> Trial:
        return self._trials.setdefault(candidate.name, Trial(candidate))


def _fitting(
    candidates: Sequence[Candidate], needed: Callable[[Sequence[Candidate]], float], left: float
) -> list[Candidate]:
    """Return the candidates, in their order, that together need no more time than is left."""
    found: list[Candidate] = []
    for candidate in candidates:
        if needed([*found, candidate]) <= left:
            found.append(candidate)
    return found
