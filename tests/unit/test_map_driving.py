"""A map by an executor that takes no time: which tasks it is given, when, and what is said of what is left."""

from __future__ import annotations

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maps import EQUILIBRIUM as REST
from maps import TINY, Now, row, write

from casadi_skin.runs import map as driving
from casadi_skin.runs.map import Engine, MapRun
from casadi_skin.runs.map_cell import FAILED, LATE, Computer, Result, Row
from casadi_skin.runs.map_grid import Grid, Task, plain
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.output import Progress
from casadi_skin.runs.program import main
from casadi_skin.runs.reading import parse_scene
from casadi_skin.solve.processes import Pool, Worker, WorkerEndedError, in_worker

EQUILIBRIUM = REST + "[map]\np = { from = 0.0, to = 9.0, points = 10 }\n"
REFINED = EQUILIBRIUM.replace("points = 10 }", "points = 10, resolution = 0.5 }") + 'watch = ["stable"]\n'


def begun(folder: Path, text: str, results: Callable[[Task], Result], cells: int, attempt: int = 2) -> None:
    """The directory of a map whose first cells are in its journal."""
    scene, out = parse_scene(text), folder / "out"
    out.mkdir(parents=True)
    head = "# The scene of a run of casadi-skin, whose results are beside this file.\n"
    (out / "scene.toml").write_text(head + text, encoding="utf-8")
    (out / "scene_model.py").write_text(write(folder, text).with_name("models.py").read_text(encoding="utf-8"))
    with Map(out, Grid.of(scene), scene, "journal.msgpack", print) as found:
        for task in found.grid.tasks(np.arange(cells)):
            found.add(task, attempt, results(task))


def test_a_second_start_is_that_of_the_nearest_cell_whose_first_one_succeeded(tmp_path: Path) -> None:
    """Cells 4 to 6 fail at first; 5 is no neighbour for 6, though it is done when 6 is tried again."""

    def result(task: Task, attempt: int) -> Result:
        (cell,) = task.cells
        return Result(kind=FAILED, reason="no") if attempt == 1 and cell in (4, 5, 6) else Result((row(cell),))

    engine = Now(result)
    assert engine.map(tmp_path, EQUILIBRIUM).complete
    assert engine.cells == [*range(10), 4, 5, 6]
    again = {task.cells[0]: (task.neighbour, task.start, task.period) for task in engine.tasks[10:]}
    assert again == {4: (3, (3.0,), 0.5), 5: (3, (3.0,), 0.5), 6: (7, (7.0,), 0.5)}
    assert all(task.start == () for task in engine.tasks[:10])
    begun(tmp_path / "killed", EQUILIBRIUM, lambda task: result(task, 1), 10, attempt=1)
    assert engine.map(tmp_path / "killed", EQUILIBRIUM, resume=True).complete
    assert [(task.cells[0], task.neighbour) for task in engine.tasks[13:]] == [(4, 3), (5, 3), (6, 7)]


def test_what_another_run_may_not_meet_starts_where_the_scene_does(tmp_path: Path) -> None:
    engine = Now(lambda task, attempt: Result(kind=LATE) if task.cells == (4,) else Result((row(4),)))
    assert engine.map(tmp_path, EQUILIBRIUM).complete
    assert (engine.cells[10:], engine.tasks[-1].start) == ([4], ())


def test_workers_that_are_lost_leave_more_tasks_under_way_than_the_others_have_room_for() -> None:
    """Two workers get eight tasks; one is gone when the first ends: nothing is handed over until four have ended."""
    handed, counts = list[Future[Result]](), iter([2, *[1] * 20])

    class Later(Now):
        def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
            handed.append(Future())
            return handed[-1]

    found = Engine(Later(), lambda: next(counts)).results(b"", [Task((k,), ()) for k in range(12)], None)
    for k in range(12):
        if len(handed) == k:  # the first are handed over when a result is asked for
            threading.Timer(0.05, lambda: handed[0].set_result(Result((row(0),)))).start()
        else:
            handed[k].set_result(Result((row(k),)))
        next(found)
        assert len(handed) == min(max(8, k + 4), 12)
    assert next(found, None) is None


def test_a_family_of_several_cells_may_take_the_time_of_all(tmp_path: Path) -> None:
    engine = Now()
    engine.map(tmp_path, TINY + "cell_limit = 3.0\n")
    assert [(len(task.cells), limit) for task, limit in zip(engine.tasks, engine.limits, strict=True)] == [(2, 6.0)] * 6


def test_a_map_is_refined_by_what_cells_are_in_the_end(tmp_path: Path) -> None:
    """A cell that fails at first is no change: only between 3 and 4, where stability does change, cells are added."""

    def result(task: Task, attempt: int) -> Result:
        (cell,) = task.cells
        return Result(kind=FAILED) if attempt == 1 and cell == 12 else Result((row(cell, stable=int(cell < 7)),))

    engine = Now(result)
    assert engine.map(tmp_path, REFINED).complete
    assert set(engine.cells) == {*range(0, 20, 2), 7}


@pytest.mark.parametrize("text", [EQUILIBRIUM, REFINED], ids=["plain", "refined"])
def test_a_cell_that_failed_once_is_tried_again_and_one_that_failed_twice_is_not(text: str, tmp_path: Path) -> None:
    engine = Now(lambda task, attempt: Result(kind=FAILED))
    for attempt, cells in ((1, list(range(0, 20, 2)) if text == REFINED else list(range(10))), (2, [])):
        folder, scene = tmp_path / str(attempt), parse_scene(text)
        begun(folder, text, lambda task: Result(kind=FAILED), 0)
        with Map(folder / "out", Grid.of(scene), scene, "journal.msgpack", print) as found:
            for task in found.grid.tasks(found.grid.coarsest):
                found.add(task, attempt, Result(kind=FAILED))
            assert found.complete is (attempt == 2)
        engine.tasks.clear()
        assert engine.map(folder, text, resume=True).complete
        assert engine.cells == cells


def test_shares_take_each_task_once_in_any_order_and_forget_their_own(tmp_path: Path) -> None:
    late, taken = Now(lambda task, attempt: Result(kind=LATE) if task.cells == (3,) else Result((row(0),))), list[int]()
    for k, done in ((3, False), (1, False), (2, True)):
        engine = late if k == 1 else Now()
        found = engine.map(tmp_path, EQUILIBRIUM, part=(k, 3))
        assert (found.complete, found.waits) == (done, not done)
        taken += engine.cells
    assert sorted(taken) == [0, 1, 2, 3, 3, 4, 5, 6, 7, 8, 9]  # who comes last tries again what failed
    for k, cells in ((3, []), (2, [])):  # the last one has computed it
        engine = Now()
        assert engine.map(tmp_path, EQUILIBRIUM, part=(k, 3), resume=True).complete
        assert engine.cells == cells


class Said(Progress):
    """Keeps what is said."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.words = list[str]()

    def say(self, words: str) -> None:
        self.words.append(words)


def test_what_is_left_is_estimated_from_what_cells_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]

    def result(task: Task, attempt: int) -> Result:
        clock[0] += 100.0
        return Result((row(task.cells[0]),))

    monkeypatch.setattr(driving.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(driving, "ASSUMED_WORKERS", 2)
    said = Said()
    MapRun(write(tmp_path, EQUILIBRIUM), tmp_path / "out", executor=Now(result), pictures=False).execute(said)
    assert said.words[:2] == [  # 8 are handed over together, and the last two
        "1 of 10 cells; 0 failed; about 2.0 h left", "9 of 10 cells; 0 failed; about 111 s left",
    ]  # fmt: skip


def test_the_growth_that_counts_goes_to_the_cells(tmp_path: Path) -> None:
    text = TINY.replace("[accuracy]", "[stability]\n[accuracy]") + "growth = 0.25\n"
    assert MapRun(write(tmp_path, text), tmp_path / "out").computer.growth == 0.25


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
    begun(
        tmp_path, EQUILIBRIUM, lambda task: last if last and task.cells == (9,) else Result((row(0),)), 10 - (not last)
    )
    scene, journal = tmp_path / "scene.toml", tmp_path / "out" / "journal.msgpack"
    before = journal.read_bytes()
    assert main(["map", str(scene), "--out", str(tmp_path / "out"), "--no-pictures", "--collect"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == f"{scene}: {reason}"
    assert journal.read_bytes() == before  # nothing was computed


@pytest.mark.slow
def test_a_worker_that_ended_between_two_tasks_is_started_again(tmp_path: Path) -> None:
    """As one does that had no task for a minute: the cell is not recorded as lost."""
    path = write(tmp_path, EQUILIBRIUM)
    scene, worker = parse_scene(EQUILIBRIUM), Worker()
    grid, computer = Grid.of(scene), pickle.dumps(Computer(plain(scene), str(path)))
    for _ in range(2):
        result = worker.compute(computer, next(grid.tasks(grid.coarsest)))
        assert (result.kind, result.reason) == ("", "")
        os.kill(worker.process.pid, signal.SIGKILL)
        worker.process.wait()
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
