"""Properties that all data sets share."""

import torch

from tests.data.small import ready


def test_estimated_velocities_see_the_noise_of_the_configurations_alone():
    given, found = (ready(noise_std=1e-2, velocities=kind) for kind in ("given", "estimated"))
    h = given.time_step
    for a, b in zip(given.trajectories("train"), found.trajectories("train"), strict=True):
        assert torch.equal(a.q, b.q)
        assert torch.equal(a.u, b.u)
        torch.testing.assert_close(b.v[1:-1], (b.q[2:] - b.q[:-2]) / (2 * h))
        assert not torch.allclose(a.v, b.v, atol=1e-2)
    for part in ("val", "test"):
        pairs = zip(given.trajectories(part), found.trajectories(part), strict=True)
        assert all(torch.equal(a.v, b.v) for a, b in pairs)
