"""Errors of recordings widen intervals so that those of another recording are inside."""

import logging

import pytest
import torch

from symo_exp.evaluation import uncertainty
from symo_exp.evaluation.horizon import cut, predict
from symo_exp.evaluation.intervals import (
    LEVEL,
    Predicted,
    coverage,
    relative_error,
    widened,
)
from symo_exp.evaluation.references import ConstantVelocity
from symo_exp.mechanics.types import Trajectory
from symo_exp.models.uncertainty import Interval, ModelPosterior, quantile
from symo_exp.optim.posterior import Posterior
from tests.evaluation.test_horizon import H, steady
from tests.models.methods import make

NODES, N = 3, 2


def errors(recordings, windows, scatter, generator):
    """Normal errors whose size differs from recording to recording."""
    sizes = (scatter * torch.randn(recordings, generator=generator).double()).exp()
    drawn = torch.randn(recordings, windows, NODES, N, generator=generator).double()
    drawn = sizes.view(-1, 1, 1, 1) * drawn
    return drawn.flatten(0, 1), torch.arange(recordings).repeat_interleave(windows)


def found(error, recording, variance=0.0, sensitivity=1.0):
    like = torch.ones_like(error)
    return relative_error(error, variance * like, sensitivity * like, recording)


@pytest.mark.parametrize(
    "recordings", [3, 24, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 8))]
)
@pytest.mark.parametrize("scatter", [0.0, 0.5, 1.0])
def test_nine_tenths_of_another_recording_are_inside(recordings, scatter):
    """On average over draws; the few recordings that there are may be alike by chance."""
    generator = torch.Generator().manual_seed(recordings)
    shares = []
    for _ in range(200):
        kappa = found(*errors(recordings, 12, scatter, generator))
        other, _ = errors(1, 12, scatter, generator)
        shares.append((other.abs() <= quantile(LEVEL) * kappa).double().mean())
    assert 0.84 < torch.stack(shares).mean() < 0.97


def test_windows_of_one_recording_have_nine_tenths_inside():
    error, _ = errors(1, 40, 0.0, torch.Generator().manual_seed(0))
    kappa = found(error, torch.zeros(40))
    inside = (error.abs() <= quantile(LEVEL) * kappa * (1 + 1e-12)).double().mean(0)
    torch.testing.assert_close(inside, torch.full_like(inside, LEVEL))


def test_recordings_that_differ_widen():
    error, recording = errors(6, 20, 0.0, torch.Generator().manual_seed(0))
    sizes = torch.tensor([0.3, 1.0, 3.0, 0.3, 1.0, 3.0]).double()[recording].view(-1, 1, 1)
    assert (found(sizes * error, recording) > 2.0 * found(error, recording)).all()


def test_a_long_recording_counts_as_much_as_a_short_one():
    error, recording = errors(2, 10, 0.5, torch.Generator().manual_seed(0))
    rows = torch.cat((torch.arange(10).repeat(5), torch.arange(10, 20)))
    torch.testing.assert_close(found(error[rows], recording[rows]), found(error, recording))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_units(factor):
    error, recording = errors(3, 10, 0.5, torch.Generator().manual_seed(0))
    plain = found(error, recording, 0.1)
    torch.testing.assert_close(found(factor * error, recording, factor**2 * 0.1), factor * plain)
    torch.testing.assert_close(found(error, recording, 0.1, factor), plain / factor)


def test_errors_that_the_parameters_explain_widen_nothing():
    error, recording = errors(3, 40, 0.0, torch.Generator().manual_seed(0))
    assert (found(error, recording, 4.0) == 0.0).all()


def test_nodes_without_values_have_the_error_of_the_last_with_one():
    error, recording = errors(3, 10, 0.5, torch.Generator().manual_seed(0))
    short = error.clone()
    short[:, 1:] = torch.nan
    kappa = found(short, recording)
    assert ((kappa > 0.0) & kappa.isfinite()).all()
    torch.testing.assert_close(kappa[2], kappa[0])


def test_a_recording_in_which_every_rollout_diverged_is_left_out():
    error, recording = errors(3, 10, 0.5, torch.Generator().manual_seed(0))
    diverged = error.clone()
    diverged[recording == 2] = torch.nan
    rows = recording < 2
    torch.testing.assert_close(found(diverged, recording), found(error[rows], recording[rows]))


def test_coverage_is_the_share_of_measured_nodes_inside_and_width_the_median():
    found = predict(ConstantVelocity(H), cut(steady(1.6), H, run_in=False))
    half = torch.full_like(found.q, 0.3)
    half[:, 1:6] = -1.0
    measures = coverage(found, Interval(found.q_true - half, found.q_true + half))
    for seconds, measured in ((0.5, 0.5), (1, 1.0), (2, 1.6)):  # which ends after 1.6 s
        assert measures[f"coverage_90_{seconds}s"] == pytest.approx(1 - 5 * H / measured)
        assert measures[f"width_90_{seconds}s"] == pytest.approx(0.3)


@pytest.mark.parametrize("held_out", [0, 1])
def test_errors_of_models_that_were_not_trained_on_recordings_widen_intervals(held_out):
    """Each recording counts with the error of its own model, in whatever group it comes."""
    model, other = (make("symo", "midpoint", 1).for_evaluation() for _ in range(2))
    posterior = certain(model)
    swings = [swing(model, start) for start in (0.3, 0.5)]

    def kappa(*groups):
        return widened(model, posterior, [Predicted(*group) for group in groups]).relative_error

    with torch.no_grad():
        for p in other.parameters():
            p *= 1.5
    own, strange = swings[1 - held_out], swings[held_out]
    mixed = kappa((model, [own]), (other, [strange]))
    assert mixed[-1] > 2.0 * kappa((model, swings))[-1]
    torch.testing.assert_close(kappa((None, swings)), kappa((model, swings)))
    torch.testing.assert_close(mixed, kappa((other, [strange]), (model, [own])))


@pytest.mark.parametrize("widest", [0, 1, 2])
def test_the_log_tells_the_largest_error_beyond_the_posterior(widest, caplog, monkeypatch):
    model = make("symo", "midpoint", 1).double()
    kappa = 2.5 * (torch.arange(3) == widest).double().unsqueeze(1)
    given = ModelPosterior(certain(model), kappa)
    monkeypatch.setattr(uncertainty, "posterior", lambda *_, **__: given.parameters)
    monkeypatch.setattr(uncertainty, "widened", lambda *_: given)
    with caplog.at_level(logging.INFO):
        uncertainty.posterior_of(model, torch.zeros_like, {}, [], [])
    (line,) = caplog.messages
    time = f"{widest * model.time_step:.2g}"
    assert f"by at most 2.5 times the sensitivity to the start, after {time} s" in line


def certain(model):
    """A posterior with the parameters of a model alone."""
    mean = torch.cat([p.detach().flatten() for p in model.parameters()])
    none = torch.zeros(len(mean), 0, dtype=torch.float64)
    return Posterior(mean, none, none, 1e-3, 1e-4, 100)


def swing(model, start):
    """A motion of the model itself from rest, measured with an error."""
    q, v = torch.tensor([[start]]).double(), torch.zeros(1, 1).double()
    path = model.rollout(q, v, steps=round(3.0 / model.time_step))
    nodes = path.q.shape[1]
    error = 1e-3 * torch.sin(torch.arange(nodes).double()).unsqueeze(1)
    return Trajectory(path.q[0] + error, path.v[0], torch.zeros(nodes, 1, dtype=torch.float64))
