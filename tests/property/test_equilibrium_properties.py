"""Random equations whose folds and Hopf points are roots of polynomials: none is missed, and errors hold."""

from __future__ import annotations

import casadi as ca
import numpy as np
from effort import examples
from hypothesis import assume, given
from hypothesis import strategies as st

from casadi_skin import OdeModel, find_equilibrium

REACH = 3.0
roots = st.lists(st.floats(-1.8, 1.8), min_size=2, max_size=6).filter(lambda values: len(values) % 2 == 0)


@examples(60, deadline=None)
@given(roots)
def test_every_fold_of_a_random_curve_is_found(values: list[float]) -> None:
    """x' = p - f(x) with f' = prod (x - r_k): folds at each r_k, in the order along x."""
    values = sorted(values)
    assume(min(np.diff(values)) > 2e-3)
    f = np.polynomial.Polynomial.fromroots(values).integ()
    inside = f(np.array(values))
    assume(f(-REACH) < inside.min() - 0.1)
    assume(f(REACH) > inside.max() + 0.1)
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    polynomial = sum(float(c) * x**k for k, c in enumerate(f.coef))
    start = find_equilibrium(OdeModel("random", x, p - polynomial, p), [-REACH], parameters={"p": float(f(-REACH))})
    branch = start.follow("p", float(f(REACH)))
    assert branch.complete
    assert [point.kind for point in branch.special_points] == ["fold"] * len(values)
    for point, root in zip(branch.special_points, values, strict=True):
        assert abs(point.parameters["p"] - f(root)) <= 10.0 * point.error + 1e-13 * (1.0 + abs(f(root)))


@examples(60, deadline=None)
@given(roots, st.floats(0.3, 30.0))
def test_every_crossing_of_a_pair_is_found(values: list[float], omega: float) -> None:
    """The growth rate of a pair is prod (p - r_k): Hopf points at each r_k, with the frequency of the pair."""
    values = sorted(values)
    assume(min(np.diff(values)) > 2e-3)
    u, v, p = (ca.SX.sym(name) for name in "uvp")
    growth = 1.0
    for root in values:
        growth = growth * (p - root)
    r2 = u**2 + v**2
    rhs = ca.vertcat((growth - r2) * u - omega * v, omega * u + (growth - r2) * v)
    start = find_equilibrium(OdeModel("pair", ca.vertcat(u, v), rhs, p), [0.0, 0.0], parameters={"p": -2.0})
    points = start.follow("p", 2.0).special_points
    assert [point.kind for point in points] == ["hopf"] * len(values)
    np.testing.assert_allclose([point.parameters["p"] for point in points], values, atol=1e-9)
    np.testing.assert_allclose([point.frequency for point in points], omega, rtol=1e-9)
    assert {point.criticality for point in points} == {"supercritical"}
