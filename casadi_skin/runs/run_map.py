"""A map of a scene from beginning to end: checked, computed by an engine, written."""

from __future__ import annotations

import re
from concurrent.futures import Executor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from casadi_skin.model.arguments import file_path, short_repr, truth
from casadi_skin.model.files import replacing
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.runs.binding import bind
from casadi_skin.runs.directory import (
    JOURNAL,
    SCENE,
    SCENE_MODEL,
    DirectoryError,
    Existing,
    check_same_source,
    in_use,
    prepare,
    prepare_part,
)
from casadi_skin.runs.faults import SceneError
from casadi_skin.runs.map_cell import Job
from casadi_skin.runs.map_drive import Drive, Engine, Part, check_workers, dask_engine, given_engine, local_engine
from casadi_skin.runs.map_grid import Grid, plain, scene_at
from casadi_skin.runs.map_lines import BOUNDARY, OF_BOUNDARY, boundaries, check_boundary, write_boundary
from casadi_skin.runs.map_pictures import write_pictures
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.map_store import UNKNOWN, Columns, Store, check_quantities
from casadi_skin.runs.map_writing import CSV, NETCDF, write_map, write_table
from casadi_skin.runs.origins import origin
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.scene_tables import MapTable
from casadi_skin.solve.watch import one_thread

ADDRESS = re.compile(r"inproc://\S+|(\w+://)?[^\s/]+:\d{1,5}")  # of a scheduler


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
    def job(self) -> Job:
        """Data shared by all tasks."""
        return Job(plain(self.scene), str(self.path.resolve()), self.table.growth)


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
    check_workers("workers", ways.workers)
    if ways.executor is not None:
        given_engine(ways.executor)
    if ways.scheduler is not None:
        words = f"scheduler: given {short_repr(ways.scheduler)}; accepted: an address, such as tcp://host:8786"
        if not isinstance(ways.scheduler, str):
            raise TypeError(words)
        if not ADDRESS.fullmatch(ways.scheduler):
            raise ValueError(words)
    given = [name for name in ("scheduler", "executor") if getattr(ways, name) is not None]
    if len(given) > 1:
        raise ValueError("executor: given beside scheduler; accepted: one of them")
    if ways.part is not None:
        pair = ways.part if isinstance(ways.part, tuple | list) and len(ways.part) == 2 else None
        whole = pair is not None and all(isinstance(n, int) and not isinstance(n, bool) for n in pair)
        if pair is None or not whole or not 1 <= pair[0] <= pair[1] <= 32767:
            raise ValueError(f"part: given {short_repr(ways.part)}; accepted: K/N with 1 <= K <= N <= 32767")
        if ways.collect:
            raise ValueError("collect: given beside part; accepted: one of them")
    if ways.shared and ways.existing is Existing.OVERWRITE:
        word = "collect" if ways.collect else "part"
        raise ValueError(f"overwrite: given beside {word}, whose directory holds other shares; accepted: one of them")


def compute_map(mapped: Mapped, directory: Path, ways: Ways, progress: Progress) -> Map:
    """Compute the missing cells of a map and write the results; see `run_map`."""
    own = None if ways.collect else journal_name(ways.part)
    if ways.collect and not (directory / SCENE).is_file():
        raise DirectoryError(f"{directory}: holds no map to collect; accepted: the directory of a map that was begun")
    with ExitStack() as held:
        held.enter_context(in_use(directory, progress.report, ways.shared))
        if ways.part is not None:
            held.enter_context(in_use(directory, progress.report, part=str(ways.part[0])))
        engine = None if ways.collect else _engine(ways)
        try:
            _prepare(mapped, directory, ways)
            store = Store(directory, mapped.grid, mapped.scene, own, progress.report)
        except BaseException:
            _closed(engine)
            raise
        with store:
            return _computed(mapped, store, engine, ways, progress)


def journal_name(part: Part | None) -> str:
    """The journal of a map, or of a share of it."""
    return JOURNAL if part is None else f"journal_{part[0]}_of_{part[1]}.msgpack"


def _computed(mapped: Mapped, store: Store, engine: Engine | None, ways: Ways, progress: Progress) -> Map:
    if ways.existing is Existing.RESUME:
        store.forget_outside(mine=ways.part is not None)
    waits = True
    try:
        waits = engine is None or not _driven(mapped, store, engine, ways, progress)
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


def _closed(engine: Engine | None) -> None:
    if engine is not None:
        with interrupts_deferred(), suppress(Exception):  # of an engine that is gone already
            engine.close()


def _driven(mapped: Mapped, store: Store, engine: Engine, ways: Ways, progress: Progress) -> bool:
    """Compute the missing cells; False where other shares are still to come."""
    drive = Drive(
        mapped.grid, store, engine, msgspec.msgpack.encode(mapped.job), progress, mapped.table.cell_limit,
        ways.part, ways.workers,
    )  # fmt: skip
    try:
        return drive.run()
    finally:
        _closed(drive.engine)


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
        write_boundary(lines, mapped.grid, store.directory / BOUNDARY)
        found = replace(found, boundary=lines)
    progress.say("writing tables and pictures")
    write_table(columns, store.directory / CSV)
    varied = {axis.name for axis in mapped.grid.axes}
    attributes = {name: v for name, v in origin(mapped.request, mapped.text).items() if name not in varied}
    write_map(columns, store.directory / NETCDF, attributes, mapped.scene.model is None)
    if ways.pictures:
        write_pictures(found)
    return found
