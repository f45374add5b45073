"""Work of a worker on a task: the scene of its cells is made, bound and computed; nothing is written.

The result of a cell is a row of quantities: those of the table of quantities at its last solution, its special points,
and how it ended; the names that the cells of a scene may have are known before one is computed.
"""

from __future__ import annotations

import math
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.model.arguments import in_words
from casadi_skin.model.result import in_turn
from casadi_skin.points.edges import parameters_of
from casadi_skin.points.gradient import Gradient, NoGradientError
from casadi_skin.results.quantities import (
    FAMILY_ERRORS,
    FAMILY_PROOFS,
    FAMILY_QUANTITIES,
    FAMILY_STABILITY,
    FIXED,
    FIXED_AT_REST,
    Place,
    columns_of,
    csv_row,
)
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.first_solution import first_solution
from casadi_skin.runs.map_grid import Grid, Tables, Task, scene_at
from casadi_skin.runs.output import Progress
from casadi_skin.runs.parts import mode_of
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError, check_known
from casadi_skin.runs.scene import Scene
from casadi_skin.search.design import Design
from casadi_skin.search.designs import best_design
from casadi_skin.solve.processes import WorkerEndedError, in_worker
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.kinds import KINDS

Value = float | int | str
Named = Iterator[tuple[str, Any, str]]  # names, values and meanings of quantities
FAILED, DIED, LATE, LOST = "failed", "died", "late", "lost"  # kinds of faults; a computation reports the first itself
OUTSIDE_FAULTS = (DIED, LATE, LOST)  # those that another run may not meet
FAULTS = ("", FAILED, *OUTSIDE_FAULTS)
SAME_ORBIT_RTOL = 1e-6  # of periods and largest values: the orbit of a branch is that of a cell's own start
UNIT_MULTIPLIER_ATOL = 1e-4
WATCHED = ("stable", "end")  # quantities where whose changes a map is refined unless it names others
TEXTS = ("end", "end_reason", "first_tongue", "regime")  # quantities that are words


class Row(msgspec.Struct, frozen=True):
    """Quantities of a cell by name, unknown ones left out.

    Attributes:
        values: by name.
        fault: why the cell has no solution; empty where it has one.
        state, period: of a solution at which a second start of a neighbour may begin.
    """

    values: dict[str, Value]
    fault: str = ""
    state: tuple[float, ...] = ()
    period: float = 0.0


class Result(msgspec.Struct, frozen=True):
    """Result of a task: a row for each of its cells, or the reason and kind of its failure."""

    rows: tuple[Row, ...] = ()
    kind: str = ""
    reason: str = ""
    seconds: float = 0.0
    meanings: dict[str, str] = {}


# Quantities of cells, and their names before a cell is computed -------------------------------------------------------

BY = "_by_"  # in names of derivatives, of what by what
OF_ALL = ("points", "end", "end_reason")
STABILITY = ("first_instability", "first_instability_error", "first_tongue", "unresolved", "changes")
LEFT_OUT = ("point", "requested", "special", "fold")  # marks of a place along a branch
FAMILY_SUFFIX = re.compile(r"_(j?\d+)$")  # of a family or a branch among several
ERROR_MEANING = "its estimated absolute error"


def known_names(request: Request) -> tuple[str, ...]:
    """Names of quantities without the suffix that distinguishes several branches."""
    scene = request.scene
    if scene.design is not None:
        return ("value", "value_error", "optima", "found", "end_reason", "Omega", "S", *scene.design.over)
    if scene.family is not None:
        tables = (FAMILY_QUANTITIES, FAMILY_STABILITY, FAMILY_ERRORS, FAMILY_PROOFS)
        names = [quantity.name for table in tables for quantity in table]
        moves = _moves(["first_instability", "threshold"], request)
        return (*names, "regime", "threshold", *STABILITY, *moves, *OF_ALL)
    ode = request.ode
    special = [name for kind in KINDS for name in _special_names(kind)]
    special += _moves(special[1::3], request)  # of the first ones
    extremes = [f"{name}_{end}" for name in ode.state_names for end in ("min", "max")]
    energy = ["energy"] if scene.orbit is not None and ode.hamiltonian is not None else []
    fixed = (*(FIXED_AT_REST if scene.equilibrium is not None else FIXED), *energy)
    states = request.equations.state_names
    found = dict.fromkeys((*request.parameters, *states, *extremes, *fixed, *STABILITY, *special, *OF_ALL))
    return tuple(name for name in found if name not in LEFT_OUT)


def _moves(located: Iterable[str], request: Request) -> list[str]:
    """Names of derivatives of located values and their errors, where the scene asks for them."""
    parts = product(located, request.parameters, ("", "_error")) if request.scene.with_gradient else ()
    return [f"{name}{BY}{parameter}{end}" for name, parameter, end in parts]


def check_quantities(request: Request, grid: Grid) -> None:
    """Raises SceneError for a quantity that [map] names and that no cell can have."""
    table = request.scene.map
    known = [name for name in known_names(request) if name not in [axis.name for axis in grid.axes]]
    for key in ("quantities", "watch"):
        for name in getattr(table, key) or ():
            if FAMILY_SUFFIX.sub("", name) not in known:
                check_known(f"[map] {key}", name, known)
    if table is not None and table.growth and "first_instability" not in known:
        raise SceneError("[map] growth: given without a quantity first_instability; accepted: beside a [family]")


def asked(scene: Scene, grid: Grid) -> Scene:
    """The scene without what no wanted quantity of a family needs: changes of stability, multipliers, proofs."""
    table, put = scene.map, msgspec.structs.replace
    if scene.family is None or scene.continuation is not None or table is None or table.quantities is None:
        return scene
    wanted = (*table.quantities, *((table.watch or WATCHED) if grid.refined else ()))
    names, moves = {FAMILY_SUFFIX.sub("", n).split(BY)[0] for n in wanted}, any(BY in n for n in wanted)
    stability, accuracy = scene.stability, scene.accuracy
    if stability is not None and not (table.boundary or names & {*STABILITY, *OF_ALL}):
        stability = put(stability, events=False) if moves or names & {q.name for q in FAMILY_STABILITY} else None
    if not names & {quantity.name for quantity in FAMILY_PROOFS}:
        accuracy = put(accuracy, certify=False)
    return put(scene, stability=stability, accuracy=accuracy)


def rows_of(
    branches: Sequence[Branch], fault: str, amplitudes: Sequence[float], growth: float, meanings: dict[str, str],
    gradient: bool = False,
) -> Iterator[Row]:  # fmt: skip
    """Rows of a cell's branches: one at their ends, or one for each amplitude of its families.

    `fault` is the reason of a failure beside the branches; `meanings` of quantities by name are added to; with
    `gradient` the derivatives of located values are among them.
    """
    several = sum(branch.space.is_family for branch in branches) > 1
    for S in amplitudes or (None,):
        values, faults = dict[str, Value](), [fault]
        failed = faults if gradient else None
        for number, branch in enumerate(branches):
            suffix = f"_j{mode_of(branch)}" if several else f"_{number + 1}" if number else ""
            solution, reason = _solution(branch, S)
            faults.append(reason)
            if solution is not None:
                values |= _kept(_of_solution(branch, solution), meanings, suffix)
            values |= _kept(_of_branch(branch, growth, failed), meanings, suffix)
        yield Row(values, "; ".join(filter(None, faults)), *_start(branches))


def _kept(quantities: Named, meanings: dict[str, str], suffix: str = "") -> dict[str, Value]:
    """Values by name, those that are not finite left out."""
    found: dict[str, Value] = {}
    for name, value, meaning in quantities:
        meanings.setdefault(name + suffix, meaning)
        if isinstance(value, str):
            found[name + suffix] = value
        elif math.isfinite(value):
            found[name + suffix] = int(value) if isinstance(value, int | np.integer | np.bool_) else float(value)
    return found


def _solution(branch: Branch, S: float | None) -> tuple[Solution | None, str]:
    """The solution of a cell, and the reason where it is not the requested one."""
    if not len(branch):
        return None, branch.reason
    if S is None:
        return branch.solutions[-1], "" if branch.complete else branch.reason
    found = next((o for o in branch.orbits if S in (o.exact.get("S"), o.S) and o.point.requested), None)
    if found is None:
        try:
            return branch.at(S=S), ""
        except (ValueError, ArithmeticError) as error:
            return None, f"S = {S:g}: {error}" if branch.complete else branch.reason
    return found, ""


def _of_solution(branch: Branch, solution: Solution) -> Named:
    quantities = [q for q in columns_of(branch) if q.name not in LEFT_OUT]
    row = csv_row(quantities, Place(solution, 0, mode_of(branch) if branch.space.is_family else 0))
    return ((q.name, row[q.name], q.meaning) for q in quantities if row[q.name] != "")


def _of_branch(branch: Branch, growth: float, failed: list[str] | None) -> Named:
    """Special points of a branch, and how it ended; with derivatives where there is a list for why some have failed."""
    if len(branch) > 1:
        yield from _instabilities(branch, growth, failed)
        yield from _special(branch, failed)
        yield "points", len(branch), "points of the branch"
    if branch.threshold is not None:
        yield "threshold", branch.threshold, "S at which the end breather of the infinite chain is born"
        if failed is not None:
            chain = branch.space.coordinates.chain
            yield from _derivatives("threshold", chain.threshold_gradient, chain.parameters, failed)
    end = "stopped" if branch.stopped else "missed" if branch.end is None else branch.end.name.lower()
    yield "end", end, "why the branch ended, in a word"
    yield "end_reason", branch.reason, "why the branch ended"


def _derivatives(name: str, gradient: Callable[[], Gradient], parameters: Iterable[str], failed: list[str]) -> Named:
    """Derivatives of a located value by all parameters, NaN where they fail; none of a kind that has none."""
    try:
        slopes, errors = (found := gradient()).slopes, found.errors
    except NoGradientError:
        return
    except (ValueError, ArithmeticError) as error:
        failed.append(f"derivatives of {name}: {error}")
        slopes = errors = dict.fromkeys(parameters, math.nan)
    for parameter, slope in slopes.items():
        yield f"{name}{BY}{parameter}", slope, f"derivative of {name} by {parameter}"
        yield f"{name}{BY}{parameter}_error", errors[parameter], ERROR_MEANING


def _instabilities(branch: Branch, growth: float, failed: list[str] | None) -> Named:
    """The first instability, of a family with the tongue or the localised multiplier, and the count of changes."""
    diagram, S, error, tongue = branch.diagram_of_changes, math.nan, math.nan, ""
    if diagram is not None and branch.stability_diagram is None:
        if (edge := diagram.first_loss) is not None:
            S, error, tongue = edge.S, edge.S_error, edge.kind
    elif diagram is not None:
        if (first := diagram.first_instability(growth)) is not None:
            modes = "" if first.modes is None else f", modes {first.modes[0]} + {first.modes[1]}, order {first.order}"
            S, error, tongue = first.start.S, first.start.S_error, first.kind + modes
            if failed is not None and S in (places := [each.value for each in branch.changes]):
                of_edge: Any = lambda: branch.edge(places.index(S)).gradient()  # noqa: E731
                yield from _derivatives("first_instability", of_edge, parameters_of(branch.space), failed)
    elif branch.with_events and not branch.space.stability_included:
        if (change := next((c for c in branch.located if not c.stable_after), None)) is not None:
            S, error = change.value, change.error
    else:
        return
    deep = f", by a growth of {growth:g} or more" if growth and branch.stability_diagram is not None else ""
    where = f"{branch.parameter} at which stability is first lost along the branch"
    meaning = where if diagram is None else f"S at which the family first becomes unstable{deep}"
    yield "first_instability", S, meaning
    yield "first_instability_error", error, ERROR_MEANING
    if tongue:
        yield "first_tongue", tongue, "kind of the first instability, and the modes that meet there"
    if diagram is not None:
        yield "unresolved", len(branch.unresolved), "stretches on which changes of stability may be missing"
    words = "changes of stability along the branch; where stretches are unresolved, at least so many"
    yield "changes", len(branch.changes), words


def _special_names(kind: str) -> tuple[str, str, str]:
    """Names of the number of special points of a kind, of the first one, and of its error."""
    name = kind.replace(" ", "_").replace("-", "_")
    return f"{name}_count", f"first_{name}", f"first_{name}_error"


def _special(branch: Branch, failed: list[str] | None) -> Named:
    """The first special point of each kind, and how many there are."""
    if branch.space.is_family:
        return
    points, parameter = branch.special_points, branch.parameter
    if branch.diagram_of_changes is None:
        yield "unresolved", len(branch.unresolved), "stretches on which special points may be missing"
    for kind in dict.fromkeys(point.kind for point in points):
        mine, (count, first, error) = [point for point in points if point.kind == kind], _special_names(kind)
        yield count, len(mine), f"special points of the kind {kind} on the branch"
        yield first, mine[0].parameters[parameter], f"{parameter} at the first {kind} of the branch"
        yield error, mine[0].error, ERROR_MEANING
        if failed is not None:
            others = [other for other in branch.space.model.parameter_names if other != parameter]
            yield from _derivatives(first, mine[0].gradient, others, failed)


def _start(branches: Iterable[Branch]) -> tuple[tuple[float, ...], float]:
    """State and period of the first solution of a branch that is no family: where a neighbour may start."""
    first = next(iter(branches), None)
    if first is None or not len(first) or first.space.is_family:
        return (), 0.0
    solution = first.solutions[0]
    state = solution.evaluate(solution.interval[0])
    return tuple(state.tolist()), solution.period if solution.is_orbit else 0.0


def _of_design(design: Design) -> Named:
    """Quantities of a design: the best optimum, and how it ended."""
    if design.found:
        yield "value", design.value, "what is optimised, at the best design"
        yield "value_error", design.error, ERROR_MEANING
        for name, value in design.parameters.items():
            yield name, value, f"{name} of the best design"
        for name in ("Omega", "S"):
            if name in design.quantities[0] and name not in design.parameters:
                yield name, design.quantities[0][name], f"{name} of the orbit there"
    yield "optima", (1 + len(design.others)) * design.found, "distinct optima found"
    yield "found", int(design.found), "1 where there is an optimum"
    yield "end_reason", design.reason, "how the search ended"


# Computing ------------------------------------------------------------------------------------------------------------

LOADED_MODULES = (  # before the first cell, whose time is limited
    "casadi_skin.follow.series",
    "casadi_skin.lattice.chain_coordinates",
    "casadi_skin.follow.family_changes",
    "casadi_skin.runs.first_solution",
    "casadi_skin.solve.ipopt",
    "casadi_skin.stability.flows",
)


@dataclass
class Computer:
    """Computes tasks of one map; a model's file is run once, so that its functions serve all cells.

    Attributes:
        tables: the scene as plain values.
        path: of its file.
        growth: of an instability that counts.
    """

    tables: Tables
    path: str
    growth: float = 0.0
    _files: Files = field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        return _computer_of_worker, (self.tables, self.path, self.growth)

    @in_turn
    def __call__(self, task: Task, *_: object) -> Result:
        """The rows of a task; a failure is kept in words."""
        started = time.perf_counter()
        try:
            with one_thread(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                rows, meanings = self._rows(task)
            return Result(tuple(rows), seconds=time.perf_counter() - started, meanings=meanings)
        except (ArithmeticError, ValueError, TypeError, OSError) as error:
            reason = in_words(error)
        except Exception as error:  # whatever a cell does, the map goes on
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return Result(kind=FAILED, reason=reason, seconds=time.perf_counter() - started)

    def _rows(self, task: Task) -> tuple[list[Row], dict[str, str]]:
        meanings = dict[str, str]()
        if task.checked and len(task.values) > 1:
            return Served(partial(self._request, task), task.along, task.values, meanings).rows, meanings
        scene = scene_at(self.tables, task.settings, task.amplitudes)
        request = bind(started_at(scene, task), Path(self.path), self._files)
        if scene.design is not None:
            problem, table = request.designed(), scene.design
            result = best_design(problem, problem.places(table.starts, table.seed), request.tolerance)
            return [Row(_kept(_of_design(result), meanings), "" if result.found else result.reason)], meanings
        if len(task.values) > 1:
            return list(served(request, task.along, task.values, meanings)), meanings
        branches, fault = followed(request)
        return list(rows_of(branches, fault, task.amplitudes, self.growth, meanings, scene.with_gradient)), meanings

    def _request(self, task: Task, value: float) -> Request:
        """The scene of the cell at a value of the parameter that a task goes along."""
        settings = [(path, value if path[-1] == task.along else other) for path, other in task.settings]
        return bind(scene_at(self.tables, settings), Path(self.path), self._files)


@dataclass
class Served:
    """Rows of orbits at values of a parameter: a branch serves those between two whose own starts lead to it.

    Where it does not join these two, or has orbits between them that do not attract while they do, the stretch is
    halved, and the cell there has its own start.
    """

    request: Callable[[float], Request]
    name: str
    values: Sequence[float]
    meanings: dict[str, str]
    solutions: dict[int, Solution] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)

    @property
    def rows(self) -> list[Row]:
        last = len(self.values) - 1
        self._own(0)
        self._own(last)
        self._between(0, last)
        return [self._row(k) for k in range(last + 1)]

    def _own(self, k: int) -> None:
        try:
            self.solutions[k] = first_solution(self.request(self.values[k]))
        except (ArithmeticError, ValueError) as error:
            self.faults[k] = in_words(error)

    def _between(self, i: int, j: int) -> None:
        if j - i < 2:
            return
        if i in self.solutions and j in self.solutions and (found := self._joining(i, j)) is not None:
            self.solutions |= dict(zip(range(i + 1, j), found, strict=True))
            return
        self._own(k := (i + j) // 2)
        self._between(i, k)
        self._between(k, j)

    def _joining(self, i: int, j: int) -> list[Solution] | None:
        """Solutions between two cells on a branch from the first that comes to the second; None where it does not."""
        wanted, end = self.values[i + 1 : j + 1], self.solutions[j]
        try:
            branch = self.solutions[i].follow(self.name, wanted[-1], at=wanted[:-1], events=False)
        except (ArithmeticError, ValueError):
            return None
        found = [s for s in branch.solutions[1:] if s.point.requested or s is branch.solutions[-1]]
        if [s.parameters[self.name] for s in found] != list(wanted):
            return None
        (*inner, last), names = found, [q for q in columns_of(branch) if q.name.endswith(("period", "_min", "_max"))]
        one, other = (csv_row(names, Place(solution, 0, 0)) for solution in (last, end))
        same = all(math.isclose(float(one[q.name]), float(other[q.name]), rel_tol=SAME_ORBIT_RTOL) for q in names)
        if same and _attracts(last):
            same = all(map(_attracts, inner))
        return inner if same else None

    def _row(self, k: int) -> Row:
        if k not in self.solutions:
            return Row({}, self.faults[k])
        return _row_alone(self.request(self.values[k]), self.solutions[k], self.meanings)


def _row_alone(request: Request, solution: Solution, meanings: dict[str, str]) -> Row:
    """The row of a cell that has this solution alone."""
    (row,) = rows_of([Branches(request, Progress(quiet=True)).alone(solution)], "", (), 0.0, meanings)
    return row


def _attracts(orbit: Solution) -> bool:
    """Whether no multiplier of an orbit is outside the circle, by more than that of its velocity is off."""
    return bool(np.max(np.abs(orbit.space.multipliers_alone(orbit.point).multipliers)) <= 1.0 + UNIT_MULTIPLIER_ATOL)


def served(request: Request, name: str, values: Sequence[float], meanings: dict[str, str]) -> Iterator[Row]:
    """Rows of the solutions at values of a parameter, where the branch from that at the first of them passes first."""
    first = first_solution(request)
    branch = first.follow(name, values[-1], at=values[1:], events=False)
    passed = [solution for solution in branch.solutions if solution.point.requested]
    found = {solution.parameters[name]: solution for solution in (*passed[::-1], first)}  # the first at each value
    words = f"the branch from {name} = {values[0]:g} has no solution there: {branch.reason}"
    for value in values:
        row = _row_alone(request, found[value], meanings) if value in found else Row({}, words)
        kept = {key: number for key, number in row.values.items() if key not in request.parameters}
        yield msgspec.structs.replace(row, values=kept)


def started_at(scene: Scene, task: Task) -> Scene:
    """The scene, with the state of a neighbour's solution as the start of its own where the task has one."""
    put = msgspec.structs.replace
    if task.start and scene.equilibrium is not None:
        return put(scene, equilibrium=put(scene.equilibrium, start=task.start, transient=None))
    if task.start and scene.orbit is not None:
        period = task.period if scene.orbit.cycles == 1 and task.period else None
        return put(scene, orbit=put(scene.orbit, start=task.start, transient=None, period=period))
    return scene


def _computer_of_worker(*arguments: Any) -> Computer:
    """The computer in a worker, where nobody reads what a model prints."""
    nowhere = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  as long as the process
    os.dup2(nowhere.fileno(), 1)
    sys.stdout = sys.stderr = nowhere
    for name in LOADED_MODULES:
        import_module(name)
    return Computer(*arguments)


def compute(computer: bytes, task: Task, limit: float | None) -> Result:
    """The result of a task, computed by the worker of this thread: the function that every engine runs."""
    started = time.perf_counter()
    try:
        found: Result = in_worker(computer, task, limit)
        return found
    except (TimeoutError, WorkerEndedError) as error:
        kind = LATE if isinstance(error, TimeoutError) else DIED
        return Result(kind=kind, reason=str(error), seconds=time.perf_counter() - started)


def followed(request: Request) -> tuple[list[Branch], str]:
    """The branches of a scene, as a run follows them, and the failures beside them.

    Raises ArithmeticError where there is none.
    """
    followed = Branches(request, Progress(quiet=True))
    followed.follow(SimpleNamespace(path=Path(), records=[], append=lambda record: None))  # its row is all that is kept
    faults = "; ".join(followed.failures)
    if not any(len(branch) for branch in followed.branches):
        raise ArithmeticError(faults or "; ".join(branch.reason for branch in followed.branches))
    return followed.branches, faults
