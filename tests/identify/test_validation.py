"""Scores of candidates and the choice among them."""

import math

import numpy as np
import pandas as pd
import pytest
import yaml

from symo_exp.identify.candidates import Candidate
from symo_exp.identify.validation import (
    Trial,
    baseline_error,
    beats,
    choose,
    compared,
    fold_error,
    latest_stage,
    likelier,
    noisy_folds,
    ran_out_of_time,
    with_least_noise,
)
from symo_exp.runs.folder import CONFIG, SERIES, RunFolder
from symo_exp.runs.series import Series


def trial(rank, errors, reasons=None):
    return Trial(Candidate(f"rank {rank}", rank, {}), dict(enumerate(errors)), reasons or {})


@pytest.mark.parametrize(
    ("simple", "complicated", "chosen"),
    [
        # held-out errors of six folds: they tie, though one fold alone prefers the second
        (
            [0.051, 0.032, 0.141, 0.084, 0.133, 0.039],
            [0.024, 0.025, 0.122, 0.091, 0.311, 0.063],
            1,
        ),
        ([0.02, 0.03, 0.04], [0.01, 0.015, 0.02], 2),  # twice as good in each
        ([0.01, 0.01, 0.01], [0.01, 0.01, 0.01], 1),
        ([0.01, 0.02, 0.03], [0.00998, 0.01996, 0.02994], 1),  # by 0.2 % in each
        ([0.01, 0.01, 0.01], [0.02, 0.03, 0.04], 1),
    ],
)
def test_ties_go_to_the_simpler(simple, complicated, chosen):
    trials = [trial(2, complicated), trial(1, simple)]
    best = choose(trials, range(len(simple)))
    assert best is not None
    assert best.candidate.rank == chosen


def test_scatter_does_not_make_a_candidate_a_tie_that_is_worse_than_a_simpler_one():
    steady, scattered, best = [0.011] * 4, [0.01, 0.01, 0.01, 0.09], [0.0105, 0.01, 0.01, 0.01]
    trials = [trial(1, steady), trial(2, scattered), trial(3, best)]
    chosen = choose(trials, range(4))
    assert chosen is not None
    assert chosen.candidate.rank == 3
    assert not beats(trials[2].errors, trials[1].errors, range(4))


def test_a_candidate_that_failed_or_has_not_all_folds_is_not_chosen():
    whole = trial(3, [1.0, 1.0])
    assert choose([trial(1, [0.1]), trial(2, [0.1, 0.1], {2: "boom"}), whole], range(2)) is whole
    assert choose([trial(1, [0.1])], range(2)) is None


def test_the_comparison_is_of_logarithms():
    one, other = {0: 1.0, 1: 4.0}, {0: 2.0, 1: 2.0}
    mean, spread = compared(one, other, [0, 1])
    assert mean == pytest.approx(0.0)
    assert spread == pytest.approx(math.log(2.0))
    assert not beats(one, other, [0, 1])
    assert beats({0: 1.0, 1: 1.1}, other, [0, 1])


@pytest.mark.parametrize(
    ("losses", "wanted"),
    [([3.0, 1.0, 2.0], 1.0), ([math.inf, 2.0], 2.0), ([math.inf], math.inf), ([], math.nan)],
)
def test_the_error_of_a_fold_is_the_smallest_of_its_validations(losses, wanted, tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.path.mkdir()
    series = Series(folder / SERIES)
    for epoch in range(2 * len(losses) + 1):
        validated = {"val_loss": losses[epoch // 2]} if epoch % 2 else {}
        series.append(epoch, {"train_loss": 1.0, **validated})
    series.flush()
    assert fold_error(folder) == pytest.approx(wanted, nan_ok=True)


@pytest.mark.parametrize(
    ("given", "epochs"), [({}, 190), ({"starts": 1}, 150), ({"epsilons": [1.0, 0.1]}, 150)]
)
def test_a_training_ran_out_of_time_before_the_end_of_its_own_stages(given, epochs, tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.path.mkdir()
    optimizer = {"starts": 2, "start": 40, "force_epochs": 30, "epochs": 20, "epsilons": [1.0] * 4}
    (folder / CONFIG).write_text(yaml.safe_dump({"optimizer": optimizer | given}))
    series = Series(folder / SERIES)
    for epoch in range(epochs):
        assert ran_out_of_time(folder)
        series.append(epoch, {"train_loss": 1.0})
        series.flush()
    assert not ran_out_of_time(folder)


@pytest.mark.parametrize("w", [0.0, 6.0])
def test_the_baseline_is_constant_velocity_on_the_held_out_part(w, tmp_path):
    """It is exact on a motion without acceleration, and off by the motion on an oscillation."""
    t = 0.02 * np.arange(300)
    q = np.sin(w * t) if w else t
    motions = [pd.DataFrame({"trajectory": k, "t": t, "q_theta": q}) for k in range(4)]
    pd.concat(motions).to_csv(tmp_path / "mine.csv", index=False)
    folder = RunFolder(tmp_path / "run")
    folder.path.mkdir()
    names = {"names": ["theta"], "angular": "all", "inputs": [], "input_matrix": None}
    system = {"_target_": "symo_exp.systems.recorded.Recorded", "time_step": 0.02, **names}
    data = {
        "_target_": "symo_exp.data.recorded.RecordedData",
        "path": str(tmp_path / "mine.csv"), "fold": [0, 3], "dtype": "float64",
    }  # fmt: skip
    (folder / CONFIG).write_text(yaml.safe_dump({"system": system, "data": data}))
    found = baseline_error(folder)
    assert (0.5 < found < 20.0) if w else found < 1e-9


def test_of_several_fits_the_finished_one_with_the_least_noise_is_kept(tmp_path):
    fits = []
    for k, (noise, status) in enumerate(
        [(0.05, "finished"), (0.01, "finished"), (0.001, "failed"), (None, "finished")]
    ):
        fits.append(RunFolder(tmp_path / str(k)))
        (tmp_path / str(k)).mkdir()
        series = Series(fits[k] / SERIES)
        series.append(0, {"noise_estimate": 1e-9})
        series.append(1, {"train_loss": 1.0} if noise is None else {"noise_estimate": noise})
        fits[k].record(status)
    assert with_least_noise(fits) == fits[1]
    assert with_least_noise(fits[2:]) == fits[3]


@pytest.mark.parametrize(
    ("noises", "expected"),
    [
        ([0.0053, 0.0083, 0.0080, 0.0073], []),  # one recording has more noise than others
        ([0.056, 0.0083, 0.0053], [0]),
        ([0.056, 0.049, 0.0053], [0, 1]),
        ([math.inf, 0.01], [0]),
        ([math.inf, math.inf], []),
        ([], []),
    ],
)
def test_folds_that_end_at_another_minimum_have_far_more_noise(noises, expected):
    assert noisy_folds(dict(enumerate(noises))) == expected


def test_parameters_that_explain_noise_alone_do_not_make_a_model_likelier():
    """Least squares with and without columns that the data do not contain, or do."""
    generator = np.random.default_rng(0)
    count, more = 500, 4
    columns = generator.normal(size=(count, more + 1))
    for share, expected in ((0.0, False), (0.5, True)):
        noises = ({}, {})
        for k in range(3):
            y = columns[:, 0] + share * columns[:, 1] + generator.normal(size=count)
            for place, used in enumerate((columns, columns[:, :1])):
                left = np.linalg.lstsq(used, y, rcond=None)[1]
                noises[place][k] = math.sqrt(float(left[0]) / (count - used.shape[1]))
        assert likelier(*noises, range(3), more, count) == expected


@pytest.mark.parametrize(
    ("losses", "stage"),
    [
        ([{1: 1.0, 2: 1.1, 3: 0.9}, {1: 1.0, 2: 0.9, 3: 1.1}], 3),  # they scatter
        ([{1: 1.0, 2: 1.0}, {1: 1.0, 2: 1.1}, {1: 1.0, 2: 1.1}], 2),  # by 1.3 and 2 standard errors
        ([{1: 1.0, 2: 1.1}, {1: 1.0, 2: 1.2}, {1: 1.0, 2: 1.1}], 1),
        ([{1: 1.0, 2: 0.9, 3: 1.8}, {1: 1.0, 2: 0.8, 3: 1.7}], 2),  # the last one is worse
        ([{1: 1.0, 2: 1.0, 3: 1.0}, {1: 1.0, 2: 1.0}], 2),  # one fold was ended
        ([{1: 1.0, 2: math.inf}, {1: 1.0, 2: 1.0}], 1),
        ([{}, {}], 1),
    ],
)
def test_the_last_stage_is_taken_that_is_not_certainly_worse(losses, stage):
    assert latest_stage(losses) == stage
