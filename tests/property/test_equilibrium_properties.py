"""Random equations whose folds and Hopf points are roots of polynomials: none is missed, and errors hold.

Whatever the steps and the tolerance are, the list is the same. Roots are 0.002 apart or more on a way of 4 to 6, and
the polynomial is 1e-11 or more between them: less is what rounding leaves of the rate of the parameter.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from effort import examples
from hypothesis import assume, example, given
from hypothesis import strategies as st

from casadi_skin import OdeModel, find_equilibrium, find_orbit

REACH = 3.0
TOLD_APART = 1e-11
roots = st.lists(st.floats(-1.8, 1.8), min_size=2, max_size=6).filter(lambda values: len(values) % 2 == 0)
tolerances, steps = st.sampled_from([1e-12, 1e-10, 1e-6, 1e-3]), st.sampled_from([0.05, 0.2, 1.0, 5.0])
PAIR_IN_A_STEP = [-1.59375, -1.0, -0.9375, 0.0625]
PAIR_BESIDE_AN_END = [0.03890460295496209, 0.04120420349699971, 0.8028653461319035, 0.8163946373925086]
THREE_PAIRS = [-0.1171875, -0.046875, 0.1875, 0.328125, 0.3359375, 0.4453125]


def polynomial_of(values: list[float]) -> np.polynomial.Polynomial:
    """The polynomial with these roots, which are far enough apart to be told apart."""
    assume(min(np.diff(values)) > 2e-3)
    polynomial = np.polynomial.Polynomial.fromroots(values)
    assume(min(abs(polynomial(polynomial.deriv().roots().real))) > TOLD_APART)
    return polynomial


def product(symbol: ca.SX, values: list[float]) -> ca.SX:
    found = ca.SX(1.0)
    for root in values:
        found = found * (symbol - root)
    return found


@examples(20, deadline=None)
@given(roots, tolerances, steps)
@example(PAIR_IN_A_STEP, 1e-10, 0.2)
@example(PAIR_BESIDE_AN_END, 1e-6, 0.2)
@example(THREE_PAIRS, 1e-10, 1.0)
def test_every_fold_of_a_random_curve_is_found(values: list[float], tolerance: float, max_step: float) -> None:
    """x' = p - f(x) with f' = prod (x - r_k): folds at each r_k, in the order along x."""
    values = sorted(values)
    f = polynomial_of(values).integ()
    inside = f(np.array(values))
    assume(f(-REACH) < inside.min() - 0.1)
    assume(f(REACH) > inside.max() + 0.1)
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    polynomial = sum(float(c) * x**k for k, c in enumerate(f.coef))
    model = OdeModel("random", x, p - polynomial, p)
    start = find_equilibrium(model, [-REACH], parameters={"p": float(f(-REACH))}, tolerance=tolerance)
    branch = start.follow("p", float(f(REACH)), max_step=max_step, max_points=2000)
    assert branch.complete
    assert [point.kind for point in branch.special_points] == ["fold"] * len(values)
    for point, root in zip(branch.special_points, values, strict=True):
        assert abs(point.parameters["p"] - f(root)) <= 10.0 * point.error + 1e-13 * (1.0 + abs(f(root)))


@pytest.mark.parametrize("kind", ["hopf", "branch point"])
@examples(20, deadline=None)
@given(roots, st.floats(0.3, 30.0), tolerances, steps)
@example(PAIR_IN_A_STEP, 1.0, 1e-10, 0.2)
def test_every_crossing_of_the_axis_is_found(
    kind: str, values: list[float], omega: float, tolerance: float, max_step: float
) -> None:
    """With g = prod (p - r_k) the growth rate of a pair, or x = g(p) crossing x = 0, for whatever it is there."""
    values = sorted(values)
    polynomial_of(values)
    u, v, p = (ca.SX.sym(name) for name in "uvp")
    g = product(p, values)
    r2 = u**2 + v**2
    pair = [(g - r2) * u - omega * v, omega * u + (g - r2) * v]
    x, rhs = (ca.vertcat(u, v), pair) if kind == "hopf" else (u, [u * (g - u)])
    model = OdeModel("crossing", x, ca.vertcat(*rhs), p)
    start = find_equilibrium(model, np.zeros(len(rhs)), parameters={"p": -2.0}, tolerance=tolerance)
    points = start.follow("p", 2.0, max_step=max_step).special_points
    assert [point.kind for point in points] == [kind] * len(values)
    np.testing.assert_allclose([point.parameters["p"] for point in points], values, atol=1e-9)
    if kind == "hopf":
        np.testing.assert_allclose([point.frequency for point in points], omega, rtol=1e-9)
        assert {point.criticality for point in points} == {"supercritical"}


@pytest.mark.slow
@pytest.mark.parametrize("max_step", [0.05, 0.6])
@pytest.mark.parametrize("values", [[1.0, 1.05, 2.5, 2.52], [0.8, 1.0, 2.0, 2.05]])
def test_every_fold_of_cycles_is_found(values: list[float], max_step: float) -> None:
    """z' = (p - f(|z|^2) + i) z with f' = prod (q - r_k): circles of radius sqrt(q), with folds at each q = r_k."""
    f = np.polynomial.Polynomial.fromroots(values).integ()
    u, v, p = (ca.SX.sym(name) for name in "uvp")
    growth = p - sum(float(c) * (u**2 + v**2) ** k for k, c in enumerate(f.coef))
    model = OdeModel("circles", ca.vertcat(u, v), ca.vertcat(growth * u - v, u + growth * v), p)
    r, end = 0.3**0.5, float(f(4.5))
    circle = find_orbit(model, lambda t: [r * np.cos(t), r * np.sin(t)], 2 * np.pi, parameters={"p": float(f(0.3))})
    points = circle.follow("p", end, max_step=max_step).special_points
    assert [point.kind for point in points] == ["fold"] * len(values)
    np.testing.assert_allclose([point.parameters["p"] for point in points], f(np.array(values)), atol=1e-7)


@pytest.mark.slow
def test_an_isola_of_cycles_is_walked_once_and_reported_as_closed() -> None:
    """z' = (1/4 - (|z|^2 - 2)^2 - p^2 + i) z: circles of radius sqrt(q), with (q - 2)^2 + p^2 = 1/4."""
    u, v, p = (ca.SX.sym(name) for name in "uvp")
    growth = 0.25 - (u**2 + v**2 - 2) ** 2 - p**2
    model = OdeModel("isola", ca.vertcat(u, v), ca.vertcat(growth * u - v, u + growth * v), p)
    r = 2.4**0.5
    start = find_orbit(model, lambda t: [r * np.cos(t), r * np.sin(t)], 2 * np.pi, parameters={"p": 0.3})
    branch = start.follow("p", 2.0, back_to=-2.0)
    assert branch.complete
    assert "closed" in branch.reason
    np.testing.assert_allclose([point.parameters["p"] for point in branch.special_points], [0.5, -0.5], atol=1e-8)


@pytest.mark.slow
@examples(3, deadline=None)
@given(roots, steps)
@example(PAIR_IN_A_STEP, 0.2)
@example(THREE_PAIRS, 1.0)
def test_every_point_on_a_curve_of_hopf_points_is_found(values: list[float], max_step: float) -> None:
    """Two pairs: growth p + g(q) r^2 - r^4 and g(q + 1/8), g = prod (q - r_k): degenerate, and both, on p = 0."""
    values = sorted(values)
    polynomial_of(values)
    x = ca.SX.sym("x", 4)
    p, q = ca.SX.sym("p"), ca.SX.sym("q")
    g, h = product(q, values), product(q + 0.125, values)
    r2, s2 = x[0] ** 2 + x[1] ** 2, x[2] ** 2 + x[3] ** 2
    a, b = p + g * r2 - r2**2, h - s2
    rhs = ca.vertcat(a * x[0] - x[1], x[0] + a * x[1], b * x[2] - 2 * x[3], 2 * x[2] + b * x[3])
    model = OdeModel("two pairs", x, rhs, ca.vertcat(p, q))
    (hopf,) = find_equilibrium(model, np.zeros(4), parameters={"p": -1.0, "q": -2.2}).follow("p", 1.0).special_points
    points = hopf.curve("q", 2.2, max_step=max_step).special_points
    for kind, places in (("generalized hopf", values), ("hopf-hopf", [root - 0.125 for root in values])):
        found = [point.parameters["q"] for point in points if point.kind == kind]
        np.testing.assert_allclose(found, places, atol=1e-8, err_msg=kind)
    assert len(points) == 2 * len(values)
