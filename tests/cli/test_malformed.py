"""Invalid files, folders and places are refused in one line that says what is wrong.

Keys and values are in ``test_main``, tables in ``data``, damaged checkpoints in
``training/test_resume``.
"""

import pytest

from symo_exp.errors import ConfigError
from tests.jobs import refusal

NODE = "_target_: symo_exp.models.node.NODE\n"
YAML = {
    "tab": ("_target_:\tsymo_exp.models.node.NODE\n\twidth: 3\n", "tab.yaml"),
    "open": ("a: [1, 2\n", "open.yaml"),
    "twice": ("width: 1\nwidth: 2\n", "duplicate key width"),
    "itself": ("a: &x [*x]\n", "refers to itself"),
    "list": ("- a\n- b\n", "needs a _target_"),
    "nothing": ("", "needs a _target_"),
    "bytes": (bytes(range(128, 256)), "not UTF-8 text"),
    "python": ("_target_: !!python/object/apply:os.mkdir ['harm']\n", "python.yaml"),
    "number": ("_target_: 3\n", "model._target_=3 is refused"),
    "missing": ("_target_: symo_exp.models.nothing.Here\n", "no attribute 'nothing'"),
    "deep": (
        NODE + "integrator: {_target_: os.mkdir, path: harm}\n",
        "model.integrator._target_=os.mkdir is refused",
    ),
    "positional": (
        NODE + "_args_: [1, 2]\ninteger: 3\n",
        "does not take it; did you mean model.integrator",
    ),
    "dangling": (NODE + "net: ${nowhere}\n", "model.net refers to nowhere, which is not a setting"),
    "circle": (NODE + "net: ${model.integrator}\nintegrator: ${model.net}\n", "model.net"),
}
"""Contents of a model file, and words of the refusal."""
FOLDER = "is not the name of a folder"
BELOW = "names a folder below output_dir"
FILES = "expected a file that ends in .csv"
STORE = "is not supported by MLflow"
PLACES = [
    ("output_dir=", f"output_dir='' {FOLDER}"),
    ("output_dir=3", f"output_dir=3 {FOLDER}"),
    (
        "experiment=2024",
        "experiment=2024 is not the name of a folder; if it is, give \"experiment='2024'\"",
    ),
    ("output_dir=file", "file cannot be written (Not a directory); choose another"),
    ("experiment=", f"experiment='' {FOLDER}"),
    ("experiment=..", f"experiment='..' {BELOW}"),
    ("experiment=a//b", f"experiment='a//b' {BELOW}"),
    *((f"{x}={'x' * 300}", f"{x}=xxx") for x in ("experiment", "output_dir")),
    ("data.cache_dir=file", "file is not a directory"),
    ("logger.directory=file", "file/mlflow.db is not writable"),
    ("logger.tracking_uri=postgresql://", STORE),
    ("logger.tracking_uri=file:///somewhere", STORE),
    ("logger.every_n_epochs=0", "logger.every_n_epochs=0: expected a whole number of at least 1"),
    ("logger.timeout=0", "logger.timeout=0: expected a finite number above 0"),
    ("logger.flush_seconds=-1", "logger.flush_seconds=-1: expected a finite number of at least 0"),
    ("resume=perhaps", "resume=perhaps has the wrong type: expected true or false"),
    ("data=recorded data.path=folder", "the folder has no .parquet, .csv, .npz"),
    ("data=recorded data.path=/dev/null", FILES),
    ("data=recorded data.path=../whole.pdf", "there is no such file or folder"),
]
SWEPT = [
    ("defaults: 7\n", "defaults must be a list"),
    ("defaults: [nowhere]\n", "nowhere is not a choice; possible: accuracy"),
    ("defaults: [mine]\n", "refers to itself"),
]


@pytest.fixture
def refused(workplace, monkeypatch):
    """Give a command, which has to be refused in a line and leave nothing."""
    monkeypatch.setenv("HOME", str(workplace))

    def refused(*words):
        line = refusal(*words)
        assert "\n" not in line
        assert not [*workplace.rglob("harm"), *workplace.rglob("*.ckpt"), *workplace.rglob("*.npz")]
        return line

    return refused


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A folder of files of models; a command reads the one that it names."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "model").mkdir()
    for name, (text, _) in YAML.items():
        content = text if isinstance(text, bytes) else text.encode()
        (folder / "model" / f"{name}.yaml").write_bytes(content)
    return str(folder)


@pytest.mark.parametrize("name", YAML)
def test_an_invalid_file_of_the_configuration_is_refused(name, mine, refused):
    assert YAML[name][1] in refused("--config-dir", mine, f"model={name}")


@pytest.mark.parametrize(("text", "wanted"), SWEPT)
def test_an_invalid_file_of_a_sweep_is_refused(text, wanted, refused, workplace):
    (workplace / "sweeps").mkdir()
    (workplace / "sweeps" / "mine.yaml").write_text(text)
    assert wanted in refused("--config-dir", "sweeps", "-cn", "mine")


@pytest.mark.parametrize(("typed", "wanted"), PLACES, ids=[typed for typed, _ in PLACES])
def test_an_invalid_place_is_refused(typed, wanted, refused, workplace):
    (workplace / "file").write_text("in the way")
    (workplace / "folder").mkdir()
    assert wanted in refused("model=node", *typed.split())


def test_a_refusal_is_one_line_whatever_words_it_repeats():
    assert str(ConfigError("data.path=a\n  b: no\tfile\n")) == "data.path=a b: no file"
