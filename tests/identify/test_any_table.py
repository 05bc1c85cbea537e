"""Tables of any pace, size and length: the search infers a machine or refuses them in one line."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from symo_exp.errors import ConfigError
from symo_exp.identify.recordings import examine
from tests.data.test_malformed_tables import CHANGES, saved

NAMES = ["theta", "x", "slide", "a", "arm_deg", "z_mm"]


def any_table(rng: np.random.Generator) -> pd.DataFrame:
    """Motions from microseconds to hours and micrometres to kilometres, perhaps with a pause."""
    n, nodes = int(rng.integers(1, 4)), int(rng.choice([2, 3, 5, 8, 15, 30, 80, 200]))
    pace, size = (10 ** rng.uniform(*ends, 2)[0] for ends in ((-6, 2), (-6, 4)))
    k = np.arange(nodes) + rng.uniform(-0.3, 0.3, nodes) * (rng.random() < 0.3)
    pause = (k > nodes / 2) * 10 ** rng.uniform(0, 4) * (rng.random() < 0.3)
    noise, names = rng.choice([0, 1e-3, 0.1]), rng.choice(NAMES, n, replace=False)
    tables = []
    for label in range(int(rng.integers(1, 7))):
        columns = {"trajectory": np.full(nodes, label), "t": pace * (k + pause)}
        for i, name in enumerate(names):
            q = rng.uniform(0, 3) * np.sin((1 + i) * k / 7 + label) + k * rng.choice([0, 0, 0.2])
            columns[f"q_{name}"] = size * (q + noise * rng.normal(size=nodes))
            columns[f"u_{name}"] = np.cos(k / 5 + i) * 10 ** rng.uniform(-3, 3)
        tables.append(pd.DataFrame(columns))
    table = pd.concat(tables, ignore_index=True)
    return table if rng.random() < 0.6 else table.drop(columns=[f"u_{x}" for x in names])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 20))]
)
def test_every_table_is_examined_or_refused_in_a_line(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    ends = {"examined": 0, "refused": 0}
    for k in range(30):
        table = any_table(rng)
        if rng.random() < 0.3:
            with contextlib.suppress(Exception):  # a change may not suit this table
                table = rng.choice(np.array(CHANGES, dtype=object))(table, rng)
        path = saved(table, rng, tmp_path)
        given = {"angular": str(rng.choice(["all", "none"]))} if rng.random() < 0.6 else {}
        try:
            examine({"path": str(path), "time_unit": "s"}, **given)
        except ConfigError as error:
            if "\n" in str(error) or len(str(error)) > 900:
                pytest.fail(f"{seed}, {k}: {error}")
            ends["refused"] += 1
        else:
            ends["examined"] += 1
        path.unlink()
    assert min(ends.values()) >= 3, ends
