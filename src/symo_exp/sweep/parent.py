"""A sweep of several runs is itself a run folder: in the store its runs appear beneath it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

from symo_exp.runs.digest import digest
from symo_exp.runs.folder import About, RunFolder
from symo_exp.sweep.compose import Job
from symo_exp.sweep.job import SWEEP, publish
from symo_exp.training import stopping


@contextmanager
def parent(jobs: Sequence[Job], name: str, tracker: Any) -> Iterator[None]:
    """Around the work of a sweep. The same jobs are the same sweep, whenever they are done."""
    names = {job.folder.path.name: "" for job in jobs}
    folder = RunFolder(jobs[0].folder.path.parent / ".sweeps" / digest(names))
    with nullcontext() if folder.in_use() else folder.alone():
        folder.mark_published(None)
        folder.describe(About(name, {"jobs": len(jobs)}))
        folder.record("running")
        publish(tracker, folder)
        about = folder.about()
        os.environ[SWEEP] = about.identity if about else ""
        try:
            yield
        except BaseException as error:
            folder.record("failed" if isinstance(error, Exception) else "interrupted", repr(error))
            raise
        else:
            signum = stopping.requested()
            bad = sum(job.folder.outcome().status != "finished" for job in jobs)
            if signum is not None:
                folder.record("interrupted", str(stopping.Interrupted(signum)))
            elif bad:
                folder.record("failed", f"{bad} of {len(jobs)} runs failed")
            else:
                folder.record("finished")
        finally:
            os.environ.pop(SWEEP, None)
            publish(tracker, folder)
