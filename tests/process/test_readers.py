"""A command goes on when nobody reads its output any more."""

import os
import subprocess
import sys

import pytest

from symo_exp.process.readers import outliving


def pipe():
    return os.pipe()


def terminal():
    return os.openpty()


@pytest.fixture(params=[pipe, terminal], ids=lambda kind: kind.__name__)
def ends(request):
    """The file descriptors of the two ends; the test closes that of the reader."""
    reader, writer = request.param()
    with open(writer, "w", encoding="utf-8", buffering=1) as stream:
        yield reader, stream


def test_what_is_written_arrives_and_later_nothing_is_raised(ends):
    reader, stream = ends
    tolerant = outliving(stream)
    assert tolerant.isatty() == stream.isatty()
    print("é first", file=tolerant, flush=True)
    assert os.read(reader, 100).decode().strip() == "é first"
    os.close(reader)
    for _ in range(2):
        print("second", file=tolerant, flush=True)
    print("at the end of the process", file=tolerant)
    tolerant.close()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no such device")
def test_a_full_disk_is_told():
    with open("/dev/full", "w", encoding="utf-8") as stream, pytest.raises(OSError, match="space"):
        print("lost", file=outliving(stream), flush=True)


def test_a_command_without_a_reader_ends_as_with_one():
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "symo_exp", "--version"]
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")
