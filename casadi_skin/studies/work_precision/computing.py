"""A setting computed: all that this study uses of the package beyond its public functions stands here.

Public functions build their problems anew in each call, which is not part of solving them.
"""

from __future__ import annotations

from collections.abc import Sequence

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.following import Following, run_following
from casadi_skin.follow.orbit import Orbit
from casadi_skin.stability.multipliers import floquets
from casadi_skin.stability.result import ReversibleFloquet
from casadi_skin.stability.stepping import OrbitState
from casadi_skin.studies.work_precision.settings import Setting


class Computation:
    """A setting, whose problems are built when they are first used and then kept."""

    def __init__(self, setting: Setting) -> None:
        self.space = Family(setting.family.request(**setting.methods))

    def follow(self, stability: bool = False) -> Branch:
        """The family to its end."""
        return run_following(Following(self.space, stability), None)

    def multipliers(self, orbits: Sequence[Orbit]) -> list[ReversibleFloquet]:
        """Stability of orbits of this family by the flow and to the tolerance of this setting.

        The errors of the orbits count for nothing. No mu at |gamma| = 1, where one site moves. Raises FlowError.
        """
        states = [OrbitState(orbit.point.problem, orbit.point.z) for orbit in orbits]
        return floquets(self.space.flow, states, self.space.accelerations, self.space.tolerance)


def requested_orbits(branch: Branch) -> list[Orbit]:
    """Orbits at the requested S; raises ArithmeticError with the reason where the family has not all."""
    if not branch.complete:
        raise ArithmeticError(branch.reason)
    return [orbit for orbit in branch.orbits if orbit.point.requested]
