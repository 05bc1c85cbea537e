"""A short training on clean data finds the physics, from the command line to the file."""

import json

import pytest

from symo_exp.__main__ import main

INERTIA = 1.0 / 3.0
"""Of the pendulum, a rod of 1 kg and 1 m about its end [kg m^2]."""


@pytest.mark.parametrize(
    "model", ["symo", *(pytest.param(m, marks=pytest.mark.slow) for m in ("e2e_symo", "l_node"))]
)
def test_the_inertia_of_the_pendulum_is_recovered_within_five_per_cent(model, tmp_path):
    integrator = "rk4" if model == "l_node" else "midpoint"
    command = [
        f"model={model}",
        f"integrator={integrator}",
        "system=pendulum",
        "objective=preconditioned",
        "optimizer=adam_then_lm",
        "dtype=float64",
        "net.width=16",
        "trainer.max_epochs=70",
        "data.n_traj=8",
        "data.integration_steps=20",
        "pictures=false",
        "logger=none",
        f"output_dir={tmp_path}",
    ]
    assert main(command) == 0
    (measures,) = tmp_path.rglob("metrics.json")
    error = json.loads(measures.read_text())["inertia_mse_aligned"] ** 0.5
    assert error < 0.05 * INERTIA
