"""The last intact checkpoint of a run, from which its training resumes."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import torch

from symo_exp.files import UnsoundError, read_state
from symo_exp.runs.folder import LAST, PREVIOUS

log = logging.getLogger(__name__)


class Saved(NamedTuple):
    """An intact checkpoint and its content."""

    path: Path
    state: dict[str, Any]

    @property
    def complete(self) -> bool:
        """True if nothing is left to train."""
        return bool(self.state["complete"])


def latest(folder: Path, run: str, model: torch.nn.Module) -> Saved | None:
    """Return the last checkpoint, else the previous one, else ``None``, and log the reason.

    Args:
        folder: Folder of the checkpoints.
        run: Digest of the run that they have to belong to.
        model: Module whose weights they have to fit.

    Raises:
        OSError: If the system does not read a file, which may be intact and stays.
        MemoryError: If its content finds no room.
    """
    for path in (folder / LAST, folder / PREVIOUS):
        try:
            return Saved(path, _read(path, run, model))
        except FileNotFoundError:
            continue
        except UnsoundError as error:
            log.warning("checkpoint %s is not used: %s", path, error)
            with suppress(OSError):  # else it would replace the previous one
                path.replace(path.with_suffix(".unsound"))
    return None


def _read(path: Path, run: str, model: torch.nn.Module) -> dict[str, Any]:
    state = read_state(path)
    wanted = {"state_dict", "run", "complete", "resumable", "random", "optimizer_states"}
    if not isinstance(state, dict) or not wanted <= state.keys():
        raise UnsoundError("it is not a checkpoint of a run")
    if state["run"] != run:
        raise UnsoundError("it belongs to another run")
    if not state["resumable"]:
        raise UnsoundError("the training diverged there")
    if _shapes(state["state_dict"]) != _shapes(model.state_dict()):
        raise UnsoundError("its weights are those of another model")
    return state


def _shapes(weights: Any) -> dict[str, tuple[torch.Size, torch.dtype]]:
    return {name: (value.shape, value.dtype) for name, value in weights.items()}
