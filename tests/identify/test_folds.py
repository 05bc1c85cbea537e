"""Folds of a cross-validation over recordings."""

import numpy as np
import pytest

from symo_exp.data.folds import at_rest, deal, folded, thinned
from symo_exp.data.resample import Samples
from symo_exp.data.table import Recording
from symo_exp.errors import ConfigError


def recording(label, seconds, part=""):
    t = np.arange(0.0, seconds, 0.01)
    samples = Samples(t, t[:, None], None, np.zeros((len(t), 0)))
    return Recording(label, part, samples, samples)


def parts(train, val, test=(1.0,)):
    durations = {"train": train, "val": val, "test": test}
    return {
        part: [recording(f"{part}{i}", s, part) for i, s in enumerate(each)]
        for part, each in durations.items()
    }


def paused(one, pause):
    """The recording, with a pause after its first half."""
    t = one.samples.t
    samples = one.samples._replace(t=t + pause * (t > t[-1] / 2))
    return one._replace(samples=samples, whole=samples)


def labelled(one):
    return one.label


def assert_same_samples(found, expected):
    for one, other in zip(found, expected, strict=True):
        assert len(one.samples.t) == pytest.approx(len(other.samples.t), abs=3)
        np.testing.assert_allclose(one.samples.q[0], other.samples.q[0], atol=0.03)


@pytest.mark.parametrize(
    ("train", "val"), [((5, 6, 7, 5), (4, 9)), ((20,), (10,)), ((3,) * 20, (3,)), ((40, 2), (2,))]
)
@pytest.mark.parametrize("count", [2, 3, 6])
def test_folds_are_a_partition_that_leaves_the_test_part_out(train, val, count):
    everything = parts(train, val)
    held_out, tested = [], {r.label for r in everything["test"]}
    for k in range(count):
        one = folded(everything, [k, count])
        assert one["val"] == one["test"] != []
        assert not {r.label for r in one["train"]} & {r.label for r in one["val"]}
        assert not {r.label for r in one["train"] + one["val"]} & tested
        held_out += [(r.label, r.samples.t[0]) for r in one["val"]]
    assert len(held_out) == len(set(held_out))
    total = sum(train) + sum(val)
    kept = sum(
        np.ptp(r.samples.t) for k in range(count) for r in folded(everything, [k, count])["val"]
    )
    assert kept == pytest.approx(total, rel=0.15)


def test_recordings_stay_whole_where_there_are_enough():
    everything = parts((5, 6, 7), (4,))
    labels = {r.label for k in range(4) for r in folded(everything, [k, 4])["val"]}
    assert labels == {"train0", "train1", "train2", "val0"}


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("count", [2, 3, 6])
def test_recordings_at_rest_are_for_training_in_every_fold(noise, count):
    everything = parts((5, 60, 7, 5), (4,))
    for part, i in (("train", 0), ("val", 0)):
        one = everything[part][i]
        q = noise * np.random.default_rng(i).normal(size=one.samples.q.shape)
        everything[part][i] = one._replace(samples=one.samples._replace(q=3.0 + q))
    assert at_rest(everything["train"] + everything["val"]) == [True, False, False, False, True]
    held_out = set()
    for k in range(count):
        one = folded(everything, [k, count])
        assert {"train0", "val0"} < {r.label for r in one["train"]}
        held_out |= {r.label.partition("/")[0] for r in one["val"]}
    assert held_out == {"train1", "train2", "train3"}


@pytest.mark.parametrize("pause", [0.7, 25.0, 1e4])
@pytest.mark.parametrize("count", [2, 3, 6])
def test_folds_have_the_samples_that_they_have_without_a_pause(pause, count):
    everything = parts((20, 3), (10,))
    later = {part: [paused(one, pause) for one in each] for part, each in everything.items()}
    found, expected = (
        sorted((one for k in range(count) for one in folded(each, [k, count])["val"]), key=labelled)
        for each in (later, everything)
    )
    assert_same_samples(found, expected)


def test_folds_without_samples_are_refused():
    with pytest.raises(ConfigError, match="too few samples for 40 folds"):
        folded(parts((0.1,), (0.1,)), [0, 40])


def test_pooled_trains_on_both_parts_and_keeps_the_test_part():
    everything = parts((5, 6), (4,))
    pooled = folded(everything, "pooled")
    assert pooled["train"] == everything["train"] + everything["val"]
    assert pooled["test"] == everything["test"]


@pytest.mark.parametrize("fold", [[2, 2], [0, 1], [-1, 3], "all", [1], [0.5, 2], 3])
def test_a_fold_that_does_not_exist_is_refused(fold):
    with pytest.raises(ConfigError, match=r"data\.fold=.*expected \[k,K\]"):
        folded(parts((5, 6), (4,)), fold)


def test_dealt_folds_are_about_equally_long():
    durations = [9.0, 1.0, 1.0, 1.0, 4.0, 4.0, 2.0, 2.0]
    dealt = deal(durations, 3)
    assert sorted(i for fold in dealt for i in fold) == list(range(8))
    lengths = [sum(durations[i] for i in fold) for fold in dealt]
    assert max(lengths) - min(lengths) <= 2.0


@pytest.mark.parametrize("seconds", [2.0, 5.0, 100.0])
def test_thinned_recordings_last_as_long_as_asked(seconds):
    recordings = [recording("a", 8.0), recording("b", 4.0)]
    found = thinned(recordings, seconds)
    lengths = [np.ptp(r.samples.t) for r in found]
    assert sum(lengths) == pytest.approx(min(seconds, 12.0), abs=0.05)
    assert lengths[0] == pytest.approx(2 * lengths[1], abs=0.05)
    assert all(r.samples.t[0] >= 0.0 and r.samples.t[-1] <= whole.samples.t[-1]
               for r, whole in zip(found, recordings, strict=True))  # fmt: skip


def test_recordings_of_a_fast_machine_are_thinned_to_as_many_as_asked():
    found = thinned([recording(str(k), 0.2) for k in range(20)], 2.0)
    assert sum(np.ptp(r.samples.t) for r in found) == pytest.approx(2.0, abs=0.2)


def test_thinned_recordings_are_seen_from_beginning_to_end():
    recordings = [recording(str(k), 10.0) for k in range(20)]
    found = thinned(recordings, 40.0)
    middles = np.sort([np.mean(r.samples.t) for r in found])
    assert middles[0] < 2.5
    assert middles[-1] > 7.5
    assert np.diff(middles).max() < 1.5


def test_thinned_pieces_of_short_recordings_have_nodes():
    recordings = [recording("a", 10.0), recording("b", 0.3), recording("c", 0.05)]
    pieces = thinned(recordings, 4.0, least=0.1)
    assert [np.ptp(one.samples.t) for one in pieces] == pytest.approx([4.0, 0.12, 0.05], abs=0.15)
    assert np.ptp(pieces[1].samples.t) >= 0.09


@pytest.mark.parametrize("pause", [0.7, 25.0, 1e4])
@pytest.mark.parametrize("seconds", [2.0, 5.0, 11.0])
def test_thinned_pieces_have_the_samples_that_they_have_without_a_pause(pause, seconds):
    recordings = [recording("a", 8.0), recording("b", 4.0)]
    later = [paused(one, pause) for one in recordings]
    assert_same_samples(thinned(later, seconds), thinned(recordings, seconds))


@pytest.mark.parametrize("shortest", [1.0, 4.0])
def test_thinned_pieces_are_not_too_short(shortest):
    recordings = [recording(str(k), 10.0) for k in range(20)]
    found = thinned(recordings, 5.0 * shortest, shortest)
    assert len(found) == 5
    assert all(np.ptp(r.samples.t) > 0.95 * shortest for r in found)
