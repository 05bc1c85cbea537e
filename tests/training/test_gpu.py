"""A run on a GPU has the measures of the same run on the processor."""

import pytest
from hydra.utils import get_class

from symo_exp.errors import ConfigError
from tests.models.methods import combinations
from tests.tables import choices, known_systems
from tests.training.runs import CLOCKS, configuration, go

pytestmark = pytest.mark.gpu

SHORT = "dtype=float64 trainer.compile=false data.monitor_trajectories=1"
TURNING = {"lagrangian=rigid_body", "dissipation=body_drag"}
"""Choices for bodies that turn freely."""
GROUPS = "lagrangian", "dissipation", "springs", "objective", "optimizer", "scheduler", "preset"


def words():
    """Each method with each kind of integrator, each system, and each choice of what is learned."""
    for method, integrator in combinations():
        yield f"system=acrobot model={method} integrator={integrator}"
    for system in known_systems():
        for model in "node", "l_node", "symo", "e2e_symo":
            yield f"system={system} model={model}"
    for group in GROUPS:
        for choice in choices(group):
            setting = f"{group}={choice}"
            yield f"system={'rigid_body' if setting in TURNING else 'acrobot'} {setting}"


@pytest.mark.parametrize("words", list(words()))
def test_measures_are_those_of_the_processor(words, workplace):
    words = f"{words} {SHORT}"
    optimizer = get_class(configuration(words)["optimizer"]["_target_"])
    if getattr(optimizer, "processor_only", False):
        with pytest.raises(ConfigError, match="trainer=cpu"):
            go(f"{words} trainer=gpu", workplace / "gpu")
        return
    expected = go(words, workplace / "cpu")
    found = go(f"{words} trainer=gpu", workplace / "gpu")
    assert found.keys() == expected.keys()
    for name in expected.keys() - CLOCKS:
        near = pytest.approx(float(expected[name]), rel=1e-6, nan_ok=True)
        assert float(found[name]) == near, name
