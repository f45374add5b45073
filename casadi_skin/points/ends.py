"""The branch that a branch of orbits has left, to which it may come back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import ending, special_orbit
from casadi_skin.zero import mesh
from casadi_skin.zero.kinds import BRANCH_POINT, KINDS_BY_TURNS
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import PERIOD, stated

# The place where orbits that left others, at a period doubling or where a symmetry is lost, rejoin them ---------------

IMAGE_PLACES = 65  # along an orbit at which it is compared with its image
ZERO_DIFFERENCE_RTOL = 1e-9  # of the orbit: a difference that counts as zero
OPPOSITE_COSINE = -0.5  # cosine of the angle between differences, below which their sign has changed


def fitted(space: SolutionSpace, lengths: Array) -> Any:
    """The discretisation with a mesh like intervals of these lengths, as many of them or a few more."""
    resolutions = space.levels.resolutions
    resolution = next((r for r in resolutions if r >= lengths.size), resolutions[-1])
    problem = stated(space.levels.problem(resolution))
    return problem.with_constants(mesh.resampled(lengths / np.sum(lengths), resolution))


@dataclass(frozen=True, eq=False)
class Left:
    """The branch that a branch of orbits has left.

    Attributes:
        space: of the orbits that it left.
        turns: 2 at a period doubling, otherwise 1.
        signs: of the components of S.
        shift: s, as a share of the period.
    """

    space: SolutionSpace
    turns: int
    signs: Array
    shift: float

    def rejoined(self, own: SolutionSpace, before: Point, after: Point) -> Point | None:
        """The orbit of those that were left between two of the branch; None where there is none."""
        one, other = (self._parts(own, point)[1] for point in (before, after))
        norms = [float(np.linalg.norm(part)) for part in (one, other)]
        size = float(np.linalg.norm(self._parts(own, before)[0]))
        if min(norms) <= ZERO_DIFFERENCE_RTOL * size or np.sum(one * other) >= OPPOSITE_COSINE * norms[0] * norms[1]:
            return None
        return self._end(own, before if norms[0] < norms[1] else after)

    def _parts(self, own: SolutionSpace, point: Point, fractions: Array | None = None) -> tuple[Array, Array]:
        """Half the sum and half the difference of an orbit and its image, at fractions of the period."""
        if fractions is None:
            fractions = np.linspace(0.0, 1.0, IMAGE_PLACES) * (1.0 - self.shift)
        x, later = (point.problem.sample(point.z, fractions + s) for s in (0.0, self.shift))
        if own.periodic is not None and any(own.periodic.turns):
            later = later - 2.0 * np.pi * self.shift * np.array(own.periodic.turns)
        return 0.5 * (x + self.signs * later), 0.5 * (x - self.signs * later)

    def _end(self, own: SolutionSpace, near: Point) -> Point | None:
        """The special orbit of those that were left near an orbit, as one of the branch that comes back."""
        found = special_orbit(self.space, KINDS_BY_TURNS[self.turns], self._mean(own, near))
        if found is None:
            return None
        turned = self.turns * stated(near.problem)._fractions()
        states = found.problem.sample(found.z, np.where(turned <= 1.0, turned, turned - 1.0))
        if self.space.periodic is not None and any(self.space.periodic.turns):
            states = states + 2.0 * np.pi * np.outer(turned > 1.0, self.space.periodic.turns)
        known = self.space.parameters(found)
        values = {name: value * (self.turns if name == PERIOD else 1) for name, value in known.items()}
        error = self.space.parameter_error(found) / abs(own.to - own.statement.values[own.parameter])
        u = own.fraction(values[own.parameter])
        return ending(near, BRANCH_POINT, states, values, u, replace(found.error, parameter=error))

    def _mean(self, own: SolutionSpace, near: Point) -> Point:
        """Half the sum of an orbit and its image as a point of the branch that was left."""
        space, old = self.space, stated(near.problem)
        problem = fitted(space, old.constants[: (old.constants.size + self.turns - 1) // self.turns])
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
