"""Systems, methods and measures of a user are a class and a file in a folder of the user."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import yaml
from torch import nn

import symo_exp
from symo_exp import code
from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from symo_exp.job.checks import check_settings
from symo_exp.job.parts import build, make
from symo_exp.job.recipe import perform
from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.learned import learned_lagrangian
from symo_exp.runs.folder import About
from tests import pages
from tests.jobs import job_of, planned, refusal
from tests.tiny import TINY

FILES = {
    path.removeprefix("mine/"): text
    for page in pages.PAGES
    if page.stem.startswith("own_")
    for path, text in pages.files(page).items()
}
"""Files that the pages ask to write, by their paths."""
ADDED = {
    "system": "system=spring model=symo system.viscous=[0.1]",
    "integrator": "integrator=heun model=node",
    "objective": "objective=bounded model=symo",
    "method": "model=reversible integrator=rk4",
    "measure": "study=largest model=node",
    "data": "data=oscillations model=symo data.n_traj=2",
    "optimizer": "optimizer=rmsprop model=node",
}
TARGETS = {
    "system": "system._target_",
    "objective": "objective._target_",
    "method": "model._target_",
    "measure": "study.largest._target_",
}
QUIET = [*TINY, "logger=none", "pictures=false"]


def write(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@pytest.fixture
def mine(workplace):
    write(workplace / "mine_own", FILES)
    return workplace / "mine_own"


@pytest.mark.parametrize("what", ADDED)
def test_one_class_and_one_file_add_a_choice(what, mine):
    """Composed and checked as by a command; the next test gives one."""
    quick = [x for x in QUIET if what != "data" or not x.startswith("data.")]
    job = job_of("--config-dir", "mine_own", "code=mine_own", *ADDED[what].split(), *quick)
    folder = job.folder.path
    values = job.values
    perform(build(values, job.folder), values, job.folder, About("a b", {}))
    found = json.loads((folder / "metrics.json").read_text())
    assert found["test_mse"] >= 0.0
    model = symo_exp.load(folder, code="mine_own")
    assert torch.isfinite(model.step(torch.zeros(1), torch.zeros(1)).q).all()
    if what == "measure":
        study = json.loads((folder / "studies" / "largest.json").read_text())
        assert study["measures"]["largest_error"] > 0.0


MODEL = """<mujoco><worldbody>
  <body><joint name="swing" type="hinge" axis="0 1 0"/><geom type="capsule" size=".02 .2"/></body>
</worldbody></mujoco>
"""
REQUIRED = """# @package _global_
defaults: [pendulum]
system:
  mass: ???
  length: ${system.mass}
"""


@pytest.mark.parametrize(
    ("by", "file"),
    [
        ("command", "relative"),
        *(
            pytest.param(*x, marks=pytest.mark.slow)
            for x in [("python", "relative"), ("command", "absolute")]
        ),
    ],
)
def test_a_model_of_mujoco_is_trained(by, file, workplace):
    pytest.importorskip("mujoco")
    (workplace / "arm.xml").write_text(MODEL)
    path = "arm.xml" if file == "relative" else str(workplace / "arm.xml")
    trains(by, "system=mujoco", f"system.model={path}")


@pytest.mark.parametrize("by", ["command", "python"])
def test_a_system_of_ones_own_with_a_required_value_is_trained(by, workplace):
    (workplace / "mine" / "system").mkdir(parents=True)
    (workplace / "mine" / "system" / "swing.yaml").write_text(REQUIRED)
    trains(by, "--config-dir", "mine", "system=swing", "system.mass=2.0")


def trains(by, *words):
    words = [*words, "model=node", *QUIET, "trainer.max_epochs=1", "measures=false"]
    if by == "command":
        assert main(words) == 0
    else:
        symo_exp.run(*words)
    (file,) = Path("outputs").rglob("run.json")
    variant = json.loads(file.read_text())["variant"]
    (required,) = [word for word in words if word.startswith("system.")]
    assert required.removesuffix(".0") in variant


def test_help_lists_choices_of_the_user(mine, capsys):
    assert main(["--help", "--config-dir", "mine_own"]) == 0
    told = capsys.readouterr().out
    for name in ("spring", "heun", "bounded", "reversible", "largest"):
        assert name in told
    assert "A mass on a spring that stiffens." in told


def not_given(folder, file):
    """Have a file name a module of the folder that no command was given, and that does harm."""
    (folder / "not_given.py").write_text("open('harm', 'w').close()\n")
    file.write_text(file.read_text().replace("mine_system", "not_given"))


def test_a_command_runs_no_code_of_a_folder_that_it_is_not_given(mine, workplace, capsys):
    not_given(mine, mine / "system" / "spring.yaml")
    assert main(["--config-dir", "mine_own", "system=spring", "model=node", *QUIET]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "not_given.Spring" in line
    assert "code=FOLDER" in line
    assert not (workplace / "harm").exists()


def test_a_stored_run_is_loaded_without_code_that_is_not_given(mine, workplace):
    words = ["--config-dir", "mine_own", "code=mine_own", "system=spring"]
    assert main([*words, "model=true_variational", *QUIET, "measures=false"]) == 0
    (folder,) = (workplace / "outputs" / "default").glob("*-*")
    assert symo_exp.load(folder).time_step > 0.0
    not_given(workplace, folder / "config.yaml")
    with pytest.raises(ConfigError, match=r"not_given\.Spring is refused.*code=FOLDER"):
        symo_exp.load(folder)
    assert not (workplace / "harm").exists()


DATACLASS = "@dataclass(frozen=True, kw_only=True)\n"
MISTAKES = [
    ("system", DATACLASS, "", "system.mass is set by a file.*it has this field: write @dataclass"),
    ("system", "(LagrangianSystem)", "", r"expected a class that inherits from \S+.System"),
    ("system", 'names=("x",)', 'names="x"', "Spring.coordinates has names=x and angular="),
    ("system", "angular=(False,)", "angular=False", "Spring.coordinates has .*angular=False"),
    ("system", "    def mass_matrix", "    def __post_init__(self): pass\n\n    def mass_matrix",
     "Spring.__post_init__ does not call super"),
    ("method", "(DynamicsModel)", "", r"expected a class that inherits from \S+.DynamicsModel"),
    ("method", "super().__init__(flow, coordinates=coordinates, objective=StateError())", "pass",
     "ReversibleNODE.__init__ does not call super"),
    ("method", "__init__(flow,", "__init__(field,", r"flow is Reversible: expected a \S+.Flow"),
    ("method", "flow, coordinates=coordinates", "flow, coordinates=None", "coordinates is null: "),
    ("method", "objective=StateError()", "objective=StateError", "objective is the class StateErr"),
    ("method", "return 0.5", "0.5", "Reversible.forward.* returns NoneType: expected a tensor"),
    ("method", "-v, u))", "-v, u)).sum(1)", r"has shape \(3,\) for v .* expected \(3, 1\)"),
    ("objective", "(Objective)", "", r"objective is Bounded: expected a \S+.Objective"),
    ("objective", "self, flow, windows", "self, flow", r"Bounded.*fails: TypeError: .*takes 2 pos"),
    ("objective", "return Residuals", "return ", "the result of Bounded.* is Tensor: expected a "),
    ("objective", ".tanh())", ".tanh().sum())", r"values of Bounded.* has shape \(\)"),
    ("measure", DATACLASS, "", "study.largest.name is set by a file.*write @dataclass"),
    ("measure", "__call__", "call", "study=largest is Largest: expected a class with the m"),
    ("measure", "model, system, data, *,", "model, *,", r"study=largest is Largest\(model, \*,"),
]  # fmt: skip


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """A folder with all mistakes: what is chosen from it is composed once."""
    folder = tmp_path_factory.mktemp("ours")
    write(folder, FILES | {"right_drag.py": DRAG, "dissipation/right_drag.yaml": DRAG_FILE})
    for k, (what, before, after, _) in enumerate(MISTAKES):
        write(folder, {f"{what}_{k}.py": changed(FILES[f"mine_{what}.py"], before, after)})
    for name, before, after, _ in DRAG_MISTAKES:
        write(folder, {f"{name}.py": changed(DRAG, before, after)})
    return folder


def changed(text, before, after):
    assert before in text
    return text.replace(before, after)


@pytest.mark.parametrize(("what", "before", "after", "said"), MISTAKES)
def test_a_mistake_in_a_class_is_refused_before_anything_starts(
    what, before, after, said, ours, workplace
):
    name = f"{what}_{MISTAKES.index((what, before, after, said))}"  # a module is imported once
    (class_name,) = re.findall(rf"_target_: mine_{what}\.(\w+)", "".join(FILES.values()))
    words = ["--config-dir", str(ours), f"code={ours}", *ADDED[what].split(), *QUIET]
    told = refusal(*words, f"{TARGETS[what]}={name}.{class_name}")
    assert re.search(said, told)


def changed_spring(mine, name, before, after, **more):
    """The system of a changed module, made like that of a command."""
    (mine / f"{name}.py").write_text(FILES["mine_system.py"].replace(before, after))
    code.add(mine)
    code.locate(f"{name}.Spring", "system._target_")
    settings = yaml.safe_load(FILES["system/spring.yaml"])["system"] | more
    return make({"system": settings | {"_target_": f"{name}.Spring"}}, "system")


@pytest.mark.parametrize(
    ("name", "before", "after", "said"),
    [
        ("no_name", "torch.tensor", "tensor", "NameError: "),
        ("no_module", "import torch", "import torches", "cannot be found: No module named "),
        ("no_field", "self.hardening", "self.harden", "AttributeError: "),
        ("no_key", "    coord", "    def __post_init__(self): {}[0]\n\n    coord", "system: 0"),
    ],
)
def test_an_error_in_a_module_of_the_user_is_told_with_its_line(name, before, after, said, mine):
    line = FILES["mine_system.py"].partition(before)[0].count("\n") + 1
    with pytest.raises(ConfigError, match=rf"{said}.*\({name}\.py, line {line}\)"):
        _ = changed_spring(mine, name, before, after).lagrangian


def test_lists_and_mappings_of_a_class_of_the_user_are_plain(mine):
    """They are part of the identity of simulated data, which is written as JSON."""
    before, given = "    coordinates =", {"gains": [1.0, 2.0], "limits": {"x": [0.0, 1.0]}}
    fields = f"    gains: list[float]\n    limits: dict[str, list[float]]\n{before}"
    system = changed_spring(mine, "with_a_list", before, fields, **given)
    assert {name: getattr(system, name) for name in given} == given
    json.dumps(system.identity())


DRAG = """import torch
from torch import nn

from symo_exp.mechanics.dissipation import Dissipation


class Drag(nn.Module, Dissipation):
    def __init__(self, *, coordinates):
        super().__init__()
        self.rate = nn.Parameter(torch.tensor(1.0))

    def force(self, q, v):
        return -self.rate * v
"""
DRAG_FILE = """# Mine.
_target_: right_drag.Drag
_partial_: true
"""


DRAG_MISTAKES = [
    ("no_dissipation", "Module, Dissipation", "Module", r"expected a \S+.Dissipation"),
    ("one_force", "* v", "* v.sum(1, keepdim=True)", r"shape \(4, 1\) .* expected \(4, 2\)"),
    ("one_number", "* v", "* v.sum(1)", r"shape \(4,\) .* expected \(4, 2\)"),
    ("no_rate", "self.rate *", "self.rates *", r"Drag.force\(q, v\) fails: AttributeError"),
    ("no_width", "coordinates)", "coordinates, width)", "Drag needs width, which its settings"),
    ("no_sizes", "*, coord", "width, size, *, coord", "Drag needs width and size, which "),
    ("no_axes", ", *, coordinates", "", "Drag is given coordinates, which it does not take"),
]


@pytest.mark.parametrize(("name", "before", "after", "said"), DRAG_MISTAKES)
def test_a_mistake_in_a_dissipation_is_refused_before_anything_starts(
    name, before, after, said, ours, workplace
):
    told = refusal(*drag_of(ours), f"dissipation._target_={name}.Drag")
    assert re.search(said, told)


def test_a_dissipation_without_a_mistake_is_accepted(ours, workplace):
    with planned(*drag_of(ours)) as (sweep, jobs):
        sweep.check(jobs)


def drag_of(folder):
    """On two coordinates, to which one force would be broadcast."""
    words = ["--config-dir", str(folder), f"code={folder}", "dissipation=right_drag"]
    return [*words, "system=cartpole", "model=symo", *QUIET]


def test_a_class_takes_what_it_passes_on_to_the_one_that_it_inherits_from(mine):
    text = FILES["mine_objective.py"]
    text += "\nclass More(Bounded):\n    def __init__(self, *, more: int, **given):\n"
    (mine / "with_more.py").write_text(f"{text}        super().__init__(**given)\n")
    code.add(mine)
    node = {"_target_": "with_more.More", "more": 1, "bound": 0.1}
    check_settings(node, node, {}, "objective.")
    for changed, said in [
        ({"bund": 0.1}, r"objective\.bund is not a setting; did you mean objective\.bound"),
        ({"bound": "wide"}, "objective.bound=wide has the wrong type: expected a number"),
    ]:
        with pytest.raises(ConfigError, match=said):
            check_settings(node | changed, node, {}, "objective.")


class Bodies(nn.Module, Lagrangian):
    """A constant inertia without a potential."""

    def __init__(self, *, coordinates):
        super().__init__()
        self.root = nn.Parameter(torch.ones(coordinates.n, coordinates.n))

    def mass_matrix(self, q):
        return (self.root @ self.root.T).expand(len(q), -1, -1)

    def potential(self, q):
        return 0.0 * q.sum(1)


class Uneven(Bodies):
    def mass_matrix(self, q):
        return self.root.triu().expand(len(q), -1, -1)


class Fixed(Bodies):
    def __init__(self, *, coordinates):
        nn.Module.__init__(self)
        self.root = torch.eye(coordinates.n)


@pytest.mark.parametrize(
    ("kind", "said"),
    [(Uneven, "mass_matrix.* is not symmetric"), (Fixed, "no parameters to train; .*nn.Parameter")],
)
def test_a_lagrangian_that_cannot_be_learned_is_refused(kind, said):
    coordinates = Coordinates(("x", "y"), (False, False))
    learned_lagrangian(coordinates, Bodies, None, None)
    with pytest.raises(ConfigError, match=f"{kind.__name__}.*{said}"):
        learned_lagrangian(coordinates, kind, None, None)


def test_a_dissipation_that_adds_energy_is_refused():
    class Motor(Dissipation):
        def force(self, q, v):
            return 0.5 * v

    coordinates = Coordinates(("x", "y"), (False, False))
    with pytest.raises(ConfigError, match=r"Motor.force\(q, v\) adds energy"):
        learned_lagrangian(coordinates, Bodies, lambda coordinates: Motor(), None)


@pytest.mark.parametrize(
    ("before", "after", "error", "said"),
    [
        ("class Spring(LagrangianSystem):", "class Spring(LagrangianSystem)", "SyntaxError", ""),
        ("@dataclass(frozen=True, kw_only=True)", "@dataclass", "TypeError", "cannot inherit"),
        ("@dataclass(", "exit(2)\n@dataclass(", "SystemExit", "2"),
    ],
)
def test_a_module_that_cannot_be_imported_is_refused(before, after, error, said, mine):
    text = FILES["mine_system.py"]
    assert before in text
    module = f"with_a_{error}"  # no name of a module that this process has found before
    (mine / f"{module}.py").write_text(text.replace(before, after))
    yaml = FILES["system/spring.yaml"].replace("mine_system", module)
    (mine / "system" / "spring.yaml").write_text(yaml)
    words = ["--config-dir", "mine_own", "code=mine_own", "system=spring", "model=node", *QUIET]
    told = f"system._target_={module}.Spring cannot be imported: {error}: {said}"
    assert told in refusal(*words)


def test_a_choice_with_the_name_of_one_that_ships_is_refused(mine):
    (mine / "system" / "pendulum.yaml").write_text((mine / "system" / "spring.yaml").read_text())
    words = ["--config-dir", "mine_own", "code=mine_own", "system=pendulum", *QUIET]
    assert "system/pendulum.yaml has the name of a file of symo_exp; rename it" in refusal(*words)


def test_a_box_without_a_range_is_refused_by_the_name_of_the_range(mine):
    file = mine / "system" / "spring.yaml"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(line for line in lines if not line.startswith("    u:")))
    words = ["--config-dir", "mine_own", "code=mine_own", "system=spring", *QUIET]
    assert "has the wrong type: expected u as well" in refusal(*words)


@pytest.mark.slow
def test_a_finished_run_of_own_code_is_loaded_by_the_command_that_names_it(mine):
    words = ["--config-dir", "mine_own", "code=mine_own", "system=spring", *QUIET]
    words += ["model=true_variational", "measures=false"]
    assert main(words) == 0
    again = f"""import symo_exp
assert symo_exp.run(*{words!r}).model.time_step > 0.0
"""
    subprocess.run([sys.executable, "-c", again], check=True, capture_output=True)
    (folder,) = (mine.parent / "outputs" / "default").glob("*-*")
    other = f"""import symo_exp
run = symo_exp.Run({str(folder)!r}, code="mine_own")
assert symo_exp.load(run).time_step == run.model.time_step
"""
    subprocess.run([sys.executable, "-c", other], check=True, capture_output=True)


@pytest.mark.parametrize(
    ("word", "wanted"), [("code=nowhere", "no such folder"), ("code=3", "code")]
)
def test_an_invalid_folder_of_code_is_refused(word, wanted, workplace):
    assert wanted in refusal(word, "model=node", *QUIET)


def test_only_what_the_folder_defines_may_be_named(mine):
    (mine / "subprocess.py").write_text("")  # a name is not enough
    text = FILES["objective/bounded.yaml"].replace("mine_objective.Bounded", "subprocess.Popen")
    (mine / "objective" / "bounded.yaml").write_text(text)
    words = ["--config-dir", "mine_own", "code=mine_own", "objective=bounded", "model=symo"]
    assert "refused" in refusal(*words, *QUIET)


def test_packages_of_an_environment_below_the_folder_are_not_the_users(workplace, monkeypatch):
    packages = workplace / ".venv" / "lib" / "site-packages"
    packages.mkdir(parents=True)
    (packages / "of_environment.py").write_text("def harm(): pass\n")
    (workplace / "own_package").mkdir()
    for name in ("own_package/__init__", "own_package/part"):
        (workplace / f"{name}.py").write_text("from of_environment import harm\ndef own(): pass\n")
    monkeypatch.syspath_prepend(packages)
    code.add(workplace)
    for name in ("own_package", "own_package.part"):
        assert code.locate(f"{name}.own", "model._target_").__module__ == name
        with pytest.raises(ConfigError, match="is refused"):
            code.locate(f"{name}.harm", "model._target_")
    assert set(code.digests(workplace)) == {"own_package/__init__.py", "own_package/part.py"}


def test_an_objective_of_another_kind_of_method_is_refused_in_a_line(mine, capsys):
    file = mine / "objective" / "bounded.yaml"
    objective = "".join(f"  {line}\n" for line in file.read_text().splitlines())
    learner = "learner:\n  objective: ${objective}\n"
    file.write_text(f"# @package _global_\nobjective:\n{objective}{learner}")
    words = ["--config-dir", "mine_own", "code=mine_own", "objective=bounded", "model=node"]
    assert main([*words, *QUIET, "measures=false"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "variational integrators" in line
    assert "model=symo" in line


def test_results_of_code_that_has_changed_since_are_warned_of(mine, capsys):
    file, other = mine / "changing_system.py", mine / "other.py"
    file.write_text(FILES["mine_system.py"])
    other.write_text("")
    yaml = FILES["system/spring.yaml"].replace("mine_system", "changing_system")
    (mine / "system" / "spring.yaml").write_text(yaml)
    words = ["--config-dir", "mine_own", "code=mine_own", "system=spring", "measures=false", *QUIET]
    words += ["model=true_variational"]
    assert main(words) == 0
    assert "changed since" not in "".join(capsys.readouterr())
    other.write_text("not = used\n")
    file.write_text(file.read_text().replace("0.5 * self.stiffness", "0.25 * self.stiffness"))
    assert main(words) == 0
    told = "".join(capsys.readouterr())
    assert "changing_system.py: changed since the start of 1 run; resume=false" in told
    assert "other.py" not in told
    assert "finished already" in told


@pytest.mark.parametrize(("part", "others"), [("model", []), ("system", ["model=node"])])
def test_a_function_that_returns_another_kind_is_refused(part, others, workplace):
    (workplace / part).mkdir()
    code = "class Other: pass\n\ndef other(**given): return Other()\n"
    (workplace / "another_kind.py").write_text(code)
    text = "_target_: another_kind.other\n"
    if part == "system":
        text = f"# @package _global_\nsystem: {{{text.strip()}}}\nlearning_rate: 1e-3\n"
    (workplace / part / "other.yaml").write_text(text)
    given = ["--config-dir", ".", "code=.", f"{part}=other", *others, *QUIET]
    assert f"{part} is Other: expected a symo_exp." in refusal(*given)


@pytest.mark.parametrize(
    ("module", "kind"), [("weighted_by_array", "np.ndarray"), ("weighted_by_one", "float | Tensor")]
)
def test_a_list_is_taken_by_a_class_that_can_make_an_array_of_it(module, kind, workplace):
    (workplace / "objective").mkdir()
    (workplace / f"{module}.py").write_text(f"""
import numpy as np
from torch import Tensor

from symo_exp.models.objectives import PreconditionedResidual

class Weighted(PreconditionedResidual):
    def __init__(self, *, weights: {kind}) -> None:
        self.weights = np.array(weights)
""")
    (workplace / "objective" / "weighted.yaml").write_text(
        f"_target_: {module}.Weighted\nweights: [1.0, 2.0]\n"
    )
    given = ["--config-dir", ".", "code=.", "objective=weighted", "model=symo", *QUIET]
    if kind == "np.ndarray":
        with planned(*given) as (sweep, jobs):
            sweep.check(jobs)
    else:
        assert "weights=[1.0, 2.0] has the wrong type: expected a number" in refusal(*given)
