"""Points of codimension two on curves of branch points of all models, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from critical_models import across_circle
from equilibrium_models import symbols

from casadi_skin import BoundaryValueProblem, Branch, OdeModel, find_equilibrium, find_orbit

PITCHFORK, TRANSCRITICAL, DOUBLE = "degenerate pitchfork", "degenerate transcritical", "double branch point"


def on_curve(curve: Branch, known: dict[str, float], largest: float = 1e-9) -> None:
    """The special points of a curve are the known ones, within errors that are small."""
    assert curve.complete
    assert [point.kind for point in curve.special_points] == list(known)
    for point, value in zip(curve.special_points, known.values(), strict=True):
        assert abs(point.parameters[curve.parameter] - value) <= 3.0 * point.error + 1e-16 < largest


def of_equilibria(rhs: Callable[..., list[ca.SX]], size: int, q: float, to: float = 1.0) -> Branch:
    """The curve in q from the first branch point in p of the equilibrium at zero."""
    x, p, k = ca.SX.sym("x", size), *symbols("p q")
    model = OdeModel("branching", x, ca.vertcat(*rhs(p, k, *ca.vertsplit(x))), ca.vertcat(p, k))
    start = find_equilibrium(model, np.zeros(size), parameters={"p": -1.0, "q": q})
    curve: Branch = start.follow("p", 1.0).special_points[0].curve("q", to)
    return curve


@pytest.mark.slow
def test_the_coefficients_of_the_branching_equation_of_equilibria_vanish() -> None:
    """x' = (p - q) x + (q - 0.3) x^3 - x^5; the same with a square; y = x^2, which adds q to -0.2."""
    cubic = of_equilibria(lambda p, q, x: [(p - q) * x + (q - 0.3) * x**3 - x**5], 1, -0.5)
    on_curve(cubic, {PITCHFORK: 0.3})
    np.testing.assert_allclose(cubic["p"], cubic["q"], rtol=0, atol=1e-12)
    on_curve(of_equilibria(lambda p, q, x: [(p - q) * x + (q - 0.3) * x**2 - x**3], 1, -0.5), {TRANSCRITICAL: 0.3})
    slaved = of_equilibria(lambda p, q, x, y: [p * x + q * x * y - 0.2 * x**3, x**2 - y], 2, -0.5)
    on_curve(slaved, {PITCHFORK: 0.2})


@pytest.mark.slow
def test_two_zero_eigenvalues_of_a_branch_point_are_told_apart_by_their_eigenvectors() -> None:
    """Growth rates p - q and p - 1 + q are zero together; x'' = p x + (q - 0.5) x' has a Jordan block."""
    two = of_equilibria(lambda p, q, x, y: [(p - q) * x - x**3, (p - 1 + q) * y - y**3 - x * y**2], 2, 0.2, 0.9)
    on_curve(two, {DOUBLE: 0.5})
    one = of_equilibria(lambda p, q, x, y: [y, p * x + (q - 0.5) * y + (q - 0.7) * x**3 - x**2 * y - x**5], 2, 0.1)
    on_curve(one, {"bogdanov-takens": 0.5, PITCHFORK: 0.7})


def of_orbits(model: OdeModel, k: float, to: float) -> Branch:
    """The curve in k from the first branch point in a of the orbits on the circle r = 1."""
    others = len(model.state_names) - 2
    guess = lambda t: [np.cos(t), np.sin(t), *[0.0] * others]  # noqa: E731
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"a": -0.3, "k": k}, corrector="newton")
    curve: Branch = orbit.follow("a", 0.7, stability=True).special_points[0].curve("k", to)
    return curve


def beside_circle(names: str, rates: Callable[..., list[ca.SX]]) -> OdeModel:
    """Cycles r = 1 with coordinates that do not act on them."""
    x, y, a, k = symbols("x y a k")
    others = symbols(names)
    growth = 1 - x**2 - y**2
    rhs = ca.vertcat(growth * x - y, growth * y + x, *rates(a, k, *others))
    return OdeModel("beside a circle", ca.vertcat(x, y, *others), rhs, ca.vertcat(a, k))


def test_a_pitchfork_of_cycles_changes_its_side() -> None:
    """eta' = a eta + k xi eta - 0.2 eta^3 with xi' = -xi + eta^2: c = k - 0.2 on the invariant curve xi = eta^2."""
    rates = lambda xi, eta, a, k: (-xi + eta**2, a * eta + k * xi * eta - 0.2 * eta**3 - eta**5)  # noqa: E731
    on_curve(of_orbits(across_circle(rates, half=False), -0.1, 0.4), {PITCHFORK: 0.2})


@pytest.mark.slow
def test_the_fold_of_the_other_cycles_comes_to_the_branch_point() -> None:
    rates = lambda xi, eta, a, k: (-xi + 0.3 * xi * eta**2, eta * (a - 0.3 + k * eta - eta**2))  # noqa: E731
    on_curve(of_orbits(across_circle(rates, half=False), -0.1, 0.2), {TRANSCRITICAL: 0.0})


@pytest.mark.slow
def test_other_multipliers_at_branch_points_of_cycles_are_named() -> None:
    """One at 1 with the same eigenvector or one of its own; a pair on the unit circle; one at -1 by half a turn."""
    jordan = beside_circle("z w", lambda a, k, z, w: [w, a * z + k * w - z**3 - z**2 * w])
    on_curve(of_orbits(jordan, -0.2, 0.3), {"1:1 resonance": 0.0})
    two = beside_circle("z w", lambda a, k, z, w: [(a - k) * z - z**3, (a - 1 + k) * w - w**3 - z * w**2])
    on_curve(of_orbits(two, 0.2, 0.8), {DOUBLE: 0.5}, largest=1e-6)

    def turning(a: ca.SX, k: ca.SX, z: ca.SX, u: ca.SX, v: ca.SX) -> list[ca.SX]:
        growth = a - 0.5 - u**2 - v**2
        return [(a - k) * z - z**3, growth * u - 0.3 * v, 0.3 * u + growth * v]

    on_curve(of_orbits(beside_circle("z u v", turning), 0.2, 0.8), {"fold-torus": 0.5})
    x, y, z, u, v, a, k = symbols("x y z u v a k")
    growth, angle = 1 - x**2 - y**2, ca.atan2(y, x)
    c, s = ca.cos(angle / 2), ca.sin(angle / 2)
    xi, eta = c * u + s * v, c * v - s * u
    rates = ((a - 0.5) * xi - xi**3, -eta)
    half = [c * rates[0] - s * rates[1] - v / 2, s * rates[0] + c * rates[1] + u / 2]
    rhs = ca.vertcat(growth * x - y, growth * y + x, (a - k) * z - z**3, *half)
    model = OdeModel("branching and flip", ca.vertcat(x, y, z, u, v), rhs, ca.vertcat(a, k))
    on_curve(of_orbits(model, 0.2, 0.8), {"fold-flip": 0.5})


def column(rhs: Callable[..., ca.SX], end: Callable[..., ca.SX] | None = None) -> Any:
    """The first branch point in lam of u = 0 on the unit interval, from q = -0.5."""
    u, v, lam, q = symbols("u v lam q")
    model = OdeModel("column", ca.vertcat(u, v), ca.vertcat(v, rhs(u, lam, q)), ca.vertcat(lam, q))
    last = model.end(u) if end is None else end(model.end(u), model.end(v), q)
    problem = BoundaryValueProblem(model, [model.start(u), last], parameters={"lam": 5.0, "q": -0.5})
    return problem.solve([0.0, 0.0]).follow("lam", 12.0).special_points[0]


def test_a_column_that_stiffens_buckles_to_the_other_side_from_a_known_stiffness_on() -> None:
    """u'' + lam sin(u) + q u^3 = 0 has the cubic term pi^2/6 - q at lam = pi^2: as -lam/6 + q is that of its force."""
    curve = column(lambda u, lam, q: -lam * ca.sin(u) - q * u**3).curve("q", 2.0)
    on_curve(curve, {PITCHFORK: np.pi**2 / 6.0})


@pytest.mark.slow
def test_squares_and_conditions_that_are_not_linear_enter_the_branching_equation() -> None:
    square = column(lambda u, lam, q: -lam * u - (q - 0.3) * u**2 + u**3)
    on_curve(square.curve("q", 1.0), {TRANSCRITICAL: 0.3})
    for power, kind in ((3, PITCHFORK), (2, TRANSCRITICAL)):
        at_end = column(lambda u, lam, q: -lam * u, lambda u, v, q, n=power: u + (q - 0.3) * v**n + v ** (2 * n - 1))
        on_curve(at_end.curve("q", 1.0), {kind: 0.3})


@pytest.mark.slow
def test_branch_points_that_conditions_alone_decide_are_followed() -> None:
    """(p - q^2) x - (1 + q) x^3 = 0 at the start of a constant, and with -q x^2 - x^3: p = q^2, at q = -1 and 0."""
    x, y, p, q = symbols("x y p q")
    model = OdeModel("conditions", ca.vertcat(x, y), ca.vertcat(0, -y), ca.vertcat(p, q), nominal=(-1.0, 0.5))
    X, Y = model.start(x), model.start(y)
    cubic, square = (p - q**2) * X - (1 + q) * X**3, (p - q**2) * X - q * X**2 - X**3
    for condition, known in ((cubic, {PITCHFORK: -1.0}), (square, {TRANSCRITICAL: 0.0})):
        problem = BoundaryValueProblem(model, [condition, Y - 1 - X**2], parameters={"p": -1.0})
        branch = problem.solve([0.0, 1.0]).follow("p", 1.0)
        (point,) = branch.special_points
        assert abs(point.parameters["p"] - 0.25) <= 3.0 * point.error < 1e-12
        curve = point.curve("q", -2.0, max_step=1.0)
        on_curve(curve, known)
        np.testing.assert_allclose(curve["p"], curve["q"] ** 2, rtol=0, atol=1e-8)
