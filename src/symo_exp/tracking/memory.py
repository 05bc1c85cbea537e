"""Which run of the store belongs to a run folder, so that a resumed run goes on with it."""

from __future__ import annotations

import json
from pathlib import Path

from symo_exp.files import write_whole
from symo_exp.tracking.store import Store

FILE = "tracking.json"


def recall(folder: Path, store: Store) -> str | None:
    """The id of the run in this store; nothing where there is none that can be read."""
    try:
        known = json.loads((folder / FILE).read_text(encoding="utf-8"))
        return str(known["run_id"]) if known["store"] == str(store) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def remember(folder: Path, store: Store, run_id: str) -> None:
    text = json.dumps({"store": str(store), "run_id": run_id}) + "\n"
    write_whole(folder / FILE, lambda path: path.write_text(text, encoding="utf-8"))


def forget(folder: Path) -> None:
    (folder / FILE).unlink(missing_ok=True)
