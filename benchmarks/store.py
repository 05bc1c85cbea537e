"""``python -m benchmarks.store``: what runs cost a tracking store, the figures of docs/scaling.md.

Runs of 2000 epochs are made up: 480 points of five series, 100 parameters, 8 tags.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import sqlite3
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from symo_exp.report.runs import load_runs
from symo_exp.runs.folder import About, RunFolder
from symo_exp.runs.series import Series
from symo_exp.tracking.publish import MlflowView
from symo_exp.tracking.store import Store, connect, experiment_id, find
from tests.clusters.server import Server, free_ports

POINTS, SERIES, PARAMETERS = 480, 5, 100
BASICS = {"model": "symo", "system": "pendulum", "seed": 0, "integrator": "midpoint"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each crowd of writers")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "server") as server:
        Path(folder).chmod(0o755)
        stores = {"SQLite": find(None, Path(folder) / "file")}
        if server:
            stores["PostgreSQL"] = find(server, folder)
            requests_of_a_run(stores["PostgreSQL"], Path(folder))
        for name, store in stores.items():
            for writers in (1, 8):
                crowd(name, store, writers, given.seconds)
        many_runs(find(None, Path(folder) / "many"), given.runs)


@contextlib.contextmanager
def served(folder: Path) -> Iterator[str | None]:
    """The address of a server with PostgreSQL, if there can be one."""
    folder.mkdir()
    folder.parent.chmod(0o755)  # the user of PostgreSQL has to get there
    (port,) = free_ports(1)
    server = Server(folder, host="127.0.0.1", port=port, workers=2)
    try:
        server.start()
    except Exception as error:
        print(f"no server: {error}")
        yield None
        return
    try:
        yield server.address
    finally:
        server.stop()


def requests_of_a_run(store: Store, folder: Path) -> None:
    """Requests of the tracker to the server for a run without files, by kind."""
    import requests

    asked: Counter[str] = Counter()
    send = requests.Session.request

    def counted(session: Any, method: str, url: str, **options: Any) -> Any:
        asked[f"{method} {url.partition('/api/')[2].partition('?')[0] or url}"] += 1
        return send(session, method, url, **options)

    made = made_run(folder / "run")
    view = MlflowView(tracking_uri=store.uri, every_n_epochs=1)
    with mock.patch.object(requests.Session, "request", counted):
        view.publish(made)
        opened = sum(asked.values())
        made.write_measures({"test_mse": 1.0})
        made.record("finished")
        view.publish(made)
    print(f"requests to open a run {opened}, to close it {sum(asked.values()) - opened}")
    for kind, count in asked.most_common():
        print(f"  {count:3d} {kind}")


def made_run(path: Path) -> RunFolder:
    """The folder of a run that trains, as if it had done all its epochs."""
    folder = RunFolder(path)
    folder.describe(About("made", parameters()))
    folder.record("running")
    series = Series(folder / "series.csv")
    for epoch in range(POINTS):
        series.append(epoch, {f"series_{i}": 1.0 / (1 + epoch) for i in range(SERIES)})
    return folder


def parameters() -> dict[str, Any]:
    return BASICS | {f"group.name_{i}": 0.1 * i for i in range(PARAMETERS - len(BASICS))}


def crowd(name: str, store: Store, writers: int, seconds: float) -> None:
    """As many processes, each sending batch after batch."""
    experiment = experiment_id(store, "crowd")
    with multiprocessing.get_context("spawn").Pool(writers) as pool:
        pool.starmap(write, [(store, experiment, 1.0)] * writers)  # all is imported
        times = [t for found in pool.starmap(write, [(store, experiment, seconds)] * writers)
                 for t in found]  # fmt: skip
    times.sort()
    print(
        f"{name}, {writers} writers: {len(times) / seconds:.0f} batches of 50 rows a second, "
        f"median {1e3 * times[len(times) // 2]:.0f} ms, "
        f"95 % in {1e3 * times[int(0.95 * len(times))]:.0f} ms, slowest {times[-1]:.1f} s",
        flush=True,
    )


def write(store: Store, experiment: str, seconds: float) -> list[float]:
    """Seconds of each batch."""
    from mlflow.entities import Metric

    client = connect(store)
    run = client.create_run(experiment).info.run_id
    times = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        step = 10 * len(times)
        rows = [Metric(f"s{i}", 0.5, 0, step + k) for i in range(5) for k in range(10)]
        times.append(timed(lambda rows=rows: client.log_batch(run, metrics=rows)))
    return times


def many_runs(store: Store, count: int) -> None:
    """Size of a store with so many runs, and the time that it takes to answer."""
    assert store.database is not None
    place = store.database.parent
    view = MlflowView(experiment="thesis", directory=place, every_n_epochs=1)
    one, other = made_run(place / "one"), made_run(place / "other")
    one.record("finished")
    view.publish(one)
    first = one.published()["run_id"]
    multiply(store.database, first, count)
    size = store.database.stat().st_size
    print(f"{count} runs: {size / 1e6:.0f} MB, {size / count / 1e3:.0f} kB a run")
    found = 0

    def report() -> None:
        nonlocal found
        found = load_runs(store, ["thesis"]).run_id.nunique()

    asked = {
        "all runs, for a report": report,
        "a run with all its series": lambda: view.publish(other),
        "go on with a run": lambda: MlflowView(experiment="thesis", directory=place).publish(other),
    }
    for name, what in asked.items():
        print(f"  {name}: {timed(what):.2f} s")
    assert found >= count


def multiply(database: Path, run: str, count: int) -> None:
    """Copy all that a store has of a run, so that it has ``count`` of them with other seeds."""
    changed = {
        "run_uuid": "substr(run_uuid, 1, 24) || printf('%08d', n)",
        "value": "case key when 'seed' then n else value end",
    }
    with sqlite3.connect(database) as db:
        for table in ("runs", "metrics", "latest_metrics", "params", "tags"):
            columns = [row[1] for row in db.execute(f"pragma table_info({table})")]
            values = ", ".join(changed.get(c, c) for c in columns)
            db.execute(
                f"with recursive numbers(n) as (select 1 union all select n + 1 from numbers "
                f"where n < {count - 1}) insert into {table} ({', '.join(columns)}) "
                f"select {values} from {table}, numbers where run_uuid = ?",
                (run,),
            )


def timed(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
