"""The tables of chapter 6, ours beside the published; floors, ranks, claims, what is missing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from symo_exp.report import published
from symo_exp.report.cells import main_variant
from symo_exp.report.claims import Verdict
from symo_exp.report.labels import (
    PAIRS,
    SYSTEMS,
    TABLE,
    Pair,
    factor,
    in_order,
    measure_name,
    pair_name,
    short,
    systems_in_order,
)
from symo_exp.report.ranking import ranking
from symo_exp.report.runs import Runs
from symo_exp.report.style import TRUE, look, stroke
from symo_exp.report.tables import Table

NUMBERS = {"pendulum": "6.2", "acrobot": "6.3", "cartpole": "6.4"}
TOLERATED = 3.0
"""The factor within which a repeated cell counts as the published one."""
SIZES, NOISES = (8, 16, 32, 64, 128), (0.0, 1e-4, 5e-4, 1e-3, 5e-3, 1e-2)


def beside(found: pd.DataFrame, compared: pd.DataFrame, system: str, variant: str) -> Table:
    """Table 6.2, 6.3 or 6.4: three lines for each method, ours, the published, and the factor."""
    mine = _cell(found, system, 32)
    theirs = _cell(compared, system, 32)
    theirs = theirs[theirs.time_step == published.TIME_STEPS.get(system)]
    pairs = {*PAIRS, *_pairs_of(mine)}
    rows = []
    for pair in sorted(pairs, key=in_order):
        ours_, published_ = _of(mine, pair), _of(theirs, pair)
        seeds = int(ours_.seeds.max()) if len(ours_) else 0
        names = [look(pair[0]).label, stroke(pair[1]).label]
        rows.append([*names, f"ours ({seeds})", *_per_metric(ours_, _spread)])
        rows.append(["", "", "thesis", *_per_metric(published_, _plus_minus)])
        rows.append(["", "", "factor", *_per_metric(published_, lambda row: factor(row["factor"]))])
    overs = theirs[["metric", "method", "over", "note"]].drop_duplicates()
    title = f"{system.capitalize()}, 32 training trajectories"
    if number := NUMBERS.get(system):
        title += f" (table {number})"
    return Table(
        key=f"table_{system}" + _suffix(variant),
        title=title + (f", {variant}" if variant else ""),
        header=["model", "integrator", "", *map(measure_name, TABLE)],
        rows=rows,
        notes=[
            "Ours: median over the seeds (their number in brackets), and in square brackets the "
            "lowest and the highest. Thesis: one run, ± over trajectories where it gives it.",
            *_what_over(overs),
            "Factor: ours over the published, both averaged over the same where there is a "
            "measure of ours for it; × larger, ÷ smaller.",
        ],
        words=3,
    )


def agreement(compared: pd.DataFrame) -> Table:
    """In how many cells ours are within a factor of three of the published."""
    rows = []
    done = compared[compared.seeds > 0]
    for variant in sorted(set(done.variant)):
        for system in systems_in_order(set(compared.system)):
            here = done[(done.variant == variant) & (done.system == system)]
            for pair in sorted(_pairs_of(here), key=in_order):
                cells = []
                for metric in ("test_mse", "integration_mse"):
                    factors = here[
                        (here.method == pair[0]) & (here.integrator == pair[1])
                        & (here.metric == metric)
                    ].factor.dropna()  # fmt: skip
                    better = int((factors < 1 / TOLERATED).sum())
                    worse = int((factors > TOLERATED).sum())
                    cells += [str(len(factors) - better - worse), str(better), str(worse)]
                rows.append([variant or "defaults", system, pair_name(*pair), *cells])
    header = ["settings", "system", "method"]
    header += [f"{m}: {w}" for m in ("test", "integration") for w in ("within 3", "÷3", "×3")]
    return Table(
        key="agreement",
        title="Cells within a factor of three of the published, better by more, worse by more",
        header=header,
        rows=rows,
        notes=[
            "Every published cell that has been run, whatever its size and noise; averaged over "
            "the same where there is a measure for it."
        ],
        words=3,
    )


def floors(found: pd.DataFrame) -> Table:
    """What the true systems miss in each integrator."""
    metrics = ("test_mse", "integration_mse", "integration_mse_100", "valid_steps", "energy_mse")
    rows = []
    for system in systems_in_order(set(found.system)):
        here = found[found.system == system]
        for pair in sorted(_pairs_of(here), key=in_order):
            values = [
                _of(here[here.metric == metric], pair)["median"].median() for metric in metrics
            ]
            kind = "variational" if pair[0] == "true_variational" else "explicit"
            rows.append([system, stroke(pair[1]).label, kind, *map(short, values)])
    return Table(
        key="floors",
        title="Floors: the true systems in the integrators, nothing learned",
        header=["system", "integrator", "", *map(measure_name, metrics)],
        rows=rows,
        notes=[
            "A learned model can lie below: it may learn part of its integrator's own error, at "
            "the price of a biased inertia."
        ],
        words=3,
    )


def ranks(measures: pd.DataFrame) -> Iterable[Table]:
    """For each system and for all together: the mean rank of each method by each measure."""
    clean = measures[(measures.noise_std == 0) & ~measures.method.isin(TRUE)]
    systems = systems_in_order(set(clean.system))
    for system in ["all systems", *systems] if len(systems) > 1 else systems:
        here = clean if system == "all systems" else clean[clean.system == system]
        rows = []
        for metric in TABLE[1:]:
            for row in ranking(here, metric).to_dict("records"):
                rows.append(
                    [
                        measure_name(metric), pair_name(row["method"], row["integrator"]),
                        f"{row['rank']:.2f}", f"{row['low']:.2f} to {row['high']:.2f}",
                        f"{100 * row['best']:.0f} %", str(row["blocks"]),
                    ]
                )  # fmt: skip
        if rows:
            yield Table(
                key="ranks_" + system.replace(" ", "_"),
                title=f"Ranking, {system}",
                header=["measure", "method", "mean rank", "95 % interval", "wins", "blocks"],
                rows=rows,
                notes=[
                    "A block is a system, a size of the training set and a seed for which every "
                    "method has been run; the intervals are by resampling blocks."
                ],
                words=2,
            )


def claims(verdicts: Sequence[Verdict]) -> Table:
    """Which statements of the thesis hold."""
    rows = []
    for verdict in verdicts:
        claim = verdict.claim
        seeds = "" if not verdict.seeds else f"{verdict.seeds} seed" + "s" * (verdict.seeds > 1)
        interval = f"{short(verdict.interval.low)} to {short(verdict.interval.high)}"
        rows.append(
            [
                claim.section, claim.system, claim.text, f"{claim.n_traj}", verdict.published,
                verdict.ours, short(verdict.margin), interval if verdict.seeds > 1 else "–", seeds,
            ]
        )  # fmt: skip
    return Table(
        key="claims",
        title="What the thesis says, and whether it holds",
        header=[
            "section", "system", "statement", "n", "by its own numbers", "by ours",
            "margin", "95 % interval", "",
        ],
        rows=rows,
        notes=[
            "Margin: the smallest of the errors said to be larger over the largest of those said "
            "to be smaller, over the factor said; above 1 the statement holds. Medians over seeds, "
            "resampled for the interval: undecided where that has 1 in it.",
            "By its own numbers: the published ones, which are not all averaged over the same.",
        ],
        words=6,
    )  # fmt: skip


def progress(runs: Runs) -> Iterable[Table]:
    """Which cells of the chapter have been run, with how many seeds.

    What has not been run is told of the main variant alone: others were tried here and there.
    """
    done = runs.measures.drop_duplicates("run_id")
    done = done[~done.method.isin(TRUE)]
    main = main_variant(done)
    for variant in sorted({*done.variant, main}):
        mine = done[done.variant == variant]
        systems = systems_in_order({*SYSTEMS, *mine.system})
        axes: list[tuple[str, str, Sequence[float], Callable[[pd.DataFrame, float], pd.Series]]]
        axes = [
            ("sizes", "training trajectories", SIZES,
             lambda rows, x: (rows.n_traj == x) & (rows.noise_std == 0)),
            ("noises", "noise at 32 trajectories", NOISES,
             lambda rows, x: (rows.n_traj == 32) & (rows.noise_std == x)),
        ]  # fmt: skip
        for key, title, values, at in axes:
            rows = []
            for system in systems:
                here = mine[mine.system == system]
                if key == "noises" and here.noise_std.nunique() < 2:
                    continue
                for pair in sorted({*PAIRS, *_pairs_of(here)}, key=in_order):
                    of = _of(here, pair)
                    counts = [of[at(of, x)].seed.nunique() for x in values]
                    if variant == main or any(counts):
                        told = (str(n) if n else "–" for n in counts)
                        rows.append([system, pair_name(*pair), *told])
            if rows:
                yield Table(
                    key=f"progress_{key}{_suffix(variant)}",
                    title=f"Seeds that have been run, by {title}"
                    + (f" ({variant})" if variant else ""),
                    header=["system", "method", *(f"{x:g}" for x in values)],
                    rows=rows,
                    words=2,
                )


def unfinished(runs: Runs) -> Table:
    """Runs that are not FINISHED, but for those that were finished by another."""
    done = {
        tuple(row) for row in runs.measures[_IDENTITY].drop_duplicates().itertuples(index=False)
    }
    rows = []
    for row in runs.table[runs.table.status != "FINISHED"].itertuples():
        if tuple(getattr(row, name) for name in _IDENTITY) in done:
            continue
        rows.append(
            [
                str(row.system), pair_name(str(row.method), str(row.integrator)), str(row.n_traj),
                f"{row.noise_std:g}", str(row.seed), str(row.status).lower(), str(row.reason),
            ]
        )  # fmt: skip
    header = ["system", "method", "n", "noise", "seed", "status", "reason"]
    return Table("unfinished", "Runs without a result", header, rows, words=2)


_IDENTITY = ["variant", "system", "time_step", "method", "integrator", "n_traj", "noise_std",
             "seed"]  # fmt: skip


def _cell(rows: pd.DataFrame, system: str, n_traj: int) -> pd.DataFrame:
    return rows[(rows.system == system) & (rows.n_traj == n_traj) & (rows.noise_std == 0)]


def _of(rows: pd.DataFrame, pair: Pair) -> pd.DataFrame:
    return rows[(rows.method == pair[0]) & (rows.integrator == pair[1])]


def _pairs_of(rows: pd.DataFrame) -> set[Pair]:
    return {(str(m), str(i)) for m, i in zip(rows.method, rows.integrator, strict=True)}


def _per_metric(rows: pd.DataFrame, say: Callable[[Mapping[Any, Any]], str]) -> list[str]:
    by_metric = {row["metric"]: row for row in rows.to_dict("records")}
    return [say(by_metric[metric]) if metric in by_metric else "–" for metric in TABLE]


def _spread(row: Mapping[Any, Any]) -> str:
    middle = short(row["median"])
    if row["seeds"] == 1:
        return middle
    return f"{middle} [{short(row['low'])}, {short(row['high'])}]"


def _plus_minus(row: Mapping[Any, Any]) -> str:
    value, std = short(row["published"]), row["published_std"]
    return value if pd.isna(std) else f"{value} ± {short(std)}"


def _what_over(overs: pd.DataFrame) -> Iterable[str]:
    """For each measure whose published values average over something of their own."""
    for metric in TABLE:
        here = overs[overs.metric == metric]
        told = []
        for (over, note), rows in here.groupby(["over", "note"], sort=False):
            if note.endswith("like ours"):
                continue
            methods = ", ".join(look(m).label for m in dict.fromkeys(rows.method))
            told.append(f"of {methods} {note}" if over else note)
        if told:
            yield f"The published {measure_name(metric)} is " + "; ".join(told) + "."


def _suffix(variant: str) -> str:
    letters = "".join(c if c.isalnum() else "_" for c in variant)
    return f"_{letters}" if letters else ""
