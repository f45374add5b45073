"""Ipopt on the orbit equations as a square nonlinear programme without objective (Waechter and Biegler 2006)."""

from __future__ import annotations

import copy

import casadi as ca
import numpy as np

from casadi_skin.bvp.collocation import CollocationEquations
from casadi_skin.bvp.problem import Array, Problem
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.solvers.corrector import Correction, Status
from casadi_skin.solvers.nlp import SOLVED, nlp_solver
from casadi_skin.solvers.watch import TimeLimitError, heed, is_over

STATUS = {
    SOLVED: Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.TOO_MANY_ITERATIONS,
    "Maximum_Iterations_Exceeded": Status.TOO_MANY_ITERATIONS,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Restoration_Failed": Status.INFEASIBLE,
    "Diverging_Iterates": Status.DIVERGED,
}


def _expressed(problem: Problem, z: ca.MX, held: ca.MX) -> tuple[ca.MX, ca.Function]:
    """The constraints and the function of their Jacobian, of a problem that is made of expressions."""
    size = problem.size
    row, value, scale = held[:size], held[size], held[size + 1]
    own = [*problem.symbols, problem.constants_symbol]
    residual, jacobian = ca.graph_substitute(own[1:3], [own[0], own[3]], [z, held[size + 2 :]])
    constraints = ca.vertcat(residual / scale, ca.dot(row, z) - value)
    results = [constraints, ca.vertcat(jacobian / scale, row.T)]
    return constraints, ca.Function("jac_g", [z, held], results, ["x", "p"], ["g", "jac_g_x"])


def _numbers(problem: Problem) -> Array:
    """The numbers that may change in the constraints."""
    return problem.numbers if isinstance(problem, CollocationEquations) else problem.constants


def residual_scale(problem: Problem, z: Array) -> float:
    """What residuals are divided by, for a tolerance that does not depend on the size of states above 1."""
    return max(1.0, float(np.max(np.abs(z[: problem.states]))))


class _Constraints(ca.Callback):  # type: ignore[misc]
    """The constraints of a problem that is evaluated by numpy, with their Jacobian or without, as a CasADi function."""

    def __init__(self, problem: CollocationEquations, with_jacobian: bool, one_scalar: bool) -> None:
        ca.Callback.__init__(self)
        self._evaluate, self._size, self._numbers = problem.discretisation, problem.size, problem.numbers.size
        self._with_jacobian = with_jacobian
        size, (rows, columns) = self._size, problem.pattern
        self._held = np.arange(problem.states if one_scalar else 0, size)  # unknowns in the held row
        ends = np.searchsorted(columns, np.arange(size + 1))
        closed = np.insert(rows, ends[self._held + 1], size - 1)  # it is the last entry of its columns
        added = np.searchsorted(self._held, np.arange(size + 1))
        self._sparsity = ca.Sparsity(size, size, (ends + added).tolist(), closed.tolist())
        self._closing = ends[self._held + 1] + np.arange(self._held.size)
        self._open = np.delete(np.arange(closed.size), self._closing)
        self.construct("jac_g" if with_jacobian else "g", {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return 1 + self._with_jacobian

    def get_name_in(self, i: int) -> str:
        return "xp"[i]

    def get_name_out(self, i: int) -> str:
        return ("g", "jac_g_x")[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense((self._size, self._size + 2 + self._numbers)[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._sparsity if i else ca.Sparsity.dense(self._size)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: list[memoryview], results: list[memoryview | None]) -> int:
        """Fill the results that are wanted, as buffers of doubles; not a number where the model cannot be evaluated."""
        size = self._size
        z, held = (np.frombuffer(argument) for argument in arguments)
        row, value, scale = held[:size], held[size], held[size + 1]
        found = [None if result is None else np.frombuffer(result) for result in results]
        try:
            if is_over():  # which ends the iteration
                raise TimeLimitError
            residual, nonzeros = self._evaluate(z, held[size + 2 :])
        except (ArithmeticError, RuntimeError):
            residual, nonzeros = np.full(size - 1, np.nan), np.full(self._open.size, np.nan)
        if found[0] is not None:
            found[0][:-1], found[0][-1] = residual / scale, row @ z - value
        if self._with_jacobian and found[1] is not None:
            found[1][self._open], found[1][self._closing] = nonzeros / scale, row[self._held]
        return 0


def square_solver(
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


class Attached:
    """A square solver with arguments and result in arrays of our own: no conversion, at a third of the cost."""

    def __init__(self, solver: ca.Function) -> None:
        size = solver.numel_in("x0")
        self.guess, self.held, self.found = np.zeros(size), np.zeros(solver.numel_in("p")), np.zeros(size)
        without, zero = np.full(size, np.inf), np.zeros(size)
        self._solver, (self._buffer, self._trigger) = solver, solver.buffer()
        arguments = {"x0": self.guess, "p": self.held, "lbx": -without, "ubx": without, "lbg": zero, "ubg": zero}
        self._fixed = tuple(arguments.values())  # the buffer holds no reference
        for name, values in (arguments | {"lam_x0": zero, "lam_g0": zero}).items():
            self._buffer.set_arg(solver.index_in(name), values.data)
        self._buffer.set_res(solver.index_out("x"), self.found.data)

    def solve(self) -> tuple[Array, str, int]:
        """Solution from `guess` with `held`, Ipopt's own words for how it ended, and the iterations."""
        with interrupts_deferred():
            self._trigger()
        stats = self._buffer.stats()
        return self.found.copy(), str(stats["return_status"]), int(stats["iter_count"])


class IpoptCorrector:
    """The nonlinear programme min 0 subject to R(z) = 0 and row . z = value.

    Its parameters are row, value and the problem's constants.

    With `one_scalar` rows hold scalars alone, which makes sparser matrices.

    Residuals are made relative to the largest state, so that `tolerance` does not depend on the chain.
    Ipopt gets the Jacobian assembled by the problem and a structurally empty Hessian of the Lagrangian: with no
    objective the multipliers stay zero, and each iteration is a Newton step with MUMPS.
    """

    def __init__(
        self, problem: Problem, tolerance: float = 1e-12, max_iterations: int = 20, one_scalar: bool = False
    ) -> None:
        self.problem, size = problem, problem.size
        z, held = ca.MX.sym("z", size), ca.MX.sym("held", size + 2 + _numbers(problem).size)
        if isinstance(problem, CollocationEquations):  # which are no expressions
            self._evaluated = tuple(_Constraints(problem, jacobian, one_scalar) for jacobian in (False, True))
            constraints, jac_g = self._evaluated[0](z, held), self._evaluated[1]
        else:
            constraints, jac_g = _expressed(problem, z, held)
        self._attached = Attached(square_solver(z, held, constraints, jac_g, tolerance, max_iterations))

    def on(self, problem: Problem) -> IpoptCorrector:
        """This corrector for a problem that differs in its constants only; the solver built is shared."""
        other = copy.copy(self)
        other.problem = problem
        return other

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point with row . z = value, or a named failure."""
        words = f"Ipopt, {self.problem.size} unknowns"
        heed(words)
        scale = residual_scale(self.problem, guess)
        attached, size = self._attached, self.problem.size
        attached.guess[:] = guess
        held = attached.held
        held[:size], held[size], held[size + 1], held[size + 2 :] = row, value, scale, _numbers(self.problem)
        z, words, iterations = attached.solve()
        heed(f"Ipopt, {size} unknowns")
        status = STATUS.get(words, Status.DIVERGED)
        if status is Status.CONVERGED and not np.all(np.isfinite(z)):
            status = Status.DIVERGED
        if status is not Status.CONVERGED:
            words = f"Ipopt: {words}; {self.problem.worst(guess)}"
        return Correction(z, status, iterations, words)
