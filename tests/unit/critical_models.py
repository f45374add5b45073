"""Models whose folds, period doublings and tori of orbits are known in closed form."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
from equilibrium_models import symbols

from casadi_skin import OdeModel

Rates = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], tuple[ca.SX, ca.SX]]


def across_circle(rates: Rates, half: bool) -> OdeModel:
    """Rates f(xi, eta, a, k) of two coordinates across the circle r = 1, in Cartesian coordinates of three dimensions.

    The circle is run through with the rate 1 + 0.7 xi^2. With `half` the coordinates turn by half as much, so that they
    close after two turns, as on a band of Moebius.
    """
    x, y, z, a, k = symbols("x y z a k")
    angle, r = ca.atan2(y, x), ca.sqrt(x**2 + y**2)
    c, s = (ca.cos(angle / 2), ca.sin(angle / 2)) if half else (1.0, 0.0)
    u, v = r - 1, z
    xi, eta = c * u + s * v, -s * u + c * v
    xi_rate, eta_rate = rates(xi, eta, a, k)
    turn = 1 + 0.7 * xi**2
    bend = turn / 2 if half else 0.0
    r_rate, z_rate = c * xi_rate - s * eta_rate - bend * v, s * xi_rate + c * eta_rate + bend * u
    rhs = ca.vertcat(r_rate * x / r - turn * y, r_rate * y / r + turn * x, z_rate)
    return OdeModel("across a circle", ca.vertcat(x, y, z), rhs, ca.vertcat(a, k))


def cycles_with_fold() -> OdeModel:
    """r' = r (mu + a r^2 - r^4), angle' = 1: cycles with r^4 - a r^2 = mu, and their fold along mu = -a^2/4, a > 0."""
    x, y, mu, a = symbols("x y mu a")
    square = x**2 + y**2
    growth = mu + a * square - square**2
    return OdeModel("folding cycles", ca.vertcat(x, y), ca.vertcat(growth * x - y, growth * y + x), ca.vertcat(mu, a))
