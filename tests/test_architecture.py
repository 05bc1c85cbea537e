"""Who may import whom (the house rules), read from the sources."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import symo_exp

ROOT = Path(symo_exp.__file__).parent

# package: (packages of ours it may import, third parties it may import)
RULES = {
    "mechanics": (set(), {"torch", "jaxtyping"}),
    "systems": ({"mechanics"}, {"torch", "jaxtyping", "numpy", "scipy", "gymnasium", "pygame"}),
    "nets": ({"mechanics"}, {"torch", "jaxtyping"}),
    "optim": ({"mechanics", "nets"}, {"torch", "jaxtyping"}),
    "models": ({"mechanics", "nets", "optim"}, {"torch", "jaxtyping", "lightning", "torchdiffeq"}),
    "data": (
        {"mechanics", "systems"},
        {"torch", "jaxtyping", "lightning", "numpy", "scipy", "pandas", "pyarrow"},
    ),
    "evaluation": ({"mechanics", "systems"}, {"torch", "jaxtyping", "numpy"}),
    "tracking": ({"evaluation"}, {"torch", "lightning", "mlflow", "yaml", "pyarrow", "filelock"}),
    "training": (set(), {"torch", "lightning", "numpy", "tqdm"}),
    "configuration": (set(), {"hydra", "omegaconf", "yaml"}),
}
EVERYBODYS = {"errors", "files", "imports", "slurm"}
CONFIG_HOMES = {"configuration", "launch", "handover", "submitted", "job", "recipe", "trained"}
"""Where objects of Hydra and OmegaConf may be seen; `trained` builds a model from its file."""


def imports(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file} imports relatively"
            assert node.module is not None
            if node.module == "symo_exp":
                yield from (f"symo_exp.{alias.name}" for alias in node.names)
            else:
                yield node.module


def files(package: str) -> list[Path]:
    found = sorted((ROOT / package).rglob("*.py"))
    assert found
    return found


@pytest.mark.parametrize("package", RULES)
def test_a_package_imports_only_what_it_may(package):
    ours, theirs = RULES[package]
    for file in files(package):
        for name in imports(file):
            first, _, rest = name.partition(".")
            if first == "symo_exp":
                other = rest.partition(".")[0]
                assert other in ours | {package} | EVERYBODYS, f"{file} imports {name}"
            elif first not in sys.stdlib_module_names:
                assert first in theirs, f"{file} imports {name}"


def test_every_package_has_its_rule():
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages - {"report"} == set(RULES)


def test_configuration_objects_stay_at_the_entrance():
    for file in ROOT.rglob("*.py"):
        home = file.relative_to(ROOT).parts[0].removesuffix(".py")
        found = {name.partition(".")[0] for name in imports(file)} & {"hydra", "omegaconf"}
        assert home in CONFIG_HOMES or not found, f"{file} imports {found}"


def test_only_tracking_and_report_know_mlflow():
    for file in ROOT.rglob("*.py"):
        home = file.relative_to(ROOT).parts[0]
        if home not in ("tracking", "report"):
            assert "mlflow" not in {name.partition(".")[0] for name in imports(file)}, file
