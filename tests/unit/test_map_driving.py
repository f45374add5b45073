"""Driving a map with an engine that takes no time: which tasks it is given, when, and what is said of what is left."""

from __future__ import annotations

import os
import pickle
import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maps import EQUILIBRIUM as REST
from maps import TINY, of_models

from casadi_skin.runs import map as driving
from casadi_skin.runs.map import Drive, Engine, MapRun
from casadi_skin.runs.map_cell import FAILED, LATE, Computer, Result, Row
from casadi_skin.runs.map_grid import Grid, Task, plain
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.program import main
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene
from casadi_skin.runs.scene import Scene
from casadi_skin.solve.processes import Pool, Worker, WorkerEndedError, in_worker

EQUILIBRIUM = REST + "[map]\np = { from = 0.0, to = 9.0, points = 10 }\n"
REFINED = EQUILIBRIUM.replace("points = 10 }", "points = 10, resolution = 0.5 }") + 'watch = ["stable"]\n'


class Now(Executor):
    """Computes a task at once by a function of it; keeps tasks and limits."""

    def __init__(self, result: Callable[[Task, int], Result]) -> None:
        self.result, self.tasks, self.limits = result, list[Task](), list[float | None]()

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        _, task, limit = given
        attempt = 1 + sum(task.cells == before.cells for before in self.tasks)
        self.tasks.append(task)
        self.limits.append(limit)
        future: Future[Any] = Future()
        future.set_result(self.result(task, attempt))
        return future


class Said(Progress):
    """Keeps what is said."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.words = list[str]()

    def say(self, words: str) -> None:
        self.words.append(words)


def stored(folder: Path, scene: Scene, own: str | None = "journal.msgpack") -> Map:
    return Map(folder, Grid.of(scene), scene, own, print)


def driven(store: Map, engine: Now, progress: Progress | None = None, **options: Any) -> bool:
    where = Engine(engine, lambda: 2, lambda: "", lambda: None)
    return Drive(store, where, b"", progress or Progress(quiet=True), **options).run()


def row(cell: int, **values: float) -> Row:
    return Row({"stable": 1, **values}, state=(float(cell),), period=0.5)


def test_a_second_start_is_that_of_the_nearest_cell_whose_first_one_succeeded(tmp_path: Path) -> None:
    """Cells 4 to 6 fail at first; 5 is no neighbour for 6, though it is done when 6 is tried again."""

    def result(task: Task, attempt: int) -> Result:
        (cell,) = task.cells
        return Result(kind=FAILED, reason="no") if attempt == 1 and cell in (4, 5, 6) else Result((row(cell),))

    engine = Now(result)
    with stored(tmp_path, parse_scene(EQUILIBRIUM)) as store:
        assert driven(store, engine)
    assert [task.cells for task in engine.tasks] == [(k,) for k in (*range(10), 4, 5, 6)]
    again = {task.cells[0]: (task.neighbour, task.start, task.period) for task in engine.tasks[10:]}
    assert again == {4: (3, (3.0,), 0.5), 5: (3, (3.0,), 0.5), 6: (7, (7.0,), 0.5)}
    assert all(task.start == () for task in engine.tasks[:10])
    (tmp_path / "killed").mkdir()
    with stored(tmp_path / "killed", parse_scene(EQUILIBRIUM)) as store:
        tasks = list(store.grid.tasks(np.arange(10)))
        for task, attempt in [*((task, 1) for task in tasks), (tasks[4], 2), (tasks[5], 2)]:
            store.add(task, attempt, result(task, attempt))
        assert driven(store, engine)
    assert (engine.tasks[13].cells, engine.tasks[13].neighbour, len(engine.tasks)) == ((6,), 7, 14)


def test_what_another_run_may_not_meet_starts_where_the_scene_does(tmp_path: Path) -> None:
    engine = Now(lambda task, attempt: Result(kind=LATE) if task.cells == (4,) else Result((row(4),)))
    with stored(tmp_path, parse_scene(EQUILIBRIUM)) as store:
        assert driven(store, engine)
        assert (engine.tasks[-1].cells, engine.tasks[-1].start) == ((4,), ())
        assert store.final(np.array([4])).tolist() == [True]


def test_a_family_of_several_cells_may_take_the_time_of_all(tmp_path: Path) -> None:
    engine = Now(lambda task, attempt: Result(tuple(row(cell) for cell in task.cells)))
    with stored(tmp_path, parse_scene(TINY)) as store:
        assert driven(store, engine, cell_limit=3.0)
    assert [(len(task.cells), limit) for task, limit in zip(engine.tasks, engine.limits, strict=True)] == [(2, 6.0)] * 6


def test_a_map_is_refined_by_what_cells_are_in_the_end(tmp_path: Path) -> None:
    """A cell that fails at first is no change: only between 3 and 4, where stability does change, cells are added."""

    def result(task: Task, attempt: int) -> Result:
        (cell,) = task.cells
        return Result(kind=FAILED) if attempt == 1 and cell == 12 else Result((row(cell, stable=int(cell < 7)),))

    engine = Now(result)
    with stored(tmp_path, parse_scene(REFINED)) as store:
        assert driven(store, engine)
        assert store.complete
    assert sorted({task.cells[0] for task in engine.tasks}) == sorted({*range(0, 20, 2), 7} - {20})


@pytest.mark.parametrize("text", [EQUILIBRIUM, REFINED], ids=["plain", "refined"])
def test_a_map_with_a_cell_that_failed_once_is_not_complete(text: str, tmp_path: Path) -> None:
    with stored(tmp_path, parse_scene(text)) as store:
        first, *others = store.grid.tasks(store.grid.coarsest)
        for task in others:
            store.add(task, 2, Result(kind=FAILED))
        store.add(first, 1, Result(kind=FAILED))
    with stored(tmp_path, parse_scene(text)) as store:
        assert not store.complete
        store.add(first, 2, Result(kind=FAILED))
        assert store.complete


def test_shares_take_each_task_once_in_any_order_and_forget_their_own(tmp_path: Path) -> None:
    scene, taken = parse_scene(EQUILIBRIUM), []
    late = Now(lambda task, attempt: Result(kind=LATE) if task.cells == (3,) else Result((row(0),)))
    for k, done in ((3, False), (1, False), (2, True)):
        engine = late if k == 1 else Now(lambda task, attempt: Result((row(task.cells[0]),)))
        with stored(tmp_path, scene, f"journal_{k}_of_3.msgpack") as store:
            assert driven(store, engine, part=(k, 3)) is done
        taken += [task.cells[0] for task in engine.tasks]
    assert sorted(taken) == [0, 1, 2, 3, 3, 4, 5, 6, 7, 8, 9]  # who comes last tries again what failed
    with stored(tmp_path, scene, "journal_1_of_3.msgpack") as store:
        store._outside[:] = True
        store.forget_outside(mine=True)
        assert np.flatnonzero(store.states == 0).tolist() == [0, 6, 9]  # 3 is the last one's
        assert driven(store, late, part=(1, 3))
        assert [task.cells for task in late.tasks[-3:]] == [(0,), (6,), (9,)]


def test_what_is_left_is_estimated_from_what_cells_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]

    def result(task: Task, attempt: int) -> Result:
        clock[0] += 100.0
        return Result((row(task.cells[0]),))

    monkeypatch.setattr(driving.time, "monotonic", lambda: clock[0])
    said = Said()
    with stored(tmp_path, parse_scene(EQUILIBRIUM)) as store:
        assert driven(store, Now(result), said)
    assert said.words[0] == "1 of 10 cells; 0 failed; about 2.0 h left"  # 8 are handed over together
    assert said.words[-1] == "9 of 10 cells; 0 failed; about 111 s left"  # and the last one at the same time


def test_the_growth_that_counts_goes_to_the_cells(tmp_path: Path) -> None:
    text = TINY.replace("[accuracy]", "[stability]\n[accuracy]") + "growth = 0.25\n"
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    assert MapRun(tmp_path / "scene.toml", tmp_path).computer.growth == 0.25


@pytest.mark.parametrize(
    ("last", "reason"),
    [
        (Result((Row({"x": 1.0}, "it ended early"),)), "p = 9.0: it ended early"),
        (Result(kind=FAILED, reason="no such point"), "p = 9.0: no such point"),
        (None, "cells are missing; go on with --resume"),
    ],
)
def test_a_map_that_is_not_what_was_asked_for_has_status_1(
    last: Result | None, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = of_models(tmp_path, ["good"])
    scene.write_text(EQUILIBRIUM, encoding="utf-8")
    words = ["map", str(scene), "--out", str(tmp_path / "out"), "--no-pictures", "--collect"]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "scene.toml").write_text(
        f"# The scene of a run of casadi-skin, whose results are beside this file.\n{EQUILIBRIUM}", encoding="utf-8"
    )
    with stored(tmp_path / "out", parse_scene(EQUILIBRIUM)) as store:
        for task in store.grid.tasks(np.arange(9 if last is None else 10)):
            result = last if task.cells == (9,) else Result((row(task.cells[0]),))
            assert result is not None
            store.add(task, 2, result)
        before = store.directory.joinpath("journal.msgpack").read_bytes()
    assert main(words) == 1
    assert capsys.readouterr().err.splitlines()[-1] == f"{scene}: {reason}"
    assert (tmp_path / "out" / "journal.msgpack").read_bytes() == before  # nothing was computed


@pytest.mark.slow
def test_a_worker_that_ended_between_two_tasks_is_started_again(tmp_path: Path) -> None:
    """As one does that had no task for a minute: the cell is not recorded as lost."""
    path = of_models(tmp_path, ["good"])
    scene = parse_scene(path.read_text(encoding="utf-8"))
    grid, worker = Grid.of(scene), Worker()
    computer, task = pickle.dumps(Computer(plain(scene), str(path))), next(grid.tasks(grid.coarsest))
    results = []
    for _ in range(2):
        results.append(worker.compute(computer, task))
        assert worker.process is not None
        os.kill(worker.process.pid, signal.SIGKILL)
        worker.process.wait()
    assert [(result.kind, result.reason) for result in results] == [("", "")] * 2
    worker.end()


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 0.3, 3.0])
def test_a_pool_is_closed_at_once_while_its_workers_start(
    seconds: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after Ctrl-C: a worker that is ended before it has taken its task is not started again."""
    (tmp_path / "naps.py").write_text("import time\n\ndef nap(task, tell, stopped):\n    time.sleep(task)\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    import naps  # type: ignore[import-not-found]

    pool = Pool(2)
    ended = [pool.submit(in_worker, pickle.dumps(naps.nap), 20.0) for _ in range(3)]
    time.sleep(seconds)
    began = time.monotonic()
    pool.close()
    assert time.monotonic() - began < 10.0
    assert [future.cancelled() for future in ended] == [False, False, True]
    for future in ended[:2]:
        with pytest.raises(WorkerEndedError):
            future.result()
