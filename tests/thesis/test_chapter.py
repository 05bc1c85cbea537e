"""The report of chapter 6: tables beside the published ones, and verdicts on its statements."""

import math

import pandas as pd
import pytest

from symo_exp.report.runs import tidy
from symo_exp.report.tables import ResultTable
from symo_exp.thesis import published
from symo_exp.thesis.chapter import factor, progress
from symo_exp.thesis.claims import CLAIMS, PAIRS, judge
from symo_exp.thesis.view import thesis_report
from tests.report.stores import repeated, row
from tests.report.test_report import made

SIZES = published.published()
SIZES = SIZES[
    (SIZES.system == "cartpole") & (SIZES.time_step == 0.05) & SIZES.n_traj.isin([8, 32])
    & SIZES.noise_std.isin([0.0, 0.01])
]  # fmt: skip


def test_a_repeated_chapter_agrees_with_the_published(tmp_path):
    rows = repeated(SIZES, factor=2.0)
    out = made(tmp_path, [*rows, row(experiment="other")], "--experiment", "thesis", "--thesis")
    assert pd.read_csv(out / "runs.csv").run_id.nunique() == len(rows)
    table = (out / "tables" / "table_cartpole.md").read_text()
    assert "| SyMo | midpoint | ours (1) | 2.04e-7 |" in table
    assert "4.25e-7" in table
    assert table.count("| factor | ×2 | ×2 |") == 6
    agreed = (out / "tables" / "agreement.md").read_text()
    assert "| defaults | cartpole | SyMo, midpoint | 3 | 0 | 0 | 3 | 0 | 0 |" in agreed
    claims = (out / "tables" / "claims.md").read_text()
    assert "| 6.6.1 | cartpole | E2E-SyMo has the best test error | 32 | holds | holds |" in claims
    assert "| not run |" in claims


@pytest.mark.parametrize("metric", ["test_mse", "integration_mse"])
def test_a_chapter_without_a_measure_is_reported(metric):
    """As of runs whose long rollouts all diverge."""
    told = thesis_report(tidy(repeated(SIZES[SIZES.metric == metric])), "it")
    (agreed,) = next(section for section in told.sections if section.key == "agreement").tables
    other = "test" if metric == "integration_mse" else "integration"
    assert (agreed.rows[[f"{other}: {x}" for x in ("within 3", "÷3", "×3")]] == "0").all(axis=None)


def test_published_values_are_drawn_beside_ours():
    told = thesis_report(tidy(repeated(SIZES)), "it")
    figures = {f.key: f for s in told.sections for f in s.figures}
    for key in ("data_size_cartpole_errors", "noise_cartpole"):
        assert figures[key].title.endswith(f"(thesis, figure {published.thesis_figures()[key]})")
        for panel in figures[key].panels:
            ours, theirs = (panel.rows[panel.rows.source == s] for s in ("ours", "published"))
            assert not ours.empty
            here = theirs.set_index(["method", "integrator", "n_traj", "noise_std"])["median"]
            for one in ours.itertuples():
                at = (one.method, one.integrator, one.n_traj, one.noise_std)
                assert here[at] == pytest.approx(one.y)


def test_missing_runs_are_listed_for_the_main_variant_alone():
    other = row(noise_std=0.01, variant="learning_rate=0.001")
    found = progress(tidy([row(n_traj=8), row(n_traj=8, seed=4), other]))
    tables = {table.key: table.rows for table in found if len(table.rows)}
    assert set(tables["progress_sizes"].system) == {"pendulum", "acrobot", "cartpole"}
    rows = tables["progress_sizes"].to_numpy().tolist()
    assert ["pendulum", "SyMo, midpoint", "2", "–", "–", "–", "–"] in rows
    assert not any(key.startswith("progress_sizes_learning_rate") for key in tables)


@pytest.mark.parametrize(
    ("number", "printed"),
    [(1.0, "×1"), (2.13, "×2.1"), (0.5, "÷2"), (654.0, "×650"), (2345.0, "×2.3e3"),
     (1 / 830, "÷830"), (float("inf"), "×∞"), (0.0, "÷∞"), (float("nan"), "–")],
)  # fmt: skip
def test_factors_say_larger_or_smaller(number, printed):
    assert factor(number) == printed
    assert ResultTable("k", "t", pd.DataFrame([["of", printed]])).numeric == [False, True]


def test_all_statements_are_borne_out_by_the_published_numbers():
    """A statement that is not was transcribed wrongly."""
    verdicts = judge(published.published().assign(seed=0)[:0])
    assert [claim["text"] for claim, theirs, _ in verdicts if theirs.said != "holds"] == []
    assert {ours.said for _, _, ours in verdicts} == {"not run"}
    assert not CLAIMS.duplicated(["system", "text"]).any()


TEXT = "The SyMos integrate better than L-NODE-RK4"


def verdict(values, text=TEXT, pairs=PAIRS):
    """Of runs with ``values(method, seed)`` as their error."""
    runs = pd.DataFrame(
        {"system": "pendulum", "n_traj": 32, "noise_std": 0.0, "seed": seed, "method": pair[0],
         "integrator": pair[1], "metric": "integration_mse", "value": values(pair[0], seed)}
        for pair in pairs for seed in range(3)
    )  # fmt: skip
    (found,) = [v for c, _, v in judge(runs) if (c["text"], c["system"]) == (text, "pendulum")]
    return found


def test_a_statement_holds_by_its_margin():
    def values(method, _):
        return {"symo": 1.0, "e2e_symo": 2.0}.get(method, 20.0)

    found = verdict(values)
    assert (found.said, found.seeds, found.margin) == ("holds", 3, pytest.approx(10.0))
    more = verdict(values, "and by two orders of magnitude")
    assert (more.said, more.margin) == ("does not hold", pytest.approx(0.1))


def test_a_statement_is_undecided_where_seeds_disagree():
    found = verdict(lambda method, seed: (1.0 if seed else 100.0) if "symo" in method else 10.0)
    assert found.said == "undecided"


def test_a_statement_needs_all_its_methods():
    found = verdict(lambda *_: 1.0, pairs=PAIRS[:-1])
    assert (found.said, found.seeds) == ("not run", 0)
    assert math.isnan(found.margin)


def test_two_that_diverge_do_not_differ():
    found = verdict(lambda *_: math.inf)
    assert (found.said, found.margin) == ("does not hold", pytest.approx(1.0))
