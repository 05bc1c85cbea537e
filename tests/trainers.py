"""A trainer of Lightning that neither logs nor prints."""

from pathlib import Path

import lightning


def quiet_trainer(epochs: int, folder: Path) -> lightning.Trainer:
    return lightning.Trainer(
        max_epochs=epochs, accelerator="cpu", logger=False, enable_checkpointing=False,
        enable_progress_bar=False, enable_model_summary=False, num_sanity_val_steps=0,
        inference_mode=False, default_root_dir=folder,
    )  # fmt: skip
