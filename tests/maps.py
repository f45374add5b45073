"""Small maps: a chain of two sites, and models that sleep, hang, end their process or fail."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import msgspec
from scenes import chain, family, table

from casadi_skin import run_map
from casadi_skin.results.store import read_records
from casadi_skin.runs.map_cell import Result, Row
from casadi_skin.runs.map_grid import Task
from casadi_skin.runs.map_result import Map, MapRecord, TaskRecord

TINY = (
    chain(2)
    + family(1, 0.1)
    + """[accuracy]
tolerance = 1e-4
[map]
gamma = { from = 0.1, to = 0.3, points = 3 }
S = { from = 0.05, to = 0.1, points = 2 }
mode = [1, 2]
"""
)
MODELS = """
import os, time
from pathlib import Path
import casadi as ca
from casadi_skin import OdeModel
x, p = ca.SX.sym("x"), ca.SX.sym("p")
good = OdeModel("good", x, p - x, p, nominal=(0.3,))

def slow():
    mark = Path(__file__).parent / f"computes_{os.getpid()}"
    mark.touch()
    time.sleep(0.4)
    mark.unlink()
    return good

slow_0 = slow_1 = slow_2 = slow_3 = slow_4 = slow_5 = slow

def hangs():
    time.sleep(1000.0)

def dies():
    os.kill(os.getpid(), 9)

def dies_once():
    marker = Path(__file__).parent / "marker"
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), 9)
    return good

def fails():
    raise RuntimeError("never")
"""
EQUILIBRIUM = table("model", file="models.py", name="good") + table("equilibrium", start=[0.1])
OF_MODELS = EQUILIBRIUM + '[map]\n"model.name" = NAMES\n'
SLOW = ["good", *(f"slow_{k}" for k in range(6))]


def write(folder: Path, text: str) -> Path:
    """A scene in a folder of its own, with the models beside it."""
    folder.mkdir(exist_ok=True)
    (folder / "models.py").write_text(MODELS, encoding="utf-8")
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def of_models(folder: Path, names: list[str], more: str = "") -> Path:
    """A scene that maps models by name."""
    return write(folder, OF_MODELS.replace("NAMES", str(names)) + more)


def row(cell: int, **values: float) -> Row:
    return Row({"stable": 1, **values}, state=(float(cell),), period=0.5)


class Now(Executor):
    """Computes a task at once by a function of it and of the number of the attempt; keeps tasks and limits."""

    def __init__(self, result: Callable[[Task, int], Result] | None = None) -> None:
        self.result = result or (lambda task, attempt: Result(tuple(row(cell) for cell in task.cells)))
        self.tasks, self.limits, self.attempts = list[Task](), list[float | None](), dict[tuple[int, ...], int]()

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        _, task, limit = given
        self.attempts[task.cells] = self.attempts.get(task.cells, 0) + 1
        self.tasks.append(task)
        self.limits.append(limit)
        future: Future[Any] = Future()
        future.set_result(self.result(task, self.attempts[task.cells]))
        return future

    @property
    def cells(self) -> list[int]:
        """The first cell of each task."""
        return [task.cells[0] for task in self.tasks]

    def map(self, folder: Path, text: str, **options: Any) -> Map:  # type: ignore[override]
        """The map of a scene in a folder, by this executor."""
        return run_map(write(folder, text), folder / "out", executor=self, pictures=False, quiet=True, **options)


def tasks(path: Path) -> list[TaskRecord]:
    """Tasks in a journal."""
    if not path.exists():
        return []
    records, _, _ = read_records(path.read_bytes(), msgspec.msgpack.Decoder(MapRecord))
    return [record for record in records if isinstance(record, TaskRecord)]


def files(directory: Path) -> tuple[bytes, bytes]:
    """The tables of a map."""
    return (directory / "map.nc").read_bytes(), (directory / "map.csv").read_bytes()


def command(*words: object) -> subprocess.Popen[str]:
    """casadi-skin with these words, started."""
    given = [sys.executable, "-m", "casadi_skin", *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": f"{Path(__file__).parents[1]}:{os.environ.get('PYTHONPATH', '')}"}
    pipe = subprocess.PIPE
    return subprocess.Popen(given, stdout=pipe, stderr=pipe, text=True, env=environment)


def workers_of(process: int) -> list[int]:
    """Worker processes that a process has started."""
    found = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        for child in task.read_text(encoding="ascii").split():
            if b"casadi_skin.solve.processes" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(int(child))
    return found


def is_running(process: int) -> bool:
    """Whether a process is there, and no zombie."""
    try:
        return ") Z " not in Path(f"/proc/{process}/stat").read_text(encoding="ascii")
    except OSError:
        return False


def until(holds: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until something holds; raises AssertionError where it does not in time."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)
