"""How intervals that are widened by some recordings of a machine hold in the others.

    python results/uncertainty/recordings.py RUN

A run has learned a recorded machine. Test parts are not read. Of the training and validation
recordings each is left out in turn, and intervals are widened by the errors of the others, or of
the validation recordings among them alone; the model has been trained on most of them all the same.
A row has, means over the recordings left out, the shares of their configurations in their 90 %
intervals to 0.5, 1 and 2 s by both, and the ratio of the errors of validation windows to those of
training windows (geometric means of root mean squares to 1 s), as they are and over the sensitivity
to the start.
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor

import symo_exp
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.evaluation.horizon import HORIZONS, cut, predict
from symo_exp.evaluation.intervals import LEVEL, ROLLOUTS, relative_error
from symo_exp.models.uncertainty import quantile, sensitivity, spread
from symo_exp.runs.folder import RunFolder

HEAD = (
    "| machine | recordings | by the others | by validation alone | val. / train. errors "
    "| over sensitivity |\n|---|---|---|---|---|---|"
)


def parts(path: str, time_step: float) -> dict[str, list]:
    system = recorded_system(path, time_step=time_step, angular="all")
    data = RecordedData(system=system, path=path)
    data.setup()
    return {part: data.trajectories(part) for part in ("train", "val")}


def held(error: Tensor, variance: Tensor, sensitive: Tensor, kappa: Tensor, h: float) -> Tensor:
    """The shares to each horizon."""
    width = quantile(LEVEL) * (variance + (kappa * sensitive).square()).sqrt()
    inside = (error.abs() <= width).double().where(error.isfinite(), torch.nan)
    return torch.stack([inside[:, 1 : 1 + round(T / h)].nanmean() for T in HORIZONS])


def row(run: Path) -> str:
    path = RunFolder(run).config()["data"]["path"]
    model = symo_exp.load(run).double()
    if model.posterior is None:
        raise SystemExit(f"{run}: the model has no posterior; give a run of total_least_squares")
    h, recordings = model.time_step, parts(path, model.time_step)
    both = [*recordings["train"], *recordings["val"]]
    windows = cut(both, h, run_in=True)
    assert windows is not None
    found = predict(model, windows, model.input_matrix)
    rolled = found.q[:, 0], found.v[:, 0], windows.u[:, windows.lead :], found.q
    variance = spread(model.flow, model.posterior.parameters, *rolled, ROLLOUTS)
    fields = found.q - found.q_true, variance, sensitivity(model.flow, *rolled)
    of, first = windows.trajectory, len(recordings["train"])
    shares: dict[str, list[Tensor]] = {"others": [], "val": []}
    for left in of.unique():
        for key, by in (("others", of != left), ("val", (of != left) & (of >= first))):
            if by.any():
                kappa = relative_error(*(x[by] for x in fields), of[by])
                shares[key].append(held(*(x[of == left] for x in fields), kappa, h))
    cells = [
        ", ".join(f"{100 * x:.0f}" for x in torch.stack(rows).mean(0).tolist()) + " %"
        for rows in shares.values()
    ]
    error, _, sensitive = (x[:, 1 : 1 + round(1.0 / h)] for x in fields)
    for size in (error, error / sensitive):
        log = size.square().nanmean((1, 2)).sqrt().log()
        cells.append(f"{float((log[of >= first].mean() - log[of < first].mean()).exp()):.2g}")
    return f"| {Path(path).stem} | {len(both)} | {' | '.join(cells)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    torch.set_num_threads(1)
    print(HEAD)
    for run in parser.parse_args().runs:
        print(row(run), flush=True)
