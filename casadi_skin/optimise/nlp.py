"""A nonlinear programme with exact derivatives, solved by Ipopt (Waechter and Biegler 2006).

Every search states its problem as one: an orbit in odd cosines, a boundary-value problem on a mesh, a kick in shooting.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.solve.iteration_callback import IterationCallback, Monitor
from casadi_skin.solve.nlp import SOLVED, nlp_solver
from casadi_skin.zero.problem import Array, Indices

BALLS = 8  # known optima that a solve keeps away from at a time
RADIUS = 0.05  # of the balls round them, in the scaled place
STOPPED = "User_Requested_Stop"
WARM_START: Mapping[str, Any] = {
    "ipopt.mu_init": 1e-9, "ipopt.bound_push": 1e-12, "ipopt.bound_frac": 1e-12, "ipopt.slack_bound_push": 1e-12,
    "ipopt.slack_bound_frac": 1e-12,
}  # fmt: skip
IPOPT_TOLERANCE = 1e-8  # Ipopt's own, unless options have another


@dataclass(frozen=True, eq=False)
class Solution:
    """Where Ipopt ended: point, multipliers, objective (its own sign, also where it is maximised) and return status."""

    x: Array
    lam_g: Array
    lam_x: Array
    objective: float
    words: str
    iterations: int


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of the unknowns, lower <= x <= upper, and of the constraints, low <= g <= high.

    `unknowns` and `conditions` name what has bounds of its own: places among the unknowns, and rows of g. Rows of no
    condition are equations.
    """

    lower: Array
    upper: Array
    low: Array
    high: Array
    unknowns: Mapping[str, Indices] = field(default_factory=dict)
    conditions: Mapping[str, Indices] = field(default_factory=dict)

    @cached_property
    def condition_rows(self) -> Indices:
        """Rows of g that are conditions."""
        return np.concatenate([[], *self.conditions.values()]).astype(int)

    @cached_property
    def equations(self) -> Indices:
        """Rows of g that are equations of the orbit."""
        return np.setdiff1d(np.arange(self.low.size), self.condition_rows)

    def violations(self, g: Array) -> Array:
        """Distance of each constraint from its bounds, shape (rows,)."""
        return np.asarray(np.maximum(np.maximum(self.low - g, g - self.high), 0.0))


class Nlp:
    """Minimise f(x, p), or maximise it, within `limits` of x and g(x, p), where p has fixed `values`.

    `jacobian` is dg/dx where that is known. Second derivatives are used where they are `exact`; Ipopt approximates them
    elsewhere. `options` of Ipopt are added to those that every search has. `place` are scaled unknowns by which optima
    are distinguished.
    """

    place: Expression | None = None

    def __init__(
        self, x: Expression, f: Expression, g: Expression, limits: Limits, *, p: Expression | None = None,
        values: Sequence[float] | Array = (), jacobian: Expression | None = None, maximise: bool = False,
        exact: bool = True, options: Mapping[str, Any],
    ) -> None:  # fmt: skip
        self.limits, self.exact, self.options, self.sign = limits, exact, options, -1.0 if maximise else 1.0
        self._x, self._f, self._g = x, self.sign * f, ca.densify(g)
        self._p = type(x).sym("p", 0) if p is None else p
        self.p = np.array(values, dtype=float)
        self._jacobian = ca.jacobian(self._g, x) if jacobian is None else jacobian
        self._solvers: dict[bool, tuple[ca.Function, IterationCallback]] = {}

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self._x.numel())

    # Functions ------------------------------------------------------------------------------------------------------

    @cached_property
    def _constraints(self) -> ca.Function:
        return ca.Function("jac_g", [self._x, self._p], [self._g, self._jacobian], ["x", "p"], ["g", "jac_g_x"])

    @cached_property
    def _gradient(self) -> ca.Function:
        return ca.Function("gradient", [self._x, self._p], [self._f, ca.densify(ca.gradient(self._f, self._x))])

    @cached_property
    def _hessian(self) -> ca.Function:
        lam_f, lam_g = (type(self._x).sym(name, n) for name, n in (("lam_f", 1), ("lam_g", self._g.numel())))
        hessian = ca.triu(ca.hessian(lam_f * self._f + ca.dot(lam_g, self._g), self._x)[0])
        names = ["x", "p", "lam_f", "lam_g"]
        return ca.Function("hess_lag", [self._x, self._p, lam_f, lam_g], [hessian], names, ["triu_hess_gamma_x_x"])

    def residual(self, x: Array) -> Array:
        """Constraints at x, shape (rows,)."""
        return np.array(self._constraints(x, self.p)[0]).ravel()

    def jacobian(self, x: Array) -> Any:
        """Derivative of `residual`, a sparse matrix of scipy in columns."""
        return self._constraints(x, self.p)[1].sparse().tocsc()

    def gradient(self, x: Array) -> Array:
        """Derivative of the objective of Ipopt, shape (size,)."""
        return np.array(self._gradient(x, self.p)[1]).ravel()

    def hessian(self, x: Array, lam_g: Array) -> Any:
        """Second derivative of the Lagrangian, a sparse matrix of scipy in columns."""
        return ca.triu2symm(self._hessian(x, self.p, 1.0, lam_g)).sparse().tocsc()

    def violations(self, x: Array) -> Array:
        """Distance of each constraint from its bounds at x, shape (rows,)."""
        return self.limits.violations(self.residual(x))

    def row_name(self, row: int, x: Array) -> str:
        """The condition that a row of g belongs to, or its equation, in words."""
        names = (name for name, rows in self.limits.conditions.items() if row in rows)
        return next(names, None) or self.equation_name(row, x)

    def equation_name(self, row: int, x: Array) -> str:
        """An equation of the orbit, in words."""
        return "the equations of the orbit"

    def sizes(self, x: Array) -> Array:
        """Scale of each unknown, shape (size,)."""
        return np.ones(self.size)

    def fault(self, x: Array) -> str:
        """Why a point that satisfies all conditions is no solution, in words; empty where it is one."""
        return ""

    def times(self, x: Array) -> Array:
        """Times of the states among the unknowns; empty where these are at fixed phases."""
        return np.zeros(0)

    @property
    def measured(self) -> Indices:
        """Places of the free numbers, in which curvature is measured; none where all unknowns are, by their sizes."""
        return np.arange(0)

    def place_of(self, x: Array) -> Array:
        """`place` at x."""
        return np.array(ca.Function("place", [self._x], [self.place])(x)).ravel()

    # Solving --------------------------------------------------------------------------------------------------------

    def solve(self, x: Array, monitor: Monitor | None = None, warm: bool = False) -> Solution:
        """Where Ipopt ends from x, moved within its bounds; a `warm` start is next to an optimum, maybe on its bounds.

        Raises KeyboardInterrupt after an interruption that nobody else listens for, and what the monitor raised.
        """
        limits = self.limits
        if warm not in self._solvers:
            self._solvers[warm] = self._built(WARM_START if warm else {})
        solver, callback = self._solvers[warm]
        with interrupts_deferred(end_solver=True):
            callback.begin(limits.low, limits.high, monitor and (lambda i, f, v: monitor(i, self.sign * f, v)))
            start = np.clip(x, limits.lower, limits.upper)
            bounds = {"lbx": limits.lower, "ubx": limits.upper, "lbg": limits.low, "ubg": limits.high}
            result = solver(x0=start, p=self.p, **bounds)
        if callback.failure is not None and not isinstance(callback.failure, KeyboardInterrupt):
            raise callback.failure
        stats = solver.stats()
        found, lam_g, lam_x = (np.array(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        value, words = self.sign * float(result["f"]), str(stats["return_status"])
        return Solution(found, lam_g, lam_x, value, words, int(stats["iter_count"]))

    def _built(self, more: Mapping[str, Any]) -> tuple[ca.Function, IterationCallback]:
        """Ipopt with bounds that are not relaxed, and its callback."""
        parts = {"x": self._x, "p": self._p, "f": self._f, "g": self._g}
        callback = IterationCallback(self.size, self._g.numel(), self._p.numel())
        options = {
            "ipopt.acceptable_iter": 0, "ipopt.bound_relax_factor": 0.0, "jac_g": self._constraints,
            "iteration_callback": callback, **self.options, **more,
        }  # fmt: skip
        options |= {"hess_lag": self._hessian} if self.exact else {"ipopt.hessian_approximation": "limited-memory"}
        return nlp_solver("search", parts, IPOPT_TOLERANCE, options, exact=False), callback

    def away_from(self, known: Sequence[Array]) -> Nlp:
        """The same programme with constraints that keep out of balls round known places, the last few of them."""
        other, far = copy.copy(self._deflated), np.full(self.place.numel(), 1e3)  # type: ignore[union-attr]
        other.p = np.concatenate([self.p, *known[-BALLS:], *[far] * (BALLS - len(known[-BALLS:]))])
        return other

    @cached_property
    def _deflated(self) -> Nlp:
        assert self.place is not None
        centres = type(self._x).sym("centres", self.place.numel(), BALLS)
        distances = ca.sum1((ca.repmat(self.place, 1, BALLS) - centres) ** 2).T
        low = np.append(self.limits.low, np.full(BALLS, RADIUS**2))
        high = np.append(self.limits.high, np.full(BALLS, np.inf))
        return Nlp(
            self._x, self.sign * self._f, ca.vertcat(self._g, distances), replace(self.limits, low=low, high=high),
            p=ca.vertcat(self._p, ca.vec(centres)), maximise=self.sign < 0, exact=self.exact, options=self.options,
            jacobian=ca.vertcat(self._jacobian, ca.jacobian(distances, self._x)),
        )  # fmt: skip

    def nearest(self, x: Array) -> Solution | None:
        """The orbit, found from x, that misses the conditions least; None where there is none, or no condition."""
        rows, n = self.limits.condition_rows, self.size
        if rows.size == 0:
            return None
        met = np.clip(self.residual(x), self.limits.low, self.limits.high)[rows]
        elastic = self._elastic.solve(np.append(x, met))
        if elastic.words != SOLVED:
            return None
        value = self.sign * float(self._gradient(elastic.x[:n], self.p)[0])
        return Solution(
            elastic.x[:n], np.zeros(self.limits.low.size), np.zeros(n), value, "nearest", elastic.iterations
        )

    @cached_property
    def _elastic(self) -> Nlp:
        """Least sum of squares of the conditions' residuals, on orbits that satisfy their equations."""
        limits, rows, equations = self.limits, self.limits.condition_rows, self.limits.equations
        z = type(self._x).sym("z", self.size + rows.size)
        g, met = ca.substitute(self._g, self._x, z[: self.size]), z[self.size :]
        lower, upper = np.append(limits.lower, limits.low[rows]), np.append(limits.upper, limits.high[rows])
        return Nlp(
            z, ca.sumsqr(g[rows.tolist()] - met), g[equations.tolist()],
            Limits(lower, upper, limits.low[equations], limits.high[equations]), p=self._p, values=self.p,
            exact=self.exact, options={**self.options, "ipopt.tol": 1e-9},
        )  # fmt: skip
