"""Ipopt on the orbit equations as a square nonlinear programme without objective (Waechter and Biegler 2006)."""

from __future__ import annotations

import copy
from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, Problem
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.solvers.corrector import Correction, Status
from casadi_skin.solvers.nlp import SOLVED, nlp_solver

_STATUS = {
    SOLVED: Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.TOO_MANY_ITERATIONS,
    "Maximum_Iterations_Exceeded": Status.TOO_MANY_ITERATIONS,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Restoration_Failed": Status.INFEASIBLE,
    "Diverging_Iterates": Status.DIVERGED,
}


class IpoptCorrector:
    """The nonlinear programme min 0 subject to R(z) = 0 and row . z = value.

    Its parameters are row, value and the problem's constants.

    Residuals are made relative to the largest state, so that `tolerance` does not depend on the chain.
    Ipopt gets the Jacobian assembled by the problem and a structurally empty Hessian of the Lagrangian: with no
    objective the multipliers stay zero, and each iteration is a Newton step with MUMPS.
    """

    def __init__(self, problem: Problem, tolerance: float = 1e-12, max_iterations: int = 20) -> None:
        self.problem = problem
        z, residual, jacobian = problem.symbols
        size = problem.size
        held = ca.MX.sym("held", size + 2 + problem.constants.size)
        row, value, scale = held[:size], held[size], held[size + 1]
        residual, jacobian = ca.graph_substitute([residual, jacobian], [problem.constants_symbol], [held[size + 2 :]])
        constraints = ca.vertcat(residual / scale, ca.dot(row, z) - value)
        jac_g = ca.Function(
            "jac_g", [z, held], [constraints, ca.vertcat(jacobian / scale, row.T)], ["x", "p"], ["g", "jac_g_x"]
        )
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
            "no_nlp_grad": True,  # the gradient of the Lagrangian, which nothing asks for
            "calc_lam_x": False,
            "calc_lam_p": False,
            "calc_f": False,
            "calc_g": False,
            "ipopt.max_iter": max_iterations,
            "ipopt.nlp_scaling_method": "none",
            "ipopt.mumps_pivtol": 1e-6,
        }
        nlp = {"x": z, "p": held, "f": 0, "g": constraints}
        self._solver = nlp_solver("corrector", nlp, tolerance, options)
        self._buffers = self._attach(size, held.numel())

    def _attach(self, size: int, parameters: int) -> tuple[ca.FunctionBuffer, Callable[[], None], Array, Array, Array]:
        """The solver's arguments and result as arrays of our own: no conversion, at a third of the cost of a call."""
        guess, held, found = np.zeros(size), np.zeros(parameters), np.zeros(size)
        without, zero = np.full(size, np.inf), np.zeros(size)
        buffer, trigger = self._solver.buffer()
        arguments = {"x0": guess, "p": held, "lbx": -without, "ubx": without, "lbg": zero, "ubg": zero}
        self._fixed = tuple(arguments.values())  # the buffer holds no reference
        for name, values in (arguments | {"lam_x0": zero, "lam_g0": zero}).items():
            buffer.set_arg(self._solver.index_in(name), values.data)
        buffer.set_res(self._solver.index_out("x"), found.data)
        return buffer, trigger, guess, held, found

    def on(self, problem: Problem) -> IpoptCorrector:
        """This corrector for a problem that differs in its constants only; the solver built is shared."""
        other = copy.copy(self)
        other.problem = problem
        return other

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point with row . z = value, or a named failure."""
        scale = max(1.0, float(np.max(np.abs(guess[: self.problem.states]))))
        with interrupts_deferred():
            buffer, trigger, start, held, found = self._buffers
            start[:], size = guess, self.problem.size
            held[:size], held[size], held[size + 1], held[size + 2 :] = row, value, scale, self.problem.constants
            trigger()
        stats = buffer.stats()
        words = str(stats["return_status"])
        status = _STATUS.get(words, Status.DIVERGED)
        z = found.copy()
        if status is Status.CONVERGED and not np.all(np.isfinite(z)):
            status = Status.DIVERGED
        if status is not Status.CONVERGED:
            words = f"Ipopt: {words}; {self.problem.worst(guess)}"
        return Correction(z, status, int(stats["iter_count"]), words)
