"""Plans of a budget."""

import itertools
from dataclasses import replace

import pytest

from symo_exp.errors import ConfigError
from symo_exp.identify import plan as plans
from symo_exp.identify import speed
from symo_exp.identify.candidates import (
    distinct_candidates,
    exclude,
    joined,
    left_open,
    structure_of,
    with_lagrangian,
)
from symo_exp.identify.effort import EFFORTS, EPSILONS, MEASURED, SPARSE, STEP
from symo_exp.identify.recordings import Machine
from symo_exp.identify.structures import ladder, structures
from symo_exp.identify.variations import variations, with_friction_of, with_less_friction
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI


def named(angular):
    return Coordinates(tuple(map(str, range(len(angular)))), tuple(angular))


def machine(n=2, seconds=60.0, recordings=7, driven=True, angular=True):
    return Machine(
        settings=(), coordinates=named((angular,) * n), driven=driven,
        time_step=0.02, finest_step=0.002, seconds=seconds, recordings=recordings,
        rest_velocity=0.1, units=SI, delay=-0.01 * driven, explained=0.97, moves=True,
        stiffness=None, notes=(),
    )  # fmt: skip


PIVOT = Coordinates.of(rotations=("R",))
FREE = Coordinates.of(("x", "y", "z"), (False,) * 3, ("R",), [(0, 0)])
TURNING = [
    replace(machine(driven=driven), coordinates=coordinates, **body)
    for coordinates, driven, body in (
        (PIVOT, False, {"body": True}),
        (PIVOT, True, {"body": True, "learned_inputs": 3}),
        (FREE, True, {"body": True, "radius": 0.1}),
        (FREE, True, {"body": True, "learned_inputs": 4}),
        (Coordinates.of(rotations=("R", "S")), False, {}),
    )
]
"""Machines that turn freely."""


@pytest.mark.parametrize("n", [1, 2, 3, 6])
@pytest.mark.parametrize("seconds", [3.0, 60.0, 3000.0])
@pytest.mark.parametrize("budget", [30.0, 600.0, 7200.0])
def test_a_plan_uses_more_of_a_larger_budget_and_never_more_than_there_is(n, seconds, budget):
    one = machine(n, seconds)
    candidates = ladder(one)
    small, large = (
        plans.make_plan(one, candidates, b, 2, 1.0, "key") for b in (budget, 10 * budget)
    )
    assert small.seconds <= large.seconds <= seconds
    assert small.effort.epochs <= large.effort.epochs
    assert small.effort.measured <= large.effort.measured
    assert small.effort.sparse >= large.effort.sparse
    assert set(small.names) <= set(large.names)
    assert 2 <= small.folds <= 6
    assert small.names


def test_the_planned_time_does_not_grow_with_data_beyond_the_budget():
    for seconds in (1e3, 1e4, 1e6):
        one = machine(2, seconds, 100)
        plan = plans.make_plan(one, ladder(one), 600.0, 2, 1.0, "key")
        chosen = [c for c in ladder(one) if c.name in plan.names]
        nodes = round(plan.seconds / one.time_step)
        assert plans.FIRST * sum(plan.expected(c, nodes, one) for c in chosen) < 1200.0


@pytest.mark.parametrize("cores", [1, 2, 4, 8])
@pytest.mark.parametrize("seconds", [60.0, 3e4])
def test_the_last_fit_has_a_fifth_of_the_budget(cores, seconds):
    one = machine(1, seconds)
    plan = plans.make_plan(one, ladder(one), 120.0, cores, 1.0, "key")
    for candidate in ladder(one):
        last = candidate.continued()
        nodes = round(plan.most_seconds(candidate, one) / one.time_step)
        more = plan.effort.training(last, nodes, one) - plan.effort.training(last, 0, one)
        assert nodes <= plans.FEWEST_NODES or more <= 1.01 * 24.0


def test_a_training_from_trained_parameters_is_shorter():
    one, effort = machine(2), EFFORTS[0]
    for candidate in ladder(one):
        last = candidate.continued()
        assert effort.total(last) == EPSILONS * effort.epochs < effort.total(candidate)
        assert effort.training(last, 1000, one) < effort.training(candidate, 1000, one)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("time_step", [0.02, 0.005, 0.001])
@pytest.mark.parametrize("budget", [20.0, 120.0, 600.0, 3600.0])
def test_a_plan_takes_more_than_its_budget_only_if_it_is_the_least(n, time_step, budget):
    one = replace(machine(n), time_step=time_step)
    plan = plans.make_plan(one, ladder(one), budget, 1, 1.0, "key")
    if plan.needed > budget:
        assert (len(plan.names), plan.folds) == (2, 3)
        assert plan.effort.sparse


@pytest.mark.parametrize("n", [1, 2, 3])
def test_plans_count_the_steps_that_validations_take(n):
    """Shorter time steps, more coordinates and more held-out data cost more, the former most."""
    one, effort = machine(n), EFFORTS[-1]
    base = ladder(one)[0]

    def validation(effort=effort, **changed):
        return effort.validation(base, replace(one, **changed))

    assert validation(time_step=0.002) == pytest.approx(10 * validation())
    assert validation(coordinates=named((True,) * (n + 1))) > validation()
    thrifty = [replace(effort, sparse=True, measured=x) for x in MEASURED]
    each = [validation(x, seconds=600.0) for x in (effort, *thrifty)]
    assert all(more > less for more, less in itertools.pairwise(each))
    for candidate in ladder(one):
        total = effort.total(candidate)
        assert total <= SPARSE * thrifty[0].between(candidate) < 2 * total


def test_plans_count_no_steps_beyond_the_end_of_short_recordings():
    """Ten recordings of a hundredth of a second, as of a machine that vibrates at some kHz."""
    one = replace(machine(1, seconds=0.1, recordings=10), time_step=1e-5, finest_step=1e-5)
    effort = EFFORTS[-1]
    each = effort.validation(ladder(one)[0], one) * effort.epochs / effort.total(ladder(one)[0])
    assert 1000 * STEP < each < 5000 * STEP


def test_a_plan_is_kept_with_the_search_and_forgotten_for_another(tmp_path):
    one = machine()
    plan = plans.make_plan(one, ladder(one), 600.0, 2, 1.0, "key")
    file = tmp_path / "search" / "plan.json"
    plans.keep_plan(file, plan)
    assert plans.kept_plan(file, "key") == plan
    assert plans.kept_plan(file, "other") is None
    file.write_text("{")
    assert plans.kept_plan(file, "key") is None


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90.0), ("10min", 600.0), ("1.5h", 5400.0), (30, 30.0)]
)
def test_durations_are_read_in_seconds(text, seconds):
    assert plans.seconds_of(text) == seconds


@pytest.mark.parametrize(
    "text", ["", "soon", "-1s", "0", "5 days", "1.2.3s", "nan", "1e300", "1e6h"]
)
def test_invalid_durations_are_refused(text):
    with pytest.raises(ConfigError, match=r"budget=.*expected a duration such as"):
        plans.seconds_of(text)


@pytest.mark.parametrize(
    "one",
    [*TURNING, *(machine(n, angular=angular) for n in (1, 2, 3) for angular in (True, False))],
)
def test_candidates_differ_and_variations_change_one_respect(one):
    candidates = ladder(one)
    assert [c.rank for c in candidates] == sorted(c.rank for c in candidates)
    every = [*candidates, *(v for c in candidates for v in variations(c, one))]
    by_name = {c.name: c for c in every}
    assert all(by_name[c.name] == c for c in every)
    assert len({tuple(sorted(c.settings.items())) for c in every}) == len(by_name)
    for candidate in candidates:
        for other in variations(candidate, one):
            keys = {*candidate.settings, *other.settings}
            differ = [k for k in keys if candidate.settings.get(k) != other.settings.get(k)]
            assert len({k.partition(".")[0] for k in differ}) == 1
            assert all(again.settings != other.settings for again in variations(other, one))


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize(
    "given",
    [
        {"springs": "none"},
        {"dissipation": "viscous"},
        {"dissipation": "none", "lagrangian": "network"},
        {"dissipation.joints": "own"},
        {"integrator": "midpoint", "system.time_step": "0.02"},
        {"optimizer.input_weight": "0"},
    ],
)
def test_given_settings_leave_no_two_candidates_equal(n, given):
    one = replace(machine(n), stiffness=((1.0,) * n,) * n)
    candidates = distinct_candidates(ladder(one), given)
    assert candidates[0] == ladder(one)[0]
    for base in candidates:
        tried = [*candidates, *distinct_candidates(variations(base, one), given, candidates)]
        settings = [left_open(c.settings, given) for c in tried]
        assert all(a != b for a, b in itertools.combinations(settings, 2))
        dropped = [c for c in (*ladder(one), *variations(base, one)) if c not in tried]
        assert dropped or given == {"dissipation.joints": "own"}
        assert all(left_open(c.settings, given) in settings for c in dropped)


@pytest.mark.parametrize("angular", [(True, True), (False, True, True), (True, False, True)])
def test_absolute_angles_have_friction_between_neighbours(angular):
    """On a cart as well: a hinge rubs with the difference of two angles."""
    one = replace(machine(), coordinates=named(angular))
    found = [c for c in ladder(one) if "absolute angles" in c.name and "viscous" not in c.name]
    assert {c.settings["lagrangian"] for c in found} == {"planar", "absolute"}
    assert all(c.settings["dissipation.joints"] == "neighbours" for c in found)


@pytest.mark.parametrize("driven", [True, False])
def test_the_friction_of_motors_is_varied_first_where_there_are_motors(driven):
    one = replace(machine(2), driven=driven)
    base = next(c for c in ladder(one) if c.settings["dissipation"] == "friction")
    kinds = [c.settings["dissipation"] for c in variations(base, one)]
    motors = [i for i, kind in enumerate(kinds) if kind == "machine"]
    learned = kinds.index("learned")
    assert (max(motors) < learned) if driven else (min(motors) > learned)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("driven", [True, False])
def test_less_friction_is_viscous_friction_alone_and_then_none(n, driven):
    """Whatever friction a candidate has; nothing else changes, and each is simpler."""
    one = machine(n, driven=driven)
    every = [*ladder(one), *(v for c in ladder(one) for v in variations(c, one))]
    for candidate in every:
        found = list(with_less_friction(candidate))
        choices = [c.settings["dissipation"] for c in found]
        assert choices == ["viscous", "none"][-len(found) :]
        ranks = [c.rank for c in (candidate, *found)]
        assert all(more > less for more, less in itertools.pairwise(ranks))
        for less in found:
            rest = {k: v for k, v in less.settings.items() if not k.startswith("dissipation")}
            assert rest.items() <= candidate.settings.items()
            assert less.name.endswith(("viscous friction", "no friction"))
            assert less.name.count("friction") == 1 + ("between" in less.name)
        same = [c for c in ladder(one) if c.settings == found[0].settings]
        assert all(c.rank == pytest.approx(found[0].rank) for c in same)


@pytest.mark.parametrize("driven", [True, False])
def test_the_friction_of_another_candidate_changes_nothing_else(driven):
    """With its own friction a candidate is the same; where friction acts is part of the rest."""
    one = machine(driven=driven)
    every = [*ladder(one), *(v for c in ladder(one) for v in variations(c, one))]
    for candidate, other in itertools.product(ladder(one), every):
        given = with_friction_of(candidate, other)
        assert structure_of(given) == structure_of(candidate)
        assert given.starts == candidate.starts
        for key in ("dissipation.joints", "dissipation.start"):
            assert given.settings.get(key) == candidate.settings.get(key)
        for key in other.settings.keys() - {"dissipation.joints", "dissipation.start"}:
            if key.startswith("dissipation"):
                assert given.settings[key] == other.settings[key]
        assert with_friction_of(given, candidate).settings == candidate.settings
        assert with_friction_of(given, candidate).rank == pytest.approx(candidate.rank)
        assert with_friction_of(given, candidate).cost == pytest.approx(candidate.cost)
    assert all(with_friction_of(candidate, candidate) == candidate for candidate in ladder(one))


def test_joined_variations_have_what_both_switch_on():
    one = machine()
    base = ladder(one)[0]
    by_name = {c.name.rpartition(", ")[2]: c for c in variations(base, one)}
    for first, second in itertools.permutations(by_name.values(), 2):
        if not exclude(base, first, second):
            both = joined(base, first, second)
            for each in (first, second):
                on = {k: v for k, v in each.settings.items() if base.settings.get(k) != v}
                assert all(both.settings[k] == v for k, v in on.items() if v != "false")
            assert both.rank > max(first.rank, second.rank)


@pytest.mark.parametrize("driven", [True, False])
def test_variations_exclude_each_other_if_they_choose_different_friction_or_integrators(driven):
    one = machine(driven=driven)
    for base in ladder(one):
        for first, second in itertools.permutations(variations(base, one), 2):
            three = [
                {c.settings[key] for c in (base, first, second)}
                for key in ("dissipation", "integrator")
            ]
            assert exclude(base, first, second) == any(len(chosen) == 3 for chosen in three)


@pytest.mark.parametrize("driven", [True, False])
def test_a_variation_is_given_to_a_simpler_candidate_with_all_that_it_changes(driven):
    one = machine(driven=driven)
    for simple, base in itertools.combinations(ladder(one), 2):
        for variation in variations(base, one):
            given = joined(base, simple, variation)
            changed = {k: v for k, v in variation.settings.items() if base.settings.get(k) != v}
            kept = {k: v for k, v in simple.settings.items() if k not in changed}
            for key, value in kept.items() | changed.items():
                assert given.settings[key] in (value, "true")
            assert given.name == f"{simple.name}, {variation.name.removeprefix(f'{base.name}, ')}"
            assert given.rank - simple.rank == pytest.approx(variation.rank - base.rank)


def test_a_variation_that_replaces_what_distinguishes_two_candidates_is_tried_once():
    base = ladder(machine(driven=True))[0]
    friction = {"dissipation": "viscous"}
    viscous = replace(base, name="viscous", settings={**base.settings, **friction})
    (learned,) = [
        one
        for one in variations(base, machine(driven=True))
        if one.settings["dissipation"] == "learned"
    ]
    assert distinct_candidates([joined(base, viscous, learned)], {}, [learned]) == []


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("driven", [True, False])
def test_every_structure_has_springs_where_they_explain_the_motion(n, driven):
    """And links in a plane are also tried without."""
    one = replace(machine(n, driven=driven), stiffness=((1.0,) * n,) * n)
    plain = {c.settings["lagrangian"] for c in ladder(one) if "springs" not in c.settings}
    sprung = {c.settings["lagrangian"] for c in ladder(one) if "springs.start" in c.settings}
    assert plain == {"planar"}
    assert sprung == {c.settings["lagrangian"] for c in ladder(machine(n, driven=driven))}


@pytest.mark.parametrize("driven", [True, False])
def test_driven_machines_have_a_candidate_with_the_friction_of_motors(driven):
    """Among the first, with a width that follows the speed of the machine."""
    one = replace(machine(1, angular=False, driven=driven), rest_velocity=0.004)
    found = [c for c in ladder(one) if c.settings["dissipation"] == "machine"]
    assert len(found) == driven
    for candidate in found:
        assert candidate in ladder(one)[:2]
        assert candidate.settings["dissipation.asymmetric"] == "true"
        assert candidate.settings["dissipation.constant"] == "true"
        assert candidate.settings["dissipation.stribeck"] == "false"
        assert float(candidate.settings["dissipation.least_rest_velocity"]) < 1e-4


def test_the_plan_leaves_out_the_costliest_candidate_first():
    one = machine(1, angular=False)
    candidates = ladder(one)
    for budget in (30.0, 100.0, 300.0, 1000.0):
        names = plans.make_plan(one, candidates, budget, 1, 1.0, "key").names
        assert names == tuple(c.name for c in candidates)[: len(names)]


def test_the_speed_is_measured_once_by_each_version(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for time, reference, expected in ((0.5, 1.0, 2.0), (1.0, 1.0, 2.0), (1.0, 3.0, 3.0)):
        monkeypatch.setattr(speed, "REFERENCE", reference)
        monkeypatch.setattr(speed, "exercise", lambda time=time: time)
        assert speed.machine_speed() == expected


def test_epochs_with_many_parameters_take_longer_with_six_coordinates():
    """The inertia of networks and general links has many, that of rigid links few."""
    for candidate in structures(machine(6)):
        one, many = (candidate.cost_of_epoch(n) for n in (1, 6))
        assert candidate.cost_of_epoch(3) == one == candidate.cost
        if candidate.name.startswith("general") or candidate.settings.get("net.width") == "8":
            assert many > 2.5 * one
        else:
            assert many < 2.0 * one


def test_variations_of_a_structure_keep_the_growth_of_its_cost():
    one = machine(6, driven=False)
    base, *_, network = ladder(one)
    assert network.growth > 0.0 == base.growth
    assert {c.growth for c in variations(network, one)} == {network.growth}
    for variation in variations(network, one):
        assert joined(network, base, variation).growth == base.growth


def test_trainings_with_inputs_take_longer_though_validations_of_one_coordinate_do_not():
    free, driven = (machine(1, driven=driven) for driven in (False, True))
    candidate, effort = ladder(free)[0], EFFORTS[-1]
    slow, fast = (effort.training(candidate, 1000, one) for one in (driven, free))
    assert slow > 1.2 * fast
    assert effort.validation(candidate, driven) == effort.validation(candidate, free)


def test_further_starts_are_planned_and_windows_are_no_longer_than_the_recordings():
    one, effort = machine(), EFFORTS[-1]
    candidate = ladder(one)[0]
    several = replace(candidate, starts=candidate.starts + 1)
    epochs = effort.total(several) / effort.total(candidate)
    assert effort.training(several, 100, one) > epochs * effort.training(candidate, 100, one)
    short, long = (replace(one, seconds=x, recordings=6) for x in (6.0, 18.0))
    assert effort.validation(candidate, short) < 0.8 * effort.validation(candidate, long)


@pytest.mark.parametrize(
    ("n", "first"), [(2, "rigid links, relative angles"), (3, None), (6, "space")]
)
@pytest.mark.parametrize("budget", [30.0, 600.0])
def test_an_arm_with_motors_is_tried_as_links_in_space_first(n, first, budget):
    one = machine(n)
    candidates = ladder(one)
    in_space = [c for c in candidates if "space" in c.name]
    assert bool(in_space) == (n > 2)
    assert all(c.forces > 0 and c.has_minima for c in in_space)
    if first is not None:
        assert first in candidates[0].name
    plan = plans.make_plan(one, candidates, budget, 2, 1.0, "key")
    assert candidates[0].name in plan.names


@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("slide", [False, True])
def test_an_arm_is_not_tried_as_general_links_and_large_networks(n, driven, slide):
    one = machine(n, driven=driven)
    one = replace(one, coordinates=named((*(True,) * (n - 1), not slide)))
    structures = {(c.settings["lagrangian"], c.settings.get("net.width")) for c in ladder(one)}
    few = {("rigid", None), ("planar", None), ("network", "2")}
    assert (structures == few) == (driven and n > 3 and not slide)


def test_candidates_with_a_given_lagrangian_are_those_that_have_it():
    candidates = ladder(machine(6))
    chosen = with_lagrangian(candidates, {"lagrangian": "lagrangian=rigid"})
    assert {c.settings["lagrangian"] for c in chosen} == {"rigid"}
    assert with_lagrangian(candidates, {}) == candidates
    assert with_lagrangian(candidates, {"lagrangian": "lagrangian=harmonic"}) == candidates
