"""Edges of tongues around a fold in the parameter: there both edges of a tongue, or of a window, meet and vanish.

Multipliers are functions of S and of the parameter. Where two mu meet, their discriminant vanishes, where one has a
value, as -1 or 0, its distance from that: an equation whose solutions `continuation` follows by arclength.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from typing import Any, Never

import numpy as np

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.family_changes import flow_error, tongues_on
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result
from casadi_skin.points.lost_symmetry import breaking_of, turns_of
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability.family_stability import orbit_state
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.multipliers import reduced_matrices
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.diagram import Place, StabilityDiagram, StabilityEdge
from casadi_skin.stability.tongues.find_changes import POWERS_BY_FRACTION
from casadi_skin.zero.family import Targets
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, EDGE, Unresolved
from casadi_skin.zero.problem import Array, Indices, Problem, Scalar, SingularError
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point

DIFFERENCE_STEP = 1e-3  # of the sizes: that of derivatives
LAST_NEWTON_STEP = 1e-7  # of the sizes: a step of Newton's method after which an edge is one
FARTHEST_FOLD_FACTOR = 4.0  # distances to the fold as foreseen, beyond which there is none
FOLD_SETTINGS = ContinuationSettings(
    parameter_max=FARTHEST_FOLD_FACTOR, tolerance=1e-6, first_step=0.1, max_step=0.5, max_parameter_step=0.2,
    min_step=1e-3, max_points=80, tiny_first=False, guard_distance=0.3, guard_angle=40.0, aim_angle=20.0,
)  # fmt: skip

Multipliers = Callable[[float, float], ComplexArray]


class NoFoldError(ArithmeticError):
    """The edge is not followed around a fold; the message gives the reason."""


@dataclass(frozen=True)
class Start:
    """An edge before a fold: its kind, S, mu, the parameter, and the distances to the fold in S and the parameter."""

    kind: str
    S: float
    mu: float
    value: float
    S_away: float
    away: float


@dataclass(frozen=True)
class Turn:
    """A fold of a curve of edges, and edges beyond it in order.

    Attributes:
        S, S_error, mu, value, error: S, mu and the parameter at the fold.
        beyond: S, mu and the parameter of each edge.
    """

    S: float
    S_error: float
    mu: float
    value: float
    error: float
    beyond: tuple[tuple[float, float, float], ...]


def turn(multipliers: Multipliers, rougher: Multipliers, start: Start) -> Turn:
    """Follow an edge around a fold ahead of it.

    Arguments:
        multipliers: gives all mu at an S and a value of the parameter; raises ArithmeticError where there is no orbit.
        rougher: the same with a larger tolerance, which shows the error.
        start: the edge before the fold.

    Raises:
        NoFoldError: there is no fold, or the edge is not followed around it.
    """
    problem = EdgeProblem(multipliers, start)
    solver = PointSolver(
        ExactLevels(problem, lambda problem: NewtonCorrector(problem, LAST_NEWTON_STEP)), FOLD_SETTINGS
    )
    points = _walked(solver, problem)
    turned = (k for k, pair in enumerate(itertools.pairwise(points)) if _rate(pair[0]) * _rate(pair[1]) < 0.0)
    last_before = next(turned, None)
    if last_before is None:
        raise NoFoldError("no fold of the edge is found")
    near = min(points[last_before : last_before + 2], key=lambda point: abs(_rate(point)))
    fold, coarse = (_fold(problem, near.z, factor * DIFFERENCE_STEP) for factor in (1.0, 2.0))
    S, value = problem.where(fold)
    noise = abs(EdgeProblem(rougher, start).test(fold) - problem.test(fold)) / abs(problem.slopes(fold)[1, 2])
    S_error = abs(start.S_away) * (abs(fold[0] - coarse[0]) + DIFFERENCE_STEP**2)
    error = abs(start.away) * (abs(fold[2] - coarse[2]) + noise)
    after = [(*problem.where(point.z), float(point.z[1])) for point in points[last_before + 1 :]]
    beyond = tuple((S, mu, value) for S, value, mu in after[-2:])
    return Turn(S, S_error, float(fold[1]), value, error, beyond)


def _walked(solver: PointSolver, problem: EdgeProblem) -> list[Point]:
    """Points from the start around the fold to beyond the value of the start; raises NoFoldError."""
    z = problem.begin
    row = np.array([0.0, 0.0, 1.0])
    try:
        correction = solver.levels.corrector(problem).correct(z, row, 0.0)
        if not correction.converged:
            raise NoFoldError(f"the edge is not found again: {correction.message}")
        tangent = solver.tangent(problem, correction.z, solver.factor(problem, correction.z, row))
        first = Point(problem, correction.z, tangent, ErrorEstimate(0.0, 0.0), FOLD_SETTINGS.first_step, 0)
        walk = ArclengthContinuation(solver, (first,))
        points = [first, *(point for point in walk if point.walked)]
    except SingularError as error:
        raise NoFoldError(str(error)) from error
    if walk.end is not End.RETURNED:
        raise NoFoldError(f"no fold of the edge is passed: {walk.detail or walk.end}")
    return points


def _rate(point: Point) -> float:
    return float(point.tangent[-1])


def _fold(problem: EdgeProblem, near: Array, difference: float) -> Array:
    """The fold near a point of the curve: there the test function vanishes with its derivative in S."""
    from scipy.optimize import root

    def conditions(x: Array) -> list[float]:
        z = np.array([x[0], near[1], x[1]])
        low, high = (problem.test(z + np.array([side * difference, 0.0, 0.0])) for side in (-1.0, 1.0))
        return [problem.test(z) / size, (high - low) / (2.0 * difference) / size]

    size = float(np.max(np.abs(problem.slopes(near)[1])))
    found = root(conditions, near[[0, 2]], tol=1e-12)
    x = found.x
    off = np.max(np.abs(found.fun))
    if not (off <= 1e-6 and np.max(np.abs(x - near[[0, 2]])) <= 1.0):
        raise NoFoldError("the fold of the edge is not located")
    z = np.array([x[0], near[1], x[1]])
    return np.array([x[0], problem.values(z)[0], x[1]])


def multipliers_of(family: Family, point: Point, moved: bool = False) -> ComplexArray:
    """All mu of an orbit of a family but the trivial one; if `moved` by as much as the error of the flow moves them."""
    whole, everywhere = family.whole, family.on_all_positions(point)
    state = orbit_state(everywhere)
    transition = whole.flow.transition(everywhere.problem, everywhere.z)
    symplectic = whole.coordinates.symplectic
    if symplectic:
        directions = whole.accelerations([state])
    else:  # the rate along the family of positions at phase zero, see `branch_sampler`
        problem, k = everywhere.problem, everywhere.problem.parameter_index
        q, change = (problem.sample(v, np.zeros(1))[0] for v in (everywhere.z, everywhere.tangent))
        S_rate = whole.coordinates.S_rate
        directions = whole.across((2.0 / S_rate * everywhere.z[k] * change + everywhere.tangent[k] * q)[None])
    matrix, error = transition.matrix[None], flow_error(transition)[None]
    reduced, errors = reduced_matrices(matrix, error, directions, symplectic)
    return np.asarray(np.linalg.eigvals(reduced[0, 0] + moved * errors[0, 0]).astype(complex))


class EdgeProblem(Problem):
    """Unknowns z = (s, mu, u) with S = start.S + s S_away and the parameter = start.value + u away.

    The equations are that mu is where multipliers meet, or the value that one has, and that they do.
    """

    resolution = 1
    states = 2

    def __init__(self, multipliers: Multipliers, start: Start) -> None:
        self._multipliers, self._start = multipliers, start
        self._last: tuple[Array, tuple[Array, Array]] | None = None

    @property
    def begin(self) -> Array:
        """The start."""
        return np.array([0.0, self._start.mu, 0.0])

    def where(self, z: Array) -> tuple[float, float]:
        """S and the parameter."""
        return self._start.S + float(z[0]) * self._start.S_away, self._start.value + float(z[2]) * self._start.away

    def values(self, z: Array) -> Array:
        """The place where multipliers meet, and the value that vanishes there."""
        mu = self._multipliers(*self.where(z))
        if self._start.kind != "complex":
            end = self._start.mu
            return np.array([end, float(mu[np.argmin(np.abs(mu - end))].real) - end])
        one, other = mu[np.argsort(np.abs(mu - z[1]))[:2]]
        return np.array([0.5 * (one + other).real, (0.25 * (one - other) ** 2).real])

    def test(self, z: Array) -> float:
        """The value that vanishes at an edge."""
        return float(self.values(z)[1])

    def slopes(self, z: Array) -> Array:
        """Derivatives of `values`, shape (2, 3), those in mu 0, by differences to one side."""
        found, here = np.zeros((2, 3)), self.values(z)
        for column in (0, 2):
            found[:, column] = (self.values(z + DIFFERENCE_STEP * np.eye(3)[column]) - here) / DIFFERENCE_STEP
        return found

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residuals and derivatives, the second equation relative to its largest derivative."""
        if self._last is None or not np.array_equal(self._last[0], z):
            try:
                values, slopes = self.values(z), self.slopes(z)
            except ArithmeticError as error:
                raise SingularError(str(error)) from error
            size = float(np.max(np.abs(slopes[1])))
            if not size > 0.0:
                raise SingularError("the multipliers do not depend on S and the parameter")
            matrix = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]) + slopes * np.array([[-1.0], [1.0 / size]])
            self._last = z.copy(), (np.array([z[1] - values[0], values[1] / size]), matrix.ravel(order="F"))
        residual, nonzeros = self._last[1]
        return residual.copy(), nonzeros.copy()

    # As continuations take it -----------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        return 3

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return np.tile(np.arange(2), 3), np.repeat(np.arange(3), 2)

    def index_of(self, scalar: Scalar) -> int:
        """Place of u among the unknowns; there is no Omega."""
        if scalar is Scalar.OMEGA:
            raise ValueError("an edge has no Omega among its unknowns")
        return 2

    def _equations(self) -> Never:
        raise NotImplementedError("edges are functions of orbits, not expressions")

    def prolong(self, z: Array, finer: Problem) -> Array:
        return z.copy()

    def parameter_size(self, z: Array) -> float:
        return 1.0

    def profile_change(self, z: Array, step: Array) -> float:
        return float(np.max(np.abs(step[:2])))

    def sample(self, z: Array, theta: Array) -> Array:
        return np.tile(z[:2], (np.size(theta), 1))

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        return 0.0

    def metric(self, z: Array, parameter_scale: float) -> Array:
        return np.ones(3)

    def rounding(self, z: Array) -> float:
        return DIFFERENCE_STEP**3

    def whereabouts(self, z: Array) -> str:
        S, value = self.where(z)
        return f"S = {S:.8g}, parameter = {value:.8g}"


# A family at other values of a parameter of its model, and its orbits near an edge of a tongue ------------------------

REAL_KIND = "real"  # kind of an edge at which a multiplier is 1
EDGE_OMEGA_RTOL = 1e-6  # relative difference of Omega: the orbit of an edge
OFFSET_FROM_EDGE = 1e-4  # of S: how far the orbits on both sides are, whose cubic is good to some 1e-13


def orbit_at_edge(branch: Branch, edge: StabilityEdge) -> Orbit:
    """The orbit at an edge; raises ArithmeticError with the reason where none is found, there or from both sides."""
    try:
        return _passing(branch, edge, edge.S, EDGE_OMEGA_RTOL)
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
        before, after = (
            _passing(branch, edge, edge.S * (1.0 + h), 2.0 * OFFSET_FROM_EDGE).point
            for h in (-OFFSET_FROM_EDGE, OFFSET_FROM_EDGE)
        )
        return Orbit(branch.space, along_curve(branch.space, before, after, edge.S))
    return None


def along_curve(space: SolutionSpace, before: Point, after: Point, S: float) -> Point:
    """The orbit at S by the curve from an orbit on one side to one on the other; raises ValueError without one."""
    curve, _ = space.point_solver.curve(before, after)
    index, value = space.target("S", S).unknown(after.problem)
    ((place, _),) = curve.crossings(index, [value])
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
    diagram = branch.stability_diagram
    edges = () if diagram is None else diagram.further if further else diagram.changes
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
    real = (edge for edge in (*diagram.changes, *diagram.further) if edge.kind == REAL_KIND and edge.mu in (-1.0, 0.0))
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


def _not_followed(localised: StabilityDiagram | None) -> Iterator[Unresolved]:
    """Places at which a localised multiplier is 1, of a family with an endless tail."""
    for change in () if localised is None else localised.all:
        if change.kind == REAL_KIND:
            words = "orbits that leave a family with an endless tail are not sought"
            yield Unresolved(change.S, change.S, words, EDGE)


SAME_PARAMETER_RTOL = 1e-12  # relative: values of the parameter that are one


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
        places = [S * (1.0 + h) for h in (-OFFSET_FROM_EDGE, OFFSET_FROM_EDGE)]
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
        sizes = np.ptp(places, axis=0) + SAME_PARAMETER_RTOL * np.abs(places[0])
        nearest = int(np.argmin(np.sum(((places - (S, value)) / sizes) ** 2, axis=1)))
        return list(self.known.values())[nearest]

    def multipliers(self, S: float, value: float) -> ComplexArray:
        """All mu but the trivial one; raises ArithmeticError where no orbit is found."""
        if value not in self.families:
            self.families[value] = self.family_at(value, S)
        self.known[S, value] = orbit_at(self.families[value], S, self.near(S, value))
        return multipliers_of(self.families[value], self.known[S, value])


# Edges of tongues of instability of a family, followed in a parameter of the model with S free ------------------------


@dataclass(frozen=True, eq=False)
class EdgePoint:
    """A point of a curve of edges.

    Attributes:
        orbit: of the family, at the edge.
        edge: its kind and place, with the error of S.
        parameters: of the model by name, and S.
        parameter_error: estimated error of the parameter that is followed, where that folds; 0 elsewhere.
    """

    orbit: Orbit
    edge: StabilityEdge
    parameters: Mapping[str, float]
    parameter_error: float = 0.0


@dataclass(frozen=True, eq=False)
class EdgeCurve(Result):
    """The edge of a tongue of a family in a second parameter.

    Attributes:
        parameter: that is followed.
        points: in order.
        end: reason for its end; None where it was stopped.
        detail: details of the reason.
        folded: numbers of the points at which the parameter folds, from 0.
    """

    parameter: str
    points: tuple[EdgePoint, ...]
    end: End | None
    detail: str = ""
    folded: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[EdgePoint]:
        return iter(self.points)

    def __getitem__(self, name: str) -> Array:
        """Values of a parameter, or of S, along the curve, shape (points,)."""
        return np.array([point.parameters[name] for point in self.points])

    def __repr__(self) -> str:
        values = self[self.parameter]
        return (
            f"<EdgeCurve: {len(self)} points, {self.parameter} from {values[0]:.6g} to {values[-1]:.6g}; {self.reason}>"
        )

    @property
    def kind(self) -> str:
        """Multipliers that leave the unit circle: "real" through 1 or -1, "complex" where two meet.

        Where the family crosses one of an m-th of its period "1:m resonance" of the shorter orbit, which points hold.
        """
        return self.points[0].edge.kind

    @property
    def solutions(self) -> tuple[Orbit, ...]:
        """The orbits at the edge."""
        return tuple(point.orbit for point in self.points)

    @property
    def folds(self) -> tuple[EdgePoint, ...]:
        """Points at which the parameter folds: there both edges of a tongue, or of a window between two, meet."""
        return tuple(self.points[number] for number in self.folded)

    @property
    def S(self) -> Array:
        """Amplitudes, shape (points,)."""
        return self["S"]

    @property
    def errors(self) -> Array:
        """Estimated errors of S, shape (points,)."""
        return np.array([point.edge.error for point in self.points])

    @property
    def complete(self) -> bool:
        """Whether the curve reached its requested end, came back beyond a fold or closed, or was stopped."""
        return self.end in (None, End.REACHED, End.AWAY, End.CLOSED)

    @property
    def reason(self) -> str:
        """The end of the curve, in a sentence."""
        words = "stopped where the condition holds" if self.end is None else str(self.end.value)
        return f"{words}: {self.detail}" if self.detail else words


EDGE_S_RTOL = 1e-6  # of S: within which the edge that a curve starts from is found again
FIRST_STEP_FRACTION = 0.02  # of the way: the first step
STEP_GROWTH = 1.8  # of a step whose edge was well extrapolated
WELL_EXTRAPOLATED_S, BADLY_EXTRAPOLATED_S = 1e-3, 1e-2  # of S: how far the edge may be from where it was extrapolated
WIDEST_HALF_STRETCH, NARROWEST_HALF_STRETCH = 0.02, 1e-5  # of S: half the stretch on which the edge is sought
ASIDE_FRACTION, UNEVEN_FRACTION = (
    0.4,
    0.8,
)  # of that half: where an orbit and an end are, as equations may be singular at an edge
ERRORS_AROUND_EDGE = 8.0  # times the error of the last extrapolation: the same
OTHER_EDGE_FRACTION = 0.3  # of the distance of another edge of the kind: how far the edge may be from the extrapolation
MU_CHANGE_PER_STEP = 0.05  # change of mu in a step
SHORTEST_STEP = 1e-5  # of the way: a step
NEAR_FOLD = 0.5  # of the distance to a fold: a step that is not taken there goes around it
FORESEEN_FOLD_FACTOR = 10.0  # times the way of the last edges: how far ahead a fold is foreseen
FINE_TOLERANCE, ROUGH_TOLERANCE = 1e-10, 1e-8  # tolerances of multipliers around a fold
EXTRAPOLATING_EDGES = 4  # edges that the next one is extrapolated from


def edge_curve(
    orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings,
    until: Callable[[Any], bool] | None, progress: Callable[[Any], None] | None, back_to: float | None,
    kind: type[EdgeWalk],
) -> EdgeCurve:  # fmt: skip
    """The edge of a tongue near S of a family, followed in a parameter (see `critical_orbits.curve.curve`).

    Raises ArithmeticError and ValueError where the edge is not found again.
    """
    walk = kind(orbit, S, parameter, float(to), at, settings, back_to)
    stopped = False
    for point in walk:
        if progress is not None:
            progress(point)
        stopped = until is not None and until(point)
        if stopped:
            break
    end, detail = (None, "") if stopped else (walk.end, walk.detail)
    return EdgeCurve(parameter, tuple(walk.points), end, detail, tuple(walk.folds))


class EdgeWalk:
    """Iterates over the points of a curve of edges; `folds` are the numbers of those at which the parameter folds."""

    def __init__(
        self, orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings,
        back_to: float | None,
    ) -> None:  # fmt: skip
        self._family, self._name, self._settings = orbit.space.whole, parameter, settings
        start = float(orbit.parameters[parameter])
        self._goal, self._other_goal = to, start if back_to is None else back_to
        self._to, self._span = to, to - start
        self._at = sorted(float(value) for value in at)
        self.points, self.folds = list[EdgePoint](), list[int]()
        self._trail = list[EdgePoint]()  # those since the last fold
        self.end: End | None = None
        self.detail = ""
        self._opens = False
        self._missed = WELL_EXTRAPOLATED_S
        for value in (to, self._other_goal):
            self.at_value(value, S)  # refused where the model has no such value
        self._first = self._found(start, S, self._guess(orbit), None)

    def __iter__(self) -> Iterator[EdgePoint]:
        yield self._kept(self._first)
        step = FIRST_STEP_FRACTION * self._span
        while len(self.points) < self._settings.max_points:
            here = self.points[-1].parameters[self._name]
            if here == self._goal:
                self._ended()
                return
            way = np.sign(self._goal - here)
            ahead = [value for value in (*self._at, self._goal) if (value - here) * way > 0.0]
            target = min(ahead, key=lambda value: abs(value - here))
            value = target if abs(target - here) <= 1.01 * abs(step) else here + step
            found = self._stepped(value)
            if found is None:
                around = self._around_fold(value)
                if around:
                    step = 0.5 * (around[-1].parameters[self._name] - around[-2].parameters[self._name])
                    yield from around
                    continue
                step = 0.5 * (value - here)
                if abs(step) < SHORTEST_STEP * abs(self._span):
                    self.end = End.NO_STEP
                    return
                continue
            well = self._missed <= WELL_EXTRAPOLATED_S * found.edge.S
            longest = self._settings.max_step * abs(self._span)
            step = (STEP_GROWTH if well else 0.7) * max(abs(value - here), abs(step) if well else 0.0)
            step = float(way * min(step, longest))
            yield self._kept(found)
        self.end, self.detail = End.POINTS, f"{self._settings.max_points} points"

    def _ended(self) -> None:
        """Set the end of a curve that has come to its goal."""
        first, last = self.points[0], self.points[-1]
        closed = len(self.points) > 1 and first.parameters[self._name] == last.parameters[self._name]
        if self._goal == self._to:
            self.end = End.REACHED
        elif closed and abs(last.edge.S - first.edge.S) <= EDGE_S_RTOL * first.edge.S:
            self.end = End.CLOSED
        else:
            self.end = End.AWAY
        self.detail = ""

    # Around folds -----------------------------------------------------------------------------------------------------

    def _around_fold(self, value: float) -> list[EdgePoint]:
        """A fold before a value of the parameter and points beyond it, which are kept; none where there is no fold."""
        away = self._fold_ahead()
        if away is None or abs(value - self.points[-1].parameters[self._name]) < NEAR_FOLD * abs(away[1]):
            return []
        last, count = self.points[-1], len(self.points)
        start = Start(last.edge.kind, last.edge.S, last.edge.mu, last.parameters[self._name], *away)
        try:
            orbits = Orbits(partial(self.at_value, tolerance=FINE_TOLERANCE), last.orbit.point)
            rougher = replace(orbits, family_at=partial(self.at_value, tolerance=ROUGH_TOLERANCE), families={})
            found = turn(orbits.multipliers, rougher.multipliers, start)
            self._opens = not self._opens
            self._kept(self._at_fold(found, orbits.near(found.S, found.value)))
            self.folds.append(count)
            for S, mu, there in found.beyond:
                self._missed = WELL_EXTRAPOLATED_S
                self._kept(self._found(there, S, orbits.near(S, there), mu))
            self._missed = WELL_EXTRAPOLATED_S
        except (ArithmeticError, ValueError, RuntimeError) as error:
            if len(self.points) > count:
                del self.points[count:], self.folds[-1:]
                self._opens = not self._opens
            self.detail = f"around a fold near {self._name} = {start.value:.8g}, S = {start.S:.8g}: {error}"
            return []
        self._trail = self.points[count + 1 :]
        self._goal, self._other_goal = self._other_goal, self._goal
        return self.points[count:]

    def _fold_ahead(self) -> tuple[float, float] | None:
        """Differences of S and of the parameter to a fold, by the parabola through the last edges; None without one."""
        if len(self._trail) < 3:
            return None
        S = np.array([point.edge.S for point in self._trail[-3:]])
        values = np.array([point.parameters[self._name] for point in self._trail[-3:]])
        curvature, slope, _ = np.polyfit(S - S[-1], values - values[-1], 2)
        with np.errstate(all="ignore"):
            S_away, away = -0.5 * slope / curvature, -0.25 * slope**2 / curvature
        onwards = S_away * (S[-1] - S[-2]) > 0.0 and away * (values[-1] - values[-2]) > 0.0
        near = abs(away) < FORESEEN_FOLD_FACTOR * abs(values[-1] - values[0])
        return (float(S_away), float(away)) if onwards and near else None

    def _at_fold(self, found: Turn, guess: Point) -> EdgePoint:
        """The fold as a point of the curve."""
        last, family = self.points[-1], self.at_value(found.value, found.S)
        orbit = Orbit(family, orbit_at(family, found.S, guess))
        place = replace(last.edge.place, coordinate_error=0.0, S=found.S, S_error=found.S_error, Omega=orbit.Omega)
        edge = replace(last.edge, place=place, mu=found.mu, width=0.0)
        return EdgePoint(orbit, edge, {**orbit.parameters, "S": found.S}, found.error)

    def _guess(self, orbit: Orbit) -> Any:
        """The orbit that a curve starts from."""
        return orbit.space.on_all_positions(orbit.point)

    # Points -----------------------------------------------------------------------------------------------------------

    def _kept(self, point: EdgePoint) -> EdgePoint:
        self.points.append(point)
        self._trail.append(point)
        return point

    def _stepped(self, value: float) -> EdgePoint | None:
        """The edge at a value of the parameter; None, with `detail` set, where it is not found for certain."""
        S = float(self._extrapolated(value, [point.edge.S for point in self._trail]))
        mu = float(self._extrapolated(value, [point.edge.mu for point in self._trail]))
        last = self.points[-1]
        level = last.orbit.point.problem.resolution
        known: list[Array] = [
            point.orbit.point.z
            for point in self._trail[-EXTRAPOLATING_EDGES:]
            if point.orbit.point.problem.resolution == level
        ]
        guess = replace(last.orbit.point, z=np.asarray(self._extrapolated(value, known)))
        try:
            return self._found(value, S, guess, mu)
        except (ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError) as error:
            here = f"{self._name} = {last.parameters[self._name]:.8g}, S = {last.edge.S:.8g}, mu = {last.edge.mu:.6g}"
            self.detail = f"beyond {here}: {error}"
            return None

    def _extrapolated(self, value: float, known: Sequence[Any]) -> Any:
        """Value of the polynomial through the last points at a value of the parameter."""
        count = min(len(known), EXTRAPOLATING_EDGES)
        places = np.array([point.parameters[self._name] for point in self._trail[-count:]])
        total = 0.0 * np.asarray(known[-1])
        for k, entry in enumerate(known[-count:]):
            others = np.delete(places, k)
            total = total + float(np.prod((value - others) / (places[k] - others))) * np.asarray(entry)
        return total

    def _found(self, value: float, S: float, guess: Point, mu: float | None) -> EdgePoint:
        """The edge near S at a value of the parameter; raises ArithmeticError where none is found for certain."""
        if not S > 0.0:
            raise ArithmeticError("S comes to 0")
        family = self.at_value(value, S)
        half = S * float(np.clip(ERRORS_AROUND_EDGE * self._missed, NARROWEST_HALF_STRETCH, WIDEST_HALF_STRETCH))
        center = orbit_at(family, S + ASIDE_FRACTION * half, guess)
        ends = [beside(family, center, S + side * half) for side in (-1.0, UNEVEN_FRACTION)]
        diagram = tongues_on(family, [ends[0], center, ends[1]])
        if diagram.unresolved:
            raise FlowError(diagram.unresolved[0].reason)
        edge = self._nearest(diagram, S, mu)
        self._missed = abs(edge.S - S) / S if mu is not None else WELL_EXTRAPOLATED_S
        self._opens = _opens(diagram, edge)
        if abs(edge.S - S) > half:
            raise ArithmeticError("the edge is farther from where it is expected than the step allows")
        point = orbit_of_edge(family, edge.S, center)
        values = {**family.parameters(point), "S": edge.S}
        return EdgePoint(Orbit(family, point), edge, values)

    def _nearest(self, diagram: StabilityDiagram, S: float, mu: float | None) -> StabilityEdge:
        """The edge that a curve goes on with; raises ArithmeticError where there is none, or it may be another one."""
        edges = [*diagram.changes, *diagram.further]
        if mu is None:
            nearest = min(edges, key=lambda edge: abs(edge.S - S), default=None)
            if nearest is None or abs(nearest.S - S) > EDGE_S_RTOL * S:
                raise ArithmeticError("the edge is not found again")
            return nearest
        last = self.points[-1].edge
        alike = [e for e in edges if e.kind == last.kind and abs(e.mu - mu) <= MU_CHANGE_PER_STEP]
        same = [e for e in alike if _opens(diagram, e) == self._opens]
        if not same:
            raise ArithmeticError("the edge is not found: its tongue closes, meets another one, or passes S too fast")
        nearest = min(same, key=lambda edge: abs(edge.S - S))
        others = [abs(edge.S - nearest.S) for edge in same if edge is not nearest]
        if abs(nearest.S - S) > min([BADLY_EXTRAPOLATED_S * S, *(OTHER_EDGE_FRACTION * other for other in others)]):
            raise ArithmeticError("the edge cannot be distinguished from another one")
        return nearest

    def at_value(self, value: float, S: float, tolerance: float | None = None) -> Family:
        """The family at a value of the parameter, to somewhat beyond S."""
        return family_at(self._family, self._name, value, S, tolerance)


def _opens(diagram: StabilityDiagram, edge: StabilityEdge) -> bool:
    """Whether an edge is the one at which its tongue starts, in the order of S."""
    assert edge.tongue is not None
    start, place = diagram.tongues[edge.tongue].start, edge.place
    return abs(start.coordinate - place.coordinate) <= start.coordinate_error + place.coordinate_error


# Edges that coincide where a family crosses one of an m-th of its period, followed as its resonance -------------------

CROSSING_S_RTOL = 1e-6  # of S: within which the crossing that a curve starts from is found again
SECANT_OFFSET = 1e-4  # of S: the second place of the secant method
SOLVED_S_RTOL = 1e-13  # of S
LONGEST_CROSSING_MOVE = 0.02  # of S: how far a crossing may be from where it is expected
REAL_MU_ATOL = 1e-9  # imaginary part of a mu that is real


class CrossingWalk(EdgeWalk):
    """Iterates over the orbits of the shorter period whose multipliers are roots of 1 or -1, along a parameter."""

    def __init__(self, orbit: Orbit, *arguments: Any) -> None:
        self._turns, self._target = turns_of(orbit), np.nan
        super().__init__(orbit, *arguments)

    def _guess(self, orbit: Orbit) -> Point:
        """The orbit of the shorter period; the multiplier that decides is the one nearest to a root."""
        family = orbit.space.whole
        point = orbit_at(family, orbit.S, shortened(super()._guess(orbit), self._turns))
        mu = multipliers_of(family, point)
        angles = np.arccos(1.0 + 2.0 * np.clip(mu[np.abs(mu.imag) <= REAL_MU_ATOL].real, -1.0, 0.0))
        roots = np.pi * np.arange(1, self._turns) / self._turns
        nearest = roots[np.argmin(np.min(np.abs(roots[:, None] - angles), axis=1, initial=np.inf))]
        self._target = -(float(np.sin(0.5 * nearest)) ** 2)
        return point

    def _found(self, value: float, S: float, guess: Point, mu: float | None) -> EdgePoint:
        """The crossing near S at a value of the parameter; raises ArithmeticError where none is found for certain."""
        from scipy.optimize import newton

        fine, near = self.at_value(value, S, FINE_TOLERANCE), guess

        def off(at: float) -> float:
            nonlocal near
            near = orbit_at(fine, float(at), near)
            return self._off(fine, near)

        if not S > 0.0:
            raise ArithmeticError("S comes to 0")
        beside = S * (1.0 + SECANT_OFFSET)
        slope = (off(beside) - off(S)) / (beside - S)
        found = float(newton(off, S, x1=beside, tol=SOLVED_S_RTOL * S))
        if not abs(found - S) <= (CROSSING_S_RTOL if mu is None else LONGEST_CROSSING_MOVE) * S:
            raise ArithmeticError("the crossing is farther from where it is expected than the step allows")
        self._missed = WELL_EXTRAPOLATED_S if mu is None else abs(found - S) / S
        orbit = Orbit(fine, orbit_at(fine, found, near))
        error = abs(self._off(fine, orbit.point, moved=True) / slope) + SOLVED_S_RTOL * found
        place = Place(0.0, 0.0, found, float(error), orbit.Omega)
        kind, power = f"1:{self._turns} resonance", POWERS_BY_FRACTION[fine.symmetry.value]
        edge = StabilityEdge(place, kind, self._target, (), False, False, power)
        return EdgePoint(orbit, edge, {**fine.parameters(orbit.point), "S": found})

    def _off(self, family: Family, point: Point, moved: bool = False) -> float:
        """Difference of the nearest mu to the one of the resonance."""
        away = multipliers_of(family, point, moved) - self._target
        nearest = away[np.argmin(np.abs(away))]
        if abs(nearest.imag) > REAL_MU_ATOL:
            raise ArithmeticError("the multipliers of the resonance leave the unit circle")
        return float(nearest.real)


def shortened(point: Point, turns: int) -> Point:
    """A guess of the orbit of a shorter period that an orbit of a family runs through several times."""
    problem, z = point.problem, point.z.copy()
    z[: problem.states] = problem.of_shorter_period(z, turns)
    z[problem.Omega_index] *= turns
    return replace(point, z=z, better=None)
