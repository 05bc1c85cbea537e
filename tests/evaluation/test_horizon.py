"""Errors over horizons of models whose motions are known."""

import dataclasses
import math
from dataclasses import dataclass

import pytest
import torch

from symo_exp.evaluation.horizon import (
    HORIZONS,
    Predictions,
    cut,
    noise,
    predict,
    predict_whole,
    tolerance,
    whole_error,
)
from symo_exp.evaluation.recordings import HeldOutErrors, held_out_error
from symo_exp.evaluation.references import ConstantVelocity
from symo_exp.mechanics.composed import ComposedMidpoint, RefinedMidpoint
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Trajectories, Trajectory
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.starts import closest_start, fitted_start
from symo_exp.models.true import TrueVariational
from symo_exp.systems.chain import ChainPendulum
from tests.tables import arguments_of

H = 0.02
BOTH = pytest.mark.parametrize("run_in", [True, False], ids=["fitted", "measured"])
EACH_N = pytest.mark.parametrize("n", [1, 2, 3])


@dataclass(frozen=True)
class Chain:
    """Pendulums of any number, coupled by springs, over steps that cost nothing."""

    gravity: float = 10.0
    time_step: float = H

    def rollout(self, q0, v0, u):
        q, v = [q0], [v0]
        for k in range(u.shape[1] - 1):
            spring = 3.0 * (q[-1].mean(1, keepdim=True) - q[-1])
            v.append(v[-1] + H * (u[:, k] + spring - self.gravity * q[-1].sin()))
            q.append(q[-1] + H * v[-1])
        return Trajectories(torch.stack(q, 1), torch.stack(v, 1), u)


def swings(n: int, *seconds: float) -> tuple[Chain, list[Trajectory]]:
    """``n`` pendulums under inputs, and its motions of so many seconds."""
    model, generator = Chain(), torch.Generator().manual_seed(n)
    nodes = [round(duration / H) + 1 for duration in seconds]
    q, v, phase = torch.randn(3, len(nodes), n, dtype=torch.float64, generator=generator)
    t = H * torch.arange(max(nodes), dtype=torch.float64)[:, None]
    u = torch.sin(3.0 * t + phase[:, None])
    path = model.rollout(q, v, u)
    return model, [
        Trajectory(*(x[i, :count] for x in (path.q, path.v, u))) for i, count in enumerate(nodes)
    ]


@EACH_N
@BOTH
def test_the_true_model_has_no_error(n, run_in):
    model, motions = swings(n, 3.0, 2.4)
    windows = cut(motions, H, run_in=run_in)
    found = predict(model, windows).measures()
    assert found.pop("valid_s") == HORIZONS[-1]
    assert max(found.values()) < 1e-6, found


@dataclass(frozen=True)
class Small:
    """A machine with coordinates in units of their own, such as micrometres."""

    model: Chain
    sizes: torch.Tensor
    time_step: float = H

    def rollout(self, q0, v0, u):
        path = self.model.rollout(q0 / self.sizes, v0 / self.sizes, u)
        return Trajectories(path.q * self.sizes, path.v * self.sizes, u)


@EACH_N
def test_a_small_machine_is_predicted_like_a_large_one(n):
    """From the same fitted starts, in the units of the coordinates."""
    model, motions = swings(n, 3.0, 5.0)
    sizes = torch.tensor([2.0**-30, 1.0, 2.0**10]).double()[:n]
    generator = torch.Generator().manual_seed(0)
    noise = [1e-3 * torch.randn(m.q.shape, generator=generator).double() for m in motions]
    large = [m._replace(q=m.q + e) for m, e in zip(motions, noise, strict=True)]
    small = [m._replace(q=m.q * sizes, v=m.v * sizes) for m in large]
    ones, found = torch.ones_like(sizes), []
    for one, given, unit in ((model, large, ones), (Small(model, sizes), small, sizes)):
        windows = cut(large, H, run_in=True)
        windows = predict(one, windows._replace(q=windows.q * unit), units=unit)
        whole = predict_whole(one, given, units=unit)
        score = held_out_error(one, given, units=unit)
        found.append((windows.q / unit, whole.q / unit, score))
    torch.testing.assert_close(found[1], found[0], rtol=1e-6, atol=1e-8, equal_nan=True)


def test_a_fit_begins_from_the_same_parabola_in_other_units():
    """Of two coordinates, the one with the larger unit does not decide."""
    model, motions = swings(2, *[1.0] * 40)
    q, _, u = (torch.stack(x) for x in zip(*motions, strict=True))
    sizes = torch.tensor([2.0**-30, 1.0]).double()
    small = Small(model, sizes)
    found = closest_start(small, q * sizes, u, sizes=tuple(sizes.tolist()))
    torch.testing.assert_close(found / sizes.repeat(2), closest_start(model, q, u))


@EACH_N
def test_a_fitted_start_finds_the_true_one_from_noisy_configurations(n):
    """Its error is that of least squares: near the noise in q, noise over the run-in in v."""
    model, motions = swings(n, *[0.2] * 40)
    q, v, u = (torch.stack(x) for x in zip(*motions, strict=True))
    generator = torch.Generator().manual_seed(0)
    noise = 1e-3 * torch.randn(q.shape, dtype=torch.float64, generator=generator)
    start = fitted_start(model, q + noise, u)
    assert (start.q - q[:, 0]).square().mean().sqrt() < 1e-3
    assert (start.v - v[:, 0]).square().mean().sqrt() < 1e-3 / 0.1
    exact = fitted_start(model, q, u)
    assert torch.allclose(exact.v, v[:, 0], atol=1e-6)


def test_the_fitted_start_reads_no_velocity():
    model, motions = swings(2, 3.0)
    wrong = [motion._replace(v=motion.v + 1.0) for motion in motions]
    fitted, measured = (
        predict(model, cut(wrong, H, run_in=run_in)).measures()["rmse_1s"]
        for run_in in (True, False)
    )
    assert fitted < 1e-6 < 1e-2 < measured


@dataclass(frozen=True)
class Off:
    """A model at rest at a distance from what it starts from; after ``seconds`` it is lost."""

    distance: float = 0.0
    seconds: float = math.inf
    time_step: float = H

    def rollout(self, q0, v0, u):
        q = q0[:, None].repeat(1, u.shape[1], 1) + self.distance
        q[:, round(min(self.seconds, 1e3) / H) + 1 :] = torch.nan
        return Trajectories(q, torch.zeros_like(q), u)


def steady(*seconds: float, n: int = 2) -> list[Trajectory]:
    """Motions at a speed of 0.5 in the first coordinate and of 0 in the others."""
    motions = []
    for duration in seconds:
        t = H * torch.arange(round(duration / H) + 1, dtype=torch.float64)[:, None]
        v = torch.zeros(len(t), n, dtype=torch.float64)
        v[:, 0] = 0.5
        motions.append(Trajectory(v * t, v, torch.zeros_like(t)))
    return motions


@BOTH
def test_constant_velocity_has_no_error_on_a_steady_motion(run_in):
    found = predict(ConstantVelocity(H), cut(steady(3.0), H, run_in=run_in)).measures()
    assert found.pop("valid_s") == HORIZONS[-1]
    assert max(found.values()) < 1e-9


@EACH_N
def test_errors_are_root_mean_squares_over_coordinates_and_time(n):
    """A model at rest is wrong by 0.5 t in one of n coordinates."""
    found = predict(Off(), cut(steady(3.0, n=n), H, run_in=False)).measures()
    for seconds in HORIZONS:
        steps = torch.arange(1, round(seconds / H) + 1)
        expected = ((0.5 * H * steps).square().mean() / n).sqrt().item()
        assert found[f"rmse_{seconds:g}s"] == pytest.approx(expected)
        assert found[f"pooled_rmse_{seconds:g}s"] == pytest.approx(expected)
    assert found["valid_s"] == pytest.approx(H * math.floor(0.1 * n**0.5 / (0.5 * H) + 1e-9))


def test_the_score_of_candidates_does_not_depend_on_the_unit_of_length():
    """The first coordinate in mm, the other in rad, over windows and whole recordings."""
    motions = steady(3.0, 5.0)
    units = torch.tensor([1e3, 1.0], dtype=torch.float64)
    longer = [Trajectory(one.q * units, one.v * units, one.u) for one in motions]
    still = held_out_error(Off(), motions)
    assert held_out_error(Off(), longer, units=units) == pytest.approx(still)
    assert held_out_error(Off(), longer) > 10.0 * still


@BOTH
def test_a_model_that_diverges_has_infinite_errors_from_then_on(run_in):
    lost = Off(seconds=1.2)
    found = predict(lost, cut(steady(3.0), H, run_in=run_in)).measures()
    assert not any(math.isnan(value) for value in found.values())
    assert found["rmse_2s"] == found["pooled_rmse_2s"] == math.inf
    assert found["rmse_0.5s"] < 1.0


def test_a_model_without_finite_rollouts_has_infinite_errors():
    found = predict(Off(math.nan), cut(steady(3.0), H, run_in=True)).measures()
    assert found.pop("valid_s") == 0.0
    assert set(found.values()) == {math.inf}


@pytest.mark.parametrize(
    ("seconds", "run_in", "expected"),
    [
        ((2.0,), False, [(0, 0)]),
        ((2.5,), False, [(0, 0), (0, 12), (0, 24)]),
        ((2.5,), True, [(0, 9), (0, 21)]),
        ((1.0, 2.5), True, [(0, 9), (1, 9), (1, 21)]),
        ((0.04,), True, []),
        ((0.3,), True, [(0, 3)]),
    ],
)
def test_windows_start_at_regular_nodes(seconds, run_in, expected):
    found = cut([m._replace(q=10 * m.q) for m in steady(*seconds)], H, run_in=run_in)
    there = [] if found is None else [(int(a), int(b)) for a, b in zip(*found[:2], strict=True)]
    assert there == expected


def test_windows_in_which_nothing_moves_are_left_out():
    (motion,) = steady(6.0)
    stopped = motion._replace(q=motion.q.clamp(max=1.0))  # from 2 s on
    found = cut([stopped], H, run_in=False)
    assert (found.first * H).max() <= 2.0 - 0.05 / 0.5 + 1e-9  # 5 % of the range
    assert cut([motion._replace(q=0.0 * motion.q)], H, run_in=False) is None


@BOTH
def test_short_trajectories_count_up_to_their_end(run_in):
    """Padding is neither an error nor valid time, and the others are as without it."""
    model, motions = swings(2, 1.0, 3.0)
    bent = Chain(gravity=12.0)
    together, alone = (
        predict(bent, cut(some, H, run_in=run_in)) for some in (motions, motions[1:])
    )
    assert torch.allclose(together.q[1:], alone.q)
    lead = 0.18 if run_in else 0.0
    assert predict(model, cut(motions, H, run_in=run_in)).valid_seconds()[0].item() == (
        pytest.approx(1.0 - lead)
    )
    assert together.rmse(2.0)[0] == together.rmse(1.0)[0]
    assert together.rmse(2.0).isfinite().all()


@BOTH
def test_predictions_do_not_depend_on_the_chunk_size(run_in, monkeypatch):
    windows = cut(steady(3.0), H, run_in=run_in)
    expected = predict(ConstantVelocity(H), windows).q
    monkeypatch.setattr("symo_exp.evaluation.horizon.CHUNK", 1)
    assert torch.equal(predict(ConstantVelocity(H), windows).q, expected)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_windows_of_a_slide_do_not_depend_on_its_unit(size):
    (motion,) = steady(6.0)
    moving = motion.q * torch.tensor([size, 0.0]).double()
    scaled = motion._replace(q=moving.clamp(max=size))
    found = cut([scaled], H, run_in=False)
    bound = min(0.2, 0.05 * size) / (0.5 * size)
    assert 2.0 - 0.25 - bound < (found.first * H).max() <= 2.0 - bound + 1e-9


def test_windows_of_noise_alone_are_left_out():
    generator = torch.Generator().manual_seed(0)
    (motion,) = steady(6.0)
    noise = 1e-4 * torch.randn(motion.q.shape, dtype=torch.float64, generator=generator)
    assert cut([motion._replace(q=noise)], H, run_in=False) is None
    found = cut([motion._replace(q=motion.q.clamp(max=1.0) + noise)], H, run_in=False)
    assert (found.first * H).max() < 2.0


@EACH_N
def test_whole_recordings_are_predicted_from_their_start(n):
    model, motions = swings(n, 5.0, 3.0)
    found = predict_whole(model, motions)
    assert found.q.shape[1] == len(motions[0].q)
    assert found.errors().nanmean() < 1e-12
    assert found.errors()[1].isfinite().sum() == len(motions[1].q) - 1
    still = predict_whole(Off(), steady(5.0, n=n)).errors()
    moved = 0.5 * H * torch.arange(1, len(still[0]) + 1)
    assert still[0].sqrt()[-1].item() == pytest.approx(moved[-1].item() / n**0.5, rel=0.05)
    lost = predict_whole(Off(seconds=1.0), motions)
    assert lost.errors().nanmean() == math.inf


@pytest.mark.parametrize("seconds", [0.3, 0.7])
def test_recordings_shorter_than_a_second_have_windows(seconds):
    model, motions = swings(1, *[seconds] * 3)
    windows = cut(motions, H, run_in=True)
    assert len(windows.q) == 3
    assert windows.lead * H <= max(0.25 * seconds, 2 * H) + 1e-9
    assert max(predict(model, windows).rmse(0.5)) < 1e-6


def test_a_coarse_step_has_errors_over_every_horizon():
    slow = [Trajectory(*(x[::50] for x in motion)) for motion in steady(60.0)]
    found = cut(slow, 1.0, run_in=False)
    assert all(math.isfinite(x) for x in predict(Off(time_step=1.0), found).measures().values())
    slower = [Trajectory(*(x[::250] for x in motion)) for motion in steady(60.0)]
    assert math.isfinite(whole_error(Off(time_step=5.0), slower))


def test_a_prediction_is_usable_while_its_error_is_within_a_tenth_of_the_motion():
    model, motions = swings(2, 3.0, 3.0)
    windows = cut(motions, H, run_in=True)
    limit = tolerance(windows, (True, True))
    assert ((limit > 0) & (limit <= 0.1)).all()
    small = windows._replace(q=0.01 * windows.q)
    torch.testing.assert_close(
        tolerance(small, (True, True)), 0.01 * tolerance(windows, (False,) * 2)
    )
    true = predict(model, windows)
    assert true.usable_seconds(limit).tolist() == pytest.approx([HORIZONS[-1]] * len(windows.q))
    near, far = (dataclasses.replace(true, q=true.q + share * limit) for share in (0.99, 1.01))
    assert (near.usable_seconds(limit) > 1.9).all()
    assert (far.usable_seconds(limit) == 0).all()


@pytest.mark.parametrize("size", [0.0, 1e-8, 1e-3])
def test_a_coordinate_that_stands_still_but_for_its_noise_ends_no_usable_prediction(size):
    motions = swings(1, 3.0, 3.0)[1]
    alone = tolerance(cut(motions, H, run_in=True), (True,), noise(motions))
    random = torch.Generator().manual_seed(0)
    beside = []
    for q, v, u in motions:
        still = 0.1 + size * torch.randn(q.shape, generator=random, dtype=q.dtype)
        beside.append(Trajectory(torch.cat((q, still), 1), torch.cat((v, 0 * v), 1), u))
    windows = cut(beside, H, run_in=True)
    limit = tolerance(windows, (True, True), noise(beside))
    torch.testing.assert_close(limit, alone.expand(2), rtol=1e-6, atol=0.0)
    q = windows.q[:, windows.lead :].clone()
    q[..., 1] = 0.1
    found = Predictions(H, windows, q, torch.zeros_like(q))
    assert found.usable_seconds(limit).tolist() == pytest.approx([HORIZONS[-1]] * len(q))


@EACH_N
def test_the_error_over_whole_recordings_counts_drift_and_is_bounded_by_the_motion(n):
    model, motions = swings(n, 5.0, 9.0, 3.0)
    assert whole_error(model, motions) < 1e-6
    assert whole_error(model, motions[2:]) is None
    (motion,) = steady(6.0, n=n)
    drift = predict_whole(Off(), [motion]).errors()
    spread = motion.q.std(0, correction=0).square().mean().sqrt()
    found = whole_error(Off(), [motion])
    nodes = len(motion.q)
    expected = (drift.sum() / nodes).sqrt().clamp(max=spread).item()
    assert found == pytest.approx(expected)
    lost = whole_error(Off(seconds=1.0), motions[:2])
    widths = [one.q.var(0, correction=0).mean() for one in motions[:2]]
    assert lost == pytest.approx(torch.stack(widths).mean().sqrt().item())


def test_held_out_errors_are_those_of_the_predictions_in_parts_of_steps():
    """A link that a motor moves against dry friction comes to rest within steps."""
    system = dataclasses.replace(ChainPendulum(1), coulomb=(2.0,), rest_velocity=0.005)

    def model(rule):
        root = Newton(tolerance=1e-12, max_iterations=50)
        given = arguments_of(system) | {"time_step": H}
        return TrueVariational(system.lagrangian, integrator=rule, root=root, **given).double()

    t = H * torch.arange(151, dtype=torch.float64)
    u = 3.0 * torch.sin(3.0 * t + torch.arange(4)[:, None])[..., None]
    q = torch.linspace(-0.5, 0.5, 4, dtype=torch.float64)[:, None]
    path = model(ComposedMidpoint(parts=32)).rollout(q, torch.zeros_like(q), u)
    motions = [Trajectory(*one) for one in zip(path.q, path.v, u, strict=True)]
    rules = VariationalMidpoint(), RefinedMidpoint(parts=4)
    coarse, fine = (HeldOutErrors()(model(rule), motions) for rule in rules)
    assert fine < 0.3 * coarse, (fine, coarse)
