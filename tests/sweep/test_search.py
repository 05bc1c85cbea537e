"""Other sweepers than ours get a number from each run."""

import json
import shlex
import signal

import numpy as np
import pandas as pd
import pytest

from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from tests.tiny import TINY

pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")

QUIET = [*TINY, "logger=none", "pictures=false", "model=node"]
SEARCH = [*QUIET, "hydra/sweeper=optuna", "hydra.sweeper.n_trials=3", "hydra.sweeper.n_jobs=1"]


def found(workplace):
    return [*workplace.rglob("metrics.json")]


def best(workplace):
    import yaml

    (file,) = workplace.rglob("optimization_results.yaml")
    return yaml.safe_load(file.read_text())


def test_the_least_of_a_measure_is_found_and_a_run_that_diverges_is_the_worst(workplace):
    words = ["optimized_metric=test_mse", "learning_rate=choice(1e30,1e-2,1e-3)"]
    assert main([*SEARCH, *words, "+hydra.sweeper.sampler.seed=1"]) == 0
    (log,) = {*workplace.rglob("outcome.json")} - {
        p.with_name("outcome.json") for p in found(workplace)
    }
    assert json.loads(log.read_text())["status"] == "failed"
    assert best(workplace)["best_value"] == min(
        json.loads(path.read_text())["test_mse"] for path in found(workplace)
    )


def test_a_trial_whose_measure_is_not_a_number_is_the_worst(workplace, monkeypatch):
    values = iter([np.nan, 2.0, np.nan])
    monkeypatch.setattr("symo_exp.job.job.optimized", lambda *_: next(values))
    words = ["learning_rate=choice(1e-2,1e-3)", "measures=false", "trainer.max_epochs=1"]
    assert main([*SEARCH, *words]) == 0
    assert best(workplace)["best_value"] == 2.0


def test_a_later_trial_that_is_refused_is_the_worst(workplace, monkeypatch):
    """For instance for want of memory: the search of a night goes on."""
    refusals = iter([None, ConfigError("net.width=4096 needs more memory"), None])
    values = iter([3.0, 2.0])
    monkeypatch.setattr("symo_exp.job.job.changed_recordings", lambda *_, **__: next(refusals))
    monkeypatch.setattr("symo_exp.job.job.is_done", lambda *_: True)
    monkeypatch.setattr("symo_exp.job.job.optimized", lambda *_: next(values))
    assert main([*SEARCH, "learning_rate=choice(1e-2,1e-3)"]) == 0
    assert best(workplace)["best_value"] == 2.0


def test_results_of_other_recordings_are_refused(workplace, capsys):
    t = 0.05 * np.arange(60)
    words = ["system=pendulum", "data=recorded", "data.path=mine.csv", "model=node", "logger=none",
             "pictures=false", "optimized_metric=test_mse", "trainer.max_epochs=1",
             *SEARCH[-3:], "hydra.sweeper.n_trials=1", "net.width=choice(4)"]  # fmt: skip
    for code, size in ((0, 1.0), (2, 1.1)):
        table = pd.DataFrame({"t": t, "q_theta": size * np.cos(2.0 * t), "u_0": np.sin(t)})
        table.to_csv("mine.csv", index=False)
        assert main(words) == code
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "the recordings have changed" in line
    assert "give experiment=NAME" in line
    assert [json.loads(path.read_text())["status"] for path in workplace.rglob("outcome.json")] == [
        "finished"
    ]


@pytest.mark.parametrize(
    ("word", "wanted"),
    [
        ("optimized_metric=nonsense", "val_loss"),
        ("data.n_traj=0", "from 1"),
        ("resume=false", "experiment=NAME"),
        ("hydra.sweeper.n_trials=0", "at least 1"),
        ("hydra.sweeper.n_jobs=-1", "at least 1"),
    ],
)
def test_bad_input_is_one_line(word, wanted, workplace, capsys):
    assert main([*SEARCH, word, "learning_rate=choice(1e-3)"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"symo_exp: error: {word}")
    assert wanted in line


def test_workers_of_a_search_are_started_deaf_to_the_signal(workplace, monkeypatch):
    """They would end by it with tracebacks while they import PyTorch."""
    launchers = pytest.importorskip("hydra_plugins.hydra_joblib_launcher.joblib_launcher")
    blocked = []

    def launch(*_, **__):
        blocked.append(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))
        raise KeyboardInterrupt

    monkeypatch.setattr(launchers.JoblibLauncher, "launch", launch)
    assert main([*SEARCH, "hydra/launcher=joblib", "net.width=choice(4,8)"]) == 130
    assert blocked == [True]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_the_search_that_ships_counts_and_ends_with_a_command_that_repeats_the_best(
    workplace, capsys
):
    """With fewer epochs than those between two validations."""
    small = [word for word in TINY if not word.startswith(("net.width", "trainer.validate"))]
    words = [*small, "logger=none", "hydra.sweeper.n_trials=2", "trainer.validate_every=10"]
    assert main(["-cn", "search", *words]) == 0
    out, err = capsys.readouterr()
    assert set(best(workplace)["best_params"]) == {"net.width", "learning_rate"}
    assert "trial 1 of 2" in out
    assert "trial 2 of 2" in out
    assert "alembic" not in out + err
    assert "study" not in (out + err).lower()
    (told,) = [line for line in out.splitlines() if line.startswith("to repeat it: ")]
    again = shlex.split(told.removeprefix("to repeat it: "))[3:]
    assert main([*again, "logger=none", "pictures=false", "data.cache_dir=cache"]) == 0
    assert "finished already" in capsys.readouterr().out


def test_a_search_without_a_run_that_succeeds_fails(workplace, capsys):
    words = ["optimized_metric=test_mse", "learning_rate=choice(1e30)"]
    assert main([*SEARCH, *words]) == 1
    out = capsys.readouterr().out
    assert "no trial has a finite test_mse" in out
    assert "repeat" not in out


@pytest.mark.slow
def test_the_best_of_a_search_with_own_classes_is_repeated_with_them(workplace, capsys):
    mine = workplace / "mine"
    (mine / "objective").mkdir(parents=True)
    source = """from symo_exp.models.objectives import Residual


class Searched(Residual):
    pass
"""
    (mine / "searched_objective.py").write_text(source)
    yaml = "# An objective.\n_target_: searched_objective.Searched\n"
    (mine / "objective" / "searched.yaml").write_text(yaml)
    given = ["--config-dir", "mine", "code=mine", "objective=searched", "model=symo"]
    words = [word for word in SEARCH if word != "model=node"]
    assert main([*given, *words, "learning_rate=choice(1e-3,1e-2)"]) == 0
    out = capsys.readouterr().out
    (told,) = [line for line in out.splitlines() if line.startswith("to repeat it: ")]
    again = shlex.split(told.removeprefix("to repeat it: "))[3:]
    assert main([*again, "logger=none", "pictures=false", "data.cache_dir=cache"]) == 0
    assert "finished already" in capsys.readouterr().out
