"""Garbage collection is suspended during large imports only."""

import gc
import sys

import pytest

from symo_exp.imports import first_import

NEW = "a_module_that_was_not_imported"


def test_imported_objects_are_exempt_from_garbage_collection():
    before = gc.get_freeze_count()
    with first_import(NEW):
        assert not gc.isenabled()
        kept = [[] for _ in range(1000)]
    assert gc.isenabled()
    assert gc.get_freeze_count() >= before + len(kept)


def test_a_failed_import_leaves_the_collector_enabled():
    with pytest.raises(ImportError), first_import(NEW):
        raise ImportError
    assert gc.isenabled()


def test_a_second_import_leaves_the_collector_enabled():
    assert "pytest" in sys.modules
    with first_import("pytest"):
        assert gc.isenabled()


def test_a_disabled_collector_stays_disabled():
    gc.disable()
    try:
        with first_import(NEW):
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
