"""Compiled training: loss and gradients of a batch as one graph, its kernels cached on disk.

At these sizes a training step is a few hundred small operations, and most of its time is spent
between them. Tracing the loss together with its gradient and handing both to the compiler
removes that. Results agree with the uncompiled step to rounding.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch._inductor import standalone_compile
from torch.fx.experimental.proxy_tensor import make_fx
from torch.utils import _pytree as pytree

OPTIONS = {"config_patches": {"cpp_wrapper": True, "pattern_matcher": False}}
"""What calls the kernels is compiled, too: with few rows a fifth of a step was Python doing that.
Sums are not put back into products of matrices (``addmm``)."""
logging.getLogger("torch._inductor.ir").setLevel(logging.ERROR)  # which solver is called how


def keep_kernels() -> None:
    """Keep kernels in the cache of the user, where the jobs of a sweep share them."""
    cache = Path.home() / ".cache" / "symo_exp" / "kernels"
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(cache))
    os.environ.setdefault("TORCHINDUCTOR_COMPILE_THREADS", "1")


class Packed:
    """Objects made of tensors on their way from one compiled piece to another.

    Taken apart and put together again only while a piece is traced.
    """

    def __init__(self, content: Any) -> None:
        self.tensors, self._structure = pytree.tree_flatten(content)

    def open(self) -> Any:
        return pytree.tree_unflatten(self.tensors, self._structure)

    def holding(self, tensors: list[Tensor]) -> Packed:
        """The same objects made of other tensors."""
        other = Packed.__new__(Packed)
        other.tensors, other._structure = tensors, self._structure
        return other


class Program:
    """A function of tensors over a model's parameters, compiled once for each set of shapes.

    Arguments and results are tensors, named tuples of them, or ``Packed``.
    """

    def __init__(self, model: nn.Module, function: Callable[..., Any], *, gradients: bool) -> None:
        """With ``gradients`` the function returns a loss, and a call the loss and its gradients in
        the parameters. A call returns a tuple, of whatever the function does."""
        self._call = _Call(model, function)
        names, parameters = zip(*self._call.named_parameters(), strict=True)
        self._names: tuple[str, ...] = names
        self.parameters: list[Tensor] = list(parameters)
        self._gradients = gradients
        self._compiled: dict[tuple[Any, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        flat = _flatten(arguments)
        # The first argument is the batch; shapes of what travels follow from its shapes.
        key = tuple((x.shape, x.dtype, x.device) for x in _flatten(arguments[:1]))
        if key not in self._compiled:
            self._compiled[key] = self._compile(arguments)
        return self._compiled[key]([*self.parameters, *flat])

    def _compile(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """The graph goes to the compiler as it is: its only inputs are tensors of fixed shapes,
        so nothing has to be checked at every call. The next process that comes with the same
        graph finds its kernels on disk, and spends seconds here instead of a minute."""
        keep_kernels()
        results: list[tuple[Any, ...]] = []
        example = [*self.parameters, *_flatten(arguments)]
        count = len(self.parameters)

        def run(*tensors: Tensor) -> list[Tensor]:
            parameters, rest = list(tensors[:count]), list(tensors[count:])
            results.append(self._run(parameters, _rebuild(arguments, rest)))
            return _flatten(results[0])

        with torch.no_grad():
            graph = make_fx(run, decomposition_table=CHEAPER)(*example)
            kernel = standalone_compile(
                graph, [*example], dynamic_shapes="from_example_inputs", options=OPTIONS
            )

        def call(tensors: list[Tensor]) -> Any:
            with torch.no_grad():
                return _rebuild(results[0], kernel(*tensors))

        return call

    def _run(self, parameters: list[Tensor], arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        named = dict(zip(self._names, parameters, strict=True))
        with torch.set_grad_enabled(self._gradients):
            result = torch.func.functional_call(self._call, named, arguments)
            if not self._gradients:
                return (result,) if isinstance(result, Tensor) else result
            gradients = torch.autograd.grad(result, parameters, materialize_grads=True)
        # Laid out like the parameters: a fused optimiser reads memory, not strides.
        return result.detach(), Packed([gradient.contiguous() for gradient in gradients])


def _flatten(things: Iterable[Any]) -> list[Tensor]:
    flat: list[Tensor] = []
    for x in things:
        if isinstance(x, Tensor):
            flat.append(x)
        else:
            flat.extend(x.tensors if isinstance(x, Packed) else x)
    return flat


def _rebuild(like: Iterable[Any], tensors: Sequence[Tensor]) -> tuple[Any, ...]:
    """The same things made of other tensors."""
    things: list[Any] = []
    at = 0
    for x in like:
        if isinstance(x, Tensor):
            things.append(tensors[at])
            at += 1
            continue
        count = len(x.tensors) if isinstance(x, Packed) else len(x)
        mine, at = list(tensors[at : at + count]), at + count
        things.append(x.holding(mine) if isinstance(x, Packed) else type(x)(*mine))
    return tuple(things)


def carry(kind: type, *constants: str) -> None:
    """Let objects of a class be ``Packed``: their tensors are, but ``constants`` are kept."""

    def flatten(x: Any) -> tuple[list[Any], Any]:
        names = [name for name in vars(x) if name not in constants]
        return [vars(x)[name] for name in names], (names, [vars(x)[name] for name in constants])

    def unflatten(children: Any, context: Any) -> Any:
        names, kept = context
        x: Any = object.__new__(kind)
        vars(x).update(zip(names, children, strict=True))
        vars(x).update(zip(constants, kept, strict=True))
        return x

    pytree.register_pytree_node(kind, flatten, unflatten)


def mm(a: Tensor, b: Tensor) -> Tensor:
    """``A B``; a tall and narrow product as ``(Bᵀ Aᵀ)ᵀ``, which the library does in a fifth of the
    time, if only ``Bᵀ`` lies row by row in memory: else it takes seven times as long as ``A B``. A
    network has such products wherever a layer has few inputs or outputs."""
    if not 8 * b.shape[1] <= min(a.shape):
        return NotImplemented  # to the tracer: leave it as it is
    return (b.T.contiguous() @ a.T).T


def addmm(x: Tensor, a: Tensor, b: Tensor, *, beta: float = 1.0, alpha: float = 1.0) -> Tensor:
    """``X + A B`` as two: the sum is compiled into what follows, where the library copies ``X`` to
    its place first."""
    if beta != 1 or alpha != 1:
        return NotImplemented
    return x + a @ b


def column_sums(
    x: Tensor, dim: list[int], keepdim: bool = False, *, dtype: torch.dtype | None = None
) -> Tensor:
    """``Σᵢ xᵢⱼ`` as ``1ᵀ X``, which goes along the rows; the compiler would go down the columns."""
    if x.ndim != 2 or dim != [0] or dtype is not None or not x.is_floating_point():
        return NotImplemented
    total = x.new_ones(1, len(x)) @ x
    return total if keepdim else total.squeeze(0)


def tanh(x: Tensor) -> Tensor:
    """``tanh x ≈ x P(x²) / Q(x²)`` in single precision, to a few units in the last place.

    The minimax approximation of degree 13 over 6 that Eigen and XLA use. Compiled into its
    neighbours it costs a tenth of the library's function, which takes 3 ns a number: a fifth of
    the step of a network whose products of matrices are as fast as the machine.
    """
    if x.dtype != torch.float32:
        return NotImplemented
    x = x.clamp(-7.9053111, 7.9053111)  # beyond that it is 1
    square = x * x
    return x * _polynomial(square, TANH_ABOVE) / _polynomial(square, TANH_BELOW)


def _polynomial(x: Tensor, coefficients: Sequence[float]) -> Tensor:
    """By Horner's rule, the highest power first."""
    value = x * coefficients[0] + coefficients[1]
    for coefficient in coefficients[2:]:
        value = value * x + coefficient
    return value


TANH_ABOVE = (
    -2.76076847742355e-16, 2.00018790482477e-13, -8.60467152213735e-11, 5.12229709037114e-08,
    1.48572235717979e-05, 6.37261928875436e-04, 4.89352455891786e-03,
)  # fmt: skip
TANH_BELOW = (
    1.19825839466702e-06,
    1.18534705686654e-04,
    2.26843463243900e-03,
    4.89352518554385e-03,
)


CHEAPER: dict[Any, Callable[..., Any]] = {
    torch.ops.aten.mm.default: mm,
    torch.ops.aten.addmm.default: addmm,
    torch.ops.aten.tanh.default: tanh,
    torch.ops.aten.sum.dim_IntList: column_sums,
}


class _Call(nn.Module):
    """A function as the forward pass of a module, so that its parameters can be replaced."""

    def __init__(self, model: nn.Module, function: Callable[..., Any]) -> None:
        super().__init__()
        self.model, self._function = model, function

    def forward(self, *arguments: Any) -> Any:
        return self._function(*arguments)
