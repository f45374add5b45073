"""A map of a scene: cells computed by an engine, each task tried twice, its result in the journal before anything else.

An engine is any executor of `concurrent.futures`; where it is lost, workers of this machine go on in its place.
"""

from __future__ import annotations

import errno
import math
import pickle
import re
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import file_path, in_words, needs_extra, short_repr, truth, whole
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.result import in_turn, renamed
from casadi_skin.runs.binding import bind
from casadi_skin.runs.directory import (
    JOURNAL_FILE,
    SCENE_FILE,
    DirectoryError,
    Existing,
    in_use,
    prepare,
)
from casadi_skin.runs.map_cell import (
    LOST,
    OUTSIDE_FAULTS,
    WATCHED,
    Computer,
    Result,
    Row,
    asked,
    check_quantities,
    compute,
)
from casadi_skin.runs.map_grid import UNKNOWN_LABEL, Axis, Cells, Grid, Task, needed, plain, scene_at
from casadi_skin.runs.map_lines import boundaries
from casadi_skin.runs.map_result import DONE, FAILED, MOST_ATTEMPTS, Map, compared
from casadi_skin.runs.output import Progress
from casadi_skin.runs.parts import origin
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import in_file
from casadi_skin.runs.scene import MapTable, Scene
from casadi_skin.solve.processes import Pool
from casadi_skin.solve.watch import one_thread, watched

TASKS_AHEAD = 3  # tasks a worker that are handed over before they are begun
ASSUMED_WORKERS = 64  # workers of an executor without a public number of workers
CONNECT_LIMIT = 10.0  # seconds until a scheduler answers
MOST_WORKERS = 256
ASK_SECONDS = 5.0  # seconds between two questions about the workers of a cluster
LOOK_SECONDS = 1.0  # seconds between two looks at an engine
SHOW_SECONDS = 0.2  # seconds between two changes of the line of progress
MEASURED_SECONDS = 10.0  # after which a plan gives up to measure the cost of cells
MEASURED_ORBITS = 64  # of a family at most, by which the cost of all of them is measured
SAME_VALUE_RTOL = 1e-6  # of a number of a cell that is computed again; processors differ by 1e-12
TELL_SECONDS = 30.0  # seconds between two lines of progress where there is no terminal
SHORT_CELL_SECONDS = 5.0  # seconds of a first cell, imports among them, below which it is measured again
SCHEDULER_ADDRESS = re.compile(r"inproc://\S+|(\w+://)?[^\s/]+:\d{1,5}")  # of a scheduler
Part = tuple[int, int]  # a share and the number of shares, the first being 1


# Engines --------------------------------------------------------------------------------------------------------------


@dataclass
class Engine:
    """An executor of tasks.

    Attributes:
        executor: the executor itself.
        workers: how many tasks it computes at the same time, queried repeatedly.
        lost: reason why it takes no more tasks; empty while it does.
        end: ends it.
        take_over: the engine that goes on where this one is lost for a reason.
    """

    executor: Executor
    workers: Callable[[], int]
    lost: Callable[[], str] = lambda: ""
    end: Callable[[], None] = lambda: None
    take_over: Callable[[str], Engine] | None = None

    def close(self) -> None:
        """End the executor, which may be gone already."""
        with interrupts_deferred(), suppress(Exception):
            self.end()

    def results(self, computer: bytes, tasks: Iterable[Task], limit: float | None) -> Iterator[tuple[Task, Result]]:
        """Tasks with their results as they end; a few at a time are handed over.

        Those under way on an engine that is lost have the reason as their result.
        """
        left, waiting = iter(tasks), dict[Future[Result], Task]()
        while True:
            room = (1 + TASKS_AHEAD) * max(self.workers(), 1) - len(waiting)
            for task in islice(left, max(room, 0)):  # workers that are gone leave more under way than there is room for
                waiting[self._submitted(computer, task, limit)] = task
                if self.lost():
                    break
            if not waiting:
                return
            ended, _ = wait(waiting, LOOK_SECONDS, FIRST_COMPLETED)
            reason = self.lost()
            for future in list(waiting) if reason else ended:
                yield waiting.pop(future), _outcome(future, reason)
            if reason and self.take_over is not None:
                self.close()
                vars(self).update(vars(self.take_over(reason)))  # from here on it is that engine

    def _submitted(self, computer: bytes, task: Task, limit: float | None) -> Future[Result]:
        try:
            return self.executor.submit(compute, computer, task, None if limit is None else limit * len(task.cells))
        except Exception as error:  # whatever an engine that is lost raises
            if not self.lost():
                raise
            future = Future[Result]()
            future.set_exception(error)
            return future


def _outcome(future: Future[Result], lost: str) -> Result:
    """The result of a task, or why the engine has none."""
    if not future.done():
        return Result(kind=LOST, reason=lost)
    try:
        return future.result()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # of an engine: cancelled, broken, a worker of it that was killed
        return Result(kind=LOST, reason=lost or f"the engine lost it: {in_words(error)}")


def local_engine(workers: int) -> Engine:
    """Worker processes on this machine."""
    pool = Pool(workers)
    return Engine(pool, lambda: workers, end=pool.close)


def dask_engine(address: str) -> Engine:
    """A dask cluster; raises ImportError, naming the extra, and OSError where no scheduler answers."""
    with needs_extra("dask", "cluster"):
        import distributed
    try:
        client: Any = distributed.Client(address, timeout=CONNECT_LIMIT, set_as_default=False)
    except OSError as error:
        words = f"no scheduler answers within {CONNECT_LIMIT:g} s ({in_words(error)})"
        raise OSError(errno.ETIMEDOUT, words, address) from None
    known, requested = 0, -math.inf

    def workers() -> int:
        nonlocal known, requested
        if time.monotonic() - requested > ASK_SECONDS:
            found: dict[str, Any] = client.scheduler_info(n_workers=-1).get("workers", {})
            known, requested = sum(int(worker.get("nthreads", 1)) for worker in found.values()), time.monotonic()
        return known

    def lost() -> str:
        return "" if client.status == "running" else f"the scheduler at {address} is lost"

    return Engine(client.get_executor(pure=False), workers, lost, lambda: client.close(timeout=1.0))


def given_engine(executor: Executor) -> Engine:
    """An executor of the caller, who ends it."""
    count, words = getattr(executor, "_max_workers", None), "the executor is broken"
    workers = count if isinstance(count, int) else ASSUMED_WORKERS
    return Engine(executor, lambda: workers, lambda: words if getattr(executor, "_broken", False) else "")


# A map of a scene from beginning to end: checked, computed by an engine, written --------------------------------------


@dataclass(eq=False)
class MapRun:
    """A map that is to be computed.

    Attributes:
        path: of the scene.
        directory: of the results.
        workers: processes on this machine.
        scheduler: address of a dask scheduler in their place.
        executor: an executor of the caller in their place.
        part: the share to compute here.
        collect: nothing is computed: the results of all shares are joined.
        existing: treatment of a directory that is not empty.
        pictures: whether pictures are drawn.
    """

    path: Path
    directory: Path
    workers: int = 1
    scheduler: str | None = None
    executor: Executor | None = None
    part: Part | None = None
    collect: bool = False
    existing: Existing = Existing.REFUSE
    pictures: bool = True

    @in_turn
    def __post_init__(self) -> None:
        """Read the scene and bind it to its model; raises SceneError, and for options as `_check_options`."""
        self._check_options()
        self.text = read_text(self.path)
        self.scene = parse_scene(self.text, str(self.path))
        with in_file(self.path):
            self.grid = Grid.of(self.scene)
            self.request = bind(self.scene, self.path)
            check_quantities(self.request, self.grid)
            named = [pair for pair in self.grid.settings(0) if pair[0][:2] == ("model", "parameters")]
            if named:  # names of the model's parameters
                bind(scene_at(plain(self.scene), named), self.path)

    def _check_options(self) -> None:
        """Raises ValueError and TypeError for options that are not accepted, or not together."""
        whole("workers", self.workers, 1, MOST_WORKERS)
        if not isinstance(self.executor, Executor | None):
            raise TypeError(f"executor: given {short_repr(self.executor)}; accepted: a concurrent.futures.Executor")
        if self.scheduler is not None:
            words = f"scheduler: given {short_repr(self.scheduler)}; accepted: an address, such as tcp://host:8786"
            if not isinstance(self.scheduler, str):
                raise TypeError(words)
            if not SCHEDULER_ADDRESS.fullmatch(self.scheduler):
                raise ValueError(words)
            if self.executor is not None:
                raise ValueError("executor: given beside scheduler; accepted: one of them")
        if self.part is not None:
            pair: Any = self.part if isinstance(self.part, tuple | list) and len(self.part) == 2 else ()
            whole_numbers = pair and all(isinstance(n, int) and not isinstance(n, bool) for n in pair)
            if not (whole_numbers and 1 <= pair[0] <= pair[1] <= 32767):
                given = "{}/{}".format(*pair) if whole_numbers else short_repr(self.part)
                raise ValueError(f"part: given {given}; accepted: K/N with 1 <= K <= N <= 32767, such as 3/20")
            if self.collect:
                raise ValueError("collect: given beside part; accepted: one of them")
        if self.shared and self.existing is Existing.OVERWRITE:
            beside = f"beside {'collect' if self.collect else 'part'}, whose directory holds other shares"
            raise ValueError(f"overwrite: given {beside}; accepted: one of them")

    @property
    def shared(self) -> bool:
        """Whether other processes may compute other shares in the directory at the same time."""
        return self.part is not None or self.collect

    @property
    def table(self) -> MapTable:
        """The table [map]."""
        assert self.scene.map is not None
        return self.scene.map

    @property
    def computer(self) -> Computer:
        """What computes tasks, in workers."""
        return Computer(plain(asked(self.scene, self.grid)), str(self.path.resolve()), self.table.growth)

    def execute(self, progress: Progress) -> Map:
        """Compute the missing cells and write the results; see `run_map`."""
        if self.collect and not (self.directory / SCENE_FILE).is_file():
            words = "holds no map to collect; accepted: the directory of a map that was begun"
            raise DirectoryError(f"{self.directory}: {words}")
        own = JOURNAL_FILE if self.part is None else "journal_{}_of_{}.msgpack".format(*self.part)
        with ExitStack() as held:
            held.enter_context(in_use(self.directory, progress.report, self.shared))
            if self.part is not None:
                held.enter_context(in_use(self.directory, progress.report, part=str(self.part[0])))
            engine = None if self.collect else held.enter_context(closing(self._engine(progress)))
            prepare(self.directory, self.request, self.text, Existing.SHARE if self.shared else self.existing)
            given = self.directory, self.grid, self.scene, None if self.collect else own, progress.report
            found = held.enter_context(Map(*given))
            if self.existing is Existing.RESUME:
                found.forget_outside(mine=self.part is not None)
                if engine is not None:
                    self._check_sample(found, engine)
            found.waits = True
            try:
                if engine is not None:
                    found.waits = not self._compute(found, engine, progress)
            finally:
                with interrupts_deferred():  # all files are written before an interruption ends the map
                    if engine is not None:
                        engine.close()
                    self._write(found, progress)
            return found

    def _check_sample(self, found: Map, engine: Engine) -> None:
        """Compute the cells again that stand out most; raises DirectoryError where they are others in the journal."""
        records = {record.cells: record for record in found.sample()}
        tasks = (task for cells in records for task in self.grid.tasks(np.array(cells)))
        for task, result in engine.results(pickle.dumps(self.computer), tasks, self.table.cell_limit):
            if result.kind in OUTSIDE_FAULTS:
                continue
            for i, (cell, row) in enumerate(zip(task.cells, records[task.cells].rows, strict=True)):
                again = Row({}, result.reason) if result.kind else result.rows[i]
                for name, value in row.values.items():
                    if not (isinstance(value, float) and compared(name)):
                        continue
                    size = float(np.nanmax(np.abs(found.columns.get(name, value))))
                    if not _same(value, again.values.get(name), size):
                        words = f"{self.grid.name(cell)}: {name} = {value!r}, computed again {again.values.get(name)}"
                        accepted = "accepted: journals as the map wrote them, or --overwrite"
                        raise DirectoryError(f"{self.directory}: {words}; {accepted}")

    def _engine(self, progress: Progress) -> Engine:
        def take_over(reason: str) -> Engine:
            progress.report(f"{reason}; {self.workers} worker(s) of this machine go on")
            return local_engine(self.workers)

        if self.executor is None and self.scheduler is None:
            return local_engine(self.workers)
        engine = given_engine(self.executor) if self.executor is not None else dask_engine(str(self.scheduler))
        return replace(engine, take_over=take_over)

    def _compute(self, found: Map, engine: Engine, progress: Progress) -> bool:
        """Compute the missing cells; False where the share of another part is still to come.

        A batch of cells follows from the results of those before it alone.
        """
        grid, data, computed, planned = found.grid, pickle.dumps(self.computer), 0, 0
        seen, began, shown, told = np.zeros(grid.shape, dtype=bool), time.monotonic(), -math.inf, time.monotonic()
        while (batch := needed(grid, np.where(seen, found.labels(), UNKNOWN_LABEL))).size:
            seen.flat[batch] = True
            planned += int(np.sum(~found.final(batch))) // (1 if self.part is None else self.part[1])
            for attempt, tasks in ((1, self._first(found, batch)), (MOST_ATTEMPTS, _again(found, batch, seen.ravel()))):
                for task, result in engine.results(data, tasks, self.table.cell_limit):
                    with interrupts_deferred():
                        found.add(task, attempt, result)
                    computed, now = computed + len(task.cells), time.monotonic()
                    if now - shown >= SHOW_SECONDS:
                        shown, seconds = now, (now - began) / computed * max(planned - computed, 0)
                        words = _progress_words(found, max(planned - computed, 0), seconds)
                        progress.say(words)
                        if not progress.on_terminal and now - told > TELL_SECONDS:
                            told = now
                            progress.report(words)
                found.refresh()
                if np.any(found.attempts[batch] == 0):
                    return False
        return True

    def _first(self, found: Map, batch: Cells) -> Iterator[Task]:
        """Tasks of one's own share that are not computed."""
        k, count = self.part or (1, 1)
        for task in islice(found.grid.tasks(batch), k - 1, None, count):
            if found.attempts[task.cells[0]] == 0:
                yield task

    @in_turn
    def _write(self, found: Map, progress: Progress) -> None:
        """Write tables and pictures, except for a share while others are still to come."""
        found.refresh()
        complete = found.complete
        found.waits = found.waits and not complete
        if not found.known or (found.waits and self.part is not None):
            return
        if self.table.boundary and complete:
            progress.say("following the boundary")
            with one_thread():
                found.write_boundary(boundaries(self.scene, self.path, found, progress.report))
        progress.say("writing tables and pictures")
        varied = {axis.name for axis in self.grid.axes}
        attributes = {name: v for name, v in origin(self.request, self.text).items() if name not in varied}
        found.write(attributes, self.scene.model is None, self.pictures)


def _same(value: float, again: Any, size: float) -> bool:
    """Whether a number was computed again, by any processor; `size` is the largest of its column."""
    return isinstance(again, float) and abs(value - again) <= SAME_VALUE_RTOL * max(abs(again), size)


def _again(found: Map, batch: Cells, seen: NDArray[np.bool_]) -> Iterator[Task]:
    """Tasks that failed once; one with a reason starts from the nearest neighbour's solution, where there is one.

    Neighbours are cells that were computed at their first attempt, so that all engines and resumed maps agree.
    """
    done = np.flatnonzero(seen & (found.states == DONE) & (found.attempts == 1))
    places = found.grid.places(done)
    for task in found.grid.tasks(batch, apart=True):
        cell = task.cells[0]
        if found.states[cell] == FAILED and found.attempts[cell] < MOST_ATTEMPTS:
            if done.size and not found.may_recover(cell):
                distances = np.abs(places - found.grid.places(np.array([cell]))).sum(axis=1)
                near = int(done[np.argmin(distances)])
                state, period = found.start(near)
                if state:
                    task = msgspec.structs.replace(task, start=state, period=period, neighbour=near)
            yield task


def _progress_words(found: Map, left: int, seconds: float) -> str:
    """The place of a map, the cells and the seconds that are left."""
    of = f", {left} to go before the next refinement" if found.grid.refined else f" of {found.grid.size}"
    known, failed = len(found.known), int(np.sum(found.states == FAILED))
    return f"{known}{of} cells; {failed} failed; about {duration(seconds)} left"


def duration(seconds: float) -> str:
    """A time in words."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.2g} s"


@renamed(out="path")
def run_map(
    scene: str | Path,
    path: str | Path | None = None,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    executor: Executor | None = None,
    part: Part | None = None,
    collect: bool = False,
    resume: bool = False,
    overwrite: bool = False,
    pictures: bool = True,
    quiet: bool = False,
) -> Map:
    """Compute the map of a scene with a table [map], cell by cell, and write its tables and pictures.

    Arguments:
        scene: path of the scene.
        path: directory of the results; results/NAME-OF-THE-SCENE unless given.
        workers: processes on this machine.
        scheduler: address of a dask scheduler, whose workers compute the cells; needs the extra `cluster`.
        executor: any `concurrent.futures.Executor`, which computes the cells.
        part: the share to compute here and the number of shares, such as (3, 20); the last process joins them.
        collect: whether the results of all shares are joined and nothing is computed.
        resume: whether to go on with a map that was begun; cells whose worker died or took too long are tried again.
        overwrite: whether the results of a run in the directory are replaced.
        pictures: whether a picture a quantity is drawn.
        quiet: whether no progress is shown.

    Returns:
        The map: values by name, status of cells, `complete` or not.

    Raises:
        ValueError, TypeError: the scene, a directory or an argument is wrong; the message names it.
        ImportError: dask is not installed.
        OSError: no scheduler answers, or a file cannot be written; computed cells are kept.
    """
    file = file_path("scene", scene)
    directory = Path("results") / file.stem if path is None else file_path("path", path)
    for name, value in (("collect", collect), ("resume", resume), ("overwrite", overwrite), ("pictures", pictures),
                        ("quiet", quiet)):  # fmt: skip
        truth(name, value)
    existing = Existing.RESUME if resume else Existing.OVERWRITE if overwrite else Existing.REFUSE
    mapping = MapRun(file, directory, workers, scheduler, executor, part, collect, existing, pictures)
    with Progress(quiet) as progress:
        return mapping.execute(progress)


# The plan of a map: the number of cells, the cost of one (measured now) and of all ------------------------------------


def map_lines(scene: Scene, request: Request, path: Path) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the map of a scene; raises SceneError for one that cannot be meant."""
    grid, table = Grid.of(scene), scene.map
    check_quantities(request, grid)
    assert table is not None
    cells = grid.coarsest
    families = grid.families(cells)
    middle = next(grid.tasks(cells[families == families[len(cells) // 2]]))
    tasks = len(cells) // len(middle.cells)
    computer = Computer(plain(asked(scene, grid)), str(path.resolve()), table.growth)
    chosen = np.linspace(0, len(middle.cells) - 1, min(len(middle.cells), MEASURED_ORBITS)).astype(int).tolist()
    given = {name: getattr(middle, name) for name in ("cells", "amplitudes", "values")}  # one a cell, or none
    some = {name: tuple(values[i] for i in chosen if values) for name, values in given.items()}
    few = msgspec.structs.replace(middle, **some)
    with watched(MEASURED_SECONDS):
        result = computer(few)
        if not result.kind and result.seconds < SHORT_CELL_SECONDS:
            result = computer(few)
    least = "more than " if (over := result.seconds >= MEASURED_SECONDS) else ""
    each = result.seconds / len(chosen)
    sizes = " x ".join(f"{len(range(0, len(axis.values), axis.stride))} {axis.name}" for axis in grid.axes)
    of_families = f", orbits of {tasks} families" if grid.amplitude is not None else ""
    quantities = ", ".join(table.watch or WATCHED)
    finest = f"; refined where {quantities} change, to {grid.size}" if grid.refined else ""
    unused = [f"[{name}]" for name in ("spectrum", "dynamics", "export") if getattr(scene, name) is not None]
    failed = f"; it failed: {result.reason}" if result.kind else ""
    failed = f", given up after {duration(result.seconds)}" if over else failed
    one = f"{least}{duration(each)} for one"
    words = f"{one} (measured on {grid.name(middle.cells[0])}{failed}); {least}{duration(each * cells.size)} for all"
    more = ", more where cells are refined" if grid.refined else ""
    limit = f"; at most {duration(table.cell_limit)} a cell" if table.cell_limit is not None else ""
    left_out = [("not in cells", f"{', '.join(unused)}, films and pictures of single cells")] if unused else []
    return [
        ("map", ", ".join(map(_axis_words, grid.axes))),
        ("cells", f"{sizes} = {cells.size}{of_families}{finest}"),
        *left_out,
        ("cost of cells", f"{words} with one worker{more}{limit}"),
    ]


def _axis_words(axis: Axis) -> str:
    first, last = axis.values[0], axis.values[-1]
    if not axis.numeric:
        shown = [str(value) for value in axis.values]
        return f"{axis.name} = {', '.join(shown if len(shown) < 8 else [*shown[:3], '...', shown[-1]])}"
    return f"{axis.name} from {first:g} to {last:g}{' in equal ratios' if axis.log else ''}"
