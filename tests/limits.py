"""Limits that the operating system sets to this process for a while."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _limited(kind: int, most: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(kind)
    resource.setrlimit(kind, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(kind, (soft, hard))


def no_file_larger_than(size: int):
    """Let writes fail, after a part of them, as on a full disk."""
    return _limited(resource.RLIMIT_FSIZE, size)


def no_more_files():
    """Let no further file be opened."""
    return _limited(resource.RLIMIT_NOFILE, 0)
