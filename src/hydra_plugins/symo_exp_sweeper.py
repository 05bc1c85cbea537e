"""The sweepers of symo_exp, in the namespace where Hydra looks for plugins.

Hydra imports every plugin at each start, so that slow imports stand where they are used.
"""

from __future__ import annotations

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from symo_exp.checks import truth


class SymoExpSweeper(Sweeper):
    """Sweeper that runs every combination of what is swept: see ``symo_exp.sweep.sweeper``.

    Args:
        params: Settings to sweep and their values, besides those of the command line.
        check_only: Check the jobs and run none.
    """

    def __init__(self, params: DictConfig | None = None, check_only: bool = False) -> None:
        self.params = params
        self.check_only = truth("hydra.sweeper.check_only", check_only)

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
        if code := self.run(sweep, arguments):
            raise SystemExit(code)

    def run(self, sweep: Any, arguments: list[str]) -> int:
        """Run the jobs of these overrides and return the exit code."""
        params = {} if self.params is None else self.params
        code: int = sweep.run(arguments, params, check_only=self.check_only)
        return code


class SymoExpMachineSweeper(SymoExpSweeper):
    """A search over candidate models of recordings: see ``symo_exp.identify.search``.

    Args:
        budget: Of wall time.
        clock: Whether stages are left out when the search grossly overruns its budget, and
            trainings ended; on a busy machine the plan alone may decide.
        check_only: Say what the recordings show and what is planned, and run nothing.
    """

    def __init__(
        self, budget: str | float = "10min", clock: bool = True, check_only: bool = False
    ) -> None:
        super().__init__(check_only=check_only)
        self.budget, self.clock = budget, truth("hydra.sweeper.clock", clock)

    def run(self, sweep: Any, arguments: list[str]) -> int:
        """Search and return the exit code."""
        from symo_exp.identify.search import Search

        assert self.config is not None
        search = Search(sweep, self.config, arguments, self.budget, clock=self.clock)
        return search.run(check_only=self.check_only)
