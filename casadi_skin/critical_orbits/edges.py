"""Edges of real tongues of instability of a family, as special orbits that can be followed in a second parameter.

A multiplier leaves the unit circle through 1 or -1 where the linearised equations of a symmetric orbit have a solution
in one of its four symmetry classes: even or odd at the start, and at the end of the part of the period that is unknown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from casadi_skin.bvp.symmetry import pinned_components
from casadi_skin.critical_orbits.location import LocatedOrbit, solved
from casadi_skin.critical_orbits.starting import component_sizes
from casadi_skin.critical_orbits.systems import Critical
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.restating import restated
from casadi_skin.orbits.special_points import EDGE, SpecialPoint

AMPLITUDE = -2  # place of S among the parameters of a restated orbit: the period is the last
REACH = 1e-6  # of S: how far from the edge that is known the located one may be


def located_edge(point: SpecialPoint, parameter: str) -> tuple[Orbit, LocatedOrbit]:
    """The edge, solved for as an orbit of the model in its own coordinates; raises ArithmeticError."""
    orbit = restated(cast(Orbit, point.solution), parameter)
    space, first = cast(BoundarySpace, orbit.space), list(orbit.parameters)[AMPLITUDE]
    known, problem = orbit.parameters[first], orbit.problem
    for critical in _candidates(space, orbit, first):
        found = solved(space, critical, orbit.point, known)
        if found is not None and abs(found.value - known) <= REACH * abs(known):
            return orbit, found
    raise ArithmeticError(f"{space.model.name}: the edge is not found again on {problem.resolution} intervals")


def _candidates(space: BoundarySpace, orbit: Orbit, first: str) -> list[Critical]:
    """What an edge may be: the velocity is of the class that is odd where the orbit is even."""
    pinned = pinned_components(space.model, space.symmetry)
    odd = [tuple(place for place in range(space.model.full_size) if place not in part) for part in pinned]
    even = [tuple(part) for part in pinned]
    sizes = component_sizes(orbit.states)
    plain = Critical(EDGE, space.statement, first, sizes, np.zeros(sizes.size))
    classes = ((even[0], odd[1]), (odd[0], even[1]), (even[0], even[1]))
    joined = replace(plain, parity=(even[0], even[1]), joined=True)
    return [joined, *(replace(plain, parity=parity) for parity in classes)]
