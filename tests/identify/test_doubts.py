"""Reasons for a bad model."""

import math
from dataclasses import replace

import pytest

from symo_exp.evaluation.verdict import verdict
from symo_exp.identify.answer import Answer
from symo_exp.identify.doubts import doubts, hopeless, missed
from tests.identify.test_plan import machine

SOUND = replace(machine(1), delay=0.0)


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [
        ({}, None),
        ({"moves": False, "explained": None}, "nothing moves"),
        ({"explained": None}, "too few samples"),
        ({"explained": 0.2}, "20 %"),
        ({"seconds": 3.0}, "3 s"),
        ({"delay": 0.03}, "30 ms"),
    ],
)
def test_each_doubt_has_a_line(changed, wanted):
    found = list(doubts(replace(SOUND, **changed)))
    assert len(found) == (wanted is not None)
    assert all(wanted in line for line in found)


@pytest.mark.parametrize(
    ("unseen", "error", "told"),
    [(1e-3, 9e-3, False), (1e-3, 0.02, True), (0.0, 0.02, False), (1e-3, math.inf, False)],
)
def test_a_fit_that_leaves_far_more_than_noise_is_doubted(unseen, error, told):
    found = list(missed(replace(SOUND, unseen=unseen), error, "rad"))
    assert len(found) == told
    assert all(f"{error:.2g} rad" in line for line in found)
    assert all("parameters may be off" in line for line in found)


@pytest.mark.parametrize(
    ("errors", "expected"),
    [([0.1, 0.5, 3.0], False), ([0.6, 0.7, 0.8], True), ([math.inf] * 3, True), ([], True)],
)
def test_a_model_without_hope_is_hardly_better_than_constant_velocity_anywhere(errors, expected):
    names = ("0.5s", "1s", "2s")
    measures = {f"rmse_{t}": x for t, x in zip(names, errors, strict=False)}
    measures |= {f"constant_velocity_rmse_{t}": 1.0 for t in names}
    assert hopeless(measures) is expected


@pytest.mark.parametrize(("error", "code"), [(0.1, 0), (0.6, 1), (3.0, 1), (math.inf, 1)])
def test_the_exit_code_says_whether_there_is_a_model(error, code, tmp_path, capsys):
    measures = {f"rmse_{t}": error for t in ("0.5s", "1s", "2s")}
    measures |= {f"constant_velocity_{name}": 1.0 for name in measures}
    measures |= {"windows": 4.0, "usable_s": 0.0, "window_s": 2.0}
    assert Answer(tmp_path, SOUND, 3).judge(measures, 1e-3, tmp_path) == code
    assert capsys.readouterr().out.startswith("verdict on the test part: no model") == bool(code)


@pytest.mark.parametrize(
    ("usable", "other", "horizon", "expected"),
    [
        (0.05, 0.1, 2.0, True),
        (0.15, 0.1, 2.0, True),
        (0.3, 0.1, 2.0, False),
        (0.08, 0.0, 2.0, True),
        (0.08, 0.0, 0.1, False),
    ],
)
def test_a_model_that_is_usable_for_a_short_time_is_one_of_an_unstable_machine(
    usable, other, horizon, expected
):
    measures = {f"rmse_{t}": 2.0 for t in ("0.5s", "1s", "2s")}
    measures |= {f"constant_velocity_{name}": 1.0 for name in measures}
    measures |= {"usable_s": usable, "constant_velocity_usable_s": other}
    assert hopeless(measures, horizon) is expected
    better = f"usable to {usable:g} s" if usable >= 2.0 * other else "no better"
    assert str(verdict(measures)).startswith(better)
