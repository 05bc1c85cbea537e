"""The answer of a report: the best method for each question, its margin and how certain it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report.cells import DEFAULTS, Compared, over_seeds, settings_of
from symo_exp.report.looks import (
    all_angles,
    in_order,
    label_and_unit,
    look,
    measure_name,
    number,
    pair_name,
    short,
)
from symo_exp.report.ranking import between, logarithms, resampled
from symo_exp.report.tables import ResultTable
from symo_exp.words import counted

ROOTS = "test_newton_failed"
"""A measure of the methods that predict from configurations; the others are given velocities."""
DIVERGED = 30.0
"""The power of ten that ``logarithms`` returns for infinite values."""
LEVEL = 0.022
"""Margin in powers of ten, a factor of 1.05, below which two methods are level."""


class Question(NamedTuple):
    """A question to the runs.

    Args:
        asks: How the answer begins.
        measures: The first of these that the runs have decides.
        says: The predicate of the best method, with places for the factor and for the second.
        smallest: Whether the smallest training set is asked about.
        noisy: Whether noisy data are asked about.
    """

    asks: str
    measures: Sequence[str]
    says: str
    smallest: bool = False
    noisy: bool = False


SMALLEST = "has the smallest test error, {} times smaller than that of {}"
QUESTIONS = (
    Question("From few data", ("test_mse",), SMALLEST, smallest=True),
    Question("Over long horizons", ("integration_mse",),
             "predicts best, with an error {} times smaller than that of {}"),
    Question("In energy", ("energy_mse", "energy_mse_fd"),
             "has the smallest error, {} times smaller than that of {}"),
    Question("From noisy data", ("test_mse",), SMALLEST, noisy=True),
    Question("In training time", ("training_seconds",), "is the fastest, {} times faster than {}"),
)  # fmt: skip


class Ranked(NamedTuple):
    """Values of one measure: a row for each system and seed, a column for each contestant."""

    question: Question
    metric: str
    noise: float
    size: float
    values: pd.DataFrame
    angular: Mapping[str, bool | None]
    """Whether all coordinates of a system are angles, ``None`` if only some are or unknown."""

    def medians(self) -> pd.DataFrame:
        """Return the logarithms of the medians over seeds, a row for each system."""
        return np.log10((10.0**self.values).groupby("system").median())


def answers(runs: pd.DataFrame, compared: Compared) -> tuple[list[str], list[ResultTable]]:
    """Return a sentence for each question that the runs answer, and a heat map for each system."""
    rows = contestants(runs[runs.source == "ours"], compared)
    found = [one for question in QUESTIONS if (one := _ask(rows, question)) is not None]
    systems = sorted({system for one in found for system in one.values.index.unique("system")})
    said = [sentence(one) for one in found]
    return said + given(rows) * bool(said), [heat_map(system, found) for system in systems]


def given(rows: pd.DataFrame) -> list[str]:
    """Return a sentence on the inputs of the methods if some are given velocities and some not."""
    finds_roots = (rows.metric == ROOTS).groupby(rows.method).any()
    named: dict[bool, list[str]] = {True: [], False: []}
    for method in sorted(map(str, finds_roots.index), key=lambda name: in_order((name, ""))):
        named[bool(finds_roots[method])].append(look(method).label)
    alone, told = (" and ".join(named[finds]) for finds in (True, False))
    if not (alone and told):
        return []
    verb = "are" if len(named[False]) > 1 else "is"
    return [f"**Inputs**: {told} {verb} given velocities, {alone} configurations alone."]


def other_settings(found: pd.DataFrame, variant: str) -> list[str]:
    """Return a sentence on the cell of other settings that beats the answer's test error most.

    Args:
        found: Cells of all settings (``report.cells``).
        variant: The settings of the answer.
    """
    rows = found[(found.source == "ours") & (found.metric == "test_mse")]
    rows = rows[~(rows.noise_std > 0) & (rows["median"] > 0)]
    best = rows[rows.variant == variant].groupby("system")["median"].min()
    alike = [one != variant and _task(one) == _task(variant) for one in rows.variant]
    others = rows[np.array(alike, dtype=bool)].assign(
        best=lambda t: t.system.map(best).astype(float)
    )
    others = others.assign(times=others.best / others["median"])
    if others.empty or not others.times.max() > 10**LEVEL:
        return []
    one = others.loc[others.times.idxmax()]
    settings = one.variant or DEFAULTS
    data = f", {counted(one.n_traj, 'trajectory')}" if one.n_traj == one.n_traj else ""
    return [
        f"**Other settings**: {pair_name(one.method, one.integrator)} has test MSE "
        f"{short(one['median'])} ({one.system}{data}), {short(one.times)} times smaller than "
        f'the best above; `--settings "{settings}"` compares the runs with these settings.'
    ]


def _task(variant: str) -> set[str]:
    """Return the settings of the system and of the data, with which errors are not comparable."""
    own = "system.", "data.", "draws="
    return {word for word in settings_of(variant) if word.startswith(own)}


def contestants(runs: pd.DataFrame, compared: Compared) -> pd.DataFrame:
    """Return the measured runs that are compared, with the name of the contestant in ``who``.

    Methods and integrators with equal settings are compared; if there is one method only, its
    settings in one sweep.
    """
    runs = runs[runs.metric != ""]
    mine = runs[runs.variant == compared.variant]
    pairs = sorted({*zip(mine.method, mine.integrator, strict=True)}, key=in_order)
    if len(pairs) == 1 and len(compared.rivals) > 1:
        method, integrator = pairs[0]
        mine = runs[(runs.method == method) & (runs.integrator == integrator)]
        mine = mine[mine.variant.isin(compared.rivals)]
        return mine.assign(who=mine.variant.replace("", DEFAULTS))
    several = [method for method, _ in pairs]
    names = {
        (m, i): pair_name(m, i) if several.count(m) > 1 else look(m).label for m, i in pairs
    }  # fmt: skip
    who = [names[pair] for pair in zip(mine.method, mine.integrator, strict=True)]
    order = pd.CategoricalDtype(list(dict.fromkeys(names.values())), ordered=True)
    return mine.assign(who=pd.Series(who, index=mine.index, dtype=order))


def _ask(rows: pd.DataFrame, question: Question) -> Ranked | None:
    """Return the values at one noise and one size of the training set.

    The size is the smallest that more than half of the contestants have if the question asks for
    it, otherwise the most frequent one.
    """
    noise = rows.noise_std.fillna(0.0)
    rows = rows[(noise > 0) if question.noisy else (noise == 0)]
    there = [metric for metric in question.measures if (rows.metric == metric).any()]
    if not there:
        return None
    here = rows[rows.metric == there[0]]
    at = ["noise_std", "n_traj"]
    here = here.assign(value=logarithms(here.value.fillna(np.inf)), **here[at].fillna(0.0))
    cells = here.drop_duplicates([*at, "system", "who"]).groupby(at).size()
    sizes = list(cells[cells > 0.5 * cells.max()].index)
    runs = here.groupby(at).size()
    noise, size = min(sizes) if question.smallest else max(sizes, key=lambda key: (runs[key], key))
    few = size < here.n_traj.max()
    here = here[(here.noise_std == noise) & (here.n_traj == size)]
    values = here.pivot_table("value", ["system", "seed"], "who", aggfunc="last", observed=True)
    values.columns = list(map(str, values.columns))
    angular = {
        str(system): all_angles(own.metric, own.value) for system, own in rows.groupby("system")
    }
    if question.smallest and not few:
        question = question._replace(asks="One step ahead")
    return Ranked(question, there[0], noise, size, values, angular)


def sentence(found: Ranked) -> str:
    """Return the best contestant, its margin with an interval, and the systems with another."""
    medians = found.medians()
    everywhere = medians.dropna(axis=1)
    if everywhere.shape[1] < 2:
        return f"{_asked(found)}: {_smallest(found)}."
    best, second = everywhere.mean().sort_values(kind="stable").index[:2]
    apart = everywhere[second].mean() - everywhere[best].mean()
    decided, sure = _certainty(found, best, second)
    if apart < LEVEL:
        says = f"**{best}** and **{second}** are level"
    elif decided:
        says = f"**{best}** {found.question.says.format(_times(apart), second)}"
    else:
        says = f"undecided between **{best}** and **{second}**, {_times(apart)} times apart"
    others: dict[str, list[str]] = {}
    for system, winner in medians.idxmin(axis=1).items():
        if winner != best:
            others.setdefault(str(winner), []).append(str(system))
    but = "".join(f"; on {' and '.join(on)} it is {winner}" for winner, on in others.items())
    return f"{_asked(found)}: {says} ({sure}){but}."


def _asked(found: Ranked) -> str:
    """Return the question with the noise and the size of the training set."""
    where = [f"noise {number(found.noise)}"] if found.noise else []
    where += [counted(found.size, "trajectory")] if found.size else []
    return f"**{found.question.asks}**" + f" ({', '.join(where)})" * bool(where)


def _smallest(found: Ranked) -> str:
    """Return the smallest value on each system, where no two contestants have run on all."""
    medians, told = found.medians(), []
    for system, name, x in zip(
        medians.index, medians.idxmin(axis=1), medians.min(axis=1), strict=True
    ):
        label, unit = label_and_unit(found.metric, found.angular[system])
        of = f" {unit}" if unit and "," not in unit else ""
        told.append(f"{name} {short(10**x)}{of} ({system})")
    return f"{label} of {', '.join(told)}"


def _certainty(found: Ranked, best: str, second: str) -> tuple[bool, str]:
    """Return whether the interval of the margin excludes zero, if there is one, and its words."""
    both = found.values[[best, second]].dropna().groupby("system").size()
    seeds = both.reindex(found.values.index.unique("system"), fill_value=0).min()
    if seeds < 2:
        return True, "one seed, no interval" if seeds else "no common seed, no interval"
    low, high = _interval(found, best, second)
    return low > 0, f"95 % interval {_times(low)} to {_times(high)}, {seeds} seeds"


def _interval(found: Ranked, best: str, second: str) -> tuple[float, float]:
    """Return the interval of the margin in powers of ten, by resampling the seeds of a system."""
    apart = []
    for stream, (_, rows) in enumerate(found.values[[best, second]].groupby("system")):
        both = rows.dropna().to_numpy()
        medians = np.log10(np.median(10.0 ** both[resampled(len(both), stream)], axis=1))
        apart.append(medians[:, 1] - medians[:, 0])
    return between(np.mean(apart, axis=0))


def heat_map(system: str, found: Iterable[Ranked]) -> ResultTable:
    """Return a table with a row for each contestant and a column for each measure."""
    texts, shades, seeds = {}, {}, [0]
    for one in found:
        medians = one.medians()
        if system not in medians.index:
            continue
        here = medians.loc[system].dropna()
        seeds.append(one.values.loc[[system]].notna().to_numpy().sum(axis=0).max())
        where = f", σ={number(one.noise)}" * bool(one.noise) + f", n={one.size:g}" * bool(one.size)
        what = measure_name(one.metric, one.angular[system]) + where
        texts[what] = pd.Series([_against(x, here.min()) for x in here], here.index)
        places = 1 - (here.rank(method="min") - 1) / max(len(here) - 1, 1)
        shades[what] = places if len(here) > 1 else places * np.nan
    names = list(dict.fromkeys(name for column in texts.values() for name in column.index))
    rows = pd.DataFrame(texts, names).fillna("–")
    marks = pd.DataFrame(shades, names)
    rows.insert(0, "", names)
    marks.insert(0, "", np.nan)
    note = f"n: training trajectories. {over_seeds(max(seeds))}; × times the best, which is bold."
    notes = [note] if marks.notna().any(axis=None) else []
    return ResultTable(f"best_{system}", system, rows, notes, system=system, shades=marks)


def _against(power: float, least: float) -> str:
    if power > DIVERGED - 1:  # the median of an even number is the mean of two
        return "diverged"
    return short(10**power) + (f" ×{_times(power - least)}" if power - least >= LEVEL else "")


def _times(power: float) -> str:
    if power > DIVERGED / 2:
        return "∞"
    return f"{10**power:.2g}" if -1 <= power < 2 else short(10**power)
