"""The ledger of a branch of equilibria: how many eigenvalues are unstable along it, and whether events account for it.

The search between two points (see `search`) sees a branch at a few places, and what is smooth between them. Here the
number of unstable eigenvalues is counted at many: 1024 over the range of the parameter, and as many on a part of the
branch where the state changes in place of the parameter. A Hopf point changes it by two, a fold by one, a branch point
by one or, on the branch that leaves to one side, by none.

Special points are distinguished by their eigenvalues, then located one by one. The parameter turns back at a fold; the
Jacobian closed by the tangent changes the sign of its determinant at a branch point; a pair of complex eigenvalues
crosses the imaginary axis at a Hopf point. A stretch is sampled in between, and halved until each of these quantities
has no root on it, or one simple root within the errors of the cubics through the samples (see `search`). Neutral
saddles have no eigenvalue on the axis, and are not seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.rest_samples import Leading, half_plane, rightmost
from casadi_skin.follow.samples import Crossing, Sample, SampledStretch, hermite_cubic
from casadi_skin.follow.search import CLEAR_DISTANCE, Search, gap_between
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import locate_rest
from casadi_skin.native import kernels
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.zero.balanced import BalancedMatrix, dense
from casadi_skin.zero.half_plane import HalfPlaneError
from casadi_skin.zero.kinds import BRANCH_POINT, FOLD, HOPF, Unresolved, kind_of
from casadi_skin.zero.problem import Array, Indices, SingularError
from casadi_skin.zero.rest import AlgebraicProblem
from casadi_skin.zero.settings import Point

LEDGER_PLACES = 1024  # over the range of the parameter
OF_PROGRAMS = 128  # of a program, whose derivatives are differences and cost as much
LEDGER_LENGTH = 6.0  # of a branch, in units of its states, that has as many places as the range of the parameter
MOST_PLACES_BETWEEN = 8192  # places between two points
NEWTON_STEPS = 4  # steps
SETTLED_STEP = 1e-7  # of a stretch: a step that is none
# States: eigenvalues of more are computed only where derivatives are not what is between two points.
SMALL_STATE_COUNT = 16
SMALL_EIGENVALUE_RTOL, SMALL_ENTRY_RTOL = 1e-6, 1e-9  # of the largest: real parts that rounding may decide
PROVED_EVERY = 8  # stretches of a branch of a large system
SURE_CHANGE_FACTOR = 10.0  # times the change of an eigenvalue, to first order, that leaves it on its side
Flags = NDArray[np.bool_]
SPECIAL_POINTS = "special points"  # in words: what may be missing
AT_EVENT_DISTANCE = 1e-9  # of a stretch: a place at an event itself


@dataclass(frozen=True, eq=False)
class Counts:
    """Numbers of unstable eigenvalues on the stretch between two points.

    Attributes:
        before, after: the points.
        row: the metric times the tangent of the first.
        sigma: places by row . (z - z of the first), both ends among them.
        least, most: bounds of the numbers there: eigenvalues on the axis but for errors are on either side.
        unknowns: the equilibria, shape (place, unknowns).
    """

    before: Point
    after: Point
    row: Array
    sigma: Array
    least: Indices
    most: Indices
    unknowns: Array

    def place(self, point: Point) -> float:
        """Where a point is."""
        return float(self.row @ (point.z - self.before.z))

    @cached_property
    def cuts(self) -> list[int]:
        """Places between which the number changes, where it does so more often than the ends show."""
        sure = np.flatnonzero(self.least == self.most)
        changes = np.flatnonzero(np.diff(self.least[sure]))
        if changes.size < 2:
            return []
        return sorted({*map(int, sure[changes]), *map(int, sure[changes + 1])})

    def points(self, equations: SolutionSpace, places: Sequence[int]) -> list[Point]:
        """Points of the branch at places within the stretch, at which equations are regular."""
        solver, problem, found = equations.point_solver, self.before.problem, list[Point]()
        for k in places:
            if 0 < k < self.sigma.size - 1:
                z = self.unknowns[k]
                with suppress(SingularError):
                    tangent = solver.tangent(problem, z, solver.factor(problem, z, self.row))
                    found.append(self.before.marked("", z=z, tangent=tangent))
        return [point for point in found if not equations.blurred(point)]

    def violation(self, events: Sequence[Point]) -> tuple[int, int] | None:
        """Neighbouring places between which events do not account for the numbers; None where they do throughout."""
        placed = sorted((self.place(event), kind_of(event.special).changes) for event in events)
        possible = set(range(int(self.least[0]), int(self.most[0]) + 1))
        last, length = 0, float(self.sigma[-1])
        for k in range(1, self.sigma.size):
            end = k == self.sigma.size - 1
            while placed and (placed[0][0] <= self.sigma[k] or end):
                changes = placed.pop(0)[1]
                possible = {n + sign * change for n in possible for change in changes for sign in (-1, 1)}
            known = {n for n in possible if self.least[k] <= n <= self.most[k]}
            if not known:
                beside = [abs(self.place(event) - self.sigma[k]) <= AT_EVENT_DISTANCE * length for event in events]
                if not any(beside):
                    return last, k
                continue
            if self.least[k] == self.most[k]:
                possible, last = known, k
        return None


@dataclass(frozen=True, eq=False)
class Places:
    """Equilibria between two points, by Newton's method from the cubic through both.

    Attributes:
        before, after: the points.
        row: the metric times the tangent of the first.
        length: of the stretch by row . (z - z of the first), on which places are at equal distances.
        unknowns: the equilibria, shape (place, unknowns).
        entries: non-zeros of the Jacobians there, but for a last step that is none, shape (place, non-zeros).
        settled: where the steps became small.
    """

    before: Point
    after: Point
    row: Array
    length: float
    unknowns: Array
    entries: Array
    settled: Flags

    @property
    def fractions(self) -> Array:
        """Where they are, as fractions of the stretch, both ends among them."""
        return np.linspace(0.0, 1.0, len(self.unknowns))

    @classmethod
    def of(cls, equations: SolutionSpace, before: Point, after: Point) -> Places:
        """As many as the ledger has between two points."""
        solver, problem = equations.point_solver, before.problem
        joined = solver.joined(before, after)
        row, curve = joined.row, joined.curve
        over = LEDGER_PLACES if equations.statics.exact else OF_PROGRAMS
        many = max(abs(after.parameter - before.parameter), curve.length / LEDGER_LENGTH)
        count = min(max(math.ceil(over * many), 3), MOST_PLACES_BETWEEN)
        guesses, _ = curve.samples(curve.length, count + 1)
        guesses[0], guesses[-1] = before.z, after.z
        still, weights = SETTLED_STEP * curve.length, solver.metric(problem, before.z)
        return cls(before, after, row, curve.length, *_solved(problem, guesses, row, still, weights))

    def clear(self, equations: SolutionSpace) -> bool:
        """Whether every eigenvalue stays on its side of the imaginary axis, by far more than it moves between places.

        The k-th largest real part is a continuous function of the place, of which a special point is a zero.
        """
        problem = self.before.problem
        if not self.settled.all() or float(self.row @ self.after.tangent) < SHARP_TURN_COSINE:
            return False
        if problem.statics.size > SMALL_STATE_COUNT:
            return self._stay(*map(equations.leading, (self.before, self.after)))
        if problem.along is not None:
            small = np.array([SMALL_EIGENVALUE_RTOL, SMALL_ENTRY_RTOL])
            data = problem.along, len(self.entries), self.entries, SURE_CHANGE_FACTOR, small
            return not kernels()["keep_sides"](*data)
        matrices = problem.filled(self.entries)[:, :, :-1]
        real = np.sort(np.linalg.eigvals(matrices).real, axis=1)
        moved, (low, high) = np.abs(real[1:] - real[:-1]).max(axis=0), (real.min(axis=0), real.max(axis=0))
        rounding = max(SMALL_EIGENVALUE_RTOL * max(-low[0], high[-1]), SMALL_ENTRY_RTOL * np.abs(matrices).max())
        return bool((np.maximum(low, -high) > np.maximum(SURE_CHANGE_FACTOR * moved, rounding)).all())

    def _stay(self, first: Leading, last: Leading) -> bool:
        """The same by eigenvalues and rates at both ends, where derivatives between them are as these show."""
        if len({*first.numbers, *last.numbers}) > 1:
            return False
        g, slopes = self._real_parts(first, last)
        moves = np.abs(g[1] - g[0]) + np.abs(slopes[0]) + np.abs(slopes[1])
        far = (np.sign(g[0]) == np.sign(g[1])) & (np.min(np.abs(g), axis=0) > CLEAR_DISTANCE * moves)
        return bool(np.all(far)) and not np.any(self.unlike(first, last)[1:-1])

    def _real_parts(self, first: Leading, last: Leading) -> tuple[Array, Array]:
        """The largest real parts at both ends, and their rates over the stretch, shape (2, eigenvalues)."""
        many, length, ends = leading_count(first, last), self.length, (first, last)
        rates = (length, length / float(self.row @ self.after.tangent))
        return np.array([end.values.real[:many] for end in ends]), np.array(
            [end.rates.real[:many] * rate for end, rate in zip(ends, rates, strict=True)]
        )

    def unlike(self, first: Leading, last: Leading) -> Flags:
        """Where derivatives are not what is between a few places, by as much as may take an eigenvalue across."""
        problem, fractions, (g, slopes) = self.before.problem, self.fractions, self._real_parts(first, last)
        nodes = np.unique(np.linspace(0, len(fractions) - 1, 4).astype(int))
        weights = np.array([[np.prod([(t - fractions[j]) / (fractions[i] - fractions[j]) for j in nodes if j != i])
                             for i in nodes] for t in fractions])  # fmt: skip
        off, many = self.entries - weights @ self.entries[nodes], g.shape[1]
        moved = SURE_CHANGE_FACTOR * np.maximum(*(end.moved(problem, off, many) for end in (first, last)))
        values, _ = hermite_cubic(g, slopes, np.repeat(fractions[:, None], many, axis=1))
        found = np.any(moved[:, :many] >= np.abs(values), axis=1) | np.any(moved[:, many:] >= 1.0, axis=1)
        found[[0, -1]] = True
        return np.asarray(found)


def leading_count(first: Leading, last: Leading) -> int:
    """How many eigenvalues matter between two points."""
    margin = min(first.margin, last.margin)
    return min(max(first.needed(margin), last.needed(margin), 1), first.values.size, last.values.size)


def counted(equations: SolutionSpace, places: Places) -> Counts | None:
    """The numbers of unstable eigenvalues between two points; None where the branch is not found there."""
    before, after, fractions, unknowns = places.before, places.after, places.fractions, places.unknowns
    problem, sigma = before.problem, places.length * fractions
    for k in np.flatnonzero(~places.settled):
        point = equations.point_solver.along(before, after, float(fractions[k]))
        if point is None:
            return None
        unknowns[k] = point.z
    places = replace(places, entries=problem.equations_at_all(unknowns)[1])
    if problem.statics.size <= SMALL_STATE_COUNT:
        seen = np.ones(sigma.size, dtype=bool)
        least, most = _numbers(problem, places.entries)
    else:
        ends = [equations.leading(end) for end in (before, after)]
        seen = places.unlike(*ends)
        first, last = (np.array(end.numbers)[:, None] for end in ends)
        inner = _numbers(problem, places.entries[seen][1:-1])
        least, most = np.concatenate([first, np.array(inner), last], axis=1)
    return Counts(before, after, places.row, sigma[seen], least, most, unknowns[seen])


def _solved(
    problem: AlgebraicProblem, z: Array, row: Array, still: float, weights: Array
) -> tuple[Array, Array, Flags]:
    """Equilibria near states, each at its place along; non-zeros of Jacobians, and whether the steps settled."""
    z, left, settled = z.copy(), np.arange(len(z)), np.zeros(len(z), dtype=bool)
    kept = np.empty((len(z), problem.pattern[0].size))
    if problem.along is not None:
        kernels()["rests_along"](problem.along, len(z), NEWTON_STEPS, still, row, weights, z, kept, settled)
        return z, kept, settled
    steps_of = partial(_chord_steps if problem.statics.is_sparse else _steps, problem, row)
    for _ in range(NEWTON_STEPS):
        residuals, kept[left] = problem.equations_at_all(z[left])
        try:
            steps = steps_of(residuals, kept[left])
        except (np.linalg.LinAlgError, SingularError):  # one is singular
            break
        z[left] -= steps
        small = np.sqrt(steps**2 @ weights) <= still
        settled[left[small]] = True
        left = left[~small]
        if not left.size:
            break
    return z, kept, settled


def _steps(problem: AlgebraicProblem, row: Array, residuals: Array, entries: Array) -> Array:
    """Newton steps at states."""
    closed, right = np.empty((len(entries), problem.size, problem.size)), np.zeros((len(entries), problem.size, 1))
    closed[:, :-1], closed[:, -1], right[:, :-1, 0] = problem.filled(entries), row, residuals
    return np.asarray(np.linalg.solve(closed, right)[..., 0])


def _chord_steps(problem: AlgebraicProblem, row: Array, residuals: Array, entries: Array) -> Array:
    """The same with the matrix of one of them, which is near to those of the others."""
    middle = entries[len(entries) // 2]
    largest = problem.equation_sizes(np.zeros(problem.size), middle)
    solve = BorderedSolver.of(problem).unchecked(middle / largest[problem.pattern[0]], row)
    return solve(np.append((residuals / largest).T, np.zeros((1, len(residuals))), axis=0)).T


def _numbers(problem: AlgebraicProblem, entries: Array) -> tuple[Indices, Indices]:
    """Bounds of the numbers of eigenvalues with a positive real part."""
    n, rounding = problem.states, problem.statics.model.rounding
    if not problem.statics.is_sparse:
        return _dense_numbers(problem.filled(entries)[:, :n, :n], rounding)
    bounds = list[tuple[int, int]]()
    for some in entries:
        matrix = problem.states_part(some)
        part = half_plane(problem, matrix)
        bounds += [part.numbers(rounding)] if part else zip(*_dense_numbers(dense(matrix)[None], rounding), strict=True)
    least, most = np.array(bounds, dtype=int).reshape(-1, 2).T
    return least, most


def _dense_numbers(stack: Array, rounding: float) -> tuple[Indices, Indices]:
    """The same of matrices (matrix, n, n)."""
    real = np.linalg.eigvals(stack).real
    least, most = np.sum(real > 0.0, axis=1), np.sum(real > 0.0, axis=1)
    near = np.min(np.abs(real), axis=1) <= SMALL_EIGENVALUE_RTOL * np.max(np.abs(real), axis=1)
    near |= np.max(np.abs(stack), axis=(1, 2)) * SMALL_ENTRY_RTOL > np.min(np.abs(real), axis=1)
    for k in np.flatnonzero(near):
        linear = BalancedMatrix(stack[k], rounding)
        values, errors = linear.eigensystem[0].real, linear.errors()
        least[k], most[k] = np.sum(values > errors), np.sum(values > -errors)
    return least, most


class Census:
    """Proofs along a branch of a large system that the eigenvalues known beside the axis are all that there are.

    Attributes:
        whole: whether all eigenvalues are computed, as those beside the axis are not found.
    """

    def __init__(self, equations: SolutionSpace) -> None:
        self.equations, self.whole = equations, False
        self._proved: Point | None = None
        self._passed = list[Point]()  # since then

    def passed(self, before: Point, after: Point) -> list[Unresolved]:
        """Goes on by a stretch; the part of the branch since the last proof where the next one fails."""
        if not self.equations.statics.is_sparse:
            return []
        if self._proved is None:
            self._proved, self.whole = before, not self._is_whole(before)
        self._passed.append(after)
        return self.close() if len(self._passed) >= PROVED_EVERY else []

    def close(self) -> list[Unresolved]:
        """The part of the branch since the last proof where there is none at its end."""
        if self._proved is None or not self._passed:
            return []
        start, end = self._proved, self._passed[-1]
        self._proved, self._passed = end, []
        if self._is_whole(end):
            return []
        words = "the number of eigenvalues near the imaginary axis is not proved"
        return [gap_between(self.equations, start, end, words, SPECIAL_POINTS)]

    def _is_whole(self, point: Point) -> bool:
        part = self.equations.leading(point).part
        with suppress(HalfPlaneError):
            return part is None or part.missing == 0
        return False


# Special points on a stretch of a branch of equilibria: distinguished by their eigenvalues, then located one by one

TOGETHER_DEPTH = 4  # divisions after which a fold and a branch point that cannot be separated are one
SHARP_TURN_COSINE = 0.5  # cosine of the turn between two points: a step turns by less
POLE_RATIO = 1e3  # of eigenvalues beside a stretch that cannot be halved: on it one goes through infinity
POLE_WORDS = "an eigenvalue goes through infinity, as where a mass matrix or algebraic equations are singular"
NO_CROSSING = Crossing(0, "", 0.0, 1)  # of a fold or a branch point, which need none
MOST_RECOUNTS = 3  # divisions of a stretch where special points do not account for eigenvalues
SAME_POINT_RTOL = 1e-9  # of a step or of a frequency
OUTSIDE_STRETCH = 1e-6  # of a stretch: a special point farther out is another one
FARTHEST_FROM_EXPECTED = 0.7  # of a stretch: how far from where it is expected a special point may be found


def special_between(equations: SolutionSpace, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
    """Special points between two points of a branch in order, each marked by its kind.

    Where several lie too near to each other to be separated, they are all at the start of the part that `gaps` gets.
    The stretch is divided where the number of unstable eigenvalues differs along it, or the special points do not
    account for it; what stays is named.
    """
    gaps += equations.census.passed(before, after)
    places = Places.of(equations, before, after)
    if places.clear(equations):
        return
    search = _Search(equations, before, after)
    counts = counted(equations, places) if search.free else None
    if counts is None:
        yield from search.on_stretch()
        gaps += search.gaps
        if search.free:
            words = "the branch is not found between two points"
            gaps.append(gap_between(equations, before, after, words, SPECIAL_POINTS))
        return
    cuts = counts.cuts
    for _ in range(MOST_RECOUNTS):
        parts, missed = pairwise((before, *counts.points(equations, cuts), after)), list[Unresolved]()
        events = [one for ends in parts for one in _between(equations, *ends, missed)]
        missing = None if missed else counts.violation(events)
        if missing is None:
            break
        cuts = sorted({*cuts, *missing})
    yield from events
    gaps += missed
    if missing is not None:
        numbers = " to ".join(str(counts.least[k]) for k in missing)
        words = f"the number of unstable eigenvalues goes from {numbers}, and no special point accounts for it"
        start, end = (replace(before, z=counts.unknowns[k]) for k in missing)
        gaps.append(gap_between(equations, start, end, words, SPECIAL_POINTS))


def _between(equations: SolutionSpace, before: Point, after: Point, gaps: list[Unresolved]) -> list[Point]:
    """Special points of a part; it is named where the branch turns by so much that no curve through its ends is it."""
    if float(equations.sample(before).row @ after.tangent) < SHARP_TURN_COSINE:
        words = "the branch turns sharply between two points"
        gaps.append(gap_between(equations, before, after, words, SPECIAL_POINTS))
        return []
    search = _Search(equations, before, after)
    found = search.on_stretch()
    gaps += search.gaps
    return found


class _Search(Search):
    """Folds, branch points and Hopf points on one stretch of a branch."""

    deepest, most_parts = 20, 400

    def __init__(self, equations: SolutionSpace, before: Point, after: Point) -> None:
        conserves = equations.model.order == 1 and all(equations.sample(end).symmetric for end in (before, after))
        self.free = equations.statics.oscillates and not conserves  # whether pairs may cross the axis one by one
        super().__init__(equations.point_solver, before, after, real=not self.free)
        self.equations, self.squares = equations, not self.free and equations.model.order == 1
        self._count = leading_count(*map(equations.leading, (before, after)))

    def sampled(self, point: Point) -> Sample:
        sample: Sample = rightmost(self.equations.sample(self.own(point)), self._count)
        if not self.squares:
            return sample
        return replace(sample, values=sample.values**2, rates=2.0 * sample.values * sample.rates)

    def is_clear(self, point: Point) -> bool:
        return not self.equations.blurred(self.own(point))

    def passes(self, ends: SampledStretch) -> bool:
        return False

    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[Point] | None:
        crossings = self._crossings(stretch)
        reals, pairs = ([one for one in crossings if (one.kind == HOPF) is pair] for pair in (False, True))
        kinds = [FOLD] * stretch.turns + [BRANCH_POINT] * stretch.reorients
        if set(kinds) == {FOLD, BRANCH_POINT} and not reals and (depth >= TOGETHER_DEPTH or last):
            kinds, reals = [BRANCH_POINT], [NO_CROSSING]  # where a branch leaves another one to one side
        elif not (last or np.all(stretch.isolates_roots)):
            return None
        if not (kinds or crossings):
            return ()
        if len(kinds) > 1 or not (kinds or pairs) or (self.free and len(reals) != len(kinds)):
            return None
        wanted = [(kind, (reals or [NO_CROSSING])[0]) for kind in kinds] + [(HOPF, one) for one in pairs]
        located = [self.located(stretch, kind, crossing) for kind, crossing in wanted]
        known = sorted((one for one in located if one is not None), key=lambda one: one[:2])
        alike = partial(np.allclose, rtol=SAME_POINT_RTOL, atol=SAME_POINT_RTOL)
        twice = any(alike(one[:2], other[:2]) for one, other in pairwise(known))
        return None if twice or len(known) < len(wanted) else [point for *_, point in known]

    def _crossings(self, stretch: SampledStretch) -> list[Crossing]:
        return list(stretch.crossings(("", "", HOPF))) if self.free else []

    def given_up(self, stretch: SampledStretch) -> list[Point]:
        """Special points of a stretch that cannot be halved, at its start."""
        crossings, first, last = self._crossings(stretch), stretch.first.point, stretch.last.point
        reals = sum(one.kind != HOPF for one in crossings)
        several = reals > 1 and not (stretch.turns or stretch.reorients)  # at once, as where a symmetry keeps them
        sizes = [float(np.max(np.abs(one.values))) for one in (stretch.first, stretch.last)]
        beside = max(float(np.max(np.abs(self.sampled(one).values))) for one in (self.first, self.last))
        if stretch.reorients and min(sizes) > POLE_RATIO * beside:
            self.gaps.append(gap_between(self.equations, first, last, POLE_WORDS, SPECIAL_POINTS))
            return []
        kinds = [FOLD] * stretch.turns + [BRANCH_POINT] * (stretch.reorients or several)
        kinds += [HOPF] * (len(crossings) - reals)
        if not kinds:
            return []  # an eigenvalue that was matched to another one
        words = " and ".join(dict.fromkeys(kinds)) + (f", {len(kinds)} in all" if len(kinds) > 1 else "")
        words = f"more than can be distinguished: {words}"
        self.gaps.append(gap_between(self.equations, first, last, words, kinds[0]))
        error = replace(first.error, parameter=abs(float(last.z[-1] - first.z[-1])))
        return [first.marked(kind, error=error) for kind in kinds]

    def located(self, stretch: SampledStretch, kind: str, crossing: Crossing) -> tuple[float, float, Point] | None:
        """The special point of a kind at a crossing, with its place on the stretch and its frequency, or None."""
        equations, solver = self.equations, self.solver
        guess = stretch.curve.at(stretch.root({FOLD: 0, BRANCH_POINT: None}.get(kind, crossing.quantity + 1)))
        near = 1j * crossing.angle if kind == HOPF else None
        found = locate_rest(equations, kind, guess, near)
        if found is None:
            return None
        z, first = found.resting, stretch.first
        along = float(first.row @ (z - first.point.z))
        inside = -OUTSIDE_STRETCH * stretch.length <= along <= (1.0 + OUTSIDE_STRETCH) * stretch.length
        if solver.distance(equations.problem, guess, z) > FARTHEST_FROM_EXPECTED * stretch.length or not inside:
            return None
        slope = stretch.curve.slope(float(np.clip(along, 0.0, stretch.length)))
        tangent = slope / np.sqrt(np.sum(solver.metric(equations.problem, z) * slope**2))
        error = replace(found.point.error, parameter=found.error)
        step = solver.settings.first_step
        omega = found.frequency if kind == HOPF else 0.0
        point = Point(equations.problem, z, np.asarray(tangent), error, step, 0, walked=False, special=kind)
        return along, omega, replace(point, angle=omega or None)
