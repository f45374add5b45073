"""What designs locate again at every design: special points, equilibria and orbits, each near that of the last design.

All have the same interface (`LocatedThing`), as `LocatedSolution` describes it. A special point is a regular solution
of its augmented problem, which Newton's method solves at other parameters from the last z, and which confirms the kind;
equilibria and orbits are those of their own equations. Derivatives are those of `points.gradient`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from casadi_skin.follow.normal_forms import critical_angle
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import FAMILY
from casadi_skin.follow.special_points import SpecialPoint, locate_rest, special_orbit, special_point
from casadi_skin.model.arguments import accepted_names, short_repr
from casadi_skin.points.edges import parameters_of
from casadi_skin.points.gradient import Gradient
from casadi_skin.search.families import FamilyOrbit, FamilyStart, FreeNumber
from casadi_skin.zero.kinds import EDGE, HOPF
from casadi_skin.zero.problem import Array

SHRUNK = 1e-4  # of an orbit's motion at the start: so near to a rest its equations have lost half of their digits


class NamedNumbers:
    """Parameters and quantities of a solution as symbols, quantities as they are asked for."""

    def __init__(self, parameters: Sequence[str], solution: Solution | None) -> None:
        self.solution, self._symbols = solution, {name: ca.SX.sym(name) for name in parameters}
        self.quantities = dict[str, Gradient]()  # at the start

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._symbols)

    @property
    def symbols(self) -> ca.SX:
        return ca.vertcat(*self._symbols.values())

    def value(self, name: str) -> ca.SX:
        """The symbol of a name; raises AttributeError, with the accepted names, for one that there is not."""
        if name not in self._symbols:
            if self.solution is None:
                raise AttributeError(f"given {name!r}; {accepted_names(name, self._symbols)}")
            try:
                self.quantities[name] = self.solution.gradient(name, errors=False)  # type: ignore[attr-defined]
            except ValueError as error:
                raise AttributeError(str(error)) from None
            self._symbols[name] = ca.SX.sym(name)
        return self._symbols[name]

    def __getattr__(self, name: str) -> ca.SX:
        if name.startswith("__"):
            raise AttributeError(name)
        return self.value(name)


@dataclass(frozen=True, eq=False)
class LocatedSolution:
    """An equilibrium, an orbit or a solution of a boundary-value problem at a design.

    `numbers` are values of the symbols of its `expressions`, `derivatives` theirs by the parameters of designs `over`,
    shape (symbols, over), and `errors` those of both. `near` is the same at other values of these parameters, None
    where it is too far for Newton's method; `finer` on a finer discretisation, None on one that meets its tolerance.

    Attributes:
        solution: what is located, as a user has it.
    """

    solution: Any
    expressions: NamedNumbers
    over: tuple[str, ...]

    def gradients(self, errors: bool = False) -> dict[str, Gradient]:
        """The gradients of its quantities; their errors take most of the time, and are asked for at the end."""
        return {name: self.solution.gradient(name, errors=errors) for name in self.expressions.quantities}

    @cached_property
    def _gradients(self) -> dict[str, Gradient]:
        start = self.expressions.solution is self.solution
        return self.expressions.quantities if start else self.gradients()

    @property
    def values(self) -> Mapping[str, float]:
        """Values of parameters by name."""
        known: Mapping[str, float] = self.solution.parameters
        return known

    @cached_property
    def numbers(self) -> Array:
        known = {**self.values, **{name: one.value for name, one in self._gradients.items()}}
        return np.array([known[name] for name in self.expressions.names])

    def _table(self, known: Mapping[str, Mapping[str, float]], own: float) -> Array:
        """Derivatives of the numbers by the parameters of designs, or their errors; `own` that of a parameter."""
        found = np.zeros((len(self.expressions.names), len(self.over)))
        for row, name in enumerate(self.expressions.names):
            if name in known:
                found[row] = [known[name].get(parameter, 0.0) for parameter in self.over]
            elif name in self.over:
                found[row, self.over.index(name)] = own
        return found

    @cached_property
    def derivatives(self) -> Array:
        return self._table(self._gradients, 1.0)

    @property
    def _errors(self) -> Array:
        return self._table({name: one.errors for name, one in self.gradients(errors=True).items()}, 0.0)

    @cached_property
    def errors(self) -> tuple[Array, Array]:
        relative = max(self.solution.error, self.solution.parameter_error if self.solution.space.free else 0.0)
        known = self._gradients
        sizes = [abs(known[name].value) if name in known else 0.0 for name in self.expressions.names]
        return relative * np.array(sizes), self._errors

    finer: ClassVar[None] = None

    def near(self, values: Mapping[str, float]) -> Self | None:
        solution, own = self.solution, {n: v for n, v in values.items() if n in self.values}
        if not own:
            return self
        name, value = next(iter(own.items()))
        space = solution.space.branch_space(solution, name, value + (abs(value) or 1.0), (), None)
        if solution.is_equilibrium:
            space = replace(space, statics=space.statics.at({**space.statics.values, **own}))
        else:
            space = replace(space, statement=space.statement.with_parameters(**own))
        try:
            found = space.solution(space.start)
        except ArithmeticError:
            return None
        first: Any = self.expressions.solution
        if found.is_orbit and np.all(np.ptp(found.states, axis=0) <= SHRUNK * np.ptp(first.states, axis=0)):
            return None
        return replace(self, solution=found)


@dataclass(frozen=True, eq=False)
class LocatedPoint(LocatedSolution):
    """A special point at a design: its numbers are all parameters, that in which it was found among them."""

    solution: SpecialPoint

    def gradients(self, errors: bool = False) -> dict[str, Gradient]:
        return {self.solution.parameter: self.solution.gradient(errors=errors)}

    @cached_property
    def errors(self) -> tuple[Array, Array]:
        own = [self.solution.error if name == self.solution.parameter else 0.0 for name in self.expressions.names]
        return np.array(own), self._errors

    def near(self, values: Mapping[str, float]) -> Self | None:
        point = self.solution
        own = {n: v for n, v in values.items() if n in point.parameters and n != point.parameter}
        try:
            slopes = self._gradients[point.parameter]
            moved = sum(slopes[name] * (value - point.parameters[name]) for name, value in own.items())
            if point.kind == EDGE:
                found = _moved_edge(point, own)
            else:
                found = (_moved_rest if point.solution.is_equilibrium else _moved_orbit)(point, own, moved)
        except (ArithmeticError, RuntimeError, ValueError):
            return None
        return None if found is None else replace(self, solution=found)


def _moved_rest(point: SpecialPoint, values: Mapping[str, float], moved: float) -> SpecialPoint | None:
    """A special equilibrium at other parameters, its own off by about `moved`."""
    old, start = point.solution.point, point.solution.space
    space = replace(start, statics=start.statics.at({**start.statics.values, **values}))
    guess = np.append(old.z[:-1], old.z[-1] + moved / space.course.extent)
    found = locate_rest(space, point.kind, guess, 1j * point.frequency if point.kind == HOPF else None)
    if found is None:
        return None
    error = replace(found.point.error, parameter=found.error)
    angle = found.frequency if point.kind == HOPF else None
    there = old.marked(point.kind, problem=space.problem, z=found.resting, error=error, better=None, angle=angle)
    return special_point(space, space.solution(there))


def _moved_orbit(point: SpecialPoint, values: Mapping[str, float], moved: float) -> SpecialPoint | None:
    """A special orbit at other parameters, as `_moved_rest`."""
    old, start = point.solution.point, point.solution.space
    space = replace(start, statement=start.statement.with_parameters(**values))
    problem, z = space.levels.problem(old.problem.resolution).with_constants(old.problem.constants), old.z.copy()
    z[-1] += moved / (space.to - space.begins)
    near = replace(old, problem=problem, z=z, better=None)
    there = special_orbit(space, point.kind, near, critical_angle(point.kind, point.solution))
    return None if there is None else special_point(space, space.solution(there))


def _moved_edge(point: SpecialPoint, values: Mapping[str, float]) -> SpecialPoint | None:
    """The edge of a tongue at other parameters, followed in one after the other."""
    for name, value in values.items():
        if value != point.parameters[name]:
            last = point.curve(name, value).points[-1]
            if last.parameters[name] != value:
                return None
            point = SpecialPoint(EDGE, point.parameter, last.parameters, last.edge.error, last.orbit)
    return point


LocatedThing = LocatedSolution | FamilyOrbit


# What a user gives ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SolutionStart:
    """A special point, an equilibrium or an orbit that designs start from."""

    given: Any

    @property
    def free(self) -> dict[str, FreeNumber]:
        """The parameters that designs may change, by name; raises ValueError for what designs do not locate."""
        given = self.given
        if not isinstance(given, SpecialPoint):
            return {name: FreeNumber(value) for name, value in given.parameters.items() if name not in given.space.free}
        space: Any = given.solution.space
        if given.kind == EDGE:
            return {name: FreeNumber(given.parameters[name]) for name in parameters_of(space)}
        if space.connects == FAMILY or not given.has_curve or space.kind:
            accepted = "a fold, Hopf point, branch point, doubling or torus of a branch in a parameter, or an edge"
            raise ValueError(f"of: given a {given.kind}; accepted: {accepted}")
        names = [name for name in space.model.parameter_names if name != given.parameter]
        return {name: FreeNumber(given.parameters[name]) for name in names}

    def expressions(self, over: Sequence[str]) -> NamedNumbers:
        """Its quantities."""
        if isinstance(self.given, SpecialPoint):
            return NamedNumbers((*self.free, self.given.parameter), None)
        return NamedNumbers(tuple(self.free), self.given)

    def located(self, expressions: NamedNumbers, over: Sequence[str]) -> LocatedThing:
        """It, with its derivatives."""
        kind = LocatedPoint if isinstance(self.given, SpecialPoint) else LocatedSolution
        return kind(self.given, expressions, tuple(over))


def start_of(given: Any) -> SolutionStart | FamilyStart:
    """What a user gives, as designs start from it; raises TypeError for what they do not."""
    if isinstance(given, FamilyStart):
        return given
    if not isinstance(given, SpecialPoint | Solution):
        accepted = "a special point, an orbit or an equilibrium, or several: a list, or by name"
        raise TypeError(f"of: given {short_repr(given)}; accepted: {accepted}")
    if isinstance(given, Orbit) and given.space.is_family:
        return FamilyStart.of(given)
    return SolutionStart(given)
