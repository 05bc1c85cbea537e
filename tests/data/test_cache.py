"""The cache: complete keys, whole files, one maker at a time."""

from __future__ import annotations

import json
import logging
import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from symo_exp.data.cache import Cache, key
from symo_exp.errors import ConfigError

RECIPE = {"what": "test", "numbers": [1, 2.5]}


def arrays() -> dict[str, np.ndarray]:
    return {"a": np.arange(2000.0).reshape(40, 50), "b": np.ones(3)}


def refuse() -> dict[str, np.ndarray]:
    raise AssertionError("made again")


def same(found: dict[str, np.ndarray]) -> bool:
    return found.keys() == arrays().keys() and all(
        np.array_equal(found[name], value) for name, value in arrays().items()
    )


def test_data_are_made_once_and_read_back(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "new" / "folder")
    assert same(cache.get("x", RECIPE, arrays))
    assert same(cache.get("x", RECIPE, refuse))
    path = cache.path("x", RECIPE)
    assert json.loads(path.with_suffix(".json").read_text()) == RECIPE
    with np.load(path, allow_pickle=False) as file:  # a plain format
        assert json.loads(str(file["recipe"])) == RECIPE
    assert not list(path.parent.glob(".*"))  # no temporary file is left


def test_another_recipe_is_another_file(tmp_path: Path) -> None:
    assert key(RECIPE) != key(RECIPE | {"numbers": [1, 2.6]})
    assert key(RECIPE) == key(dict(reversed(RECIPE.items())))
    cache = Cache(tmp_path)
    cache.get("x", RECIPE, arrays)
    with pytest.raises(AssertionError, match="made again"):
        cache.get("x", RECIPE | {"more": 1}, refuse)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))


def save(path: Path, write: Callable, *content: object, **named: object) -> None:
    with open(path, "wb") as file:
        write(file, *content, **named)


def flip_in_directory(path: Path, place: int) -> None:
    """Flip a bit of the entry of the first array: byte 8 has flags, byte 10 the method."""
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\x01\x02") + place] ^= 1
    path.write_bytes(bytes(content))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:5000]),
    "empty": lambda path: path.write_bytes(b""),
    "one bit flipped": flip,
    "encrypted": lambda path: flip_in_directory(path, 8),
    "compressed in an unknown way": lambda path: flip_in_directory(path, 10),
    "text": lambda path: path.write_text("not an archive"),
    "an array": lambda path: save(path, np.save, np.ones(3)),
    "no recipe": lambda path: save(path, np.savez, a=np.ones(3)),
    "another recipe": lambda path: save(
        path, np.savez, recipe=np.array('{"what": "else"}'), a=np.ones(3)
    ),
    "pickled": lambda path: save(
        path, np.savez, recipe=np.array({"what": "test"}, dtype=object), allow_pickle=True
    ),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_reported_and_made_again(
    damage: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cache = Cache(tmp_path)
    cache.get("x", RECIPE, arrays)
    path = cache.path("x", RECIPE)
    DAMAGE[damage](path)
    with caplog.at_level(logging.WARNING):
        assert same(cache.get("x", RECIPE, arrays))
    assert [str(path) in r.message and "\n" not in r.message for r in caplog.records] == [True]
    assert same(cache.get("x", RECIPE, refuse))


def test_a_failed_generation_leaves_no_file(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    with pytest.raises(AssertionError, match="made again"):
        cache.get("x", RECIPE, refuse)
    assert not cache.path("x", RECIPE).exists()
    assert same(cache.get("x", RECIPE, arrays))


def test_a_write_cut_short_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file: object, **_: object) -> None:
        file.write(b"half")  # type: ignore[attr-defined]
        raise OSError(28, "No space left on device")

    cache = Cache(tmp_path)
    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(ConfigError, match=r"data\.cache_dir=.*No space left"):
        cache.get("x", RECIPE, arrays)
    assert not cache.path("x", RECIPE).exists()
    assert not list(tmp_path.glob(".*"))


def test_a_path_that_is_no_directory_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    for place in (file, file / "below"):
        with pytest.raises(ConfigError, match=r"data\.cache_dir=.*not a directory"):
            Cache(place)


def test_an_unwritable_directory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere
    with pytest.raises(ConfigError, match=r"data\.cache_dir=.*not writable"):
        Cache(tmp_path / "new").check("x", RECIPE)
    assert not (tmp_path / "new").exists()


def test_an_unwritable_directory_is_accepted_if_the_data_are_cached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = Cache(tmp_path)
    cache.get("x", RECIPE, arrays)
    monkeypatch.setattr("os.access", lambda *_: False)
    cache.check("x", RECIPE)
    assert same(cache.get("x", RECIPE, refuse))
    with pytest.raises(ConfigError, match="not writable"):
        cache.check("y", RECIPE)


def slow_and_counted(folder: str, log: str, queue) -> None:
    def make() -> dict[str, np.ndarray]:
        with open(log, "a") as file:
            file.write("made\n")
        time.sleep(0.5)
        return arrays()

    queue.put(same(Cache(folder).get("x", RECIPE, make)))


def test_four_processes_make_the_data_once(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    queue, log = context.Queue(), tmp_path / "log"
    jobs = [
        context.Process(target=slow_and_counted, args=(str(tmp_path / "c"), str(log), queue))
        for _ in range(4)
    ]
    for job in jobs:
        job.start()
    answers = [queue.get(timeout=60) for _ in jobs]
    for job in jobs:
        job.join(60)
    assert answers == [True] * 4
    assert log.read_text() == "made\n"
