"""Equilibria beside which an orbit stays: saddles and saddle-nodes, with coordinates in which it comes and goes.

Beside a saddle the part of a state along the stable eigenspace decays and the one along the unstable eigenspace grows,
each measured by a norm that is monotone along the linearised flow (Lyapunov's equation), relative to the extent of the
orbit. Left invariant subspaces from Schur's form serve eigenvalues that are complex or defective.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.follow.space import BoundaryError, SolutionSpace
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.family import TWO_PI
from casadi_skin.zero.orbit import Extended, Sizes
from casadi_skin.zero.problem import Array, SingularError
from casadi_skin.zero.stated_problem import BoundaryProblem, stated
from casadi_skin.zero.statement import Statement

if TYPE_CHECKING:
    from casadi_skin.zero.settings import Point

PERIOD_PLACES = 2001  # along a period at which an orbit is looked at
SLOW_SPEED_RATIO = 1e-2  # of the largest speed along the orbit: it passes an equilibrium there
EQUILIBRIUM_DISTANCE = 0.2  # of the orbit's extent: how far from its slowest place an equilibrium may be
LINEAR_DISTANCE = 0.05  # of the orbit's extent: where an orbit is beside an equilibrium, and nearly linear
SAME_EQUILIBRIUM_DISTANCE = 1e-6  # of the orbit's extent: distance of two equilibria that are one
NEWTON_STEPS, CONVERGED_STEP = 30, 1e-10  # of Newton's method for an equilibrium; its last step, relative
ZERO_EIGENVALUE_RATIO = 1e-9  # of the largest eigenvalue: one without growth or decay


@dataclass(frozen=True, eq=False)
class Rest:
    """A saddle, or a saddle-node, which has a `centre`.

    Attributes:
        x: the equilibrium.
        p: the parameters of the statement's model there: those of the orbit, but for the one followed at a saddle-node.
        stable, unstable: coordinates in which orbits come and go, one a row.
        centre: likewise, of the eigenvalue zero; no row at a saddle.
        decay, growth: the slowest rates among these; infinite without any.
        skew: the largest ratio by which the norms of both may differ from an exponential.
    """

    x: Array
    p: Array
    stable: Array
    unstable: Array
    centre: Array
    decay: float
    growth: float
    skew: float

    def norms(self, states: Array) -> tuple[Array, Array, Array]:
        """Sizes of the stable, unstable and central parts of states, each of shape (states,)."""
        away = states - self.x
        stable, unstable, centre = (
            np.linalg.norm(away @ rows.T, axis=1) for rows in (self.stable, self.unstable, self.centre)
        )
        return stable, unstable, centre


@dataclass(frozen=True, eq=False)
class Stay:
    """A part of an orbit beside an equilibrium: when it comes and goes, its least speed and its least distance."""

    rest: Rest
    start: float
    end: float
    speed: float
    nearest: float


@dataclass(frozen=True, eq=False)
class Course:
    """States of an orbit along one period, their extent, and the parameters of the statement's model.

    `turned` is what a period adds to the states.
    """

    times: Array
    states: Array
    extent: Array
    turned: Array
    period: float
    p: Array

    @classmethod
    def of(cls, space: SolutionSpace, orbit: Point, places: int = PERIOD_PLACES) -> Course:
        """Of an orbit of a space, at even times, their end among them, and on the mesh."""
        problem, periodic = stated(orbit.problem), space._orbit_of()
        fractions = periodic.symmetry.value * problem._fractions()
        turn = np.unique(np.concatenate([np.linspace(0.0, 1.0, places)[:-1], fractions[fractions < 1.0]]))
        states = space.states_at(orbit, TWO_PI * turn, None)
        extent = np.ptp(states, axis=0)
        turned = TWO_PI * np.array(periodic.turns or np.zeros(extent.size))
        period = space.interval(orbit)[1]
        extent = np.maximum(extent, SAME_EQUILIBRIUM_DISTANCE * np.max(extent))
        return cls(period * turn, states, extent, turned, period, problem.parameters(orbit.z))

    @property
    def slowest(self) -> float:
        """The least of the mean speeds from one place to the next by the largest of them."""
        moved = np.diff(self.states, axis=0) / self.extent
        speed = np.linalg.norm(moved, axis=1) / np.diff(self.times)
        return float(np.min(speed) / np.max(speed))

    def longer(self) -> Course:
        """From a period before phase zero to two periods after it."""
        shifts = range(-1, 2)
        times = np.concatenate([self.times + k * self.period for k in shifts])
        return replace(self, times=times, states=np.concatenate([self.states + k * self.turned for k in shifts]))


def stays(space: SolutionSpace, orbit: Point, walking: int) -> tuple[Course, list[Stay]]:
    """The course of an orbit over three periods and its complete stays beside saddles and saddle-nodes, in order.

    None where it is slow beside equilibria of other kinds alone. `walking` is the place of the parameter that is
    followed among those of the statement's model, by which a saddle-node is found.
    """
    course, model = Course.of(space, orbit), space.statement.model
    one, count = course.states, len(course.times)
    rates = np.array(model.vector_field.map(count)(0.0, one.T, np.tile(course.p[:, None], count))).T
    speed = np.linalg.norm(rates / course.extent, axis=1)
    least = (speed <= np.roll(speed, 1)) & (speed <= np.roll(speed, -1)) & (speed < SLOW_SPEED_RATIO * np.max(speed))
    rests: list[Rest] = []
    for place in np.flatnonzero(least):
        if not any(np.all(np.abs(one[place] - rest.x) <= LINEAR_DISTANCE * course.extent) for rest in rests):
            rest = _rest_near(model, one[place], course, walking, float(np.max(speed)))
            if rest is not None:
                rests.append(rest)
    course = course.longer()
    shifts = (-1, 0, 1) if np.any(course.turned) else (0,)
    images = [replace(rest, x=rest.x + k * course.turned) for rest in rests for k in shifts]
    found = [stay for rest in images for stay in _stays_at(rest, course, np.tile(speed, 3))]
    return course, sorted(found, key=lambda stay: stay.start)


def _stays_at(rest: Rest, course: Course, speed: Array) -> list[Stay]:
    """The complete stays beside one equilibrium."""
    norms = rest.norms(course.states)
    inside = np.all(np.array(norms) < LINEAR_DISTANCE, axis=0)
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    found = []
    for first, last in zip(edges[:-1] + 1, edges[1:], strict=True):
        if inside[first] and last > first:
            part = slice(first, last + 1)
            distance = np.linalg.norm((course.states[part] - rest.x) / course.extent, axis=1)
            start, end = course.times[first], course.times[last]
            found.append(Stay(rest, start, end, float(np.min(speed[part])), float(np.min(distance))))
    return found


def _rest_near(model: OdeModel, x: Array, course: Course, walking: int, fastest: float) -> Rest | None:
    """The saddle or saddle-node near a state; None where there is another equilibrium or none."""
    slope = model.function(
        "slope",
        ca.densify(model.vector_field(0.0, model.full_state, model.parameters)),
        ca.densify(ca.jacobian(model.full_rhs, model.full_state)),
    )
    start, p = x, course.p
    found = _equilibrium(slope, x, p, course.extent)
    rest = None if found is None else _classified(model, slope, found, p, course.extent, fastest, saddle=True)
    if rest is None:
        solved = _saddle_node(slope, start, p, walking, course.extent)
        rest = None if solved is None else _classified(model, slope, *solved, course.extent, fastest, saddle=False)
    return None if rest is None or np.any(np.abs(rest.x - start) > EQUILIBRIUM_DISTANCE * course.extent) else rest


def _equilibrium(slope: ca.Function, x: Array, p: Array, extent: Array) -> Array | None:
    """The equilibrium near a state; None beside a double one, where Newton's method does not converge."""
    y = ca.MX.sym("y", x.size)
    return _root(y, slope(0.0, y, p)[0], x, extent)


def _saddle_node(slope: ca.Function, x: Array, p: Array, walking: int, extent: Array) -> tuple[Array, Array] | None:
    """The equilibrium with an eigenvalue zero near a state, and the parameters with the one followed as it is there."""
    n = x.size
    near = np.linalg.svd(np.array(slope(0.0, x, p)[1]))[2][-1]
    y = ca.MX.sym("y", 2 * n + 1)
    values = ca.vertcat(*(y[2 * n] if i == walking else value for i, value in enumerate(p)))
    rate, jacobian = slope(0.0, y[:n], values)
    equations = ca.vertcat(rate, jacobian @ y[n : 2 * n], ca.dot(ca.DM(near), y[n : 2 * n]) - 1.0)
    value = p[walking : walking + 1]
    sizes = np.concatenate([extent, np.ones(n), np.where(value == 0.0, 1.0, np.abs(value))])
    found = _root(y, equations, np.concatenate([x, near, value]), sizes)
    return None if found is None else (found[:n], np.where(np.arange(p.size) == walking, found[-1], p))


def _root(y: ca.MX, equations: ca.MX, guess: Array, sizes: Array) -> Array | None:
    """The root near a guess, by steps that become small beside sizes; None where Newton's method finds none."""
    in_sizes = ca.MX.sym("in_sizes", guess.size)
    scaled = ca.substitute(equations, y, sizes * in_sizes)
    options = {
        "max_iter": NEWTON_STEPS, "abstol": 0.0, "abstolStep": CONVERGED_STEP * (np.max(np.abs(guess / sizes)) + 1.0),
        "print_time": False, "show_eval_warnings": False,
    }  # fmt: skip
    try:
        found = sizes * ca.rootfinder("rest", "newton", {"x": in_sizes, "g": scaled}, options)(x0=guess / sizes)["x"]
    except RuntimeError:  # as CasADi says that Newton's method failed
        return None
    ends = np.array(ca.Function("rest", [y], [equations])(found))  # where it has left the domain it ends without a word
    return np.array(found).ravel() if np.all(np.isfinite(ends)) else None


def _classified(
    model: OdeModel, slope: ca.Function, x: Array, p: Array, extent: Array, fastest: float, saddle: bool
) -> Rest | None:
    """The equilibrium with its coordinates; None where it is neither a saddle nor a saddle-node of two eigenvalues."""
    matrix, own = np.array(slope(0.0, x, p)[1]), model.inner if isinstance(model, Extended) else model
    scaled, free = matrix * extent / extent[:, None], own.implicit
    values = np.linalg.eigvals(
        scaled if free is None else free.among_free(x, p[: own.parameters.numel()], extent)(matrix)
    )
    size = max(float(np.max(np.abs(values))), fastest)
    limit = (ZERO_EIGENVALUE_RATIO if saddle else np.sqrt(ZERO_EIGENVALUE_RATIO)) * size
    down, up = values.real < -limit, values.real > limit
    central = values.size - int(np.sum(down)) - int(np.sum(up))
    if central != (0 if saddle else 1) or (saddle and not (np.any(down) and np.any(up))):
        return None
    parts = [_coordinates(scaled, limit, sign) for sign in (-1.0, 1.0)]
    centre = np.linalg.svd(scaled.T)[2][-1:] if central else np.zeros((0, x.size))
    rates = [float(np.min(np.abs(values.real[which]), initial=np.inf)) for which in (down, up)]
    (stable, one), (unstable, other) = parts
    return Rest(x, p, stable / extent, unstable / extent, centre / extent, rates[0], rates[1], max(one, other))


def _coordinates(jacobian: Array, limit: float, sign: float) -> tuple[Array, float]:
    """Rows of coordinates along the eigenvalues whose real part has a sign, and how far their norm is from normal."""
    from scipy.linalg import schur, solve_continuous_lyapunov

    def belongs(real: complex, imaginary: float = 0.0) -> bool:
        return bool(sign * np.real(real) > limit)

    form, vectors, count = schur(jacobian.T, sort=belongs)
    if not count:
        return np.zeros((0, len(jacobian))), 1.0
    weight = solve_continuous_lyapunov(form[:count, :count], sign * np.eye(count))
    sizes = np.linalg.eigvalsh(weight)
    rows = np.linalg.cholesky(weight / sizes[-1]).T @ vectors[:, :count].T
    return rows, float(np.sqrt(sizes[-1] / sizes[0]))


def in_a_period(course: Course, found: Sequence[Stay]) -> list[Stay]:
    """The stays of one period, then the next one, which is the first of them again."""
    if not found:
        return []
    first = next((stay for stay in found if stay.end > 0.0), found[-1])
    end = first.start + course.period * (1.0 - SAME_EQUILIBRIUM_DISTANCE)
    period = [stay for stay in found if first.start <= stay.start < end]
    return [*period, *[stay for stay in found if stay.start >= end][:1]]


def in_the_part(course: Course, found: Sequence[Stay], symmetry: SymmetryClass) -> list[Stay]:
    """The stays that overlap the part of the period that a symmetric orbit is solved on."""
    return [stay for stay in found if stay.end > 0.0 and stay.start < symmetry.value * course.period]


# A connecting orbit as a truncated boundary-value problem: from beside one equilibrium to beside the next -------------

DURATION, TURN = "duration", "turn"  # of the field, which leaves its equilibria where they are (Duff 1953)
FIRST_MESH_INTERVALS = 60  # of the first mesh
CONNECTING_TOLERANCE_RATIO = 1e-2  # of the tolerance of the orbits: that of the connecting orbit
LEAST_TOLERANCE = 1e-11


class TruncatedStatement(Statement):
    """Solved by its corrector alone: it starts beside the solution."""

    always_confirmed: ClassVar[bool] = False


@dataclass(frozen=True)
class Pins:
    """Where a reversal leaves an orbit: components of the state with their values, at a time."""

    time: float
    components: Sequence[int]
    values: Array


Side = Stay | Pins


@dataclass(frozen=True, eq=False)
class Connection:
    """The part of an orbit between two sides of it, and the name of the parameter that is solved for, if any."""

    space: Any
    orbit: Point
    course: Course
    sides: tuple[Side, Side]
    free: str

    def solved(self, radius: float) -> tuple[float, float] | None:
        """The parameter and its estimated error, by a connecting orbit cut off at a distance from the equilibria.

        Distances are relative to the extent of the orbit. NaN where a connecting orbit does not determine the
        parameter: in conservative models, in invariant subspaces; None where none is found that is near to the orbit.
        """
        missing = self._undetermined
        if missing not in (0, 1):
            return None
        names = [name for name in (self.free, TURN) if name] if missing else [""]
        for name in names:
            found = self._unknown(radius, name)
            if found is not None and name == self.space.parameter:
                return found
            if found is not None and (name != TURN or abs(found[0]) <= self.space.tolerance):
                return np.nan, np.nan
        return None

    def _unknown(self, radius: float, name: str) -> tuple[float, float] | None:
        """The value of what is solved for beside the states, and its estimated error; None where none is found."""
        start, end = self._times(radius)
        statement = self._statement(radius, start, end, name)
        space = replace(
            self.space, statement=statement, sizes=self._sizes(statement),
            tolerance=max(CONNECTING_TOLERANCE_RATIO * self.space.tolerance, LEAST_TOLERANCE),
            periodic=None, parameter="", at=(), first=None, settings=None, leaves=False,
            left=None,
        )  # fmt: skip
        problem = stated(space.levels.problem(FIRST_MESH_INTERVALS))
        problem = problem.placed(self._guess(problem, statement, start, end), problem)
        z = self._guess(problem, statement, start, end)
        try:
            correction = space.levels.corrector(problem).correct(z, problem.parameter_row(), 0.0)
            if not correction.converged or self._apart(problem, correction.z, z) > LINEAR_DISTANCE:
                return None
            point = space.refined(problem, correction)
        except (BoundaryError, SingularError):
            return None
        if not name:
            return np.nan, np.nan
        place = list(statement.free).index(name)
        value = float(point.z[place - len(statement.free) - 1])
        return value, point.error.relative(1.0) * max(abs(value), float(space.sizes.scalars[place]))

    @property
    def _undetermined(self) -> int:
        """The number of parameters that the conditions determine beside the states and the duration."""
        given = sum(_conditions(side, first) for side, first in zip(self.sides, (True, False), strict=True))
        return given - (int(self.course.states.shape[1]) + 1)

    def _times(self, radius: float) -> tuple[float, float]:
        """When the orbit leaves the start, and comes to the end, at a distance."""
        first, last = self.sides
        times, states = self.course.times, self.course.states
        if isinstance(first, Pins):
            start = first.time
        else:
            away = first.rest.norms(states)[2 if len(first.rest.centre) else 1]
            gone = np.flatnonzero((times > 0.5 * (first.start + first.end)) & (away >= radius))
            start = float(times[gone[0]])
        if isinstance(last, Pins):
            return start, last.time
        away = last.rest.norms(states)[2 if len(last.rest.centre) else 0]
        come = np.flatnonzero((times < 0.5 * (last.start + last.end)) & (away >= radius))
        return start, float(times[come[-1]])

    def _statement(self, radius: float, start: float, end: float, unknown: str) -> Statement:
        model = self.space.statement.model
        kind, count, n = type(model.state), int(model.parameters.numel()), model.full_size
        saddles = {
            k: side.rest for k, side in enumerate(self.sides) if isinstance(side, Stay) and not len(side.rest.centre)
        }
        names = [DURATION, TURN, *(f"equilibrium_{k}_{name}" for k in saddles for name in model.state_names)]
        p = kind.sym("p", count + len(names))
        given, own = p[:count], p[count + 2 :]
        places = {k: own[i * n : (i + 1) * n] for i, k in enumerate(saddles)}
        nominal = [*self._values, end - start, 0.0, *(float(v) for rest in saddles.values() for v in rest.x)]
        field = model.field_at(0.0, model.state, given)
        field = field + p[count + 1] * (ca.DM(self._turning) @ field)
        larger = Extended(
            model.name, model.state, field, p, nominal=tuple(nominal), checked=False,
            state_labels=model.state_names, parameter_labels=(*model.parameter_names, *names), inner=model,
        )  # fmt: skip
        conditions: list[Expression] = [model.field_at(0.0, place, given) for place in places.values()]
        guess = self._states(np.array([start, end]))
        for k, side in enumerate(self.sides):
            at = larger.ends[k]
            if isinstance(side, Pins):
                conditions.append(at[list(side.components)] - ca.DM(side.values))
            else:
                conditions += _at_rest(side.rest, at - places.get(k, ca.DM(side.rest.x)), k == 0, radius, guess[k])
        kept = [name for name in names if name != TURN]
        free = [unknown, *kept] if unknown else kept
        return TruncatedStatement(larger, [c for c in conditions if c.numel()], (), (0.0, p[count]), free=free)

    @property
    def _turning(self) -> Array:
        """The directions into which the field is turned where the parameter does not break a connection."""
        extent = self.course.extent
        turned = np.random.default_rng(0).normal(size=(extent.size, extent.size))
        return np.asarray(turned * extent[:, None] / extent)

    @property
    def _values(self) -> list[float]:
        """Parameters of the statement's model: those of the orbit, or of a saddle-node."""
        double = [side.rest.p for side in self.sides if isinstance(side, Stay) and len(side.rest.centre)]
        return [float(value) for value in (double or [self.course.p])[0]]

    def _sizes(self, statement: Statement) -> Sizes:
        """The extent of the orbit; of the parameter the way that is followed."""
        extent, names = self.course.extent, self.space.statement.model.state_names
        sizes = {f"equilibrium_{k}_{name}": size for k in (0, 1) for name, size in zip(names, extent, strict=True)}
        sizes |= {DURATION: self.course.period, self.space.parameter: abs(self.space.to - self._start_value)}
        return Sizes(extent, np.array([sizes.get(name, 1.0) for name in statement.free]))

    @property
    def _start_value(self) -> float:
        return float(self.space.statement.values[self.space.parameter])

    def _states(self, times: Array) -> Array:
        return np.asarray(self.space.states_at(self.orbit, TWO_PI * times / self.course.period, None))

    def _guess(self, problem: Any, statement: Statement, start: float, end: float) -> Array:
        states = self._states(start + (end - start) * problem._fractions())
        return np.concatenate([states.ravel(), [statement.values[name] for name in statement.free], [0.0]])

    def _apart(self, problem: BoundaryProblem, z: Array, guess: Array) -> float:
        """Root mean square of the difference of two solutions relative to the extent of the orbit."""
        change = (z - guess)[: problem.states].reshape(problem.columns, -1) / self.course.extent
        return float(np.sqrt(np.mean(np.sum(change**2, axis=1))))


def _conditions(side: Side, first: bool) -> int:
    """The number of conditions of a side: eigenspaces, and a distance."""
    if isinstance(side, Pins):
        return len(side.components)
    return len(side.rest.stable if first else side.rest.unstable) + 1


def _at_rest(rest: Rest, away: Expression, first: bool, radius: float, guess: Array) -> list[Expression]:
    """An end in an eigenspace, at a distance."""
    inside, across = (rest.unstable, rest.stable) if first else (rest.stable, rest.unstable)
    found = [ca.DM(across) @ away] if len(across) else []
    if len(rest.centre):
        side = float(np.sign((rest.centre @ (guess - rest.x))[0]))
        return [*found, ca.DM(rest.centre) @ away - side * radius]
    return [*found, ca.sumsqr(ca.DM(inside) @ away) / radius**2 - 1.0]
