"""From a tracking store to a tidy table."""

import math

import pytest

from symo_exp.configuration.command import jobs_of, parse
from symo_exp.errors import ConfigError
from symo_exp.recipe import parameters
from symo_exp.report import runs
from symo_exp.report.cells import cells
from symo_exp.report.variant import variant
from symo_exp.tracking.parent import end_parent, start_parent
from symo_exp.tracking.store import find
from tests.report.stores import MEASURES, add_run, folder_of
from tests.tables import choices


def test_a_row_for_each_run_and_measure(store):
    for seed in (0, 1):
        add_run(store, seed=seed, system="cartpole", n_traj=8, noise_std=1e-4)
    start_parent(experiment="thesis", directory=folder_of(store), name="a sweep")
    end_parent()
    found = runs.read(store, ["thesis"])
    assert len(found.table) == 2
    assert len(found.measures) == 2 * len(MEASURES)
    row = found.measures[(found.measures.seed == 1) & (found.measures.metric == "test_mse")].iloc[0]
    assert (row.system, row.method, row.integrator) == ("cartpole", "symo", "midpoint")
    assert (row.n_traj, row.noise_std, row.time_step) == (8, 1e-4, 0.05)
    assert row.value == MEASURES["test_mse"]
    assert row.variant == ""
    assert row.seconds == MEASURES["training_seconds"]


def test_what_diverged_is_infinite_again_and_what_is_undefined_stays_so(store):
    add_run(store, metrics={"integration_mse": math.inf, "integration_std": math.nan})
    values = runs.read(store, ["thesis"]).measures.set_index("metric").value
    assert values["integration_mse"] == math.inf
    assert math.isnan(values["integration_std"])


def test_of_runs_that_are_the_same_the_last_that_finished_counts(store):
    add_run(store, metrics={"test_mse": 1.0})
    add_run(store, metrics={"test_mse": 2.0})
    add_run(store, metrics={"test_mse": 3.0}, status="FAILED", reason="power cut")
    add_run(store, status="RUNNING")
    found = runs.read(store, ["thesis"])
    assert list(found.measures.value) == [2.0]
    assert sorted(found.table.status) == ["FAILED", "FINISHED", "FINISHED", "RUNNING"]
    assert "power cut" in list(found.table.reason)


def test_only_what_is_asked_for(store):
    for system in ("pendulum", "acrobot"):
        for seed in (0, 1, 2):
            add_run(store, system=system, seed=seed)
    add_run(store, experiment="other", seed=7)
    narrowed = runs.read(store, ["thesis"], systems=["acrobot"], seeds=[0, 2]).table
    assert sorted(zip(narrowed.system, narrowed.seed, strict=True)) == [
        ("acrobot", 0), ("acrobot", 2),
    ]  # fmt: skip
    assert len(runs.read(store, ["thesis", "other"]).table) == 7


def test_a_large_store_is_read_in_pages(store, monkeypatch):
    for seed in range(5):
        add_run(store, seed=seed)
    monkeypatch.setattr(runs, "PAGE", 2)
    asked = []
    client = runs.connect(store)
    monkeypatch.setattr(runs, "connect", lambda _: _Counting(client, asked))
    assert len(runs.read(store, ["thesis"]).table) == 5
    assert asked == ["search_experiments", *["search_runs"] * 3]


class _Counting:
    def __init__(self, client, asked):
        self._client, self._asked = client, asked

    def __getattr__(self, name):
        self._asked.append(name)
        return getattr(self._client, name)


def test_what_is_not_there_is_said_in_a_line(store, tmp_path):
    add_run(store, experiment="other")
    with pytest.raises(ConfigError, match=r"no experiment 'thesis' in .*; it has: other"):
        runs.read(store, ["thesis"])
    with pytest.raises(ConfigError, match="no tracking store at"):
        runs.read(find(None, tmp_path / "nowhere"), ["thesis"])
    assert not (tmp_path / "nowhere").exists()


def test_a_median_of_infinite_values_is_no_undefined_one(store):
    for seed, value in enumerate((1.0, math.inf, math.inf)):
        add_run(store, seed=seed, metrics={"test_mse": value})
    (cell,) = cells(runs.read(store, ["thesis"]).measures).to_dict("records")
    assert (cell["seeds"], cell["median"], cell["low"]) == (3, math.inf, 1.0)


def told(*words):
    (job,) = jobs_of(parse(words)).jobs
    files = {"trainer": "cpu", "logger": "mlflow", "data": "simulated", "pair": "none"}
    plain = dict(word.split("=") for word in words if "." not in word)
    chosen = {g: plain.get(g, _default(job, g)) for g in ("optimizer", "scheduler", "root")}
    named = {g: plain.get(g, d) for g, d in _CHOICES.items()}
    return {k: str(v) for k, v in parameters(job.config, files | chosen | named).items()}


_CHOICES = {
    "model": "e2e_symo",
    "system": "pendulum",
    "integrator": "midpoint",
    "preset": "default",
}


def _default(job, group):
    if group == "root":
        return "newton"
    second_order = "Chained" in str(job.config.optimizer)
    return {"optimizer": ("adam", "adam_then_lm"), "scheduler": ("plateau", "none")}[group][
        second_order
    ]


@pytest.mark.parametrize("preset", choices("preset"))
@pytest.mark.parametrize("system", choices("system"))
def test_what_ships_is_no_variant_but_by_its_name(system, preset, workplace):
    """The report reads the files themselves: it must come to what Hydra composes from them."""
    words = [f"preset={preset}", f"system={system}"]
    if preset in ("fast", "accurate"):  # they choose these two
        words += ["model=symo", "integrator=galerkin6"]
    assert variant(told(*words)) == ("" if preset == "default" else preset)


@pytest.mark.parametrize("model", choices("model"))
def test_no_model_is_a_variant_of_its_own(model, workplace):
    integrator = "rk4" if model == "true_ode" else "midpoint"
    assert variant(told(f"model={model}", f"integrator={integrator}")) == ""


def test_whatever_else_is_set_is_the_variant(workplace):
    words = [
        "model=symo",
        "trainer.max_epochs=10",
        "data.n_traj=8",
        "data.noise_std=1e-3",
        "seed=3",
    ]
    assert variant(told(*words)) == "trainer.max_epochs=10"
    assert variant(told("model=symo", "system.time_step=0.01")) == ""
    assert variant(told("optimizer=lbfgs")) == "optimizer=lbfgs"
    assert variant(told("preset=thesis", "learning_rate=1e-3")) == "thesis, learning_rate=0.001"
    assert variant(told("model.width=16")) == "model.width=16"
    assert variant(told("learning_rate=1.0e-4", "pictures=false", "experiment=x")) == ""


def test_what_follows_from_another_setting_is_no_variant_unless_set_itself(workplace):
    cartpole = ("model=symo", "system=cartpole")
    assert variant(told(*cartpole)) == variant(told(*cartpole, "data.noise_std=1e-3")) == ""
    noisy = told(*cartpole, "data.noise_std=1e-3", "learning_rate=1e-3")
    assert variant(noisy) == "learning_rate=0.001"
    assert variant(told("optimizer.lr=5e-4")) == "optimizer.lr=0.0005"
    assert variant(told("learning_rate=5e-4")) == "learning_rate=0.0005"
