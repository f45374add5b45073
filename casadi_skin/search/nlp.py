"""A nonlinear programme with exact derivatives, solved by Ipopt (Waechter and Biegler 2006).

Every search states its problem as one: an orbit in odd cosines, a boundary-value problem on a mesh, a kick in shooting.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import in_words
from casadi_skin.model.expressions import Expression
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.search.conditions import Condition
from casadi_skin.search.design import Ending, inequalities, same_value
from casadi_skin.solve.ipopt import SOLVED_STATUS, IterationCallback, Monitor, nlp_reason, nlp_solver
from casadi_skin.zero.problem import Array, Indices

STOPPED_STATUS = "User_Requested_Stop"
WARM_START: Mapping[str, Any] = {
    "ipopt.mu_init": 1e-9, "ipopt.bound_push": 1e-12, "ipopt.bound_frac": 1e-12, "ipopt.slack_bound_push": 1e-12,
    "ipopt.slack_bound_frac": 1e-12,
}  # fmt: skip
IPOPT_TOLERANCE = 1e-8  # Ipopt's own, unless options have another
JACOBIAN_NAMES = ["x", "p"], ["g", "jac_g_x"]
HESSIAN_NAMES = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]


# Ipopt with its callback, and the sizes of unknowns, constraints and objective.
_Solver: TypeAlias = tuple[ca.Function, IterationCallback, Array, Array, float]


@dataclass(frozen=True, eq=False)
class Solution:
    """Where Ipopt ended: point, multipliers, objective (its own sign, also where it is maximised) and return status."""

    x: Array
    lam_g: Array
    lam_x: Array
    objective: float
    words: str
    iterations: int


class Nlp:
    """Minimise f(x), or maximise it, subject to equations, bounds of unknowns, and conditions.

    Arguments:
        x, f, g: symbol, scalar, and the column that vanishes but for the rows of conditions, which come last.
        bounds: by name, places among the unknowns with lower and upper bounds; those of no name, "", are given no word.
        conditions: names and bounds of the last rows.
        jacobian: dg/dx where that is known.
        maximise: whether f is maximised.
        exact: whether second derivatives are used; Ipopt approximates them elsewhere.
        options: of Ipopt, added to those that every search has.
        place: scaled unknowns by which optima are distinguished.
        measured: places of the free numbers, in which curvature is measured; none where all unknowns are, by `sizes`.
        sizes: scale of each unknown at a point, (size,), in which Ipopt has them; 1 where none is given.
    """

    def __init__(
        self, x: Expression, f: Expression, g: Expression, bounds: Mapping[str, tuple[Any, Any, Any]],
        conditions: Sequence[Condition] = (), *, jacobian: Expression | None = None, maximise: bool = False,
        exact: bool = True, options: Mapping[str, Any], place: Expression | None = None, measured: Sequence[int] = (),
        sizes: Callable[[Array], Array] | None = None,
    ) -> None:  # fmt: skip
        self.exact, self.options, self.sign = exact, options, -1.0 if maximise else 1.0
        self._x, self._f, self._p = x, self.sign * f, type(x).sym("p", 0)  # none, which Ipopt's functions take
        self._g, self.conditions = ca.densify(g), conditions
        self.place, self.measured = place, np.array(measured, dtype=int)
        self._given_jacobian, self._sizes = jacobian, sizes
        self._solvers: dict[bool, _Solver] = {}
        self.lower, self.upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for places, lower, upper in bounds.values():
            self.lower[places], self.upper[places] = lower, upper
        self.unknowns = {name: np.array(places) for name, (places, _, _) in bounds.items() if name}
        rows, stop = int(g.numel()), int(g.numel()) - len(conditions)
        self.equations, self.condition_rows = np.arange(stop), np.arange(stop, rows)
        self.low = np.append(np.zeros(stop), [condition.lower for condition in conditions])
        self.high = np.append(np.zeros(stop), [condition.upper for condition in conditions])

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self._x.numel())

    # Functions ------------------------------------------------------------------------------------------------------

    @cached_property
    def _constraints(self) -> ca.Function:
        jacobian = ca.jacobian(self._g, self._x) if self._given_jacobian is None else self._given_jacobian
        return ca.Function("jac_g", [self._x, self._p], [self._g, jacobian], *JACOBIAN_NAMES)

    @cached_property
    def _gradient(self) -> ca.Function:
        return ca.Function("gradient", [self._x, self._p], [self._f, ca.densify(ca.gradient(self._f, self._x))])

    @cached_property
    def _hessian(self) -> ca.Function:
        lam_f, lam_g = (type(self._x).sym(name, n) for name, n in (("lam_f", 1), ("lam_g", self._g.numel())))
        hessian = ca.triu(ca.hessian(lam_f * self._f + ca.dot(lam_g, self._g), self._x)[0])
        return ca.Function("hess_lag", [self._x, self._p, lam_f, lam_g], [hessian], *HESSIAN_NAMES)

    def residual(self, x: Array) -> Array:
        """Constraints at x, shape (rows,)."""
        return np.array(self._constraints(x, [])[0]).ravel()

    def objective(self, x: Array) -> float:
        """The objective as it is reported."""
        return self.shown(float(self._gradient(x, [])[0]))

    def jacobian(self, x: Array) -> Any:
        """Derivative of `residual`, a sparse matrix of scipy in columns."""
        return self._constraints(x, [])[1].sparse().tocsc()

    def gradient(self, x: Array) -> Array:
        """Derivative of the objective of Ipopt, shape (size,)."""
        return np.array(self._gradient(x, [])[1]).ravel()

    def hessian(self, x: Array, lam_g: Array) -> Any:
        """Second derivative of the Lagrangian, a sparse matrix of scipy in columns."""
        return ca.triu2symm(self._hessian(x, [], 1.0, lam_g)).sparse().tocsc()

    def violations(self, g: Array) -> Array:
        """Distance of each constraint, of values g, from its bounds, shape (rows,)."""
        return np.asarray(np.maximum(np.maximum(self.low - g, g - self.high), 0.0))

    def row_name(self, row: int, x: Array) -> str:
        """The condition that a row of g belongs to, or its equation, in words."""
        stop = self.equations.size
        return self.equation_name(row, x) if row < stop else self.conditions[row - stop].name

    def equation_name(self, row: int, x: Array) -> str:
        """An equation of the orbit, in words."""
        return "an equation of the orbit"

    def sizes(self, x: Array) -> Array:
        """Scale of each unknown, shape (size,)."""
        return np.ones(self.size) if self._sizes is None else self._sizes(x)

    def gradient_size(self, x: Array) -> float:
        """The largest derivative of the objective over the sizes of unknowns, and what it changes by over these; or 1.

        An objective that is least where its gradient vanishes has a size by the latter.
        """
        sizes, moves, gradient = self.sizes(x), self.lower < self.upper, self.gradient(x)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], self.size) * moves
        changes = (self.gradient(x + PART_OF_SIZES * signs * sizes) - gradient) / PART_OF_SIZES
        found = np.abs(np.concatenate([gradient, changes]) * np.tile(sizes * moves, 2))
        return float(np.max(found, where=np.isfinite(found), initial=0.0)) or 1.0

    def shown(self, f: float) -> float:
        """The objective as it is reported, from that of Ipopt."""
        return self.sign * f

    def fault(self, x: Array) -> str:
        """Why a point that satisfies all conditions is no solution, in words; empty where it is one."""
        return ""

    def times(self, x: Array) -> Array:
        """Times of the states among the unknowns; empty where these are at fixed phases."""
        return np.zeros(0)

    def place_of(self, x: Array) -> Array:
        """`place` at x."""
        return np.array(ca.Function("place", [self._x], [self.place])(x)).ravel()

    # Solving --------------------------------------------------------------------------------------------------------

    def solve(self, x: Array, monitor: Monitor | None = None, warm: bool = False) -> Solution:
        """Where Ipopt ends from x, moved within its bounds; a `warm` start is next to an optimum, maybe on its bounds.

        Raises KeyboardInterrupt after an interruption that nobody else listens for, and what the monitor raised.
        """
        start = np.clip(x, self.lower, self.upper)
        if warm not in self._solvers:
            self._solvers[warm] = self._built(start, WARM_START if warm else {})
        solver, callback, sizes, heights, largest = self._solvers[warm]
        tell = monitor and (lambda i, f, v: monitor(i, self.shown(largest * f), v))
        with interrupts_deferred(end_solver=True):
            callback.begin(self.low, self.high, heights, tell)
            bounds = {"lbx": self.lower / sizes, "ubx": self.upper / sizes}
            result = solver(x0=start / sizes, lbg=self.low / heights, ubg=self.high / heights, **bounds)
        if callback.failure is not None and not isinstance(callback.failure, KeyboardInterrupt):
            raise callback.failure
        stats = solver.stats()
        found, lam_g, lam_x = (np.array(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        found = np.clip(found * sizes, self.lower, self.upper)  # Ipopt keeps to bounds, rounding may not
        value, words = self.shown(largest * float(result["f"])), str(stats["return_status"])
        lam_g, lam_x = largest * lam_g / heights, largest * lam_x / sizes
        return Solution(found, lam_g, lam_x, value, words, int(stats["iter_count"]))

    def nearest(self, x: Array) -> Array:
        """From x on, where conditions hold least badly and all else holds: the least sum of squares of what is amiss.

        Each is measured by its terms at x. It is x itself where that is not found, or without conditions.
        """
        rows, n, g = self.condition_rows, self.size, self.residual(x)
        z, low, high = ca.MX.sym("z", n + rows.size), self.low[rows], self.high[rows]
        heights = _heights(self.jacobian(x)[rows], self.sizes(x))
        moved = ca.Function("g", [self._x], [self._g])(z[:n])
        amiss = (moved[rows.tolist()] - z[n:]) / heights
        ends = np.append(self.lower, low), np.append(self.upper, high)
        elastic = Nlp(
            z, ca.sumsqr(amiss), moved[: rows.size and -rows.size], {"": (np.arange(n + rows.size), *ends)},
            exact=self.exact, options=self.options, sizes=lambda at: np.append(self.sizes(at[:n]), heights),
        )  # fmt: skip
        found = elastic.solve(np.append(x, np.clip(g[rows], low, high)))
        return found.x[:n] if rows.size and found.words == SOLVED_STATUS else x

    def _built(self, x: Array, more: Mapping[str, Any]) -> _Solver:
        """Ipopt with bounds that are not relaxed, on y = x / sizes and g / heights, the sizes and heights being at x.

        The objective is over what its gradient changes it by, so that neither tolerances nor steps depend on units.
        """
        count = {"y": self.size, "p": 0, "lam_f": 1, "lam_g": self._g.numel()}
        y, p, lam_f, lam_g = (ca.MX.sym(name, n) for name, n in count.items())
        sizes, heights = self.sizes(x), np.ones(count["lam_g"])
        heights = heights if self._sizes is None else _heights(self.jacobian(x), sizes)
        scaled, callback = sizes * y, IterationCallback(self.size, count["lam_g"])
        largest = max(self.gradient_size(x), LEAST_OF_VALUE * abs(self.objective(x)))
        f, g = (ca.Function("part", [self._x], [part])(scaled) for part in (self._f / largest, self._g))
        rows, J = self._constraints(scaled, p)
        jac_g = ca.Function("jac_g", [y, p], [rows / heights, _times(J, 1.0 / heights, sizes)], *JACOBIAN_NAMES)
        options = {
            "ipopt.acceptable_iter": 0, "ipopt.bound_relax_factor": 0.0, "iteration_callback": callback,
            "jac_g": jac_g, **self.options, **more,
        }  # fmt: skip
        if self.exact:
            H = _times(self._hessian(scaled, p, lam_f / largest, lam_g / heights), sizes, sizes)
            options["hess_lag"] = ca.Function("hess_lag", [y, p, lam_f, lam_g], [H], *HESSIAN_NAMES)
        else:
            options["ipopt.hessian_approximation"] = "limited-memory"
        parts = {"x": y, "p": p, "f": f, "g": g / heights}
        return nlp_solver("search", parts, IPOPT_TOLERANCE, options, exact=False), callback, sizes, heights, largest


def _heights(J: Any, sizes: Array) -> Array:
    """The terms of constraints of this Jacobian for unknowns of these sizes, shape (rows,)."""
    found = np.asarray(abs(J) @ sizes).ravel()
    return np.where(found > 0.0, found, 1.0)


def _times(matrix: ca.MX, left: Array, right: Array) -> ca.MX:
    """diag(left) matrix diag(right)."""
    return matrix * (ca.diag(ca.DM(left)) @ ca.DM.ones(matrix.sparsity()) @ ca.diag(ca.DM(right)))


# Whether a point is a local optimum: conditions of first and second order, from multipliers and exact derivatives -----

LEAST_OF_VALUE = 1e-6  # of the objective at a start: where sizes change it by less, rounding has most digits of that
PART_OF_SIZES = 0.1  # that unknowns are moved by, to see what the gradient changes by
CURVED_HESSIAN_RATIO = 1e-6  # of the Hessian in the free directions: less is rounding
CURVATURE_NOISE = 1e-8  # curvature, relative to the gradient, that errors of multipliers make where there is none
FLAT_CURVATURE = 1e-9  # curvature over sizes, relative to the objective's, where neighbours have the same value
NEAR_BOUND = 1e-6  # distance to a bound, relative to the range or to the size, at which it is active
ACTIVE_MULTIPLIER_RATIO = 1e-5  # size of a multiplier, relative to the largest, at which its bound is active


@dataclass(frozen=True)
class Optimality:
    """The conditions of optimality at a point, and how well they hold.

    Attributes:
        kkt: residual of the conditions of first order of Karush, Kuhn and Tucker, relative to their terms.
        violation: that of equations, bounds and conditions.
        multipliers: derivatives of the objective by active bounds, the point next to them or their multiplier not
            small, and by what equalities are equal to, in words.
        curvature: smallest eigenvalue of the Hessian of the Lagrangian on the directions that equations and active
            bounds leave free, in the metric of the free numbers; infinite where none is left, nan where not known.
        negative: the most negative one relative to the largest; 0 where none is beyond rounding.
        flat: whether neighbours along some direction of the free numbers do as well.
    """

    kkt: float
    violation: float
    multipliers: Mapping[str, float]
    curvature: float
    negative: float
    flat: bool

    @property
    def active(self) -> tuple[str, ...]:
        """The active bounds."""
        return inequalities(self.multipliers)


@lru_cache(maxsize=8)
def optimality(nlp: Nlp, solution: Solution) -> Optimality:
    """The conditions at a solution; the last few are kept."""
    g, J = nlp.residual(solution.x), nlp.jacobian(solution.x)
    scaled = _scaled(nlp, solution, J)
    multipliers, unknowns, rows = _active(nlp, solution, g, scaled)
    curvature, negative = _curvature(nlp, solution, J, unknowns, rows) if nlp.exact else (np.nan, 0.0)
    size = float(np.min(scaled.sizes[nlp.measured], initial=np.inf)) if nlp.measured.size else 1.0
    flat = bool(curvature * size**2 < FLAT_CURVATURE * scaled.largest)
    return Optimality(*_kkt(nlp, solution.x, g, scaled), multipliers, curvature, negative, flat)


def _scaled(nlp: Nlp, solution: Solution, J: Any) -> SimpleNamespace:
    """Conditions without units: of unknowns over their `sizes`, and constraints over `heights`, those of their terms.

    The gradient and the multipliers are in units of the objective, whose `gradient_size` is `largest`; J has no unit.
    """
    sizes, largest = nlp.sizes(solution.x), nlp.gradient_size(solution.x)
    heights, J = _heights(J, sizes), J.multiply(sizes[None]).tocsr()
    forces = {"gradient": sizes * nlp.gradient(solution.x), "lam_g": heights * solution.lam_g}
    forces["lam_x"], J = sizes * solution.lam_x, J.multiply(1.0 / heights[:, None])
    return SimpleNamespace(sizes=sizes, heights=heights, J=J, largest=largest, **forces)


def _kkt(nlp: Nlp, x: Array, g: Array, scaled: Any) -> tuple[float, float]:
    """The larger residual of stationarity and complementarity, and the violation."""
    sizes, heights, gradient, lam_g, lam_x = scaled.sizes, scaled.heights, scaled.gradient, scaled.lam_g, scaled.lam_x
    moves, rows = nlp.lower < nlp.upper, nlp.condition_rows
    terms = np.abs(gradient) + np.asarray(abs(scaled.J).T @ np.abs(lam_g)).ravel()
    total = gradient + np.asarray(scaled.J.T @ lam_g).ravel() + lam_x
    outside = np.maximum(np.maximum(nlp.lower - x, x - nlp.upper), 0.0) / sizes
    products = np.append(
        _complementarity(lam_x, (nlp.upper - x) / sizes, (x - nlp.lower) / sizes)[moves],
        _complementarity(lam_g, (nlp.high - g) / heights, (g - nlp.low) / heights)[rows],
    )
    stationarity = np.max((np.abs(total) / np.maximum(scaled.largest, terms))[moves])
    complementarity, gaps = np.max(products, initial=0.0) / scaled.largest, nlp.violations(g) / heights
    return float(max(stationarity, complementarity)), float(max(np.max(gaps, initial=0.0), np.max(outside)))


def _complementarity(multipliers: Array, above: Array, below: Array) -> Array:
    slack = np.minimum(np.where(multipliers > 0, above, below), 1.0)
    return np.abs(multipliers) * np.abs(np.where(multipliers == 0, 0.0, slack))


def _active(nlp: Nlp, solution: Solution, g: Array, scaled: Any) -> tuple[dict[str, float], Indices, Indices]:
    """Active bounds and equalities in words with multipliers, the unknowns at them, and the rows of conditions."""
    x, held = solution.x, ACTIVE_MULTIPLIER_RATIO * max(scaled.largest, *np.abs(scaled.lam_g))
    found, unknowns, rows = dict[str, float](), list[int](), list[int]()
    for name, places in nlp.unknowns.items():
        low, high = nlp.lower[places], nlp.upper[places]
        near = NEAR_BOUND * np.where(np.isfinite(high - low), high - low, scaled.sizes[places])
        for bound, sign, side in ((low, ">=", -1.0), (high, "<=", 1.0)):
            at = (np.abs(x[places] - bound) <= near) | (side * scaled.lam_x[places] > held)
            if np.any(at):
                where = "" if places.size == 1 else f" at {np.count_nonzero(at)} of {places.size} points"
                found[f"{name} {sign} {bound[0]:.10g}{where}"] = -nlp.sign * float(np.sum(solution.lam_x[places[at]]))
                unknowns += places[at].tolist()
    for row, condition in zip(nlp.condition_rows.tolist(), nlp.conditions, strict=True):
        for bound, sign in ((condition.lower, ">="), (condition.upper, "<=")):
            if np.isfinite(bound) and abs(g[row] - bound) <= NEAR_BOUND * scaled.heights[row]:
                rows.append(row)
                words = f"{condition.name} {'=' if condition.equality else sign} {bound:.10g}"
                found[words] = -nlp.sign * float(solution.lam_g[row])
    return found, np.unique(np.array(unknowns, dtype=int)), np.unique(np.array(rows, dtype=int))


def _curvature(nlp: Nlp, solution: Solution, J: Any, unknowns: Indices, rows: Indices) -> tuple[float, float]:
    """`curvature` and `negative` with these unknowns and rows held.

    There are few free directions, as many as free numbers less conditions. Random vectors, projected on the null space
    of the equations, span them; conditions and active bounds are taken out after that, since they may depend on each
    other.
    """
    from scipy.linalg import eigh, null_space

    moves = np.flatnonzero(nlp.lower < nlp.upper)
    sizes = nlp.sizes(solution.x)[:, None]
    basis = np.zeros((nlp.size, max(0, moves.size - nlp.equations.size)))
    try:
        basis[moves] = _null_space(J[nlp.equations][:, moves].multiply(sizes[moves].T))
    except RuntimeError:  # SuperLU: "Factor is exactly singular"
        return np.nan, 0.0
    closed = np.vstack([np.asarray(J[rows] @ (sizes * basis)), basis[unknowns]])
    basis = basis @ null_space(closed) if closed.size else basis
    if basis.shape[1] == 0:
        return np.inf, 0.0
    directions = sizes * basis
    curved = sizes * np.asarray(nlp.hessian(solution.x, solution.lam_g) @ directions)
    size, reduced = float(np.linalg.norm(curved, 2)), basis.T @ curved
    negative = float(eigh(reduced, eigvals_only=True)[0])
    free = directions[nlp.measured] if nlp.measured.size else basis
    try:
        least = float(eigh(reduced, free.T @ free, eigvals_only=True)[0])
    except np.linalg.LinAlgError:  # a direction that changes no free number
        least = np.nan
    noise = max(
        CURVED_HESSIAN_RATIO * size, CURVATURE_NOISE * float(np.max(np.abs(sizes.ravel() * nlp.gradient(solution.x))))
    )
    return least, negative / size if negative < -noise else 0.0


def _null_space(J: Any) -> Array:
    """Orthonormal vectors that a sparse matrix (m, n) of full rank maps to zero, (n, n - m); raises RuntimeError."""
    from scipy.sparse import bmat, diags, identity
    from scipy.sparse.linalg import splu

    m, n = J.shape
    if n <= m:
        return np.zeros((n, 0))
    largest = np.asarray(abs(J).max(axis=1).todense()).ravel()
    J = diags(1.0 / np.where(largest > 0.0, largest, 1.0)) @ J
    project = splu(bmat([[identity(n), J.T], [J, None]]).tocsc())
    basis = np.random.default_rng(0).normal(size=(n, n - m))
    for _ in range(2):  # the second time takes away the rounding of the first
        basis, _ = np.linalg.qr(project.solve(np.vstack([basis, np.zeros((m, n - m))]))[:n])
    return basis


# Starts, and where each leads -----------------------------------------------------------------------------------------

CONVERGED = 1e-7  # residual of an optimum, whatever Ipopt says of it
SAME_OPTIMUM_RTOL = 1e-4  # distance of places below which two optima of the same value are one
LARGEST_PLACE = 1e8  # from which on a free number, in units of its range or its own, is on its way to infinity
SEARCH_ENDINGS: Mapping[str, Ending] = {
    STOPPED_STATUS: Ending.INTERRUPTED,
    "Diverging_Iterates": Ending.UNBOUNDED,
    "Infeasible_Problem_Detected": Ending.INFEASIBLE,
    "Restoration_Failed": Ending.INFEASIBLE,
}


@dataclass(frozen=True)
class Start:
    """A start: its number from 1, and the free numbers that it starts from."""

    number: int
    free: tuple[float, ...]
    name: str = ""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of a start.

    Attributes:
        start: the start.
        ending: how it ended, and `words` why: by Ipopt, by the conditions of optimality, or by what is not there.
        path: the free numbers of the start and of the solution, shape (2, free), and `values` the objectives there.
        solution: where Ipopt ended; None where there was no orbit to start from.
        place: the free numbers with frequencies, scaled: optima at a distance below 1e-4 are one.
        times: of the states in the solution of a boundary-value problem; empty for kicks.
        violation: the largest violation of a constraint relative to its terms, and `gap` that in its own units.
    """

    start: Start
    ending: Ending
    words: str
    path: Array
    values: Array
    solution: Solution | None = None
    place: Array = field(default_factory=lambda: np.zeros(0))
    times: Array = field(default_factory=lambda: np.zeros(0))
    violation: float = np.inf
    gap: float = np.inf

    @property
    def found(self) -> bool:
        """Whether it is an optimum."""
        return self.ending is Ending.FOUND

    @property
    def last(self) -> tuple[int, float, float]:
        """Iterations, objective and largest violation."""
        return (0, np.inf, self.gap) if self.solution is None else (self.solution.iterations, self.objective, self.gap)

    @property
    def objective(self) -> float:
        """Objective of the solution; infinite where there is none."""
        return np.inf if self.solution is None else self.solution.objective

    def is_near(self, other: Outcome) -> bool:
        """Whether two outcomes are one optimum: the same place, and the same value of the objective."""
        return bool(np.max(np.abs(self.place - other.place)) <= SAME_OPTIMUM_RTOL) and same_value(self, other)


class Startable(Protocol):
    """A search as one start needs it."""

    def nlp_at(self, start: Start) -> tuple[Nlp, Array]:
        """The nonlinear programme of a start, and an orbit at its parameters as a point of it.

        Raises ArithmeticError where there is no orbit.
        """


def lost_start(start: Start, words: str, ending: Ending = Ending.INTERRUPTED) -> Outcome:
    """Outcome of a start that was not solved, as one whose processes were ended, in words; it may be run again."""
    return Outcome(start, ending, words, np.array([start.free]), np.full(1, np.nan))


def solve_start(problem: Startable, start: Start, monitor: Monitor | None = None) -> Outcome:
    """Outcome of a start: an orbit there, then Ipopt."""
    try:
        nlp, x = problem.nlp_at(start)
    except ArithmeticError as error:
        return lost_start(start, in_words(error), Ending.NOT_LOCATED)
    return judged(nlp, start, x, nlp.solve(x, monitor))


def judged(nlp: Nlp, start: Start, first: Array, solution: Solution) -> Outcome:
    """The outcome of a solution: an optimum where our own conditions of optimality say so."""
    ending, words, x = SEARCH_ENDINGS.get(solution.words, Ending.FAILED), nlp_reason(solution.words), solution.x
    path, values = np.array([first, x])[:, nlp.measured], np.array([nlp.objective(first), solution.objective])
    if not np.all(np.isfinite(x)):
        return Outcome(start, ending, words, path, values, solution)
    gaps, found = nlp.violations(nlp.residual(x)), optimality(nlp, solution)
    worst = int(np.argmax(gaps))
    if ending in (Ending.FAILED, Ending.INFEASIBLE) and max(found.kkt, found.violation) <= CONVERGED:
        fault = nlp.fault(x) or (f"curvature {found.negative:.1e} of the largest" if found.negative < 0 else "")
        ending, words = (Ending.NO_OPTIMUM, f"stationary, but {fault}") if fault else (Ending.FOUND, words)
    elif ending is Ending.INFEASIBLE:
        x = nlp.nearest(x)
        solution = replace(solution, x=x, objective=nlp.objective(x))
        gaps, found = nlp.violations(nlp.residual(x)), optimality(nlp, solution)
        worst = int(np.argmax(gaps))
        words = f"{nlp.row_name(worst, x)} is off by {gaps[worst]:.3g}"
        path[-1], values[-1] = x[nlp.measured], solution.objective
    place, times = nlp.place_of(x), nlp.times(x)
    if ending is Ending.FAILED and np.max(np.abs(place)) > LARGEST_PLACE:
        ending = Ending.UNBOUNDED
    return Outcome(start, ending, words, path, values, solution, place, times, found.violation, float(gaps[worst]))
