"""Every change of stability of a family: its orbits and their flow anywhere along it, given to the search for tongues.

The coordinate is an arclength cut into sections: within one of them it is the component of z along a fixed direction,
which grows along the branch also where the parameter folds. All orbits of a section are solved on one level of
resolution, to round-off, so that everything is smooth in the coordinate, whatever the tolerance of the points was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.family import Family
from casadi_skin.follow.point import PointSolver, hermite, newton_steps
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.watch import check_time_limit, one_thread
from casadi_skin.stability.flows import OrbitState, Transition
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.find_changes import Entry, find_changes
from casadi_skin.stability.tongues.interpolation import OrbitNotFoundError, Samples
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.model_coordinates import linear_spectrum
from casadi_skin.zero.problem import Array, Problem
from casadi_skin.zero.settings import End, Point

# Orbits and transition matrices at any coordinate along a branch whose points are known -------------------------------

ORBIT_TOLERANCE = 1e-12  # of the orbits along the family, whatever the tolerance of its points
LEAST_SECTION_COSINE = 0.6  # cosine of the angle between the branch and the direction of its section, at least
NEARBY_DISTANCE = 0.3  # of the distance of neighbouring points: how far an orbit may be from where they predict it
# Steps to the end of the branch, and how far it may be, of the distance of the last points.
END_STEPS, NEAR_END = 2, 0.01
PREDICTING_POINTS = 4  # points that an orbit is predicted from
# Responses to rounding within a piece, one over another, beyond which the larger is looked at as well.
UNEVEN_RESPONSES = 2.0
ORBIT_SAFETY = 2.0
LEVEL_GAIN = 0.5  # of an error on one level of resolution: the remaining part on the next, unless it is rounding
ROUGH_ERROR = 1e-8  # error that is more than rounding, however slowly it falls from level to level


@dataclass(frozen=True)
class _Section:
    """Points of one section in the unknowns of one problem, (points, size) each, with slopes dz/d coordinate.

    `row` is the direction; `places` are row . z, ascending, and `offset` turns them into coordinates.
    """

    problem: Problem
    row: Array
    places: Array
    z: Array
    slopes: Array
    offset: float

    @property
    def ends(self) -> tuple[float, float]:
        """Coordinates of its ends."""
        return self.offset, self.offset + float(self.places[-1] - self.places[0])

    def at(self, coordinates: Array) -> Array:
        """row . z at coordinates."""
        return np.asarray(self.places[0] + (coordinates - self.offset))

    def predicted(self, places: Array) -> tuple[Array, Array]:
        """Orbits by Hermite interpolation through the nearest points, and the distances of the two next to each."""
        right = np.clip(np.searchsorted(self.places, places), 1, self.places.size - 1)
        firsts = np.clip(right - PREDICTING_POINTS // 2, 0, max(self.places.size - PREDICTING_POINTS, 0))
        found = np.empty((places.size, self.z.shape[1]))
        for first in np.unique(firsts).tolist():
            chosen, here = slice(first, first + PREDICTING_POINTS), firsts == first
            values, slopes = np.array(hermite(self.places[chosen].tolist(), places[here])).swapaxes(0, 1)
            found[here] = values.T @ self.z[chosen] + slopes.T @ self.slopes[chosen]
        found += np.multiply.outer((places - found @ self.row) / (self.row @ self.row), self.row)
        return found, self.places[right] - self.places[right - 1]


class OrbitSampler:
    """A family as `find_changes` takes it (`BranchSampler`), from its points.

    Arguments:
        family: of which these are points.
        points: in order, the first may be a linear mode of zero amplitude.
        flow_tolerance: of the transition matrices, in norm.
        converged: whether the points and their tangents are accurate enough to predict orbits from.

    `coordinates` are those of the points; `unknown` are the stretches between two of which one is not solved again.
    """

    def __init__(self, family: Family, points: Sequence[Point], flow_tolerance: float, converged: bool) -> None:
        self.family = family.whole
        self.point_solver, self._converged = self.family.point_solver, converged
        self.flow = Family(replace(self.family.request, tolerance=flow_tolerance)).flow
        self.fraction, self.symplectic = self.family.symmetry.value, self.family.coordinates.symplectic
        self._amplitude = self.family.request.S_of
        self.unknown = list[Unresolved]()
        points = [family.on_all_positions(point) for point in points]
        self._sections = self._divided(points)
        if self._sections:
            self._sections[-1] = self._up_to(self._sections[-1], points[-1].parameter)
        places = [section.offset + section.places[1:] - section.places[0] for section in self._sections]
        skipped = [stretch.coordinate_end for stretch in self.unknown]
        self.coordinates = np.sort(np.concatenate([[0.0], *places, skipped]))
        self._lost: list[float] = []

    @property
    def levels(self) -> Levels:
        """Levels of resolution."""
        return self.point_solver.levels

    @property
    def sections(self) -> Sequence[tuple[float, float]]:
        """Ends of the sections."""
        return [section.ends for section in self._sections]

    def lost_between(self, stretches: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
        """Whether an orbit between a point and the next was not found within stretches, shape (points - 1,)."""
        lost = np.array([c for c in self._lost if any(start <= c <= end for start, end in stretches)])
        found = np.zeros(self.coordinates.size - 1, dtype=bool)
        found[np.clip(np.searchsorted(self.coordinates, lost) - 1, 0, found.size - 1)] = True
        return found

    # Sections -------------------------------------------------------------------------------------------------------

    def _divided(self, points: Sequence[Point]) -> list[_Section]:
        """The branch in as few sections as its turns allow."""
        finest = max((point.problem for point in points), key=lambda problem: problem.resolution)
        z = np.array([point.problem.prolong(point.z, finest) for point in points])
        sections: list[_Section] = []
        first, offset = 0, 0.0
        while first < len(points) - 1:
            last = first + 1
            while last + 1 < len(points) and self._is_straight(finest, z[first : last + 2]):
                last += 1
            section = self._longest_section(points[first : last + 1], offset)
            if section is None:
                first, offset = first + 1, self.unknown[-1].coordinate_end
            else:
                sections.append(section)
                first, offset = first + section.places.size - 1, section.ends[1]
        return sections

    def _longest_section(self, points: Sequence[Point], offset: float) -> _Section | None:
        """A section of as many of these points as can be solved together; None, and `unknown`, where not even two."""
        try:
            return self._section(points, offset)
        except OrbitNotFoundError as error:
            if len(points) > 2:
                return self._longest_section(points[: (len(points) + 1) // 2], offset)
            start, end = points
            S = (self._amplitude(start.parameter), self._amplitude(end.parameter))
            away = start.problem.prolong(start.z, end.problem) - end.z
            length = np.sqrt(np.sum(self.point_solver.metric(end.problem, end.z) * away**2))
            self.unknown.append(Unresolved(*S, str(error), coordinates=(offset, offset + float(length))))
            return None

    def _is_straight(self, problem: Problem, z: Array) -> bool:
        """Whether all chords from point to point go along the one from the first to the last."""
        weights = self.point_solver.metric(problem, z[len(z) // 2])
        chords, whole = np.diff(z, axis=0), z[-1] - z[0]
        along = chords @ (weights * whole) / np.sqrt(np.sum(weights * whole**2) * np.sum(weights * chords**2, axis=1))
        return bool(np.min(along) >= LEAST_SECTION_COSINE)

    def _section(self, points: Sequence[Point], offset: float) -> _Section:
        """Points of a section as solutions of one problem that is fine enough for all of them."""
        hardest = max(range(len(points)), key=lambda i: (points[i].problem.resolution, i))
        problem = self._fine_enough(points, points[hardest])
        row = self._direction(problem, points)
        found = [self._with_slope(problem, point, row) for point in points]
        z, slopes = (np.array(each) for each in zip(*found, strict=True))
        places = z @ row
        if not np.all(np.diff(places) > 0.0):
            where = problem.describe_parameters(z[0])
            raise OrbitNotFoundError(f"points are not in order near {where}: another branch crosses")
        return _Section(problem, row, places, z, slopes, offset)

    def _up_to(self, section: _Section, parameter: float) -> _Section:
        """The last section, which ends where the parameter has the value of the last point, not where its row has."""
        problem, z, k = section.problem, section.z[-1], section.problem.parameter_index
        try:
            for _ in range(END_STEPS):
                found = orbit_near(self.point_solver, problem, z, section.row)
                off = (parameter - found.z[k]) / (found.along[k] or np.inf)
                if not abs(off) <= NEAR_END * (section.places[-1] - section.places[-2]):
                    return section
                z = found.z + off * found.along
        except OrbitNotFoundError:
            return section
        known, slopes = (
            np.concatenate([each[:-1], last[None]]) for each, last in ((section.z, z), (section.slopes, found.along))
        )
        return replace(section, places=np.append(section.places[:-1], z @ section.row), z=known, slopes=slopes)

    def _with_slope(self, problem: Problem, point: Point, row: Array) -> tuple[Array, Array]:
        """A point in the unknowns of a problem, and its derivative by row . z."""
        z, tangent = point.problem.prolong(point.z, problem), point.problem.prolong(point.tangent, problem)
        along = float(row @ tangent)
        if self._converged and along >= LEAST_SECTION_COSINE * np.sqrt(
            np.sum(self.point_solver.metric(problem, z) * tangent**2)
        ):
            return z, tangent / along
        found = orbit_near(self.point_solver, problem, z, row)
        return found.z, found.along

    def _fine_enough(self, points: Sequence[Point], hardest: Point) -> Problem:
        """The problem on the coarsest level that solves the hardest point, or beyond which only rounding is left."""
        problem: Problem = hardest.problem
        before, coarser = np.inf, problem
        while True:
            row = self._direction(problem, points)
            guess = hardest.problem.prolong(hardest.z, problem)
            found = orbit_near(self.point_solver, problem, guess, row)
            tangent = found.along / self._length(problem, found.z, found.along)
            estimate = self.levels.refined(problem, found.z, tangent)[0]
            error = estimate.relative(problem.frequency(found.z))
            finer = self.levels.finer(problem)
            if error <= max(ORBIT_TOLERANCE, estimate.round_off) or finer is None or self.levels.finer(finer) is None:
                return problem
            if LEVEL_GAIN * before < error <= ROUGH_ERROR:
                return coarser
            problem, coarser, before = finer, problem, error

    def _direction(self, problem: Problem, points: Sequence[Point]) -> Array:
        """The row of a section: from its first point to its last, of unit length in the metric."""
        start, end = (point.problem.prolong(point.z, problem) for point in (points[0], points[-1]))
        middle = points[len(points) // 2]
        weights = self.point_solver.metric(problem, middle.problem.prolong(middle.z, problem))
        chord = end - start
        return np.asarray(weights * chord / np.sqrt(np.sum(weights * chord**2)))

    # Orbits ---------------------------------------------------------------------------------------------------------

    def sample(self, coordinates: Array) -> Samples:
        """Samples at coordinates of one section (see `BranchSampler`); raises TimeLimitError."""
        check_time_limit("orbits between the points of a family")
        middle = float(np.mean(coordinates))
        section = min(self._sections, key=lambda section: _away(section, middle))
        problem = section.problem
        guesses, distances = section.predicted(section.at(coordinates))
        near = orbits_near(self.point_solver, problem, guesses, section.row, NEARBY_DISTANCE * distances)
        found = [orbit for orbit in near if orbit is not None]
        if len(found) < len(near):
            lost = near.index(None)
            self._lost.append(float(coordinates[lost]))
            raise OrbitNotFoundError(f"no orbit is found near {problem.describe_parameters(guesses[lost])}")
        states = [OrbitState(problem, orbit.z) for orbit in found]
        responses = np.array([self._length(problem, orbit.z, orbit.response) for orbit in found])
        k, worst = len(states) // 2, int(np.argmax(responses))
        if responses[worst] <= UNEVEN_RESPONSES * responses[k]:
            worst = k
        for i in {k, worst}:
            states[i] = self._with_better(problem, found[i])
        transitions = self.flow.transitions(states, alike=True)
        errors = np.stack([flow_error(transition) for transition in transitions]) + _orbit_error(transitions[k])
        if worst != k:
            errors += (responses / responses[worst])[:, None, None] * _orbit_error(transitions[worst])
        return Samples(
            transitions=np.stack([transition.matrix for transition in transitions]),
            errors=errors,
            directions=self.family.accelerations(states),
            S=np.array([self._amplitude(state.parameter) for state in states]),
            Omega=np.array([state.Omega for state in states]),
        )

    def _length(self, problem: Problem, z: Array, change: Array) -> float:
        """Length of a change of an orbit, in the metric."""
        return float(np.sqrt(np.sum(self.point_solver.metric(problem, z) * change**2)))

    def amplitude(self, coordinate: float) -> float:
        """S near a coordinate, between the points of the branch."""
        section = min(self._sections, key=lambda section: _away(section, coordinate))
        (z,), _ = section.predicted(section.at(np.array([coordinate])))
        return self._amplitude(float(z[section.problem.parameter_index]))

    def _with_better(self, problem: Problem, orbit: SectionOrbit) -> OrbitState:
        """An orbit with a better one, whose difference shows the error that orbits of the section make."""
        tangent = orbit.along / self._length(problem, orbit.z, orbit.along)
        better = self.levels.refined(problem, orbit.z, tangent)[1]
        return OrbitState(problem, orbit.z, None if better is None else OrbitState(better.problem, better.z))


def _away(section: _Section, coordinate: float) -> float:
    """How far outside a section a coordinate is, negative inside."""
    return max(section.ends[0] - coordinate, coordinate - section.ends[1])


def flow_error(transition: Transition) -> Array:
    """A matrix like the error of a transition matrix."""
    if transition.truncation is not None:
        return transition.truncation
    size = transition.matrix.shape[0]
    signs = np.sign(np.cos(np.arange(size * size) ** 2 % 6.25)).reshape(size, size)
    return np.asarray(transition.error / size * signs)


def _orbit_error(transition: Transition) -> Array:
    """A matrix like the error of a transition matrix that the orbit makes."""
    if transition.pair is None:
        return np.zeros_like(transition.matrix)
    return np.asarray(ORBIT_SAFETY * (transition.pair[1] - transition.pair[0]))


# Orbits of one section by Newton's method, with row . z held ----------------------------------------------------------

NEWTON_STEPS = 6  # of Newton's method
SOLVED_STEP = 1e-8  # a step of Newton's method whose square is round-off


@dataclass(frozen=True)
class SectionOrbit:
    """An orbit z, its derivative `along` by row . z, and its `response` to residuals of size 1 in general position."""

    z: Array
    along: Array
    response: Array


def orbits_near(
    point_solver: PointSolver, problem: Problem, guesses: Array, row: Array, allowed: Array | float = np.inf
) -> list[SectionOrbit | None]:
    """The orbits near guesses (guesses, unknowns), each with row . z in common with its guess.

    None where there is none within `allowed`, in the metric.
    """
    found: list[SectionOrbit | None] = [None] * len(guesses)
    z, values, active = guesses.copy(), guesses @ row, np.arange(len(guesses))
    weights, allowed = point_solver.metrics(problem, guesses), np.broadcast_to(allowed, len(guesses))
    for _ in range(NEWTON_STEPS):
        here = z[active]
        try:
            steps = newton_steps(problem, here, here @ row - values[active], np.tile(row, (active.size, 1)))
        except (ArithmeticError, RuntimeError):  # of one of them, which fails by itself too
            if len(guesses) > 1:
                alone = (
                    orbits_near(point_solver, problem, g[None], row, a) for g, a in zip(guesses, allowed, strict=True)
                )
                return [one for (one,) in alone]
            return found
        z[active] = here - steps.newton
        sizes = np.sqrt(np.sum(weights[active] * steps.newton**2, axis=1))
        moved = np.sqrt(np.sum(weights[active] * (z[active] - guesses[active]) ** 2, axis=1))
        for n in np.flatnonzero((sizes <= SOLVED_STEP) & (moved <= allowed[active])).tolist():
            i = int(active[n])
            found[i] = SectionOrbit(z[i], steps.along[n], steps.response[n])
        active = active[(sizes > SOLVED_STEP) & (sizes <= 1.0)]
        if not active.size:
            break
    return found


def orbit_near(point_solver: PointSolver, problem: Problem, guess: Array, row: Array) -> SectionOrbit:
    """As `orbits_near` from one guess; raises OrbitNotFoundError."""
    (found,) = orbits_near(point_solver, problem, guess[None], row)
    if found is None:
        raise OrbitNotFoundError(f"no orbit is found near {problem.describe_parameters(guess)}")
    return found


# Every change of stability of a family: the family's orbits and flow, given to the search for tongues -----------------

AT_REST = 1e-12  # of the largest omega^2: rounding in that of a mode without restoring force
ACCURATE_POINT_TOLERANCE = 1e-7  # tolerance of points that orbits between them are predicted from as they are
LOOKING_ROUNDS = 3  # of looking, each with orbits added where some were not found
FLOW_TOLERANCE = 1e-9  # of the norm of transition matrices; errors of multipliers are 10 to 1000 times smaller


def family_tongues(
    family: Family,
    points: Sequence[Point],
    flow_tolerance: float = FLOW_TOLERANCE,
    stability: Sequence[Floquet | None] = (),
) -> StabilityDiagram:
    """Every change of stability along a family, however narrow its window.

    The result depends on the course of the family, not on its points or their tolerance: orbits and transition matrices
    are computed anew, to tolerances of their own.

    Arguments:
        family: the family.
        points: of it in order; the first may be its linear mode of zero amplitude.
        flow_tolerance: of the transition matrices, in norm; a smaller one decides narrower tongues.
        stability: of the points, where it is known: tongues have to account for it, or the stretch is unresolved.

    Returns:
        Changes of stability, tongues, and undecided and unresolved places.
    """
    whole = family.whole
    squares = linear_spectrum(whole.request.model, whole.coordinates.parameters).squares
    frequencies = np.sqrt(np.maximum(squares, 0.0))
    others = {k + 1: float(w) for k, w in enumerate(frequencies) if k + 1 != whole.coordinates.mode_number}
    known = {id(point): each for point, each in zip(points, stability, strict=False)}
    oscillate = bool(squares[0] >= -AT_REST * squares[-1])
    with one_thread():
        for _ in range(LOOKING_ROUNDS):
            sampler = OrbitSampler(family, points, flow_tolerance, family.request.tolerance <= ACCURATE_POINT_TOLERANCE)
            entries = [
                Entry(float(coordinate), found.mu, found.mu_error)
                for coordinate, point in zip(sampler.coordinates, points, strict=False)
                if (found := known.get(id(point))) is not None
            ]
            diagram = find_changes(sampler, others if oscillate else None, entries=entries)
            lost = sampler.lost_between([(u.coordinate_start, u.coordinate_end) for u in diagram.unresolved])
            more = with_what_lies_between(family.point_solver, points, lost) if lost.any() else points
            if len(more) == len(points):
                break
            points = more
    stretches = sorted([*diagram.unresolved, *sampler.unknown], key=lambda stretch: stretch.coordinate_start)
    return replace(diagram, unresolved=tuple(stretches))


def tongues_on(family: Family, points: Sequence[Point]) -> StabilityDiagram:
    """Every change of stability on a short stretch of a family, without names of modes.

    Arguments:
        family: the family, of any amplitude.
        points: of the stretch in order, or guesses of them.

    Raises OrbitNotFoundError where these are no orbits.
    """
    with one_thread():
        sampler = OrbitSampler(family, points, FLOW_TOLERANCE, False)
        if sampler.unknown:
            raise OrbitNotFoundError(sampler.unknown[0].reason)
        return find_changes(sampler, short=True)


# Neighbouring points of a branch that are too far apart to predict the stretch between them: smaller steps there ------

FIRST_STEP_FRACTION = 1 / 16  # of the way from one point to the next: the first step
AIMED_TURN_DEGREES = 3.0  # degrees that the branch turns by in a step
MOST_WALKED_POINTS = 3000  # points of a walk


def with_what_lies_between(point_solver: PointSolver, points: Sequence[Point], lost: NDArray[np.bool_]) -> list[Point]:
    """Points with those between each and the next where an orbit is lost.

    A walk that does not come to the next point, but to the end of the branch, takes the place of all that follow.

    Arguments:
        point_solver: of the branch.
        points: of it in order.
        lost: whether an orbit between a point and the next is not found, shape (points - 1,).
    """
    found = [points[0]]
    for (before, after), is_lost in zip(pairwise(points), lost.tolist(), strict=True):
        if is_lost and before.parameter != 0.0:
            walked, at_the_end = _walked(point_solver, before, after)
            found += walked
            if at_the_end:
                return found
        found.append(after)
    return found


def _walked(point_solver: PointSolver, before: Point, after: Point) -> tuple[list[Point], bool]:
    """The points of a walk from one point to another, and whether it came to the branch's end instead; else none."""
    step = FIRST_STEP_FRACTION * float(np.linalg.norm(_way(point_solver, before, after)))
    settings = replace(point_solver.settings, at=(), first_step=step, aim_angle=AIMED_TURN_DEGREES, tiny_first=False)
    walk = ArclengthContinuation(PointSolver(point_solver.levels, settings), (replace(before, step=step),))
    found = [before]
    for point in islice(walk, MOST_WALKED_POINTS):
        if _passes(point_solver, found[-1], point, after):
            return found[1:], False
        found.append(point)
    return (found[1:], True) if walk.end is End.REACHED else ([], False)


def _way(point_solver: PointSolver, start: Point, end: Point) -> Array:
    """From one point to another, in coordinates in which the metric is that of Euclid."""
    finer = max(start.problem, end.problem, key=lambda problem: problem.resolution)
    z, z_end = start.problem.prolong(start.z, finer), end.problem.prolong(end.z, finer)
    return np.asarray(np.sqrt(point_solver.metric(finer, z)) * (z_end - z))


def _passes(point_solver: PointSolver, start: Point, end: Point, point: Point) -> bool:
    """Whether a step goes by a point."""
    step = float(np.linalg.norm(_way(point_solver, start, end)))
    before, beyond = (float(np.linalg.norm(_way(point_solver, p, point))) for p in (start, end))
    return bool(before + beyond <= step / np.cos(np.radians(AIMED_TURN_DEGREES)))
