"""Machines that are known by their recordings only."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import torch
from typing_extensions import override

from symo_exp.checks import real
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units
from symo_exp.systems.base import System

DEGREES = r"deg(?:s|rees?|r[eé]s?)?|gra(?:d|di|dos|us)|°"
UNIT = re.compile(
    rf"(_| in |[ _]*[\[(])((?:mm?|cm|rad|{DEGREES})(?:/s)?|n[ .*·]?m|n|v|a)[\])]?$", re.I
)
"""A unit at the end of a name, after an underscore or "in", or in brackets."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Recorded(System):
    """A machine whose coordinates and inputs are those of a recording.

    Args:
        names: Names of the coordinates.
        rotations: Names of the rotations ``R``, whose quaternions are the coordinates ``R_w``,
            ``R_x``, ``R_y`` and ``R_z``.
        angular: Coordinates that are angles [rad]: ``"all"``, ``"none"`` or their names.
        inputs: Names of the inputs.
        input_matrix: ``B`` (n, m) of the generalised force ``B u``. ``None``: an input for each
            coordinate, of its name or, if no input has such a name, in their order; (n, 0) without
            inputs. Zeros only beside a rotation, where a body learns how its inputs act.
        scale: Units of ``length`` [m], ``time`` [s] and ``mass`` [kg] in which learned parts of a
            model have their parameters, and settings their initial values, for motions that are
            far from 1 in those of the SI.
    """

    names: Sequence[str]
    rotations: Any = ()
    angular: str | Sequence[str] | None = None
    inputs: Sequence[str] = ()
    input_matrix: Any = None
    scale: Any = SI

    def __post_init__(self) -> None:
        names, inputs = (tuple(map(str, given)) for given in (self.names, self.inputs))
        if not names:
            raise ConfigError(
                "system=recorded has no coordinates: it goes with data=recorded data.path=FILE, "
                "a table with columns q_<name> (data.columns renames others)"
            )
        rotations, flat = _rotations(self.rotations, names)
        angular = _angular(self.angular, flat) if flat else ()
        freedoms = Coordinates.of(flat, (False,) * len(flat), rotations).names
        matrix = _matrix(self.input_matrix, freedoms, inputs, zeros=bool(rotations))
        vars(self).update(
            names=names, angular=angular, rotations=rotations, inputs=inputs, input_matrix=matrix,
            scale=scale_of(self.scale),
        )  # fmt: skip
        super().__post_init__()

    @property
    @override
    def coordinates(self) -> Coordinates:
        assert self.angular is not None
        _, flat = _rotations(self.rotations, tuple(self.names))
        turns = tuple(name in self.angular for name in flat)
        one = len(self.rotations) == 1 and turns == (False,) * 3  # a body that moves freely
        found = Coordinates.of(flat, turns, self.rotations, [(0, 0)] if one else [])
        return found._replace(units=self.scale)


def _rotations(given: object, names: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the rotations and the names of the other coordinates."""
    chosen = [given] if isinstance(given, str) else given
    if not isinstance(chosen, Sequence):
        raise ConfigError(f"system.rotations={given}: expected a list of names, such as [R]")
    rotations = tuple(map(str, chosen))
    parts = [f"{name}_{part}" for name in rotations for part in "wxyz"]
    if missing := [f"q_{part}" for part in parts if part not in names]:
        raise ConfigError(
            f"system.rotations={list(rotations)}: no column {', '.join(missing)}; a rotation R has "
            "the four q_R_w, q_R_x, q_R_y, q_R_z of its quaternion"
        )
    flat = tuple(name for name in names if name not in parts)
    if left := quaternions(flat):
        columns = ", ".join(f"q_{left[0]}_{part}" for part in "wxyz")
        raise ConfigError(
            f"system.rotations={list(rotations)}: {columns} are a quaternion by their names; give "
            f"system.rotations=[{','.join((*rotations, *left))}], or other names by data.columns"
        )
    return rotations, flat


def quaternions(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the rotations whose quaternions are among coordinates."""
    stems = [name.removesuffix("_w") for name in names if name.endswith("_w")]
    return tuple(stem for stem in stems if {f"{stem}_{part}" for part in "wxyz"} <= set(names))


def _angular(given: object, names: tuple[str, ...]) -> tuple[str, ...]:
    if given in ("all", "none"):
        return names if given == "all" else ()
    chosen = [given] if isinstance(given, str) else given
    if isinstance(chosen, Sequence) and set(map(str, chosen)) <= set(names):
        return tuple(map(str, chosen))  # names such as 0 are numbers on a command line
    raise ConfigError(
        f"system.angular={'null' if given is None else given}: which of {', '.join(names)} are "
        "angles? all, none or a list of names"
    )


def scale_of(given: object) -> Units:
    """Return the units of ``system.scale``.

    Raises:
        ConfigError: If it has other names or numbers that are not positive.
    """
    named = given._asdict() if isinstance(given, Units) else given
    if not isinstance(named, Mapping) or not set(named) <= set(Units._fields):
        raise ConfigError(
            f"system.scale={given}: expected numbers for {', '.join(Units._fields)}, such as "
            "system.scale.length=1e-3"
        )
    return Units(**{x: real(f"system.scale.{x}", value, above=0.0) for x, value in named.items()})


def without_unit(name: str) -> str:
    """Return a name without the unit that it ends with."""
    return UNIT.sub("", name)


def matrix_by_names(names: Sequence[str], inputs: Sequence[str]) -> list[list[int]] | None:
    """Return the matrix of inputs with the names of coordinates, ``None`` if others have.

    Units at the ends of names are left out. ``None`` also if names differ in their units alone.
    """
    places, actors = (list(map(without_unit, given)) for given in (names, inputs))
    alike = any(len(set(each)) < len(each) for each in (places, actors))
    if alike or not set(actors) <= set(places):
        return None
    return [[int(place == actor) for actor in actors] for place in places]


def matrix_setting(matrix: Sequence[Sequence[float]]) -> str:
    """Return the matrix of inputs as a word of a command."""
    return f"system.input_matrix={str(matrix).replace(' ', '')}"


def _matrix(
    given: object, names: tuple[str, ...], inputs: tuple[str, ...], *, zeros: bool
) -> torch.Tensor:
    n, m = len(names), len(inputs)
    places, actors = (list(map(without_unit, each)) for each in (names, inputs))
    alike = len(set(actors)) < m  # such as the voltage and the current of a motor
    if given is None and m in (0, n) and not alike:
        in_order = all(x == y or x not in places for x, y in zip(actors, places, strict=False))
        given = torch.eye(n, m).tolist() if in_order else matrix_by_names(names, inputs)
    try:
        matrix = torch.tensor([[float(x) for x in row] for row in given], dtype=torch.float64)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        matrix = torch.empty(0, 0)
    told = f"system.input_matrix={'null' if given is None else given}"
    example = [[int(i == j) for j in range(m)] for i in range(n)]
    such = f"such as {matrix_setting(example)}"
    if tuple(matrix.shape) == (n, m) and matrix.isfinite().all():
        if m and not (zeros or matrix.any()):
            raise ConfigError(
                f"{told}: zeros drive nothing; give the entries, {such}, or leave the inputs out, "
                "by data.columns"
            )
        return matrix
    hint = "; of the voltage, the current and the torque of a motor, keep one, by data.columns"
    raise ConfigError(
        f"{told}: say how the inputs ({', '.join(inputs)}) drive the coordinates "
        f"({', '.join(names)}){hint * (alike or m > n)}; a row for each coordinate, {such}"
    )
