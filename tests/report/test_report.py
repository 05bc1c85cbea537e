"""The command: from runs that are complete, half there and none."""

import pandas as pd
import pytest
from PIL import Image

from symo_exp.report.__main__ import main, report
from symo_exp.report.motions import studied
from symo_exp.report.runs import read_runs, save_runs, tidy
from symo_exp.report.tables import markdown_table
from symo_exp.tracking.store import connect
from tests.report.stores import MEASURES, add_folder, add_run, row
from tests.report.test_figures import PAIRS, swing


def made(tmp_path, rows, *words):
    """A report without figures and page of the runs, in the folder that is returned."""
    saved = save_runs(tidy(rows), tmp_path / "made.parquet")
    bare = ["--runs", str(saved), "--out", str(tmp_path / "out"), "--formats", "--no-page"]
    assert main([*bare, *words]) == 0
    return tmp_path / "out"


def test_a_store_becomes_tables_figures_and_a_page(store, tmp_path, capsys):
    for method, integrator in PAIRS:
        for n_traj in (8, 32):
            cell = {"method": method, "integrator": integrator, "n_traj": n_traj}
            add_run(store, experiment="mine", metrics={"test_mse": 1e-6}, **cell)
    add_run(store, experiment="other", method="true_ode", metrics={"test_mse": 1e-8})
    out = tmp_path / "out"
    words = ["--directory", str(store.database.parent), "--formats", "png", "pdf"]
    assert main([*words, "--out", str(out)]) == 0  # all there is
    assert "index.html" in capsys.readouterr().out
    tidy = pd.read_csv(out / "runs.csv")
    assert tidy.run_id.nunique() == 5
    assert len(pd.read_parquet(out / "runs.parquet")) == len(tidy)
    text = (out / "report.md").read_text()
    assert text.startswith("# mine, other: 2 methods on pendulum\n\n**From few data**")
    name = "data_size_pendulum_errors"
    with Image.open(out / "figures" / f"{name}.png") as picture:
        assert picture.width > 500
    assert (out / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    assert f"figures/{name}.png" in text
    again = tmp_path / "again"
    bare = ["--formats", "--no-page"]
    assert main(["--runs", str(out / "runs.csv"), "--out", str(again), *bare]) == 0
    for table in (out / "tables").iterdir():
        assert (again / "tables" / table.name).read_text() == table.read_text()


def test_run_folders_are_reported_where_there_is_no_store(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = add_folder(tmp_path / "outputs" / "mine" / "a", metrics={"long_term_mse": 0.1})
    (folder / "studies").mkdir()
    swing(nodes=5).to_parquet(folder / "studies" / "long_term.parquet")
    assert main(["--formats", "svg", "--no-page"]) == 0
    assert (tmp_path / "report" / "report.md").read_text().startswith("# mine: SyMo on pendulum\n")
    assert (tmp_path / "report" / "figures" / "long_term_pendulum.svg").exists()


def test_recordings_without_sizes_or_truth_are_reported(tmp_path):
    arm = {"system": "arm", "noise_std": None, "time_step": None}
    rows = [row({"test_mse": 1e-4 * s}, **arm, n_traj=None, seed=s) for s in (1, 2)]
    rows.append(row({"test_mse": 2e-4}, **arm, n_traj="8.0", method="node"))
    table = (made(tmp_path, rows) / "tables" / "accuracy.md").read_text()
    assert "| arm | – | defaults | SyMo, midpoint | 2 | 1.50e-4 |\n" in table
    assert "| arm | 8 | defaults | NODE, midpoint | 1 | 2.00e-4 |\n" in table


def test_what_is_unfinished_is_told_and_that_there_is_nothing(tmp_path):
    rows = [row(system="acrobot", status="FAILED", reason="out of memory")]
    text = (made(tmp_path, rows) / "report.md").read_text()
    assert "1 runs: 1 failed" in text
    assert "| acrobot | SyMo, midpoint | 32 | 0 | 0 | failed | out of memory |" in text
    text = (made(tmp_path, rows, "--seed", "5") / "report.md").read_text()
    assert "There are no finished runs yet" in text


def test_bad_input_is_a_line_and_code_2(store, tmp_path, capsys):
    add_run(store)
    (tmp_path / "file").write_text("")
    (tmp_path / "torn.parquet").write_text("PAR1")
    (tmp_path / "other.csv").write_text("run_id,value\n1,2\n")
    bare = ["--directory", str(store.database.parent), "--formats"]
    for words, wanted in [
        (["--experiment", "nothing"], "no experiment 'nothing'"),
        (["--tracking-uri", "carrier://pigeon"], "carrier"),
        (["--tracking-uri", "http://127.0.0.1:9"], "127.0.0.1:9"),
        (["--directory", str(tmp_path / "none")], "no tracking store"),
        (["--out", str(tmp_path / "file")], "cannot be written"),
        (["--runs", str(tmp_path / "none.csv")], "cannot be read (No such file"),
        (["--runs", str(tmp_path / "file")], "cannot be read (No columns"),
        (["--runs", str(tmp_path / "torn.parquet")], "torn.parquet cannot be read ("),
        (["--runs", str(tmp_path / "other.csv")], "no column 'variant'"),
    ]:
        assert main([*bare, "--out", str(tmp_path / "out"), *words]) == 2, words
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith("symo_exp.report: error: ")
        assert wanted in line
    with pytest.raises(SystemExit) as ended:
        main(["--seed", "first"])
    assert ended.value.code == 2


def test_tables_have_the_numbers_of_the_runs():
    values = enumerate((1e-6, 2e-6, 4e-6))
    rows = [row(MEASURES | {"test_mse": value}, seed=seed) for seed, value in values]
    tables = {t.key: t for s in report(tidy(rows), "it").sections for t in s.tables}
    wanted = "| pendulum | 32 | defaults | SyMo, midpoint | 3 | 2.00e-6 | 0.5 |"
    assert wanted in markdown_table(tables["accuracy"])


def test_each_method_s_study_of_the_lowest_seed_is_drawn(store, tmp_path):
    def add(table, **cell):
        run = add_run(store, metrics={"test_mse": 1e-6, "long_term_mse": 0.1}, **cell)
        if table is not None:
            table.to_parquet(tmp_path / "long_term.parquet")
            connect(store).log_artifact(run, str(tmp_path / "long_term.parquet"), "studies")

    for method, integrator in PAIRS:
        for seed in (2, 1):
            add(swing(seed, nodes=5), method=method, integrator=integrator, seed=seed)
    add_run(store, method="l_node", integrator="rk4")  # it did no study
    add(None, method="e2e_symo", seed=1)  # its file is gone
    runs = read_runs(store)
    (found,) = studied(runs, ["long_term", "forced"], store)
    assert (found.study, found.system, set(found.tables)) == ("long_term", "pendulum", set(PAIRS))
    assert found.tables["symo", "midpoint"].energy.iloc[0] == 2.0
    keys = {f.key for s in report(runs, "it", store).sections for f in s.figures}
    assert {"long_term_pendulum", "long_term_pendulum_phase_space"} <= keys
