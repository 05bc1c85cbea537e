"""The revision is that of the package's own checkout, or none."""

import subprocess

import pytest

from symo_exp.tracking.revision import revision_tags


def git(folder, *arguments):
    identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "src" / "package"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    return folder


def test_outside_a_checkout_there_is_none(package):
    assert revision_tags(package) == {}


def test_a_checkout_gives_its_commit_and_whether_it_is_changed(package, tmp_path):
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "first")
    clean = {"mlflow.source.git.commit": git(tmp_path, "rev-parse", "HEAD"), "git_dirty": "false"}
    assert revision_tags(package) == clean
    (package / "__init__.py").write_text("changed")
    assert revision_tags(package) == clean | {"git_dirty": "true"}


def test_a_checkout_whose_changes_are_not_known_is_not_called_clean(package, tmp_path, monkeypatch):
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "first")
    ask = subprocess.run

    def slow(command, **options):
        if "status" in command:
            raise subprocess.TimeoutExpired(command, 10)
        return ask(command, **options)

    monkeypatch.setattr(subprocess, "run", slow)
    assert revision_tags(package)["git_dirty"] == "true"


def test_an_environment_inside_another_repository_is_not_its_revision(package, tmp_path):
    git(tmp_path, "init", "-q")
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "someone else's work")
    assert revision_tags(package) == {}


def test_without_git_there_is_no_revision(package, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert revision_tags(package) == {}
