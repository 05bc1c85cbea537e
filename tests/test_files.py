"""Files of all packages: where those of the user are."""

from pathlib import Path

import pytest

from symo_exp.files import user_cache


@pytest.mark.parametrize(
    ("given", "folder"), [(None, "me/.cache"), ("", "me/.cache"), ("elsewhere", "elsewhere")]
)
def test_the_cache_of_a_user_is_where_the_desktop_specification_puts_it(
    given, folder, tmp_path, monkeypatch
):
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if given is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", given and str(tmp_path / given))
    assert user_cache() == Path(tmp_path, folder, "symo_exp")
