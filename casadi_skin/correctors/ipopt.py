"""Ipopt on the orbit equations as a square nonlinear programme without objective (Waechter and Biegler 2006)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem
from casadi_skin.correctors.base import Correction, Status
from casadi_skin.interrupts import interrupts_deferred

_STATUS = {
    "Solve_Succeeded": Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.TOO_MANY_ITERATIONS,
    "Maximum_Iterations_Exceeded": Status.TOO_MANY_ITERATIONS,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Restoration_Failed": Status.INFEASIBLE,
    "Diverging_Iterates": Status.DIVERGED,
}


class IpoptCorrector:
    """The nonlinear programme min 0 subject to R(z) = 0 and row . z = value, with row and value as its parameters.

    Residuals are made relative to the largest state, so that `tolerance` does not depend on the chain.
    Ipopt gets the Jacobian assembled by the problem and a structurally empty Hessian of the Lagrangian: with no
    objective the multipliers stay zero, and each iteration is a Newton step with MUMPS.
    """

    def __init__(self, problem: OrbitProblem, tolerance: float = 1e-12, max_iterations: int = 20) -> None:
        self.problem = problem
        z, residual, jacobian = problem.symbols
        size = problem.size
        held = ca.MX.sym("held", size + 2)
        row, value, scale = held[:size], held[size], held[size + 1]
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
            "print_time": False,
            "calc_lam_x": False,
            "calc_lam_p": False,
            "calc_f": False,
            "calc_g": False,
            "error_on_fail": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.tol": tolerance,
            "ipopt.constr_viol_tol": tolerance,
            "ipopt.acceptable_iter": 0,
            "ipopt.max_iter": max_iterations,
            "ipopt.nlp_scaling_method": "none",
            "ipopt.mumps_pivtol": 1e-6,
        }
        self._solver = ca.nlpsol("corrector", "ipopt", {"x": z, "p": held, "f": 0, "g": constraints}, options)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point with row . z = value, or a named failure."""
        scale = max(1.0, float(np.max(np.abs(guess[: self.problem.states]))))
        with interrupts_deferred():
            result = self._solver(x0=guess, p=np.concatenate([row, [value, scale]]), lbg=0.0, ubg=0.0)
        stats = self._solver.stats()
        words = str(stats["return_status"])
        status = _STATUS.get(words, Status.DIVERGED)
        z = np.array(result["x"]).ravel()
        if status is Status.CONVERGED and not np.all(np.isfinite(z)):
            status = Status.DIVERGED
        return Correction(z, status, int(stats["iter_count"]), words)
