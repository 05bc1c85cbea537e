"""The speed of this machine, by which a search plans its times."""

from __future__ import annotations

import json
import time
from contextlib import suppress

from symo_exp.files import read_json, user_cache, write_text

REFERENCE = 0.25
"""Time of ``exercise`` on the machine that the times of ``identify.effort`` are those of [s]."""


def machine_speed() -> float:
    """Return the speed of a core of this machine, measured once and kept in the user's cache."""
    file = user_cache() / "speed.json"
    kept = read_json(file)
    known = kept.get("speed")
    if kept.get("reference") == REFERENCE and isinstance(known, float):  # of this version
        return known
    speed = float(f"{REFERENCE / min(exercise() for _ in range(2)):.2g}")
    with suppress(OSError):  # a home that cannot be written: it is measured again
        write_text(file, json.dumps({"speed": speed, "reference": REFERENCE}))
    return speed


def exercise() -> float:
    """Return the processor time of operations like those of a training [s].

    These are short: their number counts more than their arithmetic.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        generator = torch.Generator().manual_seed(0)
        q = torch.rand(1500, 2, generator=generator, dtype=torch.float64)
        m = torch.rand(1500, 2, 2, generator=generator, dtype=torch.float64)
        start = time.process_time()
        for _ in range(1000):
            x = q.clone().requires_grad_()
            moved = (m @ x.unsqueeze(-1)).squeeze(-1)
            energy = (moved * x).sum(1) + torch.sin(x).square().sum(1)
            torch.autograd.grad(energy.sum(), x)
        return time.process_time() - start
    finally:
        torch.set_num_threads(before)
