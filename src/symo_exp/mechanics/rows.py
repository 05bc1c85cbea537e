"""Objects made of tensors that have one row for each sample of a batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from torch import Tensor
from typing_extensions import Self


@dataclass(eq=False, repr=False)
class Rowwise:
    """Base class of objects that can be taken apart and put together row by row.

    A dataclass consists of its fields. The constructor of another class must accept the attributes
    named in ``parts``, in order. Tensors among them, nested tuples of tensors and other ``Rowwise``
    objects have a row for each sample; everything else is shared.
    """

    parts: ClassVar[tuple[str, ...]] = ()

    def rows(self, index: Tensor) -> Self:
        """Return the given rows."""
        return type(self)(*[take_rows(getattr(self, name), index) for name in self._names()])

    def replace(self, index: Tensor, other: Self) -> Self:
        """Return this object with the given rows taken from ``other``."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in self._names()]
        return type(self)(*[put_rows(mine, index, new) for mine, new in pairs])

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
