"""The command of the report, of complete runs, unfinished runs and none."""

import math
import re
import subprocess
import sys
from dataclasses import replace

import pandas as pd
import pytest
from PIL import Image

from symo_exp.identify.candidates import Candidate
from symo_exp.identify.table import write_candidates
from symo_exp.identify.validation import Trial
from symo_exp.report.__main__ import general_report, main
from symo_exp.report.cells import settings_of
from symo_exp.report.looks import in_order
from symo_exp.report.motions import studied
from symo_exp.report.runs import load_runs, save_runs, tidy
from symo_exp.report.tables import ResultTable, markdown_table
from symo_exp.runs.folder import CANDIDATES
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
    assert main([*words, "--all", "--out", str(out)]) == 0
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


RECORDED = {
    "rmse_0.5s": 0.05, "rmse_1s": 0.1, "rmse_2s": 0.2, "constant_velocity_rmse_1s": 1.0,
    "usable_s": 1.0, "windows": 5.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("known", "unit"),
    [
        ({"coordinates": 2.0, "angles": 2.0}, "rad"), ({"coordinates": 1.0, "angles": 0.0}, "m"),
        ({"coordinates": 2.0, "angles": 1.0}, "m, rad"), ({"coordinates": 2.0}, "m, rad"),
        ({}, "m, rad"),
    ],
)  # fmt: skip
def test_tables_and_axes_have_the_units_of_the_coordinates(known, unit):
    """Runs of earlier versions do not say how many of their coordinates are angles."""
    squared = ", ".join(f"{one}²" for one in unit.split(", "))
    measures = {**MEASURES, "inertia_mse": 1e-3, **known}
    cells = [(n, noise) for n in (8, 32) for noise in (0.0, 1e-3, 1e-2)]
    simulated = [row(measures, system="mine", n_traj=n, noise_std=noise) for n, noise in cells]
    of_log = row({**RECORDED, **known}, system="recorded", recording="a.csv", integrator="none")
    report = general_report(tidy([*simulated, of_log]), "")
    labels = {p.x_label for f in report.figures for p in f.panels}
    labels |= {p.y_label for f in report.figures for p in f.panels}
    speeds = ", ".join(f"{one}/s" for one in unit.split(", "))
    assert {f"[{squared}]", f"RMSE [{unit}]", f"noise σ [{unit}; {speeds}]"} < labels
    headings = {heading for one in report.tables for heading in one.header}
    of_table = f"test MSE [{squared}]" if "," not in unit else "test MSE"
    assert {f"RMSE to 1 s [{unit}]", of_table} < headings
    said = " ".join(line for part in report.sections for line in part.text)
    assert f"RMSE to 1 s 0.1 {unit} (constant velocity 1)" in said


def test_a_report_replaces_the_files_of_the_one_before_and_no_others(tmp_path):
    def report(place, system, *words):
        place.mkdir(exist_ok=True)
        out = made(place, [row(system=system, n_traj=n) for n in (8, 32)], *words)
        return {str(path.relative_to(out)) for path in out.rglob("*.*")}

    before = report(tmp_path, "pendulum", "--formats", "svg")
    assert "figures/data_size_pendulum_errors.svg" in before
    mine = {"figures/mine.svg", "tables/mine.tex"}
    for name in mine:
        (tmp_path / "out" / name).write_text("of somebody else")
    assert report(tmp_path, "acrobot") == report(tmp_path / "alone", "acrobot") | mine


def test_of_several_experiments_the_last_is_reported_and_the_option_named(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("old", "new")):
        folder = add_folder(tmp_path / "outputs" / name / "a", experiment=name, seed=seed)
        about = folder.about()
        folder.clear()
        folder.describe(replace(about, started=1e9 + seed))
        folder.record("finished")
    report = tmp_path / "report" / "report.md"
    for words, title, said in [
        ([], "# new:", "new: the last of 2 experiments; --experiment NAME"),
        (["--experiment", "old"], "# old:", ""), (["--all"], "# new, old:", ""),
        (["outputs/old"], "# old:", ""),
    ]:  # fmt: skip
        assert main([*words, "--no-page"]) == 0
        assert report.read_text().startswith(title)
        assert said in capsys.readouterr().out
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: "2")
    assert main(["--no-page"]) == 0
    assert report.read_text().startswith("# old:")
    for end, code, said in [
        (EOFError, 2, "error: no experiment was chosen; give --experiment NAME, or --all"),
        (KeyboardInterrupt, 130, "interrupted"),
    ]:

        def asked(_, end=end):
            raise end

        monkeypatch.setattr("builtins.input", asked)
        capsys.readouterr()
        assert main(["--no-page"]) == code
        assert capsys.readouterr().err == f"symo_exp.report: {said}\n"


def test_the_answer_is_of_the_last_sweep_unless_other_settings_are_asked_for(tmp_path):
    rows = [row({"test_mse": 1.0}, method=method, variant=variant, sweep=sweep, started=started,
                seed=seed)
            for variant, sweep, started, seeds in (("trainer.max_epochs=2", "a", "2026-01-01", 5),
                                                   ("fast", "b", "2026-01-02", 1))
            for seed in range(seeds) for method in ("symo", "node")]  # fmt: skip
    text = (made(tmp_path, rows) / "report.md").read_text()
    assert "and of figures that name no others: fast; 10 runs have other settings" in text
    asked = made(tmp_path, rows, "--settings", "trainer.max_epochs=2") / "report.md"
    assert "name no others: trainer.max_epochs=2; 2 runs" in asked.read_text()


def test_a_last_sweep_without_a_finished_run_leaves_the_answer_to_the_one_before(tmp_path):
    rows = [row({"test_mse": 1.0 + i}, method=method, variant="fast", sweep="a")
            for i, method in enumerate(("symo", "node"))]  # fmt: skip
    rows.append(row(status="KILLED", variant="lr=7", sweep="b", started="2026-01-02"))
    text = (made(tmp_path, rows) / "report.md").read_text()
    assert "**SyMo** has the smallest test error" in text
    assert "others: fast; 1 run has other settings, which the tables list." in text
    assert "1 run has no result: see the last section." in text
    assert "| pendulum | SyMo, midpoint | lr=7 | killed |" in text


def test_run_folders_are_reported_where_there_is_no_store(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = add_folder(tmp_path / "outputs" / "mine" / "a", metrics={"long_term_mse": 0.1})
    (folder / "studies").mkdir()
    swing(nodes=5).to_parquet(folder / "studies" / "long_term.parquet")
    assert main(["--formats", "svg", "--no-page"]) == 0
    assert (tmp_path / "report" / "report.md").read_text().startswith("# mine: SyMo on pendulum\n")
    assert (tmp_path / "report" / "figures" / "long_term_pendulum.svg").exists()


def test_a_damaged_table_of_a_study_is_named_and_left_out(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    folder = add_folder(tmp_path / "outputs" / "mine" / "a", metrics={"long_term_mse": 0.1})
    (folder / "studies").mkdir()
    (folder / "studies" / "long_term.parquet").write_text("garbage")
    assert main(["--formats", "svg", "--no-page"]) == 0
    (line,) = caplog.messages
    assert "long_term.parquet is left out" in line


def test_recordings_without_sizes_or_truth_are_reported(tmp_path):
    arm = {"system": "arm", "noise_std": None, "time_step": None}
    rows = [row({"test_mse": 1e-4 * s}, **arm, n_traj=None, seed=s) for s in (1, 2)]
    rows.append(row({"test_mse": 2e-4}, **arm, n_traj="8.0", method="node"))
    table = (made(tmp_path, rows) / "tables" / "accuracy.md").read_text()
    assert "| arm | – | defaults | SyMo, midpoint | 2 | 1.50e-4 |\n" in table
    assert "| arm | 8 | defaults | NODE, midpoint | 1 | 2.00e-4 |\n" in table


def test_unfinished_runs_and_empty_stores_are_reported(tmp_path):
    rows = [row(system="acrobot", status="FAILED", reason="out of memory")]
    text = (made(tmp_path, rows) / "report.md").read_text()
    assert "1 run: 1 failed." in text
    assert "| acrobot | SyMo, midpoint | defaults | failed | out of memory | 32 | 0 | 0 |" in text
    text = (made(tmp_path, []) / "report.md").read_text()
    assert "There are no finished runs yet" in text


def test_a_single_run_is_described_with_units(tmp_path):
    text = (made(tmp_path, [row(MEASURES)]) / "report.md").read_text()
    assert "**In training time** (32 trajectories): training of SyMo 40 s (pendulum)." in text
    assert "1 run: 1 finished.\n" in text


def test_bad_input_is_a_line_and_code_2(store, tmp_path, capsys):
    add_run(store)
    (tmp_path / "file").write_text("")
    (tmp_path / "torn.parquet").write_text("PAR1")
    (tmp_path / "other.csv").write_text("run_id,value\n1,2\n")
    bare = ["--directory", str(store.database.parent), "--formats"]
    for words, wanted in [
        (["--experiment", "nothing"], "no experiment 'nothing'"),
        (["--system", "nothing"], "no system 'nothing' in these runs; there are: "),
        (["--seed", "99"], "no seed '99' in these runs; there are: 0"),
        (["--tracking-uri", "carrier://pigeon"], "carrier"),
        (["--tracking-uri", "http://127.0.0.1:9"], "127.0.0.1:9"),
        (["--directory", str(tmp_path / "none")], "no tracking store"),
        (["--out", str(tmp_path / "file")], "cannot be written"),
        (["--runs", str(tmp_path / "none.csv")], "cannot be read (No such file"),
        (["--runs", str(tmp_path / "file")], "cannot be read (No columns"),
        (["--runs", str(tmp_path / "torn.parquet")], "torn.parquet cannot be read ("),
        (["--runs", str(tmp_path / "other.csv")], "no column 'variant'"),
        (["--settings", "fast"], "there are: defaults"),
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
    tables = {t.key: t for s in general_report(tidy(rows), "it").sections for t in s.tables}
    wanted = "| pendulum | 32 | defaults | SyMo, midpoint | 3 | 2.00e-6 | 0.5 |"
    assert wanted in markdown_table(tables["accuracy"])


def test_errors_of_several_time_steps_are_apart():
    cells = [{"time_step": 0.1, "seed": seed} for seed in (0, 1)] + [{"time_step": 0.01}]
    grown = [
        row({"test_mse": 1e-4 * cell["time_step"], "test_relative": cell["time_step"],
             "coordinates": float(n)},
            variant=f"system.links={n}", system="chain", **cell)
        for n in (1, 2) for cell in cells
    ]  # fmt: skip
    tables = {t.key: t for s in general_report(tidy(grown), "it").sections for t in s.tables}
    accuracy = tables["accuracy"].rows
    others = accuracy.settings.str.endswith(", time step 0.01 s")
    assert accuracy[others]["test MSE"].tolist() == ["1.00e-6"] * 2
    assert accuracy[~others]["test MSE"].tolist() == ["1.00e-5"] * 2
    (over_n,) = (table.rows for key, table in tables.items() if key.startswith("growth"))
    assert over_n["one-step error over motion"].tolist() == ["0.1"] * 2


ALONE = {
    "noise": row(noise_std=0.01),
    "the true system": row(method="true_ode", integrator="rk4", n_traj="", noise_std=""),
    "no measures": row({}),
    "one measure": row({"test_mse": 1e-3}),
    "no size": row(n_traj=""),
    "no root": row(MEASURES | {"test_mse": math.nan, "integration_mse": math.inf}),
}


@pytest.mark.parametrize("kind", ALONE)
def test_runs_of_one_kind_alone_are_reported(kind):
    report = general_report(tidy([ALONE[kind]]), "it")
    assert "1 run: 1 finished." in [line for s in report.sections for line in s.text]


def test_settings_may_have_lists():
    variant = "system.box.q=[[-1.0, 1.0]], net.width=8"
    assert settings_of(variant) == ["system.box.q=[[-1.0, 1.0]]", "net.width=8"]


def test_each_method_s_study_of_the_lowest_seed_is_drawn(store, tmp_path):
    def add(table, **cell):
        run = add_run(store, metrics={"test_mse": 1e-6, "long_term_mse": 0.1}, **cell)
        if table is not None:
            table.to_parquet(tmp_path / "long_term.parquet")
            connect(store).log_artifact(run, str(tmp_path / "long_term.parquet"), "studies")

    for method, integrator in PAIRS:
        for seed in (2, 1):
            late = 2 * (method == "node")  # whose lowest seed is that of no other
            add(swing(seed, nodes=5), method=method, integrator=integrator, seed=seed + late)
    add_run(store, method="l_node", integrator="rk4")  # it did no study
    other = {"test_mse": 1e-6, "long_term_fast_mse": 0.1}  # of a study with a longer name
    add_run(store, metrics=other, method="symo", seed=0)
    add(None, method="e2e_symo", seed=1)  # its file is gone
    runs = load_runs(store)
    (found,) = studied(runs, ["long_term", "forced"], store)
    assert (found.study, found.system, set(found.tables)) == ("long_term", "pendulum", set(PAIRS))
    assert list(found.tables) == sorted(PAIRS, key=in_order)  # whichever run was first
    assert found.tables["symo", "midpoint"].energy.iloc[0] == 2.0
    figures = [f for s in general_report(runs, "it", store).sections for f in s.figures]
    systems = {figure.key: figure.systems for figure in figures}
    for key in ("long_term_pendulum", "long_term_pendulum_phase_space"):
        assert systems[key] == ["pendulum"]  # the page hides it when another one is selected


def recorded(path, method, rmse, **more):
    """A run on a recording, with a baseline of constant velocity and noise."""
    horizons = ("0.5s", "1s", "2s")
    measures = {"windows": 9.0, "usable_s": 0.7, "noise": 1e-3, "test_mse": 1e-6}
    measures |= {f"rmse_{h}": rmse for h in horizons}
    measures |= {f"constant_velocity_rmse_{h}": 2.0 for h in horizons}
    about = {"variant": f"recorded, data=recorded, data.path={path}", "n_traj": None, **more}
    return row(measures, system="recorded", method=method, recording=path, **about)


def test_parts_of_a_page_and_files_have_names_of_their_own():
    """Also where disks do not tell capital letters from small ones."""
    names = "a b.csv", "A_B.csv"
    rows = [recorded(name, "symo", 0.1) for name in names]
    rows += [
        row({"test_mse": 1e-3, "coordinates": n}, system=system, variant=f"system.n={n}")
        for system in ("arm 1", "ARM/1") for n in (1, 2)
    ]  # fmt: skip
    report = general_report(tidy(rows), "it")
    for parts in ((*report.sections, *report.figures), report.tables):
        keys = [one.key.casefold() for one in parts]
        assert sum(key.startswith("recording_") for key in keys) >= len(names)
        assert len(set(keys)) == len(keys)
        assert all(re.fullmatch(r"\w+", key) for key in keys)


@pytest.mark.parametrize(
    ("cells", "right"),
    [
        (["1.5e-3", "÷2.2", "×17", "–", ""], True), (["diverged", "0.1 ×3", "−2"], True),
        (["0.1", "usable to 1 s"], False), (["rad", "m"], False),
    ],
)  # fmt: skip
def test_columns_of_numbers_are_flush_right(cells, right):
    table = ResultTable("key", "title", pd.DataFrame({"": cells, "of": cells}))
    assert table.numeric == [False, right]
    assert ("| :-- | --: |" in markdown_table(table)) == right


def test_a_search_shows_its_candidates_and_the_model_that_was_tested(tmp_path):
    known = Candidate("links", 1.0, {}), Candidate("network, learned friction", 5.0, {})
    chosen, failed = Trial(known[0], errors={0: 0.1, 1: 0.2}), Trial(known[1], reasons={0: "why"})
    write_candidates(tmp_path / CANDIDATES, [chosen, failed], chosen, "1000 m, rad")
    best = recorded("arm.csv", "symo", 0.1, files=str(tmp_path / "best"))
    fold = recorded("arm.csv", "symo", 0.1, variant="recorded, data.fold=[0, 2]")
    runs = tidy([best, (fold[0], {"val_loss": 0.1})])
    tables = {t.key: t for part in general_report(runs, "it").sections for t in part.tables}
    assert next(iter(tables["recording_arm_csv"].rows[""])) == "SyMo, midpoint"
    candidates = tables["recording_arm_csv_candidates"].rows.set_index("candidate")
    assert list(candidates.index) == ["links (chosen)", "network, learned friction"]
    assert candidates.error["links (chosen)"] == "0.141"
    assert candidates.failed["network, learned friction"] == "why"
    notes = tables["recording_arm_csv_candidates"].notes
    assert "Error [1000 m, rad]: " in notes[0]
    assert f'symo_exp.load("{tmp_path / "best"}")' in notes[-1]


def test_a_search_that_runs_shows_its_candidates_so_far_and_no_empty_table(tmp_path):
    trials = [Trial(Candidate(name, 1.0, {}), errors={0: 0.1}) for name in ("links", "network")]
    write_candidates(tmp_path / CANDIDATES, trials, None, "rad")
    (about, _) = recorded("arm.csv", "symo", 0.1, files=str(tmp_path / "fold"))
    running = general_report(tidy([(about, {"val_loss": 0.1})]), "it")
    assert running.sections[0].text == ["**arm.csv**: not yet measured on the test part."]
    (table,) = running.sections[1].tables
    assert table.key == "recording_arm_csv_candidates"
    assert list(table.rows.candidate) == ["links", "network"]
    assert list(table.rows.error) == ["0.1", "0.1"]
    assert "× chosen" not in table.rows
    assert "None is chosen yet" in table.notes[-1]


def test_each_recording_has_a_section_with_baseline_noise_and_verdict(tmp_path):
    rows = [recorded("a/arm.csv", "symo", 0.1, seed=s) for s in (0, 1)]
    rows += [recorded("a/arm.csv", "node", 0.4), recorded("a/leg.csv", "symo", 3.0)]
    out = made(tmp_path, rows)
    text = (out / "report.md").read_text()
    assert text.startswith("# thesis: 2 methods on arm.csv and leg.csv")
    assert (
        "**arm.csv**: **SyMo, midpoint** predicts best: RMSE to 1 s 0.1 m, rad (constant vel"
        in text
    )
    assert "## Recording arm.csv" in text
    assert "## Recording leg.csv" in text
    arm = (out / "tables" / "recording_arm_csv.md").read_text()
    assert "| SyMo, midpoint | 2 | 0.1 | 0.1 | 0.1 | 0.7 | – | usable to 0.7 s |" in arm
    assert "| NODE, midpoint | 1 | 0.4 | 0.4 | 0.4 |" in arm
    assert "| constant velocity |  | 2 | 2 | 2 |" in arm
    assert "| noise of the measurement |  | 1.00e-3 | 1.00e-3 | 1.00e-3 |" in arm
    leg = (out / "tables" / "recording_leg_csv.md").read_text()
    assert "no better than constant velocity" in leg
    assert not (out / "tables" / "accuracy.md").exists()


@pytest.mark.parametrize("seeds", [1, 2])
def test_notes_and_captions_speak_of_several_seeds_if_there_are_several(seeds):
    of = [
        {"method": method, "seed": seed, "n_traj": n, "noise_std": noise, "integrator": name}
        for method, name in (("symo", "midpoint"), ("symo", "galerkin4"), ("node", "rk4"))
        for seed in range(seeds) for n, noise in ((8, 0.0), (32, 0.0), (32, 0.01), (32, 0.02))
    ]  # fmt: skip
    rows = [row(**cell) for cell in of]
    rows += [
        row(MEASURES | {"coordinates": float(n)}, system="chain", variant=f"system.links={n}",
            seed=seed)
        for n in (1, 2) for seed in range(seeds)
    ]  # fmt: skip
    rows += [recorded("arm.csv", "symo", 0.1, seed=seed) for seed in range(seeds)]
    sections = general_report(tidy(rows), "it", settings="defaults").sections
    found = {figure.key: figure.caption for s in sections for figure in s.figures}
    found |= {f"{table.key} ": " ".join(table.notes) for s in sections for table in s.tables}
    found = {key: text for key, text in found.items() if text and key != "speed"}
    kinds = ("data_size", "noise", "order", "growth", "recording", "best", "accuracy")
    assert {kind for kind in kinds if any(key.startswith(kind) for key in found)} == set(kinds)
    for key, text in found.items():
        assert ("over the seeds" in text) == (seeds > 1), key
        assert seeds > 1 or "band" not in text, key


def test_a_report_of_simulated_runs_starts_without_pytorch():
    modules = "document, files, overview, page"
    code = f"from symo_exp.report import {modules}; import sys; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
