"""The stores of tests/tracking, for reports."""

from tests.tracking.conftest import _no_ambient_tracking, store

__all__ = ["_no_ambient_tracking", "store"]
