"""Windows are aligned; noise has the size asked for."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from symo_exp.data.noise import add_noise
from symo_exp.mechanics.types import Trajectories, Trajectory
from symo_exp.mechanics.windows import cut_windows


def labelled(count: int = 3, nodes: int = 7, n: int = 2, m: int = 1) -> Trajectories:
    """Every number says what it is: field, trajectory, node, component."""

    def field(kind: int, width: int) -> torch.Tensor:
        b, t, i = torch.meshgrid(*(torch.arange(k) for k in (count, nodes, width)), indexing="ij")
        return (1000 * kind + 100 * b + 10 * t + i).double()

    return Trajectories(field(1, n), field(2, n), field(3, m))


def stacked(trajectories: list[Trajectory]) -> Trajectories:
    return Trajectories(*map(torch.stack, zip(*trajectories, strict=True)))


def test_windows_hold_the_nodes_they_name() -> None:
    cut = cut_windows(labelled().each())
    assert all(len(field) == 3 * 5 for field in cut)
    row = 5 + 2  # second trajectory, third window
    for name, kind, node in [
        ("q_prev", 1, 2),
        ("q", 1, 3),
        ("q_next", 1, 4),
        ("v", 2, 3),
        ("v_next", 2, 4),
        ("u_prev", 3, 2),
        ("u", 3, 3),
        ("u_next", 3, 4),
    ]:
        assert getattr(cut, name)[row, 0] == 1000 * kind + 100 * 1 + 10 * node, name


def test_every_window_once_and_none_across_trajectories() -> None:
    cut = cut_windows(labelled().each())
    assert len(torch.unique(cut.q_prev[:, 0])) == 15
    assert ((cut.q_next - cut.q_prev) == 20).all()


def test_windows_of_ragged_trajectories_lose_no_tail() -> None:
    first, second, third = labelled().each()
    short = Trajectory(*(field[:3] for field in second))
    cut = cut_windows([first, short, third])
    rows = torch.cat([torch.arange(5), torch.tensor([5]), torch.arange(10, 15)])
    for field, whole in zip(cut, cut_windows(labelled().each()), strict=True):
        assert torch.equal(field, whole[rows])


def test_noise_has_the_variance_asked_for() -> None:
    """The sample variance of N normals is within 5 √(2/N) of 1."""
    zero = Trajectories(*(torch.zeros(128, 34, k, dtype=torch.float64) for k in (2, 2, 1)))
    noisy = stacked(add_noise(zero.each(), 5e-3, 0))
    for field in (noisy.q, noisy.v):
        for component in (field[..., 0], field[..., 1]):
            scaled = component.flatten() / 5e-3
            assert abs(scaled.var() - 1) < 5 * np.sqrt(2 / scaled.numel())
            assert abs(scaled.mean()) < 5 / np.sqrt(scaled.numel())
    columns = torch.cat([noisy.q, noisy.v], -1).flatten(0, 1).T
    off_diagonal = torch.corrcoef(columns) - torch.eye(4)
    assert off_diagonal.abs().max() < 5 / np.sqrt(columns.shape[1])
    nodes = noisy.q[:, 1:, 0] * noisy.q[:, :-1, 0] / 5e-3**2
    assert abs(nodes.mean()) < 5 / np.sqrt(nodes.numel())  # white in time
    assert (noisy.u == 0).all()


def test_inputs_have_noise_of_their_own() -> None:
    """It is neither that of the states nor does it change that."""
    zero = Trajectories(*(torch.zeros(128, 34, k, dtype=torch.float64) for k in (1, 1, 1)))
    without, noisy = (stacked(add_noise(zero.each(), 1.0, 0, std)) for std in (0.0, 0.3))
    assert torch.equal(without.q, noisy.q)
    assert torch.equal(without.v, noisy.v)
    u = noisy.u.flatten() / 0.3
    assert abs(u.var() - 1) < 5 * np.sqrt(2 / u.numel())
    columns = torch.stack([noisy.q.flatten(), noisy.v.flatten(), u])
    assert (torch.corrcoef(columns) - torch.eye(3)).abs().max() < 5 / np.sqrt(u.numel())


def test_noise_of_a_trajectory_does_not_depend_on_the_others_and_scales() -> None:
    clean = labelled(6)
    small, large = (stacked(add_noise(clean.each(), std, 3)) for std in (0.1, 1.0))
    few = stacked(add_noise(clean.each()[:2], 0.1, 3))
    torch.testing.assert_close(small.v[:2], few.v, rtol=0, atol=0)
    torch.testing.assert_close(10 * (small.q - clean.q), large.q - clean.q)


@pytest.mark.parametrize("seed", [1, (0, 1)])
def test_noise_is_decided_by_its_seed(seed: int | tuple[int, int]) -> None:
    clean = labelled()

    def noisy(std: float, seed: int | tuple[int, int]) -> torch.Tensor:
        return stacked(add_noise(clean.each(), std, seed)).q

    assert torch.equal(noisy(0.1, seed), noisy(0.1, seed))
    assert not torch.equal(noisy(0.1, seed), noisy(0.1, 0))
    assert torch.equal(noisy(0.0, seed), clean.q)
