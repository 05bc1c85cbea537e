"""The sweeper of symo_exp, in the namespace where Hydra looks for plugins.

Hydra imports every plugin at each start, so that slow imports stand where they are used.
"""

from __future__ import annotations

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class SymoExpSweeper(Sweeper):
    """Sweeper that runs every combination of what is swept: see ``symo_exp.sweep.sweeper``.

    Args:
        params: Settings to sweep and their values, besides those of the command line.
        check_only: Check the jobs and run none.
    """

    def __init__(self, params: DictConfig | None = None, check_only: bool = False) -> None:
        self.params, self.check_only = params, check_only

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Keep what Hydra hands over."""
        self.hydra_context, self.task_function, self.config = hydra_context, task_function, config

    def sweep(self, arguments: list[str]) -> Any:
        """Run all jobs; exit with the code of the command unless all finished."""
        from symo_exp.sweep.sweeper import Sweep

        assert self.hydra_context is not None
        assert self.config is not None
        sweep = Sweep(self.hydra_context, self.task_function, self.config)
        if code := sweep.run(arguments, self.params or {}, check_only=self.check_only):
            raise SystemExit(code)
