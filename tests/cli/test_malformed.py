"""Invalid files, folders and places are refused in one line each.

Keys and values are in ``test_main``, damaged checkpoints in ``training/test_resume``.
"""

import numpy as np
import pandas as pd
import pytest

from tests.jobs import refusal

TABLE = pd.DataFrame(
    {
        "trajectory": np.repeat(range(3), 5),
        "t": np.tile(0.1 * np.arange(5), 3),
        "q_theta": 0.01 * np.arange(15),
        "u_0": 0.0,
    }
)
FOURTH = TABLE.index == 4


def whole(folder):
    TABLE.to_parquet(folder / "whole.parquet")
    return (folder / "whole.parquet").read_bytes()


BYTES = {
    "half.parquet": lambda folder: whole(folder)[:900],
    "cut.parquet": lambda folder: whole(folder)[:-1],
    "empty.parquet": lambda folder: b"",
    "text.parquet": lambda folder: b"my diary",
    "empty.csv": lambda folder: b"",
    "binary.csv": lambda folder: bytes(range(256)) * 20,
    "ragged.csv": lambda folder: b"trajectory,t,q_theta\n0,0,0\n0,0.1,0,5,6\n",
    "header.csv": lambda folder: b"trajectory,t,q_theta,u_0\n",
}
TABLES = {
    "no_pose": TABLE.drop(columns="q_theta"),
    "nan": TABLE.assign(q_theta=TABLE.q_theta.where(~FOURTH)),
    "infinite": TABLE.assign(q_theta=TABLE.q_theta.where(~FOURTH, np.inf)),
    "other_step": TABLE.assign(t=2.0 * TABLE.t),
    "wrapped": TABLE.assign(q_theta=6.2 * (TABLE.index % 2)),
    "short": TABLE[TABLE.index % 5 < 2],
    "one": TABLE[TABLE.trajectory == 0],
    "lists": TABLE.assign(q_theta=[[1.0, 2.0]] * len(TABLE)),
    "dates": TABLE.assign(t=pd.Timestamp("2020-01-01")),
    "nameless": TABLE.assign(trajectory=[None] * len(TABLE)),
    "words": TABLE.assign(q_theta="north"),
}
NODE = "_target_: symo_exp.models.node.NODE\n"
YAML = {
    "tab": "_target_:\tsymo_exp.models.node.NODE\n\twidth: 3\n",
    "open": "a: [1, 2\n",
    "twice": "width: 1\nwidth: 2\n",
    "itself": "a: &x [*x]\n",
    "list": "- a\n- b\n",
    "word": "hello\n",
    "nothing": "",
    "bytes": bytes(range(128, 256)),
    "python": "_target_: !!python/object/apply:os.mkdir ['harm']\n",
    "number": "_target_: 3\n",
    "null": "_target_: null\n",
    "missing": "_target_: symo_exp.models.nothing.Here\n",
    "shell": "_target_: os.mkdir\npath: harm\n",
    "deep": NODE + "integrator: {_target_: os.mkdir, path: harm}\n",
    "by_detour": NODE + "integrator: {_target_: symo_exp.tracking.store.os.mkdir, path: harm}\n",
    "positional": NODE + "_args_: [1, 2]\ninteger: 3\n",
    "dangling": NODE + "net: ${nowhere}\nintegrator: ${integrator.explicit}\n",
    "circle": NODE + "net: ${model.integrator}\nintegrator: ${model.net}\n",
}
PLACES = [
    "output_dir=",
    "output_dir=null",
    "output_dir=3",
    "output_dir=file",
    "output_dir=file/below",
    "experiment=",
    "experiment=null",
    "experiment=..",
    "experiment=a/../../b",
    "experiment=/etc",
    "experiment=a//b",
    "experiment=.hidden",
    "data.cache_dir=file",
    "logger.directory=file",
    "logger.tracking_uri=postgresql://",
    "logger.tracking_uri=file:///somewhere",
    "logger.every_n_epochs=0",
    "logger.timeout=-1",
    "resume=perhaps",
    "pictures=3",
    "data=recorded data.path=folder",
    "data=recorded data.path=/dev/null",
    "data=recorded data.path=../whole.txt",
]


@pytest.fixture
def refused(workplace, monkeypatch):
    """Give a command, which has to be refused in a line and leave nothing."""
    monkeypatch.setenv("HOME", str(workplace))

    def refused(*words):
        line = refusal(*words)
        assert len(line) > 10
        assert "\n" not in line
        assert not [*workplace.rglob("harm"), *workplace.rglob("*.ckpt"), *workplace.rglob("*.npz")]
        return line

    return refused


@pytest.mark.parametrize("name", BYTES)
def test_a_file_of_recordings_that_is_none(name, refused, workplace):
    (workplace / name).write_bytes(BYTES[name](workplace))
    assert name in refused("model=node", "data=recorded", f"data.path={name}")


@pytest.mark.parametrize("name", TABLES)
def test_a_table_of_recordings_with_wrong_columns(name, refused, workplace):
    TABLES[name].to_parquet(workplace / f"{name}.parquet")
    assert name in refused("model=node", "data=recorded", f"data.path={name}.parquet")


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A folder of files of models; a command reads the one that it names."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "model").mkdir()
    for name, text in YAML.items():
        content = text if isinstance(text, bytes) else text.encode()
        (folder / "model" / f"{name}.yaml").write_bytes(content)
    return str(folder)


@pytest.mark.parametrize("name", YAML)
def test_a_file_of_the_configuration_that_is_none(name, mine, refused):
    refused("--config-dir", mine, f"model={name}")


@pytest.mark.parametrize("text", ["defaults: 7\n", "defaults: [nowhere]\n", "defaults: [mine]\n"])
def test_a_sweep_that_cannot_be_composed(text, refused, workplace):
    (workplace / "sweeps").mkdir()
    (workplace / "sweeps" / "mine.yaml").write_text(text)
    refused("--config-dir", "sweeps", "-cn", "mine")


@pytest.mark.parametrize("typed", PLACES)
def test_a_place_that_cannot_be(typed, refused, workplace):
    (workplace / "file").write_text("in the way")
    (workplace / "folder").mkdir()
    refused("model=node", *typed.split())
