"""Internal resonances that a family was led past: neighbouring orbits between which an eigenvalue has changed sign.

Along a smooth family the Jacobian by the orbit, at fixed frequency and amplitude, has as many positive eigenvalues
throughout, and one more or less after each turn of the frequency (Sylvester's law of inertia; Keller 1977 for signs of
determinants alone, in which two changes cancel). Where the number changes otherwise, and the two sides are no smooth
continuation of one another as where branches cross, a corner was passed that is narrower than was resolved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from casadi_skin.follow.corners import side_of, turned
from casadi_skin.follow.point_solver import PointSolver
from casadi_skin.follow.settings import Point
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.time_limit import heed
from casadi_skin.zero.cosines import cosine_matrix, second_derivative_matrix
from casadi_skin.zero.problem import EPSILON, Array, Indices
from casadi_skin.zero.trigonometric import TrigonometricProblem

SYMMETRIC = 1e-9  # of the largest entry: difference of a symmetric Jacobian from its transpose
NEAR = 3  # stretches between a turn of the frequency and the change of the number that belongs to it, at most
HALVINGS = 6  # of a stretch that a resonance may lie on
SHORTEST = 1e-7  # of its length in the metric: corners of this size are those of branches that cross
BEYOND = 1.1  # times the highest frequency: harmonics above it have no resonance


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
    for _ in range(HALVINGS):
        for place in reversed(_unexplained(known)):
            middle = _between(point_solver, points[place], points[place + 1])
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


def _between(point_solver: PointSolver, before: Point, after: Point) -> Point | None:
    """An orbit between two, on their line to third order; None where none is found there."""
    curve, length = point_solver.curve(before, after)
    if not length > SHORTEST or not curve.slope(length) @ curve.t0 > 0.0:
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
        near = next((turn for turn in sorted(open_turns) if abs(turn - place) <= NEAR), None)
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

    problem: TrigonometricProblem
    z: Array
    positive: int
    direction: float
    eliminates: bool


def _counted(levels: Levels, points: Sequence[Point]) -> list[_Counted] | None:
    """Those of points, on levels with all harmonics that may meet a mode; None where there is no such count."""
    heed("internal resonances between the points of a family")
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


def _on_enough(levels: Levels, point: Point) -> tuple[TrigonometricProblem, Array] | None:
    """The level for a point with its unknowns there; None where there is none, or no odd cosines."""
    problem, z = point.problem, point.z
    if not isinstance(problem, TrigonometricProblem):
        return None
    core, own = problem.by_itself(z)
    highest = BEYOND * float(np.sqrt(np.max(np.sum(np.abs(_forces(core, own)), axis=1))))
    enough = [r for r in levels.resolutions if r >= problem.resolution and 2 * r - 1 > highest]
    if not enough:
        return None
    finer = levels.problem(enough[0])
    assert isinstance(finer, TrigonometricProblem)
    return finer, problem.prolong(z, finer)


def _positive(problem: TrigonometricProblem, states: Array) -> Indices | None:
    """Numbers of positive eigenvalues of the Jacobians by the orbit at states; None where these are not symmetric."""
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
    if np.max(np.abs(values[:, order] - values[:, reverse])) > SYMMETRIC * np.max(np.abs(values)):
        return None
    blocks = _Blocks.of(rows, columns, values, core.states, core.half_bandwidth or core.states)
    beyond = np.zeros(len(states), dtype=np.int64)
    for k, z in enumerate(states):
        block, there, beyond[k] = problem.eliminated(z)
        if block.size:
            blocks.inside[k, there.start // blocks.width] += block
    return np.asarray(beyond + blocks.positive())


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Symmetric band matrices by blocks on the diagonal and left of it, shape (matrices, blocks, width, width)."""

    inside: Array
    beside: Array

    @classmethod
    def of(cls, rows: Indices, columns: Indices, values: Array, size: int, width: int) -> _Blocks:
        """From the places of entries, and their values, shape (matrices, entries)."""
        shape = (len(values), -(-size // width), width, width)
        inside, beside = np.zeros(shape), np.zeros(shape)
        for blocks, apart in ((inside, 0), (beside, 1)):
            here = rows // width == columns // width + apart
            blocks[:, rows[here] // width, rows[here] % width, columns[here] % width] = values[:, here]
        left_over = np.arange(size - (shape[1] - 1) * width, width)
        inside[:, -1, left_over, left_over] = -1.0
        return cls(inside, beside)

    @property
    def width(self) -> int:
        return int(self.inside.shape[-1])

    def positive(self) -> Indices:
        """Numbers of positive eigenvalues, from the Schur complements block by block."""
        found, complement = np.zeros(len(self.inside), dtype=np.int64), np.zeros_like(self.inside[:, 0])
        for k in range(self.inside.shape[1]):
            values, vectors = np.linalg.eigh(self.inside[:, k] - complement)
            values[values == 0.0] = EPSILON
            found += np.count_nonzero(values > 0.0, axis=1)
            if k + 1 < self.inside.shape[1]:
                along = self.beside[:, k + 1] @ vectors
                complement = (along / values[:, None]) @ along.transpose(0, 2, 1)
        return found


def _forces(problem: TrigonometricProblem, z: Array) -> Array:
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


def _by_harmonic(problem: TrigonometricProblem, z: Array) -> Array:
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
