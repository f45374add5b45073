"""The limit of a branch of orbits whose period grows without bound: an orbit that joins equilibria.

The limit is named where the orbits stay beside saddles as long as the linearised flow there says (Kuznetsov 2004,
sections 6.2 and 7.1), and a truncated boundary-value problem has a connecting orbit beside them at a parameter that the
orbits have reached within the tolerance. An explosion of cycles (canards) passes no saddle and goes on.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.rests import (
    CONVERGED_STEP,
    LINEAR_DISTANCE,
    Connection,
    Course,
    Pins,
    Side,
    Stay,
    in_a_period,
    in_the_part,
    stays,
)
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.model.conserved import SymmetryClass, pinned_components
from casadi_skin.zero.kinds import HETEROCLINIC, HOMOCLINIC
from casadi_skin.zero.orbit import UNFOLDING
from casadi_skin.zero.problem import EPSILON, Array, Scalar
from casadi_skin.zero.settings import Point

SMALLEST_REPORTED_RATIO = 1e-9  # of the orbit's extent: smaller components are reported as 0
NEAREST_TO_LIMIT = 1e-9  # of the way that is followed: nearer to its limit the parameter does not separate orbits
DISTANCE_SAFETY = 3.0  # between an estimated distance and the reported error
ROUGH_PLACES = 101  # along a period at which it is looked at whether an orbit may be beside an equilibrium
# Of the largest speed along the orbit, both means from place to place: twice `SLOW_SPEED_RATIO`, from which they differ
# by a few per cent. Where branches end so it was 5e-4 and less.
ROUGH_SPEED_RATIO = 2e-2
LONGEST_STAY = 36.0  # times the time of growth by e: a longer stay is beyond doubles
STAY_AGREEMENT_RTOL = 0.25  # of a stay: what it may differ from that of the linearised flow
PARAMETER_ROUNDING = 100.0 * EPSILON  # of a parameter: its rounding at a saddle-node
CLOSE_APPROACH_RATIO = 0.1  # of the place where an orbit is beside an equilibrium: how near it has to come
TRUNCATION_FACTOR = 0.3  # of a truncation: the next one
NEAREST_TRUNCATION_FACTOR = 3.0  # of the distance at which an orbit passes an equilibrium: the nearest truncation


@dataclass(frozen=True)
class Limit:
    """Where the period grows without bound: the parameter, its error, and whether it is the connecting orbit's own."""

    parameter: float
    error: float
    solved: bool


def unbounded(space: SolutionSpace, before: Point, after: Point) -> Point | None:
    """The later of two orbits as the end of its branch, where the period grows without bound; None where it goes on."""
    index, place, period = after.problem.parameter_index, after.problem.index_of(Scalar.OMEGA), space.interval(after)[1]
    rate = abs(float(after.tangent[index] / after.tangent[place]))
    allowed = max(space.tolerance, NEAREST_TO_LIMIT) * after.problem.parameter_size(after.z)
    if period <= space.interval(before)[1] or rate * period > LONGEST_STAY * DISTANCE_SAFETY * allowed:
        return None
    if Course.of(space, after, ROUGH_PLACES).slowest > ROUGH_SPEED_RATIO:
        return None
    walking = space.statement.model.parameter_names.index(space.parameter)
    way = abs(space.to - space.statement.values[space.parameter])
    course, found = _approaches(space, after, walking)
    beside = in_a_period(course, found)
    if len(beside) < 2:
        return None
    value, rests = float(course.p[walking]), [stay.rest for stay in beside[:-1]]
    doubles = [float(rest.p[walking]) for rest in rests if len(rest.centre)]
    left = rate * sum(1.0 / min(rest.growth, rest.decay) for rest in rests if not len(rest.centre))
    apart = max((abs(double - value) / way for double in doubles), default=0.0)
    if max(left, apart) > DISTANCE_SAFETY * allowed:
        return None
    if not _grows(beside, in_a_period(*_approaches(space, before, walking))):
        return None
    limit = _limit(space, after, course, (beside, found), doubles, DISTANCE_SAFETY * allowed * way)
    if limit is None:
        return None
    if np.isnan(limit.parameter):
        limit = Limit(value, DISTANCE_SAFETY * left * way, solved=False)
    apart = abs(limit.parameter - value)  # the parameter of an orbit has an error as well
    if (
        apart > DISTANCE_SAFETY * (allowed * way + space.tolerance * abs(value))
        or limit.error > DISTANCE_SAFETY * allowed * way
    ):
        return None
    return _marked(space, after, limit, beside)


def _approaches(space: SolutionSpace, orbit: Point, walking: int) -> tuple[Course, list[Stay]]:
    """As `stays`, those alone that come close: an orbit passes other saddles, or one again, on its way to a limit.

    Of two at a time, as beside a saddle that a saddle-node is near, that to which it comes nearest.
    """
    course, found = stays(space, orbit, walking)
    close = sorted(
        (one for one in found if one.nearest < CLOSE_APPROACH_RATIO * LINEAR_DISTANCE), key=lambda stay: stay.nearest
    )
    apart = list[Stay]()
    for one in close:
        if not any(one.start < other.end and other.start < one.end for other in apart):
            apart.append(one)
    return course, sorted(apart, key=lambda one: one.start)


def _marked(space: SolutionSpace, orbit: Point, limit: Limit, period: Sequence[Stay]) -> Point:
    """The orbit as the end of its branch."""
    size = abs(space.to - space.statement.values[space.parameter]) * orbit.problem.parameter_size(orbit.z)
    own = 0.0 if limit.solved else orbit.error.relative(1.0)
    z = orbit.z.copy()
    if limit.solved:
        z[orbit.problem.parameter_index] = space.fraction(limit.parameter)
    kind = HOMOCLINIC if len(places_of(space, period)) == 1 else HETEROCLINIC
    error = replace(orbit.error, parameter=limit.error / size + own)
    return orbit.marked(kind, z=z, error=error)


def _grows(after: Sequence[Stay], before: Sequence[Stay]) -> bool:
    """Whether stays grow from one orbit to the next as the linearised flow has it.

    Beside a saddle the least distance falls exponentially, at a rate whose inverse is the sum of those of decay and
    growth; beside a saddle-node the least speed falls as the square of the time.
    """
    if len(after) != len(before):
        return False
    for stay, one in zip(after[:-1], before[:-1], strict=True):
        rest, length, other = stay.rest, stay.end - stay.start, one.end - one.start
        if not (length > other and stay.nearest > 0.0):
            return False
        if len(rest.centre):
            expected, own, slack = 0.5 * np.log(one.speed / stay.speed), np.log(length / other), 0.0
        else:
            expected, slack = np.log(one.nearest / stay.nearest), np.log(rest.skew)
            own = (length - other) / (1.0 / rest.growth + 1.0 / rest.decay)
        if not abs(expected - own) <= STAY_AGREEMENT_RTOL * own + slack:
            return False
    return True


def _limit(
    space: SolutionSpace,
    orbit: Point,
    course: Course,
    rests: tuple[Sequence[Stay], Sequence[Stay]],
    doubles: Sequence[float],
    allowed: float,
) -> Limit | None:
    """The limit by connecting orbits at two truncations; None where they have none in one place.

    NaN where they exist and leave the parameter to the conditions that pick an orbit.
    """
    period, connections = rests[0], _connections(space, orbit, course, *rests)
    radius, nearest = (
        CLOSE_APPROACH_RATIO * LINEAR_DISTANCE * DISTANCE_SAFETY,
        NEAREST_TRUNCATION_FACTOR * max(stay.nearest for stay in period),
    )
    before: Array | None = None
    while connections and radius > nearest:
        solved = [connection.solved(radius) for connection in connections]
        if any(one is None for one in solved):  # where another equilibrium is near, the flow is linear closer by alone
            before, radius = None, TRUNCATION_FACTOR * radius
            continue
        values = np.array([one for one in solved if one is not None])
        determined = values[~np.isnan(values[:, 0])]
        if doubles:
            own = CONVERGED_STEP * abs(space.to - space.statement.values[space.parameter]) + PARAMETER_ROUNDING * abs(
                doubles[0]
            )
            return Limit(doubles[0], own + float(np.ptp(doubles)), solved=True)
        if not len(determined):
            return Limit(np.nan, np.nan, solved=False)
        if before is not None:
            error = float(
                np.max(np.abs(determined[:, 0] - before)) + np.max(determined[:, 1]) + np.ptp(determined[:, 0])
            )
            if error <= allowed:
                return Limit(float(np.mean(determined[:, 0])), error, solved=True)
        before, radius = determined[:, 0], TRUNCATION_FACTOR * radius
    return None


def _connections(
    space: SolutionSpace, orbit: Point, course: Course, period: Sequence[Stay], found: Sequence[Stay]
) -> list[Connection]:
    """Parts of a period from one stay to the next; of a symmetric orbit from and to where its reversal leaves it."""
    periodic = space._orbit_of()
    unfolded = [name for name in space.statement.free if name.startswith(UNFOLDING)]
    free = unfolded[0] if unfolded else space.parameter
    if periodic.symmetry is SymmetryClass.FULL:
        pairs = [(one, other) for one, other in itertools.pairwise(period)]
        return [Connection(space, orbit, course, pair, free) for pair in pairs]
    inside = in_the_part(course, found, periodic.symmetry)
    end = periodic.symmetry.value * course.period
    first, last = pinned_components(periodic.model, periodic.symmetry)
    turned = np.pi * np.array(periodic.turns or np.zeros(periodic.model.full_size))
    pieces: list[tuple[Side, Side]] = []
    if inside[0].start > 0.0:
        pieces.append((Pins(0.0, first, np.zeros(len(first))), inside[0]))
    pieces += itertools.pairwise(inside)
    if inside[-1].end < end:
        pieces.append((inside[-1], Pins(end, last, turned[last])))
    return [Connection(space, orbit, course, piece, "") for piece in pieces]


def places_of(space: SolutionSpace, period: Sequence[Stay]) -> list[Array]:
    """Different equilibria of stays; those of states that turn are the same a turn apart."""
    turning = np.array(space._orbit_of().turns or np.zeros(len(period[0].rest.x))) != 0
    found: list[Array] = []

    def in_turn(x: Array) -> Array:
        return np.where(turning, np.pi - np.mod(np.pi - x, 2.0 * np.pi), x)

    for x in (in_turn(stay.rest.x) for stay in period):
        if not any(np.all(np.abs(in_turn(x - other)) <= 1e-6 * np.max(np.abs(x))) for other in found):
            found.append(x)
    return found


def joined_words(space: SolutionSpace, orbit: Point) -> str:
    """Which equilibria an orbit with a period without bound joins."""
    walking = space.statement.model.parameter_names.index(space.parameter)
    course, stayed = _approaches(space, orbit, walking)
    found = []
    for x in places_of(space, in_a_period(course, stayed)):
        x = np.where(np.abs(x) < SMALLEST_REPORTED_RATIO * course.extent, 0.0, x)
        state = ", ".join(f"{name} = {value:.6g}" for name, value in zip(space.state_names, x, strict=True))
        found.append(f"({state})")
    return f"orbits come to one that is {orbit.special} to {' and '.join(found)}"
