"""The report of any runs: its sections in reading order."""

from __future__ import annotations

import pandas as pd

from symo_exp.report import curves, held_out, motions
from symo_exp.report.answer import answers, other_settings
from symo_exp.report.cells import (
    DEFAULTS,
    Compared,
    at_step,
    cells,
    medians,
    table_note,
    usual_steps,
)
from symo_exp.report.document import Section
from symo_exp.report.growth import growth
from symo_exp.report.looks import duration, look, number, pair_names, stroke
from symo_exp.report.runs import without_result
from symo_exp.report.tables import ResultTable
from symo_exp.tracking.store import Store
from symo_exp.words import counted

TABLE = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")
FLOORS = ("test_mse", "integration_mse", "integration_mse_100", "valid_steps", "energy_mse")
ACCURACY = (*FLOORS, "inertia_mse_aligned", "training_seconds")


def sections(
    runs: pd.DataFrame,
    compared: Compared,
    store: Store | None = None,
    others: pd.DataFrame | None = None,
) -> list[Section]:
    """Return the answer, the figures, and folded the tables that they rest on.

    Args:
        runs: The tidy table of runs (``report.runs``).
        compared: The settings of the answer and of the figures.
        store: Where the files of studies are, unless in folders.
        others: Cells drawn beside these, such as published ones: the columns of ``cells``, and
            ``text``.
    """
    every, recorded = runs, runs[runs.recording != ""]
    runs, variant = runs[runs.recording == ""], compared.variant
    found, steps = cells(runs), usual_steps(runs)
    usual = at_step(found, steps)
    drawn = pd.concat([usual[(usual.variant == variant) | (usual.source == "floor")], others])
    said, heat_maps = answers(at_step(runs, steps), compared)
    said += other_settings(usual, variant) if said else []
    mine = at_step(runs[(runs.variant == variant) & (runs.source == "ours")], steps)
    clean = mine[mine.noise_std == 0]
    of_one_size = clean[clean.n_traj == clean.system.map(curves.usual_sizes(clean))]
    floors, grown = runs[runs.source == "floor"], growth(runs)
    intro = scope(runs, compared) if said else []
    files = held_out.recordings(recorded).items()
    text = [*intro, *said, *(held_out.answer(*one) for one in files), *warning(every)]
    parts = [
        Section("answer", "Answer", text, heat_maps),
        *(held_out.section(*one) for one in files),
        Section("sizes", "Errors over the size of the training set",
                figures=curves.data_size(drawn)),
        Section("noise", "Errors over noise", figures=curves.noise_figures(drawn)),
        Section("time", "Accuracy against time", figures=curves.speed(runs)),
        Section("motions", "Motions, and what was learned",
                figures=motions.motion_figures(of_one_size, floors, store)),
        Section("orders", "Errors over the order of the integrator",
                figures=curves.over_order(usual)),
        Section("growth", "Growth with the number of coordinates", tables=grown[0],
                figures=grown[1]),
        Section("floors", "Floors: the integrators alone", figures=curves.steps(found)),
        Section("tables", "Tables", tables=[accuracy(found), floor_table(usual)], folded=True),
        Section("state", "Runs", state(every), [unfinished(every)], folded=True),
    ]  # fmt: skip
    return [part for part in parts if part]


def title(runs: pd.DataFrame) -> str:
    """Return the experiments, the methods and the systems or recordings."""
    learned = runs[runs.source == "ours"]
    if runs.empty:
        return "No runs"
    methods = sorted(set(learned.method))
    simulated = learned[learned.recording == ""]
    systems = [*sorted(set(simulated.system)), *held_out.recordings(learned)]
    of = look(methods[0]).label if len(methods) == 1 else f"{len(methods)} methods"
    where = " and ".join(filter(None, (", ".join(systems[:-1]), *systems[-1:])))
    name = ", ".join(sorted(set(runs.experiment)))
    return f"{name}: {of} on {where}" if systems else name


def warning(runs: pd.DataFrame) -> list[str]:
    """Return a sentence on runs without a result, if there are any."""
    count = without_result(runs).run_id.nunique()
    if runs.run_id.nunique() == count:
        return ["There are no finished runs yet."]
    has = "has" if count == 1 else "have"
    return [f"{counted(count, 'run')} {has} no result: see the last section."] if count else []


def scope(runs: pd.DataFrame, compared: Compared) -> list[str]:
    """Return a sentence on the settings of the answer, unless all runs have the defaults."""
    learned = runs[runs.source == "ours"].drop_duplicates("run_id")
    rest = (learned.variant != compared.variant).sum()
    if not (compared.variant or rest):
        return []
    has = "has" if rest == 1 else "have"
    others = f"; {counted(rest, 'run')} {has} other settings, which the tables list" * bool(rest)
    which = "Settings of the answer, and of figures that name no others"
    return [f"{which}: {compared.variant or DEFAULTS}{others}."]


def state(runs: pd.DataFrame) -> list[str]:
    """Return the number of runs by status, their training time and the revisions of the source."""
    each = runs.drop_duplicates("run_id")
    if each.empty:
        return []
    told = ", ".join(f"{n} {status.lower()}" for status, n in each.status.value_counts().items())
    finished = each[each.status == "FINISHED"]
    lines = [f"{counted(len(each), 'run')}: {told}."]
    if len(finished):
        lines.append(f"Processor time of training: {duration(finished.seconds.sum())}.")
    if revisions := sorted({r[:10] for r in finished.revision if r}):
        lines.append(f"Revisions: {', '.join(revisions)}.")
    return lines


def unfinished(runs: pd.DataFrame) -> ResultTable:
    """Return a table of the runs that have not finished."""
    left = without_result(runs)
    left = left.assign(method=pair_names(left), status=left.status.str.lower())
    left = left.assign(settings=left.variant.replace("", DEFAULTS))
    left = left.rename(columns={"n_traj": "n", "noise_std": "noise"})
    left[["n", "noise", "seed"]] = left[["n", "noise", "seed"]].map(number)
    rows = left[["system", "method", "settings", "status", "reason", "n", "noise", "seed"]]
    return ResultTable("unfinished", "Runs without a result", rows)


def accuracy(found: pd.DataFrame) -> ResultTable:
    """Return a table of all settings, integrators and sizes run without noise."""
    learned = found[(found.source == "ours") & ~(found.noise_std > 0)]
    keys = ["system", "n_traj", "variant", "method", "integrator", "time_step"]
    seeds = learned.groupby(keys, dropna=False).seeds.max().astype(str)
    wide = medians(learned, keys, ACCURACY).reset_index()
    usual = wide.system.map(usual_steps(learned))
    settings = [
        (variant or DEFAULTS) + f", time step {h:g} s" * bool(abs(h - usually) > 0)
        for variant, h, usually in zip(wide.variant, wide.time_step, usual, strict=True)
    ]
    rows = pd.DataFrame(
        {
            "system": wide.system,
            "n": wide.n_traj.map(number),
            "settings": settings,
            "method": pair_names(wide),
            "seeds": seeds.to_numpy(),
        }
    ).join(wide.drop(columns=keys))
    title = "Accuracy by settings, method and integrator"
    return ResultTable("accuracy", title, rows, [table_note(learned)])


def floor_table(found: pd.DataFrame) -> ResultTable:
    """Return a table of the errors of the true systems in each integrator."""
    keys = ["system", "method", "integrator"]
    wide = medians(found[found.source == "floor"], keys, FLOORS).reset_index()
    names = {"integrator": wide.integrator.map(lambda name: stroke(name).label),
             "": wide.method.map(lambda name: look(name).label)}  # fmt: skip
    rows = pd.DataFrame({"system": wide.system, **names}).join(wide.drop(columns=keys))
    note = (
        "A learned model can lie below: it can learn part of the error of its integrator, with a "
        "biased inertia."
    )
    title = "Floors: the true systems in the integrators, nothing learned"
    return ResultTable("floors", title, rows, [note])
