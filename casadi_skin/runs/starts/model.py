"""My model: the oscillator of van der Pol, x' = y, y' = mu (1 - x^2) y - x. Put your own equations in its place."""

import casadi as ca

from casadi_skin import OdeModel

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
my_model = OdeModel("van der Pol", state=ca.vertcat(x, y), rhs=ca.vertcat(y, mu * (1 - x**2) * y - x), parameters=mu)
