"""The oscillator of van der Pol, x'' - mu (1 - x^2) x' + x = 0, as a model of first order."""

import casadi as ca

from casadi_skin import OdeModel

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
van_der_pol = OdeModel(
    "van der Pol",
    state=ca.vertcat(x, y),
    rhs=ca.vertcat(y, mu * (1 - x**2) * y - x),
    parameters=mu,
    half_period=(-1, -1),
)
