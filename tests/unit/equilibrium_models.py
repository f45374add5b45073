"""Models whose equilibria and bifurcations are known, for tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin import Branch, OdeModel, find_equilibrium


def symbols(names: str) -> list[ca.SX]:
    return [ca.SX.sym(name) for name in names.split()]


def branch_of(states: str, rhs: Callable[..., Sequence[Any]], guess: Any, to: float, **start: float) -> Branch:
    """Equilibria of x' = rhs(states, parameters), followed in the first of the parameters from its start."""
    x, p = symbols(states), symbols(" ".join(start))
    model = OdeModel("model", ca.vertcat(*x), ca.vertcat(*rhs(*x, *p)), ca.vertcat(*p), nominal=tuple(start.values()))
    branch: Branch = find_equilibrium(model, guess).follow(next(iter(start)), to)
    return branch


def has_points(branch: Branch, known: Sequence[tuple[str, float]], atol: float, rtol: float = 0.0) -> None:
    """The special points of a branch are the known ones, in order, and nothing is unresolved."""
    assert [point.kind for point in branch.special_points] == [kind for kind, _ in known]
    found = [point.parameters[branch.parameter] for point in branch.special_points]
    np.testing.assert_allclose(found, [place for _, place in known], atol=atol, rtol=rtol)
    assert branch.unresolved == ()


def ab() -> OdeModel:
    """The A to B reaction of AUTO-07p's demo `ab`: y = p2 x/(1 + p3), p = x exp(-y)/(1 - x) at rest."""
    x, y, p, p2, p3 = symbols("x y p p2 p3")
    rate = p * (1 - x) * ca.exp(y)
    rhs = ca.vertcat(-x + rate, -y + p2 * rate - p3 * y)
    return OdeModel("ab", ca.vertcat(x, y), rhs, ca.vertcat(p, p2, p3), nominal=(0.0, 14.0, 2.0))


def lorenz() -> OdeModel:
    """Lorenz's model: a pitchfork at r = 1, Hopf points at sigma (sigma + b + 3)/(sigma - b - 1) = 470/19."""
    x, y, z, r = symbols("x y z r")
    rhs = ca.vertcat(10 * (y - x), r * x - y - x * z, x * y - 8 * z / 3)
    return OdeModel("Lorenz", ca.vertcat(x, y, z), rhs, r)


def carbon_monoxide() -> OdeModel:
    """Oxidation of CO on platinum (Bykov, Yablonskii and Kim 1978), `cataloscill` of MatCont's manual."""
    x, y, s, q2, k = symbols("x y s q2 k")
    z = 1 - x - y - s
    rhs = ca.vertcat(5 * z**2 - 2 * x**2 - 10 * x * y, q2 * z - 0.1 * y - 10 * x * y, 0.0675 * (z - k * s))
    return OdeModel("CO oxidation", ca.vertcat(x, y, s), rhs, ca.vertcat(q2, k), nominal=(2.204678, 0.4))


def hopf_pairs(growth: list[ca.SX], p: ca.SX, frequencies: list[float]) -> OdeModel:
    """Uncoupled supercritical Hopf normal forms with given growth rates, in coordinates that mix them."""
    n = len(growth)
    x = ca.SX.sym("x", 2 * n)
    rows = []
    for k, (rate, omega) in enumerate(zip(growth, frequencies, strict=True)):
        u, v = x[2 * k], x[2 * k + 1]
        r2 = u**2 + v**2
        rows += [rate * u - omega * v - r2 * u, omega * u + rate * v - r2 * v]
    return OdeModel("pairs", x, ca.vertcat(*rows), p)


class Brusselator:
    """The Brusselator with diffusion on `m` inner points of (0, 1), held at (A, B/A) at both ends.

    The uniform state loses stability in closed form: pairs with matrix [[B - 1 - d1 mu, A^2], [-B, -A^2 - d2 mu]].
    """

    A, d1, d2 = 2.0, 0.008, 0.004

    def __init__(self, m: int, length: float = 1.0) -> None:
        self.m, self.h = m, length / (m + 1)
        u, v, (B, A) = ca.SX.sym("u", m), ca.SX.sym("v", m), symbols("B A")
        reaction = u**2 * v
        f = A - (B + 1) * u + reaction + self.d1 * self._second(u, A)
        g = B * u - reaction + self.d2 * self._second(v, B / A)
        self.model = OdeModel(
            "Brusselator", ca.vertcat(u, v), ca.vertcat(f, g), ca.vertcat(B, A), nominal=(4.0, self.A)
        )

    def _second(self, u: ca.SX, end: float | ca.SX) -> ca.SX:
        around = ca.vertcat(end, u, end)
        return (around[2:] - 2 * u + around[:-2]) / self.h**2

    def uniform(self, B: float) -> np.ndarray:
        return np.repeat([self.A, B / self.A], self.m)

    def decay(self) -> np.ndarray:
        """Eigenvalues of minus the second difference."""
        return 2.0 * (1.0 - np.cos(np.arange(1, self.m + 1) * np.pi / (self.m + 1))) / self.h**2

    def hopf_values(self, largest: float) -> np.ndarray:
        """B at the Hopf points of the uniform state up to a largest value."""
        mu = self.decay()
        B = 1.0 + self.A**2 + (self.d1 + self.d2) * mu
        det = (B - 1.0 - self.d1 * mu) * (-(self.A**2) - self.d2 * mu) + B * self.A**2
        return np.sort(B[(det > 0.0) & (largest > B)])


def abc() -> OdeModel:
    """The A to B to C reaction of AUTO-07p's demo `abc`, with p1 from 0."""
    u, names = ca.SX.sym("u", 3), [f"p{i}" for i in range(1, 6)]
    p1, p2, p3, p4, p5 = symbols(" ".join(names))
    rate = p1 * ca.exp(u[2])
    first, second = rate * (1 - u[0]), rate * (1 - u[0] - p5 * u[1])
    rhs = ca.vertcat(-u[0] + first, -u[1] + second, -(1 + p3) * u[2] + p4 * rate * (1 - u[0] + p2 * p5 * u[1]))
    return OdeModel("abc", u, rhs, ca.vertcat(p1, p2, p3, p4, p5), nominal=(0.0, 1.0, 1.55, 8.0, 0.04))


def rosenzweig_macarthur() -> OdeModel:
    """Prey x and predators y: their equilibrium at x = 1, y = 2 (1 - 1/K) has its Hopf point at K = 3."""
    x, y, K = symbols("x y K")
    eaten = x * y / (1 + x)
    return OdeModel("prey", ca.vertcat(x, y), ca.vertcat(x * (1 - x / K) - eaten, 2 * eaten - y), K)
