"""The orbit equations as a problem for Ipopt in C, through Ipopt's C interface."""

from __future__ import annotations

import casadi as ca

from casadi_skin.export.c_text import Call
from casadi_skin.export.exported_model import Subject
from casadi_skin.export.part import Part, called
from casadi_skin.solvers.nlp import nlp_solver

IPOPT_HEADER = "coin-or/IpStdCInterface.h"


def ipopt_part(subject: Subject) -> Part:
    """A square problem: the equations and the row that holds kappa, with the Jacobian from its structure."""
    problem = subject.problem
    z, residual, jacobian = problem.symbols
    held = ca.MX.sym("held")
    equations = ca.vertcat(ca.densify(residual), z[problem.parameter_index] - held)
    row = ca.MX(ca.sparsify(ca.DM(problem.parameter_row()).T))
    size = problem.size
    weights, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", size)
    options = {
        "jac_g": ca.Function("jac_g", [z, held], [equations, ca.vertcat(jacobian, row)]),
        "hess_lag": ca.Function("hess_lag", [z, held, weights, multipliers], [ca.MX(size, size)]),
    }
    program = {"x": z, "p": held, "f": ca.MX(0), "g": equations}
    solver = nlp_solver("solver", program, 1e-12, options, exact=False)
    start, value = ca.MX.sym("start", size), ca.MX.sym("value")
    solved = solver(x0=start, p=value, lbg=0, ubg=0)
    function = ca.Function(f"{subject.name}_generated_ipopt", [start, value], [solved["x"], solved["g"]])
    prototype = "int @p_ipopt(const double *guess, double kappa, double *z, double *R, double *work)"
    words = (
        "The orbit with this kappa by Ipopt, from a guess: unknowns z and what is left of the equations, R (UNKNOWNS "
        "entries), which the caller checks. Needs libipopt; not for several threads at once. Returns 0."
    )
    call = Call(prototype, function, ("guess", "&kappa"), ("z", "R"))
    return called("Periodic orbits: Ipopt", call, "IPOPT_WORK", words)
