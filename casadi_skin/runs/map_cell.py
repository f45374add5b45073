"""Work of a worker on a task: the scene of its cells is made, bound and computed; nothing is written."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.results.branch_records import BranchRecord
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.map_grid import FAILED, Result, Row, Tables, Task, scene_at
from casadi_skin.runs.map_rows import Meanings, row_of_search, rows_of
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.solve.watch import one_thread


class Job(msgspec.Struct, frozen=True):
    """Data shared by all tasks of a map: the scene as plain values, the path of its file, and a growth that counts."""

    tables: Tables
    path: str
    growth: float = 0.0


@dataclass
class Computer:
    """Computes tasks of one job; a model's file is run once, so that its functions serve all cells."""

    job: Job
    _files: Files = field(default_factory=dict)

    def compute(self, task: Task) -> Result:
        """The rows of a task; a failure is kept in words."""
        started = time.perf_counter()
        try:
            with one_thread(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                rows, meanings = self._rows(task)
            return Result(tuple(rows), seconds=time.perf_counter() - started, meanings=dict(meanings))
        except (ArithmeticError, ValueError, TypeError, OSError) as error:
            reason = " ".join(str(error).split())
        except Exception as error:  # whatever a cell does, the map goes on
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return Result(kind=FAILED, reason=reason, seconds=time.perf_counter() - started)

    def _rows(self, task: Task) -> tuple[list[Row], Meanings]:
        scene = scene_at(self.job.tables, task.settings, task.amplitudes)
        request, meanings = self._request(started_at(scene, task)), Meanings()
        if scene.search is not None:
            return [row_of_search(_searched(request), meanings)], meanings
        branches, fault = followed(request)
        return rows_of(branches, fault, task.amplitudes, self.job.growth, meanings), meanings

    def _request(self, scene: Scene) -> Request:
        """The request of a scene; cells share the model that a file gives, with its functions."""
        return bind(scene, Path(self.job.path), self._files)


def started_at(scene: Scene, task: Task) -> Scene:
    """The scene, with the state of a neighbour's solution as the start of its own where the task has one."""
    if not task.start:
        return scene
    put = msgspec.structs.replace
    if scene.equilibrium is not None:
        return put(scene, equilibrium=put(scene.equilibrium, start=task.start, transient=None))
    if scene.orbit is not None:
        period = task.period if scene.orbit.cycles == 1 and task.period else None
        return put(scene, orbit=put(scene.orbit, start=task.start, transient=None, period=period))
    return scene


def _searched(request: Request) -> Any:
    from casadi_skin.optimise.search import search
    from casadi_skin.runs.tasks import family_search, search_table

    problem, table = family_search(request), search_table(request.scene)
    return search(problem, problem.starts(table.starts, table.seed), deflate=table.deflate)


@dataclass
class _Unkept:
    """The journal and the tables of a cell: none, as its row is all that is kept."""

    path: Path = Path()
    records: list[BranchRecord] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def append(self, record: BranchRecord) -> None:
        """Keep nothing."""

    def add(self, name: str, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Count rows."""
        self.counts[name] = self.counts.get(name, 0) + len(solutions)

    def count(self, name: str, space: SolutionSpace) -> int:
        """Rows of a branch."""
        return self.counts.get(name, 0)


def followed(request: Request) -> tuple[list[Branch], str]:
    """The branches of a scene, as a run follows them, and the failures beside them.

    Raises ArithmeticError where there is none.
    """
    nothing = _Unkept()
    followed = Branches(request, nothing, Progress(quiet=True))
    followed.follow(nothing)
    faults = "; ".join(followed.failures)
    if not any(len(branch) for branch in followed.branches):
        raise ArithmeticError(faults or "; ".join(branch.reason for branch in followed.branches))
    return followed.branches, faults
