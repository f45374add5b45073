"""Orbits that leave a family of reversible orbits where a real tongue of instability opens or closes.

The variational flow over the part of the period that is solved for, a half or a quarter, is Phi = [[A, B], [C, D]] in
positions and velocities; a perturbation (x, 0) or (0, v) that comes back to one of these is its own mirror image in
time (Lamb and Roberts 1998). The singular block decides which symmetry is kept:

    mu   block      of an odd family (a quarter)             of one that is reversible alone (a half)
    0    C x = 0    the reversal; no half-period symmetry     all: another branch of the same class
    0    B v = 0    neither, but both together                the period; no reversal
    -1   A x = 0    all: another branch of the same class     the reversal, with twice the period
    -1   D v = 0    the half-period symmetry; no reversal     the same, about the other phase at rest

Where A and D, or B and C, are singular together, as the orbit runs several times through a shorter period, the family
with that period crosses, and it has all symmetries.

At mu = -1 of an odd family, 0 of another, where no block is singular beside the trivial vector, the energy has an
extremum, and no branch leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch_points import other_tangent
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.restating import restated, with_amplitude
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.zero import mesh
from casadi_skin.zero.orbit import OrbitRequest, Periodic, Sizes, statement_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem

SINGULAR = 1e-6  # smallest singular value of a block that is singular, relative to its largest
SHIFT, ROUNDS = 1e-11, 4  # of inverse iteration, relative
MOVED, INSTANT = 1e-3, 1e-5  # along the family, and of the period, for differences
ASKEW = 1e-6  # component of a tangent in the parameter: the branch leaves to both sides
REPEATED, MOST, PLACES = 1e-5, 7, 16  # of the states' range; parts of the period; times at which they are compared
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


KINDS = {
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
    assert isinstance(family, Family)
    transition, acceleration = family.transition(orbit.point)
    blocks = dict(zip("ABCD", transition.blocks(), strict=True))
    scale = np.exp(family.whole.coordinates.log_scale)
    trivial = "D" if family.symmetry is SymmetryClass.QUARTER else "B"
    best: tuple[float, str, Array] = (SINGULAR, "", np.empty(0))
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
    symmetry, turns, lost = KINDS[family.symmetry, name]
    vector = scale * (vector if family.whole.frame is None else family.whole.frame @ vector)
    zero = np.zeros(vector.size)
    full = np.concatenate([vector, zero] if name in "AC" else [zero, vector])
    return Breaking(name, full / np.linalg.norm(full), symmetry, turns, lost)


def turns_of(orbit: Orbit) -> int:
    """How often an orbit runs through its shortest period."""
    times = orbit.period * np.arange(PLACES) / PLACES
    states = orbit.evaluate(times)
    within = REPEATED * float(np.max(np.ptp(states, axis=0)))
    away = {m: np.max(np.abs(orbit.evaluate(times + orbit.period / m) - states)) for m in range(2, MOST + 1)}
    return max((m for m, distance in away.items() if distance <= within), default=1)


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
    assert isinstance(family, Family)
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
    assert isinstance(old, BoundarySpace)
    sizes, method = Sizes.of(statement, start.states), replace(old.method, corrector="newton")
    space = BoundarySpace(
        statement, old.tolerance, method, sizes, Periodic(extended, first, symmetry), parameter, to, at, None,
        settings, leaves=True,
    )  # fmt: skip
    problem = _problem(space, start, symmetry.value * breaking.turns)
    t = length * symmetry.value * problem._fractions()
    free = [length if key == PERIOD else statement.values[key] for key in statement.free]
    z = np.concatenate([start.evaluate(t).ravel(), free, [0.0]])
    error = ErrorEstimate(start.point.error.Omega, start.point.error.profile)
    along = _family_tangent(space, problem, z) if breaking.lost else _course(orbit, space, problem, t)
    own = Point(problem, z, along, error, settings.first_step, 0)
    tangent = other_tangent(space.point_solver, own)
    crosses = not breaking.lost and abs(float(tangent[problem.parameter_index])) > ASKEW
    towards = tangent[problem.parameter_index] if crosses else side * (tangent[: first.full_size] @ breaking.vector)
    tangent = np.sign(towards) * tangent
    if abs(float(tangent[problem.parameter_index])) <= ASKEW:  # rounding, which would turn back next to the start
        tangent[problem.parameter_index] = 0.0
    return replace(space, first=replace(own, tangent=tangent))


def _problem(space: BoundarySpace, start: Orbit, part: float) -> BoundaryProblem:
    """The discretisation of a part of the period with the mesh of the orbit, mirrored and repeated."""
    own = start.problem.constants / np.sum(start.problem.constants)
    there = [own, own[::-1]]
    lengths = np.concatenate([there[k % 2] for k in range(round(part / start.symmetry.value))])
    fitting = [r for r in space.levels.resolutions if r >= lengths.size]
    resolution = fitting[0] if fitting else space.levels.resolutions[-1]
    found = space.levels.problem(resolution).with_constants(mesh.resampled(lengths / np.sum(lengths), resolution))
    assert isinstance(found, BoundaryProblem)
    return found


def _course(orbit: Orbit, space: BoundarySpace, problem: BoundaryProblem, t: Array) -> Array:
    """The tangent of the family where a branch of its own class crosses: by differences along the family."""
    ends = []
    for side in (-1.0, 1.0):
        moved = Orbit(orbit.space, replace(orbit.point, z=orbit.point.z + side * MOVED * orbit.point.tangent))
        known = {**space.statement.values, PERIOD: moved.period}
        way = (moved.S - space.statement.values[space.parameter]) / (space.to - space.statement.values[space.parameter])
        places, h = t * moved.period / orbit.period, INSTANT * moved.period
        rates = (moved.evaluate(places + h) - moved.evaluate(places - h)) / (2.0 * h)
        states = np.hstack([moved.evaluate(places), rates])
        ends.append(np.concatenate([states.ravel(), [known[key] for key in space.statement.free], [way]]))
    along = ends[1] - ends[0]
    return np.asarray(along / np.sqrt(np.sum(space.point_solver.metric(problem, ends[0]) * along**2)))


def _family_tangent(space: BoundarySpace, problem: BoundaryProblem, z: Array) -> Array:
    """The tangent of the family among the two directions that the equations leave open; of norm 1 in the metric.

    By inverse iteration, once with the parameter held, once across the result of that.
    """
    from scipy.sparse import csc_matrix, diags, vstack
    from scipy.sparse.linalg import splu

    rows, columns = problem.pattern
    sizes = 1.0 / np.sqrt(space.point_solver.metric(problem, z))
    values = problem.evaluate(z)[1] * sizes[columns]
    generator, size = np.random.default_rng(0), problem.size
    J = csc_matrix((values, (rows, columns)), shape=(size - 1, size))
    shift = diags(SHIFT * float(np.max(np.abs(values))) * generator.random(size))
    row: Array = np.eye(1, size, size - 1)[0]
    for _ in range(2):
        factors = splu((vstack([J, csc_matrix(row[None, :])]) + shift).tocsc())
        row = generator.normal(size=size)
        for _ in range(ROUNDS):
            row = np.asarray(factors.solve(row))
            row /= np.linalg.norm(row)
    return np.asarray(sizes * row)


def start_of(orbit: Orbit) -> Orbit:
    """An orbit of a family as the one that a branch leaves, in the coordinates of the model, with S a parameter."""
    return restated(orbit, "S")
