"""The search as a command: an answer, a link to the model, and nothing done twice."""

import json
import os
import re
import shlex

import numpy as np
import pandas as pd
import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

import symo_exp
from symo_exp.__main__ import main
from symo_exp.data.delays import lagging
from symo_exp.data.recorded import RecordedData
from symo_exp.data.resample import Samples
from symo_exp.data.sensors import noise_of
from symo_exp.errors import ConfigError
from symo_exp.identify import trials
from symo_exp.identify.recordings import examine
from symo_exp.identify.structures import ladder
from symo_exp.identify.variations import with_half_the_step
from symo_exp.process import phases
from symo_exp.report.__main__ import main as report
from symo_exp.runs.folder import RunFolder
from symo_exp.systems.recorded import Recorded
from tests.logs import examined, pushes


def table(count=5, seconds=2.0, h=0.02, name="theta"):
    """Free swings of an oscillator that is linear, with friction."""
    t = np.arange(0.0, seconds, h)
    swings = [(0.4 + 0.1 * i) * np.exp(-0.2 * t) * np.cos(6.0 * t + i) for i in range(count)]
    return pd.concat(
        [pd.DataFrame({"trajectory": i, "t": t, f"q_{name}": q}) for i, q in enumerate(swings)]
    )


@pytest.mark.filterwarnings("error")
def test_a_table_without_rows_is_refused(tmp_path):
    (tmp_path / "mine.csv").write_text("trajectory,t,q_a\n")
    with pytest.raises(ConfigError, match="has 0 trajectories, too few"):
        examine({"path": str(tmp_path / "mine.csv")})


@pytest.mark.slow
def test_one_command_ends_with_a_model_a_table_and_a_verdict(workplace, capsys, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(workplace / "cache"))
    table().to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "budget=10s", "hydra/launcher=basic",
             "logger=none", "hydra.sweeper.clock=false"]  # fmt: skip
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "verdict on the test part: " in said
    folder = workplace / "outputs" / "machine_mine"
    model = symo_exp.load(folder / "best")
    path = model.rollout(torch.tensor([[0.3]]), torch.tensor([[0.0]]), steps=10)
    assert bool(path.q.isfinite().all())
    assert OmegaConf.load(folder / "best" / "config.yaml").trainer.time_limit is None
    folds = RunFolder(folder / "best").folds()
    names = [tuple(OmegaConf.load(fold / "config.yaml").data.fold) for fold in folds]
    assert len(names) > 1
    assert sorted(names) == [(k, len(names)) for k in range(len(names))]
    measures = RunFolder(folder / "best").measures()
    assert measures["rmse_1s"] < 0.01 * measures["constant_velocity_rmse_1s"]
    candidates = pd.read_csv(folder / "candidates.csv")
    assert candidates.chosen.sum() == 1
    assert (candidates.error > 0).all()
    assert report(["outputs/machine_mine", "--no-page"]) == 0
    page = (workplace / "report" / "report.md").read_text()
    assert "**Candidates of the search**" in page
    assert "Error [rad]: " in page
    assert "data.fold" not in page
    assert (workplace / "report" / "tables").is_dir()
    capsys.readouterr()
    written = {f: f.stat().st_mtime_ns for f in folder.glob("*/metrics.json")}
    assert main(words) == 0
    again = capsys.readouterr().out
    assert again.splitlines()[-3:] == said.splitlines()[-3:]
    assert {f: f.stat().st_mtime_ns for f in folder.glob("*/metrics.json")} == written


@pytest.mark.slow
def test_a_machine_without_friction_has_a_model_without(workplace, capsys):
    """Friction that is hardly there would end a long prediction."""
    t = np.arange(0.0, 6.0, 0.02)
    noise = np.random.default_rng(0)
    frames = [
        pd.DataFrame(
            {
                "trajectory": i,
                "t": t,
                "q_x": (1.0 + 0.1 * i) * np.cos(3.0 * t + i) + 1e-3 * noise.normal(size=len(t)),
            }
        )
        for i in range(6)
    ]
    pd.concat(frames).to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "budget=20s", "hydra/launcher=basic",
             "logger=none", "pictures=false", "hydra.sweeper.clock=false"]  # fmt: skip
    assert main(words) == 0
    capsys.readouterr()
    found = pd.read_csv(workplace / "outputs" / "machine_mine" / "candidates.csv")
    (chosen,) = found[found.chosen == 1].candidate
    assert chosen.endswith("no friction")


MISSED = "left out for lack of time", "not yet on "


@pytest.mark.slow
def test_a_search_without_time_says_what_it_leaves_out_and_repeats_itself(
    workplace, capsys, monkeypatch
):
    monkeypatch.setattr(trials, "FASTEST", 1e3)  # runs count as slow
    table().to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "budget=1s", "hydra/launcher=basic",
             "logger=none", "pictures=false", "dissipation=viscous"]  # fmt: skip
    assert main(words) == 0
    said = capsys.readouterr().out
    assert any(line.startswith(MISSED) for line in said.splitlines())
    assert "whatever its name says: dissipation=viscous\n" in said
    (untried,) = (line for line in said.splitlines() if line.startswith("with a larger budget"))
    tried = pd.read_csv(workplace / "outputs" / "machine_mine" / "candidates.csv").candidate
    assert set(untried.partition(": ")[2].split("; ")).isdisjoint(tried)
    assert main(words) == 0
    again = capsys.readouterr().out
    left_out = [line for line in said.splitlines() if line.startswith(MISSED)]
    assert left_out == [line for line in again.splitlines() if line.startswith(MISSED)]
    assert again.splitlines()[-3:] == said.splitlines()[-3:]
    link = workplace / "outputs" / "machine_mine" / "best"
    chosen = os.path.relpath(link.resolve())
    link.unlink()
    link.mkdir()  # as a copy without links has it
    assert main(words) == 0
    told = capsys.readouterr().out
    assert f"machine_mine/best is no link (Is a directory); the best is {chosen}" in told
    assert f'symo_exp.load("{chosen}")' in told


def test_a_search_whose_candidates_all_fail_ends_with_their_reasons(workplace, capsys):
    table().to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "budget=1s", "hydra/launcher=basic",
             "data.noise_std=1e300"]  # fmt: skip
    assert main(words) == 1
    said = capsys.readouterr().out
    assert "verdict: no model" in said
    assert "failed: rigid links, viscous friction: " in said
    failed = pd.read_csv(workplace / "outputs" / "machine_mine" / "candidates.csv").failed
    assert failed.str.contains("the loss of SyMo is nan").all()
    table(seconds=2.2).to_csv("mine.csv", index=False)
    assert main(words) == 2
    assert "has a search of other recordings" in capsys.readouterr().err


@pytest.mark.parametrize(
    "word", ["optimizer.start=-1", pytest.param("trainer=gpu", marks=pytest.mark.slow)]
)
def test_a_setting_that_all_candidates_refuse_is_one_error(word, workplace, capsys):
    table().to_csv("mine.csv", index=False)
    assert main(["-cn", "machine", "data.path=mine.csv", "hydra/launcher=basic", word]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert not (workplace / "outputs").exists()


def test_the_recordings_of_the_test_part_are_named(workplace):
    table(count=4, seconds=6.0).to_csv("mine.csv", index=False)
    (said,) = [note for note in examine({"path": "mine.csv"}).notes if "for the test" in note]
    assert said == "recordings: 3 to choose and train models; for the test: 3"


@pytest.mark.parametrize("gap", [0.0, 1.0, 1e5])
def test_recordings_with_gaps_or_without_a_test_part_are_examined_and_it_says_so(gap, workplace):
    frame = table(count=4, seconds=6.0)
    frame["split"] = np.where(frame.trajectory < 3, "train", "val")
    frame.loc[frame.t > 3.0, "t"] += gap
    found = examined(frame)
    assert any("has nothing for test" in note for note in found.notes)
    assert any("are cut there" in note for note in found.notes) == bool(gap)
    assert found.seconds == pytest.approx(3 * 6.0, abs=0.5)
    assert found.recordings == 3


@pytest.mark.parametrize(("lost", "offered"), [(1, True), (4, False), (9, True)])
def test_half_a_step_is_tried_where_it_cuts_recordings_no_more(lost, offered, workplace):
    """Samples every 0.01 s, some of them lost; cut at gaps of 0.06 s, with half a step 0.03 s."""
    frame = table(count=4, seconds=6.0, h=0.01)
    found = examined(frame[~frame.t.between(3.005, 3.005 + 0.01 * lost)])
    assert found.time_step == 0.02
    assert bool(with_half_the_step(ladder(found)[0], found)) == offered


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], "data.path"),
        (["data.path=none.csv"], "none.csv"),
        (["data.path=mine.csv", "budget=soon"], "budget=soon"),
        (["data.path=mine.csv", "seed=0,1"], "one value for each setting"),
        (["data.path=unclear.csv"], "system.angular"),
        (["data.path=null"], "expected a file"),
        (["data.path=log (1).csv"], "'data.path=\"log (1).csv\"'"),
        (["mine.csv"], "write data.path=mine.csv"),
        *(
            (["data.path=mine.csv", f"system.time_step={step}"], "system.time_step=")
            for step in ("-1", "0", "nan", "abc", "1e-9")
        ),
        (["data.path=mine.csv", "data.time_unit=mins"], "data.time_unit='mins'"),
        (["data.path=bursts.csv"], "nothing is left to choose and train models"),
    ],
)
def test_searches_that_cannot_be_made_are_refused_in_one_line(words, wanted, workplace, capsys):
    table().to_csv("mine.csv", index=False)
    table(name="a").to_csv("unclear.csv", index=False)
    bursts = table(count=4, h=0.01)
    bursts[bursts.t % 1.0 < 0.045].to_csv("bursts.csv", index=False)
    assert main(["-cn", "machine", *words]) == 2
    said = capsys.readouterr().err
    assert wanted in said
    assert len(said.strip().splitlines()) == 1
    assert not (workplace / "outputs").exists()


@pytest.mark.parametrize(
    ("words", "mend"),
    [
        ("objective=horizon", "possible: objective=smoothing"),
        ("optimizer=adam", "possible: optimizer=total_least_squares"),
        ("model=node", "possible: model=e2e_symo, model=l_node, model=symo"),
        ("data=simulated", "possible: data=recorded"),
        ("preset=fast", "leave it out"),
        ("preset=fast objective=smoothing optimizer=total_least_squares", "leave it out"),
        ("learner.validation=null", "leave it out"),
        ("data.fold=[0,3]", "leave it out"),
        ("data.monitor=test", "leave it out"),
        ("start_from=outputs/mine/best", "leave it out"),
    ],
)
def test_choices_that_do_not_suit_a_search_are_named_with_those_that_do(
    words, mend, workplace, capsys
):
    table().to_csv("mine.csv", index=False)
    given = words.split()
    path = [] if "data=simulated" in given else ["data.path=mine.csv"]
    assert main(["-cn", "machine", *path, *given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{given[0]} does not suit a search, which " in line
    assert line.endswith(f"; {mend}")
    assert not (workplace / "outputs").exists()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["l_node", "e2e_symo"])
def test_a_search_takes_other_models_with_a_lagrangian(model, workplace, capsys):
    table().to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "budget=1s", "hydra/launcher=basic",
             "logger=none", "pictures=false", "hydra.sweeper.clock=false"]  # fmt: skip
    assert main([*words, f"model={model}"]) == 0
    capsys.readouterr()
    measures = RunFolder(workplace / "outputs" / "machine_mine" / "best").measures()
    assert measures["rmse_1s"] < 0.05 * measures["constant_velocity_rmse_1s"]


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("count", [1, 5])
def test_a_machine_at_rest_has_no_model_and_a_reason(noise, count, workplace, capsys):
    frame = table(count, seconds=10.0 / count)
    frame["q_theta"] = noise * np.random.default_rng(0).normal(size=len(frame))
    frame.to_csv("rest.csv", index=False)
    assert main(["-cn", "machine", "data.path=rest.csv"]) == 1
    said = capsys.readouterr().out
    assert "verdict: no model" in said
    assert "nothing moves" in said


def test_the_voltage_and_the_current_of_a_motor_are_no_two_inputs(workplace):
    frame = table()
    wave = np.sin(frame.t)
    frame.assign(u_theta_V=wave, u_theta_A=0.1 * wave).to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"theta_V, theta_A.* keep one, by data\.columns"):
        examine({"path": "mine.csv"})


@pytest.mark.parametrize("rate", [100, 500, 2000])
def test_the_time_step_does_not_depend_on_noise_and_on_how_often_it_is_seen(rate, workplace):
    t = np.arange(0.0, 20.0, 1.0 / rate)
    q = 0.5 * np.sin(4.0 * t) + 0.01 * np.random.default_rng(0).normal(size=len(t))
    assert examined(pd.DataFrame({"t": t, "q_theta": q})).time_step == 0.02


@pytest.mark.parametrize(
    ("delay", "inertia"),
    [(-0.02, 90.0), (0.0, 2e-3), (0.0025, 1.0), (0.03, 2e-3), (0.03, 90.0), (0.0325, 1.0)],
)
def test_the_delay_of_an_input_and_the_inertia_that_it_moves_are_found(delay, inertia, workplace):
    frame, h = driven(), 0.005
    assert noise_of([frame.q_theta.to_numpy()]) < 1e-3
    found = examined(frame.assign(u_theta=inertia * pushes(frame.t + delay)))
    assert found.driven
    settings = dict(setting.split("=") for setting in found.settings)
    assert float(settings.get("data.input_delay", 0.0)) == pytest.approx(delay, abs=0.05 * h)
    assert not found.delay
    for setting, wanted in (("lagrangian.initial_inertia", 1.0), ("dissipation.start", 0.01)):
        value = float(settings[setting]) * found.units.mass
        assert value == pytest.approx(wanted * inertia, rel=0.3)


@pytest.mark.parametrize(
    ("rate", "angular", "cut"), [(100, "all", True), (500, "all", False), (100, "none", False)]
)
def test_stretches_too_fast_for_the_samples_are_left_out(rate, angular, cut, workplace):
    """Of angles only, and only where there are no samples for a smaller time step."""
    frames, rng, t = [], np.random.default_rng(0), np.arange(0.0, 6.0, 1 / rate)
    for i in range(6):
        q = 0.8 * np.sin(3.0 * t + i) + 1e-3 * rng.normal(size=len(t))
        if i == 0:
            q += 0.6 * np.sin(np.pi * (t - 2.0)) ** 2 * np.sin(100.0 * t) * (abs(t - 2.5) < 0.5)
        frames.append(pd.DataFrame({"trajectory": f"run {i}", "t": t, "q_theta": q}))
    found = examined(pd.concat(frames), angular=angular)
    told = [note for note in found.notes if "too fast" in note]
    assert len(told) == cut
    if cut:
        (setting,) = [one for one in found.settings if one.startswith("data.leave_out=")]
        (name, low, high), *_ = json.loads(setting.partition("=")[2])  # shocks follow
        assert name == "run 0"
        assert 2.0 <= low < 2.5 < high <= 3.0
        assert f"run 0 {low:g} to {high:g} s" in told[0]
        kept = examine({"path": "mine.csv", "leave_out": []}, angular=angular)
        assert kept.seconds > found.seconds


def test_leaps_after_which_nothing_is_left_are_refused_with_a_setting_that_keeps_them(workplace):
    t = 0.02 * np.arange(17)
    q = np.cos(3.0 * t) + 0.3 * (np.arange(17) == 8)  # in the middle of short recordings
    frames = [pd.DataFrame({"trajectory": i, "t": t, "q_theta": q + 0.1 * i}) for i in range(6)]
    pd.concat(frames).to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"nothing is left .* left out: .*data.leave_out=\[\]"):
        examine({"path": "mine.csv"}, angular="all")
    kept = examine({"path": "mine.csv", "leave_out": []}, angular="all")
    assert kept.seconds == pytest.approx(5 * 0.32)


def test_a_few_samples_far_apart_are_refused(workplace):
    """They are too few to be split in time at any time step that they allow."""
    t = 2.0 * np.arange(20)
    frames = [pd.DataFrame({"trajectory": n, "t": t[:n], "q_x": np.cos(t[:n])}) for n in (9, 20)]
    pd.concat(frames).to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"too short to be split in time .*a node every 2 s"):
        examine({"path": "mine.csv", "time_unit": "s"}, angular="none")


def driven(lag=0.0, *, jumps=False):
    """Recordings of a pendulum whose motor follows its input with a time constant."""
    h, q, v, motion = 0.005, 0.0, 0.0, []
    t = np.arange(0.0, 20.0, h)
    u = pushes(t)
    if jumps:
        u = 2.0 * np.sign(u)
    for acting in lagging(Samples(t, t[:, None], None, u[:, None]), lag).u[:, 0]:
        motion.append(q)
        v += h * (acting - 4.0 * np.sin(q) - 0.3 * v)
        q += h * v
    q = np.array(motion) + 1e-4 * np.random.default_rng(0).normal(size=len(t))
    return pd.DataFrame({"t": t, "q_theta": q, "u_theta": u})


@pytest.mark.parametrize("lost", [0.0, 0.1])
@pytest.mark.parametrize("lag", [0.0, 0.055, 0.1, 0.2])
def test_the_time_constant_with_which_a_force_follows_its_input_is_found(lag, lost, workplace):
    """Also with gaps, after which forces depend on the inputs before."""
    frame = driven(lag, jumps=lost > 0.0)
    found = examined(frame[(frame.t % 0.7 >= lost) | (frame.t < lost)], {"leave_out": []})
    settings = dict(setting.split("=") for setting in found.settings)
    lag_found = float(settings.get("data.input_lag", 0.0))
    assert lag_found == pytest.approx(lag, abs=2e-3, rel=0.06)
    assert float(settings["lagrangian.initial_inertia"]) == pytest.approx(1.0, rel=0.1)
    assert not found.delay
    assert "data.input_delay" not in settings


@pytest.mark.parametrize(("delay", "lag"), [(0.3, 0.0), (-0.2, 0.0), (0.0, 1.5), (0.3, 0.1)])
def test_inputs_act_as_they_are_given_where_anything_is_inferred_of_them(delay, lag, workplace):
    """Their direction, and the inertia, also where neither would be found."""
    frame, shift = driven(lag), round(delay / 0.005)
    frame["u_theta"] = frame.u_theta.shift(-shift)
    frame.dropna().to_csv("mine.csv", index=False)
    given = {"input_delay": delay or None, "input_lag": lag or None}
    found = examine({"path": "mine.csv"} | given)
    settings = dict(setting.split("=") for setting in found.settings)
    assert not {"system.input_matrix", "data.input_delay", "data.input_lag"} & set(settings)
    assert float(settings["lagrangian.initial_inertia"]) == pytest.approx(1.0, rel=0.1)
    assert not found.delay
    assert found.explained > 0.99


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_input_that_acts_in_the_other_direction_is_told_and_turned(sign, workplace):
    """Whatever its inertia, a machine accelerates in the direction of a force."""
    frame = driven()
    frame["u_theta"] *= sign
    frame.to_csv("mine.csv", index=False)
    found, as_given = (examine({"path": "mine.csv"}, input_matrix=x) for x in (None, [[1.0]]))
    turned = "system.input_matrix=[[-1.0]]"
    for machine in (found, as_given):
        assert any(turned in note for note in machine.notes) == (sign < 0.0)
    assert (turned in found.settings) == (sign < 0.0)
    assert not any("input_matrix" in word for word in as_given.settings)


@pytest.mark.parametrize("order", ["fffdd", "ddfff", "fdfdf"])
@pytest.mark.parametrize("one", [False, True])
def test_the_inertia_is_that_of_recordings_in_which_inputs_act(order, one, workplace):
    """Free swings ("f") last longer than what is examined, also those that ``one`` begins with."""
    t = np.arange(0.0, 25.0, 0.005)
    free = pd.DataFrame({"t": t, "q_theta": 0.3 * np.cos(16.0 * np.pi / 25.0 * t)})
    parts = [free.assign(u_theta=0.0) if each == "f" else driven() for each in f"{order}dd"]
    frame = pd.concat(parts, keys=range(7), names=["trajectory"]).reset_index(level=0)
    if one:
        frame["trajectory"] = (frame.trajectory - 4).clip(0)
        frame["split"] = frame.trajectory.map(["train", "val", "test"].__getitem__)
        frame["t"] = 0.005 * np.arange(len(frame))
    found = examined(frame)
    assert min(found.friction) > 0.0
    settings = dict(setting.split("=") for setting in found.settings)
    assert "system.scale.mass" not in settings
    if not one:
        assert float(settings["lagrangian.initial_inertia"]) == pytest.approx(1.0, rel=0.1)


def test_a_check_says_what_a_search_infers_and_leaves_nothing(workplace, capsys, monkeypatch):
    driven().to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "budget=20s", "hydra.sweeper.check_only=true"]
    shown, printed = [], print
    monkeypatch.setattr(phases, "say", shown.append)
    monkeypatch.setattr(phases, "clear", shown.clear)
    at_print: list[list[str]] = []
    monkeypatch.setattr(
        "builtins.print", lambda *x, **y: (at_print.append([*shown]), printed(*x, **y))
    )
    assert main(words) == 0
    assert at_print
    assert not any(at_print)  # no line is printed behind a status
    said = capsys.readouterr().out.splitlines()
    notes = list(examine({"path": "mine.csv"}).notes)
    assert said[: len(notes)] == notes
    assert said[-1].startswith("plan: ")
    assert not list(workplace.glob("outputs/**/*"))


@pytest.mark.parametrize("sparse", [[], ["log_1"], ["log_0", "log_3"]])
def test_recordings_with_fewer_samples_than_most_are_named(sparse, workplace):
    for name, one in driven().groupby(driven().t // 4.0):
        name = f"log_{name:.0f}"
        one[:: 10 if name in sparse else 1].to_csv(f"{name}.csv", index=False)
    (said,) = [x for x in examine({"path": "log_*.csv"}).notes if x.startswith("time step: ")]
    finest = 0.05 if sparse else 0.005
    assert f"samples every {finest:g} s" in said
    assert said.partition(" s in ")[2].partition(", every 0.005 s")[0] == ", ".join(sparse)


@pytest.mark.parametrize("constant", [False, True])
def test_an_input_that_never_changes_suggests_neither_an_inertia_nor_a_delay(constant, workplace):
    frame = driven()
    if constant:
        frame["u_theta"] = 1.5
    said = "; ".join(examined(frame).notes)
    assert ("as inputs suggest" in said) != constant
    assert ("inputs: no delay" in said) != constant
    assert ("never change" in said) == constant


@pytest.mark.parametrize("seconds", [5.0, 10.0, 20.0])
def test_an_input_that_never_acts_is_named_and_changes_nothing(seconds, workplace):
    frame = driven()
    frame["q_elbow"] = 0.4 * np.cos(2.9 * frame.t) + 0.3 * np.cos(4.3 * frame.t)
    frame = frame[frame.t < seconds].rename(columns={"q_theta": "q_arm", "u_theta": "u_arm"})
    found = examined(frame.assign(u_elbow=0.0))
    (mend,) = [
        x
        for note in found.notes
        for x in note.split("u_elbow is always zero; leave it out by ")[1:]
    ]
    alone = examine({"path": "mine.csv", "columns": {"u_elbow": None}})
    assert set(alone.settings) - set(found.settings) == {"system.input_matrix=[[1],[0]]"}
    words = [
        "-cn",
        "machine",
        "data.path=mine.csv",
        "hydra.sweeper.check_only=true",
        *shlex.split(mend),
    ]
    assert main(words) == 0


def test_an_input_that_never_changes_is_named(workplace):
    driven().assign(u_theta=0.3).to_csv("mine.csv", index=False)
    mend = "u_theta is constant; if nothing acts, leave it out by 'data.columns={u_theta: null}'"
    assert mend in examine({"path": "mine.csv"}).notes


def test_a_free_machine_gets_no_estimate_of_its_inertia(workplace):
    assert not any("inertia" in setting for setting in examined(table()).settings)


@pytest.mark.parametrize(
    ("name", "angle"),
    [
        ("theta", True), ("shoulder", True), ("x", False), ("cart_position", False),
        ("1 [rad]", True), ("1_rad", True), ("x_rad", True), ("1 [m]", False), ("1_mm", False),
    ],
)  # fmt: skip
def test_angles_are_told_by_name(name, angle, workplace):
    assert examined(table(name=name)).coordinates.angular == (angle,)


@pytest.mark.parametrize(("file", "angle"), [("ball_position_m", False), ("ball_deg", True)])
def test_angles_are_told_by_the_name_of_the_file(file, angle, workplace):
    table(name="1").rename(columns={"q_1": file}).to_csv("mine.csv", index=False)
    data = {"path": "mine.csv", "columns": {"q_ball": file}}
    assert examine(data).coordinates.angular == (angle,)


@pytest.mark.parametrize("name", ["0", "1e3", "a b", "a, b", "null", "it's"])
def test_the_setting_that_an_unclear_name_needs_can_be_typed(name, workplace):
    table(name=name).to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"system\.angular has no value yet") as error:
        examine({"path": "mine.csv"})
    word = shlex.split(str(error.value).partition(" a list, as ")[2])[0]
    words = ["-cn", "machine", "data.path=mine.csv", "hydra.sweeper.check_only=true", word]
    assert main(words) == 0


@pytest.mark.parametrize("known", ["arm", "cart"])
def test_all_coordinates_that_may_be_angles_are_asked_for_at_once(known, workplace):
    """An answer for the first alone, such as none, would make lengths of the others."""
    frame = table(name="trolley")
    frame.assign(q_sway=2.0 * frame.q_trolley, **{f"q_{known}": frame.q_trolley}).to_csv(
        "mine.csv", index=False
    )
    with pytest.raises(ConfigError, match=r"q_trolley \(.* q_sway \(.*are angles") as error:
        examine({"path": "mine.csv"})
    assert f"q_{known}" not in str(error.value)
    assert ('"arm"' in str(error.value)) == (known == "arm")


@pytest.mark.parametrize("name", ["0", "1e3", "arm [rad]", "joint, left", "null"])
def test_angles_with_any_name_are_a_setting(name, workplace):
    frame = table(name=name)
    frame[f"q_{name}"] *= 20.0
    found = examined(frame, {"degrees": False})
    (word,) = (word for word in found.settings if word.startswith("system.angular="))
    (given,) = OverridesParser.create().parse_overrides([word])
    assert Recorded(names=[name], angular=given.value(), time_step=0.1).coordinates.angular == (
        True,
    )


def test_angles_whose_names_say_so_are_in_degrees(workplace):
    frame = table(name="1_deg")
    frame["q_1_deg"] *= 180.0 / np.pi
    assert "data.degrees=true" in examined(frame).settings
    assert "data.degrees=true" not in examine({"path": "mine.csv", "degrees": False}).settings


def test_coordinates_that_never_move_are_named(workplace):
    frame = table()
    frame["q_elbow"] = 0.3
    found = examined(frame)
    (note,) = [note for note in found.notes if "q_elbow never moves" in note]
    assert note.endswith("give 'data.columns={q_elbow: null}'")
    assert not any("gear" in note for note in found.notes)  # rounding errors are no motion
    alone = examine({"path": "mine.csv", "columns": {"q_elbow": None}})
    assert (found.coordinates.n, alone.coordinates.n) == (2, 1)
    assert found.explained == pytest.approx(alone.explained, abs=0.01)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_machine_without_its_joints_at_rest_is_one_setting(noise, workplace):
    frame = driven().rename(columns={"q_theta": "q_arm", "u_theta": "u_arm"})
    rng = np.random.default_rng(0)
    for name in ("elbow", "wrist"):
        frame[f"q_{name}"] = 0.3 + noise * rng.normal(size=len(frame))
        frame[f"v_{name}"], frame[f"u_{name}"] = 0.0, 0.1 * frame.u_arm + 0.2
    frame["v_arm"] = np.gradient(frame.q_arm, frame.t)
    found = examined(frame)
    (note,) = [note for note in found.notes if "never move by more than noise" in note]
    assert note.startswith("q_elbow, q_wrist")
    (word,) = shlex.split(note.partition(" give ")[2])
    (given,) = OverridesParser.create().parse_overrides([word])
    alone = examine({"path": "mine.csv", "columns": given.value()})
    assert alone.coordinates.names == ("arm",)
    assert "as inputs suggest" in "; ".join(alone.notes)


@pytest.mark.parametrize(("bent", "told"), [(0.0, True), (1e-3, True), (0.1, False)])
def test_coordinates_that_a_gear_joins_are_named(bent, told, workplace):
    """An elastic one, whose parts move against each other, is a machine of two coordinates."""
    frame = table(name="motor")
    noise = np.random.default_rng(0).normal(size=(len(frame), 2))
    bending = bent * np.sin(20.0 * frame.t)
    frame["q_joint"] = frame.q_motor / 50 + bending / 50 + 1e-4 * noise[:, 0]
    frame["q_motor"] += 1e-3 * noise[:, 1]
    frame = frame.rename(columns={"q_motor": "motor [rad]"})
    frame.to_csv("mine.csv", index=False)
    columns = {"q_motor": "motor [rad]", "q_arm": "q_joint"}
    notes = examine({"path": "mine.csv", "columns": columns}).notes
    found = [note for note in notes if "q_arm is 0.02 times q_motor" in note]
    assert len(found) == told
    assert all(note.endswith("give 'data.columns={q_motor: \"motor [rad]\"}'") for note in found)


def test_without_a_coordinate_its_velocity_is_not_read_either(workplace):
    frame = table(name="motor").assign(v_motor=0.0, v_joint=0.0)
    frame.assign(q_joint=2.0 * frame.q_motor).to_csv("mine.csv", index=False)
    (note,) = [note for note in examine({"path": "mine.csv"}).notes if "a gear joins" in note]
    assert note.endswith("give 'data.columns={q_joint: null, v_joint: null}'")


def test_the_input_of_a_coordinate_that_a_gear_moves_acts_through_the_gear(workplace):
    frame = table(name="motor")
    frame["u_motor"], frame["u_joint"] = np.sin(3.0 * frame.t), np.cos(2.0 * frame.t)
    frame.assign(q_joint=2.0 * frame.q_motor).to_csv("mine.csv", index=False)
    (note,) = [note for note in examine({"path": "mine.csv"}).notes if "a gear joins" in note]
    columns, matrix = shlex.split(note.partition(" give ")[2].partition(", by which")[0])[::2]
    given = OverridesParser.create().parse_overrides([columns, matrix])
    assert [one.key_or_group for one in given] == ["data.columns", "system.input_matrix"]
    columns, matrix = (one.value() for one in given)
    assert matrix == [[1.0, 2.0]]
    found = examine({"path": "mine.csv", "columns": columns}, input_matrix=matrix)
    assert found.coordinates.names == ("motor",)


def test_that_a_point_is_on_a_circle_is_said_with_the_question_for_the_matrix(workplace):
    angle = np.sin(2.0 * table().t)
    frame = pd.DataFrame({"t": table().t, "q_x": np.sin(angle), "q_y": -np.cos(angle)})
    frame.assign(u_motor=np.cos(3.0 * frame.t)).to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"say how the inputs .*; q_x and q_y lie on a circle"):
        examine({"path": "mine.csv"})


@pytest.mark.parametrize(("swing", "told"), [(2.0, True), (0.5, True), (0.002, False)])
@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_two_lengths_of_a_link_that_turns_are_to_be_its_angle(swing, told, unit, workplace):
    frame = table(name="x")
    rng = np.random.default_rng(0)
    angle = swing * (frame.q_x - frame.q_x.mean()) / np.ptp(frame.q_x)
    x = unit * (0.3 + 0.4 * np.sin(angle) + 1e-4 * rng.normal(size=len(frame)))
    y = unit * (0.7 - 0.4 * np.cos(angle) + 1e-4 * rng.normal(size=len(frame)))
    frame.assign(q_x=x, q_y=y).to_csv("mine.csv", index=False)
    found = [note for note in examine({"path": "mine.csv"}).notes if "lie on a circle" in note]
    assert len(found) == told
    for note in found:
        (radius,) = re.findall(r"of radius (\S+)", note)
        assert float(radius) == pytest.approx(0.4 * unit, rel=0.02)
    assert all("arctan2(y - b, x - a)" in note for note in found)
    frame.assign(q_x=x, q_y=np.sin(3.0 * frame.t)).to_csv("mine.csv", index=False)
    assert not any("lie on a circle" in note for note in examine({"path": "mine.csv"}).notes)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Torque [N mm]", True), ("motor_mNm", True), ("Current (mA)", True), ("Strom", True),
        ("motor_volt", True), ("pwm1", True), ("Force [kN]", True), ("u_theta", False),
        ("Torque [Nm]", False), ("force (N)", False), ("torque_N_m", False), ("motor_a", False),
    ],
)  # fmt: skip
def test_inputs_that_are_no_forces_by_their_names_are_told(name, told, workplace):
    """Masses in results are in proportion to their unit."""
    driven().rename(columns={"u_theta": name}).to_csv("mine.csv", index=False)
    found = examine({"path": "mine.csv", "columns": {"u_theta": name}}).notes
    assert any(x.startswith(f"inputs, {name}, are used as they are") for x in found) == told


def test_recordings_in_another_unit_than_most_are_named(workplace):
    frame = driven()
    every = pd.concat(
        frame.assign(trajectory=f"run{k}", q_theta=frame.q_theta + 1e-4 * k) for k in range(4)
    )
    every.loc[every.trajectory == "run2", "q_theta"] *= 180.0 / np.pi
    every.to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"q_theta moves by [\d.]+ in run2, by"):
        examine({"path": "mine.csv"})


@pytest.mark.parametrize(
    ("ratio", "bent", "told"),
    [
        (50.0, 0.02, True),
        (-50.0, 0.02, True),
        (0.02, 0.02, True),
        (2.0, 0.02, False),
        (50.0, 0.2, False),
    ],
)
def test_angles_that_an_elastic_gear_joins_are_to_be_in_one_scale(ratio, bent, told, workplace):
    frame = table(name="arm")
    frame["q_motor"] = ratio * (frame.q_arm + bent * np.sin(20.0 * frame.t))
    notes = examined(frame, {"degrees": False}).notes
    found = [note for note in notes if "elastic gear" in note]
    fast, times = ("q_motor", ratio) if abs(ratio) > 1.0 else ("q_arm", 1.0 / ratio)
    assert len(found) == told
    assert all(f"divide {fast} by its ratio, about {round(times)}," in note for note in found)


@pytest.mark.parametrize(
    ("place", "step", "noise"),
    [(0.1, 0.005, 0.0), (0.3, 0.0013, 0.0), (123.456, 0.0013, 0.0), (0.1, 0.005, 1e-3)],
)
def test_coordinates_that_never_move_set_neither_the_time_step_nor_units(
    place, step, noise, workplace
):
    """Between samples at irregular times, they have rounding errors."""
    rng = np.random.default_rng(0)
    t = step * (np.arange(round(20.0 / step)) + 0.1 * rng.random(round(20.0 / step)))
    frame = pd.DataFrame({"t": t, "q_theta": 0.5 * np.sin(3 * t) + 0.2 * np.cos(5 * t)})
    frame.to_csv("alone.csv", index=False)
    frame.assign(q_x=place + noise * rng.normal(size=len(t))).to_csv("mine.csv", index=False)
    alone, found = examine({"path": "alone.csv"}), examine({"path": "mine.csv"})
    assert (found.time_step, found.units) == (alone.time_step, alone.units)
    assert found.rest_velocity == alone.rest_velocity
    assert found.explained == pytest.approx(alone.explained, abs=0.01)
    assert found.horizon == alone.horizon


@pytest.mark.parametrize(("factor", "told"), [(1.0, ""), (57.3, "57 times"), (-1.0, "-1 times")])
def test_velocities_that_contradict_the_coordinates_are_told(factor, told, workplace):
    frame = table()
    swings = frame.groupby("trajectory").q_theta
    frame["v_theta"] = factor * swings.transform(lambda q: np.gradient(q, 0.02))
    found = [note for note in examined(frame).notes if "the slope of" in note]
    assert len(found) == bool(told)
    assert all(f"v_theta is {told}" in note and "v_theta: null" in note for note in found)


def test_an_input_that_never_acts_is_told_where_a_matrix_is_asked_for(workplace):
    frame = table()
    frame["u_left"], frame["u_right"] = np.sin(frame.t), 0.0
    frame.to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"system\.input_matrix.*u_right is always zero") as error:
        examine({"path": "mine.csv"})
    (mend,) = re.findall(r"data\.columns=\{(\w+): null\}", str(error.value))
    assert examine({"path": "mine.csv", "columns": {mend: None}}).driven


def test_inputs_with_the_names_of_coordinates_drive_these(workplace):
    frame = table(name="shoulder")
    frame["q_elbow"], frame["u_elbow"] = frame.q_shoulder * 0.5, 0.1
    assert "system.input_matrix=[[0],[1]]" in examined(frame).settings
    units = {name: f"{name} [{'Nm' if name[0] == 'u' else 'rad'}]" for name in frame if name != "t"}
    frame.rename(columns=units).to_csv("units.csv", index=False)
    assert "system.input_matrix=[[0],[1]]" in examine({"path": "units.csv"}).settings
    frame.rename(columns={"u_elbow": "u_motor"}).to_csv("other.csv", index=False)
    with pytest.raises(ConfigError, match="input_matrix"):
        examine({"path": "other.csv"})


@pytest.mark.parametrize(("factor", "settings"), [
    (1.0, {"data.wrapped=true"}),
    (180.0 / np.pi, {"data.wrapped=true", "data.degrees=true"}),
])  # fmt: skip
def test_angles_that_jump_by_a_turn_are_unwrapped(factor, settings, workplace):
    t = 0.01 * np.arange(3000)
    angle = factor * ((3.0 * t + np.sin(t) + np.pi) % (2 * np.pi) - np.pi)
    found = examined(pd.DataFrame({"t": t, "q_1": angle}))
    assert found.coordinates.angular == (True,)
    assert settings == {word for word in found.settings if word.startswith("data.")}
    plain = examine({"path": "mine.csv"}, angular="all")
    assert plain.time_step == found.time_step == 0.02
    if "data.degrees=true" in settings:
        with pytest.raises(ConfigError, match=r"data.degrees=false.* jump by 360.*degrees=true"):
            examine({"path": "mine.csv", "degrees": False})


@pytest.mark.parametrize("factor", [1.0, 180.0 / np.pi])
def test_rests_where_an_angle_jumps_by_a_turn_are_left_out(factor, workplace):
    t = 0.01 * np.arange(4000)
    moving = (t > 10.0) & (t < 30.0)
    q = np.pi + np.where(moving, np.sin(2 * (t - 10.0)) * (30.0 - t) / 20.0, 0.0)
    q = np.random.default_rng(0).normal(q, 1e-4)
    pd.DataFrame({"t": t, "q_1": q}).to_csv("plain.csv", index=False)
    angle = factor * ((q + np.pi) % (2 * np.pi) - np.pi)
    pd.DataFrame({"t": t, "q_1": angle}).to_csv("jumping.csv", index=False)
    plain, found = examine({"path": "plain.csv"}, angular="all"), examine({"path": "jumping.csv"})
    assert found.seconds == pytest.approx(plain.seconds) == pytest.approx(0.8 * 20.0, abs=3.0)
    assert found.coordinates == plain.coordinates
    assert set(plain.notes) < set(found.notes)
    assert any("s at rest are left out" in note for note in found.notes)


@pytest.mark.parametrize(
    ("hertz", "noise"), [(1.0, 1e-3), (5.0, 0.0), (20.0, 1e-3), (300.0, 0.0), (300.0, 1e-3)]
)
def test_the_time_step_resolves_a_vibration(hertz, noise, workplace):
    t = np.arange(0.0, max(2.0, 40.0 / hertz), min(0.01, 0.02 / hertz))
    random = np.random.default_rng(0)
    x = np.sin(2 * np.pi * hertz * t) + noise * random.normal(size=len(t))
    pd.DataFrame({"t": t, "q_x": x, "u_x": np.cos(2 * np.pi * hertz * t)}).to_csv("mine.csv")
    step = examine({"path": "mine.csv"}).time_step
    assert 2 * np.pi * hertz * step < 0.75
    assert step == 0.02 or 2 * np.pi * hertz * step > 0.2


@pytest.mark.parametrize("rate", [99.0, 99.9, 99.95, 100.0, 100.05])
def test_the_time_step_of_a_fast_motion_is_the_pace_of_the_samples(rate, workplace):
    t = np.arange(0.0, 6.0, 1.0 / rate)
    step = examined(pd.DataFrame({"t": t, "q_x": np.sin(100.0 * t)})).time_step
    assert step == pytest.approx(1.0 / rate, rel=1.1e-3)
    system = Recorded(names=["x"], angular="none", time_step=step)
    RecordedData(system=system, path="mine.csv").setup()


@pytest.mark.parametrize(("hertz", "pieces"), [(300.0, 10), (2e4, 1)])
def test_the_time_step_resolves_a_vibration_that_was_recorded_for_a_short_time(
    hertz, pieces, workplace
):
    t = np.arange(0.0, 400.0 / hertz, 0.02 / hertz)
    x = np.sin(2 * np.pi * hertz * t) + 1e-3 * np.random.default_rng(0).normal(size=len(t))
    place = np.arange(len(t)) * pieces // len(t)
    frame = pd.DataFrame({"t": t, "q_x": x, "u_x": np.cos(2 * np.pi * hertz * t)})
    if pieces > 1:
        frame["trajectory"] = place
    step = examined(frame, {"time_unit": "s"}).time_step
    assert 0.2 < 2 * np.pi * hertz * step < 0.75


@pytest.mark.parametrize(("gravity", "asked"), [(40.0, True), (0.0, False)])
def test_turns_of_a_coordinate_named_position_are_asked_for(gravity, asked, workplace):
    """Of a pendulum that turns over, not of a carriage that goes as far."""
    t, q, v, motion = 0.01 * np.arange(3000), 0.0, 9.0, []
    u = 25.0 * np.sin(1.3 * t) + 15.0 * np.sin(2.9 * t + 1)
    for force in u:
        for _ in range(10):
            v += 1e-3 * (force - gravity * np.sin(q) - 0.5 * v)
            q += 1e-3 * v
        motion.append(q)
    pd.DataFrame({"t": t, "q_position": motion, "u_motor": u}).to_csv("mine.csv", index=False)
    assert np.ptp(motion) > 7.0
    if asked:
        with pytest.raises(ConfigError, match=r"system.angular has no .*q_position moves by"):
            examine({"path": "mine.csv"})
        assert examine({"path": "mine.csv"}, angular="all").explained > 0.9
    else:
        assert examine({"path": "mine.csv"}).coordinates.angular == (False,)


@pytest.mark.parametrize("amplitude", [0.5, 2.5])
@pytest.mark.parametrize("gusts", [0.0, 6.0])
def test_angles_that_are_explained_in_degrees_only_are_asked_for(amplitude, gusts, workplace):
    """Swings of a pendulum, which the wind may move as well."""
    t, q, v, swings = 0.01 * np.arange(2000), amplitude, 0.0, []
    wind = gusts * np.random.default_rng(0).normal(size=len(t) // 20).repeat(20)
    for force in wind:
        swings.append(q)
        v += 0.01 * (force - 9.81 * np.sin(q))
        q += 0.01 * v
    for name, factor in (("radians", 1.0), ("degrees", 180.0 / np.pi)):
        frame = pd.DataFrame({"t": t, "q_theta": factor * np.array(swings)})
        frame.to_csv(f"{name}.csv", index=False)
    assert examine({"path": "radians.csv"}).coordinates.angular == (True,)
    with pytest.raises(ConfigError, match="degrees=true or false"):
        examine({"path": "degrees.csv"})
    plain = examine({"path": "radians.csv"})
    assert examine({"path": "degrees.csv", "degrees": True}).time_step == plain.time_step
    examine({"path": "degrees.csv", "degrees": False})


def test_degrees_of_a_pole_on_a_cart_are_asked_for(workplace):
    """Half of the accelerations' power is that of the cart, which any reading explains."""
    t, (x, q, v, w), rows = 0.01 * np.arange(3000), (0.0, 0.5, 0.0, 0.0), []
    u = sum(np.sin(rate * t + rate**2) for rate in (2.3, 3.7, 5.1))
    for force in 3.0 * u:
        rows.append((x, q))
        a = force - 4.0 * x - v
        v, w = v + 0.01 * a, w - 0.01 * (20.0 * np.sin(q) + 2.0 * a * np.cos(q) + 0.2 * w)
        x, q = x + 0.01 * v, q + 0.01 * w
    place, turn = np.array(rows).T
    frame = pd.DataFrame({"t": t, "q_cart": place, "q_pole": turn, "u_cart": 3.0 * u})
    frame.to_csv("radians.csv", index=False)
    frame.assign(q_pole=np.degrees(turn)).to_csv("degrees.csv", index=False)
    assert examine({"path": "radians.csv"}).explained > 0.9
    assert examine({"path": "degrees.csv", "degrees": False}).explained > 0.5
    with pytest.raises(ConfigError, match="degrees=true or false"):
        examine({"path": "degrees.csv"})


@pytest.mark.parametrize(("gravity", "horizons"), [(25.0, [0.2, 0.4, 0.8]), (-25.0, None)])
def test_errors_of_machines_that_a_controller_balances_count_over_shorter_times(
    gravity, horizons, workplace
):
    """A pendulum upright, where errors grow by e in 0.2 s, or hanging."""
    h, rng = 0.005, np.random.default_rng(0)
    q, v, rows = 0.1, 0.0, []
    for t in h * np.arange(6000):
        u = -40.0 * q - 4.0 * v + sum(np.sin(w * t + w**2) for w in (2.3, 3.7, 5.1, 8.3))
        rows.append((t, q, u))
        for _ in range(5):
            v += h / 5 * (gravity * np.sin(q) - 0.2 * v + u)
            q += h / 5 * v
    frame = pd.DataFrame(rows, columns=["t", "q_theta", "u_motor"])
    frame["q_theta"] += 1e-5 * rng.normal(size=len(frame))
    given = [x.split("=")[1] for x in examined(frame).settings if "horizons" in x]
    if horizons is None:
        assert not given
    else:
        np.testing.assert_allclose(json.loads(given[0]), horizons, rtol=0.1)


@pytest.mark.parametrize(("rate", "step"), [(5.0, 0.02), (45.0, 0.005)])
def test_errors_of_an_unstable_machine_grow_little_in_a_time_step(rate, step, workplace):
    """A mass that a magnet pulls away and a controller holds, in units of 1 mm."""
    h, rng = 0.001, np.random.default_rng(0)
    x, v, rows = 1e-4, 0.0, []
    for t in h * np.arange(20_000):
        sines = sum(np.sin(w * t + w**2) for w in (2.3, 3.7, 5.1, 8.3, 21.0))
        u = rate**2 * (2e-4 * sines - 2.0 * x) - rate * v
        rows.append((t, x, u))
        for _ in range(5):
            v += h / 5 * (rate**2 * x + u)
            x += h / 5 * v
    frame = pd.DataFrame(rows, columns=["t", "q_x", "u_x"])
    frame["q_x"] += 1e-6 * rng.normal(size=len(frame))
    found = examined(frame)
    assert found.time_step == step
    assert found.horizon == pytest.approx(4.0 / rate, rel=0.15)


@pytest.mark.parametrize(("stiffness", "weight"), [(0.0, 0.5), (0.5, 0.0), (1.4, 0.0), (1.4, 0.5)])
def test_the_stiffness_of_an_elastic_joint_is_found_and_gravity_is_no_spring(
    stiffness, weight, workplace
):
    """A motor and a link, with a spring between them or none; the link has a weight or none."""
    h, rng = 0.005, np.random.default_rng(0)
    t = np.arange(0.0, 30.0, h)
    inputs = pushes(t)
    q, v, motion = np.zeros(2), np.zeros(2), []
    inertia = np.array([0.012, 0.008])
    for now in inputs:
        motion.append(q)
        twist = stiffness * (q[1] - q[0])
        torque = np.array([now + twist, -twist - weight * np.sin(q[1])]) - 0.02 * v
        v = v + h * torque / inertia
        q = q + h * v
    q = np.array(motion) + 1e-5 * rng.normal(size=(len(t), 2))
    frame = pd.DataFrame({"t": t, "q_motor": q[:, 0], "q_link": q[:, 1], "u_motor": inputs})
    found = examined(frame)
    if not stiffness:
        assert found.stiffness is None
        return
    expected = stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(found.stiffness, expected, rtol=0.0, atol=0.7 * stiffness)
    (sprung,) = [c for c in ladder(found)[:2] if c.settings.get("springs") == "linear"]
    assert sprung.settings["springs.start"].startswith("[[")
