"""A nonlinear programme with exact derivatives, solved by Ipopt (Waechter and Biegler 2006).

Every search states its problem as one: an orbit in odd cosines, a boundary-value problem on a mesh, a kick in shooting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, Indices
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.expressions import Expression
from casadi_skin.optimise.iteration_callback import IterationCallback, Monitor
from casadi_skin.solvers.nlp import SOLVED, nlp_solver

BALLS = 8  # known optima that a solve keeps away from at a time
RADIUS = 0.05  # of the balls round them, in the scaled place
STOPPED = "User_Requested_Stop"
WARM_START: Mapping[str, Any] = {
    "ipopt.mu_init": 1e-9, "ipopt.bound_push": 1e-12, "ipopt.bound_frac": 1e-12, "ipopt.slack_bound_push": 1e-12,
    "ipopt.slack_bound_frac": 1e-12,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Solution:
    """Where Ipopt ended: point, multipliers, objective (of what is maximised the value itself) and return status."""

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
        """How far each constraint is from its bounds, shape (rows,)."""
        return np.asarray(np.maximum(np.maximum(self.low - g, g - self.high), 0.0))


class Nlp:
    """Minimise f(x, p), or maximise it, within `limits` of x and g(x, p); p has fixed `values`.

    Arguments:
        name: of the solver.
        x: unknowns, a symbol or (SX) a column of symbols.
        f: objective.
        g: constraints, equations first.
        limits: bounds.
        p, values: parameters, numbers that are no unknowns.
        jacobian: dg/dx where it is known; CasADi's otherwise.
        maximise: whether f is maximised.
        exact: whether second derivatives are used; without, Ipopt approximates them.
        options: of Ipopt, beyond those that every search has.
    """

    place: Expression | None = None  # scaled unknowns by which optima are told apart, for deflation

    def __init__(
        self,
        name: str,
        x: Expression,
        f: Expression,
        g: Expression,
        limits: Limits,
        *,
        p: Expression | None = None,
        values: Sequence[float] = (),
        jacobian: Expression | None = None,
        maximise: bool = False,
        exact: bool = True,
        options: Mapping[str, Any] = {},
    ) -> None:
        self.name, self.limits, self.exact, self.options = name, limits, exact, options
        self.sign = -1.0 if maximise else 1.0
        self._x, self._f, self._g = x, self.sign * f, ca.densify(g)
        self._p = type(x).sym("p", 0) if p is None else p
        self.p = np.array(values, dtype=float)
        self._jacobian = ca.jacobian(self._g, x) if jacobian is None else jacobian
        self._solvers: dict[tuple[bool, bool], tuple[ca.Function, IterationCallback]] = {}

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
        """Derivative of what Ipopt minimises, shape (size,)."""
        return np.array(self._gradient(x, self.p)[1]).ravel()

    def hessian(self, x: Array, lam_g: Array) -> Any:
        """Second derivative of the Lagrangian, a sparse matrix of scipy in columns."""
        return ca.triu2symm(self._hessian(x, self.p, 1.0, lam_g)).sparse().tocsc()

    def violations(self, x: Array) -> Array:
        """How far each constraint is from its bounds at x, shape (rows,)."""
        return self.limits.violations(self.residual(x))

    def row_name(self, row: int, x: Array) -> str:
        """The condition that a row of g belongs to, or its equation, in words."""
        names = (name for name, rows in self.limits.conditions.items() if row in rows)
        return next(names, None) or self.equation_name(row, x)

    def equation_name(self, row: int, x: Array) -> str:
        """An equation of the orbit, in words."""
        return "the equations of the orbit"

    def sizes(self, x: Array) -> Array:
        """What each unknown is measured by, shape (size,)."""
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

    def solve(
        self, x: Array, monitor: Monitor | None = None, known: Sequence[Array] = (), warm: bool = False
    ) -> Solution:
        """Where Ipopt ends.

        Arguments:
            x: start; it is moved within its bounds.
            monitor: called at every iteration with its number, the objective and the largest violation.
            known: places, scaled, that are kept away from.
            warm: whether the start is next to an optimum, on which the barrier is not to push it off its bounds.

        Raises:
            KeyboardInterrupt: after an interruption that nobody else listens for.
            Exception: what the monitor raised.
        """
        limits, p = self.limits, self.p
        low, high = limits.low, limits.high
        if known:
            width = np.asarray(known[0]).size
            centres = [*known[-BALLS:], *[np.full(width, 1e3)] * (BALLS - len(known[-BALLS:]))]
            p = np.concatenate([p, *centres])
            low, high = np.append(low, np.full(BALLS, RADIUS**2)), np.append(high, np.full(BALLS, np.inf))
        solver, callback = self._solver(bool(known), warm)
        with interrupts_deferred(end_solver=True):
            callback.begin(low, high, monitor and (lambda i, f, v: monitor(i, self.sign * f, v)))
            start = np.clip(x, limits.lower, limits.upper)
            result = solver(x0=start, p=p, lbx=limits.lower, ubx=limits.upper, lbg=low, ubg=high)
        if callback.failure is not None and not isinstance(callback.failure, KeyboardInterrupt):
            raise callback.failure
        stats = solver.stats()
        found, lam_g, lam_x = (np.array(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        objective, words = self.sign * float(result["f"]), str(stats["return_status"])
        return Solution(found, lam_g[: limits.low.size], lam_x, objective, words, int(stats["iter_count"]))

    def _solver(self, deflated: bool, warm: bool) -> tuple[ca.Function, IterationCallback]:
        """Ipopt with its callback, built once."""
        if (deflated, warm) not in self._solvers:
            self._solvers[deflated, warm] = self._built(deflated, WARM_START if warm else {})
        return self._solvers[deflated, warm]

    def _built(self, deflated: bool, more: Mapping[str, Any]) -> tuple[ca.Function, IterationCallback]:
        x, g, p = self._x, self._g, self._p
        derivatives = {"jac_g": self._constraints} | ({"hess_lag": self._hessian} if self.exact else {})
        if deflated:
            assert self.place is not None
            centres = type(x).sym("centres", self.place.numel(), BALLS)
            distances = ca.sum1((ca.repmat(self.place, 1, BALLS) - centres) ** 2).T
            g, p, derivatives = ca.vertcat(g, distances), ca.vertcat(p, ca.vec(centres)), {}
        callback = IterationCallback(x.numel(), g.numel(), p.numel())
        options = {**self.options, **more, **derivatives, "iteration_callback": callback}
        if not self.exact:
            options["ipopt.hessian_approximation"] = "limited-memory"
        return _ipopt(self.name, {"x": x, "p": p, "f": self._f, "g": g}, options), callback

    @cached_property
    def _elastic(self) -> ca.Function:
        """Ipopt on: least sum of squares of what the conditions are off by, on orbits that satisfy their equations."""
        equations, conditions = self.limits.equations.tolist(), self.limits.condition_rows.tolist()
        met = type(self._x).sym("met", len(conditions))
        off = ca.sumsqr(self._g[conditions] - met)
        parts = {"x": ca.vertcat(self._x, met), "p": self._p, "f": off, "g": self._g[equations]}
        return _ipopt("elastic", parts, {**self.options, "ipopt.tol": 1e-9})

    def nearest(self, x: Array) -> Solution | None:
        """The orbit, found from x, that misses the conditions least; None where there is none, or no condition."""
        limits, rows = self.limits, self.limits.condition_rows
        if rows.size == 0:
            return None
        met = np.clip(self.residual(x)[rows], limits.low[rows], limits.high[rows])
        with interrupts_deferred(end_solver=True):
            result = self._elastic(
                x0=np.append(np.clip(x, limits.lower, limits.upper), met), p=self.p, lbg=0, ubg=0,
                lbx=np.append(limits.lower, limits.low[rows]), ubx=np.append(limits.upper, limits.high[rows]),
            )  # fmt: skip
        stats = self._elastic.stats()
        if stats["return_status"] != SOLVED:
            return None
        found = np.array(result["x"]).ravel()[: self.size]
        value = self.sign * float(self._gradient(found, self.p)[0])
        zero = np.zeros(limits.low.size)
        return Solution(found, zero, np.zeros(self.size), value, "nearest", int(stats["iter_count"]))


def _ipopt(name: str, parts: Mapping[str, Expression], options: Mapping[str, Any]) -> ca.Function:
    """Ipopt with bounds that are not relaxed and no acceptable point; Ipopt's own tolerance unless options have one."""
    strict = {"ipopt.acceptable_iter": 0, "ipopt.bound_relax_factor": 0.0}
    return nlp_solver(name, parts, 1e-8, strict | dict(options), exact=False)
