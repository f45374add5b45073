"""Models whose bifurcation diagrams are known."""

import casadi as ca

from casadi_skin import OdeModel


def carbon_monoxide() -> OdeModel:
    """Oxidation of carbon monoxide on platinum: Bykov, Yablonskii and Kim (1978), `cataloscill` of MatCont."""
    x, y, s, q2, k = (ca.SX.sym(name) for name in ("x", "y", "s", "q2", "k"))
    z = 1 - x - y - s
    rhs = ca.vertcat(5 * z**2 - 2 * x**2 - 10 * x * y, q2 * z - 0.1 * y - 10 * x * y, 0.0675 * (z - k * s))
    return OdeModel("CO oxidation", ca.vertcat(x, y, s), rhs, ca.vertcat(q2, k), nominal=(2.204678, 0.4))


def prey_and_predators() -> OdeModel:
    """Rosenzweig and MacArthur (1963): prey x in an environment that carries K of it, predators y that get enough."""
    x, y, K = (ca.SX.sym(name) for name in ("x", "y", "K"))
    eaten = x * y / (1 + x)
    return OdeModel("prey and predators", ca.vertcat(x, y), ca.vertcat(x * (1 - x / K) - eaten, 2 * eaten - y), K)
