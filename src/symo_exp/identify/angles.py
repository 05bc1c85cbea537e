"""Which coordinates are angles, in which units, and whether they jump by a turn."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from symo_exp.data.diagnose import SUSPECT
from symo_exp.data.explained import explained_in_degrees, explained_power
from symo_exp.data.naming import ANGLE, SLIDE, length_unit, meanings, units_of_angles
from symo_exp.data.paths import few
from symo_exp.data.table import Recording
from symo_exp.data.turns import are_counts
from symo_exp.errors import ConfigError
from symo_exp.identify.pace import STEPS
from symo_exp.identify.sampled import EXAMINED, at_nodes, first_seconds, with_inputs
from symo_exp.mechanics.types import Coordinates
from symo_exp.shell import override_value

SPAN = 2 * np.pi
"""Range of a coordinate beyond which it is an angle."""
WELL = 0.75
"""Share of the explained power above which no other reading is asked for: springs are explained
better in degrees, whose sines are straight, although they act on angles in radians."""
MUCH = 0.3
"""Share of the power that another reading explains in addition where it is likely, although
something else moves the machine, too, or regressions represent it badly."""
ODD = 10.0
"""Range of a coordinate in a recording over the usual one from which the recording is named."""
LONG = 30.0
"""Range of a length without a unit [m] beyond which it is probably in another one."""
WHOLE = 0.3
"""Distance of a jump from a whole turn, over a turn, up to which an angle is wrapped."""


def is_angle(name: str, written: str, columns: Sequence[np.ndarray]) -> bool | None:
    """Return whether a coordinate is an angle, ``None`` if its names and range do not tell.

    Args:
        name: Its name.
        written: Its name in the file if that states a unit, else its name.
        columns: Its values in each recording.
    """
    words = _kinds(name)
    if units_of_angles([written]) or any(re.fullmatch(ANGLE, word) for word in words):
        return True
    words += _kinds(written)
    if length_unit(written) or any(re.fullmatch(SLIDE, word) for word in words):
        return False
    low, high = min(x.min() for x in columns), max(x.max() for x in columns)
    if high - low > SPAN or _wraps(columns, 2 * np.pi):
        return True
    return None


def _kinds(name: str) -> list[str]:
    """Return the words of a name without numbers."""
    return [word.lower().rstrip("0123456789") for word in meanings(name)]


def ask_which_turn(
    kinds: Mapping[str, bool | None], columns: Mapping[str, Sequence[np.ndarray]]
) -> None:
    """Refuse coordinates of which nothing tells whether they are angles, all in one question.

    Args:
        kinds: By coordinate: whether it is an angle, ``None``: unknown.
        columns: By coordinate: its values in each recording.
    """
    unknown = [name for name, angle in kinds.items() if angle is None]
    if not unknown:
        return
    every = {name: np.concatenate(columns[name]) for name in unknown}
    told = few([f"q_{name} ({x.min():.3g} to {x.max():.3g})" for name, x in every.items()])
    one, several = f"is {told} an angle [rad] or a position [m]", f"which of {told} are angles"
    possible = override_value([name for name, angle in kinds.items() if angle is not False])
    raise ConfigError(
        f"system.angular has no value yet: {one if len(unknown) == 1 else several}? Give "
        "all angles by system.angular=all, none or a list, as "
        f"{shlex.quote(f'system.angular={possible}')}"
    )


def told_units(
    chosen: Sequence[str], written: Mapping[str, str], columns: Mapping[str, Sequence[np.ndarray]]
) -> list[str]:
    """Return a line on which coordinates are angles, and lines on lengths in other units than m.

    Args:
        chosen: The angles.
        written: All coordinates, and the name of each that states its unit.
        columns: By coordinate: its values in each recording.
    """
    kinds = dict.fromkeys(chosen, "angles [rad]")
    positions = [name for name in written if name not in chosen]
    units = {name: length_unit(written[name]) or "m" for name in positions}
    kinds |= {name: f"positions [{unit}]" for name, unit in units.items()}
    groups = {kind: [x for x in kinds if kinds[x] == kind] for kind in kinds.values()}
    parts = "; ".join(f"{kind}: {', '.join(group)}" for kind, group in groups.items())
    lines = [f"{parts} (by names and ranges; system.angular says otherwise)"]
    if odd := [name for name, unit in units.items() if unit != "m"]:
        unit = units[odd[0]]
        lines.append(
            f"lengths of {few(odd)} are used as they are: where results say m, they are in {unit}, "
            f"and kg is N s^2/{unit}; convert them in the file for results in SI units"
        )
    if counted := [name for name in positions if name not in odd and are_counts(columns[name])]:
        lines.append(
            f"lengths of {few(counted)} are whole numbers: where results say m, they are in that "
            "unit, such as counts of an encoder; convert them in the file for results in SI units"
        )
    ranges = {x: float(np.ptp(np.concatenate(columns[x]))) for x in positions}
    ranges = {x: size for x, size in ranges.items() if size > LONG and x not in (*odd, *counted)}
    if ranges:
        told = few([f"{x} moves by {size:.3g} m" for x, size in ranges.items()])
        lines.append(
            f"{told}, as its name states no unit; if it is in mm or another one, convert it in the "
            "file for results in SI units"
        )
    return lines


def turn_settings(
    recordings: Sequence[Recording], space: Coordinates, data: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the settings of data with which angles that jump by a turn are read.

    Raises:
        ConfigError: If they jump by a turn in degrees, and the given setting says radians.
    """
    columns = [r.samples.q[:, i] for r in recordings for i in np.flatnonzero(space.angular)]
    degrees = data.get("degrees")
    if data.get("wrapped") is not None or not columns:
        return ()
    if not degrees and _wraps(columns, 2 * np.pi):
        return ("wrapped",)
    if not _wraps(columns, 360.0):
        return ()
    if degrees is False:
        raise ConfigError(
            "data.degrees=false, but angles jump by 360, a turn in degrees; "
            "give data.degrees=true, or data.wrapped=false if they move so"
        )
    return ("wrapped",) if degrees else ("degrees", "wrapped")


def _wraps(columns: Sequence[np.ndarray], turn: float) -> bool:
    """Return whether steps that change by more than half a turn do by nearly a whole one.

    From a jump to one back, as of an angle that rests where it jumps, they change by two.
    """
    steps = np.concatenate([np.abs(np.diff(x, 2)) for x in columns])
    jumps = steps[steps > 0.5 * turn]
    whole = turn * np.where(jumps > 1.5 * turn, 2.0, 1.0)
    return bool(jumps.size and (np.abs(jumps - whole) < WHOLE * turn).all())


def ask_for_degrees(recordings: Sequence[Recording], space: Coordinates) -> None:
    """Refuse angles whose motion is explained much better if their numbers are degrees."""
    if wide := _beyond_a_turn(recordings, space, angular=True):
        plain, degrees = _explained(recordings, space)
        readings = {"degrees": degrees, "radians": plain}
        _ask("data.degrees", "true or false", wide, readings)


def ask_for_angles(recordings: Sequence[Recording], space: Coordinates) -> None:
    """Refuse lengths, by their names, whose motion is explained much better if they are angles."""
    if wide := _beyond_a_turn(recordings, space, angular=False):
        every = zip(space.names, space.angular, strict=True)
        other = space._replace(angular=tuple(angle or name in wide for name, angle in every))
        shares = (_explained(recordings, x)[0] for x in (other, space))
        readings = dict(zip(("angles [rad]", "lengths"), shares, strict=True))
        _ask("system.angular", "all, none or a list of names", wide, readings)


def _explained(
    recordings: Sequence[Recording], coordinates: Coordinates
) -> tuple[float | None, float | None]:
    """Return the share of the accelerations' power that is explained, and that if in degrees."""
    step = max(STEPS[0], *(one.samples.step for one in recordings))
    pairs = with_inputs(at_nodes(first_seconds(recordings, EXAMINED), step), step, 0.0)
    given = pairs, coordinates, step
    return explained_power(*given, driven=True), explained_in_degrees(*given)


def _beyond_a_turn(
    recordings: Sequence[Recording], space: Coordinates, *, angular: bool
) -> dict[str, str]:
    """Return the angles, or the lengths, with ranges larger than ``SPAN``, and words for these.

    Recordings in which a range is far larger than usual are named: they may be in another unit.
    """
    ranges = np.array([np.ptp(one.samples.q, axis=0) for one in recordings])
    labels = [one.label for one in recordings]
    found = {}
    for name, angle, sizes in zip(space.names, space.angular, ranges.T, strict=True):
        if angle != angular or sizes.max() <= SPAN:
            continue
        usual = float(np.median(sizes))
        odd = [label for label, size in zip(labels, sizes, strict=True) if size > ODD * usual]
        told = f" in {few(odd)}, by {usual:.3g} in most recordings" if odd else ""
        found[name] = f"q_{name} moves by {sizes.max():.3g}{told}"
    return found


def _ask(
    setting: str, choices: str, ranges: Mapping[str, str], readings: Mapping[str, float | None]
) -> None:
    """Refuse a setting that is left open if another reading explains a motion much better.

    ``readings`` are the explained shares of the accelerations' power by that and the present one.
    """
    (reading, other), (present, plain) = readings.items()
    if plain is None or other is None or plain > WELL:
        return
    if not (1 - other < SUSPECT * (1 - plain) or other - plain > MUCH):
        return
    raise ConfigError(
        f"{setting} has no value yet: {', '.join(ranges.values())}; {100 * other:.3g} % of the "
        f"accelerations' power is explained if these are {reading}, {100 * plain:.3g} % if they "
        f"are {present}; give {setting}={choices}, the same for all recordings"
    )
