"""A solution of a boundary-value problem, with its errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.arguments import short_repr
from casadi_skin.bvp import mesh
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.statement import BoundaryValueProblem
from casadi_skin.continuation.points import Point

if TYPE_CHECKING:
    from casadi_skin.orbits.boundary_branch import BoundaryBranch
    from casadi_skin.orbits.solve import Method


@dataclass(frozen=True, eq=False)
class BoundarySolution:
    """States over the interval and values of all parameters, with estimated errors.

    `error` is the estimated error of each state relative to its largest value (no less than a millionth of the largest
    of all states, nor a thousandth of that of the guess), the largest of these; `parameter_error` that of the free
    parameters, relative to their values (no less than a thousandth of their guess; 1 at least where that is 0).
    """

    statement: BoundaryValueProblem
    method: Method
    point: Point

    @property
    def problem(self) -> BoundaryProblem:
        """The equations that are satisfied."""
        problem = self.point.problem
        assert isinstance(problem, BoundaryProblem)
        return problem

    @cached_property
    def parameters(self) -> dict[str, float]:
        """All parameters by name."""
        values = self.problem.parameters(self.point.z)
        return dict(zip(self.statement.model.parameter_names, map(float, values), strict=True))

    def kept(self) -> dict[str, Any]:
        """What this kind of solution knows beyond its point; its neighbours on a branch know the same."""
        return {}

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Start and end."""
        return self.statement.span(np.array(list(self.parameters.values())))

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times in the interval, shape (time, component); raises ValueError for others."""
        try:
            times = np.atleast_1d(np.asarray(t, dtype=float))
        except (TypeError, ValueError):
            raise ValueError(f"t: given {short_repr(t)}; accepted: numbers") from None
        start, end = self.interval
        slack = 1e-9 * (end - start)
        if not np.all((times >= start - slack) & (times <= end + slack)):
            raise ValueError(f"t: given {times.min():g} to {times.max():g}; accepted: {start:g} to {end:g}")
        return self.problem.sample(self.point.z, np.clip((times - start) / (end - start), 0.0, 1.0))

    def __getitem__(self, name: str) -> float | Array:
        """The value of a parameter, or the values of a state at `t`; raises KeyError for other names."""
        names = self.statement.model.state_names
        if name in self.parameters:
            return self.parameters[name]
        if name not in names:
            raise KeyError(f"{name}; known: {', '.join((*names, *self.parameters))}")
        return self.states[:, names.index(name)]

    @cached_property
    def t(self) -> Array:
        """Times of the unknowns: ends and stages of the intervals."""
        start, end = self.interval
        return np.asarray(start + self.problem._fractions() * (end - start))

    @cached_property
    def states(self) -> Array:
        """States at `t`, shape (time, component)."""
        return np.array(self.point.z[: self.problem.states].reshape(-1, self.statement.model.full_size))

    @property
    def mesh(self) -> Array:
        """Ends of the intervals, shape (intervals + 1,)."""
        start, end = self.interval
        return np.asarray(start + mesh.edges(self.problem.constants) * (end - start))

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return self.problem.resolution

    @property
    def error(self) -> float:
        """Estimated error of the states, relative to the largest value of each."""
        return self.point.error.profile

    @property
    def parameter_error(self) -> float:
        """Estimated relative error of the free parameters; 0 where there are none."""
        return self.point.error.Omega if self.statement.free else 0.0

    @property
    def at_round_off(self) -> bool:
        """Whether rounding keeps the estimated errors above the tolerance: no mesh makes them smaller."""
        return self.point.at_round_off

    @property
    def residual(self) -> float:
        """Largest residual of the equations relative to their largest term."""
        return self.problem.relative_residual(self.point.z)

    def follow(self, parameter: str, end: float, **options: Any) -> BoundaryBranch:
        """The branch of solutions through this one; see `casadi_skin.orbits.boundary_branch.follow`."""
        from casadi_skin.orbits.boundary_branch import follow

        return follow(self, parameter, end, **options)
