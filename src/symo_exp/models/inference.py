"""Calls from ``torch.inference_mode()``."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import torch

P = ParamSpec("P")
T = TypeVar("T")


def leaves_inference_mode(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that leaves ``torch.inference_mode()`` while it runs.

    Models and systems differentiate their own functions. The mode makes such derivatives zero, or
    raises an error. Results have no gradients there, as under ``torch.no_grad()``.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if not torch.is_inference_mode_enabled():
            return function(*args, **kwargs)
        with torch.inference_mode(False), torch.no_grad():
            return function(*args, **kwargs)

    return call
