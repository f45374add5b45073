"""Files of a branch of orbits or solutions of any model: branch.csv and branch.nc."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.files import replacing
from casadi_skin.orbits.periodic_orbit import PeriodicOrbit
from casadi_skin.orbits.solution import BoundarySolution
from casadi_skin.results.netcdf import EMPTY, put, write_versions
from casadi_skin.results.tables import Cell
from casadi_skin.stability.full_period import Multipliers

if TYPE_CHECKING:
    from scipy.io import netcdf_file

    from casadi_skin.runs.model_request import ModelRequest

PHASES = 401  # of the common grid of profiles
FINE = 16  # places an interval in which extremes are looked for
FIXED = ("point", "requested", "fold", "period", "error", "parameter_error", "intervals", "residual",
         "max_abs_multiplier", "stable", "unstable", "trivial_deviation")  # fmt: skip


@dataclass(frozen=True, eq=False)
class BranchPoint:
    """A solution with its multipliers, where these are asked for."""

    solution: BoundarySolution
    multipliers: Multipliers | None

    @cached_property
    def extremes(self) -> tuple[Array, Array]:
        """Smallest and largest value of each state, shapes (components,)."""
        return extremes(self.solution)


def requested_marks(request: ModelRequest, points: Sequence[BranchPoint]) -> list[bool]:
    """Which of the points are at a value of the parameter that was asked for."""
    table = request.scene.continuation
    return [table is not None and p.solution.parameters[table.parameter] in table.at for p in points]


def fold_marks(points: Sequence[BranchPoint]) -> list[bool]:
    """Which of the points are folds: neither walked nor asked for, between two where the parameter goes either way."""
    marks = [False] * len(points)
    for i in range(1, len(points) - 1):
        before, here, after = (points[k].solution for k in (i - 1, i, i + 1))
        between = not (here.point.walked or here.point.requested)
        marks[i] = between and _rate(before) * _rate(after) < 0.0
    return marks


def _rate(solution: BoundarySolution) -> float:
    """Rate of the followed parameter along the branch."""
    return float(solution.point.tangent[-1])


def extremes(solution: BoundarySolution) -> tuple[Array, Array]:
    """Smallest and largest value of each state over the interval or the period.

    The extremes of fine samples are moved to the vertex of the parabola through their neighbours and evaluated there.
    """
    t = _fine_times(solution)
    x = solution.evaluate(t)
    found = []
    for sign in (-1.0, 1.0):
        place = np.argmax(sign * x, axis=0)
        times = np.array([_vertex(t, x[:, i], k) for i, k in enumerate(place)])
        moved = np.diagonal(solution.evaluate(times))
        found.append(sign * np.maximum(sign * moved, sign * np.diagonal(x[place])))
    return found[0], found[1]


def _fine_times(solution: BoundarySolution) -> Array:
    edges = solution.mesh
    inner = edges[:-1, None] + np.diff(edges)[:, None] * np.arange(FINE) / FINE
    t = np.append(inner.ravel(), edges[-1])
    if not isinstance(solution, PeriodicOrbit):
        return t
    copies = round(1.0 / solution.symmetry.value)  # the part that was unknown, mirrored or repeated over the period
    part = t[-1]
    whole = [k * part + (t if k % 2 == 0 else part - t[::-1]) for k in range(copies)]
    return np.unique(np.concatenate(whole))


def _vertex(t: Array, x: Array, k: int) -> float:
    """Where the parabola through three samples has its vertex; the sample itself at an end or on a line."""
    if k in (0, t.size - 1):
        return float(t[k])
    left, right = t[k - 1] - t[k], t[k + 1] - t[k]
    a, b = (x[k - 1] - x[k]) / left, (x[k + 1] - x[k]) / right
    curvature = (b - a) / (right - left)
    if curvature == 0.0:
        return float(t[k])
    slope = a - curvature * left
    return float(np.clip(t[k] - 0.5 * slope / curvature, t[k - 1], t[k + 1]))


# branch.csv ----------------------------------------------------------------------------------------------------------


def branch_row(request: ModelRequest, point: BranchPoint, index: int) -> dict[str, Cell]:
    """One row of branch.csv; the columns of the period and of multipliers are absent where there are none.

    What depends on the neighbours (`fold`) is 0.
    """
    solution, followed = point.solution, request.scene.continuation
    row: dict[str, Cell] = {"point": index, "requested": int(requested_marks(request, [point])[0]), "fold": 0}
    values = {name: value for name, value in solution.parameters.items() if name != "period"}
    first = {} if followed is None else {followed.parameter: values.pop(followed.parameter)}
    _add(row, first)
    if isinstance(solution, PeriodicOrbit):
        row["period"] = solution.period
    else:
        values = {name: value for name, value in solution.parameters.items() if name not in first}
    _add(row, values)
    smallest, largest = point.extremes
    for name, low, high in zip(request.model.state_names, smallest, largest, strict=True):
        _add(row, {f"{name}_min": float(low), f"{name}_max": float(high)})
    row |= {
        "error": solution.error,
        "parameter_error": solution.parameter_error,
        "intervals": solution.intervals,
        "residual": solution.residual,
    }
    if point.multipliers is not None:
        row |= _stability(point.multipliers)
    return row


def _stability(found: Multipliers) -> dict[str, Cell]:
    moduli = np.abs(found.others)
    return {
        "max_abs_multiplier": float(moduli.max()) if moduli.size else "",  # all of them may be trivial
        "stable": int(found.stable),
        "unstable": int(np.count_nonzero(moduli > 1.0 + found.allowed)),
        "trivial_deviation": found.deviation,
    }


def _add(row: dict[str, Cell], values: dict[str, float]) -> None:
    """Add cells by names that users chose, told apart from the columns that there are."""
    for name, value in values.items():
        taken = name in row or name in FIXED
        row[f"{name} (of the model)" if taken else name] = value


# branch.nc -----------------------------------------------------------------------------------------------------------


def write_netcdf(path: Path, request: ModelRequest, points: Sequence[BranchPoint], scene_text: str) -> None:
    """Write all points along one dimension `point` in arclength order, in the units of the model.

    Raises ArithmeticError on a value that is not finite.
    """
    from scipy.io import netcdf_file

    scene = request.scene
    with replacing(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        write_versions(file, scene_text, scene.title or "")
        origin = {"model": request.model.name, "model_file": scene.model.file, "model_source": request.source}
        for name, value in origin.items():
            setattr(file, name, value or "untitled")
        parameters = list(points[0].solution.parameters)
        sizes = {"point": len(points), "phase": PHASES, "state": request.model.full_size, "part": 2}
        for name, size in sizes.items():
            file.createDimension(name, size)
        _put_names(file, "state", request.model.state_names)
        if parameters:
            file.createDimension("parameter", len(parameters))
            _put_names(file, "parameter", parameters)
            values = np.array([[p.solution.parameters[name] for name in parameters] for p in points])
            put(file, "parameters", ("point", "parameter"), values, "values of the parameters; names: parameter_name")
        _put_solutions(file, request, points)
        if all(point.multipliers is not None for point in points):
            _put_multipliers(file, points)


def _put_names(file: netcdf_file, what: str, names: Sequence[str]) -> None:
    """Names as characters, the convention of netCDF 3 for strings."""
    encoded = [name.encode() for name in names]
    width = max(len(name) for name in encoded)
    file.createDimension(f"{what}_name_length", width)
    variable = file.createVariable(f"{what}_name", "c", (what, f"{what}_name_length"))
    variable[:] = np.array([list(name.ljust(width).decode("latin-1")) for name in encoded], dtype="S1")
    variable.long_name = f"names along `{what}`"  # type: ignore[attr-defined]


def _put_solutions(file: netcdf_file, request: ModelRequest, points: Sequence[BranchPoint]) -> None:
    solutions = [point.solution for point in points]
    columns = {
        "requested": (requested_marks(request, points), "1 where the value of the parameter was asked for"),
        "fold": (fold_marks(points), "1 where the parameter turns back"),
        "error": ([s.error for s in solutions], "estimated error of the states, relative to the largest value of each"),
        "parameter_error": ([s.parameter_error for s in solutions], "estimated relative error of free parameters"),
        "residual": ([s.residual for s in solutions], "largest residual relative to the largest term"),
        "intervals": ([s.intervals for s in solutions], "intervals of the mesh"),
        "smallest": ([p.extremes[0] for p in points], "smallest value of each state"),
        "largest": ([p.extremes[1] for p in points], "largest value of each state"),
        "start": ([_span(s)[0] for s in solutions], "start of the interval; 0 for an orbit"),
        "end": ([_span(s)[1] for s in solutions], "end of the interval; the period of an orbit"),
    }
    for name, (values, meaning) in columns.items():
        dimensions = ("point", "state") if name in ("smallest", "largest") else ("point",)
        put(file, name, dimensions, np.array(values), meaning)
    phases = np.linspace(0.0, 1.0, PHASES)
    put(file, "phase", ("phase",), phases, "place in the interval or the period, from 0 to 1")
    profiles = np.stack([s.evaluate(_times(s, phases)) for s in solutions])
    put(file, "profile", ("point", "phase", "state"), profiles, "states; names: state_name")
    longest = max(s.intervals for s in solutions)
    file.createDimension("edge", longest + 1)
    edges = np.stack([np.append(s.mesh, np.full(longest - s.intervals, EMPTY)) for s in solutions])
    put(file, "mesh", ("point", "edge"), edges, "ends of the intervals of the part that was unknown; empty after it")
    setattr(file.variables["mesh"], "_FillValue", EMPTY)  # noqa: B010


def _span(solution: BoundarySolution) -> tuple[float, float]:
    return (0.0, solution.period) if isinstance(solution, PeriodicOrbit) else solution.interval


def _times(solution: BoundarySolution, phases: Array) -> Array:
    start, end = _span(solution)
    return np.asarray(start + phases * (end - start))


def _put_multipliers(file: netcdf_file, points: Sequence[BranchPoint]) -> None:
    found = [point.multipliers for point in points if point.multipliers is not None]
    file.createDimension("multiplier", found[0].values.size)
    values = np.stack([m.values for m in found])
    put(file, "multipliers", ("point", "multiplier"), values, "multipliers over the period, in descending modulus")
    put(file, "stable", ("point",), np.array([m.stable for m in found]), "1 where none but the trivial is unstable")
    deviations = np.array([m.deviation for m in found])
    put(file, "trivial_deviation", ("point",), deviations, "distance of the trivial multipliers from 1")
    trivial = found[0].trivial
    file.variables["multipliers"].trivial = trivial  # type: ignore[attr-defined]


# The terminal --------------------------------------------------------------------------------------------------------


def summary_columns(request: ModelRequest) -> list[str]:
    """Headings of `summary_rows`."""
    followed = request.scene.continuation
    columns = ["point", "", *([] if followed is None else [followed.parameter])]
    columns += ["period"] if request.problem is None else []
    columns += [f"largest {request.model.state_names[0]}", "its error"]
    return columns + (["max |mult.|"] if request.scene.stability is not None else [])


def summary_rows(request: ModelRequest, points: Sequence[BranchPoint]) -> list[list[str]]:
    """Cells of the points that a reader looks for: the first and the last, those asked for, folds."""
    followed = request.scene.continuation
    asked, folds = requested_marks(request, points), fold_marks(points)
    rows = []
    for i, point in enumerate(points):
        marks = {"start": i == 0, "asked for": asked[i], "fold": folds[i], "end": i == len(points) - 1}
        words = [word for word, holds in marks.items() if holds]
        if not words:
            continue
        solution = point.solution
        row = [str(i), ", ".join(words) if len(points) > 1 else "alone"]
        row += [] if followed is None else [f"{solution.parameters[followed.parameter]:.8g}"]
        row += [f"{solution.period:.10g}"] if isinstance(solution, PeriodicOrbit) else []
        row += [f"{point.extremes[1][0]:.8g}", f"{solution.error:.1e}"]
        if point.multipliers is not None:
            moduli = np.abs(point.multipliers.others)
            row.append(f"{moduli.max():.6g}" if moduli.size else "")
        rows.append(row)
    return rows
