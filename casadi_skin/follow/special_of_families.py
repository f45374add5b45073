"""Special points of a family, which are located after it was followed: folds, and where other orbits leave it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from casadi_skin.follow.making import solution_at
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import (
    BRANCH_POINT,
    DOUBLING,
    EDGE,
    FOLD,
    NotLocatedError,
    SpecialPoint,
)
from casadi_skin.follow.unresolved import Unresolved
from casadi_skin.model import methods
from casadi_skin.points.at_edges import Passes, between, orbit_at_edge
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.localised_diagram import LocalisedDiagram

REAL = "real"  # kind of an edge at which a multiplier is 1


def special_point(space: SolutionSpace, solution: Solution) -> SpecialPoint:
    """A solution that is marked as special, as a special point."""
    name, point = space.parameter, solution.point
    values = {**solution.parameters, name: solution.value(name)}
    return SpecialPoint(point.special, name, values, space.parameter_error(point), solution)


def folds_of_family(space: SolutionSpace, solutions: Sequence[Solution]) -> Iterator[SpecialPoint | Unresolved]:
    """Folds between the points of a family."""
    for before, after in pairwise(solutions):
        try:
            for found in space.special_between(before.point, after.point):
                yield found if isinstance(found, Unresolved) else special_point(space, solution_at(space, found))
        except NotLocatedError as error:
            yield Unresolved(before.value(space.parameter), after.value(space.parameter), str(error), FOLD)


def edges_left_at(
    branch: Passes, diagram: StabilityDiagram | None, localised: LocalisedDiagram | None
) -> Iterator[SpecialPoint | Unresolved]:
    """Edges of real tongues of a family at which other orbits leave it, by its changes of stability."""
    if diagram is None:
        yield from _not_followed(localised)
        return
    real = (edge for edge in (*diagram.changes, *diagram.further) if edge.kind == REAL and edge.mu in (-1.0, 0.0))
    for edge in sorted(real, key=lambda edge: edge.place.coordinate):
        try:
            orbit = orbit_at_edge(branch, edge)
        except ArithmeticError as error:
            yield Unresolved(edge.S, edge.S, str(error), EDGE)
            continue
        breaking = methods.TASKS["breaking"].load()(orbit, edge.mu)
        if breaking is not None:
            if not breaking.lost:  # a branch of the same class crosses, where the equations are singular
                orbit = between(branch, edge) or orbit
            kind, values = BRANCH_POINT if breaking.turns == 1 else DOUBLING, {**orbit.parameters, "S": edge.S}
            yield SpecialPoint(kind, branch.space.parameter, values, edge.error, orbit, edge.mu)


def _not_followed(localised: LocalisedDiagram | None) -> Iterator[Unresolved]:
    """Places at which a localised multiplier is 1, of a family with an endless tail."""
    for change in () if localised is None else localised.all:
        if change.kind == REAL:
            words = "orbits that leave a family with an endless tail are not sought"
            yield Unresolved(change.S, change.S, words, EDGE)
