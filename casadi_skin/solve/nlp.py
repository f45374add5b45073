"""Nonlinear programs for Ipopt (Waechter and Biegler 2006): solvers are built, and their endings put in words, here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

SOLVED = "Solve_Succeeded"
_NO_POINT = "no point near the guess satisfies conditions and bounds"
_REASONS = {
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
    return _REASONS.get(status, status)
