"""Engines of maps: the same bytes on all of them, and nothing lost when something dies."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from maps import SLOW, TINY, command, files, is_running, of_models, tasks, until, workers_of, write
from outputs import read_rows

from casadi_skin import run_map

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc"),
    pytest.mark.filterwarnings("ignore"),  # of distributed
]
PLAIN = {"pictures": False, "quiet": True}
JOURNAL = "journal.msgpack"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[bytes, bytes]]:
    """A scene of slow cells, and the tables of its map."""
    folder = tmp_path_factory.mktemp("undisturbed")
    scene = of_models(folder, SLOW)
    assert run_map(scene, folder / "out", workers=2, **PLAIN).complete
    return scene, files(folder / "out")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A dask cluster of two workers on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as found:
        yield found


def test_all_engines_give_the_same_bytes(tmp_path: Path, cluster: Any) -> None:
    scene = write(tmp_path, TINY)
    known = run_map(scene, tmp_path / "one", **PLAIN)
    assert (known.complete, known.shape) == (True, (3, 2, 2))
    with ThreadPoolExecutor(1) as executor:
        run_map(scene, tmp_path / "threads", executor=executor, **PLAIN)
    run_map(scene, tmp_path / "dask", scheduler=cluster.scheduler_address, **PLAIN)
    parts = [run_map(scene, tmp_path / "parts", part=(k, 2), **PLAIN) for k in (2, 1)]
    assert [(part.complete, part.waits) for part in parts] == [(False, True), (True, False)]
    for name in ("threads", "dask", "parts"):
        assert files(tmp_path / name) == files(tmp_path / "one"), name
    for name in ("map.nc", "map.csv"):
        (tmp_path / "parts" / name).unlink()
    assert run_map(scene, tmp_path / "parts", collect=True, **PLAIN).complete
    assert files(tmp_path / "parts") == files(tmp_path / "one")


def test_what_dies_hangs_or_fails_is_told_tried_twice_and_left(tmp_path: Path) -> None:
    scene = of_models(tmp_path, ["good", "hangs", "dies", "fails"], "cell_limit = 4.0\n")
    found = run_map(scene, tmp_path / "out", **PLAIN)
    assert found.status.tolist() == [1, 3, 3, 3]
    reasons = dict(found.failures())
    assert reasons["model.name = hangs"] == "took longer than 4 s"
    late = [task.seconds for task in tasks(tmp_path / "out" / JOURNAL) if task.kind == "late"]
    assert max(late) < 8.0  # the limit, and what a loaded machine adds
    assert reasons["model.name = dies"] == "its worker ended by signal 9"
    assert "RuntimeError: never" in reasons["model.name = fails"]
    attempts = [(task.cells[0], task.attempt, task.kind) for task in tasks(tmp_path / "out" / JOURNAL)]
    assert sorted(attempts) == [
        (0, 1, ""), (1, 1, "late"), (1, 2, "late"), (2, 1, "died"), (2, 2, "died"), (3, 1, "failed"), (3, 2, "failed"),
    ]  # fmt: skip
    found.forget_outside()  # as a map that is resumed does
    assert found.states.tolist() == [1, 0, 0, 3]


def killed_at_work(worker: int, folder: Path) -> bool:
    """Kill a worker that computes a cell: one that is killed between two is started again, and nothing dies."""
    os.kill(worker, signal.SIGSTOP)
    at_work = (folder / f"computes_{worker}").exists()
    os.kill(worker, signal.SIGKILL if at_work else signal.SIGCONT)
    return at_work


def test_workers_and_a_parent_that_are_killed_lose_no_finished_cell(
    tmp_path: Path, undisturbed: tuple[Path, tuple[bytes, bytes]]
) -> None:
    scene, known = undisturbed
    out = tmp_path / "out"
    with command("map", scene, "--out", out, "--workers", 2, "--no-pictures", "--quiet") as process:
        until(lambda: tasks(out / JOURNAL))
        until(lambda: killed_at_work(workers_of(process.pid)[0], scene.parent))
        until(lambda: "died" in [task.kind for task in tasks(out / JOURNAL)])
        workers = workers_of(process.pid)
        process.send_signal(signal.SIGKILL)
    until(lambda: not any(map(is_running, workers)), 10.0)
    kept = tasks(out / JOURNAL)
    assert run_map(scene, out, resume=True, **PLAIN).complete
    every = tasks(out / JOURNAL)
    assert every[: len(kept)] == kept
    assert sorted(task.cells for task in every if not task.kind) == [(k,) for k in range(len(SLOW))]
    assert files(out) == known


def test_a_worker_that_hangs_does_not_outlive_a_parent_that_is_killed(tmp_path: Path) -> None:
    scene, out = of_models(tmp_path, ["good", "hangs"]), tmp_path / "out"
    with command("map", scene, "--out", out, "--no-pictures", "--quiet") as process:
        until(lambda: tasks(out / JOURNAL))
        until(lambda: workers_of(process.pid))
        workers = workers_of(process.pid)
        process.send_signal(signal.SIGKILL)
    until(lambda: not any(map(is_running, workers)), 10.0)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_map_is_written(tmp_path: Path) -> None:
    scene, out = of_models(tmp_path, ["good", "hangs"]), tmp_path / "out"  # it is interrupted however slow we look
    with command("map", scene, "--out", out, "--no-pictures", "--quiet") as process:
        until(lambda: tasks(out / JOURNAL))
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
    assert [task.cells for task in tasks(out / JOURNAL)] == [(0,)]
    assert len(read_rows(out / "map.csv")) == 1


def test_a_lost_worker_of_a_cluster_and_a_lost_scheduler_lose_nothing(
    tmp_path: Path, cluster: Any, undisturbed: tuple[Path, tuple[bytes, bytes]]
) -> None:
    scene, known = undisturbed
    first, second = tmp_path / "first", tmp_path / "second"

    def kill() -> None:
        until(lambda: tasks(first / JOURNAL))
        with suppress(ProcessLookupError):
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    assert run_map(scene, first, scheduler=cluster.scheduler_address, **PLAIN).complete
    killer.join()
    assert files(first) == known

    def close() -> None:
        until(lambda: tasks(second / JOURNAL))
        cluster.close()

    closer = threading.Thread(target=close)
    closer.start()
    assert run_map(scene, second, scheduler=cluster.scheduler_address, workers=2, **PLAIN).complete
    closer.join()
    assert files(second) == known
    assert "lost" in [task.kind for task in tasks(second / JOURNAL)]
