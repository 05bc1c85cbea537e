"""Locks of files on file systems that may have none, such as network disks."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager

WITHOUT = errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP
"""Errors of the system where it has no locks."""


@contextmanager
def where_possible() -> Iterator[None]:
    """Go on without the lock that is acquired meanwhile if the file system has none."""
    try:
        yield
    except NotImplementedError:  # of filelock
        return
    except OSError as error:
        if error.errno not in WITHOUT:
            raise
