"""Elements of a MATLAB file, which SciPy reads without checking them.

A file of version 5 consists of elements, each a tag with its type and its size and then its data; a
matrix consists of elements itself (MathWorks, *MAT-File Format*).
"""

from __future__ import annotations

import struct

HEADER, TAG = 128, 8
"""Lengths of the head of a file and of a tag [bytes]."""
TYPES = {*range(1, 8), 9, *range(12, 19)}
MATRIX, COMPRESSED = 14, 15
ARRAYS, SPARSE = range(4, 16), 5
"""Classes of matrices of numbers or characters."""
COMPLEX = 1 << 11


def check_elements(content: bytes) -> None:
    """Refuse a damaged file, which could end Python by a segmentation fault.

    Compressed elements have a checksum and are not looked into.

    Raises:
        ValueError: If an element has an unknown type or extends beyond the one that contains it.
    """
    order = ">" if content[126:128] == b"MI" else "<"
    _walk(memoryview(content), order, HEADER, len(content))


def _walk(content: memoryview, order: str, start: int, end: int) -> list[int]:
    """Check the elements between two places, and return where their data begin."""
    found = []
    while start < end:
        if start + TAG > end:
            raise ValueError(f"it is damaged: an element at byte {start} is cut off")
        kind, size = struct.unpack_from(f"{order}2I", content, start)
        data, after = start + TAG, start + TAG + size
        if kind >> 16:  # a small element, whose data are in its tag
            kind, size, data, after = kind & 0xFFFF, kind >> 16, start + 4, start + TAG
        elif kind != COMPRESSED:
            after += -size % TAG
        if kind not in TYPES or data + size > after or after > end:
            raise ValueError(f"it is damaged: there is no element at byte {start}")
        if kind == MATRIX:
            _check_matrix(content, order, data, data + size)
        found.append(data)
        start = after
    return found


def _check_matrix(content: memoryview, order: str, start: int, end: int) -> None:
    """Check a matrix: its flags, its shape, its name and what it holds."""
    parts = _walk(content, order, start, end)
    if not parts:
        return  # an empty cell
    (flags,) = struct.unpack_from(f"{order}I", content, parts[0])
    kind = flags & 0xFF
    wanted = 4 + 2 * (kind == SPARSE) + bool(flags & COMPLEX)
    if kind in ARRAYS and len(parts) != wanted:
        raise ValueError(f"it is damaged: the matrix at byte {start} has {len(parts)} parts")
