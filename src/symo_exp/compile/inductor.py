"""The only uses of PyTorch's compiler that go beyond its public interface."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from symo_exp.compile.kernels import CHEAPER

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

flatten, unflatten = pytree.tree_flatten, pytree.tree_unflatten
"""Nested objects to their tensors and back."""


class CompilerError(RuntimeError):
    """Raised if the compiler fails, and not the function that it compiles."""


def compiler_available() -> bool:
    """Return whether the machine has the C++ compiler that the generated kernels need."""
    return any(shutil.which(name) for name in ("c++", "g++", "clang++"))


def kernel_cache() -> Path:
    """Return the folder of compiled kernels."""
    own = os.environ.get("TORCHINDUCTOR_CACHE_DIR")
    return Path(own) if own else Path.home() / ".cache" / "symo_exp" / "kernels"


def trace(function: Callable[..., list[Tensor]], example: Sequence[Tensor]) -> torch.fx.GraphModule:
    """Return the operations of a function of tensors, with the cheaper kernels in place."""
    from torch.fx.experimental.proxy_tensor import make_fx

    return make_fx(function, decomposition_table=CHEAPER)(*example)


def lower(graph: torch.fx.GraphModule, example: Sequence[Tensor]) -> Callable[..., list[Tensor]]:
    """Return a graph as kernels for the shapes and layouts of ``example``.

    Kernels are cached on disk: a later process with the same graph, such as another job of a sweep,
    spends seconds here instead of a minute. All inputs are tensors of fixed shapes, so that nothing
    is checked at a call.

    Raises:
        CompilerError: If the compiler fails.
    """
    os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(kernel_cache())
    os.environ.setdefault("TORCHINDUCTOR_COMPILE_THREADS", "1")
    # The graph is sound, so every error here is the compiler's: a missing lowering, a broken g++ or
    # a full disk. They have no common class.
    try:
        from torch._inductor import standalone_compile

        return standalone_compile(
            graph, [*example], dynamic_shapes="from_example_inputs", options=OPTIONS
        )
    except Exception as error:
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise CompilerError(reason) from error


def carry(kind: type, *constants: str) -> None:
    """Register a class with ``flatten``; attributes named in ``constants`` are kept as they are."""

    def take_apart(x: Any) -> tuple[list[Any], Any]:
        given = dict(vars(x))
        kept = {name: given.pop(name) for name in constants}
        return list(given.values()), (list(given), kept)

    def put_together(values: Any, context: Any) -> Any:
        x: Any = object.__new__(kind)
        vars(x).update(zip(context[0], values, strict=True), **context[1])
        return x

    pytree.register_pytree_node(kind, take_apart, put_together)
