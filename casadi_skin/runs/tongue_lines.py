"""First instabilities of families over a parameter: edges of tongues, followed from one of them in the parameter.

Neighbouring families that enter the same tongue share a line. It goes on to the neighbours on both sides, at which
another tongue is the first one, as long as no other line lies below it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from casadi_skin.follow.special_points import EDGE, SpecialPoint
from casadi_skin.runs.map_cell import followed
from casadi_skin.runs.map_columns import Columns
from casadi_skin.runs.map_planes import Plane, Points
from casadi_skin.runs.map_store import UNKNOWN
from casadi_skin.runs.request import Request

BEYOND = 1e-3  # of S: how far beyond an edge the family is followed that it is found on
AGREE = 1e-6  # of S: within which the edge is the one that the map has
MARGIN = 0.05  # of the range of S, by which a curve leaves it before it ends
Bound = Callable[[Sequence[Any], float], Request]


@dataclass(frozen=True)
class Entry:
    """The first instability of a family: its value of the parameter, S, the tongue, and a cell of it."""

    value: float
    S: float
    tongue: str
    cell: int


def tongue_lines(plane: Plane, columns: Columns, bound: Bound, report: Callable[[str], None]) -> list[Points]:
    """Lines of the boundary, in the order of the plane's axes.

    Arguments:
        bound: the request of a family up to an amplitude, at settings of the scene.
        report: takes the reason why an edge cannot be followed; its line joins the families then.
    """
    entries, lines = _entries(plane, columns), list[Points]()
    values = [entry.value for entry in entries]
    for tongue, group in groupby(range(len(entries)), key=lambda k: entries[k].tongue):
        places = list(group)
        if not tongue:
            continue
        run = [entries[k] for k in places]
        reach = values[max(places[0] - 1, 0)], values[min(places[-1] + 1, len(values) - 1)]
        try:
            lines.append(_followed(plane, run, reach, bound))
        except (ValueError, ArithmeticError) as error:
            words = f"{plane.axes[0].name}, {plane.axes[1].name}: the edge of the tongue {tongue} is not followed"
            report(f"{words}, its line joins families: {' '.join(str(error).split())}")
            lines.append(np.array([(entry.value, entry.S) for entry in run]))
    shown = [part for k, line in enumerate(lines) for part in lowest(line, lines[:k] + lines[k + 1 :])]
    return [line if plane.along[1] == plane.grid.amplitude else line[:, ::-1] for line in shown]


def _entries(plane: Plane, columns: Columns) -> list[Entry]:
    """The families of a plane, in the order of their parameter; of a refined map those that are known."""
    amplitude_first = plane.along[0] == plane.grid.amplitude
    found = []
    for value, family in zip(
        plane.axes[1 if amplitude_first else 0].values, plane.cells.T if amplitude_first else plane.cells, strict=True
    ):
        known = family[columns.store.states[family] != UNKNOWN]
        if known.size:
            cell = int(known[0])
            S = float(columns.numbers["first_instability"][cell])
            found.append(Entry(float(value), S, columns.text("first_tongue", cell), cell))
    return found


def _followed(plane: Plane, run: Sequence[Entry], reach: tuple[float, float], bound: Bound) -> Points:
    """The edge that the families of a run have, from one end of a reach of the parameter to the other one.

    Raises ValueError and ArithmeticError where it cannot be followed, or does not pass all of them.
    """
    (name,) = [axis.paths[0][-1] for k, axis in zip(plane.along, plane.axes, strict=True) if k != plane.grid.amplitude]
    middle = run[len(run) // 2]
    (branch,), fault = followed(bound(plane.grid.settings(middle.cell), middle.S * (1.0 + BEYOND)))
    diagram = branch.stability_diagram
    edges = [] if diagram is None else [*diagram.changes, *diagram.further]
    near = [edge for edge in edges if abs(edge.S - middle.S) <= AGREE * middle.S]
    if not near:
        raise ArithmeticError(fault or "it is not found again")
    orbit, outside = branch.at(S=near[0].S), _outside(plane)
    point = SpecialPoint(EDGE, "S", {**orbit.parameters, "S": near[0].S}, near[0].error, orbit)
    halves = []
    for to in reach:
        at = [entry.value for entry in run if min(middle.value, to) < entry.value < max(middle.value, to)]
        if to != middle.value:
            order = sorted(at, reverse=to < middle.value)
            halves.append(checked(point.curve(name, to, at=order, until=outside), name, run))
    if not halves:
        return np.array([(middle.value, middle.S)])
    below = halves[0] if len(halves) == 2 else halves[0][:1]
    return np.concatenate([below[::-1], halves[-1][1:]])


def _outside(plane: Plane) -> Callable[[Any], bool]:
    """Whether an edge lies beyond the range of S."""
    (axis,) = [axis for k, axis in zip(plane.along, plane.axes, strict=True) if k == plane.grid.amplitude]
    low, high = sorted((float(axis.values[0]), float(axis.values[-1])))
    margin = MARGIN * (high - low)
    least, most = max(low - margin, 0.5 * low), high + margin

    def outside(solution: Any) -> bool:
        return not least <= solution.parameters["S"] <= most

    return outside


def checked(curve: Any, name: str, run: Sequence[Entry]) -> Points:
    """The points of a curve, which passes the families of a run; raises ArithmeticError where it does not."""
    points = np.column_stack([curve[name], curve["S"]])
    low, high = points[:, 0].min(), points[:, 0].max()
    for entry in run:
        if low <= entry.value <= high:
            near = np.abs(points[points[:, 0] == entry.value, 1] - entry.S)
            if not np.any(near <= AGREE * entry.S):
                raise ArithmeticError(f"it passes {name} = {entry.value:g} elsewhere")
    return points


def lowest(line: Points, others: Sequence[Points]) -> Iterator[Points]:
    """The parts of a line below which no other line is."""
    above = np.zeros(len(line), dtype=bool)
    for other in others:
        x, S = other[np.argsort(other[:, 0], kind="stable")].T
        inside = (line[:, 0] >= x[0]) & (line[:, 0] <= x[-1])
        single = len(x) > 1 and bool(np.all(np.diff(x) > 0.0))
        above |= inside & single & (line[:, 1] > np.interp(line[:, 0], x, S))
    cuts = [0, *(np.flatnonzero(np.diff(above)) + 1).tolist(), len(line)]
    for first, last in pairwise(cuts):
        if not above[first]:
            yield line[first:last]
