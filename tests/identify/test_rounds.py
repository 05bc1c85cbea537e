"""Decisions between candidates that held-out errors do not tell apart, by the noise of the fits."""

import re
from dataclasses import replace

import pytest

from symo_exp.identify import plan as plans
from symo_exp.identify import trials
from symo_exp.identify.fits import Fits
from symo_exp.identify.rounds import Rounds
from symo_exp.identify.structures import ladder
from symo_exp.runs.folder import SERIES, RunFolder
from symo_exp.runs.series import Series
from symo_exp.shell import override_value
from tests.identify.test_plan import machine


class ToldFits:
    """Fits that end with a told error and noise, each in a folder of its own.

    They take ``pace`` times the time of a plan; without it the clock does not count.
    """

    def __init__(self, folder, told, one, plan, pace=None):
        self.folder, self.told, self.done = folder, told, []
        self.machine, self.plan, self.given, self.clock = one, plan, {}, pace is not None
        nodes = round(plan.seconds / one.time_step)
        self.seconds = lambda candidate: (pace or 1.0) * plan.expected(candidate, nodes, one)

    def to_folds(self, todo, attempt=0):
        found = []
        for candidate, k in todo:
            self.done.append(candidate)
            error, noise = self.told(candidate.settings)
            fit = RunFolder(self.folder / f"{candidate.name}-{k}-{attempt}")
            # folds differ in their errors, and so do candidates in which fold is the better one
            scatter = 1.0 + 0.1 * (-1) ** (k + len(candidate.name))
            Series(fit / SERIES).append(1, {"val_loss": error * scatter, "noise_estimate": noise})
            fit.record("finished", seconds=self.seconds(candidate))
            found.append((candidate, k, fit))
        return found


@pytest.fixture
def prepared(tmp_path, monkeypatch):
    """Return the rounds of a search by told errors, its fits and its plan."""
    monkeypatch.setattr(trials, "baseline_error", lambda fit: 1e3)
    monkeypatch.setattr(trials, "parameters_of", lambda fit: 10)
    monkeypatch.setattr(trials, "ran_out_of_time", lambda fit: False)

    def prepare(told, one, budget=600.0, pace=None):
        plan = plans.make_plan(one, ladder(one), budget, 2, 1.0, "key")
        fits = ToldFits(tmp_path, told, one, plan, pace)
        return Rounds(fits, trials.Trials(fits, lambda *_: None)), fits, plan

    return prepare


@pytest.fixture
def decided(prepared):
    """Return what is chosen of rigid links by their told errors and noise."""

    def decide(
        told, *, raise_order=False, reduce_forces=False, combine=False, driven=True, finest=0.002
    ):
        one = replace(machine(2, 60.0, driven=driven), finest_step=finest)
        search, _, _ = prepared(told, one)
        search.screen(ladder(one) if combine else ladder(one)[:1])
        best = search.trials.best()
        if combine:
            search.combine(best)
            best = search.trials.best()
        if reduce_forces:
            best = search.reduce_forces(best)
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
    ("finest", "noise", "chosen"),
    [
        (0.02, 0.96, "galerkin6"),
        (0.02, 0.98, "galerkin4"),
        (0.002, 0.96, "galerkin4"),  # half the time step is a variation
    ],
)
def test_order_6_is_for_samples_a_time_step_apart(finest, noise, chosen, decided):
    noises = {"midpoint": 1e-3, "galerkin4": 0.98e-3, "galerkin6": 1e-3 * noise}
    settings = decided(lambda x: (1.0, noises[x["integrator"]]), raise_order=True, finest=finest)
    assert settings["integrator"] == chosen


@pytest.mark.parametrize(
    ("error", "noise", "chosen"),
    [
        (1.0, 1.0, "none"),  # neither errors nor data ask for friction
        (1.0, 1.02, "viscous"),  # data are less likely without
        (2.0, 1.02, "viscous"),
        (0.5, 1.02, "none"),  # errors are smaller for certain
        (1.0, 0.98, "none"),
        (2.0, 0.98, "viscous"),  # its training, with more noise, has not reached a minimum
    ],
)
def test_friction_is_left_out_unless_data_are_less_likely_without(error, noise, chosen, decided):
    def told(settings):
        return (error, 1e-3 * noise) if settings["dissipation"] == "none" else (1.0, 1e-3)

    assert decided(told, reduce_forces=True)["dissipation"] == chosen


@pytest.mark.parametrize(("noise", "chosen"), [(0.98, True), (1.0, False)])
def test_springs_are_left_out_unless_data_are_less_likely_without(noise, chosen, prepared):
    def told(settings):
        return (0.5, 1e-3 * noise) if "springs" in settings else (1.0, 1e-3)

    one = machine(2, 60.0)
    search, _, _ = prepared(told, one, budget=1e5)
    search.screen(ladder(one)[:1])
    search.vary(search.trials.best())
    best = search.trials.best()
    assert "springs" in best.candidate.settings
    assert ("springs" in search.reduce_forces(best).candidate.settings) == chosen


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


@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("fine", ["galerkin4", "half"])
@pytest.mark.parametrize("worse", [1.0, 2.0])
def test_simpler_structures_have_what_makes_another_one_the_best(worse, fine, driven, prepared):
    """They are chosen if their errors are no larger for certain.

    Links in a plane have the larger errors in the midpoint rule with the initial step.
    """

    def told(settings):
        halved, order = "system.time_step" in settings, settings["integrator"]
        refined = halved if fine == "half" else order == fine
        planar = settings["lagrangian"] == "planar"
        error = 1.0 if refined else (3.0 if planar else 2.0)
        return (worse * error if planar else error), 1e-3

    one = machine(2, 60.0, driven=driven)
    search, _, _ = prepared(told, one, budget=1e5)
    search.screen(ladder(one))
    chosen = search.refine().candidate
    assert (chosen.settings["lagrangian"] == "planar") == (worse == 1.0)
    assert told(chosen.settings)[0] == 1.0


@pytest.mark.parametrize("friction", ["friction", "viscous"])
@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_models_with_dry_friction_predict_in_parts_of_steps_where_that_is_better(
    gain, friction, prepared
):
    def told(settings):
        right = settings["dissipation"] == friction and settings["lagrangian"] == "planar"
        refined = settings["integrator"] == "refined_midpoint"
        error, noise = (1.0, 1e-3) if right else (3.0, 2e-3)
        return error * (gain if refined else 1.0), noise

    one = machine(2, 60.0, driven=False)
    search, fits, _ = prepared(told, one, budget=1e5)
    search.screen(ladder(one))
    chosen = search.refine().candidate.settings
    assert chosen["dissipation"] == friction
    dry = friction == "friction"
    assert (chosen["integrator"] == "refined_midpoint") == (dry and gain < 1.0)
    assert any(c.settings["integrator"] == "refined_midpoint" for c in fits.done) == dry


def test_a_model_that_needs_no_springs_is_simplified_further_without_them(prepared):
    """With springs, or with dry friction, the simpler structure has larger errors."""

    def told(settings):
        if settings["dissipation"] == "none":
            return 3.0, 2e-3
        plain = settings["dissipation"] == "viscous" and "springs" not in settings
        return (1.0 if plain or settings["lagrangian"] == "relative" else 3.0), 1e-3

    one = replace(machine(2, 60.0), stiffness=((1.0, 0.0), (0.0, 1.0)))
    search, _, _ = prepared(told, one, budget=1e5)
    search.screen(ladder(one))
    best = search.trials.best()
    assert best.candidate.settings["lagrangian"] == "relative"
    assert "springs" in best.candidate.settings
    chosen = search.reduce_structure(search.reduce_forces(best)).candidate
    assert chosen.settings["lagrangian"] == "planar"
    assert "springs" not in chosen.settings
    assert chosen.name == "rigid links, relative angles, viscous friction"


@pytest.fixture
def searched(prepared):
    """Return the plan of a search by told errors, and its fits in the first rounds and in all.

    A candidate is listed once for each fit.
    """

    def search(told, one, budget, pace=None):
        tried, fits, plan = prepared(told, one, budget, pace)
        tried.screen([c for c in ladder(one) if c.name in plan.names])
        screened = list(fits.done)
        tried.refine()
        return plan, screened, fits

    return search


@pytest.mark.parametrize("least", [0.02, 0.01, 0.005, 0.0025])
def test_steps_are_halved_as_long_as_the_error_decreases(least, prepared):
    one = machine(1, 60.0)

    def told(settings):
        return max(float(settings.get("system.time_step", one.time_step)), least), 1e-3

    search, _, _ = prepared(told, one, budget=1e5)
    search.screen(ladder(one)[:1])
    settings = search.refine().candidate.settings
    assert float(settings.get("system.time_step", one.time_step)) == least
    names = [t.candidate.name for t in search.trials.by_simplicity()]
    assert len(set(names)) == len(names)
    assert any("1/4 of the time step" in name for name in names) == (least < 0.02)


@pytest.mark.parametrize(("error", "chosen"), [(100.0, "relative"), (10.0, "planar")])
def test_candidates_that_a_plan_left_out_are_tried_if_the_others_are_poor(
    error, chosen, prepared, capsys
):
    """That is, if they have more than a fiftieth of the error of constant velocity, here 20."""

    def told(settings):
        return (1.0 if settings["lagrangian"] == "relative" else error), 1e-3

    one = machine(2, 60.0)
    search, _, plan = prepared(told, one, budget=60.0)
    planned, others = ([c for c in ladder(one) if (c.name in plan.names) == x] for x in (1, 0))
    search.screen(planned)
    search.deepen(others)
    assert search.trials.best().candidate.settings["lagrangian"] == chosen
    said = capsys.readouterr().out
    assert ("further candidates, since none so far suits" in said) == (chosen == "relative")


@pytest.mark.parametrize("enough", ["half the step", "order 4", "both"])
@pytest.mark.parametrize("driven", [True, False])
def test_finer_integrations_precede_candidates_that_a_plan_left_out(
    driven, enough, prepared, capsys
):
    """Networks also represent errors of the integrator, and would be chosen for that."""

    def told(settings):
        fine = "system.time_step" in settings, settings["integrator"] == "galerkin4"
        done = {"half the step": fine[0], "order 4": fine[1], "both": all(fine)}[enough]
        rigid = 50.0 if any(fine) else 100.0
        return (5.0 if done else rigid if settings["lagrangian"] == "planar" else 10.0), 1e-3

    one = machine(2, 60.0, driven=driven)
    search, _, plan = prepared(told, one, budget=100.0)
    planned, others = ([c for c in ladder(one) if (c.name in plan.names) == x] for x in (1, 0))
    search.screen(planned)
    search.deepen(others)
    assert search.trials.best().candidate.settings["lagrangian"] == "planar"
    assert "further candidates" not in capsys.readouterr().out


@pytest.mark.parametrize("pace", [None, 0.5, 2.0])
@pytest.mark.parametrize("budget", [60.0, 1e5])
@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_no_search_takes_more_than_its_time(gain, driven, budget, pace, searched, capsys):
    """Whether costly candidates are better or worse, and runs faster or slower than planned.

    The last fits are not included. The first rounds do not depend on how long runs take, and
    further stages have the time that is reserved in any case.
    """
    one = machine(3, 60.0, driven=driven)

    def told(settings):
        costly = (settings["lagrangian"], settings["integrator"], settings["dissipation"])
        return gain ** sum(x in ("network", "galerkin4", "learned") for x in costly), 1e-3

    plan, screened, fits = searched(told, one, budget, pace)
    before, after = (sum(map(fits.seconds, done)) for done in (screened, fits.done))
    reserved = before + (pace or 1.0) * plan.reserved
    assert after <= max(reserved, plan.cores * max(plan.budget, plan.needed))
    assert budget < 1e5 or not re.search("^left out for|^not yet", capsys.readouterr().out, re.M)


@pytest.mark.parametrize("best", [0, 1])
@pytest.mark.parametrize("pace", [None, 8.0])
@pytest.mark.parametrize("driven", [True, False])
def test_finer_steps_are_tried_with_the_smallest_budget(driven, pace, best, searched):
    """If one of the two simplest candidates is the best one, however slow runs are."""
    one = machine(3, driven=driven)
    simplest = ladder(one)[best].settings

    def told(settings):
        return (1.0 if settings == simplest else 2.0), 1e-3

    _, screened, fits = searched(told, one, 1.0, pace)
    tried = [c.settings for c in fits.done[len(screened) :]]
    assert any("system.time_step" in x or x["integrator"] == "galerkin4" for x in tried)


def test_what_there_is_no_time_for_is_printed(searched, capsys):
    def told(settings):
        return 0.5 ** sum(x in ("galerkin4", "learned") for x in settings.values()), 1e-3

    _, _, fits = searched(told, machine(3), 1.0)
    missed = set()
    out = capsys.readouterr().out
    for line in out.splitlines():
        if line.startswith("left out for lack of time"):
            base, _, names = line.removeprefix("left out for lack of time").partition(": ")
            base = f"{base.removeprefix(', variations of ')}, " if base else ""
            missed |= {base + name for name in names.split("; ")}
    assert missed
    assert not missed & {c.name for c in fits.done}
    assert "no time left" not in out  # cheaper candidates are tried


class ToldFolds:
    """Performs fits that end with a told noise."""

    def __init__(self, folder, noise=1e-3):
        self.folder, self.noise, self.words = folder, noise, []

    def fit(self, name, noise):
        folder = RunFolder(self.folder / name)
        Series(folder / SERIES).append(1, {"noise_estimate": noise})
        return folder

    def perform(self, words, names):
        self.words += words
        return [self.fit(f"fit {k}", self.noise) for k in range(len(words))]


def test_a_fit_that_is_tested_is_not_trained_anew(tmp_path):
    """Also where all fits are, by resume=false."""
    one, sweep = machine(2, 60.0), ToldFolds(tmp_path)
    plan = plans.make_plan(one, ladder(one), 600.0, 2, 1.0, "key")
    fits = Fits(sweep, one, plan, {"resume": "resume=false"}, "mine", seed=0, clock=False)
    candidate, epochs, start = ladder(one)[0], 9, sweep.fit("fold", 1e-3)
    fits.to_all(candidate, epochs, [start])
    fits.test(candidate, epochs, start)
    fitted, tested = sweep.words
    assert "resume=true" not in fitted
    assert tested[-1] == "resume=true"


@pytest.mark.parametrize("cores", [1, 2, 16])
@pytest.mark.parametrize(("noise", "everywhere"), [(3e-3, False), (5e-3, True)])
def test_last_fits_start_from_the_quietest_folds(noise, everywhere, cores, tmp_path):
    """From each fold where they end with far more noise than the quietest one."""
    one, sweep = machine(2, 60.0), ToldFolds(tmp_path, noise)
    plan = plans.make_plan(one, ladder(one), 600.0, cores, 1.0, "key")
    folds = [sweep.fit(f"fold {k}", x) for k, x in enumerate((2e-3, 9e-3, 1e-3, 4e-3))]
    fits = Fits(sweep, one, plan, {"optimizer.starts": "optimizer.starts=6"}, "mine", 0, False)
    starts = list(fits.last(ladder(one)[0], 9, folds).values())
    quietest = [folds[k] for k in (2, 0, 3, 1)]
    assert starts == (quietest if everywhere else quietest[:cores])
    assert f"start_from={override_value(str(starts[-1]))}" in sweep.words[-1]
    assert "optimizer.starts=0" in sweep.words[-1]
