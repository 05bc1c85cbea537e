"""Tables of chapter 6: results beside the published ones, statements, and cells that were run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import pandas as pd

from symo_exp.report.curves import AT
from symo_exp.report.looks import (
    Pair,
    in_order,
    look,
    measure_name,
    number,
    pair_name,
    pair_names,
    short,
    stroke,
)
from symo_exp.report.overview import TABLE
from symo_exp.report.tables import ResultTable
from symo_exp.thesis.claims import PAIRS, judge
from symo_exp.thesis.published import TIME_STEPS
from symo_exp.words import counted

NUMBERS = {"pendulum": "6.2", "acrobot": "6.3", "cartpole": "6.4"}
TOLERATED = 3.0
"""Factor within which a repeated cell agrees with the published one."""
SIZES, NOISES = (8, 16, 32, 64, 128), (0.0, 1e-4, 5e-4, 1e-3, 5e-3, 1e-2)


def main_variant(rows: pd.DataFrame) -> str:
    """Return the defaults if any run has them, otherwise the most frequent settings."""
    variants = rows[rows.source == "ours"].variant.value_counts()
    return "" if "" in variants or variants.empty else str(variants.idxmax())


def chapter_tables(found: pd.DataFrame, compared: pd.DataFrame) -> Iterable[ResultTable]:
    """Yield tables 6.2 to 6.4 for each variant, from cells at the time steps of the chapter."""
    learned = _at_32(found[found.source == "ours"])
    main = main_variant(learned)
    theirs = _at_32(compared[compared.time_step == compared.system.map(TIME_STEPS)])
    for variant in sorted(set(learned.variant)):
        mine = learned[learned.variant == variant]
        of = theirs[(theirs.variant == variant) | theirs.variant.isna()]
        for system in in_thesis_order(mine.system):
            here = mine[mine.system == system]
            # other variants were run for some methods only
            pairs = _pairs(here) if variant == main else _run(here)
            yield _table(here, of[of.system == system], system, variant, pairs)


def _table(
    mine: pd.DataFrame, theirs: pd.DataFrame, system: str, variant: str, pairs: Iterable[Pair]
) -> ResultTable:
    """Return three lines for each method: ours, the published values, and the factor."""
    rows = []
    for pair in pairs:
        ours, published = _of(mine, pair), _of(theirs, pair)
        count = int(ours.seeds.max()) if len(ours) else 0
        rows += [
            [look(pair[0]).label, stroke(pair[1]).label, f"ours ({count})", *_each(ours, _spread)],
            ["", "", "thesis", *_each(published, _plus_minus)],
            ["", "", "factor", *_each(published, lambda row: factor(row["factor"]))],
        ]
    title = f"{system.capitalize()}, {AT} training trajectories"
    title += f" (table {NUMBERS[system]})" if system in NUMBERS else ""
    notes = [
        "Ours: median over the seeds (their number in brackets), and in square brackets the "
        "lowest and the highest. Thesis: one run, ± over trajectories unless stated otherwise.",
        *_what_over(theirs[["metric", "method", "over", "note"]].drop_duplicates()),
        "Factor: ours over the published, both averaged over the same quantities where we have "
        "that measure; × larger, ÷ smaller.",
    ]
    header = ["model", "integrator", "", *map(measure_name, TABLE)]
    title += f", {variant}" if variant else ""
    table = pd.DataFrame(rows, columns=header)
    return ResultTable(f"table_{system}{_suffix(variant)}", title, table, notes)


def agreement(compared: pd.DataFrame) -> ResultTable:
    """Return the numbers of cells within a factor of three of the published ones."""
    metrics = {"test_mse": "test", "integration_mse": "integration"}
    done = compared[(compared.seeds > 0) & compared.metric.isin(metrics)].dropna(subset="factor")
    x = done.factor
    sized = done.assign(
        within=x.between(1 / TOLERATED, TOLERATED), better=x < 1 / TOLERATED, worse=x > TOLERATED
    )
    counts = sized.groupby(["variant", "system", "method", "integrator", "metric"])
    kinds = ["within", "better", "worse"]
    wide = counts[kinds].sum().unstack(fill_value=0)
    wide = wide.reindex(columns=pd.MultiIndex.from_product([kinds, metrics]), fill_value=0)
    places = {system: i for i, system in enumerate(in_thesis_order(done.system))}
    rows = [
        [variant or "defaults", system, pair_name(*pair),
         *(f"{row[kind, metric]}" for metric in metrics for kind in kinds)]
        for (variant, system, *pair), row in sorted(
            wide.iterrows(), key=lambda x: (x[0][0], places[x[0][1]], in_order(x[0][2:]))
        )
    ]  # fmt: skip
    header = ["settings", "system", "method"]
    header += [f"{m}: {w}" for m in metrics.values() for w in ("within 3", "÷3", "×3")]
    note = (
        "Every published cell that has been run, of all sizes and noise levels, averaged over "
        "the same quantities where we have that measure."
    )
    title = "Cells within a factor of three of the published value, better, and worse"
    return ResultTable("agreement", title, pd.DataFrame(rows, columns=header), [note])


def claims(measures: pd.DataFrame) -> ResultTable:
    """Return a table of the statements of the thesis, and which of them hold."""
    rows = []
    for claim, published, ours in judge(measures):
        several = ours.seeds > 1
        interval = " to ".join(map(short, ours.interval))
        rows.append({
            "section": claim["section"], "system": claim["system"], "statement": claim["text"],
            "n": claim["n_traj"], "by its own numbers": published.said, "by ours": ours.said,
            "margin": short(ours.margin), "95 % interval": interval if several else "–",
            "": counted(ours.seeds, "seed") if ours.seeds else "",
        })  # fmt: skip
    notes = [
        "Margin: the ratio that the statement is about, the smallest error on its larger side to "
        "the largest on its smaller side, divided by the stated factor; above 1 it holds. "
        "Medians over seeds, which the interval resamples; undecided if it contains 1.",
        "By its own numbers: by the published ones, whose averages differ between methods.",
    ]
    title = "Statements of the thesis"
    return ResultTable("claims", title, pd.DataFrame(rows), notes)


def progress(runs: pd.DataFrame) -> Iterable[ResultTable]:
    """Yield tables of the number of seeds in each cell of the chapter.

    Cells that have not been run are listed for the main variant only.
    """
    done = runs[(runs.source == "ours") & (runs.metric != "")].drop_duplicates("run_id")
    main = main_variant(done)
    noisy = done[done.n_traj == AT]
    several = noisy.groupby(["variant", "system"]).noise_std.transform("nunique") > 1
    axes = {
        "sizes": ("training trajectories", "n_traj", SIZES, done[done.noise_std == 0]),
        "noises": (f"noise at {AT} trajectories", "noise_std", NOISES, noisy[several]),
    }
    for variant in sorted({*done.variant, main}):
        for key, (over, axis, values, of) in axes.items():
            here = of[of.variant == variant]
            systems = in_thesis_order([*(TIME_STEPS if key == "sizes" else ()), *here.system])
            cells = [(s, *pair) for s in systems for pair in _pairs(here[here.system == s])]
            by = ["system", "method", "integrator"]
            index = pd.MultiIndex.from_tuples(cells, names=by)
            counts = here.groupby([*by, axis]).seed.nunique().unstack(axis)
            counts = counts.reindex(index=index, columns=list(values))
            if variant != main:
                counts = counts.dropna(how="all")
            rows = counts.map(number).rename(columns="{:g}".format).reset_index()
            rows = rows.assign(method=pair_names(rows)).drop(columns="integrator")
            title = f"Seeds that have been run, by {over}" + (f" ({variant})" if variant else "")
            yield ResultTable(f"progress_{key}{_suffix(variant)}", title, rows)


def in_thesis_order(systems: Iterable[str]) -> list[str]:
    """Return the systems in the order of the thesis, others last."""
    places = list(TIME_STEPS)
    return sorted(set(systems), key=lambda s: (places.index(s) if s in places else len(places), s))


def factor(x: float) -> str:
    """Return a factor as tables print it: ``×2.1``, ``÷830``."""
    if pd.isna(x):
        return "–"
    if x == 0 or x == float("inf"):
        return "÷∞" if x == 0 else "×∞"
    times, sign = (x, "×") if x >= 1 else (1 / x, "÷")
    if times < 1000:
        return f"{sign}{float(f'{times:.2g}'):g}"
    digits, exponent = f"{times:.1e}".split("e")
    return f"{sign}{digits}e{int(exponent)}"


def _at_32(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[(rows.n_traj == AT) & (rows.noise_std == 0)]


def _of(rows: pd.DataFrame, pair: Pair) -> pd.DataFrame:
    return rows[(rows.method == pair[0]) & (rows.integrator == pair[1])]


def _pairs(rows: pd.DataFrame) -> list[Pair]:
    """Return the methods of the chapter and others that have been run."""
    return sorted({*PAIRS, *_run(rows)}, key=in_order)


def _run(rows: pd.DataFrame) -> list[Pair]:
    """Return the methods that have been run."""
    return sorted({*zip(rows.method, rows.integrator, strict=True)}, key=in_order)


def _each(rows: pd.DataFrame, say: Callable[[Mapping[Any, Any]], str]) -> list[str]:
    by_metric = {row["metric"]: row for row in rows.to_dict("records")}
    return [say(by_metric[metric]) if metric in by_metric else "–" for metric in TABLE]


def _spread(row: Mapping[Any, Any]) -> str:
    spread = f" [{short(row['low'])}, {short(row['high'])}]" if row["seeds"] > 1 else ""
    return short(row["median"]) + spread


def _plus_minus(row: Mapping[Any, Any]) -> str:
    value, std = short(row["published"]), row["published_std"]
    return value if pd.isna(std) else f"{value} ± {short(std)}"


def _what_over(overs: pd.DataFrame) -> Iterable[str]:
    """Yield a note for each measure whose published values are other averages."""
    for metric in TABLE:
        told = []
        for note, rows in overs[overs.metric == metric].groupby("note", sort=False):
            if not str(note).endswith("like ours"):
                methods = ", ".join(look(m).label for m in dict.fromkeys(rows.method))
                told.append(f"{methods} {note}")
        if told:
            yield f"Published {measure_name(metric)}: " + "; ".join(told) + "."


def _suffix(variant: str) -> str:
    return f"_{variant}" if variant else ""
