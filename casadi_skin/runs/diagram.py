"""A bifurcation diagram: branches that leave a branch, curves in two parameters, and the files of all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.rest_curve import UnfoldingError
from casadi_skin.follow.solution import Equilibrium
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.points.curves import curve_space
from casadi_skin.points.diagram import LEAVING_KINDS, Further
from casadi_skin.results import figures
from casadi_skin.results.dataset import dataset_of, write_csv, write_netcdf
from casadi_skin.results.figures.solutions import chosen_solutions
from casadi_skin.results.quantities import Cell, unique_names
from casadi_skin.results.tables import UNRESOLVED
from casadi_skin.runs.parts import picture
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import ContinuationTable
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.zero.settings import End
from casadi_skin.zero.stated_problem import PERIOD

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
    kinds = table.switch or (() if table.depth is None else LEAVING_KINDS)
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
