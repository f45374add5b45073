"""Driving a map: batches of cells, each task tried twice, every result in the journal before anything else happens."""

from __future__ import annotations

import errno
import math
import pickle
import re
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import file_path, short_repr, truth, whole
from casadi_skin.model.files import replacing
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results.dataset import write_netcdf
from casadi_skin.runs.binding import bind
from casadi_skin.runs.directory import (
    JOURNAL_FILE,
    SCENE_FILE,
    SCENE_MODEL,
    DirectoryError,
    Existing,
    check_same_source,
    in_use,
    prepare,
    prepare_part,
)
from casadi_skin.runs.map_cell import Computer, Job, compute
from casadi_skin.runs.map_grid import FAILED as FAULT
from casadi_skin.runs.map_grid import LOST, Cells, Grid, Result, Task, needed, plain, scene_at
from casadi_skin.runs.map_grid import UNKNOWN_LABEL as UNLABELLED
from casadi_skin.runs.map_lines import BOUNDARY_FILE, OF_BOUNDARY, boundaries, check_boundary, write_boundary
from casadi_skin.runs.map_result import CSV, NETCDF, Map, map_dataset, write_pictures, write_table
from casadi_skin.runs.map_store import DONE, FAILED, MOST_ATTEMPTS, UNKNOWN, Columns, Store, check_quantities
from casadi_skin.runs.parts import origin
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import MapTable, Scene
from casadi_skin.solve.processes import Pool
from casadi_skin.solve.watch import one_thread

TASKS_AHEAD = 3  # tasks a worker that are handed over before they are begun
ASSUMED_WORKERS = 64  # workers of an executor without a public number of workers
CONNECT_LIMIT = 10.0  # seconds until a scheduler answers
MOST_WORKERS = 256
ASK_SECONDS = 5.0  # seconds between two questions about the workers of a cluster


@dataclass(frozen=True)
class Engine:
    """An executor of tasks.

    Attributes:
        executor: the executor itself.
        workers: how many tasks it computes at the same time, queried repeatedly.
        lost: reason why it takes no more tasks; empty while it does.
        close: ends it.
    """

    executor: Executor
    workers: Callable[[], int]
    lost: Callable[[], str]
    close: Callable[[], None]

    def width(self) -> int:
        """Number of tasks handed over at the same time."""
        return max(self.workers(), 1) + TASKS_AHEAD * max(self.workers(), 1)


def local_engine(workers: int) -> Engine:
    """Worker processes on this machine."""
    pool = Pool(workers)
    return Engine(pool, lambda: workers, lambda: "", pool.close)


def dask_engine(address: str) -> Engine:
    """A dask cluster; raises ImportError, naming the extra, and OSError where no scheduler answers."""
    try:
        import distributed
    except ImportError as error:
        raise ImportError(
            'dask is not installed; it comes with the extra: pip install "casadi-skin[cluster]"'
        ) from error
    try:
        client: Any = distributed.Client(address, timeout=CONNECT_LIMIT, set_as_default=False)
    except OSError as error:
        words = f"no scheduler answers within {CONNECT_LIMIT:g} s ({' '.join(str(error).split())})"
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
    """An executor of the caller, who ends it; raises TypeError for other objects."""
    if not isinstance(executor, Executor):
        raise TypeError(f"executor: given {short_repr(executor)}; accepted: a concurrent.futures.Executor")
    count = getattr(executor, "_max_workers", None)
    workers = count if isinstance(count, int) else ASSUMED_WORKERS

    def lost() -> str:
        return "the executor is broken" if getattr(executor, "_broken", False) else ""

    return Engine(executor, lambda: workers, lost, lambda: None)


LOOK_SECONDS = 1.0  # seconds between two looks at an engine
SHOW_SECONDS = 0.2  # seconds between two changes of the line of progress
TELL_SECONDS = 30.0  # seconds between two lines of progress where there is no terminal
Part = tuple[int, int]  # a share and the number of shares, the first being 1


@dataclass
class Drive:
    """A map on its way.

    Attributes:
        grid, store, engine: its cells, their results, the place of their computation.
        computer: the part that all tasks share, pickled.
        cell_limit: seconds that a cell may take.
        part: the share that is computed here; None of a map that is computed here as a whole.
        workers: processes of this machine that take over from a lost engine.
    """

    grid: Grid
    store: Store
    engine: Engine
    computer: bytes
    progress: Progress
    cell_limit: float | None = None
    part: Part | None = None
    workers: int = 1
    computed: int = 0
    _planned: int = 0
    _began: float = field(default_factory=time.monotonic)
    _told: float = field(default_factory=time.monotonic)
    _shown: float = -math.inf

    def run(self) -> bool:
        """Compute the missing cells; False where the share of another part is still to come."""
        seen = np.zeros(self.grid.size, dtype=bool)
        for batch in self._batches():
            seen[batch] = True
            self._planned += int(np.sum(~self.store.final(batch))) // (1 if self.part is None else self.part[1])
            self._compute(self._first(batch), 1)
            self.store.refresh()
            if np.any(self.store.attempts[batch] == 0):
                return False
            self._compute(self._again(batch, seen), MOST_ATTEMPTS)
        return True

    def _batches(self) -> Iterator[Cells]:
        """Cells to compute one batch after the other; a batch follows from the results of those before it alone."""
        if not self.grid.refined:
            yield self.grid.coarsest
            return
        shown = np.full(self.grid.shape, UNLABELLED, dtype=np.int32)
        while (batch := needed(self.grid, shown)).size:
            yield batch
            shown.flat[batch] = self.store.watch.labels.flat[batch]

    def _first(self, batch: Cells) -> Iterator[Task]:
        """Tasks of one's own share that are not computed."""
        for number, task in enumerate(self.grid.tasks(batch)):
            mine = self.part is None or number % self.part[1] == self.part[0] - 1
            if mine and self.store.attempts[task.cells[0]] == 0:
                yield task

    def _again(self, batch: Cells, seen: NDArray[np.bool_]) -> Iterator[Task]:
        """Tasks that failed once; one with a reason starts from the nearest neighbour's solution, where there is one.

        Neighbours are cells that were computed at their first attempt, so that all engines and resumed maps agree.
        """
        done = np.flatnonzero(seen & (self.store.states == DONE) & (self.store.attempts == 1))
        places = self.grid.places(done)
        for task in self.grid.tasks(batch):
            cell = task.cells[0]
            if self.store.states[cell] != FAILED or self.store.attempts[cell] >= MOST_ATTEMPTS:
                continue
            if self.store.record(cell).kind == FAULT and done.size:
                distances = np.abs(places - self.grid.places(np.array([cell]))).sum(axis=1)
                near = int(done[np.argmin(distances)])
                row = self.store.row(near)
                if row is not None and row.state:
                    task = msgspec.structs.replace(task, start=row.state, period=row.period, neighbour=near)
            yield task

    # Handing over -----------------------------------------------------------------------------------------------------

    def _compute(self, tasks: Iterable[Task], attempt: int) -> None:
        """Compute tasks, handed over a few at a time; where the engine is lost, workers of this machine take over."""
        left, waiting = iter(tasks), dict[Future[Result], Task]()
        while True:
            for task in islice(left, max(self.engine.width() - len(waiting), 0)):
                future = self._submitted(task)
                if future is None:
                    self._keep(task, Result(kind=LOST, reason=self.engine.lost() or "no engine took it"), attempt)
                    self._take_over(waiting, attempt)
                else:
                    waiting[future] = task
            if not waiting:
                return
            ended, _ = wait(waiting, LOOK_SECONDS, FIRST_COMPLETED)
            for future in ended:
                self._keep(waiting.pop(future), _outcome(future, self.engine), attempt)
            if self.engine.lost():
                self._take_over(waiting, attempt)
            self._show()

    def _submitted(self, task: Task) -> Future[Result] | None:
        limit = None if self.cell_limit is None else self.cell_limit * len(task.cells)
        try:
            return self.engine.executor.submit(compute, self.computer, task, limit)
        except Exception:  # whatever an engine that is lost raises
            if not self.engine.lost():
                raise
            return None

    def _take_over(self, waiting: dict[Future[Result], Task], attempt: int) -> None:
        """Record the tasks under way on a lost engine, and go on with workers of this machine."""
        reason = self.engine.lost() or "the engine is lost"
        for task in waiting.values():
            self._keep(task, Result(kind=LOST, reason=reason), attempt)
        waiting.clear()
        self.progress.report(f"{reason}; {self.workers} worker(s) of this machine go on")
        _closed(self.engine)
        self.engine = local_engine(self.workers)

    def _keep(self, task: Task, result: Result, attempt: int) -> None:
        with interrupts_deferred():
            self.store.add(task, attempt, result)
        self.computed += len(task.cells)

    def _show(self) -> None:
        """The place of the map, and an estimate of the remaining time."""
        now = time.monotonic()
        if now - self._shown < SHOW_SECONDS:
            return
        self._shown, failed = now, int(np.sum(self.store.states == FAILED))
        left = max(self._planned - self.computed, 0)
        seconds = (now - self._began) / max(self.computed, 1)
        known = int(np.sum(self.store.states != UNKNOWN))
        of = f" of {self.grid.coarsest.size}" if not self.grid.refined else f", {left} to go before the next refinement"
        words = f"{known}{of} cells; {failed} failed; about {duration(seconds * left)} left"
        self.progress.say(words)
        if not self.progress.on_terminal and now - self._told > TELL_SECONDS:
            self._told = now
            self.progress.report(words)


def _outcome(future: Future[Result], engine: Engine) -> Result:
    """The result of a task, or why the engine has none."""
    try:
        return future.result()
    except BaseException as error:  # of an engine: cancelled, broken, a worker of it that was killed
        if isinstance(error, KeyboardInterrupt):
            raise
        words = " ".join(str(error).split()) or type(error).__name__
        return Result(kind=LOST, reason=engine.lost() or f"the engine lost it: {words}")


def duration(seconds: float) -> str:
    """A time in words."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.2g} s"


# The plan of a map: the number of cells, the cost of one (measured now) and of all ------------------------------------

SHORT_CELL_SECONDS = 5.0  # seconds of a first cell, imports among them, below which it is measured again


def map_lines(scene: Scene, request: Request, path: Path) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the map of a scene; raises SceneError for one that cannot be meant."""
    grid, table = Grid.of(scene), scene.map
    check_quantities(request, grid)
    check_boundary(scene, grid)
    assert table is not None
    cells = grid.coarsest
    family = grid.family(int(cells[len(cells) // 2]))
    (middle,), tasks = grid.tasks(family), len(cells) // len(family)
    computer = Computer(Job(plain(scene), str(path.resolve()), table.growth))
    result = computer.compute(middle)
    if result.seconds < SHORT_CELL_SECONDS:
        result = computer.compute(middle)
    sizes = " x ".join(f"{len(range(0, len(axis.values), axis.stride))} {axis.name}" for axis in grid.axes)
    families = f", orbits of {tasks} families" if grid.amplitude is not None else ""
    finest = (
        f"; refined where {', '.join(table.watch or ('stable', 'end'))} change, to {grid.size}" if grid.refined else ""
    )
    lines = [
        ("map", ", ".join(_axis_words(grid, i) for i in range(len(grid.axes)))),
        ("cells", f"{sizes} = {cells.size}{families}{finest}"),
    ]
    one, all_of_them = result.seconds / len(middle.cells), result.seconds * tasks
    failed = f"; it failed: {result.reason}" if result.kind else ""
    words = (
        f"{duration(one)} for one (measured on {grid.name(middle.cells[0])}{failed}); {duration(all_of_them)} for all"
    )
    more = ", more where cells are refined" if grid.refined else ""
    limit = f"; at most {duration(table.cell_limit)} a cell" if table.cell_limit is not None else ""
    unused = [f"[{name}]" for name in ("spectrum", "dynamics", "export") if getattr(scene, name) is not None]
    if unused:
        lines.append(("not in cells", f"{', '.join(unused)}, films and pictures of single cells"))
    return [*lines, ("cost of cells", f"{words} with one worker{more}{limit}")]


def _axis_words(grid: Grid, place: int) -> str:
    axis = grid.axes[place]
    first, last = axis.values[0], axis.values[-1]
    if not axis.numeric:
        shown = [str(value) for value in axis.values]
        return f"{axis.name} = {', '.join(shown if len(shown) < 8 else [*shown[:3], '...', shown[-1]])}"
    return f"{axis.name} from {first:g} to {last:g}{' in equal ratios' if axis.log else ''}"


# A map of a scene from beginning to end: checked, computed by an engine, written --------------------------------------

SCHEDULER_ADDRESS = re.compile(r"inproc://\S+|(\w+://)?[^\s/]+:\d{1,5}")  # of a scheduler


@dataclass(frozen=True)
class Ways:
    """Choices for the computation of a map: where, and which part.

    Attributes:
        workers: processes on this machine.
        scheduler: address of a dask scheduler in their place.
        executor: an executor of the caller in their place.
        part: the share to compute here.
        collect: nothing is computed: the results of all shares are joined.
        existing: treatment of a directory that is not empty.
        pictures: whether pictures are drawn.
    """

    workers: int = 1
    scheduler: str | None = None
    executor: Executor | None = None
    part: Part | None = None
    collect: bool = False
    existing: Existing = Existing.REFUSE
    pictures: bool = True

    @property
    def shared(self) -> bool:
        """Whether other processes may compute other shares in the directory at the same time."""
        return self.part is not None or self.collect


@dataclass(frozen=True, eq=False)
class Mapped:
    """A scene that is to be mapped, bound to its model."""

    scene: Scene
    text: str
    path: Path
    request: Request
    grid: Grid

    @classmethod
    def of(cls, text: str, path: Path) -> Mapped:
        """The map in the text of a scene; raises SceneError that begins with its path."""
        scene = parse_scene(text, str(path))
        try:
            grid = Grid.of(scene)
            request = bind(scene, path)
            check_quantities(request, grid)
            check_boundary(scene, grid)
            named = [pair for pair in grid.settings(0) if pair[0][:2] == ("model", "parameters")]
            if named:  # names of the model's parameters
                bind(scene_at(plain(scene), named), path)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None
        return cls(scene, text, path, request, grid)

    @property
    def table(self) -> MapTable:
        """The table [map]."""
        assert self.scene.map is not None
        return self.scene.map

    @property
    def computer(self) -> Computer:
        """Data shared by all tasks."""
        return Computer(Job(plain(self.scene), str(self.path.resolve()), self.table.growth))


def run_map(
    scene: str | Path,
    out: str | Path | None = None,
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
        out: directory of the results; results/NAME-OF-THE-SCENE unless given.
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
    path = file_path("scene", scene)
    directory = Path("results") / path.stem if out is None else file_path("out", out)
    for name, value in (("collect", collect), ("resume", resume), ("overwrite", overwrite), ("pictures", pictures),
                        ("quiet", quiet)):  # fmt: skip
        truth(name, value)
    existing = Existing.RESUME if resume else Existing.OVERWRITE if overwrite else Existing.REFUSE
    ways = Ways(workers, scheduler, executor, part, collect, existing, pictures)
    check_ways(ways)
    mapped = Mapped.of(read_text(path), path)
    with Progress(quiet) as progress:
        return compute_map(mapped, directory, ways, progress)


def check_ways(ways: Ways) -> None:
    """Raises ValueError and TypeError for choices that are not accepted, or not together."""
    whole("workers", ways.workers, 1, MOST_WORKERS)
    if ways.executor is not None:
        given_engine(ways.executor)
    if ways.scheduler is not None:
        words = f"scheduler: given {short_repr(ways.scheduler)}; accepted: an address, such as tcp://host:8786"
        if not isinstance(ways.scheduler, str):
            raise TypeError(words)
        if not SCHEDULER_ADDRESS.fullmatch(ways.scheduler):
            raise ValueError(words)
    given = [name for name in ("scheduler", "executor") if getattr(ways, name) is not None]
    if len(given) > 1:
        raise ValueError("executor: given beside scheduler; accepted: one of them")
    if ways.part is not None:
        pair = ways.part if isinstance(ways.part, tuple | list) and len(ways.part) == 2 else None
        numbers = pair is not None and all(isinstance(n, int) and not isinstance(n, bool) for n in pair)
        if pair is None or not numbers or not 1 <= pair[0] <= pair[1] <= 32767:
            raise ValueError(f"part: given {short_repr(ways.part)}; accepted: K/N with 1 <= K <= N <= 32767")
        if ways.collect:
            raise ValueError("collect: given beside part; accepted: one of them")
    if ways.shared and ways.existing is Existing.OVERWRITE:
        word = "collect" if ways.collect else "part"
        raise ValueError(f"overwrite: given beside {word}, whose directory holds other shares; accepted: one of them")


def compute_map(mapped: Mapped, directory: Path, ways: Ways, progress: Progress) -> Map:
    """Compute the missing cells of a map and write the results; see `run_map`."""
    if ways.collect and not (directory / SCENE_FILE).is_file():
        raise DirectoryError(f"{directory}: holds no map to collect; accepted: the directory of a map that was begun")
    own = JOURNAL_FILE if ways.part is None else "journal_{}_of_{}.msgpack".format(*ways.part)
    with ExitStack() as held:
        held.enter_context(in_use(directory, progress.report, ways.shared))
        if ways.part is not None:
            held.enter_context(in_use(directory, progress.report, part=str(ways.part[0])))
        engine = None if ways.collect else _engine(ways)
        if engine is not None:
            held.callback(_closed, engine)
        _prepare(mapped, directory, ways)
        arguments = directory, mapped.grid, mapped.scene, None if ways.collect else own, progress.report
        store = held.enter_context(Store(*arguments))
        if ways.existing is Existing.RESUME:
            store.forget_outside(mine=ways.part is not None)
        waits = True
        try:
            if engine is not None:
                data, limit = pickle.dumps(mapped.computer), mapped.table.cell_limit
                drive = Drive(mapped.grid, store, engine, data, progress, limit, ways.part, ways.workers)
                try:
                    waits = not drive.run()
                finally:
                    _closed(drive.engine)
        finally:
            with interrupts_deferred():  # all files are written before an interruption ends the map
                found = _written(mapped, store, waits, ways, progress)
        return found


def _prepare(mapped: Mapped, directory: Path, ways: Ways) -> None:
    request = mapped.request
    if request.path is not None and (ways.shared or ways.existing is Existing.RESUME):
        check_same_source(directory, request.path, request.source)
    if ways.shared:
        prepare_part(directory, mapped.scene, mapped.text)
    else:
        prepare(directory, mapped.scene, mapped.text, ways.existing)
    if request.path is not None:
        with replacing(directory / f"{SCENE_MODEL}{request.path.suffix}") as temporary:
            temporary.write_text(request.source, encoding="utf-8")


def _engine(ways: Ways) -> Engine:
    if ways.executor is not None:
        return given_engine(ways.executor)
    return local_engine(ways.workers) if ways.scheduler is None else dask_engine(ways.scheduler)


def _closed(engine: Engine) -> None:
    with interrupts_deferred(), suppress(Exception):  # of an engine that is gone already
        engine.close()


def _written(mapped: Mapped, store: Store, waits: bool, ways: Ways, progress: Progress) -> Map:
    """The map with its tables and pictures written, except for a share while others are still to come."""
    store.refresh()
    complete = store.complete
    columns = Columns(store, mapped.table.quantities)
    found = Map(store.directory, columns, complete, waits and not complete)
    if not np.any(store.states != UNKNOWN) or (found.waits and ways.part is not None):
        return found
    if mapped.table.boundary and complete:
        progress.say("following the boundary")
        with one_thread():
            lines = boundaries(
                mapped.scene, mapped.path, plain(mapped.scene), Columns(store, OF_BOUNDARY), progress.report
            )
        write_boundary(lines, mapped.grid, store.directory / BOUNDARY_FILE)
        found = replace(found, boundary=lines)
    progress.say("writing tables and pictures")
    write_table(columns, store.directory / CSV)
    varied = {axis.name for axis in mapped.grid.axes}
    attributes = {name: v for name, v in origin(mapped.request, mapped.text).items() if name not in varied}
    write_netcdf(store.directory / NETCDF, map_dataset(columns, attributes, mapped.scene.model is None))
    if ways.pictures:
        write_pictures(found)
    return found
