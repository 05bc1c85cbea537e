"""Fits of candidates to recordings, each a run of the sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hydra.core.override_parser.overrides_parser import OverridesParser

from symo_exp.data.folds import POOLED
from symo_exp.errors import ConfigError
from symo_exp.identify.candidates import Candidate, left_open
from symo_exp.identify.plan import Plan
from symo_exp.identify.recordings import Machine
from symo_exp.identify.validation import NOISY, noise_of_fit
from symo_exp.runs.folder import RunFolder
from symo_exp.shell import override_value
from symo_exp.sweep.sweeper import Sweep

ITERATIONS = 5
"""Of the fit of starts in validations: more refine those of motions that stick alone."""
SEEDS = 1000
"""Difference of the seeds of fits of the same candidate to the same data."""
COMPARED = ("logger=none", "pictures=false", "measures=false")
"""Settings of fits that are compared, not shown."""


@dataclass(frozen=True)
class Fits:
    """The fits of a search. Attempts at the same fold differ in their seeds.

    Args:
        sweep: Performs the runs.
        machine: The recorded machine.
        plan: The plan of the search.
        given: Overrides of the command line by what they set; they replace those of candidates.
        experiment: The experiment of the runs.
        seed: That of the first attempts.
        clock: Whether the time that runs take counts, not plans alone: trainings are ended when
            they take much longer than planned, and there is less time for further ones.
    """

    sweep: Sweep
    machine: Machine
    plan: Plan
    given: Mapping[str, str]
    experiment: str
    seed: int
    clock: bool

    def check(self, candidates: Sequence[Candidate]) -> None:
        """Build candidates, at least one, until one can be fitted.

        Raises:
            ConfigError: That of the first candidate, if all are refused.
        """
        errors = []
        for candidate in candidates:
            error = self.sweep.refusal(self._overrides_of_fold(candidate, 0))
            if error is None:
                return
            errors.append(error)
        raise errors[0]

    def to_folds(
        self, todo: Sequence[tuple[Candidate, int]], attempt: int = 0
    ) -> list[tuple[Candidate, int, RunFolder | ConfigError]]:
        """Fit candidates to folds, side by side."""
        count = self.plan.folds
        words = [self._overrides_of_fold(candidate, k, attempt) for candidate, k in todo]
        names = [f"{candidate.name}, fold {k + 1} of {count}" for candidate, k in todo]
        found = self.sweep.perform(words, names)
        return [(c, k, folder) for (c, k), folder in zip(todo, found, strict=True)]

    def last(
        self, candidate: Candidate, epochs: int, folds: Sequence[RunFolder]
    ) -> dict[RunFolder, RunFolder]:
        """Return fits of the chosen candidate to all data, with the folds that they start from.

        These are the quietest folds, one for each core, or all if the fits from those end with far
        more noise than the quietest fold.

        Raises:
            ConfigError: If the candidate is refused.
        """
        quietest = sorted(folds, key=noise_of_fit)
        found = self.to_all(candidate, epochs, quietest[: self.plan.cores])
        if min(map(noise_of_fit, found)) > NOISY * noise_of_fit(quietest[0]):
            found |= self.to_all(candidate, epochs, quietest[self.plan.cores :])
        return found

    def to_all(
        self, candidate: Candidate, epochs: int, starts: Sequence[RunFolder]
    ) -> dict[RunFolder, RunFolder]:
        """Return fits to the training and the validation part, with the runs that they start from.

        Raises:
            ConfigError: If the candidate is refused.
        """
        words = [self._overrides_of_last(candidate, epochs, start, *COMPARED) for start in starts]
        names = [f"{candidate.name}, last fit"] * len(starts)
        return dict(zip(self._performed(words, names), starts, strict=True))

    def test(self, candidate: Candidate, epochs: int, start: RunFolder) -> None:
        """Measure a fit to all data on the test part, draw pictures of it and publish it.

        Raises:
            ConfigError: If the candidate is refused.
        """
        shown = "pictures=true", "measures=true"
        words = self._overrides_of_last(candidate, epochs, start, *shown)
        # resume=false is for the fits; this one has just been made
        self._performed([[*words, "resume=true"]], [candidate.name])

    def _performed(self, words: Sequence[list[str]], names: Sequence[str]) -> list[RunFolder]:
        folders = []
        for folder in self.sweep.perform(words, names):
            if isinstance(folder, ConfigError):
                raise folder
            folders.append(folder)
        return folders

    def _overrides_of_fold(self, candidate: Candidate, k: int, attempt: int = 0) -> list[str]:
        seconds = self.plan.seconds
        more = [f"data.fold=[{k},{self.plan.folds}]", f"data.seconds={seconds:g}", *COMPARED]
        forced = {"seed": f"seed={self.seed + SEEDS * attempt}"} if attempt else {}
        return self._overrides(candidate, seconds, more, forced)

    def _overrides_of_last(
        self, candidate: Candidate, epochs: int, start: RunFolder, *more: str
    ) -> list[str]:
        """Return the overrides of a fit to all data, or to as many as there is time for."""
        seconds = self.plan.most_seconds(candidate, self.machine)
        if seconds < self.machine.seconds:
            more = (*more, f"data.seconds={seconds:g}")
        settings = [
            f"data.fold={POOLED}",
            f"trainer.max_epochs={epochs}",
            f"trainer.validate_every={epochs}",  # once: nothing is held out
            "optimizer.tolerance=1e9",  # so that the last parameters are kept
            *more,
        ]
        trained = f"start_from={override_value(str(start))}"
        forced = by_key([trained, "optimizer.starts=0", "optimizer.force_epochs=0"])
        return self._overrides(candidate.continued(), seconds, settings, forced)

    def _overrides(
        self, candidate: Candidate, seconds: float, more: Sequence[str], forced: Mapping[str, str]
    ) -> list[str]:
        """Return the overrides of a fit to data of a length.

        Those of the command line replace others, and are replaced by ``forced`` ones.
        """
        settings = by_key(
            [
                *self.machine.settings,
                f"experiment={self.experiment}",
                "trainer.compile=false",  # it takes longer than most of these trainings
                f"learner.validation.iterations={ITERATIONS}",
                self._limit(candidate, seconds),
                *self.plan.overrides(candidate),
                *candidate.overrides(),
                *more,
            ]
        )
        if candidate.settings["dissipation"] == "none":
            settings = left_open(settings, ["dissipation"]) | {"dissipation": "dissipation=none"}
        found = {**left_open(settings, self.given), **self.given, **forced}
        return sorted(found.values(), key=lambda word: "." in word.partition("=")[0])

    def _limit(self, candidate: Candidate, seconds: float) -> str:
        """Return the setting of the time after which a training is ended."""
        if not self.clock:
            return "trainer.time_limit=null"
        nodes = round(seconds / self.machine.time_step)
        limit = self.plan.limit(candidate, nodes, self.machine)
        return f"trainer.time_limit={limit:.0f}"


def by_key(overrides: Sequence[str]) -> dict[str, str]:
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
