"""A learned input matrix."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units
from symo_exp.nets.inputs import LearnedInputs
from symo_exp.nets.readings import readings
from tests.learned import assert_jacobian

MATRICES = [[[1.0, 0.0], [0.0, 1.0]], [[0.0], [-2.0]], [[0.0, 0.0], [0.0, 3.0]], [[1.0, 1.0]]]


def coordinates(n: int, units: Units = SI) -> Coordinates:
    names = tuple(map(str, range(n)))
    return Coordinates(names, tuple(i > 0 for i in range(n)), units=units)


def learned(given, units: Units = SI) -> tuple[torch.Tensor, LearnedInputs]:
    matrix = torch.tensor(given, dtype=torch.float64)
    return matrix, LearnedInputs(matrix, coordinates(len(matrix), units)).double()


@pytest.mark.parametrize("given", MATRICES)
def test_it_begins_at_the_given_matrix_and_keeps_its_largest_entry(given) -> None:
    matrix, found = learned(given)
    torch.testing.assert_close(found.matrix, matrix)
    with torch.no_grad():
        found.entries.copy_(torch.arange(1.0, len(found.entries) + 1))
    kept = found.matrix == matrix
    assert int(kept.sum()) == 1
    assert float(matrix[kept].abs()) == float(matrix.abs().max())
    u = torch.randn(4, matrix.shape[1], dtype=torch.float64)
    torch.testing.assert_close(found.force(u), u @ found.matrix.T)


@pytest.mark.parametrize("given", MATRICES)
def test_its_forces_have_derivatives_sample_by_sample(given) -> None:
    matrix, found = learned(given)
    u = torch.randn(4, matrix.shape[1], dtype=torch.float64)
    assert_jacobian(lambda: found.force(u), list(found.parameters()))


def test_entries_are_of_order_one_in_the_units_of_the_coordinates() -> None:
    """A motor moves a slide of micrometres, and turns a link by a thousandth of its force."""
    matrix, found = learned([[1.0], [0.0]], Units(length=1e-6))
    with torch.no_grad():
        found.entries.fill_(1.0)
    torch.testing.assert_close(found.matrix, matrix + torch.tensor([[0.0], [1e-6]]).double())


def test_it_is_read_as_forces_by_a_unit_of_an_input() -> None:
    _, found = learned([[1.0, 0.0], [0.0, 3.0]])
    with torch.no_grad():
        found.entries.fill_(2.0)
    rows = readings(found, coordinates(2))
    assert [row.name for row in rows] == ["0.input.0", "0.input.1", "1.input.0", "1.input.1"]
    assert [row.unit for row in rows] == ["N", "N", "N m", "N m"]
    torch.testing.assert_close(torch.stack([row.value for row in rows]), found.matrix.flatten())


@pytest.mark.parametrize(
    ("matrix", "place", "text"),
    [
        (torch.eye(1), coordinates(1), "has 1: a factor of all of them is one of the inertia"),
        (torch.zeros(2, 0), coordinates(2), "has 0"),
        (torch.eye(3), Coordinates.of(rotations=["R"]), r"lagrangian\.learned_inputs"),
    ],
)
def test_what_cannot_be_learned_is_refused(matrix, place, text) -> None:
    with pytest.raises(ConfigError, match=text):
        LearnedInputs(matrix, place)
