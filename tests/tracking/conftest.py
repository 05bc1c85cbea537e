"""A store of its own for each test."""

import shutil
from pathlib import Path

import pytest

from symo_exp.tracking.store import Store, find


@pytest.fixture(autouse=True)
def _no_ambient_tracking(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MLFLOW_TRACKING_URI", "SYMO_EXP_PARENT_RUN"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def store(database: Path, tmp_path: Path) -> Store:
    (tmp_path / "mlruns").mkdir()
    shutil.copy(database, tmp_path / "mlruns" / "mlflow.db")
    return find(None, tmp_path / "mlruns")
