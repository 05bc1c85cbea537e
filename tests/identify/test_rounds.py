"""Decisions between candidates that held-out errors do not tell apart, by the noise of the fits."""

import pytest

from symo_exp.identify import plan as plans
from symo_exp.identify import rounds
from symo_exp.identify.candidates import ladder
from symo_exp.identify.rounds import Rounds
from symo_exp.runs.folder import SERIES, RunFolder
from symo_exp.runs.series import Series
from tests.identify.test_plan import machine


class ToldFits:
    """Fits that end with a told error and noise, each in a folder of its own."""

    def __init__(self, folder, told):
        self.folder, self.told = folder, told

    def to_folds(self, todo, attempt=0):
        found = []
        for candidate, k in todo:
            error, noise = self.told(candidate.settings)
            fit = RunFolder(self.folder / f"{candidate.name}-{k}-{attempt}")
            # folds differ in their errors, and so do candidates in which fold is the better one
            scatter = 1.0 + 0.1 * (-1) ** (k + len(candidate.name))
            Series(fit / SERIES).append(1, {"val_loss": error * scatter, "noise_estimate": noise})
            fit.record("finished")
            found.append((candidate, k, fit))
        return found


@pytest.fixture
def decided(tmp_path, monkeypatch):
    """Return what is chosen of rigid links by their told errors and noise."""
    monkeypatch.setattr(rounds, "baseline_error", lambda fit: 1e3)
    monkeypatch.setattr(rounds, "parameters_of", lambda fit: 10)

    def decide(told, *, raise_order=False, reduce_friction=False, combine=False, driven=True):
        one = machine(2, 60.0, driven=driven)
        candidates = ladder(one)
        plan = plans.make_plan(one, candidates, 600.0, 2, 1.0, "key")
        fits = ToldFits(tmp_path, told)
        search = Rounds(
            fits, one, plan, {}, in_time=lambda share, stage: True, progressed=lambda fit: None
        )  # fmt: skip
        search.screen(candidates if combine else candidates[:1])
        best = search.choice()
        if combine:
            search.combine(best)
            best = search.choice()
        if reduce_friction:
            best = search.reduce_friction(best)
        if raise_order:
            best = search.raise_order(best)
        return best.candidate.settings

    return decide


@pytest.mark.parametrize(
    ("error", "noise", "chosen"),
    [
        (1.0, 0.98, "galerkin4"),  # errors tie, and data are likelier
        (1.0, 1.0, "midpoint"),
        (1.0, 1.02, "midpoint"),
        (0.1, 1.0, "midpoint"),  # a variation, which the rounds try anyway
        (2.0, 0.98, "midpoint"),  # larger errors for certain
    ],
)
def test_order_4_is_chosen_where_data_are_likelier_and_errors_no_larger(
    error, noise, chosen, decided
):
    def told(settings):
        fine = settings["integrator"] == "galerkin4"
        return (error, 1e-3 * noise) if fine else (1.0, 1e-3)

    assert decided(told, raise_order=True)["integrator"] == chosen


@pytest.mark.parametrize(
    ("error", "noise", "chosen"),
    [
        (1.0, 1.0, "none"),  # neither errors nor data ask for friction
        (1.0, 1.02, "viscous"),  # data are less likely without
        (2.0, 1.02, "viscous"),
        (0.5, 1.02, "none"),  # errors are smaller for certain
    ],
)
def test_friction_is_left_out_unless_data_are_less_likely_without(error, noise, chosen, decided):
    def told(settings):
        return (error, 1e-3 * noise) if settings["dissipation"] == "none" else (1.0, 1e-3)

    assert decided(told, reduce_friction=True)["dissipation"] == chosen


@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("structure", ["network", "relative", "absolute"])
def test_the_friction_that_makes_a_network_the_best_is_given_to_simpler_structures(
    structure, driven, decided
):
    """A combination that no candidate of the first round has."""

    def told(settings):
        learned = 1.0 if settings["dissipation"] == "learned" else 2.0
        return learned * (1.0 if settings["lagrangian"] in (structure, "network") else 1.5), 1e-3

    chosen = decided(told, combine=True, driven=driven)
    assert (chosen["lagrangian"], chosen["dissipation"]) == (structure, "learned")
