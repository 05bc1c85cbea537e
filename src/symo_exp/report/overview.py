"""The report of any runs: its sections, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from symo_exp.report import curves, motions
from symo_exp.report.cells import at_step, cells, main_variant, usual_steps
from symo_exp.report.growth import growth
from symo_exp.report.looks import (
    letters,
    look,
    measure_name,
    number,
    pair_names,
    short,
    stroke,
)
from symo_exp.report.ranking import ranking
from symo_exp.report.runs import without_result
from symo_exp.report.tables import Table
from symo_exp.report.write import Section
from symo_exp.tracking.store import Store

TABLE = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")
FLOORS = ("test_mse", "integration_mse", "integration_mse_100", "valid_steps", "energy_mse")
ACCURACY = (*FLOORS, "inertia_mse_aligned", "training_seconds")


def sections(
    runs: pd.DataFrame, store: Store | None = None, beside: pd.DataFrame | None = None
) -> list[Section]:
    """Everything that can be said of the runs. Figures, ranks and floors are of one variant.

    ``store`` has the files of studies. ``beside`` are cells to draw with ours, such as published
    ones: the columns of ``cells``, and ``text``.
    """
    found, variant, steps = cells(runs), main_variant(runs), usual_steps(runs)
    usual = at_step(found, steps)
    drawn = pd.concat([usual[(usual.variant == variant) | (usual.source == "floor")], beside])
    mine = at_step(runs[(runs.variant == variant) & (runs.source == "ours")], steps)
    at_32 = mine[(mine.n_traj == curves.AT) & (mine.noise_std == 0)]
    floors, grown = runs[runs.source == "floor"], growth(runs)
    parts = [
        Section("state", "What has been run", state(runs, variant), [unfinished(runs)]),
        Section("sizes", "Errors over the size of the training set",
                figures=curves.data_size(drawn)),
        Section("noise", "Errors over noise", figures=curves.noise(drawn)),
        Section("motions", "Motions, and what was learned",
                figures=motions.figures(at_32, floors, store)),
        Section("floors", "Floors: the integrators alone", tables=[floor_table(usual)],
                figures=curves.steps(found)),
        Section("ranking", "Ranking", tables=[*ranks(mine)]),
        Section("accuracy", "Accuracy by settings", tables=[accuracy(found)],
                figures=curves.over_order(usual)),
        Section("growth", "Growth with the number of coordinates", tables=grown[0],
                figures=grown[1]),
        Section("time", "Accuracy against time", figures=curves.speed(runs)),
    ]  # fmt: skip
    return [part for part in parts if part]


def state(runs: pd.DataFrame, variant: str) -> list[str]:
    """How many runs there are, and of which sources they were made."""
    each = runs.drop_duplicates("run_id")
    if each.empty:
        return ["There are no runs yet: nothing can be told."]
    told = ", ".join(f"{n} {status.lower()}" for status, n in each.status.value_counts().items())
    finished = each[each.status == "FINISHED"]
    hours = finished.seconds.sum() / 3600
    lines = [f"{len(each)} runs: {told}. The finished ones trained for {hours:.1f} hours."]
    if revisions := sorted({r[:10] for r in finished.revision if r}):
        lines.append(f"Revisions: {', '.join(revisions)}.")
    if variant:
        lines.append(f"Figures and ranks are of the runs with {variant}.")
    return lines


def unfinished(runs: pd.DataFrame) -> Table:
    """Runs that are not finished, nor were by another."""
    left = without_result(runs)
    left = left.assign(method=pair_names(left), status=left.status.str.lower())
    left = left.rename(columns={"n_traj": "n", "noise_std": "noise"})
    left[["n", "noise", "seed"]] = left[["n", "noise", "seed"]].map(number)
    rows = left[["system", "method", "n", "noise", "seed", "status", "reason"]]
    return Table("unfinished", "Runs without a result", rows, words=2)


def accuracy(found: pd.DataFrame) -> Table:
    """Every variant, integrator and size that has been run without noise, system by system."""
    learned = found[(found.source == "ours") & ~(found.noise_std > 0)]
    keys = ["system", "n_traj", "variant", "method", "integrator", "time_step"]
    seeds = learned.groupby(keys, dropna=False).seeds.max().astype(str)
    wide = medians(learned, keys, ACCURACY).reset_index()
    rows = pd.DataFrame(
        {
            "system": wide.system,
            "n": wide.n_traj.map(number),
            "settings": wide.variant.replace("", "defaults"),
            "method": pair_names(wide),
            "seeds": seeds.to_numpy(),
        }
    ).join(wide.drop(columns=keys))
    notes = ["Medians over the seeds. Training: processor time of all optimiser steps."]
    title = "Accuracy by settings, method and integrator"
    return Table("accuracy", title, rows, notes, words=4)


def floor_table(found: pd.DataFrame) -> Table:
    """What the true systems miss in each integrator."""
    keys = ["system", "method", "integrator"]
    wide = medians(found[found.source == "floor"], keys, FLOORS).reset_index()
    rows = pd.concat(
        [wide.system, wide.integrator.map(lambda i: stroke(i).label),
         wide.method.map(lambda m: look(m).label).rename(""), wide.drop(columns=keys)], axis=1,
    )  # fmt: skip
    note = (
        "A learned model can lie below: it may learn part of its integrator's own error, at the "
        "price of a biased inertia."
    )
    title = "Floors: the true systems in the integrators, nothing learned"
    return Table("floors", title, rows, [note], words=3)


def medians(found: pd.DataFrame, keys: Sequence[str], metrics: Iterable[str]) -> pd.DataFrame:
    """Cells with a column for each of the measures, printed."""
    wide = found.groupby([*keys, "metric"], dropna=False)["median"].median().unstack()
    return wide.reindex(columns=list(metrics)).map(short).rename(columns=measure_name)


def ranks(runs: pd.DataFrame) -> Iterable[Table]:
    """For each system and for all together: the mean rank of each method by each measure."""
    clean = runs[~(runs.noise_std > 0)]
    systems = sorted(set(clean.system))
    for system in ["all systems", *systems] if len(systems) > 1 else systems:
        here = clean if system == "all systems" else clean[clean.system == system]
        found = pd.concat([ranking(here, m).assign(measure=measure_name(m)) for m in TABLE[1:]])
        interval = zip(found.low, found.high, strict=True)
        rows = pd.DataFrame(
            {
                "measure": found.measure,
                "method": pair_names(found),
                "mean rank": found["rank"].map("{:.2f}".format),
                "95 % interval": [f"{low:.2f} to {high:.2f}" for low, high in interval],
                "wins": found.best.map(lambda share: f"{100 * share:.0f} %"),
                "blocks": found.blocks.astype(str),
            }
        )
        note = (
            "A block is a system, a size of the training set and a seed for which every method "
            "has been run; the intervals are by resampling blocks."
        )
        yield Table(f"ranks_{letters(system)}", f"Ranking, {system}", rows, [note], words=2)
