"""What the tests of this folder share."""

from tests.faults.commands import nothing_goes_on  # noqa: F401 - it acts on every test
