"""Who may import whom, and who does, read from the sources."""

import ast
from collections.abc import Iterator
from pathlib import Path

import symo_exp

ROOT = Path(symo_exp.__file__).parent

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
    "models": ({"mechanics", "nets", "optim"}, {"torch", "jaxtyping", "torchdiffeq"}),
    "compile": ({"mechanics", "nets", "models"}, {"torch", "jaxtyping"}),
    "data": (
        {"mechanics", "systems"},
        {"torch", "jaxtyping", "lightning", "numpy", "scipy", "pandas", "pyarrow", "filelock",
         "rosbags"},
    ),
    "evaluation": (
        {"mechanics", "nets", "optim", "systems", "data", "models"},
        {"torch", "jaxtyping", "numpy"},
    ),
    "runs": ({"models"}, {"torch", "yaml", "hydra", "pyarrow", "filelock"}),
    "process": (set(), set()),
    "training": (
        {"mechanics", "models", "optim", "process", "runs", "compile"},
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
        {"process", "runs", "tracking", "training", "evaluation", "report", "data", "systems"},
        {"hydra", "omegaconf", "lightning", "torch"},
    ),
    "cli": ({"process", "job"}, {"hydra", "omegaconf", "yaml"}),
    "sweep": (
        {"process", "job", "cli", "runs", "tracking", "evaluation", "report"},
        {"hydra", "omegaconf", "yaml"},
    ),
    "identify": (
        {"process", "mechanics", "systems", "data", "evaluation", "runs", "sweep"},
        {"hydra", "omegaconf", "numpy", "torch"},
    ),
    "use": (
        {"mechanics", "systems", "nets", "models", "compile", "runs", "tracking", "cli", "sweep"},
        {"torch", "numpy", "gymnasium", "pandas", "PIL"},
    ),
}  # fmt: skip


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


def graph() -> dict[str, set[str]]:
    """Package: the packages of ours that it imports."""
    named = {package: {name for file in files(package) for name in imports(file)}
             for package in RULES}  # fmt: skip
    return {
        package: {other for other in set(RULES) - {package}
                  if any(f"{name}.".startswith(f"symo_exp.{other}.") for name in names)}
        for package, names in named.items()
    }  # fmt: skip
