"""The run folder of a sweep: in the store, the runs of the sweep appear beneath it."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import Any

from symo_exp.errors import first_line, one_line
from symo_exp.job.job import SWEEP, VARIED, end, publish
from symo_exp.job.lines import MEASURES
from symo_exp.process import stopping
from symo_exp.report.looks import written
from symo_exp.runs.digest import digest
from symo_exp.runs.folder import RunFolder
from symo_exp.runs.outcome import About, Status
from symo_exp.sweep.compose import Job
from symo_exp.tracking.page import COMMAND, RESULT


def parent_folder(jobs: Sequence[Job]) -> RunFolder:
    """Return the run folder of a sweep. The same jobs are the same sweep."""
    names = {job.folder.path.name: "" for job in jobs}
    return RunFolder(jobs[0].folder.path.parent / ".sweeps" / digest(names))


@contextmanager
def parent(jobs: Sequence[Job], name: str, command: str, tracker: Any) -> Iterator[None]:
    """Keep a run folder for the sweep meanwhile."""
    folder = parent_folder(jobs)
    with nullcontext() if folder.in_use() else folder.alone():
        folder.mark_published(None)
        tags = {COMMAND: command}
        folder.describe(About(name, {"jobs": len(jobs)}, tags=tags))
        folder.record("running")
        publish(tracker, folder)
        about = folder.about()
        os.environ[SWEEP] = about.identity if about else ""
        words = (word.partition("=") for job in jobs for word in job.label.split())
        varied = list(dict.fromkeys(name for name, equals, _ in words if equals))
        os.environ[VARIED] = ",".join(varied)
        tracker.show(varied)
        status: Status = "finished"
        reason = ""
        try:
            yield
        except Exception as error:
            status, reason = "failed", f"{type(error).__name__}: {one_line(error)}"
            raise
        except BaseException as error:
            status, reason = "interrupted", first_line(error)
            raise
        else:
            signum = stopping.requested()
            bad = sum(job.folder.outcome().status != "finished" for job in jobs)
            if signum is not None:
                status, reason = "interrupted", str(stopping.Interrupted(signum))
            elif bad:
                status, reason = "failed", f"{bad} of {len(jobs)} runs failed"
            if result := _result(jobs):
                with suppress(OSError):  # a full disk: the runs have these numbers
                    folder.describe(About(name, {"jobs": len(jobs)}, tags={**tags, RESULT: result}))
        finally:
            os.environ.pop(SWEEP, None)
            os.environ.pop(VARIED, None)
            end(folder, tracker, status, reason)


def _result(jobs: Sequence[Job]) -> str:
    """Return the run with the smallest value of each measure."""
    measures = {job.label: job.folder.measures() for job in jobs}
    least = []
    for name in MEASURES:
        there = {label: found[name] for label, found in measures.items() if name in found}
        if there:
            label = min(there, key=lambda one: (math.isnan(there[one]), there[one]))
            least.append(f"{name} {written(there[label])} ({label})")
    return f"Smallest {', '.join(least)}." if least else ""
