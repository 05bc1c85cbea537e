"""Metrics of the training loop."""

import copy
from functools import partial
from types import SimpleNamespace

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.models.objectives import Objective, Residuals
from symo_exp.optim.base import EpochOptimizer, minibatches
from symo_exp.optim.chained import Chained
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.training.checkpoint import Checkpoint
from symo_exp.training.divergence import DivergenceError, StopOnDivergence
from tests.models.methods import learner, windows
from tests.trainers import quiet_trainer


class Quiet(Objective):
    """An objective of a user's own: parameters alone, and two statistics."""

    def __call__(self, flow, windows):
        values = torch.stack([p.sum() for p in flow.parameters()]).unsqueeze(0)
        return Residuals(values, {"rows": torch.tensor(float(len(windows.q)))})


def test_metrics_of_an_epoch_are_those_of_its_steps(tmp_path):
    model = learner(
        "symo", "midpoint", 2, objective=Quiet(), optimizer=lambda p: torch.optim.SGD(p, lr=0.01)
    )
    twin, data = copy.deepcopy(model), windows(2, 12)
    batches = [[data.rows(slice(0, 4)), data.rows(slice(4, 12))]]
    loader = torch.utils.data.DataLoader(batches, batch_size=None)
    quiet_trainer(2, tmp_path).fit(model, loader)
    told = model.epoch_metrics
    assert {"train_loss", "lr", "step_ms", "training_seconds", "peak_memory", "rows"} == set(told)
    assert all(type(value) is float for value in told.values())
    assert told["rows"] == 6.0
    assert told["lr"] == 0.01
    optimizer = torch.optim.SGD(twin.parameters(), lr=0.01)
    *_, expected = [minibatches(optimizer, twin, batches[0])["train_loss"] for _ in range(2)]
    assert told["train_loss"] == float(expected)
    assert model.steps == 4


class Silent(EpochOptimizer):
    """An optimiser of a user's own that does not return its loss."""

    def epoch(self, model, batches):
        return None


def test_an_optimiser_that_returns_no_loss_is_named(tmp_path):
    model = learner("symo", "midpoint", 2, optimizer=partial(Silent, patience=1))
    loader = torch.utils.data.DataLoader([[windows(2, 4)]], batch_size=None)
    with pytest.raises(ConfigError, match=r"Silent\.epoch returns None: expected .*train_loss"):
        quiet_trainer(1, tmp_path).fit(model, loader)


SECOND_ORDER = partial(LevenbergMarquardt, patience=1)
RATES = {
    "a smaller optimizer.lr, another seed": torch.optim.Adam,
    "a smaller optimizer.first.lr, another seed": partial(
        Chained, first=torch.optim.Adam, epochs=1, then=SECOND_ORDER
    ),
    "another seed": SECOND_ORDER,
}
"""What to try, and the optimiser."""


@pytest.mark.parametrize("advice", RATES)
def test_the_advice_on_a_divergence_names_a_setting_of_the_optimiser(advice, tmp_path):
    model = learner("symo", "midpoint", 2)
    model.epoch_metrics = {"train_loss": float("nan")}
    optimizer = RATES[advice](model.parameters())
    trainer = SimpleNamespace(optimizers=[optimizer], current_epoch=0)
    with pytest.raises(DivergenceError, match=f"; try {advice} or dtype=float64"):
        StopOnDivergence(Checkpoint(tmp_path, 1.0)).on_train_epoch_end(trainer, model)
