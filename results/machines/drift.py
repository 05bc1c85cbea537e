"""Measure the drift of a model fitted to the error over long pieces, on other motions.

    python results/machines/drift.py halves FILE FOLDER
    python results/machines/drift.py refine RUN EPOCHS

The first joins the training and validation recordings of a file, pieces of one motion, and cuts it
in two: first.parquet and second.parquet train on one half and validate on the other. The second
fits the model of a run to its whole training part by epochs of Levenberg-Marquardt.
"""

import sys
from pathlib import Path

import pandas as pd

from symo_exp.evaluation.horizon import HORIZONS, cut, median, predict, whole_error
from symo_exp.identify.fits import ITERATIONS
from symo_exp.models.horizon import HorizonError
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.runs.folder import RunFolder
from symo_exp.runs.load import divided_recordings, from_folder
from symo_exp.training.learner import Learner


def halves(file: str, folder: str) -> None:
    table = pd.read_parquet(file).query("split != 'test'")
    order = table.trajectory.str.extract(r"(\d+)$")[0].astype(int)  # pieces are numbered in time
    pieces = [piece.copy() for _, piece in table.groupby(order)]
    step, end = float(pieces[0].t.diff().median()), 0.0
    for piece in pieces:
        piece["t"] += end
        end = float(piece.t.iloc[-1]) + step
    whole = pd.concat(pieces)
    parts = whole.iloc[: len(whole) // 2], whole.iloc[len(whole) // 2 :]
    for name, (train, other) in {"first": parts, "second": parts[::-1]}.items():
        split = [train.assign(split="train", trajectory="a")]
        split += [other.assign(split=s, trajectory=s) for s in ("val", "test")]
        pd.concat(split).to_parquet(Path(folder) / f"{name}.parquet", index=False)


def refine(run: str, epochs: str) -> None:
    model, data = from_folder(Path(run)), divided_recordings(RunFolder(run))
    h, place = model.time_step, model.input_matrix

    def show() -> None:
        windows = cut(data.val, h, run_in=True)
        assert windows is not None
        found = predict(model, windows, place, iterations=ITERATIONS)
        short = " / ".join(f"{median(found.rmse(t)):.2g}" for t in HORIZONS)
        wholes = (whole_error(model, part, place) for part in (data.train, data.val))
        print(short, "held out; whole, training and held out:", *(f"{x:.2g}" for x in wholes))

    show()
    steps = min(len(one.q) for one in data.train) // 50 * 50
    objective = HorizonError(horizon=steps, huber=None, grow=0)
    learner = Learner(model, objective=objective)
    for p in model.parameters():
        p.requires_grad_(requires_grad=True)
    optimizer, batches = LevenbergMarquardt(model.parameters()), [objective.cut(data.train)]
    for epoch in range(int(epochs)):
        batches = objective.prepare(model.flow, batches, epoch)
        optimizer.epoch(learner, batches)
    show()


if __name__ == "__main__":
    {"halves": halves, "refine": refine}[sys.argv[1]](*sys.argv[2:])
