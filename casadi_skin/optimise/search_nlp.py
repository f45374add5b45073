"""A search as a nonlinear programme with exact derivatives, solved by Ipopt (Waechter and Biegler 2006).

Unknown are the free numbers and, of every orbit, its values at the nodes, its squared frequency and, where an
objective or a constraint asks for a slope, its tangent. Deflation, where asked for, keeps the free numbers and the
frequencies out of balls round optima that are known (constraints in place of the shifted residuals of Farrell,
Birkisson and Funke 2015; compare Papadopoulos, Farrell and Surowiec 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.optimise.iteration_callback import Monitor, Watch
from casadi_skin.optimise.layout import SearchLayout
from casadi_skin.optimise.request import SearchRequest
from casadi_skin.solvers.nlp import SOLVED, nlp_solver
from casadi_skin.theory.linear import Array

MAX_ITERATIONS = 200
DIVERGED = 1e8  # size of an unknown that counts as run away
BALLS = 8  # known optima that are kept away from at a time
RADIUS = 0.05  # of these balls, in the free numbers relative to their range and in the frequency
VIOLATION = 1e-9  # of a constraint, relative to its terms


@dataclass(frozen=True, eq=False)
class Solution:
    """Where Ipopt ended: point, multipliers, and its word; `objective` in the sense asked for."""

    x: Array
    lam_g: Array
    lam_x: Array
    objective: float
    words: str
    iterations: int


class SearchNlp(SearchLayout):
    """The nonlinear programme of a request on a number of harmonics."""

    def __init__(self, request: SearchRequest, harmonics: int) -> None:
        self.request, self.harmonics = request, harmonics
        free, orbits = request.symbols(harmonics)
        sign = -1.0 if request.maximise else 1.0
        objective = ca.SX(request.evaluated(request.objective, orbits))
        conditions = [ca.SX(request.evaluated(c.quantity, orbits)) for c in request.conditions]
        self.has_tangent = tuple(o.tangent is not None for o in orbits)
        equations = [o.equations for o in orbits]
        self.rows = tuple(c.numel() for c in conditions)
        self.equations = sum(e.numel() for e in equations)
        self.free_count = request.free_count
        self.sizes = tuple(o.unknowns.numel() for o in orbits)
        self.state = request.chain.sites * harmonics + 1
        self._x = ca.vertcat(free, *(o.unknowns for o in orbits))
        held = [o.S for o in orbits] if "S" not in request.free else []
        self._p = ca.vertcat(*held) if held else ca.SX(0, 1)
        self.p = np.array(request.amplitudes if held else ())
        self._f, self._g = sign * objective, ca.vertcat(*equations, *conditions)
        sites = self.state - 1
        rows = [[part[:sites], part[sites]] for e in equations for part in ca.vertsplit(e, self.state)]
        self._row_blocks = [*(block for pair in rows for block in pair), *conditions]
        states = [part for o in orbits for part in ca.vertsplit(o.unknowns, self.state)]
        self._column_blocks = [free, *(block for part in states for block in (part[:sites], part[sites]))]
        self._sign = sign
        self._orbits = orbits
        self._solvers: dict[tuple[bool, bool], tuple[ca.Function, Watch]] = {}

    # Points ---------------------------------------------------------------------------------------------------------

    def pack(self, free: Array, orbits: list[tuple[Array, float]]) -> Array:
        """Unknowns from the free numbers and, of each orbit, values at the nodes and Omega; tangents are solved for."""
        parts = [free]
        for (values, Omega), tangent in zip(orbits, self.has_tangent, strict=True):
            parts += [values.ravel(), np.array([Omega**2]), np.zeros(self.state if tangent else 0)]
        x = np.concatenate(parts)
        return self._with_tangents(x) if any(self.has_tangent) else x

    def _with_tangents(self, x: Array) -> Array:
        from scipy.sparse.linalg import splu

        x, residual, jacobian = x.copy(), self.residual(x), self.jacobian(x).tocsc()
        for k, first in enumerate(self.starts):
            if self.has_tangent[k]:
                row = sum(self.sizes[:k]) + self.state
                matrix = jacobian[row : row + self.state, first + self.state : first + 2 * self.state]
                x[first + self.state : first + 2 * self.state] -= splu(matrix).solve(residual[row : row + self.state])
        return x

    # Functions ------------------------------------------------------------------------------------------------------

    def gradient(self, x: Array) -> Array:
        """Derivative of the objective that Ipopt minimises, shape (size,)."""
        return np.array(self._gradient(x, self.p)).ravel()

    def hessian(self, x: Array, lam_g: Array) -> Any:
        """Second derivative of the Lagrangian, a sparse matrix of scipy."""
        upper = self._derivatives["hess_lag"](x, self.p, 1.0, lam_g)
        return ca.triu2symm(upper).sparse()

    @cached_property
    def _gradient(self) -> ca.Function:
        return ca.Function("gradient", [self._x, self._p], [ca.densify(ca.gradient(self._f, self._x))])

    @cached_property
    def _objective(self) -> ca.Function:
        return ca.Function("objective", [self._x, self._p], [self._f])

    @cached_property
    def _jacobian(self) -> ca.SX:
        """Derivative of all constraints, block by block: dense rows beside dense columns would spoil the colouring."""
        rows = [ca.horzcat(*(ca.jacobian(row, column) for column in self._column_blocks)) for row in self._row_blocks]
        return ca.vertcat(*rows)

    @cached_property
    def _derivatives(self) -> dict[str, ca.Function]:
        """Functions that Ipopt calls, shared by its solvers and by what checks its optima."""
        lam_f, lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", self._g.numel())
        hessian = ca.triu(ca.hessian(lam_f * self._f + ca.dot(lam_g, self._g), self._x)[0])
        point = [self._x, self._p]
        jac_g = ca.Function("jac_g", point, [self._g, self._jacobian], ["x", "p"], ["g", "jac_g_x"])
        names = ["x", "p", "lam_f", "lam_g"]
        hess_lag = ca.Function("hess_lag", [*point, lam_f, lam_g], [hessian], names, ["triu_hess_gamma_x_x"])
        return {"jac_g": jac_g, "hess_lag": hess_lag}

    @cached_property
    def _constraints(self) -> ca.Function:
        return ca.Function("g", [self._x, self._p], [ca.densify(self._g), self._jacobian])

    def residual(self, x: Array) -> Array:
        """Equations and conditions at x: what is held between `condition_bounds`."""
        return np.array(self._constraints(x, self.p)[0]).ravel()

    def jacobian(self, x: Array) -> Any:
        """Derivative of `residual`, a sparse matrix of scipy."""
        return self._constraints(x, self.p)[1].sparse()

    def values(self, x: Array, names: tuple[str, ...]) -> list[dict[str, float]]:
        """Named quantities of every orbit at x; slopes only where the programme has the tangent."""
        found = []
        for k, orbit in enumerate(self._orbits):
            asked = [n for n in names if self.has_tangent[k] or not n.endswith("_slope")]
            made = ca.vertcat(*(orbit.value(n) for n in asked))
            numbers = np.array(ca.Function("values", [self._x, self._p], [made])(x, self.p)).ravel()
            found.append(dict(zip(asked, numbers.tolist(), strict=True)))
        return found

    def conditions(self, x: Array) -> dict[str, Array]:
        """Values of the conditions by name."""
        values, found, first = self.residual(x), {}, self.equations
        for condition, rows in zip(self.request.conditions, self.rows, strict=True):
            found[condition.name] = values[first : first + rows]
            first += rows
        return found

    def violations(self, x: Array) -> Array:
        """How far each constraint's row is from its bounds."""
        lower, upper = self.condition_bounds
        values = self.residual(x)
        return np.maximum(np.maximum(lower - values, values - upper), 0.0)

    # Solving --------------------------------------------------------------------------------------------------------

    def _solver(self, deflated: bool, polish: bool) -> tuple[ca.Function, Watch]:
        """Ipopt and what watches it, built once; to `polish` is to start at an optimum of fewer harmonics."""
        if (deflated, polish) not in self._solvers:
            self._solvers[deflated, polish] = self._built(deflated, polish)
        return self._solvers[deflated, polish]

    def _built(self, deflated: bool, polish: bool) -> tuple[ca.Function, Watch]:
        g, p = self._g, self._p
        if deflated:
            width = self.free_count + len(self.sizes)
            centres = ca.SX.sym("centres", width, BALLS)
            here = ca.vertcat(self._x[: self.free_count], *(self._x[i + self.state - 1] for i in self.starts))
            shift = (ca.repmat(here, 1, BALLS) - centres) / ca.DM(self.scales)
            g, p = ca.vertcat(g, ca.sum1(shift**2).T), ca.vertcat(p, ca.vec(centres))
        watch = Watch(self._x.numel(), g.numel(), p.numel(), self._sign)
        options = {
            "iteration_callback": watch,
            "ipopt.compl_inf_tol": 1e-9,
            "ipopt.max_iter": MAX_ITERATIONS,
            "ipopt.mumps_pivtol": 1e-6,
            "ipopt.diverging_iterates_tol": DIVERGED,
        }
        if not deflated:
            options |= self._derivatives
        if polish:
            options |= {"ipopt.mu_init": 1e-9, "ipopt.bound_push": 1e-12, "ipopt.bound_frac": 1e-12,
                        "ipopt.slack_bound_push": 1e-12, "ipopt.slack_bound_frac": 1e-12}  # fmt: skip
        return nlp_solver("search", {"x": self._x, "p": p, "f": self._f, "g": g}, 1e-10, options), watch

    def solve(
        self, x: Array, monitor: Monitor | None = None, known: tuple[Array, ...] = (), polish: bool = False
    ) -> Solution:
        """Where Ipopt ends from x; `known` are the places to keep away from."""
        lower, upper = self.bounds
        low, high = self.condition_bounds
        p = self.p
        if known:
            far = np.full(self.scales.size, 1e3) * self.scales
            centres = [*known[-BALLS:], *[far] * (BALLS - len(known[-BALLS:]))]
            p = np.concatenate([p, *centres])
            low, high = np.append(low, np.full(BALLS, RADIUS**2)), np.append(high, np.full(BALLS, np.inf))
        solver, watch = self._solver(bool(known), polish)
        watch.begin(low, high, monitor)
        result = solver(x0=np.clip(x, lower, upper), p=p, lbx=lower, ubx=upper, lbg=low, ubg=high)
        stats = solver.stats()
        found = np.array(result["x"]).ravel()
        rows = self._g.numel()
        return Solution(
            found, np.array(result["lam_g"]).ravel()[:rows], np.array(result["lam_x"]).ravel(),
            self._sign * float(result["f"]), str(stats["return_status"]), int(stats["iter_count"]),
        )  # fmt: skip

    @cached_property
    def _elastic(self) -> ca.Function:
        """Ipopt on: least sum of squares of what the conditions are off by, on orbits that meet their equations."""
        rows = self._g.numel() - self.equations
        met = ca.SX.sym("met", rows)
        off = self._g[self.equations :] - met
        options = {"ipopt.max_iter": MAX_ITERATIONS, "ipopt.bound_relax_factor": 0.0, "ipopt.mumps_pivtol": 1e-6}
        parts = {"x": ca.vertcat(self._x, met), "p": self._p, "f": ca.sumsqr(off), "g": self._g[: self.equations]}
        return nlp_solver("elastic", parts, 1e-9, options, exact=False)

    def nearest(self, x: Array) -> Solution | None:
        """The orbit, found from x, that misses the conditions least; None where Ipopt finds no orbit."""
        (lower, upper), (low, high) = self.bounds, (b[self.equations :] for b in self.condition_bounds)
        met = np.clip(self.residual(x)[self.equations :], low, high)
        solver = self._elastic
        result = solver(
            x0=np.append(np.clip(x, lower, upper), met), p=self.p, lbg=0, ubg=0,
            lbx=np.append(lower, low), ubx=np.append(upper, high),
        )  # fmt: skip
        stats = solver.stats()
        found, zero = np.array(result["x"]).ravel()[: self.size], np.zeros(self._g.numel())
        if stats["return_status"] != SOLVED:
            return None
        value = float(self._objective(found, self.p))
        return Solution(found, zero, np.zeros(self.size), self._sign * value, "nearest", int(stats["iter_count"]))


@lru_cache(maxsize=16)
def programme(request: SearchRequest, harmonics: int) -> SearchNlp:
    """The programme of a request; the last few are kept, since starts share them."""
    return SearchNlp(request, harmonics)
