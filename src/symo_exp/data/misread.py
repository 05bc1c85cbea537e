"""Columns whose names contradict what they are read as."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from symo_exp.data.advice import Columns, converting, suggested_inputs
from symo_exp.data.naming import (
    PLACE,
    SPEED,
    is_no_input,
    is_no_place,
    is_wanted,
    kind_of_column,
    names,
    short_name,
    short_names,
    slope_of,
    unread_unit,
)
from symo_exp.data.paths import few

PLAIN = re.compile(r"q\W?\d*\W?")
"""Names of coordinates in other tables, which are no names of this project."""


class Doubt(NamedTuple):
    """A contradiction, and the mapping of columns that resolves it.

    Attributes:
        told: Words for it, with what to do.
        mapped: Names of this project to those of the file.
        left: Columns that are left out.
        optional: Mapped columns of the file that may be left out instead.
    """

    told: str
    mapped: Mapping[str, str] = {}
    left: Sequence[str] = ()
    optional: Sequence[str] = ()


def doubt_of(found: Sequence[str], new: Sequence[str], given: Columns) -> Doubt | None:
    """Return what the names of some columns contradict, ``None`` if nothing does.

    Args:
        found: Names of the file.
        new: Names of this project.
        given: The mapping of columns; what it says is not doubted.
    """
    stems, quaternion = names("q", new), [f"q_{part}" for part in "wxyz"]
    read = [name for name in new if name[:2] in ("q_", "u_") and name not in given]
    places, inputs = ([x for x in read if x[0] == kind] for kind in "qu")
    every = zip(found, new, strict=True)
    unread = [x for x, ours in every if x == ours and x[:2] not in ("q_", "v_", "u_")]
    if set(quaternion) <= set(places):
        named = {f"q_R_{name[2:]}": name for name in quaternion}
        return Doubt(f"{few(quaternion)} are a quaternion by their names; name its rotation", named)
    wanted = [name for name in places if is_wanted(name)]
    if 0 < len(wanted) < len(stems):
        return Doubt(
            f"{few(wanted)}: what a controller wants, as such names say, is no coordinate; rename "
            "them, or leave them out",
            left=wanted,
        )
    wrong = [name for name in places if is_no_place(name[2:], stems)]
    if 0 < len(wrong) < len(stems):
        return _no_places(wrong, new)
    plain = [name for name in unread if PLAIN.fullmatch(name)]
    if places and plain:
        mapped = {f"q_{key}": x for key, x in zip(short_names(plain, PLACE), plain, strict=True)}
        return Doubt(
            f"{few(places)} would be coordinates by their names, and {few(plain)} would not; if "
            "the latter are, map them",
            mapped,
            left=[name for name in places if name not in mapped],
        )
    if idle := [x for x in inputs if is_no_input(x[2:], [y[2:] for y in inputs if y != x])]:
        return Doubt(
            f"{few(idle)}: no input by its name; rename it if it is one, or leave it out",
            left=idle,
        )
    unmapped = [name for name in unread if kind_of_column(name) == "u"]
    if unmapped and not names("u", new):
        return Doubt(
            f"no column u_<name> with an input, but {few(unmapped)}; map them",
            suggested_inputs(unmapped, stems),
            optional=unmapped,
        )
    moved = {x: y for x, y in zip(new, found, strict=True) if x[:2] in ("q_", "v_")}
    if odd := [name for name in moved.values() if unread_unit(name)]:
        if any(x[:2] == "q_" and y not in odd for x, y in moved.items()):
            return Doubt(f"{converting(odd)}, or leave them out", left=odd)
        return Doubt(converting(odd))
    return None


def _no_places(wrong: Sequence[str], new: Sequence[str]) -> Doubt:
    """Return the doubt about coordinates that are velocities or inputs by their names."""
    left = [stem for stem in names("q", new) if f"q_{stem}" not in wrong]
    rates = {slope_of(x[2:], left) or short_name(x[2:], SPEED): x for x in wrong}
    if len(left) == 1 and kind_of_column(wrong[0][2:]) == "v":
        rates.setdefault(left[0], wrong[0])
    found = {} if names("v", new) else {f"v_{stem}": rates[stem] for stem in left if stem in rates}
    found = found if len(found) == len(left) else {}
    return Doubt(
        f"{few(wrong)}: no coordinate by its name, but a velocity, an acceleration or an input; "
        "rename it if it is one, or read the others",
        found,
        left=[name for name in wrong if name not in found.values()],
    )
