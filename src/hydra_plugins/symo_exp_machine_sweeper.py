"""The search for the model of a machine as Hydra finds it: a sweeper by its plugin interface.

Hydra imports every plugin at each start, so what takes time to import is imported when it is used.
"""

from __future__ import annotations

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class SymoExpMachineSweeper(Sweeper):
    """A search over candidate models of recordings: see ``symo_exp.identify.search``.

    Args:
        budget: Of wall time.
        clock: Whether stages are left out when the search grossly overruns its budget, and
            trainings ended; on a busy machine the plan alone may decide.
        check_only: Whether nothing is run.
    """

    def __init__(
        self, budget: str | float = "10min", clock: bool = True, check_only: bool = False
    ) -> None:
        self.budget, self.clock, self.check_only = budget, clock, check_only

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Keep what Hydra hands over."""
        self.hydra_context, self.task_function, self.config = hydra_context, task_function, config

    def sweep(self, arguments: list[str]) -> Any:
        """Search; a command that did not end well ends with its exit code."""
        from symo_exp.identify.search import Search
        from symo_exp.sweep.sweeper import Sweep

        assert self.hydra_context is not None
        assert self.config is not None
        sweep = Sweep(self.hydra_context, self.task_function, self.config)
        search = Search(sweep, self.config, arguments, self.budget, clock=self.clock)
        if code := search.run(check_only=self.check_only):
            raise SystemExit(code)
