"""The branches of a run, followed one after the other, each result kept in the journal as it converges."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec
import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import following_space
from casadi_skin.follow.following import Following
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.rest_curve import UnfoldingError
from casadi_skin.follow.rest_location import BRANCH_POINT, FOLD, HOPF
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import DOUBLING, TORUS, SpecialPoint
from casadi_skin.follow.walk import Walk
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.points.curves import curve_space
from casadi_skin.points.diagram import LEAVING, Further
from casadi_skin.results import figures
from casadi_skin.results.branch_records import (
    BranchRecord,
    CutRecord,
    EndRecord,
    Records,
    known_of,
    point_record,
    stability_record,
)  # fmt: skip
from casadi_skin.results.dataset import Cell, unique_names, write_csv, write_netcdf
from casadi_skin.results.figures.profiles import chosen_solutions
from casadi_skin.results.quantities import dataset_of
from casadi_skin.results.store import Journal
from casadi_skin.results.tables import UNRESOLVED
from casadi_skin.runs.model_tables import ContinuationTable
from casadi_skin.runs.offshoots import Offshoots
from casadi_skin.runs.pictures import picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.solve.watch import watched
from casadi_skin.stability.stepping import FlowError
from casadi_skin.zero.settings import End, Point
from casadi_skin.zero.stated_problem import PERIOD

if TYPE_CHECKING:
    pass


# A bifurcation diagram: branches that leave a branch, curves in two parameters, and the files of all of them ----------

CYCLES, OTHER, CURVE = "cycles", "other", "curve"
FOLLOWED = (FOLD, HOPF, DOUBLING, TORUS)  # kinds that curves in two parameters have
EMPTY: Cell = ""
SAME = 1e-6  # distance of special points that are one


def further_spaces(
    branches: Sequence[Branch], table: ContinuationTable, tolerance: float, failures: list[str]
) -> Iterator[tuple[str, SolutionSpace]]:
    """Names and spaces of the branches that leave at special points, then of the curves through them.

    `branches` grows: its last one is what was followed for the name and space before. A name ends with the numbers of
    the special points that lead to it; a special point that was met before is not left again. Branches that cannot be
    started are named in `failures`.
    """
    options = {"max_points": table.max_points, "max_step": table.max_step}
    kinds = table.switch or (() if table.depth is None else LEAVING)
    depth, halves = (float("inf"), 1) if table.depth is None else (table.depth, 2)
    further = Further(branches[-1], kinds, depth, {**options, "tolerance": tolerance}, halves)
    for name, point, space in further:
        if len(further.branches) == table.limit:
            most = "one branch belongs" if table.limit == 1 else f"{table.limit} branches belong"
            failures.append(f"[continuation] limit: more than {most} to the diagram")
            break
        yield f"{CYCLES if _has_cycles(point) else OTHER}{name}", space
        if branches[-1].space is space:
            further.add(branches[-1], space, point)
    failures += [f"[continuation] switch: {line}" for line in further.failures]
    curves = list[Branch]()
    for place, point in further.reached:
        passed = any(_passes(curve, point) for curve in curves)
        crossing = point.kind == BRANCH_POINT and point.mu is None
        if table.curve is not None and (point.kind in FOLLOWED or crossing) and not _at_rest(point) and not passed:
            try:
                space = curve_space(point, table.curve.parameter, table.curve.to, at=(), **options)  # type: ignore[arg-type]
                yield f"{CURVE}{place}", space
            except UnfoldingError:  # it is one at these values alone
                continue
            except (ValueError, ArithmeticError) as error:
                failures.append(f"[continuation] curve: {point.kind} {place[1:]}: {error}")
            else:
                curves.append(branches[-1])


def _has_cycles(point: SpecialPoint) -> bool:
    """Whether cycles leave a special point of equilibria."""
    return point.kind == HOPF and isinstance(point.solution, Equilibrium)


def _at_rest(point: SpecialPoint) -> bool:
    """Whether cycles have shrunk to an equilibrium there: its own branch has the curve."""
    return point.kind == HOPF and isinstance(point.solution, Orbit)


def _passes(curve: Branch, point: SpecialPoint) -> bool:
    """Whether a curve that came back to the value of its parameter did so at another special point."""
    if curve.end is not End.RETURNED or curve.space.kind != point.kind:
        return False
    try:
        found = curve.at(point.parameters[curve.parameter], which=1)
    except (ValueError, ArithmeticError):
        return False
    if not isinstance(found, Equilibrium):
        a, b = found.parameters[point.parameter], point.parameters[point.parameter]
        return bool(abs(a - b) <= SAME * max(abs(a), abs(b)))
    x, y = found.positions, point.solution.evaluate(0.0)[: found.positions.size]
    return bool(np.max(np.abs(x - y)) <= SAME * max(1.0, float(np.max(np.abs(x)))))


def write_diagram(
    request: Request,
    names: Sequence[str],
    branches: Sequence[Branch],
    attributes: dict[str, float | str],
    directory: Path,
) -> None:
    """special_points.csv, a netCDF file a branch, and the pictures."""
    title = request.scene.title or ""
    for name, branch in zip(names, branches, strict=True):
        write_netcdf(directory / f"{name}.nc", replace(dataset_of([branch]), attributes=attributes))
    first = branches[0]
    if not first.parameter:
        return
    columns = diagram_columns(first)
    rows = [row for name, branch in zip(names, branches, strict=True) for row in diagram_rows(name, branch, columns)]
    write_csv(directory / "special_points.csv", columns, rows)
    in_one = [branch for branch in branches if not branch.space.kind]
    picture(request.scene, directory / "branch", figures.bifurcation_figure, in_one, title)
    chosen = chosen_solutions(in_one)
    if chosen:
        picture(request.scene, directory / "portrait", figures.portrait_figure, chosen, title)
    curves = [branch for branch in branches if branch not in in_one]
    if curves:
        picture(request.scene, directory / "curves", figures.curves_figure, curves, title)


def diagram_columns(branch: Branch) -> list[str]:
    """Columns of special_points.csv of a diagram; the period that orbits have free is a column of its own."""
    fixed = ("branch", "kind", "error", "period", "frequency", "coefficient", "criticality")
    known = [name for name in branch.solutions[0].parameters if name not in branch.space.free or name != PERIOD]
    names = [branch.parameter, *(name for name in known if name != branch.parameter)]
    return ["branch", "kind", *unique_names(names, fixed), *fixed[2:]]


def diagram_rows(name: str, branch: Branch, columns: Sequence[str]) -> Iterator[dict[str, Cell]]:
    """A row for each special point of a branch; quantities that a point does not have are empty.

    A stretch that is not resolved has a row too, with its width for the error.
    """
    for point in branch.special_points:
        known = list(branch_parameters(point, columns[2:-5]).values())
        period: Cell = point.solution.period if isinstance(point.solution, Orbit) else EMPTY
        yield dict(zip(columns, [name, point.kind, *known, point.error, period, *_critical(point)], strict=True))
    for stretch in branch.passed_over:
        row: dict[str, Cell] = dict.fromkeys(columns, EMPTY)
        width = abs(stretch.end - stretch.start)
        yield {**row, "branch": name, "kind": UNRESOLVED, columns[2]: stretch.start, "error": width}


def branch_parameters(point: SpecialPoint, columns: Sequence[str]) -> dict[str, Cell]:
    """Values of parameters by column; names that the table takes itself have " (of the model)" after them."""
    return {name: float(point.parameters[name.removesuffix(" (of the model)")]) for name in columns}


def _critical(point: SpecialPoint) -> list[Cell]:
    try:
        frequency, coefficient, words = point.frequency, point.coefficient, point.criticality
    except (ValueError, ArithmeticError):
        return [EMPTY, EMPTY, EMPTY]
    return [frequency or EMPTY, coefficient if coefficient == coefficient else EMPTY, words]


# Branches and edges that a run follows from families ------------------------------------------------------------------


BUILTIN = (ZeroDivisionError, OverflowError, FloatingPointError)


class Rows(Protocol):
    """Rows of solutions, written or not: the tables of a run have these."""

    def add(self, name: str, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Add rows to those of a branch."""

    def count(self, name: str, space: SolutionSpace) -> int:
        """Number of rows beside which a branch stands."""


@dataclass
class Branches:
    """The branches of a request.

    Attributes:
        branches, seconds: fill as branches end.
        failures: reasons why a part is not as requested, in a line each.
        tables: rows of the computed points.
        offshoots: branches and edges followed from families.
    """

    request: Request
    tables: Rows
    progress: Progress
    branches: list[Branch] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    offshoots: Offshoots = field(default_factory=Offshoots)

    @property
    def _with_stability(self) -> bool:
        return self.request.scene.stability is not None

    @property
    def _with_events(self) -> bool:
        stability = self.request.scene.stability
        return stability is not None and stability.events

    def follow_all(self, path: Path) -> None:
        """Follow every branch, with every solution in the journal at `path` before anything else happens to it."""
        with Journal(path, msgspec.msgpack.Decoder(BranchRecord)) as journal:
            if journal.fault:
                self.progress.report(f"{path}: {journal.fault}; what follows it is dropped and computed again")
            self.follow(journal)

    def follow(self, journal: Records) -> None:
        """Follow every branch, each result appended to the records before anything else happens to it."""
        try:
            for name, space in self._spaces(journal):
                started = time.perf_counter()
                with self._named(f"mode {name}: " if isinstance(space, Family) else ""):
                    self._follow(name, space, journal)
                    self._seek_changes(name, self.branches[-1])
                self.seconds.append(time.perf_counter() - started)
            self._from_families(journal)
        except (ArithmeticError, ValueError) as error:  # no first orbit exists
            self.failures.append(str(error))

    def _from_families(self, journal: Records) -> None:
        """Branches that leave families, and edges of their tongues, where the scene requests them."""
        table = self.request.scene.continuation
        if self.request.scene.family is None or table is None:
            return
        from casadi_skin.runs.family_points import follow_edges, leaving_spaces

        families = [branch for branch in self.branches if len(branch)]
        for name, space in leaving_spaces(families, table, self.failures):
            self.progress.say(name)
            before = len(self.branches)
            try:
                with self._named(f"[continuation] switch: {name}: "):
                    self._follow(name, space, journal)
            finally:  # beside the families, also where it is interrupted
                self.offshoots.leaving += [(name, branch) for branch in self.branches[before:]]
                del self.branches[before:]
        follow_edges(families, table, self.offshoots, self.failures, self.progress, journal)

    @contextmanager
    def _named(self, where: str) -> Iterator[None]:
        """Keep a failure of the block in words, so that the next branch is followed."""
        try:
            yield
        except BUILTIN as error:  # not raised by this package, so that it names nothing
            self.failures.append(f"{where}numbers leave the range of double precision ({error})")
        except (ArithmeticError, ValueError) as error:
            self.failures.append(f"{where}{error}")

    def _seek_changes(self, name: str, branch: Branch) -> None:
        """Every change of stability of a family, and resonances passed over, where the scene requests events."""
        if branch.with_events and isinstance(branch.space, Family):
            self.progress.say(f"j = {name}: changes of stability")
            branch.diagram_of_changes  # noqa: B018  computed once, and kept by the branch
            branch.passed_resonances  # noqa: B018  likewise

    def _spaces(self, journal: Records) -> Iterator[tuple[str, SolutionSpace]]:
        """Names and spaces of the branches to follow; a single orbit or solution is kept at once."""
        for family in self.request.families:
            self.progress.say(f"j = {family.mode}: building")
            yield str(family.mode), Family(family)
        scene, table = self.request.scene, self.request.scene.continuation
        if scene.equilibrium is None and scene.orbit is None and scene.solution is None:
            return
        from casadi_skin.runs.first_solution import cycle, cycle_record, first_solution, known_cycle

        simulated = None
        if scene.orbit is not None:
            simulated = known_cycle(journal.records, self.request.ode, self.request.parameters)
            if simulated is None:
                self.progress.say("simulating")
                simulated = cycle(self.request)
                journal.append(cycle_record(simulated))
        self.progress.say("solving")
        with watched(report=self.progress.say):
            first = first_solution(self.request, simulated)
        if table is not None:
            yield (
                "branch",
                following_space(
                    first,
                    table.parameter,
                    table.to,
                    at=table.at,
                    max_points=table.max_points,
                    max_step=table.max_step,
                    back_to=table.back_to,
                ),
            )
            if scene.has_diagram:
                yield from further_spaces(self.branches, table, self.request.tolerance, self.failures)
            return
        branch = self._alone(first)
        self.tables.add("branch", branch.solutions, branch.space)
        self.branches.append(branch)
        self.seconds.append(0.0)

    def _alone(self, solution: Solution) -> Branch:
        """A single orbit or solution as a branch of one point."""
        end, words = End.REACHED, ""
        if self._with_stability and not solution.space.stability_included:
            try:
                found = solution.space.floquets([solution.point])[0]
                solution = solution.space.solution(solution.point, found, solution.exact)
            except FlowError as error:
                end, words = End.FLOW, str(error)
        return Branch(solution.space, (solution,), (), self._with_stability, end, words)

    def _follow(self, name: str, space: SolutionSpace, journal: Records) -> None:
        """Follow one branch to its end; each result goes to the journal before anything else happens.

        An interruption may come before a result is handed over: its row is added then.
        """
        with interrupts_deferred():
            known = known_of(journal.records, name, space, self._with_stability and not space.stability_included)
        if known.fault:
            words = f"{known.fault} in record {known.kept + 1} of {name}; what follows it is dropped and computed again"
            self.progress.report(f"{journal.path}: {words}")
            journal.append(CutRecord(name, known.kept))

        def keep(point: Point, walk: Walk) -> None:
            journal.append(point_record(name, point, walk, self._with_stability))

        following = Following(
            space, self._with_stability, self._with_events, known.solutions,
            waiting=known.waiting, missed=known.missed, keep=keep, unresolved=known.unresolved,
        )  # fmt: skip
        if known.end is not None:
            self.tables.add(name, following.solutions, space)
            self.branches.append(following.finished(known.end.end, known.end.detail, known.end.misses))
            return
        before = self.tables.count(name, space)
        self.tables.add(name, following.solutions, space)
        try:
            for result in following:
                point = result.point
                sought_again = point.special and not (
                    point.located or point.requested
                )  # by its neighbours' multipliers
                periodic = isinstance(result, Orbit) or result.known_floquet is not None
                if periodic and self._with_stability and not sought_again:
                    journal.append(stability_record(name, result))
                self.tables.add(name, [result], space)
                self.progress.solution(result, len(following.solutions))
        finally:
            branch = following.branch()
            if branch.end is None and not branch.stopped:  # interrupted: its changes of stability are not sought now
                branch = replace(branch, with_events=False)
            self.branches.append(branch)
            self.tables.add(name, branch.solutions[self.tables.count(name, space) - before :], space)
        journal.append(EndRecord(name, branch.end, branch.detail, dict(branch.misses), branch.passed_over))
