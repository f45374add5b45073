"""A family at other values of a parameter of its model, and its orbits near an edge of a tongue."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.ode import OdeModel
from casadi_skin.points.breaking import breaking_of
from casadi_skin.points.edge_fold import multipliers_of
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.diagram import LocalisedDiagram, StabilityEdge
from casadi_skin.zero.family import Targets
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, EDGE
from casadi_skin.zero.problem import Scalar, SingularError
from casadi_skin.zero.settings import Point
from casadi_skin.zero.unresolved import Unresolved

# Edges of tongues of a family as special points: the orbits there, and those at which other orbits leave it -----------

REAL = "real"  # kind of an edge at which a multiplier is 1
NEAR = 1e-6  # relative difference of Omega: the orbit of an edge
BESIDE = 1e-4  # of S: how far the orbits on both sides are, whose cubic is good to some 1e-13


def orbit_at_edge(branch: Branch, edge: StabilityEdge) -> Orbit:
    """The orbit at an edge; raises ArithmeticError with the reason where none is found, there or from both sides."""
    try:
        return _passing(branch, edge, edge.S, NEAR)
    except (ArithmeticError, ValueError) as error:
        reason = str(error)
    found = between(branch, edge)
    if found is None:
        raise ArithmeticError(f"no orbit is found at the edge at S = {edge.S:.10g}, nor on both sides of it: {reason}")
    return found


def _passing(branch: Branch, edge: StabilityEdge, S: float, near: float) -> Orbit:
    """The orbit at an S on the part of a branch that an edge is on; raises ValueError or ArithmeticError without."""
    for which in itertools.count():
        found: Orbit = branch.at(S, which)
        if abs(found.Omega - edge.Omega) <= near * edge.Omega:
            return found
    raise AssertionError


def between(branch: Branch, edge: StabilityEdge) -> Orbit | None:
    """The orbit at an edge where its equations are singular, by the curve of the family from one side to the other."""
    with suppress(ArithmeticError, ValueError):
        before, after = (_passing(branch, edge, edge.S * (1.0 + h), 2.0 * BESIDE).point for h in (-BESIDE, BESIDE))
        return Orbit(branch.space, along_curve(branch.space, before, after, edge.S))
    return None


def along_curve(space: SolutionSpace, before: Point, after: Point, S: float) -> Point:
    """The orbit at S by the curve from an orbit on one side to one on the other; raises ValueError without one."""
    curve, length = space.point_solver.curve(before, after)
    (place,) = curve.crossings(*space.target("S", S).unknown(after.problem), length)
    tangent = curve.slope(place) * np.linalg.norm(after.tangent) / np.linalg.norm(curve.slope(place))
    return replace(after, z=curve.at(place), tangent=tangent, better=None)


def edge(branch: Branch, number: int = 0, further: bool = False) -> SpecialPoint:
    """The edge of a tongue of a family as a special point, to be followed in a second parameter.

    Arguments:
        branch: a family.
        number: place of the edge among `changes`, from 0.
        further: whether it is the place in `stability_diagram.further`, where orbits are unstable on both sides.

    Returns:
        The point; its `curve` follows the edge with S free.

    Raises:
        ValueError: the branch is not a family, or has no such edge.
    """
    listed = branch.changes
    if further:
        listed = () if branch.stability_diagram is None else branch.stability_diagram.further
    edges = [edge for edge in listed if isinstance(edge, StabilityEdge)]
    if str(number) not in map(str, range(len(edges))):
        where = "further edges" if further else "changes"
        accepted = f"0 to {len(edges) - 1}, the places in {where}" if edges else f"none: no {where} of a family"
        accepted += "; those of localised multipliers are not followed" if branch.localised_diagram else ""
        raise ValueError(f"number: given {number!r}; accepted: {accepted}")
    orbit = orbit_at_edge(branch, edges[number])
    values = {**orbit.parameters, branch.parameter: edges[number].value}
    return SpecialPoint(EDGE, branch.parameter, values, edges[number].error, orbit)


def edges_left(branch: Branch) -> Iterator[SpecialPoint | Unresolved]:
    """Edges of real tongues of a family at which other orbits leave it, by its changes of stability."""
    diagram = branch.stability_diagram
    if diagram is None:
        yield from _not_followed(branch.localised_diagram)
        return
    real = (edge for edge in (*diagram.changes, *diagram.further) if edge.kind == REAL and edge.mu in (-1.0, 0.0))
    for edge in sorted(real, key=lambda edge: edge.place.coordinate):
        try:
            orbit = orbit_at_edge(branch, edge)
        except ArithmeticError as error:
            yield Unresolved(edge.S, edge.S, str(error), EDGE)
            continue
        breaking = breaking_of(orbit, edge.mu)
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


SAME = 1e-12  # relative: values of the parameter that are one


def parameters_of(family: Family) -> tuple[str, ...]:
    """Names of the parameters of a family's model in which its edges can be followed."""
    model, names = family.request.model, tuple(family.coordinates.parameters)
    if isinstance(model, OdeModel):
        return names
    known: list[str] = [f.name for f in fields(model)] if is_dataclass(model) else []
    return tuple(name for name in names if name in known)


def family_at(family: Family, parameter: str, value: float, S: float, tolerance: float | None = None) -> Family:
    """The family at a value of a parameter, to somewhat beyond S."""
    request = family.request
    changed: dict[str, Any] = {"targets": Targets(), "amplitude_max": 1.5 * S}
    changed |= {} if tolerance is None else {"tolerance": tolerance}
    if isinstance(request.model, OdeModel):
        changed["parameters"] = {**family.coordinates.parameters, parameter: value}
    else:
        model: Any = request.model
        changed["model"] = replace(model, **{parameter: value})
    return Family(replace(request, **changed))


def orbit_at(family: Family, S: float, guess: Point) -> Point:
    """The orbit at S near a guess from a family beside; raises ArithmeticError where none is found."""
    problem = family.levels.problem(guess.problem.resolution)
    value, index = family.coordinates.parameter_of(S), problem.parameter_index
    z = guess.problem.prolong(guess.z, problem)
    z[index] = value
    row, solver = problem.parameter_row(), family.point_solver
    correction = solver.correct(problem, z, row, value, 1.0)
    if correction is None:
        raise ArithmeticError(solver.failure)
    correction.z[index] = value
    try:
        found = solver.refined(problem, correction, row, Scalar.PARAMETER)
    except SingularError as error:
        raise ArithmeticError(str(error)) from error
    if found is None:
        raise ArithmeticError("no level of resolution is fine enough")
    return found


def orbit_of_edge(family: Family, S: float, center: Point) -> Point:
    """The orbit at an edge; where its equations are singular, by the curve through orbits on both sides."""
    try:
        return orbit_at(family, S, beside(family, center, S))
    except ArithmeticError:
        places = [S * (1.0 + h) for h in (-BESIDE, BESIDE)]
        before, after = (orbit_at(family, place, beside(family, center, place)) for place in places)
        return along_curve(family, before, after, S)


def beside(family: Family, point: Point, S: float) -> Point:
    """A guess at another S along the tangent of a point."""
    index = point.problem.parameter_index
    moved = (family.coordinates.parameter_of(S) - point.parameter) / point.tangent[index]
    return replace(point, z=point.z + moved * point.tangent, better=None)


@dataclass(frozen=True)
class Orbits:
    """Orbits of families at values of the parameter, each solved from the nearest of those known before.

    Attributes:
        family_at: the family at a value, to somewhat beyond an S.
        first: the orbit from which the first one is solved.
    """

    family_at: Callable[[float, float], Family]
    first: Point
    families: dict[float, Family] = field(default_factory=dict)
    known: dict[tuple[float, float], Point] = field(default_factory=dict)

    def near(self, S: float, value: float) -> Point:
        """The orbit that is nearest among those that were solved."""
        if not self.known:
            return self.first
        places = np.array(list(self.known))
        sizes = np.ptp(places, axis=0) + SAME * np.abs(places[0])
        nearest = int(np.argmin(np.sum(((places - (S, value)) / sizes) ** 2, axis=1)))
        return list(self.known.values())[nearest]

    def multipliers(self, S: float, value: float) -> ComplexArray:
        """All mu but the trivial one; raises ArithmeticError where no orbit is found."""
        if value not in self.families:
            self.families[value] = self.family_at(value, S)
        self.known[S, value] = orbit_at(self.families[value], S, self.near(S, value))
        return multipliers_of(self.families[value], self.known[S, value])
