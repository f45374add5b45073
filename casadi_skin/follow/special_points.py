"""Special points of a branch: folds, at which the continuation parameter turns back, and others.

Turns of the continuation parameter between two points of a branch, also two within one step.

Its rate is known at both ends, and at a place between where it comes near zero or changes much. Hermite curves through
two and through three of them differ by what bounds their errors; a stretch is divided until the rate has no root within
that bound, or one that is simple.

Special points of a family, which are located after it was followed: its folds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from casadi_skin.follow.point import PointSolver
from casadi_skin.model.result import Result
from casadi_skin.zero.kinds import DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.zero.settings import Point

if TYPE_CHECKING:
    from casadi_skin.follow.solution import Solution
from collections.abc import Sequence
from itertools import pairwise

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.zero.kinds import Unresolved

# Turns of the continuation parameter between two points of a branch, also two within one step -------------------------

TURN_WITHIN = 0.47  # of a stretch: where it is looked at; not the middle, where symmetric functions agree by accident
STEADY_RATE_RATIO = 0.5  # of the largest rate on a stretch: the least one for which nothing turns back within it
TURN_DEEPEST = 14  # divisions of a stretch
TURN_BOUND = 0.25  # of the largest difference of both curves: the error of the finer one
TURN_MARGIN = 0.05  # of the change of the rate on a stretch: is added, for errors that both curves have in common
STILL_RATE = 1e-9  # rate of a quantity that does not change
_NEAR_ENDS = 0.5 ** np.arange(7.0, 24.0, 2.0)
RATE_PLACES = np.concatenate([[0.0], _NEAR_ENDS[::-1], np.linspace(0.0, 1.0, 65)[1:-1], 1.0 - _NEAR_ENDS, [1.0]])


def turning(point_solver: PointSolver, before: Point, after: Point) -> list[tuple[Point, Point]]:
    """The parts of a stretch on each of which the quantity that is followed turns back once, in order."""
    return list(_turning(point_solver, before, after, 0))


def _turning(point_solver: PointSolver, before: Point, after: Point, depth: int) -> Iterator[tuple[Point, Point]]:
    turns = rate(before) * rate(after) < 0.0 and max(abs(rate(before)), abs(rate(after))) > STILL_RATE
    ends = _through(point_solver, [before, after])
    known = depth >= TURN_DEEPEST or (not turns and _steady(ends))
    middle = None if known else _between(point_solver, before, after, TURN_WITHIN)
    place = None if middle is None else _unsettled(ends, _through(point_solver, [before, middle, after]))
    if middle is None or place is None:
        if turns:
            yield before, after
        return
    divided = middle if place == TURN_WITHIN else _between(point_solver, before, after, place) or middle
    yield from _turning(point_solver, before, divided, depth + 1)
    yield from _turning(point_solver, divided, after, depth + 1)


def rate(point: Point) -> float:
    """Rate of the continuation parameter along the branch."""
    return float(point.tangent[point.problem.parameter_index])


def _between(point_solver: PointSolver, before: Point, after: Point, fraction: float) -> Point | None:
    """The point at a fraction of the way on the level of the second one, for the search alone."""
    correction, tangent = point_solver.corrected_along(before, after, fraction)
    if correction is None or tangent is None:
        return None
    return replace(after, z=correction.z, tangent=tangent, better=None, special="", walked=False)


def _through(point_solver: PointSolver, points: list[Point]) -> Polynomial:
    """The rate of the continuation parameter from 0 to 1, by the polynomial through values and rates at points."""
    problem = points[-1].problem
    index = problem.parameter_index
    z = [point.problem.prolong(point.z, problem) for point in points]
    t = [point.problem.prolong(point.tangent, problem) for point in points]
    row = point_solver.metric(problem, z[0]) * t[0]
    sigma = np.array([float(row @ (one - z[0])) for one in z])
    places, powers = sigma / sigma[-1], np.arange(2 * len(points))
    values = [one[index] - z[0][index] for one in z]
    rates = [one[index] / float(row @ one) * sigma[-1] for one in t]
    by_rate = powers * places[:, None] ** np.maximum(powers - 1, 0)
    matrix = np.vstack([places[:, None] ** powers, by_rate])
    return Polynomial(np.linalg.solve(matrix, np.concatenate([values, rates]))).deriv()


def _steady(found: Polynomial) -> bool:
    """Whether a rate is nowhere less than a share of its largest value, or vanishes throughout."""
    g = found(RATE_PLACES)
    size = np.abs(g)
    return bool(
        np.max(size) <= STILL_RATE or (np.all(g * g[0] > 0.0) and np.min(size) >= STEADY_RATE_RATIO * np.max(size))
    )


def _unsettled(coarse: Polynomial, fine: Polynomial) -> float | None:
    """The place to divide a stretch; None where the rate has no root, or a simple one, within the bounds."""
    g, missed = fine(RATE_PLACES), float(np.max(np.abs(fine(RATE_PLACES) - coarse(RATE_PLACES))))
    half = np.where(
        RATE_PLACES < TURN_WITHIN, RATE_PLACES / TURN_WITHIN, (RATE_PLACES - TURN_WITHIN) / (1.0 - TURN_WITHIN)
    )
    bound = TURN_BOUND * missed + TURN_MARGIN * float(np.ptp(g))
    sign = np.sign(g[0] if abs(g[0]) > STILL_RATE * np.max(np.abs(g)) else g[-1])  # a special point may be its start
    if g[0] * g[-1] < 0.0:
        shaky = (
            bound * 4.0 * np.abs(1.0 - 2.0 * half) / np.where(RATE_PLACES < TURN_WITHIN, TURN_WITHIN, 1.0 - TURN_WITHIN)
        )
        return None if np.all(np.sign(g[-1]) * fine.deriv()(RATE_PLACES) >= shaky) else TURN_WITHIN
    if np.all((sign * g > bound * 4.0 * half * (1.0 - half))[1:-1]):
        return None
    least = int(np.argmin(sign * g))
    return float(RATE_PLACES[least]) if sign * g[least] <= 0.0 < sign * fine(TURN_WITHIN) else TURN_WITHIN


FOLD_TOLERANCE = 1e-7  # of a step: the parameter is stationary there, so that it has twice the digits
TEST_ZERO_XTOL = 1e-11  # of a step, to which a zero of a test is found


class NotLocatedError(ArithmeticError):
    """A special point that the branch passes cannot be located; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class SpecialPoint(Result):
    """A special point of a branch, with the coefficient of its normal form.

    Attributes:
        kind: "fold"; of equilibria also "branch point" and "hopf"; of boundary-value problems "branch point"; of orbits
            whose stability was computed "period doubling", "torus" and "branch point", the first two also of problems
            whose conditions close their solutions; where they end "hopf", or "homoclinic" or "heteroclinic" where their
            period grows without bound, or "bound" where a bound of the problem is met.
        parameter: name of the continuation parameter.
        parameters: values of all parameters by name, and of the continuation parameter.
        error: estimated error of the continuation parameter.
        solution: the solution there.
        mu: value of mu, 0 or -1, at which another branch leaves a family.
    """

    kind: str
    parameter: str
    parameters: Mapping[str, float]
    error: float
    solution: Solution
    mu: float | None = None

    def __repr__(self) -> str:
        words = f", {self.criticality}" if self.has_criticality else ""
        words += "".join(f", loses its {what}" for what in self.lost)
        name = self.parameter
        return f"<{self.kind} at {name} = {self.parameters[name]:.12g} +- {self.error:.1e}{words}>"

    def __str__(self) -> str:
        """One line, as `repr`, also within other words."""
        return repr(self)

    @property
    def has_criticality(self) -> bool:
        """Whether the normal form is known and decides on which side the new branch is."""
        if self.kind not in (HOPF, DOUBLING, TORUS) or self.mu is not None:
            return False
        space: Any = self.solution.space
        if getattr(space, "periodic", self) is not None:
            return True
        closure, point = space.closure, self.solution.point
        return closure is not None and bool(closure.goes_on(point.problem, point.z))

    follow: ClassVar[Callable[..., Any]]
    """The `Branch` that leaves here: `casadi_skin.points.switch.switch`."""
    curve: ClassVar[Callable[..., Any]]
    """This point followed in a second parameter: `casadi_skin.points.curves.curve`."""
    normal_form: ClassVar[Callable[..., Any]]
    """The normal form, by projection: `casadi_skin.follow.normal_forms.critical`."""
    lost_symmetries: ClassVar[Callable[..., tuple[str, ...]]]
    """The symmetries that what leaves here lacks, in words: `casadi_skin.points.lost_symmetry.lost_at`."""

    @cached_property
    def _critical(self) -> Any:
        return self.normal_form()

    @property
    def vector(self) -> Any:
        """Critical eigenvector, of orbits Floquet vector at phase zero, shape (components of the state,).

        Raises ValueError where none is defined.
        """
        return self._critical.vector

    @cached_property
    def lost(self) -> tuple[str, ...]:
        """Symmetries that orbits of the branch that leaves at a branch point lack, in words."""
        return self.lost_symmetries()

    @property
    def frequency(self) -> float:
        """Imaginary part of the critical eigenvalues or Floquet exponents; raises ValueError where none is defined."""
        return float(self._critical.frequency)

    @property
    def coefficient(self) -> float:
        """Coefficient of the normal form.

        Of a Hopf point the first Lyapunov coefficient, of a fold the quadratic one, of a period doubling or a torus the
        cubic one (see `critical_orbits.normal_forms`). NaN where none is defined or known, as at a homoclinic end.
        """
        try:
            return float(self._critical.coefficient)
        except ValueError:  # of a kind without a normal form
            return math.nan

    @property
    def criticality(self) -> str:
        """Meaning of the coefficient: "supercritical", "subcritical" or "degenerate"; of a fold "quadratic".

        Empty where no normal form is known.
        """
        try:
            return str(self._critical.words)
        except ValueError:
            return ""


def check_second(point: SpecialPoint, parameter: str) -> None:
    """Raise ValueError where a special point is to be followed in the parameter that it was found in."""
    if parameter == point.parameter:
        solution = point.solution
        names = (name for name in solution.parameters if name not in (parameter, *solution.space.free))
        accepted = ", ".join(names) or "none"
        raise ValueError(f"parameter: given {parameter!r}, in which the {point.kind} was found; accepted: {accepted}")


def turns_between(before: Point, after: Point) -> bool:
    """Whether the continuation parameter turns back between two points."""
    return rate(before) * rate(after) < 0.0


def folds_between(point_solver: PointSolver, before: Point, after: Point) -> Iterator[Point]:
    """The points between two at which the continuation parameter turns back, in order; raises NotLocatedError."""
    yield from (fold_between(point_solver, *part) for part in turning(point_solver, before, after))


def fold_between(point_solver: PointSolver, before: Point, after: Point) -> Point:
    """The point between two at which the free parameter is stationary; raises NotLocatedError where none is found.

    It is located on one level of resolution: the errors of orbits at a held parameter, by which others are
    refined, are of no use beside a fold.
    """
    from scipy.optimize import brentq

    def rate_at(fraction: float) -> float:
        if fraction in (0.0, 1.0):
            return rate(after if fraction else before)
        tangent = point_solver.tangent_along(before, after, fraction)
        if tangent is None:
            raise _not_located(point_solver)
        return float(tangent[after.problem.parameter_index])

    root = float(brentq(rate_at, 0.0, 1.0, xtol=FOLD_TOLERANCE))
    point = point_solver.along(before, after, root) or point_solver.coarse_along(before, after, root)
    if point is None:
        raise _not_located(point_solver)
    return replace(point, special=FOLD)


class Place(NamedTuple):
    """A corrected point on the way between two, at a fraction of it, and the value of a test there."""

    fraction: float
    point: Point
    value: float


def zero_between(
    point_solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float], kind: str
) -> tuple[Place, Place, float]:
    """The zero of a test that changes its sign between two points, the place beside it, and its size at both ends.

    Raises NotLocatedError.
    """
    from scipy.optimize import brentq

    known = {0.0: Place(0.0, before, test(before)), 1.0: Place(1.0, after, test(after))}
    size = max(abs(end.value) for end in known.values())

    def value(fraction: float) -> float:
        if fraction not in known:
            point = point_solver.along(before, after, fraction)
            if point is None:
                raise NotLocatedError(f"a point of kind {kind} cannot be located: {point_solver.failure}")
            known[fraction] = Place(fraction, point, test(point))
        return known[fraction].value

    root = float(brentq(value, 0.0, 1.0, xtol=TEST_ZERO_XTOL))
    value(root)
    zero, beside = sorted(known.values(), key=lambda place: abs(place.fraction - root))[:2]
    return zero, beside, size


def _not_located(point_solver: PointSolver) -> NotLocatedError:
    why = point_solver.failure or "the equations are singular beside it"
    return NotLocatedError(f"the parameter turns back at a point that cannot be located: {why}")


# Special points of a family, which are located after it was followed: its folds --------------------------------------


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
                yield found if isinstance(found, Unresolved) else special_point(space, space.solution(found))
        except NotLocatedError as error:
            yield Unresolved(before.value(space.parameter), after.value(space.parameter), str(error), FOLD)
