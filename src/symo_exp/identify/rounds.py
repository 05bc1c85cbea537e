"""Rounds of a search over folds: candidates, combinations, variations, simplifications."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

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
from symo_exp.identify.trials import Trials
from symo_exp.identify.validation import GAIN, Trial, beats, noise_ratio
from symo_exp.identify.variations import (
    finer,
    of_higher_order,
    variations,
    with_finer_predictions,
    with_friction_of,
    with_half_the_step,
    with_less_friction,
    without_springs,
)

HOPELESS = 4.0
"""A candidate whose error is so many times the best one's is not tried on further folds."""
POOR = 0.02
"""Error over that of constant velocity beyond which a candidate does not suit the machine."""
SIMPLER = 2
"""Simpler structures that are given the friction or the variations of the best candidate."""


class Rounds:
    """The stages of a search, each of which tries further candidates.

    Args:
        fits: Fits candidates to the recordings of a machine by a plan.
        trials: The candidates that were tried by these fits.
    """

    def __init__(self, fits: Fits, trials: Trials) -> None:
        self._machine, self._plan, self._given = fits.machine, fits.plan, fits.given
        self.trials = trials

    def screen(self, candidates: Sequence[Candidate]) -> None:
        """Successive halving: every round has fewer candidates on more folds."""
        plan = self._plan
        self.trials.run(candidates[:1], range(plans.FIRST))  # a first model to use
        rounds = sorted({plans.FIRST, min(plan.folds, plans.FIRST + 2), plan.folds})
        alive = list(candidates)
        for folds in map(range, rounds):
            if len(folds) > plans.FIRST:
                alive = self.trials.in_time_for(alive, folds)
            ranked = self.trials.run(alive, folds)
            self.trials.reserve()
            simplest = [c for c in candidates if c in ranked][:1]
            half = ranked[: max(2, math.ceil(len(alive) / 2))]
            kept = distinct_candidates((*half[:1], *simplest, *half[1:]), self._given)
            alive = [c for c in kept if not self._hopeless(c, self.trials.of(ranked[0]), folds)]

    def deepen(self, candidates: Sequence[Candidate]) -> None:
        """Try candidates that the plan left out, if those that it has do not suit the machine.

        Before, the best one is integrated more finely, as long as that helps: the integrator may be
        all that does not suit, and the candidates left out include networks, which also represent
        its errors.
        """
        coarse, best = None, self._unsuitable() if candidates else None
        while best is not None and best is not coarse:
            coarse = best
            fine = finer(coarse.candidate, self._machine)
            for one in distinct_candidates(fine, self._given, self.trials.candidates):
                self._promote(self.trials.affordable([one], coarse), coarse)
                if (best := self._unsuitable()) is None:
                    return
        if best is None:
            return
        if further := self.trials.affordable(candidates, best):
            print("further candidates, since none so far suits the machine", flush=True)
        self._promote(further, best)

    def _unsuitable(self) -> Trial | None:
        """Return the best candidate, if it does not suit the machine."""
        first, best = range(plans.FIRST), self.trials.best()
        poor = best is not None and best.mean(first) > POOR * self.trials.baseline(first)
        return best if poor else None

    def refine(self) -> Trial | None:
        """Do all stages after the first rounds; return what is chosen, nothing if all failed."""
        for stage in (self.combine, self.vary, self.halve, self.refine_predictions):
            if (best := self.trials.best()) is not None:
                stage(best)
        if (best := self.trials.best()) is None:
            return None
        return self.raise_order(self.reduce_structure(self.reduce_forces(best)))

    def combine(self, best: Trial) -> None:
        """Give the friction of the best candidate to simpler structures, the best of them.

        The candidates of the first round do not combine every structure with every friction, so
        that a network may be the best one for its friction alone, or because it also represents
        errors of the integrator. The best combination is therefore integrated more finely as well.
        """
        first, known = range(plans.FIRST), self.trials.candidates
        structures = {structure_of(best.candidate): best.candidate}
        for simple in self._simpler(known, best):
            structures.setdefault(structure_of(simple), simple)
        simpler = [c for c in structures.values() if c is not best.candidate]
        given = (with_friction_of(simple, best.candidate) for simple in simpler)
        folds = range(len(best.errors))
        tried = self.trials.affordable(
            distinct_candidates(given, self._given, known)[:SIMPLER], best
        )
        ranked = self.trials.run(tried, first)
        promising = [c for c in ranked if not self._hopeless(c, best, first)]
        for simple in promising[:1]:
            self.trials.run([simple], folds)
            finest = distinct_candidates(finer(simple, self._machine), self._given, known)[:1]
            self._promote(self.trials.affordable(finest, best), self.trials.of(simple))

    def vary(self, base: Trial) -> None:
        """Try variations of the best candidate, and those that are better together."""
        known = self.trials.candidates
        new = distinct_candidates(variations(base.candidate, self._machine), self._given, known)
        folds = range(len(base.errors))
        tried = self.trials.affordable(
            new, base, keep=len(folds) * self.trials.planned(base.candidate)
        )
        joint = base
        for c in self._promote(tried, base):
            if not self._gains(c, base, folds):
                break
            if joint is not base:
                if exclude(base.candidate, joint.candidate, c):
                    continue
                c = joined(base.candidate, joint.candidate, c)
                if not self.trials.affordable([c], base):
                    break
                self.trials.run([c], folds)
            if joint is base or self._gains(c, joint, folds):
                joint = self.trials.of(c)

    def halve(self, best: Trial) -> None:
        """Halve time steps that the best candidate has halved, as long as its error decreases.

        Motors that stick and slip do so within a step.
        """
        if "system.time_step" not in best.candidate.settings:
            return
        halved = with_half_the_step(best.candidate, self._machine)
        tried = self.trials.affordable(distinct_candidates(halved, self._given), best)
        for fine in self._promote(tried, best):
            if self._gains(fine, best, range(len(best.errors))):
                self.halve(self.trials.of(fine))

    def refine_predictions(self, best: Trial) -> None:
        """Try predictions in parts of time steps, which need no other training."""
        finer = with_finer_predictions(best.candidate)
        new = distinct_candidates(finer, self._given, self.trials.candidates)
        self._promote(self.trials.affordable(new, best), best)

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

        names = {c.name for c in self.trials.candidates}
        tried = [c for c in structures(self._machine) if c.name in names]
        named = f"{best.candidate.name}, "
        mine = [c for c in tried if named.startswith(f"{like_best(c).name}, ")]
        if not mine:
            return best
        base = max(mine, key=lambda c: len(c.name))
        simpler = self._simpler(tried, self.trials.of(base))
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
            Those tried on all folds, the best first: ``PROMOTED`` at most, each better on the first
            folds than ``base``.
        """
        first = range(plans.FIRST)
        ranked, least = self.trials.run(tried, first), base.mean(first)
        better = [c for c in ranked if self.trials.of(c).mean(first) < least]
        return self.trials.run(better[: plans.PROMOTED], range(len(base.errors)))

    def _at_least_as_good(
        self,
        candidate: Candidate,
        best: Trial,
        worse: Callable[[Trial, Trial, Sequence[int]], bool],
    ) -> Trial | None:
        """Return the trial of a candidate, nothing if it fails or is worse in some folds or all."""
        settings = left_open(candidate.settings, self._given)
        same = (
            other
            for other in self.trials.candidates
            if left_open(other.settings, self._given) == settings
        )
        candidate = next(same, candidate)
        if not self.trials.affordable([candidate], best):
            return None
        trial = self.trials.of(candidate)
        for folds in (range(plans.FIRST), range(len(best.errors))):
            self.trials.run([candidate], folds)
            if trial.failed or worse(trial, best, folds):
                return None
        return trial

    def _beaten(self, simple: Trial, best: Trial, folds: Sequence[int]) -> bool:
        """Return whether a simpler structure has larger errors for certain."""
        return beats(best.errors, simple.errors, folds)

    def _worse(self, less: Trial, more: Trial, folds: Sequence[int]) -> bool:
        """Return whether a simpler model is less likely and has no smaller errors for certain.

        A model that leaves more noise than one that it contains has not been trained to its
        minimum. Noises say nothing then, and the errors alone decide.
        """
        if noise_ratio(more.noises(), less.noises(), folds) > GAIN:
            return beats(more.errors, less.errors, folds)
        parameters = (more.parameters or 0) - (less.parameters or 0)
        return self.trials.likelier(more, less, folds, parameters) and not beats(
            less.errors, more.errors, folds
        )

    def _no_better(self, fine: Trial, coarse: Trial, folds: Sequence[int]) -> bool:
        """Return whether a finer integration has larger errors for certain, or is not likelier.

        A gain in likelihood that a useless parameter would also give does not count.
        """
        return beats(coarse.errors, fine.errors, folds) or self.trials.likelier(
            coarse, fine, folds, -1
        )

    def _simpler(self, candidates: Sequence[Candidate], base: Trial) -> list[Candidate]:
        """Return the candidates that are simpler than one and not hopeless, the best first."""
        simpler = [c for c in candidates if c.rank < base.candidate.rank]
        ranked = self.trials.ranked(simpler, range(plans.FIRST))
        return [c for c in ranked if not self._hopeless(c, base, range(plans.FIRST))]

    def _hopeless(self, candidate: Candidate, best: Trial, folds: Sequence[int]) -> bool:
        return self.trials.of(candidate).mean(folds) > HOPELESS * best.mean(folds)

    def _gains(self, candidate: Candidate, base: Trial, folds: Sequence[int]) -> bool:
        trial = self.trials.of(candidate)
        return not trial.failed and beats(trial.errors, base.errors, folds)
