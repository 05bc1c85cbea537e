"""Runs that an earlier version stored give the motions and energies that it recorded with them.

Each folder of ``stored`` has the ``config.yaml`` of a run of one epoch, the weights of its
checkpoint, and ``expected.json`` with what a version of before computed from them, roots being
found to rounding.
"""

import json
from pathlib import Path

import pytest
import torch

from symo_exp.models.flows import VariationalFlow
from symo_exp.tracking.load import load

STORED = sorted((Path(__file__).parent / "stored").iterdir())


@pytest.mark.parametrize("folder", STORED, ids=lambda folder: folder.name)
def test_a_stored_run_predicts_what_it_did(folder):
    model = load(folder, dtype=torch.float64).for_evaluation()
    n, m = model.input_matrix.shape
    q = torch.linspace(-0.4, 0.5, 2 * n, dtype=torch.float64).view(2, n)
    v = torch.linspace(0.3, -0.2, 2 * n, dtype=torch.float64).view(2, n)
    u = torch.linspace(-1, 1, 2 * 6 * m, dtype=torch.float64).view(2, 6, m)
    if isinstance(model.flow, VariationalFlow):
        model.flow.rollout_root.tolerance = 1e-15
    motion = model.rollout(q, v, u)
    found = {"q": motion.q, "v": motion.v}
    if model.lagrangian is not None:
        found |= {"energy": model.energy(q, v), "mass_matrix": model.mass_matrix(q)}
    expected = json.loads((folder / "expected.json").read_text())
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        reference = torch.tensor(values, dtype=torch.float64)
        torch.testing.assert_close(found[name], reference, rtol=1e-12, atol=1e-12)
