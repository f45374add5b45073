"""Roessler's model, whose cycles double their periods (Roessler 1976)."""

import casadi as ca

from casadi_skin import OdeModel

x, y, z, a, b, c = (ca.SX.sym(name) for name in "xyzabc")
roessler = OdeModel(
    "Roessler",
    state=ca.vertcat(x, y, z),
    rhs=ca.vertcat(-y - z, x + a * y, b + z * (x - c)),
    parameters=ca.vertcat(a, b, c),
    nominal=(0.2, 0.2, 2.0),
)
