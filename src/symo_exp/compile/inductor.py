"""What is private of PyTorch's compiler: nothing else here knows more than this file offers."""

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
"""What calls the kernels is compiled, too: with few rows a fifth of a step was Python doing that;
apart from them and optimised less, which g++ is done with sooner and a step does not notice.
Sums are not put back into products of matrices (``addmm``)."""
logging.getLogger("torch._inductor.ir").setLevel(logging.ERROR)  # which solver is called how

flatten, unflatten = pytree.tree_flatten, pytree.tree_unflatten
"""Nested objects to their tensors and back."""


class CompilerError(RuntimeError):
    """The compiler, or the machine that it runs on, has failed; not what it was to compile."""


def compiler_available() -> bool:
    """Whether the machine has the C++ compiler that the generated kernels need."""
    return any(shutil.which(name) for name in ("c++", "g++", "clang++"))


def kernel_cache() -> Path:
    """Where kernels are kept."""
    own = os.environ.get("TORCHINDUCTOR_CACHE_DIR")
    return Path(own) if own else Path.home() / ".cache" / "symo_exp" / "kernels"


def trace(function: Callable[..., list[Tensor]], example: Sequence[Tensor]) -> torch.fx.GraphModule:
    """The operations of a function of tensors, with the cheaper kernels in place."""
    from torch.fx.experimental.proxy_tensor import make_fx

    return make_fx(function, decomposition_table=CHEAPER)(*example)


def lower(graph: torch.fx.GraphModule, example: Sequence[Tensor]) -> Callable[..., list[Tensor]]:
    """The graph as kernels for the shapes and layouts of ``example``, kept in the user's cache.

    Its only inputs are tensors of fixed shapes, so nothing has to be checked at every call. The
    next process that comes with the same graph, another job of a sweep say, finds its kernels on
    disk and spends seconds here instead of a minute.
    """
    os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(kernel_cache())
    os.environ.setdefault("TORCHINDUCTOR_COMPILE_THREADS", "1")
    # The graph is traced and sound, so whatever goes wrong here is the compiler's, be it a missing
    # lowering, a broken g++ or a full disk: there is no common class of all that.
    try:
        from torch._inductor import standalone_compile

        return standalone_compile(
            graph, [*example], dynamic_shapes="from_example_inputs", options=OPTIONS
        )
    except Exception as error:
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise CompilerError(reason) from error


def carry(kind: type, *constants: str) -> None:
    """Let ``flatten`` take objects of a class apart; attributes named ``constants`` are kept."""

    def take_apart(x: Any) -> tuple[list[Any], Any]:
        given = dict(vars(x))
        kept = {name: given.pop(name) for name in constants}
        return list(given.values()), (list(given), kept)

    def put_together(values: Any, context: Any) -> Any:
        x: Any = object.__new__(kind)
        vars(x).update(zip(context[0], values, strict=True), **context[1])
        return x

    pytree.register_pytree_node(kind, take_apart, put_together)
