"""Work of a worker on a task: the scene of its cells is made, bound and computed; nothing is written."""

from __future__ import annotations

import math
import os
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.optimise.search import SearchResult
from casadi_skin.results.branch_records import BranchRecord
from casadi_skin.results.quantities import Place, columns_of, csv_row
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.map_grid import DIED, FAILED, LATE, Result, Row, Tables, Task, Value, scene_at
from casadi_skin.runs.map_store import LEFT_OUT, plain_kind
from casadi_skin.runs.parts import mode_of
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.solve.processes import WorkerEndedError, in_worker
from casadi_skin.solve.watch import one_thread

# The result of a cell as a row of named quantities: its solution, its special points, and its end ---------------------


class Meanings(dict[str, str]):
    """Meanings of quantities by name, filled as rows are made."""

    def named(self, pairs: Iterator[tuple[str, Any, str]], suffix: str = "") -> dict[str, Value]:
        """Values by name, those that are not finite left out; their meanings are kept."""
        found: dict[str, Value] = {}
        for name, value, meaning in pairs:
            self.setdefault(name + suffix, meaning)
            if isinstance(value, str):
                found[name + suffix] = value
            elif math.isfinite(value):
                found[name + suffix] = int(value) if isinstance(value, int | np.integer | np.bool_) else float(value)
        return found


def rows_of(
    branches: Sequence[Branch], fault: str, amplitudes: Sequence[float], growth: float, meanings: Meanings
) -> list[Row]:
    """Rows of a cell's branches: one at their ends, or one for each amplitude of its families.

    `fault` is the reason of a failure beside the branches.
    """
    rows = []
    for S in amplitudes or (None,):
        values: dict[str, Value] = {}
        faults = [fault] if fault else []
        for number, branch in enumerate(branches):
            several = sum(b.space.is_family for b in branches) > 1
            suffix = f"_j{mode_of(branch)}" if several else f"_{number + 1}" if number else ""
            solution, reason = _solution(branch, S)
            faults += [reason] if reason else []
            if solution is not None:
                values |= meanings.named(_of_solution(branch, solution), suffix)
            values |= meanings.named(_of_branch(branch, growth), suffix)
        rows.append(Row(values, "; ".join(faults), *_start(branches)))
    return rows


def _solution(branch: Branch, S: float | None) -> tuple[Solution | None, str]:
    """The solution of a cell, and the reason where it is not the requested one."""
    if not len(branch):
        return None, branch.reason
    if S is None:
        return branch.solutions[-1], "" if branch.complete else branch.reason
    found = next((o for o in branch.orbits if S in (o.exact.get("S"), o.S) and o.point.requested), None)
    if found is None:
        with suppress(ValueError, ArithmeticError):
            return branch.at(S=S), ""
    return found, "" if found is not None else branch.reason


def _of_solution(branch: Branch, solution: Solution) -> Iterator[tuple[str, Any, str]]:
    quantities = [q for q in columns_of(branch) if q.name not in LEFT_OUT]
    mode = mode_of(branch) if branch.space.is_family else 0
    row = csv_row(quantities, Place(solution, 0, mode))
    meanings = {q.name: q.meaning for q in quantities}
    for name, value in row.items():
        if value != "":
            yield name, value, meanings[name]


def _of_branch(branch: Branch, growth: float) -> Iterator[tuple[str, Any, str]]:
    """Special points of a branch, and how it ended."""
    if len(branch) > 1:
        yield from _instabilities(branch, growth)
        yield from _special(branch)
        yield "points", len(branch), "points of the branch"
    if branch.threshold is not None:
        yield "threshold", branch.threshold, "S at which the end breather of the infinite chain is born"
    yield "end", _end(branch), "why the branch ended, in a word"
    yield "end_reason", branch.reason, "why the branch ended"


def _end(branch: Branch) -> str:
    return "stopped" if branch.stopped else "missed" if branch.end is None else branch.end.name.lower()


CHANGES_MEANING = "changes of stability along the branch; where stretches are unresolved, at least so many"


def _instabilities(branch: Branch, growth: float) -> Iterator[tuple[str, Any, str]]:
    if branch.stability_diagram is not None:
        first = branch.stability_diagram.first_instability(growth)
        deep = f", by a growth of {growth:g} or more" if growth else ""
        if first is not None:
            yield "first_instability", first.start.S, f"S at which the family first becomes unstable{deep}"
            yield "first_instability_error", first.start.S_error, "its estimated absolute error"
            modes = "" if first.modes is None else f", modes {first.modes[0]} + {first.modes[1]}, order {first.order}"
            yield "first_tongue", f"{first.kind}{modes}", "kind of the first instability, and the modes that meet there"
        yield "unresolved", len(branch.unresolved), "stretches on which changes of stability may be missing"
        yield "changes", len(branch.changes), CHANGES_MEANING
    elif branch.localised_diagram is not None:
        lost = branch.localised_diagram.first_loss
        if lost is not None:
            yield "first_instability", lost.S, "S at which the family first becomes unstable"
            yield "first_instability_error", lost.S_error, "its estimated absolute error"
            yield "first_tongue", lost.kind, "kind of the first instability, and the modes that meet there"
        yield "unresolved", len(branch.unresolved), "stretches on which changes of stability may be missing"
        yield "changes", len(branch.changes), CHANGES_MEANING
    elif branch.with_events and not branch.space.stability_included:
        change = next((c for c in branch.located if not c.stable_after), None)
        where, error = (math.nan, math.nan) if change is None else (change.value, change.error)
        yield "first_instability", where, f"{branch.parameter} at which stability is first lost along the branch"
        yield "first_instability_error", error, "its estimated absolute error"
        yield "changes", len(branch.located), CHANGES_MEANING


def _special(branch: Branch) -> Iterator[tuple[str, Any, str]]:
    """The first special point of each kind, and how many there are."""
    if branch.space.is_family:
        return
    points = branch.special_points
    if branch.diagram_of_changes is None:
        yield "unresolved", len(branch.unresolved), "stretches on which special points may be missing"
    for kind in dict.fromkeys(point.kind for point in points):
        mine, name = [point for point in points if point.kind == kind], plain_kind(kind)
        first, parameter = mine[0], branch.parameter
        yield f"{name}_count", len(mine), f"special points of the kind {kind} on the branch"
        yield f"first_{name}", first.parameters[parameter], f"{parameter} at the first {kind} of the branch"
        yield f"first_{name}_error", first.error, "its estimated absolute error"


def _start(branches: Sequence[Branch]) -> tuple[tuple[float, ...], float]:
    """State and period of the first solution of a branch that is no family: where a neighbour may start."""
    first = branches[0] if branches else None
    if first is None or not len(first) or first.space.is_family:
        return (), 0.0
    solution = first.solutions[0]
    state = solution.evaluate(solution.interval[0])
    return tuple(state.tolist()), solution.period if solution.is_orbit else 0.0


def row_of_search(result: SearchResult, meanings: Meanings) -> Row:
    """The row of a search: its best optimum, and how it ended."""

    def pairs() -> Iterator[tuple[str, Any, str]]:
        if result.found:
            best = result.best
            yield "objective", best.objective, "the objective at the best optimum"
            numbers: Mapping[str, float] = best.parameters
            for name, value in numbers.items():
                yield name, value, f"{name} of the best optimum"
            yield "Omega", best.Omega, "frequency of the best optimum"
        yield "optima", len(result.optima), "distinct optima found"
        yield "end", result.status.name.lower(), "how the search ended, in a word"
        yield "end_reason", result.reason, "how the search ended"

    return Row(meanings.named(pairs()), "" if result.found else result.reason)


class Job(msgspec.Struct, frozen=True):
    """Data shared by all tasks of a map: the scene as plain values, the path of its file, and a growth that counts."""

    tables: Tables
    path: str
    growth: float = 0.0


LOADED_MODULES = (  # before the first cell, whose time is limited
    "casadi_skin.follow.series",
    "casadi_skin.lattice.chain_coordinates",
    "casadi_skin.follow.family_changes",
    "casadi_skin.runs.first_solution",
    "casadi_skin.solve.ipopt",
    "casadi_skin.stability.splitting",
)


@dataclass
class Computer:
    """Computes tasks of one job; a model's file is run once, so that its functions serve all cells."""

    job: Job
    _files: Files = field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        return _computer_of_worker, (self.job,)

    def __call__(self, task: Task, *_: object) -> Result:
        """The rows of a task, in a worker."""
        return self.compute(task)

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
            from casadi_skin.runs.tasks import Search

            return [row_of_search(Search(request).searched(), meanings)], meanings
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


def _computer_of_worker(job: Job) -> Computer:
    """The computer in a worker, where nobody reads what a model prints."""
    nowhere = open(os.devnull, "w")  # noqa: SIM115  as long as the process
    os.dup2(nowhere.fileno(), 1)
    sys.stdout = sys.stderr = nowhere
    for name in LOADED_MODULES:
        import_module(name)
    return Computer(job)


def compute(computer: bytes, task: Task, limit: float | None) -> Result:
    """The result of a task, computed by the worker of this thread: the function that every engine runs."""
    started = time.perf_counter()
    try:
        found: Result = in_worker(computer, task, limit)
        return found
    except TimeoutError as error:
        kind, reason = LATE, str(error)
    except WorkerEndedError as error:
        kind, reason = DIED, str(error)
    return Result(kind=kind, reason=reason, seconds=time.perf_counter() - started)


@dataclass
class _Unkept:
    """The journal of a cell: none, as its row is all that is kept."""

    path: Path = Path()
    records: list[BranchRecord] = field(default_factory=list)

    def append(self, record: BranchRecord) -> None:
        """Keep nothing."""


def followed(request: Request) -> tuple[list[Branch], str]:
    """The branches of a scene, as a run follows them, and the failures beside them.

    Raises ArithmeticError where there is none.
    """
    followed = Branches(request, Progress(quiet=True))
    followed.follow(_Unkept())
    faults = "; ".join(followed.failures)
    if not any(len(branch) for branch in followed.branches):
        raise ArithmeticError(faults or "; ".join(branch.reason for branch in followed.branches))
    return followed.branches, faults
