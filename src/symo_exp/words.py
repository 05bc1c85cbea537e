"""Words of messages and of tables."""

from __future__ import annotations


def counted(count: float, noun: str) -> str:
    """Return a number of things in words: ``1 run``, ``3 runs``, ``2 trajectories``.

    Args:
        count: The number.
        noun: The name of one of them.
    """
    several = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{count:.0f} {noun if count == 1 else several}"
