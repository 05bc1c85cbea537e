"""An exported step equals that of the model, in a process without symo_exp."""

import pkgutil
import subprocess
import sys
from functools import partial
from itertools import cycle
from pathlib import Path

import jaxtyping
import pytest
import torch

import symo_exp
from symo_exp.compile.inductor import stand_ins, trace
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.springs import LinearSprings
from symo_exp.use.export import FixedStep
from tests.models.methods import combinations, make, make_small, windows
from tests.systems.every import SYSTEMS
from tests.tables import arguments_of

ROTATING = [name for name, system in SYSTEMS.items() if system.space.rotations]
"""Systems with rotations."""
PIVOT = "spherical_pendulum"


@pytest.fixture(autouse=True)
def _any_batch(_shapes):
    """Shapes that are looked at while a step is traced would be part of it."""
    jaxtyping.config.update("jaxtyping_disable", True)


ALONE = """
import sys, torch
sys.modules["symo_exp"] = None  # an import fails
step = torch.export.load("model.pt2").module()
given, expected = torch.load("states.pt")
for batch in (1, 4, 5):
    found = step(*(x[:batch] for x in given))
    for mine, theirs in zip(found, expected):
        assert mine.shape == theirs[:batch].shape
        torch.testing.assert_close(mine, theirs[:batch])
q, v, u, _ = given
for _ in range(20):
    q, v, found = step(q, v, u, u)
    assert found.all()
assert not any(name.startswith("symo_exp.") for name in sys.modules)
torch.save(q, "end.pt")
"""


def on(name, method, integrator, **overrides):
    """A model for the coordinates of a system."""
    system = SYSTEMS[name]
    return make(method, integrator, system.coordinates.n, **arguments_of(system), **overrides)


def states(model):
    """Smooth states of a model and controls."""
    data, m = windows(model.coordinates.n), model.input_matrix.shape[1]
    q = model.flow.space.of_vector(data.q)
    return q, data.v, data.u.expand(-1, m), data.u_next.expand(-1, m)


def check_alone(model, folder, iterations):
    """Compare the exported step with the model in another process."""
    given = states(model)
    with torch.no_grad():
        expected = tuple(model.step(*given))[:3]
    symo_exp.export(model, folder / "model.pt2", iterations=iterations)
    torch.save((given, expected), folder / "states.pt")
    done = subprocess.run(
        [sys.executable, "-I", "-c", ALONE], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    held = given[2][:, None].expand(-1, 21, -1)
    end = model.rollout(given[0], given[1], held).q[:, -1]
    torch.testing.assert_close(torch.load(folder / "end.pt"), end)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("chain_2", "node"),
        *(
            pytest.param(*x, marks=pytest.mark.slow)
            for x in [(PIVOT, "symo"), (PIVOT, "node"), (PIVOT, "l_node"), ("chain_2", "symo")]
        ),
    ],
)
def test_a_step_takes_either_precision_and_returns_plain_tensors(method, name, tmp_path):
    model = on(name, method, "midpoint").float()
    path = symo_exp.export(model, tmp_path / "model.pt2", iterations=1)
    step = torch.export.load(path).module()
    given = [x.float() for x in states(model)]
    single, double = step(*given), step(*(x.double() for x in given))
    for a, b in zip(single, double, strict=True):
        assert a.dtype == b.dtype != torch.float64
        torch.testing.assert_close(a, b)
        a.numpy()


def test_a_step_runs_without_this_package(tmp_path):
    check_alone(make("node", "midpoint", 1), tmp_path / "made" / "on the way", iterations=1)


@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize(("method", "integrator"), combinations())
def test_every_step_runs_without_this_package(method, integrator, n, tmp_path):
    check_alone(make(method, integrator, n), tmp_path, iterations=6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method", "integrator"),
    [(name, *pair) for pair, name in zip(combinations(), cycle(ROTATING), strict=False)],
)
def test_every_step_on_rotations_runs_without_this_package(name, method, integrator, tmp_path):
    check_alone(on(name, method, integrator), tmp_path, iterations=6)


PARTS = {
    "springs": {"springs": LinearSprings},
    "input matrix": {"inputs": "learned"},
    "friction of machines": {"dissipation": partial(MachineFriction, stribeck=True, width=3)},
    "known equations": {
        "coordinates": SYSTEMS["chain_2"].coordinates,
        "lagrangian": partial(KnownLagrangian, system=SYSTEMS["chain_2"]),
    },
    "units of its own": {
        "coordinates": Coordinates(("x", "a"), (False, True), units=Units(0.1, 2.0, 10.0)),
        "springs": LinearSprings,
        "dissipation": LearnedDissipation,
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("parts", PARTS)
def test_every_part_of_a_lagrangian_is_exported_for_any_batch(parts, tmp_path):
    model = make("symo", "midpoint", 2, **PARTS[parts])
    path = symo_exp.export(model, tmp_path / "model.pt2", iterations=4)
    step = torch.export.load(path).module()
    generator = torch.Generator().manual_seed(0)
    for batch in (1, 4):
        q, v = 0.1 * torch.randn(2, batch, 2, dtype=torch.float64, generator=generator)
        u = torch.ones(batch, 1, dtype=torch.float64)
        *state, found = step(q, v, u, u)
        assert found.all()
        for mine, theirs in zip(state, model.step(q, v, u, u), strict=False):
            torch.testing.assert_close(mine, theirs, atol=1e-8, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "iterations"), [("chain_1", 2), (PIVOT, 1)])
def test_a_variational_step_reports_roots_that_were_not_found(name, iterations, tmp_path):
    model = on(name, "symo", "midpoint")
    path = symo_exp.export(model, tmp_path / "x.pt2", iterations=iterations)
    q, *moving = states(model)
    at_rest = torch.arange(len(q)) == 0
    given = [q, *(x.masked_fill(at_rest[:, None], 0.0) for x in moving)]
    *state, found = torch.export.load(path).module()(*given)
    assert found.any()
    assert not found.all()
    for mine, theirs in zip(state, model.step(*given), strict=False):
        torch.testing.assert_close(mine[found], theirs[found])


@pytest.mark.parametrize("integrator", ["midpoint", "galerkin4"])
def test_roots_are_judged_in_the_units_of_coordinates(integrator):
    large, (small, sizes) = (build("symo", integrator, 2) for build in (make, make_small))
    q, v, *inputs = states(large)
    judged = []
    for iterations in (1, 2, 3):
        expected = FixedStep(large.flow, iterations)(q, v, *inputs)
        found = FixedStep(small.flow, iterations)(sizes * q, sizes * v, *inputs)
        torch.testing.assert_close(found[0] / sizes, expected[0])
        torch.testing.assert_close(found[1] / sizes, expected[1])
        judged += zip(found[2].tolist(), expected[2].tolist(), strict=True)
    assert set(judged) == {(True, True), (False, False)}


def test_the_known_equations_of_a_model_file_are_the_same_operations_for_any_batch():
    """Of which a file consists: neither numbers of rows nor constants decide about them."""
    system = SYSTEMS["mujoco"]
    lagrangian = KnownLagrangian(system=system)
    q, v, _ = system.points(3, seed=0)

    def derivatives(q, v):
        at = lagrangian.expand(q, v)
        return [*at.values, at.mass(), *at.curvature()]

    graph = trace(derivatives, stand_ins((), (q, v), 3), {})
    checks = [node for node in graph.graph.nodes if "check_errors" in str(node.target)]
    assert not checks  # kernels with such operations are not kept for later processes
    for rows in (1, 3):
        for mine, theirs in zip(graph(q[:rows], v[:rows]), derivatives(q, v), strict=True):
            torch.testing.assert_close(mine, theirs[:rows])


def test_impossible_exports_are_refused_in_one_line(tmp_path, monkeypatch):
    model = make("node", "midpoint", 1)
    (tmp_path / "file").touch()
    wrong = [
        ({"path": "model.zip"}, r"ends in .pt2, .onnx"),
        ({"path": "model.pt2", "iterations": 0}, "at least 1"),
        ({"path": tmp_path / "file" / "model.pt2"}, "cannot be written"),
    ]
    for suffix in (".pt2", ".onnx", ".xml", ".urdf"):
        (tmp_path / f"folder{suffix}").mkdir()
        wrong.append(({"path": tmp_path / f"folder{suffix}"}, "is a folder; give the name of"))
    wrong.append(({"path": None}, r"path\(NoneType\): expected the name of a file"))
    for other in (SYSTEMS["pendulum"], None):
        with pytest.raises(
            ConfigError, match=rf"export\({type(other).__name__}\): expected a model"
        ):
            symo_exp.export(other, "model.pt2")
    lagrangian = {"run": make("l_node", "midpoint", 1), "path": "x.onnx"}
    with monkeypatch.context() as installed:
        installed.setattr("importlib.util.find_spec", lambda name: name)
        with pytest.raises(ConfigError, match="ONNX cannot solve linear equations"):
            symo_exp.export(**lagrangian)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for arguments, said in [*wrong, ({"path": "x.onnx"}, "pip install onnx onnxscript")]:
        with pytest.raises(ConfigError, match=said):
            symo_exp.export(model, **arguments)


def write_onnx(program, *, f, external_data=True, **options):
    """A stand-in of ``torch.onnx.export``: where ONNX is installed, it writes these files."""
    Path(f).write_text("graph")
    if external_data:
        Path(f"{f}.data").write_text("weights")


@pytest.fixture
def _onnx(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    monkeypatch.setattr("torch.onnx.export", write_onnx)


@pytest.mark.usefixtures("_onnx")
def test_an_onnx_file_contains_its_weights(tmp_path):
    path = symo_exp.export(make("node", "midpoint", 1), tmp_path / "made" / "model.onnx")
    assert list(path.parent.iterdir()) == [path]


def test_the_free_dimension_of_an_onnx_file_is_called_batch(tmp_path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxscript")
    path = symo_exp.export(make("node", "midpoint", 1), tmp_path / "model.onnx")
    graph = onnx.load(path).graph
    for one in (*graph.input, *graph.output):
        assert one.type.tensor_type.shape.dim[0].dim_param == "batch"


@pytest.mark.usefixtures("_onnx")
@pytest.mark.parametrize(
    ("name", "function"), [("model.pt2", "torch.export.save"), ("model.onnx", "torch.onnx.export")]
)
def test_an_interrupted_export_keeps_the_file_before(name, function, tmp_path, monkeypatch):
    save = pkgutil.resolve_name(function)

    def interrupted(*arguments, **options):
        save(*arguments, **options)
        raise KeyboardInterrupt

    path = tmp_path / name
    path.write_text("before")
    monkeypatch.setattr(function, interrupted)
    with pytest.raises(KeyboardInterrupt):
        symo_exp.export(make("node", "midpoint", 1), path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
