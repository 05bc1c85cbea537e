"""The last intact checkpoint of a run, from which its training resumes."""

from __future__ import annotations

import io
import logging
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import torch

from symo_exp.errors import first_line
from symo_exp.training.checkpoint import LAST, PREVIOUS

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
        except _UnsoundError as error:
            log.warning("checkpoint %s is not used: %s", path, error)
            with suppress(OSError):  # else it would replace the previous one
                path.replace(path.with_suffix(".unsound"))
    return None


class _UnsoundError(Exception):
    pass


def _read(path: Path, run: str, model: torch.nn.Module) -> dict[str, Any]:
    content = io.BytesIO(path.read_bytes())  # at once: all later errors are those of the content
    try:
        if not content.getbuffer():
            raise _UnsoundError("it is empty")
        with zipfile.ZipFile(content) as archive:
            damaged = archive.testzip()  # checks all its parts
        if damaged is not None:
            raise _UnsoundError(f"{damaged} in it is damaged")
        content.seek(0)
        state = torch.load(content, map_location="cpu", weights_only=True)
    except zipfile.BadZipFile:
        raise _UnsoundError("it is not a complete file") from None
    except Exception as error:  # damaged in another way, or of another program
        if isinstance(error, _UnsoundError | MemoryError):
            raise
        raise _UnsoundError(f"it cannot be read ({first_line(error)})") from None
    wanted = {"state_dict", "run", "complete", "resumable", "random", "optimizer_states"}
    if not isinstance(state, dict) or not wanted <= state.keys():
        raise _UnsoundError("it is not a checkpoint of a run")
    if state["run"] != run:
        raise _UnsoundError("it belongs to another run")
    if not state["resumable"]:
        raise _UnsoundError("the training diverged there")
    if _shapes(state["state_dict"]) != _shapes(model.state_dict()):
        raise _UnsoundError("its weights are those of another model")
    return state


def _shapes(weights: Any) -> dict[str, tuple[torch.Size, torch.dtype]]:
    return {name: (value.shape, value.dtype) for name, value in weights.items()}
