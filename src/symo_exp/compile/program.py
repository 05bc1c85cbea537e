"""Functions over a model's parameters as compiled graphs.

A training step consists of a few hundred small operations, and most of its time is spent between
them. The loss is traced together with its gradient, and the compiler gets both. Results agree with
the uncompiled step to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from symo_exp.compile.inductor import OpenRowsError, flatten, lower, stand_ins, trace, unflatten
from symo_exp.compile.kernels import CHEAPER


class Packed(NamedTuple):
    """The tensors of an object that one compiled piece passes to another.

    The object is rebuilt only while a piece is traced, since that takes long.
    """

    tensors: list[Tensor]
    structure: Any
    traced: list[Tensor] | None = None
    """Placeholders of the tensors in the trace of the piece that made them."""

    def open(self) -> Any:
        """Return the object itself."""
        return unflatten(self.tensors, self.structure)


class Program:
    """A function of tensors over a model's parameters, compiled once for all numbers of rows.

    Arguments are tensors, named tuples of them, or ``Packed`` objects, which the function receives
    opened. It returns a tuple; a call returns a tuple with everything but tensors ``Packed``.

    Args:
        model: Owner of the parameters.
        function: The function. Single tensors that it returns are no arguments of other programs
            unless they are contiguous.
        gradients: Whether the first result is a loss whose gradients a call leaves in the
            parameters.
        open_rows: Whether kernels are for any number of rows above one; otherwise, and for a single
            row, each shape has its own.

    Raises:
        OpenRowsError: By a call, if the function cannot be compiled with an open number of rows.
    """

    def __init__(
        self,
        model: nn.Module,
        function: Callable[..., tuple[Any, ...]],
        *,
        gradients: bool = False,
        open_rows: bool = True,
    ) -> None:
        self._model, self._function = model, function
        self._named, self._gradients = dict(_Call(model, function).named_parameters()), gradients
        self._parameters = list(self._named.values())
        self._open = open_rows
        self._compiled: dict[tuple[Any, ...], Callable[..., tuple[Any, ...]]] = {}

    def __call__(self, *arguments: Any) -> tuple[Any, ...]:
        """Call the function; it is compiled at the first call with such shapes."""
        # The first argument is the batch; all other shapes follow from its shapes.
        batch = _tensors(arguments[0])
        rows = len(batch[0])
        is_open = self._open and rows > 1
        key = (None if is_open else rows, *[(x.shape[1:], x.dtype, x.device) for x in batch])
        if key not in self._compiled:
            given = [_packed(x) for x in arguments]
            self._compiled[key] = self._compile(given, rows if is_open else None)
        tensors = [*self._parameters]
        for x in arguments:
            tensors.extend(_tensors(x))
        return self._compiled[key](tensors)

    def _compile(self, arguments: list[Packed], rows: int | None) -> Callable[..., tuple[Any, ...]]:
        results: list[Packed] = []

        def run(*tensors: Tensor) -> list[Tensor]:
            queue = iter(tensors)
            named = {name: next(queue) for name in self._named}
            opened = [
                x._replace(tensors=[next(queue) for _ in x.tensors]).open() for x in arguments
            ]
            found, gradients = self._run(named, opened)
            results[:] = map(_packed, found)
            return [*(tensor for x in results for tensor in x.tensors), *gradients]

        # A function may keep constants, such as coefficients of series: they come to be outside of
        # the trace, whose tensors have no data.
        run(*self._parameters, *(tensor for x in arguments for tensor in x.tensors))
        given = [tensor for x in arguments for tensor in x.traced or x.tensors]
        try:
            kernel = self._kernel(run, given, rows)
        except Exception as error:
            # Whatever the reason, an older compiler or a function that asks for the number of rows:
            # with all sizes given, it works or raises again.
            if rows is not None:
                raise OpenRowsError from error
            raise
        alone = [isinstance(x.open(), Tensor) for x in results]
        ends = [0, *accumulate(len(x.tensors) for x in results)]
        places = list(zip(alone, results, ends, ends[1:], strict=False))

        def call(tensors: list[Tensor]) -> tuple[Any, ...]:
            with torch.no_grad():
                found = kernel(*tensors)
            if self._gradients:
                for parameter, gradient in zip(self._parameters, found[ends[-1] :], strict=True):
                    parameter.grad = gradient
            return tuple(
                [
                    found[i] if one else Packed(found[i:j], x.structure, x.tensors)
                    for one, x, i, j in places
                ]
            )

        return call

    def _kernel(
        self, run: Callable[..., list[Tensor]], given: list[Tensor], rows: int | None
    ) -> Callable[..., list[Tensor]]:
        example = stand_ins(self._parameters, given, rows)
        with torch.no_grad():
            graph = trace(run, example, CHEAPER)
            constants = [getattr(graph, x.target) for x in graph.graph.find_nodes(op="get_attr")]
            assert not any(x is y for x in constants for y in self._parameters)
            return lower(graph, example)

    def _run(self, named: dict[str, Tensor], arguments: list[Any]) -> tuple[Any, list[Tensor]]:
        """Return what the function finds, and gradients, at parameters ``named``."""

        def evaluate() -> tuple[Any, list[Tensor]]:  # gradients, too, may read parameters
            found = self._function(*arguments)
            if not self._gradients:
                return found, []
            loss, *rest = found
            gradients = torch.autograd.grad(loss, list(named.values()), materialize_grads=True)
            # Laid out like the parameters: a fused optimiser reads memory, not strides.
            return (loss.detach(), *rest), [gradient.contiguous() for gradient in gradients]

        with torch.set_grad_enabled(self._gradients):
            return torch.func.functional_call(_Call(self._model, evaluate), named, ())


def _tensors(x: Any) -> Any:
    return (x,) if isinstance(x, Tensor) else x.tensors if isinstance(x, Packed) else x


def _packed(x: Any) -> Packed:
    return x if isinstance(x, Packed) else Packed(*flatten(x))


class _Call(nn.Module):
    """Module whose forward pass is a function, so that its parameters can be replaced."""

    def __init__(self, model: nn.Module, function: Callable[..., Any]) -> None:
        super().__init__()
        self.model, self.forward = model, function
