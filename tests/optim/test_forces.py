"""Epochs on forces: where fits of accelerations end with an immovable body, they find the truth."""

import copy
from functools import partial

import pytest
import torch

from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Trajectories
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.objectives import PreconditionedResidual, RootError, StateError
from symo_exp.models.symo import SyMo
from symo_exp.nets.dissipation import LearnedDissipation
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.training.learner import Learner
from tests.learned import double_precision

H = 0.02


def slides(n, *, inertia, friction):
    """A chain of slides, each a body on the one before."""
    torch.manual_seed(0)
    with double_precision():
        return SyMo(
            coordinates=Coordinates(tuple("abc"[:n]), (False,) * n), input_matrix=torch.eye(n),
            time_step=H, objective=PreconditionedResidual(), integrator=Galerkin(stages=2),
            root=Newton(),
            lagrangian=partial(
                RigidChain, initial_inertia=inertia, axes=[[1, 0, 0], [0, 1, 0], [0, 0, 1]][:n]
            ),
            dissipation=partial(LearnedDissipation, start=friction),
        )  # fmt: skip


def motions(model, *, forced=True, count=8):
    """Windows of motions of a model."""
    n, steps = model.input_matrix.shape[0], 20
    generator = torch.Generator().manual_seed(1)
    q, v = torch.randn(2, count, n, dtype=torch.float64, generator=generator)
    held = 5.0 * torch.randn(count, 1, n, dtype=torch.float64, generator=generator)
    u = (held if forced else torch.zeros_like(held)).expand(-1, steps, -1)
    path = model.for_evaluation().rollout(q, v, u)
    return cut_windows(Trajectories(path.q, path.v, u).each())


def trained(model, samples, *, force_epochs, epochs=60):
    learner = Learner(model)
    optimizer = LevenbergMarquardt(model.parameters(), force_epochs=force_epochs)
    for _ in range(epochs):
        if float(optimizer.epoch(learner, [samples])["train_loss"]) < 1e-24:
            return


@pytest.mark.parametrize(
    ("n", "inertia", "friction"), [(1, 1e3, 1e-4), (1, 1e-2, 1.0), (2, 1e3, 1e-2)]
)
def test_friction_and_inertia_are_found_from_starts_that_are_far_too_small_or_large(
    n, inertia, friction
):
    truth = slides(n, inertia=2.0, friction=0.5)
    samples, q = motions(truth), torch.zeros(1, n, dtype=torch.float64)
    model = slides(n, inertia=inertia, friction=friction)
    trained(model, samples, force_epochs=40)
    found, expected = model.dissipation.coefficients()[0], truth.dissipation.coefficients()[0]
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-8)
    expected = truth.lagrangian.mass_matrix(q)
    torch.testing.assert_close(model.lagrangian.mass_matrix(q), expected, rtol=1e-6, atol=1e-8)


def test_forces_come_first_on_few_samples_and_only_where_inputs_act():
    truth = slides(1, inertia=2.0, friction=0.5)
    for forced in (True, False):
        samples = motions(truth, forced=forced, count=24)
        model = slides(1, inertia=1.0, friction=0.1)
        learner = Learner(model)
        equations = learner.as_forces(samples)
        assert (equations is not None) == forced
        optimizer = LevenbergMarquardt(model.parameters(), force_epochs=2)
        optimizer.damp(1e3)
        start = copy.deepcopy(model)
        loss = float(optimizer.epoch(learner, [samples])["train_loss"])
        if forced:
            few = samples.rows(slice(None, None, len(samples.q) // (8 * len(optimizer.flat()))))
            expected = Learner(start).as_forces(samples).residuals(few)
        else:
            expected = Learner(start).residuals(samples)
        assert loss == pytest.approx(expected.square().mean().item(), rel=1e-9)
        assert (optimizer.memory["forces"] == 0) != forced


def test_objectives_without_forces_have_none():
    model = slides(1, inertia=2.0, friction=0.5)
    samples, flow = motions(model), model.flow
    for objective in (StateError(), RootError()):
        assert objective.as_forces(flow, samples) is None
