"""The forced oscillator of Duffing, q'' + delta q' + q + q^3 = a cos(omega t)."""

import casadi as ca

from casadi_skin import OdeModel

q, v, omega, a, delta, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "a", "delta", "t"))
duffing = OdeModel(
    "Duffing, forced",
    state=ca.vertcat(q, v),
    rhs=ca.vertcat(v, -q - q**3 - delta * v + a * ca.cos(omega * t)),
    parameters=ca.vertcat(omega, a, delta),
    time=t,
    forcing_period=2 * ca.pi / omega,
    half_period=(-1, -1),
)
