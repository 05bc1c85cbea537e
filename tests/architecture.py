"""Allowed and actual imports, read from the sources."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import symo_exp

ROOT = Path(symo_exp.__file__).parent
PLUGINS = ROOT.parent / "hydra_plugins"
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

# package: (packages of ours it may import, third parties it may import)
RULES = {
    "mechanics": (set(), {"torch", "jaxtyping"}),
    "systems": (
        {"mechanics"},
        {"torch", "jaxtyping", "numpy", "scipy", "gymnasium", "pygame", "PIL", "yaml",
         "mujoco"},
    ),
    "nets": ({"mechanics"}, {"torch", "jaxtyping"}),
    "optim": ({"mechanics", "nets"}, {"torch", "jaxtyping", "numpy", "scipy"}),
    "models": ({"mechanics", "nets", "optim"}, {"torch", "jaxtyping", "torchdiffeq", "numpy"}),
    "compile": ({"mechanics", "nets", "models"}, {"torch", "jaxtyping"}),
    "data": (
        {"mechanics", "systems", "process"},
        {"torch", "jaxtyping", "lightning", "numpy", "scipy", "pandas", "pyarrow", "filelock",
         "rosbags"},
    ),
    "evaluation": (
        {"mechanics", "nets", "optim", "systems", "data", "models"},
        {"torch", "jaxtyping", "numpy"},
    ),
    "runs": ({"models", "data"}, {"torch", "yaml", "hydra", "pyarrow", "filelock"}),
    "process": (set(), set()),
    "training": (
        {"mechanics", "nets", "models", "optim", "process", "runs", "compile"},
        {"torch", "jaxtyping", "lightning", "numpy", "tqdm"},
    ),
    "tracking": ({"runs", "models"}, {"torch", "mlflow", "filelock"}),
    "report": (
        {"runs", "tracking", "systems", "models", "evaluation", "mechanics"},
        {"torch", "numpy", "pandas", "matplotlib", "altair", "vl_convert", "jinja2", "PIL", "yaml",
         "mlflow", "pyarrow"},
    ),
    "thesis": (
        {"report", "data", "systems", "tracking"},
        {"torch", "numpy", "scipy", "pandas", "jaxtyping"},
    ),
    "job": (
        # the columns of a recording and what a MuJoCo model says are part of a configuration
        {"process", "runs", "tracking", "training", "evaluation", "report", "data", "systems",
         "models", "optim"},
        {"hydra", "omegaconf", "pydantic", "pydantic_core", "lightning", "torch"},
    ),
    "cli": ({"process", "job"}, {"hydra", "omegaconf", "yaml"}),
    "sweep": (
        {"process", "job", "cli", "runs", "tracking", "evaluation", "report"},
        {"hydra", "omegaconf", "yaml", "optuna"},
    ),
    "identify": (
        {"process", "mechanics", "systems", "data", "evaluation", "runs", "sweep"},
        {"hydra", "joblib", "omegaconf", "numpy", "torch"},
    ),
    "use": (
        {"mechanics", "systems", "nets", "models", "compile", "runs", "tracking", "cli", "sweep"},
        {"torch", "numpy", "gymnasium", "pandas", "PIL"},
    ),
}  # fmt: skip


DOCUMENTED = {"_replace", "_fields", "_asdict", "_make"}
PRIVATE_NAME = re.compile(r"_[a-z]\w*(?<!_)|_(foreach|fused)_\w+")
INTERNAL_NAME = re.compile(r"\w+_loop|\w+_connector|\w+_progress|manual_optimization")
"""Attributes of Lightning's loops: without an underscore, and without a promise to stay."""


@cache
def imports(file: Path) -> tuple[str, ...]:
    found: list[str] = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file} imports relatively"
            assert node.module is not None
            if node.module == "symo_exp":
                found += [f"symo_exp.{alias.name}" for alias in node.names]
            else:
                found.append(node.module)
    return tuple(found)


def foreign_attributes(file: Path) -> Iterator[str]:
    """Private attributes that the file uses and does not define, and internal ones of Lightning.

    Attributes with an underscore that are documented are no private ones: those of named tuples
    and Hydra's keys, as ``_target_``.
    """
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    own = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    own |= {n.attr for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)}
    own |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    used = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    used |= {
        word.value.rpartition(".")[2]
        for node in nodes
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).rpartition(".")[2] in ("getattr", "setattr")
        for word in node.args
        if isinstance(word, ast.Constant) and isinstance(word.value, str)
    }
    yield from sorted(name for name in used - own - DOCUMENTED if PRIVATE_NAME.fullmatch(name))
    yield from sorted(name for name in used if INTERNAL_NAME.fullmatch(name))


def files(package: str) -> list[Path]:
    found = sorted((ROOT / package).rglob("*.py"))
    assert found
    return found


def graph() -> dict[str, set[str]]:
    """Package: the packages of ours that it imports."""
    named = {package: {name for file in files(package) for name in imports(file)}
             for package in RULES}  # fmt: skip
    return {
        package: {other for other in set(RULES) - {package}
                  if any(f"{name}.".startswith(f"symo_exp.{other}.") for name in names)}
        for package, names in named.items()
    }  # fmt: skip


def modules() -> dict[str, Path]:
    """Dotted name: file, of every module of ours and of the benchmarks."""
    found = {}
    for file in (*ROOT.rglob("*.py"), *BENCHMARKS.glob("*.py")):
        home = ROOT if file.is_relative_to(ROOT) else BENCHMARKS
        parts = [home.name, *file.relative_to(home).with_suffix("").parts]
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imported_modules(file: Path) -> Iterator[str]:
    """Yield the names that a file may import: ``from a import b`` gives ``a`` and ``a.b``."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names))


def public_names() -> Iterator[tuple[str, str]]:
    """Yield every public class and function at the top of a file, with that file."""
    for file in sorted(ROOT.rglob("*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                yield node.name, file.relative_to(ROOT).as_posix()
