"""The answer of a search: its candidates, its best model and the verdict."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from symo_exp.evaluation.verdict import comparison, verdict
from symo_exp.identify.doubts import doubts, hopeless, missed
from symo_exp.identify.recordings import Machine
from symo_exp.identify.table import candidates_table, unit_of_held_out, write_candidates
from symo_exp.identify.validation import Trial
from symo_exp.runs.folder import BEST, CANDIDATES, RunFolder


class Answer:
    """Prints what a search finds and keeps it in the folder of the search.

    Args:
        folder: Where the link to the best model and the table of candidates go.
        machine: The recorded machine.
        folds: Of the cross-validation.
    """

    def __init__(self, folder: Path, machine: Machine, folds: int) -> None:
        self._folder, self._machine, self._folds = folder, machine, folds
        self._unit = ", ".join(machine.coordinates.units_of_errors)
        self._unit_of_held_out = unit_of_held_out(machine.coordinates, machine.units)

    def keep(self, fit: RunFolder, trials: Sequence[Trial]) -> None:
        """Keep the best fit and the candidates so far."""
        self.link(fit)
        with suppress(OSError):  # a full disk; the table is written again
            write_candidates(self._folder / CANDIDATES, trials, None, self._unit_of_held_out)

    def link(self, folder: RunFolder) -> Path:
        """Link ``BEST`` to a run and return it; where that is impossible, name and return the run.

        There may be a folder of that name, as in a copy of a search, or links may be impossible.
        """
        link, new = self._folder / BEST, self._folder / f".{BEST}.{os.getpid()}"
        try:
            new.unlink(missing_ok=True)
            new.symlink_to(os.path.relpath(folder.path, self._folder), target_is_directory=True)
            os.replace(new, link)
        except OSError as error:
            new.unlink(missing_ok=True)
            print(f"{os.path.relpath(link)} is no link ({error.strerror}); the best is {folder}")
            return folder.path
        return link

    def summarise(self, trials: Sequence[Trial], best: Trial | None) -> None:
        """Print and keep the table of candidates."""
        print(candidates_table(trials, best, self._folds, self._unit_of_held_out))
        write_candidates(self._folder / CANDIDATES, trials, best, self._unit_of_held_out)

    def give_up(self) -> int:
        """Print that there is no model, with possible reasons; return the exit code."""
        print("verdict: no model")
        self._tell(doubts(self._machine))
        return 1

    def judge(self, measures: Mapping[str, float], error: float, model: Path) -> int:
        """Print the verdict on a model, from its measures on the test part; return the exit code.

        It is 0 for a model that may be used, and 1 if the verdict is "no model".

        Args:
            measures: Those of the model.
            error: The noise of its fit, infinite where it is unknown.
            model: The link to its run, or the folder.
        """
        label = verdict(measures) or "not judged"
        if failed := hopeless(measures, self._machine.horizon):
            bad = label.startswith("no")
            label = f"no model; {label if bad else 'hardly better than constant velocity'}"
        print(f"verdict on the test part: {label}")
        beside = comparison(measures, self._unit)
        if beside is not None:
            print(f"  {beside}")
        if "open_loop_rmse" in measures:
            whole = f"{measures['open_loop_rmse']:.2g} {self._unit}"
            print(f"  RMSE over whole test recordings, in open loop from their start: {whole}")
        if not label.startswith("good"):
            reasons = [*missed(self._machine, error, self._unit_of_held_out)]
            self._tell([*doubts(self._machine), *reasons] if failed or beside is None else reasons)
        print(f'the model: symo_exp.load("{os.path.relpath(model)}")')
        return int(failed)

    @staticmethod
    def _tell(reasons: Iterable[str]) -> None:
        for line in reasons:
            print(f"  possible reason: {line}")
