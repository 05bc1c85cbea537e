"""A store of its own for each test."""

from pathlib import Path

import pytest

from symo_exp.tracking.store import Store, find
from tests.tiny import copy_store


@pytest.fixture(autouse=True)
def _no_ambient_tracking(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MLFLOW_TRACKING_URI", "SYMO_EXP_PARENT_RUN"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def store(database: Path, tmp_path: Path) -> Store:
    copy_store(database, tmp_path)
    return find(None, tmp_path / "mlruns")
