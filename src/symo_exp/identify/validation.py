"""Errors of candidates over folds, and the choice among them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np
from omegaconf import DictConfig, OmegaConf

from symo_exp.evaluation.horizon import HORIZONS
from symo_exp.evaluation.recordings import held_out_error
from symo_exp.evaluation.references import ConstantVelocity
from symo_exp.identify.candidates import Candidate
from symo_exp.runs.folder import CONFIG, SERIES, RunFolder
from symo_exp.runs.instances import instance_of
from symo_exp.runs.load import divided_recordings, from_folder
from symo_exp.runs.series import read
from symo_exp.words import counted

NOISY = 4.0
"""Ratio of the noise of folds beyond which one ended at another minimum."""
GAIN = 0.005
"""Smallest relative decrease of the error that counts, however small its standard error: folds
share data, which the standard error does not count."""
CERTAIN = 2.0
"""Standard errors by which an earlier stage of a training has to be better than the last one."""
WORST, LEAST = 10.0, 1e-12
"""An error counts as at most so many times that of constant velocity, and at least as this."""


@dataclass
class Trial:
    """A candidate and the results of its folds.

    ``errors`` and ``folders`` are those of the folds that ended well, ``reasons`` say why the
    others did not; ``overran`` are those that were ended by the clock.
    """

    candidate: Candidate
    errors: dict[int, float] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0
    overran: set[int] = field(default_factory=set)
    parameters: int | None = None
    folders: dict[int, RunFolder] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """True if a fold failed."""
        return bool(self.reasons)

    def mean(self, folds: Iterable[int] | None = None) -> float:
        """Return the geometric mean of the errors; infinite where a fold has none."""
        chosen = list(self.errors) if folds is None else list(folds)
        if not chosen or any(k not in self.errors for k in chosen):
            return math.inf
        return math.exp(float(np.mean([math.log(self.errors[k]) for k in chosen])))

    def noises(self) -> dict[int, float]:
        """Return the estimated noise in the folds that ended well."""
        return {k: noise_of_fit(folder) for k, folder in self.folders.items()}

    def told(self) -> str:
        """Return the result in words."""
        if self.reasons:
            return f"failed: {next(iter(self.reasons.values()))}"
        ended = f", {len(self.overran)} ran out of time" if self.overran else ""
        folds = counted(len(self.errors), "fold")
        return f"error {self.mean():.3g} over {folds}, {self.seconds:.0f} s{ended}"


def noise_of_fit(fit: RunFolder) -> float:
    """Return the noise that a fit estimated at its end, infinite if it has none."""
    rows = read(fit / SERIES)
    return rows[-1].get("noise_estimate", math.inf) if rows else math.inf


def parameters_of(fit: RunFolder) -> int:
    """Return the number of parameters of a fitted model."""
    return sum(p.numel() for p in from_folder(fit.path).parameters())


def with_least_noise(fits: Sequence[RunFolder]) -> RunFolder:
    """Return the fit that explains its data best, a finished one if there is any."""
    return min(fits, key=lambda fit: (fit.outcome().status != "finished", noise_of_fit(fit)))


def noisy_folds(noises: Mapping[int, float]) -> list[int]:
    """Return the folds whose estimated noise exceeds ``NOISY`` times that of the quietest fold.

    Folds share most of their training data. On seven machines, the noise of folds that ended at the
    same minimum differs by a factor of two, because one recording has more of it than others.
    """
    least = min(noises.values(), default=math.inf)
    return [k for k, noise in noises.items() if noise > NOISY * least]


def ran_out_of_time(fit: RunFolder) -> bool:
    """Return whether a training ended before the last stage that trainings of its settings have."""
    optimizer = OmegaConf.load(fit / CONFIG).optimizer
    stages = len(optimizer.epsilons)
    return len(read(fit / SERIES)) < _begun(optimizer) + stages * optimizer.epochs


def _begun(optimizer: DictConfig) -> int:
    """Return the epochs of a training before its first epsilon."""
    return int(optimizer.force_epochs + optimizer.starts * optimizer.start)


def fold_error(folder: RunFolder) -> float:
    """Return the smallest error of a training on its held-out part.

    It is that of ``held_out_error``; infinite where the model diverges or no window moves, NaN
    without a validation.
    """
    losses = [row["val_loss"] for row in read(folder / SERIES) if "val_loss" in row]
    return min((x for x in losses if not math.isnan(x)), default=math.inf if losses else math.nan)


def baseline_error(folder: RunFolder) -> float:
    """Return the same error of constant velocity on the held-out part of a training."""
    config = OmegaConf.load(folder / CONFIG)
    system = instance_of(config.system)
    return held_out_error(
        ConstantVelocity(system.time_step, system.coordinates.space),
        divided_recordings(folder).val,
        units=system.coordinates.sizes,
        horizons=OmegaConf.select(config, "learner.validation.horizons", default=HORIZONS),
    )


def epochs_of_last_fit(folds: Sequence[RunFolder]) -> int:
    """Return the epochs from a trained fold to the last stage that no other one surpasses.

    Of the second round of stages, in which friction is learned as well, it has those up to the same
    epsilon once.
    """
    optimizer = OmegaConf.load(folds[0] / CONFIG).optimizer
    begun, each, epsilons = _begun(optimizer), optimizer.epochs, optimizer.epsilons
    losses = []
    for fold in folds:
        ends = [(row["epoch"] + 1 - begun, row["val_loss"]) for row in read(fold / SERIES)
                if "val_loss" in row]  # fmt: skip
        losses.append({math.ceil(end / each): loss for end, loss in ends if end > 0})
    stage = latest_stage(losses)
    again = sum(epsilon <= optimizer.late_from for epsilon in epsilons)
    return int(each * (stage if stage <= len(epsilons) else stage - again))


def latest_stage(losses: Sequence[Mapping[int, float]]) -> int:
    """Return the last stage of a training that the best one does not beat by two standard errors.

    Later stages trust the equations more. If these are right, parameters become more accurate,
    which errors of predictions from noisy starts hardly show.

    Args:
        losses: Those after the stages of each fold; stages that not all folds have do not count.
    """
    ended = [{s: x for s, x in one.items() if math.isfinite(x)} for one in losses]
    stages = sorted(set.intersection(*map(set, ended))) if ended else []
    found = {s: {k: max(one[s], LEAST) for k, one in enumerate(ended)} for s in stages}
    if not found:
        return 1
    best = min(found.values(), key=lambda errors: sum(map(math.log, errors.values())))
    return max(s for s in stages if not beats(best, found[s], range(len(ended)), CERTAIN))


def choose(trials: Sequence[Trial], folds: Sequence[int]) -> Trial | None:
    """Return the simplest of the trials that the best one does not beat for certain.

    One beats another if the mean over the folds of the difference of the logarithms of their
    errors exceeds one standard error of this mean, and ``GAIN``. Trials with a larger mean error
    than a simpler one do not compete: if they are not beaten for certain, their errors scatter.
    """
    complete = [t for t in trials if not t.failed and all(k in t.errors for k in folds)]
    complete.sort(key=lambda t: (t.candidate.rank, t.mean(folds)))
    least = accumulate((t.mean(folds) for t in complete), min)
    useful = [t for t, smallest in zip(complete, least, strict=True) if t.mean(folds) <= smallest]
    if not useful:
        return None
    best = useful[-1]
    return next(t for t in useful if not beats(best.errors, t.errors, folds))


def beats(
    one: Mapping[int, float],
    other: Mapping[int, float],
    folds: Sequence[int],
    certainty: float = 1.0,
) -> bool:
    """Return whether ``one`` is smaller by ``certainty`` standard errors, and by ``GAIN``."""
    mean, spread = compared(one, other, folds)
    return mean < -max(certainty * spread, GAIN)


def compared(
    one: Mapping[int, float], other: Mapping[int, float], folds: Sequence[int]
) -> tuple[float, float]:
    """Return the mean over folds of ``log(one / other)`` and its standard error."""
    differences = [math.log(one[k] / other[k]) for k in folds]
    if len(differences) < 2:
        return float(np.mean(differences)), 0.0
    deviation = float(np.std(differences, ddof=1))
    return float(np.mean(differences)), deviation / math.sqrt(len(differences))


def noise_ratio(
    one: Mapping[int, float], other: Mapping[int, float], folds: Sequence[int]
) -> float:
    """Return the mean over folds of ``log(one / other)``; NaN if a noise was not estimated."""
    if not all(math.isfinite(x[k]) for x in (one, other) for k in folds):
        return math.nan
    return compared(one, other, folds)[0]


def likelier(
    one: Mapping[int, float],
    other: Mapping[int, float],
    folds: Sequence[int],
    more: int,
    count: int,
) -> bool:
    """Return whether a model is likelier than another by the noise that is left of the data.

    This is the Bayesian information criterion, a mean over the folds: the logarithm of the
    likelihood of ``count`` residuals is ``-count log σ`` plus a constant. It is true where an
    optimiser estimates no noise.

    Args:
        one: Estimated noise ``σ`` in the folds.
        other: That of the other model.
        folds: The folds to compare.
        more: Number of parameters that the other model lacks.
        count: Number of residuals in a fold.
    """
    gain = noise_ratio(other, one, folds)
    return math.isnan(gain) or count * gain > 0.5 * more * math.log(count)
