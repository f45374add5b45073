"""A connecting orbit as a truncated boundary-value problem: from beside one equilibrium to beside the next.

It starts in the unstable eigenspace of the one, at a distance, and ends in the stable eigenspace of the other, at a
distance (Beyn 1990); both equilibria are solved with it, and so is the parameter where the conditions determine it.
Orbits of reversible models start or end where the reversal leaves them; those of conservative ones have their unfolding
in place of the parameter. At a saddle-node the parameter is that of the saddle-node, and orbits come and go along its
centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.points.rests import BESIDE, Course, Rest, Stay
from casadi_skin.solve.refined import BoundaryError, refined
from casadi_skin.zero.boundary_choices import Sizes
from casadi_skin.zero.method import TWO_PI
from casadi_skin.zero.orbit_statement import Extended
from casadi_skin.zero.problem import Array, SingularError
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statement import Statement

if TYPE_CHECKING:
    from casadi_skin.follow.boundary_solutions import BoundarySolutions
    from casadi_skin.follow.settings import Point

DURATION, TURN = "duration", "turn"  # of the field, which leaves its equilibria where they are (Duff 1953)
INTERVALS = 60  # of the first mesh
FINER = 1e-2  # of the tolerance of the orbits: that of the connecting orbit
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

    space: BoundarySolutions
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
            self.space, statement=statement, tolerance=max(FINER * self.space.tolerance, LEAST_TOLERANCE),
            sizes=self._sizes(statement), periodic=None, parameter="", at=(), first=None, settings=None, leaves=False,
            left=None,
        )  # fmt: skip
        problem = space.levels.problem(INTERVALS)
        problem = problem.placed(self._guess(problem, statement, start, end), problem)
        z = self._guess(problem, statement, start, end)
        try:
            correction = space.levels.corrector(problem).correct(z, problem.parameter_row(), 0.0)
            if not correction.converged or self._apart(problem, correction.z, z) > BESIDE:
                return None
            point = refined(space.point_solver, problem, correction)
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
        return self.space.states_at(self.orbit, TWO_PI * times / self.course.period, None)

    def _guess(self, problem: Any, statement: Statement, start: float, end: float) -> Array:
        states = self._states(start + (end - start) * problem._fractions())
        return np.concatenate([states.ravel(), [statement.values[name] for name in statement.free], [0.0]])

    def _apart(self, problem: Any, z: Array, guess: Array) -> float:
        """Root mean square of the difference of two solutions relative to the extent of the orbit."""
        assert isinstance(problem, BoundaryProblem)
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
