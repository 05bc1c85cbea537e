"""The table of a sweep: within 80 columns, the best of each column marked."""

import math
import time

import pytest

from symo_exp.job.lines import run_line
from symo_exp.runs.folder import About, RunFolder
from symo_exp.runs.outcome import Outcome
from symo_exp.sweep.table import Watch, table

MEASURES = {
    "train_mse": 1.234e-4, "test_mse": 2e-4, "integration_mse": 1.9e6, "energy_mse": 5.0,
    "inertia_mse": 1e-9, "rmse_2s": 0.5, "lr": 1e-3,
}  # fmt: skip


def made(path, *, status="finished", **measures) -> RunFolder:
    folder = RunFolder(path)
    folder.path.mkdir()
    folder.describe(About("SyMo pendulum n=8", {}))
    folder.write_measures(measures)
    folder.record(status, "" if status == "finished" else "out of memory", seconds=12.3)
    return folder


def test_the_table_fits_and_the_best_of_each_column_is_marked(tmp_path):
    long = "model=symo data.n_traj=8 optimizer.lr=1e-3 system.time_step=0.05 seed=12"
    folders = [
        made(tmp_path / "a", **MEASURES),
        made(tmp_path / "b", **{**MEASURES, "test_mse": 1e-7}),
        made(tmp_path / "c", **{**MEASURES, "energy_mse": math.inf, "inertia_mse": math.nan}),
    ]
    lines = table([long, "model=node", "model=symo data.n_traj=8"], folders).splitlines()
    assert max(map(len, lines)) <= 80
    header, first, node, symo, units, *_ = lines
    assert header.split()[:3] == ["train", "test", "integration"]
    assert first.startswith("symo …")
    assert "eed=12  " in first
    assert node.startswith("node  ")
    assert "1.00e-7*" in node
    assert "1.00e-7" not in first + symo
    assert symo.split()[:2] == ["symo", "n=8"]
    assert units.startswith("* the best; MSE in m², rad²; energy in J²; inertia in kg²")


def test_labels_that_differ_in_a_name_with_blanks_or_in_a_long_list_are_told_apart(tmp_path):
    many = ",".join(f"logs/recording_{i}.csv" for i in range(60))
    labels = [*(f"data.path=my log.{i}.csv" for i in range(2)),
              *(f"data.path=[{many},{i}.csv,{many}]" for i in range(2))]  # fmt: skip
    folders = [made(tmp_path / str(i), **MEASURES) for i in range(4)]
    _, *rows = table(labels, folders).splitlines()
    assert rows[0].startswith("path=my log.0.csv ")
    assert rows[1].startswith("path=my log.1.csv ")
    assert rows[2] != rows[3]


@pytest.mark.parametrize(
    ("angles", "units"),
    [
        ((1, 2), ("rad²", "kg² m⁴", "rad")), ((0, 0), ("m²", "kg²", "m")),
        ((0, 2), ("m², rad²", "kg², kg² m², kg² m⁴", "m, rad")),
        ((None, 2), ("m², rad²", "kg², kg² m², kg² m⁴", "m, rad")),
    ],
)  # fmt: skip
def test_the_units_are_those_of_the_coordinates_of_the_runs(angles, units, tmp_path):
    """A run of an earlier version does not say how many of its coordinates are angles."""
    folders = []
    for n, turning in zip((1, 2), angles, strict=True):
        known = {"coordinates": n} if turning is None else {"coordinates": n, "angles": turning}
        baseline = {"rmse_1s": 0.1, "constant_velocity_rmse_1s": 1.0}
        folders.append(made(tmp_path / f"{n}", **MEASURES, **known, **baseline))
    text = " ".join(table(["model=symo", "model=node"], folders).split())
    squared, inertia, plain = units
    assert f"MSE in {squared}; energy in J²; inertia in {inertia}; to 2 s: RMSE in {plain}" in text
    assert text.endswith(f"RMSE to 1 s 0.1 {'rad' if angles[1] else 'm'} (constant velocity 1)")


def test_no_two_runs_have_the_same_name_and_values_are_whole(tmp_path):
    values = "0.1", "0.01", "0.001", "0.0001"
    noises = [f"model=symo data.noise_std={x} seed=0" for x in values]
    long = "model=symo optimizer.lr={} data.n_test=64 data.n_val=1 trainer.max_epochs=7500 seed=12"
    simulated = {name: x for name, x in MEASURES.items() if name != "rmse_2s"}
    for labels in (noises, [long.format(x) for x in values]):
        folders = [made(tmp_path / f"{len(label)}{i}", **simulated)
                   for i, label in enumerate(labels)]  # fmt: skip
        names = [line[: line.index("1.23e-4")].strip()
                 for line in table(labels, folders).splitlines()[1:5]]  # fmt: skip
        assert len(set(names)) == 4
        if labels == noises:
            assert [name.split("=")[1].split()[0] for name in names] == list(values)


def test_the_best_is_marked_for_each_system(tmp_path):
    """Errors of a cartpole are no better than larger ones of an acrobot."""
    found = {"cartpole": (1e-6, 2e-6), "acrobot": (3e-2, 4e-2), "pendulum": (1e-9,)}
    folders = []
    for system, errors in found.items():
        for i, error in enumerate(errors):
            folders.append(made(tmp_path / f"{system}{i}", test_mse=error))
            folders[-1].describe(About("SyMo", {"system": system}))
    _, *rows, units = table([f"{folder}" for folder in folders], folders).splitlines()
    assert ["*" in row for row in rows] == [True, False, True, False, False]
    assert units.startswith("* the best of its system; MSE")


def test_a_run_that_has_not_started_is_of_no_other_system(tmp_path):
    folders = [made(tmp_path / name, test_mse=1.0) for name in "ab"]
    for folder in folders:
        folder.describe(About("SyMo", {"system": "cartpole"}))
    told = table(["a", "b", "c"], [*folders, RunFolder(tmp_path / "c")])
    assert "* the best; MSE" in told


def test_a_single_run_has_no_room_for_marks_and_its_name_is_whole(tmp_path):
    values = {"train_mse": 3.39e-18, "test_mse": 5.23e-18, "integration_mse": 9.76e-12,
              "energy_mse": 1.11e-15, "inertia_mse": 4.16e-15}  # fmt: skip
    lines = table(["SyMo cartpole n=32"], [made(tmp_path / "a", **values)]).splitlines()
    assert lines[1].startswith("SyMo cartpole n=32  3.39e-18  5.23e-18  ")
    assert max(map(len, lines)) <= 80
    assert "*" not in "".join(lines)


def test_parameters_of_a_run_fit_the_terminal(tmp_path, monkeypatch):
    folder = made(tmp_path / "a", test_mse=1.0)
    note = f"determined only together with {', '.join(f'body.inertia_{i}' for i in range(9))}"
    row = {"name": "body.mass", "value": 0.5, "standard_deviation": math.nan, "unit": "kg",
           "determined": "no", "note": note}  # fmt: skip
    folder.write_parameters([row])
    monkeypatch.setenv("COLUMNS", "1000")
    whole = table(["SyMo"], [folder])
    monkeypatch.setenv("COLUMNS", "80")
    told = table(["SyMo"], [folder])
    assert told.split() == whole.split()
    assert max(map(len, told.splitlines())) <= 80 < max(map(len, whole.splitlines()))


def test_measures_of_no_run_have_no_column_and_failures_have_a_reason(tmp_path):
    folders = [made(tmp_path / "a", test_mse=1.0), made(tmp_path / "b", status="failed")]
    assert "log" not in table(["seed=0", "seed=1"], folders)  # it has none
    (folders[1] / "symo_exp.log").touch()
    header, first, second, units, failed = table(["seed=0", "seed=1"], folders).splitlines()
    assert header.split() == ["test", "time"]
    assert first.split() == ["seed=0", "1", "12", "s"]  # nothing to be better than
    assert second.split() == ["seed=1", "-", "12", "s"]
    assert "energy" not in units
    assert failed.startswith("failed: seed=1: out of memory (log: ")
    assert "symo_exp.log" in failed


def test_a_run_is_a_short_line_its_folder_last(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = run_line(made(tmp_path / "a", **MEASURES))
    assert line == "SyMo pendulum n=8  test 2.00e-4  integration 1.90e6  to 2 s 0.5  12 s  a"
    line = run_line(made(tmp_path / "b", status="failed"))
    assert line == "SyMo pendulum n=8  failed: out of memory  12 s  b"


def test_looks_at_many_runs_take_little_of_the_time(tmp_path, monkeypatch):
    monkeypatch.setattr("symo_exp.sweep.table.SECONDS", 0.001)
    looks = []

    def slowly(self):
        looks.append(time.sleep(0.05))
        return Outcome("waiting")

    monkeypatch.setattr(RunFolder, "outcome", slowly)
    with Watch([RunFolder(tmp_path)]):
        time.sleep(0.9)
    assert len(looks) <= 4  # at first, once, and at the end


def test_many_runs_that_did_not_start_are_counted(tmp_path):
    failed = [made(tmp_path / f"f{i}", status="failed") for i in range(5)]
    for folder in failed:
        (folder / "symo_exp.log").touch()  # each has a log of its own
    folders = [*failed, *(RunFolder(tmp_path / f"w{i}") for i in range(200))]
    lines = table([f"seed={i}" for i in range(205)], folders).splitlines()
    assert sum(line.startswith("failed: seed=") for line in lines) == 5
    assert [line.split(": ")[1] for line in lines if line.startswith("waiting: ")] == ["200 runs"]
