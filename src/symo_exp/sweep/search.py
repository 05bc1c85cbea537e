"""The end of a search by another sweeper, such as Optuna's."""

from __future__ import annotations

import math
import shlex
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from symo_exp.errors import ConfigError, Refused
from symo_exp.job.job import READS_FOLDERS
from symo_exp.shell import override_value, python_command
from symo_exp.sweep.compose import Composer
from symo_exp.tracking.page import COMMAND

RESULTS = "optimization_results.yaml"


class AnnounceBest(Callback):
    """Print the best trial of a search as a command that repeats it.

    Args:
        check_only: End the command before the first trial; the settings of trials are not known.
    """

    def __init__(self, *, check_only: bool = False) -> None:
        self._check_only = check_only

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Keep Optuna from announcing a study, whose trials are counted elsewhere.

        Raises:
            Refused: For numbers of trials with which Optuna fails or never ends.
            SystemExit: Without an error, if a search is only to be checked.
        """
        if "n_trials" in config.hydra.sweeper:
            for name in ("n_trials", "n_jobs"):
                if config.hydra.sweeper[name] < 1:
                    given = f"hydra.sweeper.{name}={config.hydra.sweeper[name]}"
                    told = f"{given}: expected a whole number of at least 1"
                    raise Refused(ConfigError(told))
            with suppress(ImportError):
                import optuna

                optuna.logging.set_verbosity(optuna.logging.WARNING)
        if self._check_only and not config.hydra.sweeper._target_.startswith(READS_FOLDERS):
            raise SystemExit(0)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Read the results that the sweeper has left in the folder of the sweep."""
        file = Path(config.hydra.sweep.dir, RESULTS)
        if "n_trials" not in config.hydra.sweeper or not file.is_file():
            return
        found = yaml.safe_load(file.read_text(encoding="utf-8"))
        if "best_params" not in found:  # several objectives have no single best trial
            return
        if not math.isfinite(found["best_value"]):
            print(f"no trial has a finite {config.optimized_metric}")
            raise SystemExit(1)  # as after a sweep with failed runs
        given = OverridesParser.create().parse_overrides(list(config.hydra.overrides.task))
        best = {key: override_value(value) for key, value in found["best_params"].items()}
        fixed = [
            str(override.input_line)
            for override in given
            if not override.is_sweep_override() and override.get_key_element() not in best
        ]
        chosen = [f"{key}={value}" for key, value in best.items()]
        loader = GlobalHydra.instance().config_loader()
        folder = Composer(loader, config).job([*fixed, *chosen], "").folder
        print(f"best trial: {config.optimized_metric} {found['best_value']:.4g}  {folder}")
        if about := folder.about():
            words = shlex.split(about.tags[COMMAND])[3:]
            print(f"to repeat it: {python_command('symo_exp', *words)}")
