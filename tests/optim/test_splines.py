"""Smoothing splines through measured trajectories."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.interpolate import make_smoothing_spline

from symo_exp.mechanics.types import Trajectory
from symo_exp.optim.splines import smoothed

NODES = 60
TIME = torch.arange(NODES).double()
TRUE = torch.stack((torch.sin(0.3 * TIME), torch.cos(0.2 * TIME)), dim=1)


def _smoothed(q: torch.Tensor) -> torch.Tensor:
    return smoothed([Trajectory(q, torch.zeros_like(q), q[:, :0])], velocities=False)


@pytest.mark.parametrize("noise", [1e-2, 0.03, 0.1])
def test_splines_are_those_of_scipy(noise: float) -> None:
    """The values are those of scipy's spline with the least error in cross-validation.

    Scipy searches for ``λ`` instead of its logarithm, up to the number of nodes, and does not
    resolve that of small noise.
    """
    q = TRUE + noise * torch.randn(NODES, 2, generator=torch.Generator().manual_seed(0)).double()
    found = _smoothed(q)
    for column, y in zip(found.T.numpy(), q.T.numpy(), strict=True):
        expected = make_smoothing_spline(TIME.numpy(), y)(TIME.numpy())
        assert np.abs(column - expected).max() < 1e-2 * noise


def test_noise_is_removed_and_motion_kept() -> None:
    """Noise becomes smaller; exact values and straight lines stay as they are."""
    noise = 0.1 * torch.randn(NODES, 2, generator=torch.Generator().manual_seed(1)).double()
    assert (_smoothed(TRUE + noise) - TRUE).std() < 0.6 * noise.std()
    assert torch.allclose(_smoothed(TRUE), TRUE, atol=1e-6)
    line = torch.stack((1.0 + 2.0 * TIME, 0.0 * TIME), dim=1)
    assert torch.allclose(_smoothed(line), line, atol=1e-9)
