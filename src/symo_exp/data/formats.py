"""Files of recordings as tables: CSV, Parquet, NumPy, MATLAB and ROS 2 bags."""

from __future__ import annotations

import csv
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pyarrow.parquet
import scipy.io

from symo_exp.data.arrays import archive_of, from_arrays, matlab_arrays
from symo_exp.data.bags import bag_table
from symo_exp.data.dialect import NO_TEXT, Dialect
from symo_exp.data.paths import TEXT, Location, shown, suffix
from symo_exp.errors import ConfigError, first_line

UNREADABLE = (
    OSError, ValueError, TypeError, IndexError, EOFError, RuntimeError, csv.Error,
    zipfile.BadZipFile, zlib.error, scipy.io.matlab.MatReadError,
)  # fmt: skip
"""Errors of a file that is damaged or of another format, those of pandas and Arrow among them."""


def columns_of(file: Path) -> list[str]:
    """Return the names of a file's columns without reading all of its rows."""
    if suffix(file) in TEXT:
        return list(Dialect.of(file).names)
    if suffix(file) == ".parquet":
        return [str(name) for name in pyarrow.parquet.read_schema(file).names]
    return [str(name) for name in table_of(file).columns]


def table_of(file: Path) -> pd.DataFrame:
    """Return all rows of a file; the columns are those of ``columns_of``."""
    if suffix(file) in TEXT:
        return Dialect.of(file).read(file)
    if suffix(file) == ".parquet":  # an index that was written along is a column like others
        return pyarrow.parquet.read_table(file).to_pandas(ignore_metadata=True)
    if suffix(file) == ".npz":
        return from_arrays(archive_of(file))
    if suffix(file) == ".mat":
        return from_arrays(matlab_arrays(file))
    return bag_table(file)


@contextmanager
def readable(path: Location) -> Iterator[None]:
    """Turn errors of reading a file into a ``ConfigError``."""
    try:
        yield
    except ConfigError:
        raise
    except UNREADABLE as error:
        told = NO_TEXT if isinstance(error, UnicodeError) else first_line(error)
        reason = getattr(error, "strerror", None) or told
        raise ConfigError(f"{shown(path)}: cannot be read ({reason})") from error
