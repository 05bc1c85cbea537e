"""The verdict on a model of recordings."""

import math

import pytest

from symo_exp.evaluation.verdict import comparison, verdict

GOOD = {
    "windows": 9.0, "usable_s": 2.0, "noise": 1e-3,
    "rmse_0.5s": 0.01, "rmse_1s": 0.02, "rmse_2s": 0.04,
    "constant_velocity_rmse_0.5s": 0.5, "constant_velocity_rmse_1s": 1.0,
    "constant_velocity_rmse_2s": 2.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "good"),
        ({"usable_s": 0.6}, "usable to 0.6 s"),
        ({"usable_s": 1.3, "window_s": 1.3}, "good over the 1.3 s"),
        ({"usable_s": 0.6, "window_s": 1.3}, "usable to 0.6 s"),
        ({"usable_s": 0.0}, "not usable"),
        ({"rmse_0.5s": 0.5, "rmse_1s": 1.0, "rmse_2s": 3.0}, "no better than constant velocity"),
        ({"rmse_0.5s": math.inf, "rmse_1s": math.inf, "rmse_2s": math.nan}, "no better"),
        ({"rmse_0.5s": math.inf}, "good"),
        ({"windows": 0.0}, "not judged"),
    ],
)
def test_a_verdict_follows_from_the_measures(changes, said):
    assert verdict(GOOD | changes).startswith(said)


def test_only_models_of_recordings_have_a_verdict():
    assert verdict({"test_mse": 1.0}) is None
    assert comparison({"test_mse": 1.0}, "rad") is None
    for part in ("to 1 s 0.02", "constant velocity 1", "noise 0.001"):
        assert part in comparison(GOOD, "rad")
    coarse = {name: 1e4 * x for name, x in GOOD.items()}  # in mm, and ten times as large
    assert comparison(coarse, "m") == "RMSE to 1 s 200 m (constant velocity 10000, noise 10)"
    assert comparison(GOOD | {"window_s": 0.12}, "rad").startswith("RMSE to 0.12 s 0.02")
    assert "noise 2.2e-5)" in comparison(GOOD | {"noise": 2.18e-5}, "rad")
