"""Arrays of NumPy and MATLAB as tables."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io

from symo_exp.data.clocks import TIME
from symo_exp.data.elements import check_elements
from symo_exp.data.paths import few
from symo_exp.errors import ConfigError, first_line


def from_arrays(arrays: Mapping[str, Any]) -> pd.DataFrame:
    """Return named arrays as a table.

    An array (T,) is a column; (T, k) is k columns ``<name>_0``, ...; (N, T, k) is N trajectories.
    Arrays of other lengths, and those that hold no numbers, are left out. T is the length of the
    array of times, (T,) or (N, T), which is named ``t`` or ``time``, perhaps with its unit.

    Raises:
        ValueError: If there is no array of times, or a signal has another length.
    """
    found = {name: np.asarray(x) for name, x in arrays.items()}
    found = {name: x for name, x in found.items() if x.dtype.kind in "biufUSMm" and x.size > 1}
    times = [name for name in found if TIME.fullmatch(name)]
    if not times:
        raise ValueError(
            f"there is no array of times named t among {few(sorted(arrays)) or 'none'}: save t, q "
            "and u as arrays with a row for each sample"
        )
    clock, signals = found[times[0]].shape, {x.shape[:2] for x in found.values() if x.ndim == 3}
    nodes = clock[1] if clock[:2] in signals else max(clock)
    count = max((len(x) for x in found.values() if x.ndim == 3 and x.shape[1] == nodes), default=0)
    columns: dict[str, np.ndarray] = {}
    if count:
        columns["trajectory"] = np.repeat(np.arange(count), nodes)
    for name, x in found.items():
        rows = _rows_of_many(x, count, nodes) if count else _rows_of_one(x, nodes)
        if rows is None:
            _refuse_signal(name, x, times[0], nodes)
            continue
        many = rows.shape[1] > 1 or x.ndim == 3 or name in ("q", "v", "u")
        for i, column in enumerate(rows.T):
            columns[f"{name}_{i}" if many else name] = column
    return pd.DataFrame(columns)


def _refuse_signal(name: str, x: np.ndarray, clock: str, nodes: int) -> None:
    """Refuse an array that is left out if its name or its length is that of a signal."""
    rows = min(x.shape, key=lambda size: abs(size - nodes))
    if abs(rows - nodes) == 1 or re.match(r"[qvu](_|$)", name):
        raise ValueError(
            f"{name} has {rows} rows, {clock} {nodes}; save arrays of one length (repeat the last "
            f"input), or leave {name} out of the file"
        )


def _rows_of_many(x: np.ndarray, count: int, nodes: int) -> np.ndarray | None:
    """Return an array of ``count`` trajectories as (rows, columns), ``None`` if it does not fit."""
    if x.ndim <= 3 and x.shape[:2] == (count, nodes):
        return x.reshape(count * nodes, -1)
    if max(x.shape) == x.size == nodes:
        return np.tile(x.reshape(-1), count)[:, None]
    return np.repeat(x.reshape(-1), nodes)[:, None] if max(x.shape) == x.size == count else None


def _rows_of_one(x: np.ndarray, nodes: int) -> np.ndarray | None:
    """Return an array of one trajectory as (rows, columns), ``None`` if it does not fit."""
    if max(x.shape) == x.size == nodes:
        return x.reshape(-1, 1)
    if x.ndim == 2 and nodes in x.shape:
        return x if len(x) == nodes else x.T
    return None


def archive_of(file: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file of ``numpy.savez``.

    Raises:
        ValueError: If it is another file, or an array holds objects.
    """
    with file.open("rb") as handle:
        if not zipfile.is_zipfile(handle):
            raise ValueError("it is no archive of arrays, as numpy.savez writes them")
    found = {}
    with np.load(file, allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                found[name] = arrays[name]
            except ValueError as error:
                raise ValueError(
                    f"array {name}: {first_line(error)}; save arrays of numbers, or leave {name} "
                    "out of the file"
                ) from error
    return found


def matlab_arrays(file: Path) -> dict[str, Any]:
    """Return arrays of a MATLAB file, those in structures by their own names.

    Where different arrays have the same name, it begins with those of the structures.

    Raises:
        ConfigError: If the file is of MATLAB 7.3.
        ValueError: If it is damaged.
    """
    if scipy.io.matlab.matfile_version(str(file))[0] == 1:
        check_elements(file.read_bytes())
    try:
        found = scipy.io.loadmat(str(file), simplify_cells=True)
    except (NameError, ArithmeticError, MemoryError) as error:  # as SciPy takes damaged sizes
        raise ValueError(f"it is damaged: {first_line(error)}") from error
    except NotImplementedError:
        raise ConfigError(
            f"data.path={file}: MATLAB 7.3 files are not read; save with save('{file.name}', '-v7')"
        ) from None
    flat: dict[tuple[str, ...], Any] = {}

    def add(values: Mapping[str, Any], inside: tuple[str, ...] = ()) -> None:
        for name, value in values.items():
            path = (*inside, name)
            if isinstance(value, Mapping):
                add(value, path)
            elif not name.startswith("__") and np.size(value) > 1:
                flat[path] = value

    add(found)
    same: dict[str, list[Any]] = {}
    for (*_, name), value in flat.items():
        same.setdefault(name, []).append(value)
    return {
        path[-1] if all(np.array_equal(x, value) for x in same[path[-1]]) else "_".join(path): value
        for path, value in flat.items()
    }
