"""The studies of a run: which are asked for, which are done, and where they are kept.

``studies/<name>.parquet`` holds the numbers of a study, ``studies/<name>.json`` its settings and
measures. The second is written last: with it, and with the same settings, a study is done.
Nothing here imports PyTorch, so that a sweep can tell quickly what is left to do.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symo_exp.files import write_whole
from symo_exp.tracking import artifacts

if TYPE_CHECKING:
    from symo_exp.evaluation.study import Finding

Settings = Mapping[str, Mapping[str, Any]]
"""By name: what the configuration says of each study that is asked for."""


def missing(asked: Settings, folder: Path) -> list[str]:
    """The studies that have not been done with these settings in the folder of a run."""
    return [name for name, settings in asked.items() if not _is_done(name, settings, folder)]


def keep(name: str, settings: Mapping[str, Any], finding: Finding, folder: Path) -> None:
    """Write what a study has found, whole or not at all."""
    import pyarrow
    import pyarrow.parquet

    (folder / artifacts.STUDIES).mkdir(parents=True, exist_ok=True)
    if finding.columns:
        table = pyarrow.table({key: x.numpy() for key, x in finding.columns.items()})
        write_whole(
            _path(folder, name, "parquet"),
            lambda file: pyarrow.parquet.write_table(table, file, compression="zstd"),
        )
    plain = {k: x if math.isfinite(x) else str(float(x)) for k, x in finding.measures.items()}
    text = json.dumps({"settings": dict(settings), "measures": plain}, indent=1) + "\n"
    write_whole(_path(folder, name, "json"), lambda file: file.write_text(text, encoding="utf-8"))


def _is_done(name: str, settings: Mapping[str, Any], folder: Path) -> bool:
    try:
        text = _path(folder, name, "json").read_text(encoding="utf-8")
        return bool(json.loads(text)["settings"] == dict(settings))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _path(folder: Path, name: str, suffix: str) -> Path:
    return folder / artifacts.STUDIES / f"{name}.{suffix}"
