"""Standard output and errors whose reader may go away before the runs end."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any, TextIO

GONE = errno.EPIPE, errno.EIO
"""Errors of a pipe, as of ``| head -1``, and of a terminal that was closed."""


class _Outliving(io.FileIO):
    """Writes to where a file descriptor leads, and to nowhere once nobody reads there."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in GONE:
                raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        return super().write(data)


def outliving(stream: TextIO) -> TextIO:
    """Return a stream to the same place that raises nothing when its reader has gone."""
    stream.flush()
    raw = _Outliving(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=getattr(stream, "line_buffering", False),
        write_through=getattr(stream, "write_through", False),
    )


def outlive() -> None:
    """Let this process end its work, although nobody may read its output any more."""
    for name in ("stdout", "stderr"):
        if (stream := getattr(sys, name)) is not None:  # else it was closed from the start
            setattr(sys, name, outliving(stream))
