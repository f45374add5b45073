"""A slab that heats itself: u'' + lambda exp(u / (1 + eps u)) = 0 with u = 0 on both faces (Gelfand's problem)."""

import casadi as ca

from casadi_skin import BoundaryValueProblem, OdeModel

u, v, lam, eps = (ca.SX.sym(name) for name in ("u", "v", "lambda", "eps"))
slab = OdeModel("heated slab", ca.vertcat(u, v), ca.vertcat(v, -lam * ca.exp(u / (1 + eps * u))), ca.vertcat(lam, eps))
ignition = BoundaryValueProblem(slab, [slab.start(u), slab.end(u)], parameters={"lambda": 1.0, "eps": 0.2})
