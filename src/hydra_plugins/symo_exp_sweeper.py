"""The sweeper of symo_exp as Hydra finds it: plugins live in this namespace.

Hydra imports every plugin at each start, so what takes time to import is imported when it is used.
"""

from __future__ import annotations

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class SymoExpSweeper(Sweeper):
    """Every combination of what is swept: see ``symo_exp.sweep.sweeper``.

    ``params`` are swept besides what the command line says. With ``check_only`` nothing is run.
    """

    def __init__(self, params: DictConfig | None = None, check_only: bool = False) -> None:
        self.params, self.check_only = params, check_only

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """What Hydra hands over."""
        self.hydra_context, self.task_function, self.config = hydra_context, task_function, config

    def sweep(self, arguments: list[str]) -> Any:
        """Do all jobs; a command that did not end well ends with its exit code."""
        from symo_exp.sweep.sweeper import Sweep

        assert self.hydra_context is not None
        assert self.config is not None
        sweep = Sweep(self.hydra_context, self.task_function, self.config)
        if code := sweep.run(arguments, self.params or {}, check_only=self.check_only):
            raise SystemExit(code)
