"""Files of recordings as tables: CSV, Parquet, NumPy, MATLAB and ROS 2 bags."""

from __future__ import annotations

import codecs
import csv
import glob
import hashlib
import itertools
import os
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet
import scipy.io

from symo_exp.data.languages import WORDS
from symo_exp.errors import ConfigError, first_line, shortened

TABLES = (".parquet", ".csv", ".npz", ".mat")
TEXT = (".csv", ".tsv", ".txt", ".dat")
"""Text files; in a folder only the first kind is taken for a recording."""
BAGS = (".db3", ".mcap", ".bag")
TIME_UNITS = {
    "d": "d", "day": "d", "days": "d", "h": "h", "hour": "h", "hours": "h", "min": "min",
    "minutes": "min", "s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "msec": "ms",
    "millis": "ms", "milliseconds": "ms", "us": "us", "\u00b5s": "us", "\u03bcs": "us",
    "usec": "us", "micros": "us", "microseconds": "us", "ns": "ns", "nsec": "ns", "nanos": "ns",
    "nanoseconds": "ns",
}  # fmt: skip
"""Units of time as names state them, by their spelling."""
IN_UNIT = r"(?:_(UNIT)|(?: *[\[(]| in )(UNIT)[\])]?)".replace("UNIT", "|".join(TIME_UNITS))
CLOCKS = "|".join((*WORDS["time"].split(), *WORDS["timestamp"].split()))
TIME = re.compile(rf"_*(?:t|times?|timestamps?|stamps?|{CLOCKS})(?:{IN_UNIT})?", re.IGNORECASE)
"""Names of a time column, with the unit that they state."""
IN_TIME = re.compile(rf".+{IN_UNIT}", re.IGNORECASE)
"""Names that state a unit of time."""
UNREADABLE = (
    OSError, ValueError, TypeError, IndexError, EOFError, csv.Error, zipfile.BadZipFile, zlib.error,
    scipy.io.matlab.MatReadError,
)  # fmt: skip
"""Errors of a file that is damaged or of another format, those of pandas and Arrow among them."""
JOINTS = "sensor_msgs/msg/JointState"
COMMENT = re.compile(r"\s*[#%]+\s*")
"""The beginning of a comment before the table."""
SEPARATOR = re.compile(r'"?sep=.?"?\s*')
"""A line before the table with which spreadsheets state the separator."""
NUMBER = re.compile(r"\s*[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?\s*")
"""A word that is a number, perhaps with a decimal comma."""
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+\D*\d*")
"""A word that is a number with a decimal comma, or with commas between thousands."""
WITH_COMMA = r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$"
"""A number with a decimal comma alone."""
FEWEST_CELLS = 2
"""In a row: a time and a position."""
BEGINNING = 50
"""Lines of a text file from which its dialect is inferred."""
NO_TEXT = "it is no text in a known encoding; save it as UTF-8"
OTHER_FILES = {
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "save the sheet as CSV"),
    **dict.fromkeys(("", ".asc", ".log"), "rename a table of text to mine.csv"),
    ".npy": "save t, q and u by numpy.savez",
    **dict.fromkeys((".gz", ".bz2", ".xz", ".zst", ".zip", ".7z"), "unpack it"),
    **dict.fromkeys(
        (".json", ".jsonl", ".feather", ".h5", ".hdf5", ".pkl"),
        "read it with pandas and write it by DataFrame.to_csv(..., index=False)",
    ),
}
"""What to do with other files, by their suffix."""

Location = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""One file, folder or glob pattern, or a list of them."""


def shown(path: Location) -> str:
    """Return ``data.path=...`` as it begins every message about it."""
    if isinstance(path, str | os.PathLike):
        return f"data.path={path}"
    return f"data.path=[{few(list(path))}]"


def few(words: Sequence[object]) -> str:
    """Return the first words in a line, and how many are left."""
    text = ", ".join(map(str, words[:12]))
    return f"{text}, and {len(words) - 12} more" if len(words) > 12 else text


def titled(label: str) -> str:
    """Return how messages call a trajectory, which has no name if it is alone."""
    return f"trajectory {label}" if label else "the recording"


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


def files(path: Location) -> list[Path]:
    """Return the files that a path names, in order.

    Args:
        path: A file, a folder of tables, a bag, a glob pattern, or a list of these.

    Raises:
        ConfigError: If nothing is found or a file has an unknown suffix.
    """
    if isinstance(path, pd.DataFrame):
        raise ConfigError(
            "data.path is a DataFrame: write it with to_parquet('mine.parquet') and give that path"
        )
    if isinstance(path, Sequence) and not isinstance(path, str) and path:
        return [file for one in path for file in files(one)]
    if not isinstance(path, str | os.PathLike) or not str(path):
        raise ConfigError(
            f"data.path={path!r}: expected a file, a folder, a pattern such as 'logs/*.csv' or a "
            "list of these"
        )
    file = Path(str(path)).expanduser()
    if is_bag(file):
        return [file]
    if file.is_dir():
        there = (one for one in file.iterdir() if not one.name.startswith("."))
        tables = (one for one in there if suffix(one) in TABLES or is_bag(one))
        found = sorted(tables, key=_by_number)
        if not found:
            raise ConfigError(f"{shown(path)}: the folder has no {', '.join(TABLES)} file or bag")
        return found
    if not file.exists() and glob.has_magic(str(file)):
        matches = sorted(glob.glob(str(file), recursive=True), key=_by_number)
        if not matches:
            raise ConfigError(f"{shown(path)}: no file matches this pattern")
        return files(matches)
    if suffix(file) not in (*TABLES, *TEXT):
        if not file.exists():
            raise ConfigError(f"{shown(path)}: there is no such file or folder")
        mend = f"; {known}" if (known := OTHER_FILES.get(suffix(file))) else ""
        raise ConfigError(
            f"{shown(path)}: expected a file that ends in {', '.join((*TEXT, *TABLES[2:]))} or "
            f"{TABLES[0]}, a ROS 2 bag, or a folder of these{mend}"
        )
    return [file]


def _by_number(path: str | Path) -> tuple[list[tuple[int, str]], str]:
    """Return what orders ``run_9`` before ``run_10``."""
    text = str(path)
    parts = re.split(r"(\d+)", text)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], text


def content_of(paths: Sequence[Path]) -> str:
    """Return a digest of the content of files and of folders of files, read once a version."""
    every = [
        file
        for path in paths
        for file in (sorted(path.rglob("*")) if path.is_dir() else [path])
        if file.is_file()
    ]
    states = [(file.absolute(), file.stat()) for file in every]
    return _content(tuple((file, now.st_mtime_ns, now.st_size) for file, now in states))


@lru_cache(maxsize=64)  # shared by the jobs of a sweep
def _content(versions: tuple[tuple[Path, int, int], ...]) -> str:
    found = hashlib.sha256()
    for file, *_ in versions:
        with file.open("rb") as handle:
            while part := handle.read(2**20):
                found.update(part)
    return found.hexdigest()[:10]


def suffix(file: Path) -> str:
    """Return the suffix in lower case; data loggers write ``LOG.CSV``."""
    return file.suffix.lower()


def is_bag(file: Path) -> bool:
    """Return whether a path is a ROS bag: a file of one, or a folder with its metadata."""
    return suffix(file) in BAGS or (file / "metadata.yaml").is_file()


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
        return from_arrays(_archive(file))
    if suffix(file) == ".mat":
        return from_arrays(_matlab(file))
    return _bag(file)


class Dialect(NamedTuple):
    """How a text file writes a table.

    Attributes:
        encoding: Of the characters.
        separator: Between columns.
        decimal: Decimal sign.
        skipped: Lines before the rows, the line of names included.
        names: Names of the columns.
        cells: In the longest one of the first rows.
        heading: The first line of those before the names that belong to no table.
    """

    encoding: str
    separator: str
    decimal: str
    skipped: int
    names: tuple[str, ...]
    cells: int
    heading: str = ""

    @classmethod
    def of(cls, file: Path) -> Dialect:
        """Infer the dialect from the first lines of a file.

        Before the table there may be blank lines, a line such as ``sep=;``, comments, which begin
        with # or %, and lines of data loggers with fewer cells, such as a date. The last comment
        has the names if rows of numbers follow, as NumPy's ``savetxt`` writes them.
        """
        encoding, before, first = _encoding(file), [], ""
        with file.open(encoding=encoding, newline="") as text:
            lines = (line.rstrip("\r\n") for line in text)
            for line in lines:
                if line.strip() and not (COMMENT.match(line) or SEPARATOR.fullmatch(line)):
                    first = line
                    break
                before.append(line)
            others = list(itertools.islice(lines, BEGINNING))
        skipped, comments = len(before) + 1, list(filter(COMMENT.match, before))
        if comments and re.match(NUMBER.pattern + r"(?:[,;\s]|$)", first):
            skipped, others = len(before), [first, *others]
            first = COMMENT.sub("", comments[-1], count=1)
        heading, place = first, _line_of_names([first, *others])
        if place:
            skipped, first, others = skipped + place, others[place - 1], others[place:]
        separator = _separator(first)
        names, *rows = _cells([first, *others], separator) or [[]]
        comma = any(DECIMAL_COMMA.fullmatch(cell) for row in rows for cell in row)
        return cls(
            encoding, separator, "," if comma else ".", skipped,
            tuple(name.strip() for name in names), max(map(len, rows), default=0),
            heading if place else "",
        )  # fmt: skip

    def read(self, file: Path) -> pd.DataFrame:
        """Return the table without rows that are empty throughout.

        Raises:
            ValueError: If there are cells beyond the last name that are not empty.
        """
        count = len(self.names)
        try:
            table = pd.read_csv(
                file,
                encoding=self.encoding,
                sep=r"\s+" if self.separator == " " else self.separator,
                decimal=self.decimal,
                skiprows=self.skipped,
                skipinitialspace=True,
                header=None,
                names=list(range(max(count, self.cells))),
                low_memory=False,
            )
        except pd.errors.EmptyDataError:
            return pd.DataFrame(columns=self.names)
        if table.iloc[:, count:].notna().any(axis=None):
            raise ValueError(
                f"a row has {self.cells} cells, the line of names {count}, {few(self.names)}; "
                "names are in the first line that is no comment (#)"
            )
        table = table.iloc[:, :count].dropna(how="all").reset_index(drop=True)
        if self.decimal == "," and self.separator != " ":  # a line of words has blanks, too
            # beside words, such as a row of units, numbers are still text
            words = table.select_dtypes(exclude="number")
            table[words.columns] = words.replace(WITH_COMMA, r"\1.\2", regex=True)
        return table

    @property
    def notes(self) -> list[str]:
        """Lines for the log on differences from a plain CSV file."""
        found = []
        if self.heading:
            found.append(f"lines before the names are left out, first {self.heading[:40]!r}")
        names = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "blanks"}
        if self.separator in names:
            decimal = " and decimal commas" if self.decimal == "," else ""
            found.append(f"read with {names[self.separator]} between columns{decimal}")
        return found


def _encoding(file: Path) -> str:
    """Return the encoding that the beginning of a text file shows.

    Spreadsheets also write UTF-16 and the encoding of Windows, in which a degree sign is one byte.

    Raises:
        ValueError: If the first line holds zero bytes, which no text does.
    """
    with file.open("rb") as handle:
        beginning = handle.read(2**16)
    if beginning.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if b"\0" in beginning.partition(b"\n")[0]:
        raise ValueError(NO_TEXT)
    try:
        codecs.getincrementaldecoder("utf-8")().decode(beginning)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _separator(line: str) -> str:
    """Return the separator of the line of names, or of numbers where names are missing.

    Commas are decimal signs if another one makes all cells numbers.
    """
    counts = Counter({sign: line.count(sign) for sign in (",", ";", "\t", "|")})
    for sign, count in counts.items():
        if sign != "," and count and all(map(NUMBER.fullmatch, line.split(sign))):
            return sign
    separator, count = counts.most_common(1)[0]
    return " " if count == 0 and len(line.split()) > 1 else separator


def _line_of_names(lines: Sequence[str]) -> int:
    """Return which line has as many names as the first row of numbers has cells.

    It is the first line, unless that has another number of cells and a later one has as many.
    """
    signs = (";", "\t", "|", ",", " ")
    for place, line in enumerate(lines):
        for sign in signs:
            (cells,) = _cells([line], sign) or [[]]
            if len(cells) < FEWEST_CELLS or not all(map(NUMBER.fullmatch, cells)):
                continue
            heads = [(_cells([head], sign) or [[]])[0] for head in lines[:place]]
            fits = [k for k, head in enumerate(heads) if len(head) == len(cells) and all(head)]
            return fits[0] if fits else 0
    return 0


def _cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    """Return the cells of lines, without their quotes."""
    if separator == " ":
        return [line.split() for line in lines]
    return list(csv.reader(lines, delimiter=separator, skipinitialspace=True))


def from_arrays(arrays: Mapping[str, Any]) -> pd.DataFrame:
    """Return named arrays as a table.

    An array (T,) is a column; (T, k) is k columns ``<name>_0``, ...; (N, T, k) is N trajectories.
    Arrays of other lengths, and those that hold no numbers, are left out. T is the length of the
    array of times, which is named ``t`` or ``time``, perhaps with its unit.

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
    nodes = max(found[times[0]].shape)
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
    if x.size == nodes:
        return np.tile(x.reshape(-1), count)[:, None]
    return np.repeat(x.reshape(-1), nodes)[:, None] if x.size == count else None


def _rows_of_one(x: np.ndarray, nodes: int) -> np.ndarray | None:
    """Return an array of one trajectory as (rows, columns), ``None`` if it does not fit."""
    if x.size == nodes:
        return x.reshape(-1, 1)
    if x.ndim == 2 and nodes in x.shape:
        return x if len(x) == nodes else x.T
    return None


def _archive(file: Path) -> dict[str, np.ndarray]:
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


def _matlab(file: Path) -> dict[str, Any]:
    """Return arrays of a MATLAB file, those in structures by their own names.

    Where different arrays have the same name, it begins with those of the structures.
    """
    try:
        found = scipy.io.loadmat(str(file), simplify_cells=True)
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


def _bag(file: Path) -> pd.DataFrame:
    """Return the joint states of a ROS bag: position ``q_``, velocity ``v_``, effort ``u_``."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ConfigError(
            f"data.path={file}: reading a ROS bag needs rosbags, which is not installed: "
            "pip install 'symo_exp[ros]'"
        ) from error
    folder = file.parent if (file.parent / "metadata.yaml").is_file() and file.is_file() else file
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            topics = {c.topic: c.msgtype for c in reader.connections}
            joints = [c for c in reader.connections if c.msgtype == JOINTS]
            if len({c.topic for c in joints}) != 1:
                there = few(sorted(topics)) or "none"
                raise ConfigError(
                    f"data.path={file}: expected one topic of {JOINTS}; it has {there}; "
                    "save the signals as a table of columns t, q_<name>, u_<name>"
                )
            messages = [
                reader.deserialize(raw, c.msgtype)
                for c, _, raw in reader.messages(connections=joints)
            ]
    except ConfigError:
        raise
    except Exception as error:  # the library has many
        reason = shortened(error, 200)
        raise ConfigError(f"data.path={file}: cannot be read as a ROS bag ({reason})") from error
    return _joint_states(file, messages)


def _joint_states(file: Path, messages: Sequence[Any]) -> pd.DataFrame:
    if not messages:
        raise ConfigError(f"data.path={file}: the bag has no joint states")
    joints = list(messages[0].name)
    whole = [message for message in messages if list(message.name) == joints]
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in whole])
    columns: dict[str, np.ndarray] = {"t": (stamps - stamps[0]) * 1e-9}
    for kind, field in (("q", "position"), ("v", "velocity"), ("u", "effort")):
        if all(len(getattr(message, field)) == len(joints) for message in whole):
            values = np.array([getattr(message, field) for message in whole])
            columns |= {f"{kind}_{name}": values[:, i] for i, name in enumerate(joints)}
    return pd.DataFrame(columns)
