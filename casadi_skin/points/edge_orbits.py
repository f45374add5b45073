"""A family at other values of a parameter of its model, and its orbits near an edge of a tongue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.follow.family import Family
from casadi_skin.follow.settings import Point
from casadi_skin.model.ode import OdeModel
from casadi_skin.points.at_edges import BESIDE, along_curve
from casadi_skin.points.edge_fold import multipliers_of
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.method import Targets
from casadi_skin.zero.problem import Scalar, SingularError

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
