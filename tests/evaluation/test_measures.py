"""The measures against small examples computed by hand."""

import math

import pytest
import torch

from symo_exp.evaluation import measures

NAN, INF = math.nan, math.inf


def test_the_error_of_a_sample_is_the_mean_square_over_coordinates():
    predicted = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    true = torch.tensor([[1.0, 0.0], [0.0, 3.0]])
    assert measures.mean_squared(predicted - true).tolist() == [2.0, 5.0]


def test_a_prediction_is_valid_until_its_error_first_exceeds_a_tenth():
    path = torch.tensor([[0.0, 0.09, 0.2, 0.0], [0.0, 0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 0.0]])
    assert measures.valid_steps(path.unsqueeze(-1)).tolist() == [2, 4, 0]


def test_mean_and_population_deviation():
    found = measures.mean_and_std("x", torch.tensor([1.0, 3.0]))
    assert found == {"x_mse": 2.0, "x_std": 1.0}
    assert measures.mean_and_std("x", torch.tensor([4.0])) == {"x_mse": 4.0, "x_std": 0.0}


@pytest.mark.parametrize("lost", [NAN, INF, -INF, 1e200])
def test_a_lost_prediction_has_an_infinite_error(lost: float):
    predicted = torch.tensor([[0.0], [lost]], dtype=torch.float64)
    assert measures.squared(predicted).mean().item() == INF
    found = measures.mean_and_std("x", torch.tensor([1.0, INF]))
    assert found["x_mse"] == INF
    assert math.isnan(found["x_std"])
