"""Nothing that was logged is lost, and MLflow is called seldom."""

import math

import lightning
import pytest
import torch

from symo_exp.tracking.logger import BATCH, MlflowTracker
from symo_exp.tracking.none import NoTracker
from symo_exp.tracking.store import connect


@pytest.fixture
def tracker(store):
    return MlflowTracker(experiment="e", tracking_uri=store.uri)


def history(tracker, name):
    rows = connect(tracker.store).get_metric_history(tracker.run_id, name)
    return {row.step: row.value for row in rows}


def state(tracker):
    run = connect(tracker.store).get_run(tracker.run_id)
    return run.info.status, run.data.tags.get("reason")


class Calls:
    """Counts, and on demand refuses, the requests for metrics."""

    def __init__(self, tracker, monkeypatch):
        client = connect(tracker.store)
        self.count, self.away, send = 0, False, client.log_batch

        def log_batch(run_id, *args, metrics=(), **kwargs):
            self.count += bool(metrics)
            if self.away and metrics:
                raise ConnectionError("server away\nmore")
            send(run_id, *args, metrics=metrics, **kwargs)

        monkeypatch.setattr(client, "log_batch", log_batch)


def train(tracker, epochs):
    for epoch in range(epochs):
        tracker.log_metrics({"train_loss": 1.0 / (1 + epoch), "epoch": epoch}, step=7 * epoch)
        tracker.log_metrics({"val_loss": 2.0, "epoch": epoch}, step=7 * epoch)


def test_every_epoch_arrives_in_few_requests(tracker, monkeypatch):
    tracker._every = 1
    calls = Calls(tracker, monkeypatch)
    with tracker.run(name="r", parameters={"model": {"width": 24}}):
        train(tracker, 1000)
        tracker.finalize("success")
    assert history(tracker, "train_loss") == {k: 1.0 / (1 + k) for k in range(1000)}
    assert len(history(tracker, "val_loss")) == 1000
    assert calls.count <= 2000 / BATCH + 2
    run = connect(tracker.store).get_run(tracker.run_id)
    assert run.data.params == {"model.width": "24"}
    assert run.info.status == "FINISHED"
    assert tracker.run_id in tracker.address


def test_a_long_history_is_thinned_but_for_its_beginning_and_end(tracker):
    with tracker.run(name="r", parameters={}):
        train(tracker, 204)
    steps = set(history(tracker, "train_loss"))
    assert steps == set(range(100)) | set(range(100, 201, 5)) | {203}
    assert set(history(tracker, "val_loss")) == steps


def test_time_makes_it_send_too(tracker, monkeypatch):
    calls = Calls(tracker, monkeypatch)
    tracker._flush_seconds = 0.0
    with tracker.run(name="r", parameters={}):
        train(tracker, 1)
        assert calls.count == 2


def test_a_store_that_is_away_does_not_stop_the_training(tracker, monkeypatch, caplog):
    calls = Calls(tracker, monkeypatch)
    tracker._flush_seconds = 0.0
    with tracker.run(name="r", parameters={}):
        calls.away = True
        train(tracker, 90)
        assert calls.count == 1, "it must not ask again at every epoch"
        calls.away = False
        train(tracker, 100)
    assert len(history(tracker, "train_loss")) == 100
    assert "wait for the tracking store: ConnectionError: server away" in caplog.text


@pytest.mark.parametrize(
    ("error", "status", "reason"),
    [
        (RuntimeError("Newton\nhas lost"), "FAILED", "RuntimeError: Newton"),
        (KeyboardInterrupt(), "KILLED", "KeyboardInterrupt"),
        (SystemExit(143), "KILLED", "SystemExit: 143"),
    ],
)
def test_how_a_run_ends_is_told_and_what_was_logged_is_kept(tracker, error, status, reason):
    def job():
        with tracker.run(name="r", parameters={}):
            train(tracker, 3)
            raise error

    with pytest.raises(type(error)):
        job()
    assert state(tracker) == (status, reason)
    assert len(history(tracker, "train_loss")) == 3


def test_infinite_and_undefined_measures_survive(tracker):
    with tracker.run(name="r", parameters={}):
        tracker.log_measures({"test_mse": 0.5, "integration_mse": math.inf, "energy_std": math.nan})
    found = connect(tracker.store).get_run(tracker.run_id).data.metrics
    assert found["test_mse"] == 0.5
    assert found["integration_mse"] > 1.79e308  # the largest double stands for infinity in SQL
    assert math.isnan(found["energy_std"])


def test_the_run_folder_is_kept(tracker, tmp_path):
    folder = tmp_path / "run"
    for name in ("config.yaml", "checkpoints/last.ckpt", "pictures/energy.png", "other.log"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    with tracker.run(name="r", parameters={}):
        tracker.log_run_folder(folder)
    client = connect(tracker.store)
    listed = {x.path for x in client.list_artifacts(tracker.run_id)}
    assert listed == {"config.yaml", "checkpoints", "pictures"}
    assert [x.path for x in client.list_artifacts(tracker.run_id, "checkpoints")] == [
        "checkpoints/last.ckpt"
    ]


def test_a_run_is_continued(tracker, store):
    with tracker.run(name="r", parameters={"seed": 0}):
        train(tracker, 3)
    again = MlflowTracker(experiment="e", tracking_uri=store.uri, run_id=tracker.run_id)
    with again.run(name="r", parameters={"seed": 0}):
        train(again, 5)
    assert len(history(again, "train_loss")) == 5
    assert state(again) == ("FINISHED", None)


def test_logging_without_a_run_is_a_mistake_that_is_told(tracker):
    with pytest.raises(RuntimeError, match="no run is open"):
        tracker.log_measures({"test_mse": 1.0})


class Chunked(lightning.LightningModule):
    def __init__(self):
        super().__init__()
        self.automatic_optimization = False
        self.weight = torch.nn.Parameter(torch.zeros(()))

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)

    def training_step(self, batch, _):
        loss = (self.weight - 1).square()
        self.optimizers().zero_grad()
        loss.backward()
        self.optimizers().step()
        self.log("train_loss", loss, on_step=False, on_epoch=True, batch_size=1)

    def validation_step(self, batch, _):
        self.log("val_loss", self.weight, batch_size=1)


@pytest.mark.parametrize("tracker_", ["mlflow", "none"])
def test_lightning_logs_by_epoch(tracker_, tracker, tmp_path):
    used = tracker if tracker_ == "mlflow" else NoTracker()
    used.check()
    trainer = lightning.Trainer(
        max_epochs=4, logger=used, default_root_dir=tmp_path, accelerator="cpu",
        enable_progress_bar=False, enable_model_summary=False, enable_checkpointing=False,
        log_every_n_steps=1, inference_mode=False,
    )  # fmt: skip
    with used.run(name="r", parameters={}):
        trainer.fit(Chunked(), train_dataloaders=[[0]], val_dataloaders=[[0]])
        used.log_measures({"test_mse": 1.0})
        used.log_run_folder(tmp_path)
    if tracker_ == "mlflow":
        assert list(history(used, "train_loss")) == [0, 1, 2, 3]
        assert list(history(used, "val_loss")) == [0, 1, 2, 3]
        assert state(used) == ("FINISHED", None)
