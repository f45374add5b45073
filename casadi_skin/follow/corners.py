"""Corners that a step of a continuation cuts: where a branch turns aside between two points that predict one another.

In a narrow internal resonance a branch turns sharply into an excursion, and comes back to go on from the other side of
the corner almost as if nothing had been there: two branches that would cross if the coupling of the resonance vanished
have parted. The determinant of the Jacobian closed by the tangent keeps its sign along a smooth branch, but has other
signs on either side of the corner, as on either side of a branch point (Keller 1977; Allgower and Georg 1990, chapter
8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.point import LocalCurve, PointSolver
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import Correction, Status
from casadi_skin.solve.watch import check_time_limit
from casadi_skin.zero.cosines import cosine_matrix, second_derivative_matrix
from casadi_skin.zero.problem import EPSILON, Array, Indices, Problem, SingularError
from casadi_skin.zero.settings import Point

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

SHARP_TURN_DEGREES = 15.0  # degrees between both sides and their chord at a corner
IN_LINE = 3.0  # degrees between them where branches cross
SOUGHT_FRACTIONS = (0.5, 0.3, 0.7)  # of the way between two places: where the branch is sought
LEAST_TURN_COSINE = 0.8  # cosine of the turn from a place to one within a step from it, at least
SHORT_CHORD_RATIO = 0.25  # of a step: a chord that turns so much is a corner, not the course of the branch
SMALLEST_CORNER = 1e-7  # a corner of this size is that of branches that cross
ROUNDING_FACTOR = 1000.0  # times what rounding moves a place by: at 30 times chords turn by 30 degrees for nothing
CORNER_STEP_FRACTION = 0.25  # of the distance to the other side of a corner: the step from which it is walked round
LEVEL_SHIFT_RATIO = 0.1  # of a step: what another level of resolution may move its start by
ALIKE_LENGTH_RATIO = 3.0  # ratio of the lengths of a corner on two levels, which halvings determine, at most
POLISHING_STEPS = 2  # steps of Newton's method on a point before a corner
LOOKED_AT = 6  # levels of resolution, at most, on which a corner is sought until two agree


@dataclass(frozen=True)
class Side:
    """A place of a branch in the unknowns of a problem, with its unit tangent and the sign of the determinant.

    `noise` is the distance by which rounding may move it, 0 where that is not looked at.
    """

    problem: Problem
    z: Array
    tangent: Array
    orientation: float
    noise: float = 0.0


@dataclass(frozen=True)
class Corner:
    """The last place found before a corner, and the distance from there to the other side."""

    before: Side
    length: float


def side_of(point_solver: PointSolver, problem: Problem, place: Point | Side) -> Side | None:
    """A place of the branch on a level of resolution, its own or another one; None where it is not found there."""
    z, tangent = (place.problem.prolong(v, problem) for v in (place.z, place.tangent))
    row = point_solver.metric(problem, z) * tangent
    try:
        if problem is not place.problem:
            correction = point_solver.levels.corrector(problem).correct(z, row, float(row @ z))
            if not correction.converged:
                return None
            z = correction.z
        solve = point_solver.factor(problem, z, row)
    except SingularError:
        return None
    return Side(problem, z, point_solver.tangent(problem, z, solve), solve.orientation)


def shifts(point_solver: PointSolver, place: Point | Side, other: Point | Side | None, step: float) -> bool:
    """Whether a place lies too far from itself on another level for a step, maybe beyond a corner."""
    if other is None:
        return True
    there = place.problem.prolong(place.z, other.problem)
    return point_solver.distance(other.problem, there, other.z) > LEVEL_SHIFT_RATIO * step


def turned(point_solver: PointSolver, before: Side, after: Side) -> Corner | None:
    """The corner that a step cuts; None where it cuts none.

    Coarse levels have corners where branches cross, and none where they do not: two levels have to agree.
    """
    problem = max(before.problem, after.problem, key=lambda problem: problem.resolution)
    sides = _on(point_solver, problem, before, after)
    if sides is None or sides[0].orientation * sides[1].orientation >= 0.0:
        return None
    found = corner(point_solver, *sides)
    for _ in range(LOOKED_AT):
        finer = point_solver.levels.finer(problem)
        on_finer = None if finer is None else _on(point_solver, finer, *sides)
        if finer is None or on_finer is None or on_finer[0].orientation * on_finer[1].orientation >= 0.0:
            return found
        problem, sides, last = finer, on_finer, found
        found = corner(point_solver, *sides)
        if _agree(found, last):
            return found
    return None


def _agree(one: Corner | None, other: Corner | None) -> bool:
    """Whether two levels of resolution have the same corner, or both none: that of a coarse grid shrinks."""
    if one is None or other is None:
        return one is other
    return bool(1.0 / ALIKE_LENGTH_RATIO <= one.length / other.length <= ALIKE_LENGTH_RATIO)


def _on(point_solver: PointSolver, problem: Problem, before: Side, after: Side) -> tuple[Side, Side] | None:
    """Two places on one level; None where one is not found there."""
    one, other = (
        place if place.problem is problem else side_of(point_solver, problem, place) for place in (before, after)
    )
    return None if one is None or other is None else (one, other)


def corner(point_solver: PointSolver, before: Side, after: Side) -> Corner | None:
    """The corner between two places of opposite orientations; None where branches cross there.

    The stretch is halved around the change of sign: the two sides of a corner come no nearer to one another than it is
    wide, while those of a branch point go over into one another.
    """
    whole = length = point_solver.distance(before.problem, before.z, after.z)
    while length > max(SMALLEST_CORNER, ROUNDING_FACTOR * before.noise, ROUNDING_FACTOR * after.noise):
        turn = _turn(point_solver, before, after)
        if length <= SHORT_CHORD_RATIO * whole and turn > SHARP_TURN_DEGREES:
            return Corner(before, length)
        tried = (_between(point_solver, before, after, fraction) for fraction in SOUGHT_FRACTIONS)
        middle = next((one for one in tried if one is not None), None)
        if middle is None:  # where branches cross, no place is found next to the crossing, but both sides are in line
            return Corner(before, min(length, SHORT_CHORD_RATIO * whole)) if turn > IN_LINE else None
        if middle.orientation == before.orientation:
            before = middle
        else:
            after = middle
        length = point_solver.distance(before.problem, before.z, after.z)
    return None


def _turn(point_solver: PointSolver, before: Side, after: Side) -> float:
    """The largest angle in degrees between two tangents and the chord."""
    weights = point_solver.metric(before.problem, before.z)
    ways = [np.sqrt(weights) * way for way in (before.tangent, after.z - before.z, after.tangent)]
    first, chord, last = (way / np.linalg.norm(way) for way in ways)
    cosine = min(first @ chord, chord @ last, first @ last)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _between(point_solver: PointSolver, before: Side, after: Side, fraction: float) -> Side | None:
    """The place of the branch at a fraction of the way between two; None where none is near."""
    problem = before.problem
    row = point_solver.metric(problem, before.z) * before.tangent
    way = float(row @ (after.z - before.z))
    if not (way > 0.0 and float(row @ after.tangent) > 0.0):
        return None
    curve = LocalCurve.through(before.z, before.tangent, after.z, after.tangent, row)
    correction, row = point_solver.on_curve(problem, curve, fraction)
    if correction is None:
        return None
    try:
        solve = point_solver.factor(problem, correction.z, row)
        z = correction.z - solve(np.append(problem.evaluate(correction.z)[0], 0.0))  # what is left over is amplified
        response = solve(np.append(problem.rounding(z) * problem.probe, 0.0))
        tangent = point_solver.tangent(problem, z, solve)
    except SingularError:
        return None
    weights = point_solver.metric(problem, z)
    if float((weights * before.tangent) @ tangent) < LEAST_TURN_COSINE:
        return None
    return Side(problem, z, tangent, solve.orientation, float(np.sqrt(np.sum(weights * response**2))))


def point_before(point_solver: PointSolver, found: Corner) -> Point | None:
    """The point before a corner, with the step to go on with; None where none is as near. Raises SingularError."""
    problem, z, tangent = found.before.problem, found.before.z, found.before.tangent
    row = point_solver.metric(problem, z) * tangent
    point = point_solver.refined(problem, Correction(z, Status.CONVERGED, 0), row, tangent=tangent)
    if point is None:
        return None
    z, tangent = point.z, point.tangent
    for _ in range(POLISHING_STEPS):  # what a finer level leaves over may be more than a step round the corner
        row = point_solver.metric(point.problem, z) * tangent
        solve = point_solver.factor(point.problem, z, row)
        z = z - solve(np.append(point.problem.evaluate(z)[0], 0.0))
        tangent = point_solver.tangent(point.problem, z, solve)
    point = replace(point, z=z, tangent=tangent, step=CORNER_STEP_FRACTION * found.length)
    return None if shifts(point_solver, found.before, point, found.length) else point


# Internal resonances that a family was led past: neighbouring orbits between which an eigenvalue has changed sign -----

SYMMETRY_RTOL = 1e-9  # of the largest entry: difference of a symmetric Jacobian from its transpose
TURN_TO_CHANGE_STRETCHES = (
    3  # stretches between a turn of the frequency and the change of the number that belongs to it, at most
)
RESONANCE_HALVINGS = 6  # of a stretch that a resonance may lie on
SHORTEST_STRETCH = 1e-7  # of its length in the metric: corners of this size are those of branches that cross
HIGHEST_FREQUENCY_FACTOR = 1.1  # times the highest frequency: harmonics above it have no resonance


@dataclass(frozen=True)
class PassedResonance:
    """A stretch of a family between two neighbouring orbits on which it may have gone round a resonance.

    Attributes:
        S: amplitudes of both orbits.
        Omega: their frequencies.
        changes: by how many the number of positive eigenvalues differs.
        meetings: pairs of a harmonic of Omega and a mode, by ascending frequency about the orbit, that meet there.
    """

    S: tuple[float, float]
    Omega: tuple[float, float]
    changes: int
    meetings: tuple[tuple[int, int], ...]

    @property
    def met(self) -> str:
        """The meetings in words, empty where frequencies show none."""
        return ", ".join(f"{harmonic} Omega with mode {mode}" for harmonic, mode in self.meetings)

    def __str__(self) -> str:
        named = f" ({self.met})" if self.met else ""
        between = f"between S = {self.S[0]:.10g} and {self.S[1]:.10g}"
        return f"a narrow resonance is passed over {between}{named}"


def passed_resonances(
    point_solver: PointSolver, points: Sequence[Point], S_of: Callable[[Point], float]
) -> tuple[PassedResonance, ...] | None:
    """Stretches between neighbouring points that may pass a resonance; None where the Jacobian is not symmetric.

    A stretch is halved as long as orbits are found on it: where the frequency turns more than once between two points
    the number changes by more than one, or not at all. Where branches cross nothing is passed over.

    Arguments:
        point_solver: of the family.
        points: of it in order.
        S_of: the amplitude of a point.
    """
    points, known = list(points), _counted(point_solver.levels, points)
    if known is None:
        return None
    for _ in range(RESONANCE_HALVINGS):
        for place in reversed(_unexplained(known)):
            middle = _orbit_between(point_solver, points[place], points[place + 1])
            counted = None if middle is None else _counted(point_solver.levels, [middle])
            if middle is not None and counted is not None:
                points.insert(place + 1, middle)
                known[place + 1 : place + 1] = counted
    stretches = [(points[k : k + 2], known[k : k + 2]) for k in _unexplained(known)]
    return tuple(_passed(*one, S_of) for one in stretches if not _cross(point_solver, *one))


def _cross(point_solver: PointSolver, points: Sequence[Point], known: Sequence[_Counted]) -> bool:
    """Whether another branch crosses between two points, as where an excursion meets orbits of a third of its period.

    There both sides go over into one another; those of a corner do not.
    """
    problem = max((one.problem for one in known), key=lambda problem: problem.resolution)
    sides = [side_of(point_solver, problem, point) for point in points]
    if sides[0] is None or sides[1] is None or sides[0].orientation * sides[1].orientation >= 0.0:
        return False
    return turned(point_solver, sides[0], sides[1]) is None


def _orbit_between(point_solver: PointSolver, before: Point, after: Point) -> Point | None:
    """An orbit between two, on their line to third order; None where none is found there."""
    curve, length = point_solver.curve(before, after)
    if not length > SHORTEST_STRETCH or not curve.slope(length) @ curve.slope(0.0) > 0.0:
        return None
    return point_solver.along(before, after, 0.5)


def _passed(points: Sequence[Point], known: Sequence[_Counted], S_of: Callable[[Point], float]) -> PassedResonance:
    """The stretch between two points."""
    (before, after), (one, other) = points, known
    met = (
        ()
        if one.eliminates
        else tuple(sorted(_meetings(_by_harmonic(one.problem, one.z), _by_harmonic(other.problem, other.z))))
    )
    S, Omega = (S_of(before), S_of(after)), (before.Omega, after.Omega)
    return PassedResonance(S, Omega, abs(one.positive - other.positive), met)


def _unexplained(known: Sequence[_Counted]) -> list[int]:
    """Places before stretches on which the number changes otherwise than by turns of the frequency.

    Where the orbit has a shorter period the frequency turns by symmetry, and the number stays. A turn and its change
    may lie on neighbouring stretches: orbits next to a turn are known to their errors alone.
    """
    changes = [abs(one.positive - other.positive) for one, other in pairwise(known)]
    turns = [int(one.direction != other.direction) for one, other in pairwise(known)]
    open_turns = {place for place, turn in enumerate(turns) if turn > changes[place]}
    found = []
    for place, count in enumerate(changes):
        near = next((turn for turn in sorted(open_turns) if abs(turn - place) <= TURN_TO_CHANGE_STRETCHES), None)
        if count == 1 and not turns[place] and near is not None:
            open_turns.remove(near)
        elif count > turns[place]:
            found.append(place)
    return found


@dataclass(frozen=True)
class _Counted:
    """Positive eigenvalues at a point, on a level with z there, and the sign of the rate of Omega.

    The number may be one up to a constant where sites are eliminated.
    """

    problem: Problem
    z: Array
    positive: int
    direction: float
    eliminates: bool


def _counted(levels: Levels, points: Sequence[Point]) -> list[_Counted] | None:
    """Those of points, on levels with all harmonics that may meet a mode; None where there is no such count."""
    check_time_limit("internal resonances between the points of a family")
    placed = [_on_enough(levels, point) for point in points]
    known = [one for one in placed if one is not None]
    found: dict[int, _Counted] = {}
    for problem in dict.fromkeys(problem for problem, _ in known):
        these = [k for k, (other, _) in enumerate(known) if other is problem]
        counts = _positive(problem, np.array([known[k][1] for k in these]))
        if counts is None:
            return None
        for k, positive in zip(these, counts.tolist(), strict=True):
            # u in the place of Omega rises with it, or falls, also where Omega itself stands still
            direction = float(np.sign(points[k].tangent[points[k].problem.Omega_index]))
            eliminates = problem.by_itself(known[k][1])[0] is not problem
            found[k] = _Counted(problem, known[k][1], positive, direction, eliminates)
    return [found[k] for k in range(len(points))] if len(known) == len(points) else None


def _on_enough(levels: Levels, point: Point) -> tuple[Problem, Array] | None:
    """The level for a point with its unknowns there; None where there is none, or no odd cosines."""
    problem, z = point.problem, point.z
    if not problem.cosines:
        return None
    core, own = problem.by_itself(z)
    highest = HIGHEST_FREQUENCY_FACTOR * float(np.sqrt(np.max(np.sum(np.abs(_forces(core, own)), axis=1))))
    enough = [r for r in levels.resolutions if r >= problem.resolution and 2 * r - 1 > highest]
    if not enough:
        return None
    finer = levels.problem(enough[0])
    return finer, problem.prolong(z, finer)


def _positive(problem: Problem, states: Array) -> Indices | None:
    """Numbers of positive eigenvalues of the Jacobians by the orbit at states; None where these are not symmetric."""
    from scipy.sparse import csc_matrix

    alone = [problem.by_itself(z) for z in states]
    core = alone[0][0]
    rows, columns = core.pattern
    inner = (rows < core.states) & (columns < core.states)
    rows, columns = rows[inner], columns[inner]
    values = core.evaluate_all(np.array([own for _, own in alone]))[1][:, inner]
    keys, turned = rows * core.states + columns, columns * core.states + rows
    order, reverse = np.argsort(keys), np.argsort(turned)
    if not np.array_equal(keys[order], turned[reverse]):
        return None
    if np.max(np.abs(values[:, order] - values[:, reverse])) > SYMMETRY_RTOL * np.max(np.abs(values)):
        return None
    found, every = np.zeros(len(states), dtype=np.int64), np.arange(core.states)
    rows, columns = np.append(rows, every), np.append(columns, every)
    for k, z in enumerate(states):
        block, there, beyond = problem.eliminated(z)
        zero = np.full(every.size, EPSILON * float(np.max(np.abs(values[k]))))  # a zero eigenvalue counts as positive
        matrix = csc_matrix((np.append(values[k], zero), (rows, columns)), shape=(every.size, every.size))
        if block.size:
            ends = np.repeat(every[there], len(block)), np.tile(every[there], len(block))
            matrix = matrix + csc_matrix((block.ravel(), ends), shape=matrix.shape)
        found[k] = beyond + positive_eigenvalues(matrix)
    return found


def positive_eigenvalues(matrix: csc_matrix) -> int:
    """The number of positive eigenvalues of a symmetric matrix: that of its positive pivots (Sylvester)."""
    from scipy.sparse.linalg import splu

    factors = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return int(np.count_nonzero(factors.U.diagonal() > 0.0))


def _forces(problem: Problem, z: Array) -> Array:
    """Derivatives of restoring forces over Omega^2 by positions, shape (sites, sites, nodes)."""
    H, N = problem.resolution, problem.states // problem.resolution
    rows, columns = problem.pattern
    entries = problem.evaluate(z)[1]
    found = np.zeros((N, N, H))
    at_node = (rows < problem.states) & (columns < problem.states) & (rows % H == columns % H)
    row, column = rows[at_node], columns[at_node]
    np.add.at(found, (row // H, column // H, row % H), entries[at_node])
    every = np.arange(N)
    found[every, every] -= np.diag(second_derivative_matrix(H))
    return found


def _by_harmonic(problem: Problem, z: Array) -> Array:
    """Eigenvalues of the Jacobian of each harmonic alone, shape (harmonics, sites), descending."""
    H = problem.resolution
    shares = (2.0 / H) * cosine_matrix(H) ** 2
    alone = np.einsum("nmi,ik->knm", _forces(problem, z), shares)
    alone -= (2.0 * np.arange(H)[:, None, None] + 1.0) ** 2 * np.eye(alone.shape[1])
    return np.asarray(np.linalg.eigvalsh(alone)[:, ::-1])


def _meetings(before: Array, after: Array) -> set[tuple[int, int]]:
    """Pairs of a harmonic and a mode whose eigenvalue by itself changes sign; the mode's own harmonic is none."""
    shared = min(len(before), len(after))
    harmonics, places = np.nonzero((before[:shared] > 0.0) != (after[:shared] > 0.0))
    return {(2 * int(k) + 1, before.shape[1] - int(place)) for k, place in zip(harmonics, places, strict=True)}
