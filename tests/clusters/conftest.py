"""Fixtures of the tests of clusters."""

from tests.faults.commands import nothing_goes_on  # noqa: F401 - it acts on every test
