"""The search for special points on branches of equilibria, and on curves of their special points."""

from __future__ import annotations

from casadi_skin.follow.equilibrium_equations import EquilibriumEquations
from casadi_skin.follow.sample import Sample
from casadi_skin.follow.search import Search
from casadi_skin.follow.stretch import Signs
from casadi_skin.zero.settings import Point


class EquilibriumSearch(Search[Point]):
    """A search among equilibria, or curves of their special points."""

    def __init__(self, equations: EquilibriumEquations, signs: Signs) -> None:
        super().__init__(signs)
        self.equations = equations

    def sample(self, point: Point) -> Sample:
        return self.equations.sample(point)

    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        return self.equations.point_solver.along(before, after, fraction)

    def is_clear(self, point: Point) -> bool:
        return not self.sample(point).blurred
