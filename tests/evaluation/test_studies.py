"""Studies of the true systems in integrators whose properties are known."""

import math
from functools import partial

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.evaluation.learned import LearnedQuantities
from symo_exp.evaluation.motion import Motion, log_volume
from symo_exp.evaluation.study import Finding
from symo_exp.mechanics.explicit import RK4, DormandPrince5, Midpoint
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.node import NODE
from symo_exp.models.true import TrueOde, TrueVariational
from symo_exp.nets.mlp import MLP
from tests.oscillator import oscillator
from tests.tables import arguments_of, systems

SYSTEMS = systems()
ROOT = Newton(tolerance=1e-12, max_iterations=50)


def given(system, lagrangian=None):
    return {"lagrangian": lagrangian or system, **arguments_of(system)}


def variational(system, integrator=None, **other):
    integrator = integrator or VariationalMidpoint()
    return TrueVariational(integrator=integrator, root=ROOT, **given(system, **other))


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[pytest.mark.slow] * (k % 2)) for k, x in enumerate(SYSTEMS)]
)
def test_a_precise_model_follows_the_truth_under_an_input(name):
    """An input that came half a step late would be seen: the reference knows it at every time."""
    system = SYSTEMS[name]
    study = Motion(name="forced", steps=20, amplitude=1.0, period=10.0, count=2)
    finding = study(variational(system, Galerkin(stages=2)), system, None)
    assert finding.measures["forced_configuration_mse"] < 1e-6
    assert finding.measures["forced_valid_steps"] == 20
    explicit = TrueOde(integrator=DormandPrince5(), **given(system))
    assert study(explicit, system, None).measures["forced_configuration_mse"] < 1e-6
    columns = finding.columns
    assert {len(x) for x in columns.values()} == {2 * 21}
    wave = torch.sin(0.2 * math.pi * columns["t"][:21])
    torch.testing.assert_close(columns["u_0"][:21], wave)


def test_the_reference_conserves_energy_without_input():
    system = SYSTEMS["pendulum"]
    finding = Motion(name="long", steps=30)(variational(system), system, None)
    energy = finding.columns["energy_true"].view(4, 31)
    assert (energy - energy[:, :1]).abs().max() < 1e-7
    assert finding.columns["u_0"].abs().max() == 0.0
    assert 0 < finding.measures["long_energy_mse"] < 1e-2


def test_a_study_without_the_truth_has_drift_and_volume():
    system = SYSTEMS["cartpole"]
    model = TrueOde(integrator=RK4(), **given(system))
    alone = Motion(name="drift", steps=50, truth=False)(model, system, None)
    assert set(alone.measures) == {"drift_energy_mse", "drift_volume"}
    assert not any("true_" in name for name in alone.columns)
    assert 0 < alone.measures["drift_energy_mse"] < 1e-8


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_variational_integrator_keeps_the_volume_of_phase_space(name):
    system = SYSTEMS[name]
    study = Motion(name="drift", steps=40, truth=False)
    kept = study(variational(system), system, None).columns["log_volume"]
    assert kept.abs().max() < 1e-9
    lost = study(TrueOde(integrator=Midpoint(), **given(system)), system, None).columns[
        "log_volume"
    ]
    assert lost.abs().max() > 1e-4


def test_the_volume_is_the_determinant_of_the_motion():
    """Of an oscillator under the explicit midpoint rule: 1 + (hω)⁴/4 a coordinate and step."""
    true, h = oscillator(2), 0.3
    model = TrueOde(
        lagrangian=true, coordinates=Coordinates(("a", "b"), (False, False)), time_step=h,
        input_matrix=torch.zeros(2, 1, dtype=torch.float64), integrator=Midpoint(),
    ).double()  # fmt: skip
    q0 = torch.tensor([[0.3, -0.1]], dtype=torch.float64)
    path = model.rollout(q0, 2 * q0, steps=7)
    found = log_volume(model, true, path.q, path.v, torch.zeros(1, 8, 1, dtype=torch.float64))
    frequency = (true.stiffness / true.mass).sqrt()
    step = torch.log(1 + (h * frequency) ** 4 / 4).sum()
    torch.testing.assert_close(found[0], step * torch.arange(8, dtype=torch.float64))


def test_the_volume_is_that_of_momenta():
    """The cartpole's inertia varies along the motion, so velocities would not do."""
    system = SYSTEMS["cartpole"]
    model = variational(system).for_evaluation()
    q, v, _ = system.box.points(2, 0)
    path = model.rollout(q, v, steps=20)
    u = torch.zeros(2, 21, 1, dtype=torch.float64)
    assert log_volume(model, system, path.q, path.v, u).abs().max() < 1e-9

    class Constant(Lagrangian):
        def mass_matrix(self, q):
            return torch.eye(2, dtype=q.dtype).expand(len(q), 2, 2)

        def potential(self, q):
            return q.sum(1)

    assert log_volume(model, Constant(), path.q, path.v, u).abs().max() > 1e-3


def test_starts_are_reproducible_and_in_the_box():
    box = SYSTEMS["acrobot"].box
    points = box.points(50, 3)
    assert all(map(torch.equal, points, box.points(50, 3)))
    assert not torch.equal(points[0], box.points(50, 4)[0])
    for values, ranges in zip(points, box, strict=True):
        low, high = torch.tensor(ranges, dtype=torch.float64).T
        assert ((low <= values) & (values <= high)).all()


def test_the_key_of_the_reference_depends_on_its_settings_alone():
    system, recipes = SYSTEMS["pendulum"], []

    def remember(name, recipe, make):
        recipes.append(recipe)
        return make()

    study = Motion(name="a", steps=3, count=1)
    study(variational(system), system, None, remember=remember)
    study(TrueOde(integrator=RK4(), **given(system)), system, None, remember=remember)
    assert recipes[0] == recipes[1]
    for other in (Motion(name="b", steps=4, count=1), Motion(name="c", steps=3, count=1, seed=1),
                  Motion(name="d", steps=3, count=1, amplitude=2.0)):  # fmt: skip
        other(variational(system), system, None, remember=remember)
        assert recipes[-1] != recipes[0]


def test_learned_quantities_are_compared_with_the_true_ones():
    system = SYSTEMS["acrobot"]
    study = LearnedQuantities(name="learned", steps=20, count=2)
    right = study(variational(system), system, None)
    assert set(right.measures.values()) == {0.0}

    class Twice(Lagrangian):
        def mass_matrix(self, q):
            return 2 * system.mass_matrix(q)

        def potential(self, q):
            return system.potential(q) + 5.0

    wrong = study(variational(system, lagrangian=Twice()), system, None)
    kinetic = right.columns["kinetic_true"]
    assert wrong.measures["learned_kinetic_mse"] == pytest.approx(kinetic.square().mean().item())
    assert wrong.measures["learned_potential_mse"] < 1e-20  # a constant is no error
    mass = right.columns["inertia_11_true"]
    torch.testing.assert_close(wrong.columns["inertia_11"], 2 * mass)
    assert {len(x) for x in wrong.columns.values()} == {2 * 21}


def test_a_method_without_a_lagrangian_has_no_learned_quantities():
    system = SYSTEMS["pendulum"]
    node = NODE(net=partial(MLP, width=4, depth=2), integrator=RK4(), **arguments_of(system))
    assert LearnedQuantities(name="learned", steps=3)(node, system, None).columns == {}
    moved = Motion(name="long", steps=3, count=1)(node, system, None)
    assert moved.columns["log_volume"].isfinite().all()


@pytest.mark.parametrize(
    ("wrong", "wanted"),
    [
        ({"steps": 0}, r"steps=0.*from 1 to"),
        ({"count": 0}, r"count=0.*from 1 to"),
        ({"period": 0.0}, r"period=0\.0.*above 0"),
        ({"amplitude": math.inf}, r"amplitude=inf.*finite"),
    ],
)
def test_invalid_settings_are_refused(wrong, wanted):
    with pytest.raises(ConfigError, match=rf"study\.x.*{wanted}"):
        Motion(**{"name": "x", "steps": 3, **wrong})


def test_a_finding_takes_tensors_and_carries_no_gradient():
    x = torch.ones(3, requires_grad=True)
    found = Finding(columns={"x": 2 * x}, measures={"a_sum": x.sum()})
    assert found.columns["x"].numpy().tolist() == [2.0, 2.0, 2.0]
    assert found.measures == {"a_sum": 3.0}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"columns": {"x": torch.ones(3), "y": torch.ones(4)}}, "shapes .*equal lengths"),
        ({"columns": {"x": torch.ones(3, 2)}}, "expected one dimension"),
        ({"measures": {"a": "text"}}, "the measure a='text': expected a number"),
        ({"measures": {"a": torch.ones(2)}}, "the measure a=.*: expected a number"),
    ],
)
def test_a_finding_that_is_no_table_or_number_is_refused(given, told):
    with pytest.raises(ConfigError, match=told):
        Finding(**given)
