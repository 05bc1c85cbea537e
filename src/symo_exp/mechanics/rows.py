"""Objects made of tensors that have one row for each sample of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from torch import Tensor
from typing_extensions import Self


@dataclass(eq=False, repr=False)
class Rowwise:
    """Base class of objects that can be taken apart and put together row by row.

    They consist of the attributes named in ``parts``, those of a dataclass of its fields. Tensors
    among them, nested tuples of tensors and other ``Rowwise`` objects have a row for each sample;
    everything else is shared. Other attributes, such as cached properties, are not copied.
    """

    parts: ClassVar[tuple[str, ...]] = ()

    def rows(self, index: Tensor) -> Self:
        """Return the given rows."""
        return self._of(take_rows(getattr(self, name), index) for name in self._names())

    def replace(self, index: Tensor, other: Self) -> Self:
        """Return this object with the given rows taken from ``other``."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in self._names()]
        return self._of(put_rows(mine, index, new) for mine, new in pairs)

    def _of(self, values: Iterable[Any]) -> Self:
        found = object.__new__(type(self))
        vars(found).update(zip(self._names(), values, strict=True))
        return found

    def _names(self) -> tuple[str, ...]:
        return self.parts or tuple(field.name for field in fields(self))


def take_rows(tree: Any, index: Tensor) -> Any:
    """Return the given rows of a tensor, a ``Rowwise`` object or a tuple of these."""
    if isinstance(tree, Tensor):
        return tree[index]
    if isinstance(tree, Rowwise):
        return tree.rows(index)
    return _each(lambda part: take_rows(part, index), tree)


def put_rows(tree: Any, index: Tensor, other: Any) -> Any:
    """Return ``tree`` with the given rows taken from ``other``; ``None`` if either is."""
    if tree is None or other is None:
        return None
    if isinstance(tree, Tensor):
        return tree.index_copy(0, index, other)
    if isinstance(tree, Rowwise):
        return tree.replace(index, other)
    return _each(lambda part, new: put_rows(part, index, new), tree, other)


def _each(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    if not isinstance(tree, tuple):
        return tree
    parts = [function(*branches) for branches in zip(tree, *others, strict=True)]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
