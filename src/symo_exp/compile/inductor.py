"""The only uses of PyTorch's compiler that go beyond its public interface."""

from __future__ import annotations

import logging
import os
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from symo_exp.errors import first_line
from symo_exp.files import user_cache
from symo_exp.mechanics.rows import Rowwise

OPTIONS = {
    "config_patches": {
        "cpp_wrapper": True,
        "cpp_wrapper_build_separate": True,
        "pattern_matcher": False,
    }
}
"""The code that calls the kernels is compiled, too: with few rows Python took a fifth of a step for
it. It is built separately and optimised less, which shortens compilation and not the step. Sums are
not merged into products of matrices (``addmm``)."""
logging.getLogger("torch._inductor.ir").setLevel(logging.ERROR)  # which solver is called how

TYPICAL_ROWS = 128
"""Number of rows that the compiler optimises for if it is left open."""

unflatten = pytree.tree_unflatten
"""Nested objects from their tensors: the inverse of ``flatten``."""


class CompilerError(RuntimeError):
    """Raised if the compiler fails, or a function has no fixed sequence of operations."""


class OpenRowsError(Exception):
    """Raised if a function cannot be compiled once for all numbers of rows."""


def compiler_available() -> bool:
    """Return whether the machine has the C++ compiler that the generated kernels need."""
    return any(shutil.which(name) for name in ("c++", "g++", "clang++"))


def kernel_cache() -> Path:
    """Return the folder of compiled kernels: the one of ``TORCHINDUCTOR_CACHE_DIR``, else our own.

    When its compiler is imported, PyTorch sets the variable to ``torchinductor_<user>`` below the
    folder of temporary files, which a restart deletes and another user may have made.
    """
    given = Path(os.environ.get("TORCHINDUCTOR_CACHE_DIR") or "torchinductor_")
    return user_cache() / "kernels" if given.name.startswith("torchinductor_") else given


def stand_ins(fixed: Sequence[Tensor], batched: Sequence[Tensor], rows: int | None) -> list[Tensor]:
    """Return tensors without data, with which a function of ``fixed`` and ``batched`` is traced.

    Args:
        fixed: Tensors whose shapes are part of the graph, such as parameters.
        batched: Tensors whose leading dimension, where it has the size ``rows``, is the batch, or
            results of another trace, which are returned as they are.
        rows: Number of rows, which is left open: the graph is the same for all batches.
            ``None``: all shapes are part of the graph.
    """
    from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode
    from torch.fx.experimental.symbolic_shapes import (
        DimDynamic,
        ShapeEnv,
        StatelessSymbolicContext,
    )

    mode = _mode(batched) or FakeTensorMode(
        shape_env=ShapeEnv(),
        allow_non_fake_inputs=True,  # constants of the model
    )

    def stand_in(x: Tensor, size: int | None) -> Tensor:
        if isinstance(x, FakeTensor):
            return x
        sizes = [DimDynamic.STATIC] * x.ndim
        if size is not None and x.shape[:1] == (size,):
            sizes[0] = DimDynamic.DUCK  # all of these are the same unknown
            shape = (TYPICAL_ROWS, *x.shape[1:])
            x = torch.empty_strided(shape, x.stride(), dtype=x.dtype, device=x.device)
        return mode.from_tensor(x, symbolic_context=StatelessSymbolicContext(dynamic_sizes=sizes))

    return [*(stand_in(x, None) for x in fixed), *(stand_in(x, rows) for x in batched)]


def trace(
    function: Callable[..., Sequence[Tensor]],
    example: Sequence[Tensor],
    kernels: Mapping[Any, Callable[..., Any]],
) -> torch.fx.GraphModule:
    """Return the operations of a function of stand-ins, derivatives among them.

    Args:
        function: The function.
        example: Its arguments.
        kernels: Functions that replace operations.

    Raises:
        OpenRowsError: If the operations depend on a number of rows that was left open.
        CompilerError: If they depend on values.
    """
    from torch._dispatch.python import enable_python_dispatcher
    from torch.fx.experimental.proxy_tensor import make_fx
    from torch.fx.experimental.symbolic_shapes import GuardOnDataDependentSymNode

    mode = _mode(example)
    known = len(mode.shape_env.guards)  # the compiler has left its own there
    try:
        with mode, enable_python_dispatcher():
            graph = make_fx(function, decomposition_table=kernels)(*example)
    except GuardOnDataDependentSymNode as error:
        raise CompilerError("its operations depend on values") from error
    if len(mode.shape_env.guards) > known:
        raise OpenRowsError("its operations depend on the number of rows")
    return graph


def simplify(graph: torch.fx.GraphModule) -> None:
    """Remove views that change no shape, and operations whose results nothing uses.

    Products of matrices leave such views behind. Results stay the same to the last bit.

    Args:
        graph: A graph from ``trace``, which is changed.
    """
    from torch.fx.experimental.symbolic_shapes import statically_known_true, sym_eq

    aten = torch.ops.aten
    # products of matrices are traced with _unsafe_view, an operation without a public name
    views = (aten.view.default, aten._unsafe_view.default, aten.expand.default)
    for target in views:
        for node in graph.graph.find_nodes(op="call_function", target=target):
            source = node.args[0]
            before, after = (tuple(x.meta["val"].shape) for x in (source, node))
            if statically_known_true(sym_eq(before, after)):
                node.replace_all_uses_with(source)
                graph.graph.erase_node(node)
    graph.graph.eliminate_dead_code()
    graph.recompile()


def _mode(tensors: Sequence[Tensor]) -> Any:
    """Return what the stand-ins among some tensors have in common, ``None`` if there are none."""
    from torch._guards import detect_fake_mode

    return detect_fake_mode(tensors)


def lower(graph: torch.fx.GraphModule, example: Sequence[Tensor]) -> Callable[..., list[Tensor]]:
    """Return a graph as kernels for the shapes and layouts of the stand-ins in ``example``.

    Kernels are cached on disk: a later process with the same graph, such as another job of a sweep,
    spends seconds here instead of a minute.

    Raises:
        CompilerError: If the compiler fails.
    """
    os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(kernel_cache())
    os.environ.setdefault("TORCHINDUCTOR_COMPILE_THREADS", "1")
    # The graph is sound, so every error here is the compiler's: a missing lowering, a broken g++ or
    # a full disk. They have no common class.
    try:
        from torch._guards import TracingContext, tracing
        from torch._inductor import standalone_compile

        with tracing(TracingContext(_mode(example))), warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of PyTorch about its own functions
            return standalone_compile(
                graph, [*example], dynamic_shapes="from_tracing_context", options=OPTIONS
            )
    except Exception as error:
        raise CompilerError(first_line(error)) from error


def flatten(tree: Any) -> tuple[list[Any], Any]:
    """Return the tensors of nested objects, and their structure."""
    _carry(Rowwise)
    return pytree.tree_flatten(tree)


def _carry(kind: type[Rowwise]) -> None:
    """Register a class and those derived from it; attributes without tensors are kept as is."""
    for derived in kind.__subclasses__():
        _carry(derived)
    if kind in pytree.SUPPORTED_NODES:
        return

    def take_apart(x: Any) -> tuple[list[Any], Any]:
        given: dict[str, Any] = {}
        kept: dict[str, Any] = {}
        for name, value in vars(x).items():
            into = given if isinstance(value, Tensor | tuple | Rowwise) else kept
            into[name] = value
        return list(given.values()), (list(given), kept)

    def put_together(values: Any, context: Any) -> Any:
        x: Any = object.__new__(kind)
        vars(x).update(zip(context[0], values, strict=True), **context[1])
        return x

    pytree.register_pytree_node(kind, take_apart, put_together)
