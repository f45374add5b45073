"""Ipopt on the orbit equations as a square nonlinear programme without objective (Waechter and Biegler 2006).

Newton's method comes first, at a fraction of Ipopt's cost; Ipopt where it fails, and as arbiter of reported results. A
call of Ipopt that has nothing to do costs more than a Newton step. Several orbits are confirmed in one call: the
nonlinear programme of independent blocks, one an orbit, takes half of what the calls take one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.solve.newton import Correction, Corrector, HeldState, NewtonCorrector, ReturningCorrector, Status
from casadi_skin.solve.watch import check_time_limit, is_over
from casadi_skin.zero.problem import Array, Problem

# Nonlinear programs for Ipopt (Waechter and Biegler 2006): solvers are built, and their endings put in words, here ----

SOLVED_STATUS = "Solve_Succeeded"
_NO_POINT = "no point near the guess satisfies conditions and bounds"
_REASON_WORDS = {
    "Infeasible_Problem_Detected": _NO_POINT,
    "Restoration_Failed": _NO_POINT,
    "Diverging_Iterates": "the objective is unbounded below, or the iteration diverges",
    "Maximum_Iterations_Exceeded": "the iteration did not converge in the steps allowed",
    "Search_Direction_Becomes_Too_Small": "no way on: conditions and bounds leave hardly a point, or degenerate there",
    "Invalid_Number_Detected": "an expression has no finite value or derivative on the way",
}


def nlp_solver(
    name: str, nlp: Mapping[str, Any], tolerance: float, particular: Mapping[str, Any], *, exact: bool = True
) -> ca.Function:
    """Ipopt on the program {x, p, f, g}, silent, with CasADi's options `particular` beside the common ones.

    A failure comes back as a status. Where `exact`, constraints are met to the tolerance without scaling, bounds are
    not relaxed, and no acceptable point ends the iteration before.
    """
    options: dict[str, Any] = {
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": tolerance,
    }
    if exact:
        options |= {
            "ipopt.constr_viol_tol": tolerance,
            "ipopt.bound_relax_factor": 0.0,
            "ipopt.acceptable_iter": 0,
        }
    return ca.nlpsol(name, "ipopt", dict(nlp), options | dict(particular))


def nlp_reason(status: str) -> str:
    """Why Ipopt found no optimum, in words; the status itself where there are none."""
    return _REASON_WORDS.get(status, status)


STATUS_BY_WORDS = {
    SOLVED_STATUS: Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.TOO_MANY_ITERATIONS,
    "Maximum_Iterations_Exceeded": Status.TOO_MANY_ITERATIONS,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Restoration_Failed": Status.INFEASIBLE,
    "Diverging_Iterates": Status.DIVERGED,
}


def residual_scale(problem: Problem, z: Array) -> float:
    """The divisor of residuals, for a tolerance that does not depend on the size of states above 1."""
    return max(1.0, float(np.max(np.abs(z[: problem.states]))))


class _Once:
    """Values of a function of unknowns and numbers, kept for the next call: constraints and Jacobian are one.

    They are those of the first `distinct` points, the last of which stands for all others. Problems that share a solver
    take turns in it: each is stated with `of` before it is solved.
    """

    def __init__(self, problem: Problem, count: int) -> None:
        self._problem, self.distinct = problem, count
        self._last: tuple[Array, Array, tuple[Array, Array]] | None = None

    def of(self, problem: Problem, distinct: int) -> None:
        """Evaluate a problem from now on, at so many different points."""
        if problem is not self._problem:
            self._problem, self._last = problem, None
        self.distinct = distinct

    def __call__(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        if self._last is None or not (np.array_equal(z, self._last[0]) and np.array_equal(numbers, self._last[1])):
            self._last = z.copy(), numbers.copy(), self._problem.evaluated(z[: self.distinct], numbers)
        return self._last[2]


class Computed(ca.Callback):  # type: ignore[misc]
    """A function of dense columns: `evaluate` takes their entries, and gives the non-zeros of each result."""

    def __init__(
        self,
        name: str,
        arguments: Mapping[str, int],
        results: Mapping[str, ca.Sparsity],
        evaluate: Callable[..., Sequence[Array]] = lambda *_: (),
    ) -> None:
        ca.Callback.__init__(self)
        self._arguments, self._results, self._compute = list(arguments.items()), list(results.items()), evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._arguments)

    def get_n_out(self) -> int:
        return len(self._results)

    def get_name_in(self, i: int) -> str:
        return self._arguments[i][0]

    def get_name_out(self, i: int) -> str:
        return self._results[i][0]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._arguments[i][1], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._results[i][1]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: list[Any], results: list[Any]) -> int:
        """Fill the results that are wanted, as buffers of doubles."""
        given = zip(arguments, self._arguments, strict=True)  # None for zeros
        entries = [np.zeros(count) if buffer is None else np.frombuffer(buffer) for buffer, (_, count) in given]
        for result, values in zip(results, self._compute(*entries), strict=True):
            if result is not None:
                np.frombuffer(result)[:] = values
        return 0


class _Constraints(Computed):
    """The constraints of `count` points, with their Jacobian or without, as a function.

    Its arguments are the unknowns, and a row, its value and the scale of the residuals of each point, with the numbers
    of the problem behind them. `evaluate` gives the residuals and the non-zeros of the Jacobians.
    """

    def __init__(
        self, problem: Problem, evaluate: _Once, count: int, with_jacobian: bool, one_scalar: bool = False
    ) -> None:
        self._evaluate, self._count = evaluate, count
        self._size, self._numbers = problem.size, problem.numbers.size
        self._with_jacobian = with_jacobian
        size, (rows, columns) = self._size, problem.pattern
        self._in_row = np.arange(problem.states if one_scalar else 0, size)  # unknowns in the held row
        ends = np.searchsorted(columns, np.arange(size + 1))
        closed = np.insert(rows, ends[self._in_row + 1], size - 1)  # it is the last entry of its columns
        added = np.searchsorted(self._in_row, np.arange(size + 1))
        block = ca.Sparsity(size, size, (ends + added).tolist(), closed.tolist())
        self._closing = ends[self._in_row + 1] + np.arange(self._in_row.size)
        self._open = np.delete(np.arange(closed.size), self._closing)
        arguments = {"x": count * size, "p": count * (size + 2) + self._numbers}
        results = {"g": ca.Sparsity.dense(count * size, 1)}
        results |= {"jac_g_x": ca.diagcat(*[block] * count)} if with_jacobian else {}
        super().__init__("jac_g" if with_jacobian else "g", arguments, results)

    def eval_buffer(self, arguments: list[Any], results: list[Any]) -> int:
        """Fill the results that are wanted, as buffers of doubles; not a number where the model cannot be evaluated."""
        count, size = self._count, self._size
        z, held = (np.frombuffer(argument) for argument in arguments)
        held, numbers = held[: count * (size + 2)].reshape(count, size + 2), held[count * (size + 2) :]
        found = [None if result is None else np.frombuffer(result).reshape(count, -1) for result in results]
        z, rows, scale = z.reshape(count, size), held[:, :size], held[:, size + 1 :]
        residuals, nonzeros = self._evaluate(z, numbers)
        distinct = len(residuals)
        if is_over():
            residuals = np.full(residuals.shape, np.nan)  # which ends the iteration
        if found[0] is not None:
            found[0][:distinct, :-1] = residuals / scale[:distinct]
            found[0][distinct:, :-1] = found[0][distinct - 1, :-1]
            found[0][:, -1] = np.einsum("ij,ij->i", rows, z) - held[:, size]
        if self._with_jacobian and found[1] is not None:
            found[1][:distinct, self._open] = nonzeros / scale[:distinct]
            found[1][:distinct, self._closing] = rows[:distinct, self._in_row]
            found[1][distinct:] = found[1][distinct - 1]
        return 0


def _square_nlp(
    z: ca.MX, held: ca.MX, constraints: ca.MX, jac_g: ca.Function, tolerance: float, max_iterations: int
) -> ca.Function:
    """Ipopt on as many equations g(z; held) = 0 as unknowns: no objective, and an empty Hessian of the Lagrangian."""
    size = z.numel()
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", size)
    hess_lag = ca.Function(
        "hess_lag",
        [z, held, lam_f, lam_g],
        [ca.MX(size, size)],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )
    options = {
        "jac_g": jac_g,
        "hess_lag": hess_lag,
        "no_nlp_grad": True,  # the gradient of the Lagrangian, which is not used
        "calc_lam_x": False,
        "calc_lam_p": False,
        "calc_f": False,
        "calc_g": False,
        "ipopt.max_iter": max_iterations,
        "ipopt.nlp_scaling_method": "none",
        "ipopt.mumps_pivtol": 1e-6,
    }
    nlp = {"x": z, "p": held, "f": 0, "g": constraints}
    return nlp_solver("corrector", nlp, tolerance, options)


class IpoptCorrector(Corrector):
    """The nonlinear programme min 0 subject to R(z) = 0 and row . z = value, of one point or of `count` at once.

    Its parameters are the row, the value and the scale of the residuals of each point, then the problem's numbers. With
    `one_scalar` rows hold scalars alone, which makes sparser matrices.

    Residuals are made relative to the largest state, so that `tolerance` does not depend on the chain. Ipopt gets the
    Jacobian assembled by the problem and a structurally empty Hessian of the Lagrangian: with no objective the
    multipliers stay zero, and each iteration is a Newton step with MUMPS. Arguments and result are arrays of our own,
    with a row a point: no conversion, at a third of the cost.
    """

    def __init__(
        self,
        problem: Problem,
        tolerance: float = 1e-12,
        max_iterations: int = 20,
        one_scalar: bool = False,
        count: int = 1,
    ) -> None:
        self.problem = problem
        self._evaluate = evaluate = _Once(problem, count)
        g, jac_g = (
            _Constraints(problem, evaluate, count, with_jacobian, one_scalar) for with_jacobian in (False, True)
        )
        size, points = problem.size, count * (problem.size + 2)
        guess, found = np.zeros(count * size), np.zeros(count * size)
        parameters = np.zeros(points + problem.numbers.size)
        z, p = ca.MX.sym("z", guess.size), ca.MX.sym("p", parameters.size)
        solver = _square_nlp(z, p, g(z, p), jac_g, tolerance, max_iterations)
        self._guess, self._found = guess.reshape(count, size), found.reshape(count, size)
        self._held, self._numbers = parameters[:points].reshape(count, size + 2), parameters[points:]
        without, zero = np.full(guess.size, np.inf), np.zeros(guess.size)
        self._buffer, self._trigger = solver.buffer()
        arguments = {"x0": guess, "p": parameters, "lbx": -without, "ubx": without, "lbg": zero, "ubg": zero}
        self._kept = solver, g, jac_g, arguments  # CasADi holds no reference
        for name, values in (arguments | {"lam_x0": zero, "lam_g0": zero}).items():
            self._buffer.set_arg(solver.index_in(name), values.data)
        self._buffer.set_res(solver.index_out("x"), found.data)

    def all_corrected(self, points: Sequence[HeldState]) -> list[Correction]:
        """Corrections of up to `count` points, which share their status; the last point fills the rest."""
        count, size = self._guess.shape
        self._evaluate.of(self.problem, len(points))
        check_time_limit(f"Ipopt, {size * count} unknowns")
        for k in range(count):
            z, row, value = points[min(k, len(points) - 1)]
            self._guess[k], self._held[k, :size], self._held[k, size] = z, row, value
            self._held[k, size + 1] = residual_scale(self.problem, z)
        self._numbers[:] = self.problem.numbers
        with interrupts_deferred():
            self._trigger()
        check_time_limit(f"Ipopt, {size * count} unknowns")
        stats, found = self._buffer.stats(), self._found[: len(points)].copy()
        words = str(stats["return_status"])
        status = STATUS_BY_WORDS.get(words, Status.DIVERGED)
        if status is Status.CONVERGED and not np.all(np.isfinite(found)):
            status = Status.DIVERGED
        if status is not Status.CONVERGED:
            words = f"Ipopt: {words}; {self.problem.describe_largest_residual(points[0][0])}"
        return [Correction(z, status, int(stats["iter_count"]), words) for z in found]

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        return self.all_corrected([(guess, row, value)])[0]


# Newton's method first; Ipopt where it fails, and as arbiter of reported results --------------------------------------

NEWTON_STEPS = 10  # of Newton's method, before Ipopt is called
# Of each step to the next at least: the solution is within two steps of the guess then (Kantorovich).
STEP_SHRINKAGE = 0.5
LOWER_STEPS = 30  # of Newton's method with smaller residuals at each
AGREED_TOLERANCES = 10.0  # tolerances within which Ipopt's solution is the same as that of Newton's method


class ArbitratedCorrector(Corrector):
    """Newton's method, and Ipopt from the same guess where its steps do not shrink fast: they may lead anywhere then.

    Arguments:
        problem, tolerance, max_iterations: as those of `IpoptCorrector`.
        together: number of points that one call of Ipopt confirms.
        always: whether Ipopt is called for every verdict; else where a solution does not meet its test as it is.
        far: whether the solution may be far from its guess. Newton's steps, of any length, are then taken where Ipopt
            takes them too, as long as the residuals decrease, with factors that cost less than its own in long systems;
            then those to an orbit that attracts; and where Ipopt finds none, as in stiff problems.
    """

    confirms = True

    def __init__(
        self,
        problem: Problem,
        tolerance: float = 1e-12,
        max_iterations: int = 20,
        together: int = 1,
        always: bool = True,
        far: bool = False,
    ) -> None:
        self.problem, self.tolerance, self.max_iterations = problem, tolerance, max_iterations
        self.together, self._always, self._far = together, always, far

    def _ipopt(self, one_scalar: bool = False, count: int = 1) -> IpoptCorrector:
        """Ipopt on equations of this resolution, built when it is first needed."""
        key = ("ipopt", one_scalar, count, self.tolerance, self.max_iterations)
        if key not in self.problem.shared:
            made = IpoptCorrector(self.problem, self.tolerance, self.max_iterations, one_scalar, count)
            self.problem.shared[key] = made
        found: IpoptCorrector = self.problem.shared[key]
        return found.on(self.problem)

    @property
    def _nearby(self) -> NewtonCorrector:
        return NewtonCorrector(self.problem, self.tolerance, NEWTON_STEPS, STEP_SHRINKAGE)

    def near(self, guess: Array, row: Array, value: float) -> Correction:
        return self._nearby.correct(guess, row, value)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        near = self._nearby
        decreasing = NewtonCorrector(self.problem, self.tolerance, LOWER_STEPS, decreasing=True)
        for way in (near, decreasing, ReturningCorrector(self.problem, near)) if self._far else (near,):
            found = way.correct(guess, row, value)
            if found.converged:
                return found
        found = self._ipopt(not np.any(row[: self.problem.states])).correct(guess, row, value)
        if found.converged or not self._far:
            return found
        last = NewtonCorrector(self.problem, self.tolerance, NEWTON_STEPS).correct(guess, row, value)
        return last if last.converged else found

    def confirm_all(self, points: Sequence[HeldState]) -> list[Correction]:
        """The verdicts of Ipopt on solutions: each itself where it agrees; one by one where it does not solve all."""
        found: list[Correction] = []
        for first in range(0, len(points), self.together):
            some = points[first : first + self.together]
            verdicts = [] if self.together == 1 else self._ipopt(count=self.together).all_corrected(some)
            if not (verdicts and all(verdict.converged for verdict in verdicts)):
                verdicts = [self._verdict(*point) for point in some]
            found += self._agreed([point[0] for point in some], verdicts)
        return found

    def _verdict(self, z: Array, row: Array, value: float) -> Correction:
        """Ipopt's solution next to one; of a long system with the free parameter held where that will do.

        A row through all unknowns costs more.
        """
        if not self._always and self._is_optimal(z):
            return Correction(z, Status.CONVERGED, 0)
        one_scalar = not np.any(row[: self.problem.states])
        if self._far and not one_scalar:
            held = self.problem.parameter_row()
            found = self._ipopt(one_scalar=True).correct(z, held, float(held @ z))
            if found.converged:
                return found
        return self._ipopt(one_scalar).correct(z, row, value)

    def _agreed(self, solutions: Sequence[Array], verdicts: Sequence[Correction]) -> list[Correction]:
        """The verdicts, which are the solutions themselves where both are the same within the tolerance."""
        z, found = np.array(solutions), np.array([verdict.z for verdict in verdicts])
        with np.errstate(all="ignore"):  # one that is not finite does not agree
            apart = np.sqrt(np.einsum("ij,ij->i", self.problem.metrics(z, 1.0), (found - z) ** 2))
        agree = apart <= AGREED_TOLERANCES * self.tolerance
        return [
            Correction(one, verdict.status, 0) if verdict.converged and same else verdict
            for one, verdict, same in zip(solutions, verdicts, agree.tolist(), strict=True)
        ]

    def _is_optimal(self, z: Array) -> bool:
        """Whether z meets the test at which Ipopt ends: no scaled residual above the tolerance."""
        scaled = np.max(np.abs(self.problem.evaluate(z)[0])) / residual_scale(self.problem, z)
        return bool(scaled <= self.tolerance)


CORRECTORS: Mapping[str, Callable[..., Corrector]] = {
    "ipopt": IpoptCorrector,
    "newton": NewtonCorrector,
}


# The function that Ipopt calls at every iteration: it reports progress and can end the solve --------------------------

Monitor = Callable[[int, float, float], bool]  # (iteration, objective, violation) -> whether to stop


class IterationCallback(ca.Callback):  # type: ignore[misc]  # CasADi has no types
    """Calls a monitor at every iteration of Ipopt, and ends the solve where it returns True or raises.

    `failure` is the exception that the monitor raised: CasADi would report a failed evaluation in its place.
    """

    def __init__(self, unknowns: int, rows: int) -> None:
        ca.Callback.__init__(self)
        sizes = {"x": unknowns, "f": 1, "g": rows, "lam_x": unknowns, "lam_g": rows, "lam_p": 0}
        self._sizes = [sizes[name] for name in ca.nlpsol_out()]
        self.begin(np.zeros(rows), np.zeros(rows), np.ones(rows), None)
        self.construct("iteration", {})

    def begin(self, low: Array, high: Array, heights: Array, monitor: Monitor | None) -> None:
        """Prepare for another solve, with bounds of the constraints; Ipopt has them over `heights`."""
        self._low, self._high, self._heights, self._monitor, self._iteration = low, high, heights, monitor, 0
        self.failure: BaseException | None = None

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i], 1) if self._sizes[i] else ca.Sparsity(0, 0)

    def eval(self, arguments: list[ca.DM]) -> list[int]:
        try:
            return [int(self._monitor is not None and self._stops(dict(zip(ca.nlpsol_out(), arguments, strict=True))))]
        except BaseException as error:
            self.failure = error
            return [1]

    def _stops(self, values: dict[str, ca.DM]) -> bool:
        assert self._monitor is not None
        g = np.array(values["g"]).ravel() * self._heights
        violation = float(np.max(np.maximum(self._low - g, g - self._high), initial=0.0))
        self._iteration += 1
        return self._monitor(self._iteration - 1, float(values["f"]), violation)
