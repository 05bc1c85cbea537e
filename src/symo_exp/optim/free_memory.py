"""The memory that this process can still take."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

MEMORY = Path("/proc/meminfo")
"""Linux's file about the memory of the machine."""
GROUPS, MOUNTED = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
"""Linux's file about the control groups of this process, and where these are."""
FILES = {
    "": ("memory.max", "memory.current", "active_file", "inactive_file"),
    "memory": (
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        "total_active_file",
        "total_inactive_file",
    ),
}
"""By what a control group is about, all in version 2 and memory in version 1: the files of the
limit and of the use, and the names of the files in memory among its statistics."""


def available_bytes() -> int | None:
    """Return the memory that this process can still take, in bytes; ``None`` if unknown.

    That includes files that the system keeps in memory, most of it on a machine that has run for
    long. Where the system does not tell, it is all memory. A container or a job of a cluster may
    have less than the machine.
    """
    return min([*_of_machine(), *_of_groups()], default=None)


def _of_machine() -> Iterator[int]:
    try:
        known = dict(line.split(":") for line in MEMORY.read_text(encoding="ascii").splitlines())
        yield 1024 * int(known["MemAvailable"].split()[0])
        return
    except (OSError, ValueError, LookupError):
        pass
    try:
        yield os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return


def _of_groups() -> Iterator[int]:
    """Yield what each limit of a control group leaves."""
    try:
        lines = GROUPS.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return
    for line in lines:
        _, kind, path = line.split(":", 2)
        if kind in FILES:
            home = MOUNTED / kind
            group = home / path.lstrip("/")  # in a container, maybe a path outside of it
            for each in (group, *group.parents):  # the limit may be that of a group around it
                if each.is_relative_to(home):
                    yield from _left(each, *FILES[kind])


def _left(group: Path, limit: str, use: str, *kept: str) -> Iterator[int]:
    try:
        most, used = int((group / limit).read_text()), int((group / use).read_text())
        lines = (group / "memory.stat").read_text().splitlines()
        statistics = dict(line.split() for line in lines)
        yield max(most - used + sum(int(statistics[name]) for name in kept), 0)
    except (OSError, ValueError, LookupError):  # "max": no limit
        return
