"""Fixtures of all tests."""

import gc
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch is imported

import pytest
import torch
from jaxtyping import install_import_hook

from tests import composed, shapes
from tests.tiny import copy_store

gc.disable()  # until tests run: what is imported and collected stays

# The shapes in the signatures of the mathematics are checked wherever a test calls it. (Not in
# modules of protocols, which beartype cannot check.)
install_import_hook(
    [
        "symo_exp.mechanics.euler_lagrange",
        "symo_exp.mechanics.explicit",
        "symo_exp.mechanics.lagrangian",
        "symo_exp.nets",
        "symo_exp.evaluation.measures",
    ],
    "tests.shapes.checked",
)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop():
    """Look for garbage seldom, and not among what is imported: it took a tenth of the time."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def _composed_once():
    with composed.once():
        yield


@pytest.fixture(autouse=True)
def _shapes():
    shapes.begin()


@pytest.fixture(autouse=True)
def _no_settings_of_the_shell(monkeypatch):
    for name in ("MLFLOW_TRACKING_URI", "SYMO_EXP_DEBUG", "HYDRA_FULL_ERROR"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(autouse=True)
def _gpu(request):
    if request.node.get_closest_marker("gpu") and not torch.cuda.is_available():
        pytest.skip("no GPU here")


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """An empty folder to run commands in, with a store and a cache of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def database(tmp_path_factory):
    """A store made once, then copied: MLflow takes seconds to make one."""
    from symo_exp.tracking.store import connect, find

    store = find(None, tmp_path_factory.mktemp("template"))
    connect(store)
    return store.database


@pytest.fixture
def store(database, tmp_path):
    """A store where commands look for one."""
    from symo_exp.tracking.store import find

    copy_store(database, tmp_path)
    return find(None, tmp_path / "mlruns")
