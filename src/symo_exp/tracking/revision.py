"""The git revision of the code that runs."""

from __future__ import annotations

import subprocess
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def revision_tags(package: Path = PACKAGE) -> dict[str, str]:
    """Return the commit and whether the package differs from it; nothing outside a checkout.

    An installed package may lie inside another repository (an environment in a project): only a
    repository that tracks the package's own file counts.
    """
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is None:
        return {}
    commit = _git(package, "rev-parse", "HEAD")
    if commit is None:
        return {}
    changed = _git(package, "status", "--porcelain", "--untracked-files=no")
    new = _git(package, "status", "--porcelain", "--", str(package))
    clean = changed == new == ""  # not where git did not answer in time
    # MLflow shows this tag as the run's version
    return {"mlflow.source.git.commit": commit, "git_dirty": str(not clean).lower()}


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
