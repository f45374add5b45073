"""Edges of tongues of a family: the orbits there, what leaves it, and curves of edges in a parameter of the model.

At an edge multipliers meet, or one has a value, as -1 or 0: one equation in S and the parameter, whose curve is
followed by arclength. Where both edges of a tongue, or of a window, meet and vanish, the parameter folds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.family_changes import flow_error, tongues_on
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import FOLD_TOLERANCE, SpecialPoint, folds_between
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result
from casadi_skin.points.lost_symmetry import breaking_of, shortened, turns_of
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability.family_stability import orbit_state
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.multipliers import POWERS_BY_FRACTION, orthogonal_complements, reduced_matrices
from casadi_skin.stability.reduction import blocks_of
from casadi_skin.stability.tongues.diagram import Place, StabilityEdge
from casadi_skin.zero.family import Targets
from casadi_skin.zero.kinds import EDGE, KINDS_BY_TURNS, Unresolved
from casadi_skin.zero.problem import Array, Indices, Scalar, SingularError
from casadi_skin.zero.rest import Course, Undiscretised
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point, Target

# Orbits at edges, and the special points of a family there ------------------------------------------------------------

REAL_KIND, COMPLEX_KIND = "real", "complex"  # kinds of an edge: a multiplier is 1, or two meet
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
    curve, length = space.point_solver.curve(before, after)
    if length < 0.0:  # tangents point the other way
        before, after = after, before
        curve, _ = space.point_solver.curve(before, after)
    index, value = space.target("S", S).unknown(after.problem)
    ((place, _),) = curve.crossings(index, [value])
    tangent = curve.slope(place) * np.linalg.norm(after.tangent) / np.linalg.norm(curve.slope(place))
    one, other = before.error, after.error
    error = replace(other, Omega=one.Omega + other.Omega, profile=one.profile + other.profile)
    return replace(after, z=curve.at(place), tangent=tangent, error=error, better=None)


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
        words, localised = "orbits that leave a family with an endless tail are not sought", branch.localised_diagram
        places = () if localised is None else localised.all  # at which a localised multiplier is 1, some of them
        yield from (Unresolved(one.S, one.S, words, EDGE) for one in places if one.kind == REAL_KIND)
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
            kind, values = KINDS_BY_TURNS[breaking.turns], {**orbit.parameters, "S": edge.S}
            yield SpecialPoint(kind, branch.space.parameter, values, edge.error, orbit, edge.mu)


def parameters_of(family: Family) -> tuple[str, ...]:
    """Names of the parameters of a family's model in which its edges can be followed."""
    model, names = family.request.model, tuple(family.coordinates.parameters)
    if isinstance(model, OdeModel):
        return names
    known: list[str] = [f.name for f in fields(model)] if is_dataclass(model) else []
    return tuple(name for name in names if name in known)


def family_at(family: Family, parameter: str, value: float) -> Family:
    """The family at a value of a parameter, in the same units; raises ValueError where the model has no such value."""
    request = family.request
    method = replace(request.method, corrector="newton")
    changed: dict[str, Any] = {"targets": Targets(), "tolerance": FINE_TOLERANCE, "method": method}
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


def beside(family: Family, point: Point, S: float) -> Point:
    """A guess at another S along the tangent of a point."""
    index = point.problem.parameter_index
    moved = (family.coordinates.parameter_of(S) - point.parameter) / point.tangent[index]
    return replace(point, z=point.z + moved * point.tangent, better=None)


def flow_along(family: Family, point: Point) -> tuple[Array, Array, Array]:
    """Phi along an orbit, a matrix like its error, and q'' at phase zero, which K does not see (see `multipliers`)."""
    whole, everywhere = family.whole, family.on_all_positions(point)
    transition = whole.flow.transition(everywhere.problem, everywhere.z)
    return transition.matrix, flow_error(transition), whole.accelerations([orbit_state(everywhere)])[0]


def mu_of(flow: Array, direction: Array) -> Any:
    """The mu of Phi, shape (2n, 2n), without the trivial one."""
    K, _ = reduced_matrices(flow[None], np.zeros_like(flow[None]), direction[None], symplectic=False)
    return np.linalg.eigvals(K[0, 0])


@dataclass(frozen=True)
class Condition:
    """The function that vanishes at an edge, as it is of Phi, near one.

    Attributes:
        mean: of the mu that meet.
        value: of the function.
        a, b: at the edge dPhi changes it by the sum of a^T dPhi b over columns, shape (2n, any) each.
        null: n, where two meet by a form; all coordinates.
    """

    mean: float
    value: float
    a: Array
    b: Array
    null: Array | None = None


# Edges followed in a parameter of the model with S free: one equation in both -------------------------------

DIFFERENCE_STEP = 2e-4  # of S and of the way of the parameter: that of derivatives; not the offset of orbits
SAME_SLOPES = 1e-7  # of these: a distance within which derivatives are the same
BEND_STEP = 1e-3  # of S: that of a second derivative
LAST_NEWTON_STEP = 1e-8  # of these: a step of Newton's method after which an edge is one
FIRST_STEP, SHORTEST_STEP = 0.05, 1e-5  # of these, along the curve
FINE_TOLERANCE = 1e-10  # of the families at other values of the parameter
KEPT_ORBITS, KEPT_FAMILIES = 40, 12  # orbits that the next ones are solved from; families
EDGE_S_RTOL = 1e-6  # of S: within which the edge that a curve starts from is found again
HALF_STRETCH = 8e-3  # of S: half the stretch on which it is sought
ASIDE_FRACTION, UNEVEN_FRACTION = 0.4, 0.8  # of that: where an orbit and an end are, off places that are singular
EQUAL_MU_DISTANCE = 1e-6  # between mu that pass a real edge together, as those that a symmetry makes equal
REAL_MU_ATOL = 1e-9  # imaginary part of a mu that is real
EQUAL_PAIRS_DISTANCE = 1e-4  # between those of several pairs that collide together


class EdgeProblem(Undiscretised):
    """Unknowns z = (S / S0, mu, u), where the parameter goes from its start to its end as u goes from 0 to 1.

    The equations are that mu is the mean of those that meet, of which there are `count`, and with an orthonormal basis
    V of the invariant space of K that belongs to them

        trace V^T P V = 0                   where they pass 0 or -1: by P or Q, whichever vanishes,
        n^T P K n = 0 with n^T P n = 0      where two meet, n in the space of V: by P and K, or Q and K^T.

    These zeros are simple however narrow a tongue is (see `stability.tongues.pairs`); of both n it is that nearest to
    n at the nearest orbit known. Without P and Q, of more mu, and at an extremum of the energy, where the trivial mu is
    one of them, their distance from the edge's mu, or their variance where they meet, vanishes instead.
    """

    states = 2

    def __init__(
        self, orbit: Orbit, course: Course, exact: Iterable[float], edge: StabilityEdge, beside: Point
    ) -> None:
        self.edge, self._family, self._course, self._S = edge, orbit.space.whole, course, edge.S
        breaking = breaking_of(orbit, edge.mu) if edge.kind == REAL_KIND else None
        self.crossed = breaking is not None and not breaking.lost and breaking.turns == 1
        self._exact = {course.fraction(value): value for value in exact}
        self._families, self._last = dict[float, Family](), dict[bytes, tuple[Array, Array]]()
        self._known: dict[tuple[float, float], tuple[Point, Array | None]]
        self._known = {(self._family.request.S_of(beside.parameter) / edge.S, 0.0): (beside, None)}
        self._meet, self._form = edge.kind == COMPLEX_KIND, 0
        self._trivial = -1.0 if POWERS_BY_FRACTION[self._family.flow.fraction] == 2 else 0.0
        here = self.orbit(self.begin)
        flow, _, direction = flow_along(here.space, here.point)
        near = EQUAL_PAIRS_DISTANCE if self._meet else EQUAL_MU_DISTANCE
        self.count = max(1 + self._meet, int(np.sum(np.abs(mu_of(flow, direction) - edge.mu) <= near)))
        if self._family.coordinates.symplectic and breaking is not None:
            self._form = 1 if breaking.block in "AC" else 2
        elif self._family.coordinates.symplectic and self._meet and self.count == 2:
            forms = [upper.T @ lower for *_, upper, lower in (self._along(flow, direction, edge.mu, k) for k in (1, 2))]
            self._form = 1 + int(np.argmin([np.linalg.det(P) / np.sum(P**2) for P in forms]))

    @property
    def begin(self) -> Array:
        """The start."""
        return np.array([1.0, self.edge.mu, 0.0])

    def where(self, z: Array) -> tuple[float, float]:
        """S and the parameter."""
        return self._S * float(z[0]), float(self._exact.get(float(z[2]), self._course.at(float(z[2]))))

    def _family_at(self, value: float) -> Family:
        if value not in self._families:
            self._families[value] = family_at(self._family, self._course.name, value)
            _keep_last(self._families, KEPT_FAMILIES)
        return self._families[value]

    def orbit(self, z: Array) -> Orbit:
        """The orbit at z; raises ArithmeticError where none is found, ValueError where the model has no such value.

        Where another branch of the same class crosses it is on the curve from one side to the other.
        """
        S, value = self.where(z)
        if not S > 0.0:
            raise ArithmeticError("S comes to 0")
        family, (near, _) = self._family_at(value), self._nearest(z)
        if not self.crossed:
            return Orbit(family, orbit_at(family, S, beside(family, near, S)))
        sides = (S * (1.0 + h) for h in (-OFFSET_FROM_EDGE, OFFSET_FROM_EDGE))
        before, after = (orbit_at(family, side, beside(family, near, side)) for side in sides)
        return Orbit(family, along_curve(family, before, after, S))

    def _nearest(self, z: Array) -> tuple[Point, Array | None]:
        """The nearest of the orbits known, with its n."""
        places = np.array(list(self._known))
        return list(self._known.values())[int(np.argmin(np.sum((places - z[[0, 2]]) ** 2, axis=1)))]

    def values(self, z: Array, errors: bool = False) -> Array:
        """The mean of mu and the function that vanishes; with `errors` this with those of flow and orbit, too."""
        place, (_, before) = (float(z[0]), float(z[2])), self._nearest(z)
        orbit = self.orbit(z)
        point = orbit.point
        flow, error, direction = flow_along(orbit.space, point)
        here = self.condition(flow, direction, z[1], before)
        self._known[place] = point, here.null
        _keep_last(self._known, KEPT_ORBITS)
        if not errors:
            return np.array([here.mean, here.value])
        finer = point.better or point
        others = flow_along(orbit.space, replace(point, problem=finer.problem, z=finer.z, better=None))
        moved = [self.condition(*one, z[1], here.null).value for one in ((flow + error, direction), others[::2])]
        return np.array([here.mean, here.value, *moved])

    def _space(self, K: Any, mu: float, meeting: int | None = None) -> Array:
        """An orthonormal basis of the invariant space of the mu that meet, near one, shape (m, meeting)."""
        from scipy.linalg import schur

        away, meeting = np.sort(np.abs(np.linalg.eigvals(K) - mu)), meeting or self.count
        within = 0.5 * (away[meeting - 1] + away[meeting]) if away.size > meeting else np.inf

        def meets(real: float, imaginary: float = 0.0) -> bool:
            return bool(abs(real + 1j * imaginary - mu) < within)

        _, vectors, count = schur(K, sort=meets)
        if count != meeting:
            raise ArithmeticError("the multipliers that meet cannot be distinguished from others")
        return np.asarray(vectors[:, :count])

    def _along(self, flow: Array, direction: Array, mu: float, form: int) -> tuple[float, Array, Array, Array]:
        """The mean of mu; a basis V of the right space of K, or of the left one; A V and C V, or B V and D V."""
        A, B, C, D = blocks_of(flow)
        K, unit = B.T @ C if form == 1 else C.T @ B, direction / np.linalg.norm(direction)
        frame = orthogonal_complements(direction[None])[0]
        own = frame.T @ K @ frame
        V = self._space(own, mu)
        mean, V = float(np.trace(V.T @ own @ V)) / self.count, frame @ V
        distance = mu - self._trivial
        if form == 2 and abs(distance) > EQUAL_MU_DISTANCE:  # with what left vectors have along the trivial direction
            V = V + np.outer(unit, unit @ K @ V / distance)
        upper, lower = (A, C) if form == 1 else (B, D)
        return mean, V, upper @ V, lower @ V

    def condition(self, flow: Array, direction: Array, mu: float, before: Array | None = None) -> Condition:
        """The function that vanishes, of Phi and q'' at phase zero, and how it changes with Phi at the edge.

        Of P or Q dV and dn are not seen there. Where two meet, n^T P K n = l^T K r changes by l^T dK r, with r = n and
        l = P n, or l = n and r = Q n, and K = -(Phi^-1)_12 C changes with Phi as matrices do. Without them K is not
        reduced, and the trivial mu is taken with those that it meets: at an extremum of the energy, in a Jordan block.
        """
        n, C, null = len(direction), blocks_of(flow)[2], None
        K = -np.linalg.solve(flow, np.vstack([np.zeros_like(C), C]))[:n]
        if self._form:
            mean, V, upper, lower = self._along(flow, direction, mu, self._form)
            P, first = 0.5 * (upper.T @ lower + lower.T @ upper), self._form == 1
            if not self._meet:
                start = np.vstack([V, 0.0 * V] if first else [0.0 * V, V])
                return Condition(mean, float(np.trace(P)), np.vstack([lower, upper]), start)
            (low, high), axes = np.linalg.eigh(P)
            if not low < 0.0 < high:
                raise ArithmeticError("the multipliers that meet have signatures that are not opposite")
            both = axes @ (np.sqrt([[high], [-low]]) * [[1.0, 1.0], [1.0, -1.0]])
            both = both / np.linalg.norm(both, axis=0)
            here, there = V @ both, blocks_of(flow)[0 if first else 1].T @ lower @ both
            left, right = (there, here) if first else (here, there)
            found = np.sum(left * (K @ right), axis=0)
            k = int(np.argmin(np.abs(found)) if before is None else np.argmax(np.abs(before @ here)))
            value, left, right, null = float(found[k]), left[:, [k]], right[:, [k]], here[:, k]
        else:
            trivial = int(abs(mu - self._trivial) <= EQUAL_MU_DISTANCE)
            count = self.count + trivial
            right, left = self._space(K, mu, count), self._space(K.T, mu, count)
            left = left @ np.linalg.inv(right.T @ left)
            own = left.T @ K @ right
            mean = float(np.trace(own) - trivial * self._trivial) / self.count
            off = own - (mean if self._meet else self.edge.mu) * np.eye(count)
            value = float(np.trace(off @ off) / 2.0 if self._meet else np.trace(off))
            left = left @ off.T if self._meet else left
        back = np.linalg.solve(flow.T, np.vstack([left, 0.0 * left]))
        ahead = np.linalg.solve(flow, np.vstack([0.0 * right, C @ right]))
        a, b = [back, np.vstack([0.0 * left, -back[n:]])], [ahead, np.vstack([right, 0.0 * right])]
        return Condition(mean, value, np.hstack(a), np.hstack(b), null)

    def linear(self, z: Array) -> tuple[Array, Array]:
        """`values` and their derivatives by S and u, shape (2, 2), by differences; raises SingularError.

        Those by u are to the side that is within the way, as the model may accept nothing beyond it.
        """
        key = z.tobytes()
        if key not in self._last:
            beside = (s for x, (_, s) in self._last.items() if np.max(np.abs(np.frombuffer(x) - z)) <= SAME_SLOPES)
            try:
                here = self.values(z)
                slopes = next(beside, None)
                self._last[key] = here, self._slopes(z, here) if slopes is None else slopes
            except (ArithmeticError, ValueError, RuntimeError) as error:
                raise SingularError(str(error)) from error
            _keep_last(self._last, KEPT_ORBITS)
        return self._last[key]

    def _slopes(self, z: Array, here: Array) -> Array:
        h, (in_S, _, in_u) = DIFFERENCE_STEP, np.eye(3)
        inwards = h if z[2] < 0.5 else -h
        by_u = (self.values(z + inwards * in_u) - here) / inwards
        return np.column_stack([(self.values(z + h * in_S) - self.values(z - h * in_S)) / (2.0 * h), by_u])

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residuals and derivatives, the second equation relative to its largest derivative."""
        (mu, value), slopes = self.linear(z)
        size = float(np.max(np.abs(slopes[1])))
        if not size > 0.0:
            raise SingularError("the multipliers do not depend on S and the parameter")
        matrix = np.array([[-slopes[0, 0], 1.0, -slopes[0, 1]], [slopes[1, 0] / size, 0.0, slopes[1, 1] / size]])
        return np.array([z[1] - mu, value / size]), matrix.ravel(order="F")

    def point(self, found: Point) -> EdgePoint:
        """A point of the curve with its errors: by those of the flow and of the orbit, over the slope by S.

        At a fold that slope is zero to within its own error, which gives that of S, and the parameter has one too.
        """
        z, (S, _) = found.z, self.where(found.z)
        (_, (by_S, by_u)), (mu, value, moved, finer) = self.linear(z)[1], self.values(z, errors=True)
        off, parameter_error = abs(value) + abs(moved - value) + abs(finer - value), 0.0
        if found.special:
            step = BEND_STEP * np.eye(3)[0]
            bend = abs(self.values(z + step)[1] + self.values(z - step)[1] - 2.0 * value) / BEND_STEP**2
            S_error = FOLD_TOLERANCE + 2.0 * SAME_SLOPES + 10.0 * DIFFERENCE_STEP**2 + off / (DIFFERENCE_STEP * bend)
            parameter_error = abs((self._course.to - self._course.start) / by_u) * (off + 0.5 * bend * S_error**2)
        else:
            S_error = off / abs(by_S)
        orbit = self.orbit(z)
        place = Place(0.0, 0.0, S, float(self._S * S_error), orbit.Omega)
        edge = replace(self.edge, place=place, mu=float(mu) if self._meet else self.edge.mu)
        values = {**orbit.space.parameters(orbit.point), "S": S}
        return EdgePoint(orbit, edge, values, float(parameter_error))

    # As continuations take it -----------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        return 3

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return np.tile(np.arange(2), 3), np.repeat(np.arange(3), 2)

    def profile_change(self, z: Array, step: Array, between: Array | None = None) -> float:
        return float(np.max(np.abs(step[:2])))

    def metric(self, z: Array, parameter_scale: float) -> Array:
        return np.array([z[0] ** -2.0, 1.0, 1.0])

    def rounding(self, z: Array) -> float:
        return DIFFERENCE_STEP**3

    def describe_parameters(self, z: Array) -> str:
        S, value = self.where(z)
        return f"S = {S:.8g}, {self._course.name} = {value:.8g}"


def _keep_last(known: dict[Any, Any], count: int) -> None:
    """Forget the oldest entries."""
    while len(known) > count:
        del known[next(iter(known))]


# Curves of edges ------------------------------------------------------------------------------------------------------


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


def edge_curve(
    orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings,
    until: Callable[[Any], bool] | None, progress: Callable[[Any], None] | None, back_to: float | None,
) -> EdgeCurve:  # fmt: skip
    """The edge of a tongue near S of a family, followed in a parameter (see `points.curves.curve`).

    Raises ArithmeticError and ValueError where the edge is not found again.
    """
    start = float(orbit.parameters[parameter])
    exact = (start, to, *at, *(() if back_to is None else (back_to,)))
    for value in exact:
        family_at(orbit.space.whole, parameter, value)  # refused where the model has no such value
    problem = edge_problem(orbit, S, Course(parameter, start, to), exact)
    limits = replace(
        settings, tolerance=LAST_NEWTON_STEP, min_step=SHORTEST_STEP, closing=False, guard_distance=0.3,
        guard_angle=40.0, aim_angle=20.0, first_step=FIRST_STEP,
        at=(*settings.at, Target(Scalar.PARAMETER, settings.parameter_min)),
    )  # fmt: skip
    solver = PointSolver(ExactLevels(problem, lambda problem: NewtonCorrector(problem, LAST_NEWTON_STEP)), limits)
    row = problem.parameter_row()
    found = solver.levels.corrector(problem).correct(problem.begin, row, 0.0)
    if not (found.converged and abs(found.z[0] - 1.0) <= EDGE_S_RTOL):
        raise ArithmeticError(f"the edge is not found again: {found.message}".removesuffix(": "))
    tangent = solver.tangent(problem, found.z, solver.factor(problem, found.z, row))
    last = Point(problem, found.z, tangent, ErrorEstimate(0.0, 0.0), limits.first_step, 0)
    walk, points, folds, stopped = ArclengthContinuation(solver, (last,)), [problem.point(last)], list[int](), False
    end: End | None = None
    for following in walk:
        for place in (*folds_between(solver, last, following), following):
            folds += [len(points)] if place.special else []
            points.append(problem.point(place))
            if progress is not None:
                progress(points[-1])
            stopped = stopped or (until is not None and until(points[-1]))
        last = following
        if last.parameter == settings.parameter_min:  # back, and as far to the other side as it was to go
            closed = abs(last.z[0] - 1.0) <= EDGE_S_RTOL and back_to is None
            end = End.CLOSED if closed else End.AWAY
        if stopped or end is not None:
            break
    end = None if stopped else end or walk.end
    return EdgeCurve(parameter, tuple(points), end, "" if end in (None, End.AWAY) else walk.detail, tuple(folds))


def edge_problem(orbit: Orbit, S: float, course: Course, exact: Iterable[float]) -> EdgeProblem:
    """The equations of the edge near S of a family; raises ArithmeticError where it is not found again."""
    family, point, turns = orbit.space.whole, orbit.space.on_all_positions(orbit.point), turns_of(orbit)
    if turns == 1:
        edge, known = _edge_near(family, point, S)
    else:
        known = orbit_at(family, S, shortened(point, turns))
        edge = _resonance(family, known, S, turns)
    return EdgeProblem(orbit, course, exact, edge, known)


def _edge_near(family: Family, point: Point, S: float) -> tuple[StabilityEdge, Point]:
    """The edge at an orbit, among those of a short stretch around it, and an orbit of that."""
    half = HALF_STRETCH * S
    center = orbit_at(family, S + ASIDE_FRACTION * half, point)
    ends = [beside(family, center, S + side * half) for side in (-1.0, UNEVEN_FRACTION)]
    diagram = tongues_on(family, [ends[0], center, ends[1]])
    if diagram.unresolved:
        raise FlowError(diagram.unresolved[0].reason)
    nearest = min((*diagram.changes, *diagram.further), key=lambda edge: abs(edge.S - S), default=None)
    if nearest is None or abs(nearest.S - S) > EDGE_S_RTOL * S:
        raise ArithmeticError("the edge is not found again")
    return nearest, center


def _resonance(family: Family, point: Point, S: float, turns: int) -> StabilityEdge:
    """Edges that coincide where a family crosses one of an m-th of its period, whose multiplier is a root of 1 or -1.

    It is the resonance of the orbit of the shorter period, at a point of which the family is.
    """
    mu = mu_of(*flow_along(family, point)[::2])
    real = np.clip(mu[np.abs(mu.imag) <= REAL_MU_ATOL].real, -1.0, 0.0)
    roots = np.pi * np.arange(1, turns) / turns
    away = np.min(np.abs(roots[:, None] - np.arccos(1.0 + 2.0 * real)), axis=1, initial=np.inf)
    target, power = -(float(np.sin(0.5 * roots[np.argmin(away)])) ** 2), POWERS_BY_FRACTION[family.symmetry.value]
    place = Place(0.0, 0.0, S, 0.0, point.Omega)
    return StabilityEdge(place, f"1:{turns} resonance", target, (), False, False, power)
