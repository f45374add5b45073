"""Symmetries that an orbit has and the branch that leaves at its branch point has not.

A symmetry S of the equations that changes signs of states may hold of an orbit at each instant, S x(t) = x(t), or
after half of the period, S x(t) = x(t + T/2). It is lost on a branch that leaves along a Floquet vector which S, or S
and half a period, turn to its opposite (Golubitsky, Stewart and Schaeffer 1988).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch_points import other_tangent
from casadi_skin.follow.find import restated, with_amplitude
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.points.ends import fitted
from casadi_skin.zero.kinds import BRANCH_POINT
from casadi_skin.zero.orbit import OrbitRequest, Periodic, Sizes, statement_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem

# Orbits that leave a family of reversible orbits where a real tongue of instability opens or closes -------------------

SINGULAR_BLOCK_RATIO = 1e-6  # smallest singular value of a block that is singular, relative to its largest
FAMILY_DIFFERENCE_STEP, TIME_DIFFERENCE_STEP = 1e-3, 1e-5  # along the family, and of the period, for differences
ASKEW_TANGENT = 1e-6  # component of a tangent in the parameter: the branch leaves to both sides
REPEATED_STATE_DISTANCE, MOST_PERIOD_PARTS, COMPARED_TIMES = (
    1e-5,
    7,
    16,
)  # of the states' range; parts of the period; times at which they are compared
HALF_PERIOD, REVERSAL = "half-period symmetry", "reversal"


@dataclass(frozen=True, eq=False)
class Breaking:
    """Orbits that leave an orbit of a family.

    Attributes:
        block: "A", "B", "C" or "D", as above.
        vector: the perturbation at phase zero in the coordinates of the model, positions then velocities.
        symmetry: which part of the period of the orbits that leave is unknown.
        turns: how often they run through the period.
        lost: the symmetries that they lack, in words.
    """

    block: str
    vector: Array
    symmetry: SymmetryClass
    turns: int
    lost: tuple[str, ...]


BREAKING_KINDS = {
    (SymmetryClass.QUARTER, "C"): (SymmetryClass.HALF, 1, (HALF_PERIOD,)),
    (SymmetryClass.QUARTER, "B"): (SymmetryClass.FULL, 1, (HALF_PERIOD, REVERSAL)),
    (SymmetryClass.QUARTER, "A"): (SymmetryClass.QUARTER, 1, ()),
    (SymmetryClass.QUARTER, "D"): (SymmetryClass.FULL, 1, (REVERSAL,)),
    (SymmetryClass.HALF, "C"): (SymmetryClass.HALF, 1, ()),
    (SymmetryClass.HALF, "B"): (SymmetryClass.FULL, 1, (REVERSAL,)),
    (SymmetryClass.HALF, "A"): (SymmetryClass.HALF, 2, ()),
    (SymmetryClass.HALF, "D"): (SymmetryClass.FULL, 2, (REVERSAL,)),
}


def breaking_of(orbit: Orbit, mu: float) -> Breaking | None:
    """The orbits that leave at the edge of a real tongue with mu 0 or -1; None where there are none."""
    family = orbit.space
    transition, acceleration = family.transition(orbit.point)
    blocks = dict(zip("ABCD", transition.blocks(), strict=True))
    scale = np.exp(family.whole.coordinates.log_scale)
    trivial = "D" if family.symmetry is SymmetryClass.QUARTER else "B"
    best: tuple[float, str, Array] = (SINGULAR_BLOCK_RATIO, "", np.empty(0))
    names = "CB" if mu > -0.5 else "AD"
    for name in names[:1] if turns_of(orbit) > 1 else names:
        _, values, rows = np.linalg.svd(blocks[name])
        place = -2 if name == trivial else -1
        if values.size >= -place and values[place] / values[0] < best[0]:
            vector = rows[place]
            if name == trivial:
                along = acceleration / np.linalg.norm(acceleration)
                vector = np.linalg.svd(rows[-2:] - np.outer(rows[-2:] @ along, along))[2][0]
            best = (float(values[place] / values[0]), name, np.asarray(vector))
    _, name, vector = best
    if not name:
        return None
    symmetry, turns, lost = BREAKING_KINDS[family.symmetry, name]
    vector = scale * (vector if family.whole.frame is None else family.whole.frame @ vector)
    zero = np.zeros(vector.size)
    full = np.concatenate([vector, zero] if name in "AC" else [zero, vector])
    return Breaking(name, full / np.linalg.norm(full), symmetry, turns, lost)


def turns_of(orbit: Orbit) -> int:
    """How often an orbit runs through its shortest period."""
    times = orbit.period * np.arange(COMPARED_TIMES) / COMPARED_TIMES
    states = orbit.evaluate(times)
    within = REPEATED_STATE_DISTANCE * float(np.max(np.ptp(states, axis=0)))
    away = {
        m: np.max(np.abs(orbit.evaluate(times + orbit.period / m) - states)) for m in range(2, MOST_PERIOD_PARTS + 1)
    }
    return max((m for m, distance in away.items() if distance <= within), default=1)


def shortened(point: Point, turns: int) -> Point:
    """A guess of the orbit of a shorter period that an orbit of a family runs through several times."""
    problem, z = point.problem, point.z.copy()
    z[: problem.states] = problem.of_shorter_period(z, turns)
    z[problem.Omega_index] *= turns
    return replace(point, z=z, better=None)


def breaking_space(
    orbit: Orbit, mu: float, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings,
    side: int, start: Orbit,
) -> BoundarySpace:  # fmt: skip
    """The space of the orbits that leave an orbit of a family, left along its null vector.

    `start` is the same orbit as `restated` gives it: its parameters, S among them, are those that may be followed.
    """
    breaking = breaking_of(orbit, mu)
    if breaking is None:
        raise ValueError("follow: given an extremum of the energy; accepted: a point at which another branch leaves")
    family = orbit.space
    extended, _, select = with_amplitude(family.coordinates.model)
    first, symmetry = extended.first_order(), breaking.symmetry
    length = breaking.turns * start.period
    values = {key: start.parameters[key] for key in first.parameter_names}
    section = None
    if symmetry is SymmetryClass.FULL:  # where S is stationary: no phase is at rest
        section = ca.jtimes(select, extended.state, extended.velocity)
    request = OrbitRequest(first, length, 1, values, np.zeros(first.full_size), start, symmetry, select, section)
    statement = statement_of(request)
    old = start.space
    sizes, method = Sizes.of(statement, start.states), replace(old.method, corrector="newton")
    space = BoundarySpace(
        statement, old.tolerance, method, sizes, Periodic(extended, first, symmetry),
        parameter=parameter, to=to, at=at, settings=settings, leaves=True,
    )  # fmt: skip
    there = [start.problem.constants, start.problem.constants[::-1]]
    parts = round(symmetry.value * breaking.turns / start.symmetry.value)
    problem = fitted(space, np.concatenate([there[k % 2] for k in range(parts)]))
    t = length * symmetry.value * problem._fractions()
    free = [length if key == PERIOD else statement.values[key] for key in statement.free]
    z = np.concatenate([start.evaluate(t).ravel(), free, [0.0]])
    error = ErrorEstimate(start.point.error.Omega, start.point.error.profile)
    along = _course(orbit, space, problem, t)
    own = Point(problem, z, along, error, settings.first_step, 0)
    tangent = other_tangent(space.point_solver, own)
    crosses = not breaking.lost and abs(float(tangent[problem.parameter_index])) > ASKEW_TANGENT
    towards = tangent[problem.parameter_index] if crosses else side * (tangent[: first.full_size] @ breaking.vector)
    tangent = np.sign(towards) * tangent
    if (
        abs(float(tangent[problem.parameter_index])) <= ASKEW_TANGENT
    ):  # rounding, which would turn back next to the start
        tangent[problem.parameter_index] = 0.0
    return replace(space, first=replace(own, tangent=tangent))


def _course(orbit: Orbit, space: BoundarySpace, problem: BoundaryProblem, t: Array) -> Array:
    """The tangent of the family, by differences along it."""
    ends = []
    for side in (-1.0, 1.0):
        moved = Orbit(
            orbit.space, replace(orbit.point, z=orbit.point.z + side * FAMILY_DIFFERENCE_STEP * orbit.point.tangent)
        )
        known = {**space.statement.values, PERIOD: moved.period}
        way = (moved.S - space.statement.values[space.parameter]) / (space.to - space.statement.values[space.parameter])
        places, h = t * moved.period / orbit.period, TIME_DIFFERENCE_STEP * moved.period
        rates = (moved.evaluate(places + h) - moved.evaluate(places - h)) / (2.0 * h)
        states = np.hstack([moved.evaluate(places), rates])
        ends.append(np.concatenate([states.ravel(), [known[key] for key in space.statement.free], [way]]))
    along = ends[1] - ends[0]
    return np.asarray(along / np.sqrt(np.sum(space.point_solver.metric(problem, ends[0]) * along**2)))


def start_of(orbit: Orbit) -> Orbit:
    """An orbit of a family as the one that a branch leaves, in the coordinates of the model, with S a parameter."""
    return restated(orbit, "S")


MOST_STATES_TRIED = 10  # states of a model all of whose changes of sign are tried
FIELD_TRIALS, SAME_FIELD_RTOL = 3, 1e-9  # random points at which fields are compared, and their relative difference
HELD_SYMMETRY_RTOL = 1e-5  # of an orbit's extent: how far off a symmetry may be that it has
COMPARED_PLACES = 64  # along the orbit


def lost_at(point: SpecialPoint) -> tuple[str, ...]:
    """Symmetries that orbits of the branch that leaves at a special point lack, in words; empty without any."""
    if point.mu is not None:
        breaking = breaking_of(point.solution, point.mu)
        return () if breaking is None else breaking.lost
    if point.kind != BRANCH_POINT or getattr(point.solution.space, "periodic", None) is None:
        return ()
    return lost_symmetries(point.solution)


def lost_symmetries(orbit: Orbit) -> tuple[str, ...]:
    """Symmetries lost at a branch point, in words, as "half-period symmetry in x, y"; empty without a known one.

    Arguments:
        orbit: at the branch point, over its whole period.
    """
    found = []
    for signs, shift in lost_operations(orbit):
        changed = ", ".join(name for name, sign in zip(orbit.model.state_names, signs, strict=True) if sign < 0)
        found.append(f"{'half-period' if shift else 'mirror'} symmetry in {changed}")
    return tuple(dict.fromkeys(found))


def lost_operations(orbit: Orbit) -> Iterator[tuple[Array, float]]:
    """Signs of the components, and the share of the period, of each symmetry that is lost at a branch point."""
    model = orbit.model
    times = orbit.period * np.arange(COMPARED_PLACES) / COMPARED_PLACES
    states, later = orbit.evaluate(times), orbit.evaluate(times + 0.5 * orbit.period)
    within = HELD_SYMMETRY_RTOL * np.ptp(states)
    vector = critical_vector(orbit)
    after: Array | None = None
    for signs in sign_symmetries(model, orbit.model_parameters):
        at_once = not model.forced and bool(np.max(np.abs(signs * states - states)) < within)
        if at_once and np.linalg.norm(signs * vector + vector) < np.linalg.norm(signs * vector - vector):
            yield signs, 0.0
        if np.max(np.abs(signs * states - later)) < within:
            after = _half_a_period_on(orbit, vector) if after is None else after
            image = _across(orbit, signs * vector)
            if np.linalg.norm(after + image) < np.linalg.norm(after - image):
                yield signs, 0.5


def sign_symmetries(model: OdeModel, parameters: Array) -> list[Array]:
    """Changes of signs of states under which the equations stay the same; of a forced model half a period later."""
    n = model.full_size
    if n <= MOST_STATES_TRIED:
        choices = [np.array(signs) for signs in itertools.product((1.0, -1.0), repeat=n)][1:]
    else:
        declared = [] if model.half_period is None else [np.array(model.half_period, dtype=float)]
        choices = [-np.ones(n), *declared]
    generator, shift = np.random.default_rng(3), 0.5 * model.forcing_period_at(parameters)
    points = np.abs(generator.normal(size=(FIELD_TRIALS, n)))
    here = [np.array(model.vector_field(0.3, x, parameters)).ravel() for x in points]

    def holds(signs: Array) -> bool:
        there = [np.array(model.vector_field(0.3 + shift, signs * x, parameters)).ravel() for x in points]
        return all(
            bool(np.max(np.abs(b - signs * a)) <= SAME_FIELD_RTOL * (1.0 + np.max(np.abs(a))))
            for a, b in zip(here, there, strict=True)
        )

    return [signs for signs in choices if holds(signs)]


def _half_a_period_on(orbit: Orbit, vector: Array) -> Array:
    """A perturbation at phase zero half a period later, across the orbit."""
    from scipy.integrate import solve_ivp

    model, p = orbit.model, orbit.model_parameters
    jacobian = model.function("J", ca.densify(ca.jacobian(model.full_rhs, model.full_state)))

    def rate(t: float, w: Array) -> Array:
        return np.asarray(np.array(jacobian(t, orbit.evaluate(t), p)) @ w)

    found = solve_ivp(rate, (0.0, 0.5 * orbit.period), vector, "LSODA", rtol=1e-6, atol=1e-9)
    return _across(orbit, found.y[:, -1])


def _across(orbit: Orbit, vector: Array) -> Array:
    """A vector at half of the period without its part along the orbit."""
    model, t = orbit.model, 0.5 * orbit.period
    if model.forced:
        return vector
    along = np.array(model.vector_field(0.0, orbit.evaluate(t), orbit.model_parameters)).ravel()
    return np.asarray(vector - along * (along @ vector) / (along @ along))


def critical_vector(orbit: Orbit) -> Array:
    """The vector of norm 1 that the monodromy matrix leaves as it is, across the motion along the orbit."""
    monodromy = orbit.space.monodromy(orbit.point, orbit.floquet())
    vectors = np.linalg.svd(monodromy - np.eye(len(monodromy)))[2][::-1]
    if orbit.floquet().trivial == 0:
        return np.asarray(vectors[0])
    h = 1e-5 * orbit.period
    ahead, behind = orbit.evaluate([h, -h])
    along = (ahead - behind) / np.linalg.norm(ahead - behind)
    free = [vector - along * (along @ vector) for vector in vectors[:2]]
    longest = max(free, key=lambda vector: float(np.linalg.norm(vector)))
    return np.asarray(longest / np.linalg.norm(longest))
