"""Rules on imports and names, read from the sources."""

import re
import sys
from pathlib import Path

import pytest

from tests.architecture import (
    PLUGINS,
    ROOT,
    RULES,
    files,
    foreign_attributes,
    graph,
    imported_modules,
    imports,
    modules,
    public_names,
)

TESTS = Path(__file__).parent
EVERYBODYS = {"checks", "errors", "files", "imports", "locks", "shell", "shipped", "code", "words"}
ABOVE = (
    {"__main__", "avx512", "record", "cli", "compile", "process", "systems", "tracking", "use"},
    {"torch", "gymnasium", "numpy", "pandas"},
)
"""The same as a rule, of the files above the packages."""


def assert_allowed(sources, ours, theirs):
    for file in sources:
        for name in imports(file):
            first, _, rest = name.partition(".")
            if first == "symo_exp":
                other = rest.partition(".")[0]
                assert other in ours | EVERYBODYS, f"{file} imports {name}"
            elif first not in sys.stdlib_module_names | {"typing_extensions"}:
                assert first in theirs, f"{file} imports {name}"


@pytest.mark.parametrize("package", RULES)
def test_a_package_imports_only_what_it_may(package):
    ours, theirs = RULES[package]
    assert_allowed(files(package), ours | {package}, theirs)


def test_files_above_the_packages_import_only_what_they_may():
    assert_allowed(ROOT.glob("*.py"), *ABOVE)


def test_every_package_has_its_rule():
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages == set(RULES)


def test_packages_have_no_import_cycle():
    """A package that imports another, at any remove, is not imported by it."""
    left = graph()
    order = []
    while left:
        free = [package for package, needs in left.items() if not needs & set(left)]
        assert free, f"a circle among {sorted(left)}"
        order += free
        left = {package: needs for package, needs in left.items() if package not in free}
    assert len(order) == len(RULES)


def test_files_have_no_import_cycle():
    """At whatever place of a file the import stands, for a type checker alone included."""
    known = modules()
    left = {
        name: {other for other in imported_modules(file) if other in known} - {name}
        for name, file in known.items()
        if name != "symo_exp"  # which names its public functions
    }
    left = {name: needs - {"symo_exp"} for name, needs in left.items()}
    while left:
        free = [name for name, needs in left.items() if not needs & set(left)]
        circle = sorted(name for name, needs in left.items() if needs & set(left))
        assert free, f"a circle among some of {circle}"
        left = {name: needs for name, needs in left.items() if name not in free}


def test_public_names_are_unique():
    """All but ``main``, the entrance of every command."""
    homes: dict[str, list[str]] = {}
    for name, file in public_names():
        homes.setdefault(name, []).append(file)
    assert {name: found for name, found in homes.items() if len(found) > 1}.keys() <= {"main"}


def test_newtons_iteration_is_written_twice():
    """With branches for root finding, and without for compiled steps.

    No other file evaluates a root problem, but that of an integrator which may have nothing to
    iterate; those of `optim` are other problems.
    """
    evaluates = {
        file.relative_to(ROOT).as_posix()
        for package in RULES.keys() - {"optim"}
        for file in files(package)
        if "problem.at(" in file.read_text(encoding="utf-8")
    }
    assert evaluates == {"mechanics/roots.py", "mechanics/galerkin.py", "compile/newton.py"}


def test_whole_numbers_are_checked_in_one_place():
    found = [file for file in ROOT.rglob("*.py") if "numbers" in imports(file)]
    assert [file.name for file in found] == ["checks.py"]


PRIVATE = re.compile(r"(?:hydra|submitit|lightning|mlflow|omegaconf|loky|joblib)(?:\.\w+)*\._\w+")


def test_libraries_are_used_by_their_public_interface():
    """No mock in the sources, no private module but of torch's compiler, and that in one file."""
    compilers = set()
    for file in [*ROOT.rglob("*.py"), *PLUGINS.glob("*.py")]:
        for name in imports(file):
            assert not PRIVATE.match(name), f"{file} imports {name}"
            if name.startswith(("torch._inductor", "torch._dynamo", "torch.fx.experimental")):
                compilers.add(file)
        assert "unittest" not in file.read_text(encoding="utf-8"), file
    assert len(compilers) <= 1, compilers


PRIVATE_ATTRIBUTES = {
    "compile/inductor.py": {"_unsafe_view"},
    "nets/mlp.py": {"_parameters"},
    "optim/base.py": {"_step_supports_amp_scaling"},
    "optim/direct.py": {
        "_foreach_add_", "_fused_adam_", "_optimizer_step_pre_hooks", "_optimizer_step_post_hooks",
    },
}  # fmt: skip
"""By file: the attributes of PyTorch without a public equivalent, whose use is explained there."""


def test_attributes_of_libraries_are_public():
    found = {
        (file.relative_to(ROOT) if file.is_relative_to(ROOT) else file).as_posix(): names
        for file in (*ROOT.rglob("*.py"), *PLUGINS.glob("*.py"))
        if (names := set(foreign_attributes(file)))
    }
    assert found == PRIVATE_ATTRIBUTES


def test_tests_use_public_attributes():
    """All but ``torch._inductor``, whose failure is simulated, ``os._exit``, and the two steps of
    Hydra that ``composed`` keeps."""
    found = {name for file in TESTS.rglob("*.py") for name in foreign_attributes(file)}
    steps = {"_create_defaults_list", "_compose_config_from_defaults_list"}
    assert found == {"_inductor", "_exit", *steps}
