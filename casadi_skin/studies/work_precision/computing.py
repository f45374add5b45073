"""A setting computed: all that this study uses of the package beyond its public functions stands here.

Public functions build their problems anew in each call, which is to be told apart from solving them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.follow import Following
from casadi_skin.orbits.multipliers import accelerations
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.stability.flow import OrbitState
from casadi_skin.stability.multipliers import floquets
from casadi_skin.stability.result import Floquet
from casadi_skin.studies.work_precision.settings import Family, Setting


def default_walker(family: Family) -> str:
    """The walker of a family where none is asked for."""
    return FamilyRequest(family.chain, family.mode, family.amplitude_max, family.at).way


class Computation:
    """A setting, whose problems are built when they are first used and then kept."""

    def __init__(self, setting: Setting) -> None:
        family = setting.family
        request = FamilyRequest(family.chain, family.mode, family.amplitude_max, family.at, **setting.methods)
        self.space = Family(request)

    def follow(self, stability: bool = False) -> Branch:
        """The family to its end."""
        continuation = Following(self.space, stability)
        for _ in continuation:
            pass
        return continuation.branch()

    def multipliers(self, orbits: Sequence[Orbit]) -> list[Floquet]:
        """Stability of orbits of this family by the flow and to the tolerance of this setting.

        The errors of the orbits count for nothing. No mu at |gamma| = 1, where one site moves. Raises FlowError.
        """
        if self.space.coordinates.core.sites == 1:
            return [Floquet(np.zeros(0, complex), np.zeros(0), 0.0, 2) for _ in orbits]
        states = [OrbitState(orbit.point.problem, orbit.point.z) for orbit in orbits]
        tolerance = self.space.request.tolerance
        return floquets(self.space.flow, states, lambda found: accelerations(self.space, found), tolerance)


def requested_orbits(branch: Branch) -> list[Orbit]:
    """Orbits at the S that were asked for; raises ArithmeticError with the reason where the family has not all."""
    if not branch.complete:
        raise ArithmeticError(branch.reason)
    return [orbit for orbit in branch.orbits if orbit.point.requested]


def unknowns(orbit: Orbit) -> int:
    """The number of unknowns of an orbit."""
    return orbit.point.problem.size
