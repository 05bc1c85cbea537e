"""The files of a run say what they should, and are never half-written."""

import math

import pandas
import pytest
import torch
import yaml

from symo_exp.evaluation.evaluate import evaluate
from symo_exp.tracking import artifacts
from tests.oscillator import Exact, data, oscillator


def test_rollouts_are_a_tidy_table(tmp_path):
    system = oscillator(2)
    model = Exact(system, system, 0.1, fails_from=25)
    rollouts = evaluate(model, system, data(system, 0.1)).rollouts
    table = pandas.read_parquet(artifacts.write_rollouts(tmp_path, rollouts))
    assert list(table.columns) == [
        "trajectory", "step", "t", "q_q0", "q_q1", "v_q0", "v_q1", "q_true_q0", "q_true_q1",
        "v_true_q0", "v_true_q1", "energy", "energy_true", "converged",
    ]  # fmt: skip
    assert len(table) == 3 * 31
    row = table[(table.trajectory == 2) & (table.step == 7)].iloc[0]
    assert row.t == pytest.approx(0.7)
    assert row.q_q1 == rollouts.q[2, 7, 1].item()
    assert row.v_true_q0 == rollouts.v_true[2, 7, 0].item()
    assert row.energy == rollouts.energy[2, 7].item()
    assert table.q_q0.isna().sum() == 3 * 5
    assert (~table.converged).sum() == 3 * 5


def test_measures_are_json_even_when_they_are_not_finite(tmp_path):
    measures = {"test_mse": 1e-9, "integration_mse": math.inf, "energy_std": math.nan}
    text = artifacts.write_measures(tmp_path, measures).read_text()
    assert "Infinity" not in text
    assert "NaN" not in text
    back = artifacts.read_measures(tmp_path)
    assert back["test_mse"] == 1e-9
    assert back["integration_mse"] == math.inf
    assert math.isnan(back["energy_std"])


def test_the_config_is_plain_yaml(tmp_path):
    config = {"model": {"_target_": "symo_exp.models.symo.SyMo", "width": 24}, "rate": 1e-4}
    assert yaml.safe_load(artifacts.write_config(tmp_path, config).read_text()) == config


def test_a_failed_write_leaves_the_old_file_and_no_rubbish(tmp_path):
    artifacts.write_config(tmp_path, {"seed": 0})
    with pytest.raises(yaml.YAMLError):
        artifacts.write_config(tmp_path, {"seed": torch.zeros(1)})
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]
    assert "seed: 0" in (tmp_path / "config.yaml").read_text()
