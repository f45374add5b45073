"""The end of a curve of special orbits where the orbits shrink to an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from casadi_skin.follow.boundary_solutions import BoundarySolutions
from casadi_skin.follow.find import find_equilibrium
from casadi_skin.follow.followed import Followed
from casadi_skin.follow.following import Following, run_following
from casadi_skin.follow.location import locate_rest, special_orbit
from casadi_skin.follow.rest_curve import curve_space
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.follow.solution import Equilibrium
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero import mesh
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import sizes_of
from casadi_skin.zero.settings import ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem
from casadi_skin.zero.statics import Statics

KINDS = {FOLD: ("generalized hopf",), TORUS: ("hopf-hopf", "zero-hopf")}  # at which curves of orbits end
AROUND = 0.5  # of the way of the second parameter: how far Hopf points are followed
NEAR = 0.1  # of it: how far from the smallest orbit the end may be


def shrunk(space: Followed, before: Point, after: Point) -> Point | None:
    """The point of a curve of Hopf points at which the orbits have amplitude zero; None where none is found."""
    smaller = min((before, after), key=lambda point: float(np.max(np.ptp(_states(space, point), axis=0))))
    hopf = _hopf_near(space, smaller)
    if hopf is None or space.kind not in KINDS:
        return None
    start, span = hopf.parameters[space.parameter], space.to - space.statement.values[space.parameter]
    found = list[SpecialPoint]()
    for side in (1.0, -1.0):
        to = start + side * AROUND * span
        curve = run_following(
            Following(curve_space(hopf, space.parameter, to, at=(), max_points=500, max_step=0.05)), None
        )
        found += [point for point in curve.special_points if point.kind in KINDS[space.kind]]
    close = [p for p in found if abs(p.parameters[space.parameter] - start) <= NEAR * abs(span)]
    if not close:
        return None
    nearest = min(close, key=lambda point: abs(point.parameters[space.parameter] - start))
    return _as_orbit(space, smaller, nearest)


def _states(space: Followed, point: Point) -> Array:
    return space.states_at(point, np.linspace(0.0, 2.0 * np.pi, 257)[:-1], None)


def _hopf_near(space: Followed, orbit: Point) -> SpecialPoint | None:
    """The Hopf point near an orbit of small amplitude, in the first parameter, from its mean and its period."""
    model, values = space.model, space.parameters(orbit)
    assert space.critical is not None
    name, period = space.critical.first, space.interval(orbit)[1]
    x = _states(space, orbit).mean(axis=0)
    statics = Statics(model, {key: values[key] for key in model.parameter_names})
    unit = float(space.sizes.scalars[len(space.critical.orbit.free)])
    equilibria = EquilibriumSpace(statics, 1e-10, "newton", sizes_of([x]), name, values[name] + unit)
    found = locate_rest(equilibria, HOPF, x / equilibria.sizes, 0.0, 2j * np.pi / period)
    if found is None:
        return None
    course = equilibria.course
    assert course is not None
    at = {**statics.values, name: float(course.at(found.s))}
    resting = find_equilibrium(model, found.y * equilibria.sizes, parameters=at)
    resting = replace(resting, space=replace(cast(EquilibriumSpace, resting.space), parameter=name, to=at[name] + unit))
    return SpecialPoint(HOPF, name, at, found.error * unit, resting)


def _as_orbit(space: Followed, orbit: Point, end: SpecialPoint) -> Point:
    """The end as an orbit of amplitude zero of the curve."""
    problem = orbit.problem
    assert isinstance(problem, BoundaryProblem)
    assert space.critical is not None
    n, z = space.critical.states, orbit.z.copy()
    states = z[: problem.states].reshape(problem.columns, -1)
    states[:, :n] = end.solution.evaluate(0.0)
    for place, name in enumerate(space.statement.free, start=problem.states):
        if name == PERIOD:
            values = cast(Equilibrium, end.solution).eigenvalues
            known = 2.0j * np.pi / z[place]
            z[place] = 2.0 * np.pi / float(values[np.argmin(np.abs(values - known))].imag)
        elif name in end.parameters:
            z[place] = end.parameters[name]
    start = space.statement.values[space.parameter]
    z[-1] = (end.parameters[space.parameter] - start) / (space.to - start)
    moved = end.error / abs(space.to - start) / problem.parameter_size(z)
    error = ErrorEstimate(end.solution.error, end.solution.error, parameter=moved)
    return replace(orbit, z=z, error=error, requested=False, walked=False, better=None, special=end.kind)


# The place where orbits that left others, at a period doubling or where a symmetry is lost, rejoin them ---------------

PLACES = 65  # along an orbit at which it is compared with its image
NOTHING = 1e-9  # of the orbit: a difference that counts as zero
OPPOSITE = -0.5  # cosine of the angle between differences, below which their sign has changed


@dataclass(frozen=True, eq=False)
class Left:
    """The branch that a branch of orbits has left.

    Attributes:
        space: of the orbits that it left.
        turns: 2 at a period doubling, otherwise 1.
        signs: of the components of S.
        shift: s, as a share of the period.
    """

    space: BoundarySolutions
    turns: int
    signs: Array
    shift: float

    def rejoined(self, own: BoundarySolutions, before: Point, after: Point) -> Point | None:
        """The orbit of those that were left between two of the branch; None where there is none."""
        one, other = (self._parts(own, point)[1] for point in (before, after))
        norms = [float(np.linalg.norm(part)) for part in (one, other)]
        size = float(np.linalg.norm(self._parts(own, before)[0]))
        if min(norms) <= NOTHING * size or np.sum(one * other) >= OPPOSITE * norms[0] * norms[1]:
            return None
        return self._end(own, before if norms[0] < norms[1] else after)

    def _parts(self, own: BoundarySolutions, point: Point, fractions: Array | None = None) -> tuple[Array, Array]:
        """Half the sum and half the difference of an orbit and its image, at fractions of the period."""
        if fractions is None:
            fractions = np.linspace(0.0, 1.0, PLACES) * (1.0 - self.shift)
        x, later = (point.problem.sample(point.z, fractions + s) for s in (0.0, self.shift))
        if own.periodic is not None and any(own.periodic.turns):
            later = later - 2.0 * np.pi * self.shift * np.array(own.periodic.turns)
        return 0.5 * (x + self.signs * later), 0.5 * (x - self.signs * later)

    def _end(self, own: BoundarySolutions, near: Point) -> Point | None:
        """The special orbit of those that were left near an orbit, as one of the branch that comes back."""
        kind = DOUBLING if self.turns == 2 else BRANCH_POINT
        found = special_orbit(self.space, kind, self._mean(own, near))
        if found is None:
            return None
        problem, z = near.problem, near.z.copy()
        assert isinstance(problem, BoundaryProblem)
        turned = self.turns * problem._fractions()
        states = found.problem.sample(found.z, np.where(turned <= 1.0, turned, turned - 1.0))
        if self.space.periodic is not None and any(self.space.periodic.turns):
            states = states + 2.0 * np.pi * np.outer(turned > 1.0, self.space.periodic.turns)
        z[: problem.states] = states.ravel()
        values = self.space.parameters(found)
        for place, name in enumerate(own.statement.free, start=problem.states):
            z[place] = values[name] * (self.turns if name == PERIOD else 1)
        z[-1] = own.fraction(values[own.parameter])
        error = self.space.parameter_error(found) / abs(own.to - own.statement.values[own.parameter])
        return replace(
            near, z=z, error=replace(found.error, parameter=error / problem.parameter_size(z)), better=None,
            walked=False, requested=False, special=BRANCH_POINT,
        )  # fmt: skip

    def _mean(self, own: BoundarySolutions, near: Point) -> Point:
        """Half the sum of an orbit and its image as a point of the branch that was left."""
        space, old = self.space, near.problem
        assert isinstance(old, BoundaryProblem)
        parts = old.constants[: (old.constants.size + self.turns - 1) // self.turns]
        fitting = [r for r in space.levels.resolutions if r >= parts.size]
        resolution = fitting[0] if fitting else space.levels.resolutions[-1]
        lengths = mesh.resampled(parts / np.sum(parts), resolution)
        problem = space.levels.problem(resolution).with_constants(lengths)
        assert isinstance(problem, BoundaryProblem)
        places = problem._fractions() / self.turns
        reached = np.minimum(places, 1.0 - self.shift)  # beyond half a period: the image of half a period before
        states = self._parts(own, near, reached)[0]
        if self.shift and self.turns == 1:
            late = places > 1.0 - self.shift
            states[late] = self.signs * self._parts(own, near, places[late] - self.shift)[0]
        values = own.parameters(near)
        free = [values[name] / (self.turns if name == PERIOD else 1) for name in space.statement.free]
        z = np.concatenate([states.ravel(), free, [space.fraction(values[space.parameter])]])
        return replace(near, problem=problem, z=z, tangent=np.zeros(problem.size), better=None, special="")
