"""Models whose folds, period doublings and tori of orbits are known in closed form."""

from __future__ import annotations

import casadi as ca
from equilibrium_models import symbols

from casadi_skin import OdeModel


def around(rates: tuple[ca.SX, ca.SX], turn: ca.SX, half: bool, names: tuple[ca.SX, ...], p: ca.SX) -> OdeModel:
    """Rates of two coordinates across the circle r = 1 and of its angle, in Cartesian coordinates of three dimensions.

    With `half` the two coordinates turn by half as much as the angle, so that they close after two turns.
    """
    xi, eta, x, y, z = names
    angle = ca.atan2(y, x)
    r = ca.sqrt(x**2 + y**2)
    c, s = (ca.cos(angle / 2), ca.sin(angle / 2)) if half else (ca.SX(1), ca.SX(0))
    u, v = r - 1, z
    inside = [c * u + s * v, -s * u + c * v]  # the coordinates xi, eta of a place
    xi_rate, eta_rate, turn_rate = (ca.substitute(e, ca.vertcat(xi, eta), ca.vertcat(*inside)) for e in (*rates, turn))
    bend = 0.5 * turn_rate if half else 0.0
    r_rate = c * xi_rate - s * eta_rate - bend * v
    z_rate = s * xi_rate + c * eta_rate + bend * u
    rhs = ca.vertcat(r_rate * x / r - turn_rate * y, r_rate * y / r + turn_rate * x, z_rate)
    return OdeModel("around a circle", ca.vertcat(x, y, z), rhs, p)


def doubling(c: float) -> OdeModel:
    """The circle doubles its period at a = 0, with xi' = (a + b) xi + c xi^3, on a band of Moebius."""
    xi, eta, x, y, z, a, b = symbols("xi eta x y z a b")
    rates = ((a + b) * xi + c * xi**3, -eta + 0.3 * xi**2 * eta)
    return around(rates, 1 + 0.7 * xi**2, True, (xi, eta, x, y, z), ca.vertcat(a, b))


def torus(d: float, omega: float) -> OdeModel:
    """The circle loses its stability to a torus at a = 0, with w' = (a + b + i omega) w + d w |w|^2."""
    xi, eta, x, y, z, a, b = symbols("xi eta x y z a b")
    square = xi**2 + eta**2
    growth, turn = a + b + d * square, omega + 0.4 * square
    rates = (growth * xi - turn * eta, turn * xi + growth * eta)
    return around(rates, 1 + 0.7 * square, False, (xi, eta, x, y, z), ca.vertcat(a, b))


def cycles_with_fold() -> OdeModel:
    """r' = r (mu + a r^2 - r^4), angle' = 1: cycles with r^4 - a r^2 = mu, and their fold along mu = -a^2/4, a > 0."""
    x, y, mu, a = symbols("x y mu a")
    square = x**2 + y**2
    growth = mu + a * square - square**2
    return OdeModel("folding cycles", ca.vertcat(x, y), ca.vertcat(growth * x - y, growth * y + x), ca.vertcat(mu, a))
