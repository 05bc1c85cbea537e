"""The cache: complete keys, whole files, one maker at a time."""

from __future__ import annotations

import json
import logging
import multiprocessing
import time
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


def test_made_once_and_read_back(tmp_path: Path) -> None:
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


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))


def foreign_text(path: Path) -> None:
    path.write_text("not an archive")


def foreign_array(path: Path) -> None:
    with open(path, "wb") as file:
        np.save(file, np.ones(3))


def foreign_archive(path: Path) -> None:
    with open(path, "wb") as file:
        np.savez(file, a=np.ones(3))


def other_recipe(path: Path) -> None:
    with open(path, "wb") as file:
        np.savez(file, recipe=np.array('{"what": "else"}'), a=np.ones(3))


def pickled(path: Path) -> None:
    with open(path, "wb") as file:
        np.savez(file, recipe=np.array({"what": "test"}, dtype=object), allow_pickle=True)


@pytest.mark.parametrize(
    "spoil",
    [
        truncated,
        empty,
        flipped,
        foreign_text,
        foreign_array,
        foreign_archive,
        other_recipe,
        pickled,
    ],
)
def test_a_bad_file_is_noticed_said_and_made_again(
    spoil, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cache = Cache(tmp_path)
    cache.get("x", RECIPE, arrays)
    path = cache.path("x", RECIPE)
    spoil(path)
    with caplog.at_level(logging.WARNING):
        assert same(cache.get("x", RECIPE, arrays))
    assert [str(path) in r.message and "\n" not in r.message for r in caplog.records] == [True]
    assert same(cache.get("x", RECIPE, refuse))


def test_what_fails_leaves_nothing_and_can_be_tried_again(tmp_path: Path) -> None:
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


def test_a_place_that_is_no_directory_is_refused_at_once(tmp_path: Path) -> None:
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


def test_an_unwritable_directory_will_do_where_the_data_are_there(
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


def test_four_processes_make_it_once(tmp_path: Path) -> None:
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
