"""Compare the time and the results of rollouts that solve ten steps at once, or one by one.

    python results/machines/stretches.py RUN

Predicts the windows of the validation part of a run as its validations do, first step by step.
"""

import sys
import time
from unittest import mock

import symo_exp
from symo_exp.evaluation.horizon import cut, predict
from symo_exp.identify.fits import ITERATIONS
from symo_exp.models.flows import VariationalFlow
from symo_exp.runs.folder import RunFolder
from symo_exp.runs.load import divided_recordings


def main(run: str) -> None:
    model, data = symo_exp.load(run), divided_recordings(RunFolder(run))
    windows = cut(data.val, model.time_step, run_in=True)
    assert windows is not None
    errors, times = [], []
    for together in (False, True):
        start = time.process_time()
        with mock.patch.object(VariationalFlow, "solves_stretches", together):
            found = predict(model, windows, model.input_matrix, iterations=ITERATIONS)
        times.append(time.process_time() - start)
        errors.append(float(found.errors().nanmean().sqrt()))
    change = errors[1] / errors[0] - 1
    print(f"{times[0]:.2f} s step by step, {times[1]:.2f} s ten at once: {times[0] / times[1]:.1f} "
          f"times faster; the error changes by {change:.1e} of itself")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1])
