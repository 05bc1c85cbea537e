"""The Lightning trainer, without anything that takes time between optimiser steps."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import lightning
import torch
from lightning.pytorch.plugins.environments import LightningEnvironment

from symo_exp.checks import real, whole_number
from symo_exp.errors import ConfigError
from symo_exp.training.allocator import keep_freed_memory
from symo_exp.training.checkpoint import Checkpoint, WholeFiles
from symo_exp.training.compiling import CompileTraining
from symo_exp.training.divergence import StopOnDivergence
from symo_exp.training.overrun import StopOverrun
from symo_exp.training.progress import ProgressBar

MOST_THREADS = 4096
"""More than machines have cores; each thread takes memory."""


def make_trainer(
    *,
    accelerator: Literal["cpu", "gpu"],
    max_epochs: int,
    validate_every: int,
    checkpoint_every: float,
    progress: bool,
    threads: int,
    compile: bool | str,
    folder: Path,
    run: str = "",
    kernels: str = "",
    time_limit: float | None = None,
    callbacks: Sequence[lightning.Callback] = (),
) -> lightning.Trainer:
    """Return a trainer whose Lightning batch is a whole epoch (see ``TrajectoryData``).

    Args:
        accelerator: Device of the training.
        max_epochs: Number of epochs.
        validate_every: Epochs between two validations.
        checkpoint_every: Least time between two checkpoints [s].
        progress: Whether to show a progress bar on a terminal.
        threads: Threads of the whole process; with more than one, jobs of a sweep that share the
            cores slow each other down.
        compile: Whether to compile the training step: see ``CompileTraining``.
        folder: Folder of the checkpoints.
        run: Digest of the run that the checkpoints belong to.
        kernels: Digest of the settings that compiled kernels depend on.
        time_limit: Processor time of all starts after which the training is ended [s]; ``None``: no
            limit.
        callbacks: Callbacks that are called before those of the trainer.

    Raises:
        ConfigError: If an argument is out of range or there is no GPU.
    """
    whole_number("trainer.max_epochs", max_epochs)
    whole_number("trainer.validate_every", validate_every)
    whole_number("trainer.threads", threads, high=MOST_THREADS)
    if not checkpoint_every >= 0:
        raise ConfigError(f"trainer.checkpoint_every={checkpoint_every} must be 0 or more seconds")
    if compile not in (True, False, "auto"):
        raise ConfigError(f"trainer.compile={compile} must be true, false or auto")
    _settle(accelerator, threads)
    checkpoint = Checkpoint(folder, checkpoint_every, run)
    bar: list[lightning.Callback] = [ProgressBar()] if progress else []
    limit = None if time_limit is None else real("trainer.time_limit", time_limit, above=0)
    ours = [StopOnDivergence(checkpoint), checkpoint, StopOverrun(limit)]
    return lightning.Trainer(
        accelerator=accelerator,
        devices=1,
        max_epochs=max_epochs,
        check_val_every_n_epoch=min(validate_every, max_epochs),  # at the end at least
        num_sanity_val_steps=0,
        inference_mode=False,  # a Lagrangian is differentiated in validation, too
        logger=False,
        callbacks=[*callbacks, *ours, *bar, CompileTraining(compile, kernels)],
        # a run is one process on a cluster too; Lightning's own requeueing and its choice of a
        # checkpoint would interfere with ours
        plugins=[WholeFiles(), LightningEnvironment()],
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=folder,
    )


def _settle(accelerator: str, threads: int) -> None:
    """Apply the settings of the whole process."""
    if accelerator == "gpu" and not torch.cuda.is_available():
        raise ConfigError("trainer.accelerator=gpu, but PyTorch finds no GPU here; use trainer=cpu")
    torch.set_num_threads(threads)
    keep_freed_memory()
    # Lightning's advice does not apply to data in memory, one item an epoch and one process
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    advice = ("does not have many workers", "number of training batches", "LeafSpec", "`srun`")
    for message in advice:
        warnings.filterwarnings("ignore", message=f".*{message}.*")
