"""The whole report: from stores that are complete, half empty and empty."""

import json
import re

import pandas as pd
import pytest
from PIL import Image

from symo_exp.report import published
from symo_exp.report.__main__ import main
from symo_exp.report.build import report
from symo_exp.report.chapter import progress
from symo_exp.report.page import page
from symo_exp.report.runs import read
from symo_exp.report.style import METHODS
from symo_exp.report.tables import Table, latex, markdown
from tests.report.stores import add_published, add_run, folder_of

SIZES = published.published()
SIZES = SIZES[
    (SIZES.system == "cartpole") & (SIZES.time_step == 0.05) & SIZES.n_traj.isin([8, 32])
    & SIZES.noise_std.isin([0.0, 0.01])
]  # fmt: skip


def panels_of(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="panels">(.*?)</script>', text, re.S)
    return json.loads(found.group(1))


def made(store, *words, out="out", formats=("--formats", "png")):
    where = ["--directory", str(folder_of(store)), "--out", str(out)]
    return main([*where, *formats, *words])


def test_a_store_becomes_tables_figures_and_a_page(store, tmp_path, capsys):
    count = add_published(store, SIZES, factor=2.0)
    for kind in ("true_ode", "true_variational"):
        add_run(store, system="cartpole", method=kind, metrics={"test_mse": 1e-8})
    out = tmp_path / "out"
    assert made(store, out=out, formats=("--formats", "png", "pdf")) == 0
    assert "index.html" in capsys.readouterr().out
    tidy = pd.read_csv(out / "runs.csv")
    assert tidy.run_id.nunique() == count + 2
    assert len(pd.read_parquet(out / "runs.parquet")) == len(tidy)
    table = (out / "tables" / "table_cartpole.md").read_text()
    assert "| SyMo | midpoint | ours (1) | 2.04e-7 |" in table
    assert "4.25e-7" in table
    assert table.count("| factor | ×2 | ×2 |") == 6
    agreed = (out / "tables" / "agreement.md").read_text()
    assert "| defaults | cartpole | SyMo, midpoint | 3 | 0 | 0 | 3 | 0 | 0 |" in agreed
    claims = (out / "tables" / "claims.md").read_text()
    assert "| 6.6.1 | cartpole | E2E-SyMo has the best test error | 32 | holds | holds |" in claims
    assert "| 6.4.1 | pendulum |" in claims
    assert "| not run |" in claims
    for name in ("data_size_cartpole_errors", "noise_cartpole"):
        with Image.open(out / "figures" / f"{name}.png") as picture:
            assert picture.width > 500
        assert (out / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert f"figures/{name}.png" in (out / "report.md").read_text()


def test_an_empty_store_gives_a_report_that_says_so(store, tmp_path):
    add_run(store, status="RUNNING")
    (read(store, ["thesis"]).table, made(store, out=tmp_path / "a"))
    assert "1 runs: 1 running" in (tmp_path / "a" / "report.md").read_text()
    assert made(store, "--seed", "5", out=tmp_path / "b") == 0
    text = (tmp_path / "b" / "report.md").read_text()
    assert "There are no runs yet" in text
    assert "Nothing of this has been run." in text
    assert (tmp_path / "b" / "index.html").stat().st_size > 1_000_000


def test_a_half_empty_store_says_what_is_missing(store, tmp_path):
    add_run(store, system="acrobot", method="node", integrator="rk4", seed=0)
    add_run(store, system="acrobot", method="node", integrator="rk4", seed=4)
    add_run(store, system="acrobot", method="symo", status="FAILED", reason="out of memory")
    assert made(store, out=tmp_path / "out") == 0
    text = (tmp_path / "out" / "report.md").read_text()
    assert "| acrobot | NODE, RK4 | – | – | 2 | – | – |" in text
    assert "| acrobot | SyMo, midpoint | – | – | – | – | – |" in text
    assert "| acrobot | SyMo, midpoint | 32 | 0 | 0 | failed | out of memory |" in text
    assert "| NODE | RK4 | ours (2) |" in text


def test_bad_input_is_a_line_and_code_2(store, tmp_path, capsys):
    add_run(store)
    (tmp_path / "file").write_text("")
    (tmp_path / "torn.parquet").write_text("PAR1")
    (tmp_path / "other.csv").write_text("run_id,value\n1,2\n")
    for words, wanted in [
        (["--experiment", "nothing"], "no experiment 'nothing'"),
        (["--tracking-uri", "carrier://pigeon"], "carrier"),
        (["--tracking-uri", "http://127.0.0.1:9"], "127.0.0.1:9"),
        (["--directory", str(tmp_path / "none")], "no tracking store"),
        (["--out", str(tmp_path / "file")], "cannot be written"),
        (["--runs", str(tmp_path / "none.csv")], "cannot be read (No such file"),
        (["--runs", str(tmp_path / "file")], "cannot be read (No columns"),
        (["--runs", str(tmp_path / "none.parquet")], "none.parquet cannot be read ("),
        (["--runs", str(tmp_path / "torn.parquet")], "torn.parquet cannot be read ("),
        (["--runs", str(tmp_path / "other.csv")], "no column 'variant'"),
    ]:
        assert made(store, *words) == 2, words
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith("symo_exp.report: error: ")
        assert wanted in line
    with pytest.raises(SystemExit) as ended:
        main(["--seed", "first"])
    assert ended.value.code == 2


def test_the_page_needs_nothing_else(store):
    add_published(store, SIZES[SIZES.method == "symo"])
    made_ = report(read(store, ["thesis"]), "a <store> & more")
    text = page(made_.title, made_.summary, made_.sections)
    assert "a &lt;store&gt; &amp; more" in text
    loads = re.findall(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)\s*=", text)
    assert loads == []
    charts = panels_of(text)
    assert set(charts) >= {"data_size_cartpole_errors", "noise_cartpole", "speed_test_mse"}
    for chart in charts.values():
        for panel in chart:
            for trace in panel["data"]:
                assert trace["meta"]["method"] in METHODS
                assert trace["meta"]["source"] in ("ours", "published")
                assert trace["line"]["width"] == 0 or trace["line"]["color"].startswith("#")


def test_one_colour_for_a_method_in_every_figure(store):
    add_published(store, SIZES, seeds=(0, 1))
    made_ = report(read(store, ["thesis"]), "it")
    colours: dict[str, set] = {}
    for chart in panels_of(page("t", "s", made_.sections)).values():
        for trace in (trace for panel in chart for trace in panel["data"]):
            if trace["line"]["width"]:
                colours.setdefault(trace["meta"]["method"], set()).add(trace["line"]["color"])
    assert colours == {name: {look.colour} for name, look in METHODS.items()}


def test_spread_is_shown_where_there_is_one(store):
    for seed, value in enumerate((1e-6, 2e-6, 4e-6)):
        add_run(store, seed=seed, metrics={"test_mse": value})
    made_ = report(read(store, ["thesis"]), "it")
    table = next(t for s in made_.sections for t in s.tables if t.key == "table_pendulum")
    assert "2.00e-6 [1.00e-6, 4.00e-6]" in markdown(table)
    chart = next(
        c for s in made_.sections for c in s.charts if c.key == "data_size_pendulum_errors"
    )
    (line,) = [s for p in chart.panels for s in p.series if s.source == "ours"]
    assert (line.low, line.y, line.high) == ([1e-6], [2e-6], [4e-6])


def test_latex_escapes_what_it_must():
    table = Table("k", "50 % of a_b & c", ["x²", "σ"], [["{1}", "÷2 ± 3"]], ["#1"])
    text = latex(table)
    assert r"50 \% of a\_b \& c" in text
    assert r"x$^2$ & $\sigma$ \\" in text
    assert r"\{1\} & $\div$2 $\pm$ 3 \\" in text
    assert text.isascii()


def test_what_is_missing_is_told_of_the_main_variant_alone(store):
    add_run(store, n_traj=8, parameters={"preset": "default"})
    add_run(store, noise_std=0.01, parameters={"learning_rate": 1e-3})
    tables = {table.key: table for table in progress(read(store, ["thesis"]))}
    main_rows = {row[0] for row in tables["progress_sizes"].rows}
    assert {"pendulum", "acrobot", "cartpole"} <= main_rows
    others = [table for key, table in tables.items() if "learning_rate" in key]
    assert all(any(cell != "–" for cell in row[2:]) for table in others for row in table.rows)
    assert not any(key.startswith("progress_sizes_learning_rate") for key in tables)
