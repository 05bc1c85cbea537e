"""Checks of what functions of a user return."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from symo_exp.errors import ConfigError, with_place


def returned(told: str, function: Callable[..., Any], *given: Any) -> Any:
    """Return ``function(*given)``.

    Args:
        told: The call in words, for the error.
        function: A function that may be a user's.
        given: Its arguments.

    Raises:
        ConfigError: If it fails.
    """
    try:
        return function(*given)
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(f"{told} fails: {with_place(error)}") from error


def checked_tensor(
    told: str, value: object, shape: tuple[int, ...], dtype: torch.dtype, given: str
) -> Tensor:
    """Return ``value``.

    Args:
        told: The call that returned it, for the error.
        value: The returned object.
        shape: The shape that it should have.
        dtype: The precision that it should have.
        given: The arguments of the call, such as ``q of shape (3, 1)``.

    Raises:
        ConfigError: If it is no tensor of this shape and precision.
    """
    if not isinstance(value, Tensor):
        raise ConfigError(f"{told} returns {type(value).__name__}: expected a tensor")
    if tuple(value.shape) != shape:
        raise ConfigError(f"{told} has shape {tuple(value.shape)} for {given}: expected {shape}")
    if value.dtype != dtype:
        raise ConfigError(
            f"{told} has dtype {value.dtype}: expected {dtype}, that of its arguments; new tensors "
            "have it by dtype=q.dtype"
        )
    return value
