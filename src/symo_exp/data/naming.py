"""Names of columns: the kind of a column, its unit and its coordinate, as the words say."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from symo_exp.data.clocks import IN_TIME, TIME
from symo_exp.data.languages import english, parts_of, plain
from symo_exp.systems.recorded import UNIT, without_unit

ANGLE = (
    "theta|th|phi|psi|alpha|beta|angle|ang|rot|joint|shoulder|elbow|hip|knee|ankle|wrist|pole|arm|link"
    "|pendulum|upper|lower|roll|pitch|yaw|motor|wheel"
)
SLIDE = "x|y|z|pos|position|cart|slide|slider|lin|linear|prismatic|height|stroke|carriage|table|d"
"""Words in the names of angles and of positions."""
PLACE = re.compile(r"(?:q|qpos|pos|positions?|angles?)(\d*)", re.I)
"""A word that says that a column is a coordinate, and the number of the coordinate."""
PLACES = re.compile(rf"(?:{ANGLE}|{SLIDE})\d*", re.I)
"""A word of a coordinate's name."""
SPEED = re.compile(
    r"(?:d?dq|qd?d|dot|qvel|vel|velocity|velocities|speeds?|omega|rates?|rpm)(\d*)", re.I
)
"""A word that says that a column is a velocity, and the number of the coordinate."""
EFFORT = r"tau|torques?|moments?|forces?|efforts?|currents?|volt|volts|voltages?|pwm|duty"
"""Words that only names of inputs have."""
INPUT = re.compile(
    rf"(?:u|{EFFORT}|motors?|inputs?|cmd|commands?|controls?|ctrl|act|actions?|throttle|thrust"
    r"|rudder|heat)(\d*)",
    re.I,
)
"""A word of an input's name, and the number of the coordinate."""
EFFORTS = re.compile(rf"(?:{EFFORT})\d*", re.I)
"""A word of a name that is none of a coordinate."""
ELECTRIC = re.compile(r"(?:currents?|volts?|voltages?|pwm|duty)\d*", re.I)
"""A word of the name of an input that is neither a torque nor a force."""
INPUT_UNIT = re.compile(
    r"(?:_| in | *[\[(])((?:[kcm]?n[ .*·_]?[cm]?m|[kcm]n|m[av]|%)|(?<!_)(?:n|k?[av]))[\])]?$", re.I
)
"""A unit at the end of an input's name; a single letter after an underscore may be a name."""
FORCE = re.compile(r"f\d*", re.I)
"""The first word of an input's name; as a last word it may say that a signal is filtered."""
WANTED = re.compile(
    r"(?:ref|reference|des|desired|set|setpoint|sp|target|goal|cmd|command|commanded|demand|error"
    r"|err)\d*",
    re.I,
)
"""A word of the name of what a controller wants, which the machine need not do."""
OTHER = re.compile(
    r"(?:acc|accel|acceleration|ddot|ddq|qdd|jerk|bat|battery|bus|vbus|supply|temp|temperature"
    r"|seq|sequence|id|status|statusword|word)\d*",
    re.I,
)
"""A word of the name of what is no coordinate, velocity or input."""
_OF_TURNS = dict.fromkeys(("turns", "rev", "revs", "revolutions"), "rad = 2 pi times turns")
_OF_COUNTS = dict.fromkeys(
    ("count", "counts", "tick", "ticks"),
    "rad = 2 pi times counts over the counts of a turn, or m = counts times the length of one",
)
CONVERSIONS = {
    "mrad": "rad = mrad / 1000", "rpm": "rad/s = 2 pi times rpm / 60", **_OF_TURNS, **_OF_COUNTS,
}  # fmt: skip
"""Units of coordinates and velocities that are not read, and how they become some that are."""
TIME_OF = re.compile(r".*(?:[./](?:t|times?)|[\W_]stamps?|timestamps?)", re.I)
"""Names of times in those of messages of ROS, such as ``header.stamp``."""
STAMP_PART = re.compile(r"(.*stamp[\W_])?(n|nano)?sec(?:ond)?s?", re.I)
"""The beginning of a name of a part of such times, and whether it is that of nanoseconds."""


def names(kind: str, columns: Sequence[str]) -> tuple[str, ...]:
    """Return the names that follow ``q_``, ``v_`` or ``u_``."""
    return tuple(name[2:] for name in columns if name.startswith(f"{kind}_"))


def kind_of_column(name: str) -> str:
    """Return ``q``, ``v`` or ``u``, as the unit or a word of a name says, ``-`` for none of them.

    Nothing if the name does not tell.
    """
    unit, words = UNIT.search(name), meanings(without_unit(name))
    wanted = is_wanted(name)
    if any(map(OTHER.fullmatch, words)):
        return "-"
    if unit and (unit[1] != "_" or len(unit[2]) > 1):  # _a may be a name
        if unit[2].lower().startswith(("n", "v", "a")):
            return "u"
        return "-" if wanted else "v" if unit[2].endswith("/s") else "q"
    acts = INPUT_UNIT.search(name)
    if acts and acts[0][0] != "_" and acts[1] != "%":  # _ma may be a name, and % is of anything
        return "u"
    last = [("u", INPUT), ("q", PLACES)]  # a motor drives, but where it is counted, it is a place
    last = last[::-1] if unread_unit(name) else last
    if any(map(FORCE.fullmatch, words[:1])):
        last = [("u", FORCE), *last]
    for kind, word in (("v", SPEED), ("q", PLACE), ("u", EFFORTS), *last):
        if any(map(word.fullmatch, words)):
            return "-" if wanted and kind != "u" else kind
    return ""


def is_no_place(stem: str, stems: Collection[str]) -> bool:
    """Return whether a name is that of a velocity, an acceleration or an input.

    Args:
        stem: The name, without ``q_``.
        stems: Names of all coordinates.
    """
    kind = kind_of_column(stem)
    effort = kind == "u" and any(map(EFFORTS.fullmatch, meanings(stem)))
    return kind in ("v", "-") or effort or slope_of(stem, stems) is not None


def is_no_input(stem: str, others: Sequence[str]) -> bool:
    """Return whether a name says that a column is no input, though others are.

    Args:
        stem: The name, without ``u_``.
        others: Those of the other inputs.
    """
    words = meanings(stem)
    if any(map(OTHER.fullmatch, words)):
        return any(not any(map(OTHER.fullmatch, meanings(other))) for other in others)
    rest = {word for word in words if not WANTED.fullmatch(word)}
    measured = [other for other in others if not is_wanted(other)]
    return is_wanted(stem) and any(rest <= set(meanings(other)) for other in measured)


def is_wanted(name: str) -> bool:
    """Return whether a name says what a controller wants."""
    return any(map(WANTED.fullmatch, meanings(name)))


def _words(name: str) -> list[str]:
    """Return the words of a name, also of one such as ``jointAngle``."""
    found = re.findall(r"[A-Z]+\d*(?![a-z])|[A-Z]?[a-z]+\d*|\d+", plain(name))
    return [part for word in found for part in parts_of(word)]


def meanings(name: str) -> list[str]:
    """Return the words of a name in English."""
    return [english(word) for word in _words(name)]


def short_names(stems: Sequence[str], kind: re.Pattern[str] | None = None) -> list[str]:
    """Return different names for columns, short ones if these differ."""
    short = [short_name(stem, kind) for stem in stems] if kind else []
    every = (short, [_short(stem) for stem in stems])
    numbered = [f"{_short(stem)}_{i}" for i, stem in enumerate(stems)]
    return next((x for x in every if len(set(x)) == len(stems)), numbered)


def short_name(stem: str, kind: re.Pattern[str]) -> str:
    """Return a name without the word that states its kind: ``1`` of ``q1``."""
    words = _words(stem)
    kept = [match[1] if (match := kind.fullmatch(english(word))) else word for word in words]
    return "_".join(filter(None, kept)) or _short(stem)


def _short(stem: str) -> str:
    """Return a name without blanks, brackets and letters that keys of settings cannot have.

    Where nothing is left it says nothing: ``x`` would be a position.
    """
    return re.sub(r"[\W_]+", "_", plain(stem), flags=re.ASCII).strip("_") or "column"


def unit_of(name: str) -> str:
    """Return the unit that a name ends with, degrees as ``deg``; nothing if it ends with none."""
    unit = UNIT.search(name)
    return re.sub(r"°|deg\w+|gra[du]\w*", "deg", plain(unit[2]).lower()) if unit else ""


def unread_unit(name: str) -> str:
    """Return the key in ``CONVERSIONS`` of the unit that a name ends with; else nothing."""
    words = _words(name)
    while words and words[-1] in ("s", "sec", "min", "per"):
        words.pop()
    return word if words and (word := words[-1].lower()) in CONVERSIONS else ""


def length_unit(name: str) -> str:
    """Return the unit of length that a name ends with; after an underscore, m may be a name."""
    known = unit_of(name) in ("mm", "cm") or re.search(r"[\s\[(]m[\])]?$", name)
    return (unit_of(name) or "m") if known else ""


def is_no_force(name: str) -> bool:
    """Return whether the name of an input says another unit than N m and N, or no force."""
    if unit := INPUT_UNIT.search(name):
        return not re.fullmatch(r"n(?:[ .*·_]?m)?", unit[1], re.I)
    return any(map(ELECTRIC.fullmatch, meanings(name)))


def units_of_angles(columns: Sequence[str]) -> set[str]:
    """Return the units of angles at the ends of names, ``rad`` and ``deg``."""
    return {unit_of(name) for name in columns} & {"rad", "deg"}


def slope_of(stem: str, stems: Collection[str]) -> str | None:
    """Return the name that a name is the derivative of, such as ``x`` of ``dx`` or ``xdot``."""
    for pattern in (r"d_?(.+)", r"(.+?)_?(?:dot|d|p)"):
        if (match := re.fullmatch(pattern, stem)) and match[1] in stems:
            return match[1]
    return None


def says_time(name: str) -> bool:
    """Return whether a name is one of times, or ends with a unit of time other than ``_s``."""
    unit = IN_TIME.fullmatch(name)
    return bool(TIME.fullmatch(name) or TIME_OF.fullmatch(name) or (unit and unit[2]))


def split_times(columns: Sequence[str]) -> list[tuple[str, str]]:
    """Return the columns of seconds and of nanoseconds whose sums are the times of a stamp."""
    parts = {match[0]: match for name in columns if (match := STAMP_PART.fullmatch(name))}
    whole = {match[1]: name for name, match in parts.items() if not match[2]}
    return [(whole[x[1]], name) for name, x in parts.items() if x[2] and x[1] in whole]
