"""Folds and Hopf points in two parameters and the points of codimension two on them: closed forms, published values."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import Brusselator, ab, branch_of, carbon_monoxide, has_points, hopf_pairs, symbols
from scipy.optimize import fsolve

from casadi_skin import OdeModel, find_equilibrium


def test_the_folds_of_ab_meet_in_the_cusp_in_closed_form() -> None:
    """AUTO-07p's demo `ab`: p2/(1 + p3) x (1 - x) = 1 at a fold, so that they meet at (p, p3) = (exp(-2), 2.5)."""
    fold = find_equilibrium(ab(), [0, 0]).follow("p", 0.25).special_points[0]
    curve = fold.curve("p3", 3.0)
    assert "came back" in curve.reason
    for solution in curve.solutions:
        x, b = solution["x"], 14.0 / (1.0 + solution["p3"])
        assert abs(b * x * (1.0 - x) - 1.0) < 1e-11
        assert abs(solution["p"] - x * np.exp(-b * x) / (1.0 - x)) < 1e-12
    cusp = curve.special_points[-1]
    assert cusp.kind == "cusp"
    assert abs(cusp.parameters["p3"] - 2.5) < 1e-12
    assert abs(cusp.parameters["p"] - np.exp(-2.0)) < 1e-13
    np.testing.assert_array_equal(curve.parameters["p"], [solution["p"] for solution in curve.solutions])


@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("rest", [0.0, 1.0, 1e-4])
def test_states_that_take_no_part_change_no_curve(rate: float, rest: float) -> None:
    """x' = a + b x - x^3, y' = rate (rest - y): one cusp, at a = b = 0, and folds along 27 a^2 = 4 b^3."""
    rates = lambda x, y, a, b: [a + b * x - x**3, rate * (rest - y)]  # noqa: E731
    points = branch_of("x y", rates, [-1.3, rest], 1.0, a=-1.0, b=1.0).special_points
    assert [point.kind for point in points] == ["fold", "fold"]
    assert abs(abs(points[0].coefficient) - np.sqrt(3.0)) < 1e-9  # 3 x with x^2 = 1/3
    curve = points[0].curve("b", -1.0)
    np.testing.assert_allclose(27.0 * curve["a"] ** 2, 4.0 * curve["b"] ** 3, atol=1e-12)
    has_points(curve, [("cusp", 0.0)], 1e-12)
    assert abs(curve.special_points[0].parameters["a"]) < 1e-12


@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e3])
def test_states_that_take_no_part_change_no_curve_of_branch_points(rate: float) -> None:
    """x' = (a - k) x + (k^2 - 1/4) x^3, y' = -rate y: pitchforks along a = k, degenerate where k = 1/2."""
    rates = lambda x, y, a, k: [(a - k) * x + (k**2 - 0.25) * x**3, -rate * y]  # noqa: E731
    (point,) = branch_of("x y", rates, [0.0, 0.0], 1.0, a=-1.0, k=0.0).special_points
    assert point.kind == "branch point"
    curve = point.curve("k", 1.0)
    np.testing.assert_allclose(curve["a"], curve["k"], atol=1e-12)
    has_points(curve, [("degenerate pitchfork", 0.5)], 1e-10)


@pytest.mark.slow
def test_the_bogdanov_takens_point_of_ab_has_trace_and_determinant_zero() -> None:
    fold = find_equilibrium(ab(), [0, 0]).follow("p", 0.25).special_points[0]
    found = fold.curve("p3", 3.0).special_points[0]
    assert found.kind == "bogdanov-takens"

    def conditions(z: np.ndarray) -> list[float]:
        x, p3 = z
        rate = x / (1.0 - x)
        trace = -1.0 - rate + 14.0 * x - 1.0 - p3
        return [trace, (1.0 + rate) * (1.0 + p3 - 14.0 * x) + 14.0 * x * rate]

    x, p3 = fsolve(conditions, [found.solution["x"], found.parameters["p3"]], xtol=1e-14)
    assert abs(found.parameters["p3"] - p3) <= max(found.error, 1e-11)
    assert abs(found.solution["x"] - x) < 1e-10


# (q2, k) in the test `testCO.jl` of BifurcationKit.jl, and the cusp in MatCont's manual, `cataloscill`
CARBON_MONOXIDE = {
    "bogdanov-takens": [(1.161199, 0.722339), (1.417628, 0.971397)],
    "cusp": [(1.006408, 0.355991)],
    "generalized hopf": [(0.8913189828755895, 0.23248736), (0.924255, 0.305879)],
}


@pytest.mark.slow
def test_carbon_monoxide_has_the_points_that_are_published() -> None:
    """The two-parameter diagram of CO oxidation; the Bogdanov-Takens points also against their conditions."""
    hopf, fold, _, last = (
        find_equilibrium(carbon_monoxide(), [0.001137, 0.891483, 0.062345]).follow("q2", 0.5).special_points
    )
    up, round_the_cusp = (fold.curve("k", to, back_to=back).special_points for to, back in ((3.0, None), (0.01, 3.0)))
    down = hopf.curve("k", 0.01).special_points
    found = {kind: [point for point in (*up, *round_the_cusp, *down) if point.kind == kind] for kind in CARBON_MONOXIDE}
    for kind, published in CARBON_MONOXIDE.items():
        places = sorted((point.parameters["q2"], point.parameters["k"]) for point in found[kind])
        np.testing.assert_allclose(places, published, rtol=1.5e-6, err_msg=kind)
    for point in found["generalized hopf"]:
        assert point.criticality == "degenerate"
        assert abs(point.coefficient) < 1e-9
    ends = [start.curve("k", 3.0).special_points[-1] for start in (hopf, last)]
    for end, point in zip(ends, found["bogdanov-takens"], strict=True):
        for name in ("q2", "k"):
            assert abs(end.parameters[name] - point.parameters[name]) <= end.error + point.error
        exact = _where(carbon_monoxide(), point, lambda c: [c[0], c[1]])
        np.testing.assert_allclose([point.parameters["q2"], point.parameters["k"]], exact, rtol=1e-10)


def _where(model: OdeModel, point, conditions) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Parameters at which coefficients of the characteristic polynomial, from the constant on, satisfy conditions."""
    f = ca.Function("f", [model.state, model.parameters], [model.rhs, ca.jacobian(model.rhs, model.state)])

    def residual(z: np.ndarray) -> np.ndarray:
        value, matrix = (np.array(r) for r in f(z[:3], z[3:]))
        return np.concatenate([value.ravel(), conditions(np.poly(matrix)[::-1])])

    start = [*point.solution.state, point.parameters["q2"], point.parameters["k"]]
    return np.asarray(fsolve(residual, start, xtol=1e-14))[3:]


def test_the_bogdanov_takens_normal_form_in_closed_form() -> None:
    """x' = y, y' = b1 + b2 x + x^2 - x y: folds at b1 = b2^2/4, Hopf points at b1 = 0 for b2 < 0, both end at 0."""
    rates = lambda x, y, b1, b2: [y, b1 + b2 * x + x**2 - x * y]  # noqa: E731
    hopf, fold = branch_of("x y", rates, [-0.37, 0.0], 0.5, b1=-0.5, b2=-1.0).special_points
    assert (hopf.kind, fold.kind) == ("hopf", "fold")
    curve, folds = (point.curve("b2", 1.0) for point in (hopf, fold))
    np.testing.assert_allclose(curve["b1"], 0.0, atol=1e-12)
    assert "end at a Bogdanov-Takens point" in curve.reason
    np.testing.assert_allclose(folds["b1"], folds["b2"] ** 2 / 4.0, atol=1e-12)
    assert folds.complete
    for one in (curve, folds):
        has_points(one, [("bogdanov-takens", 0.0)], 1e-9)


@pytest.mark.slow
def test_hopf_hopf_and_zero_hopf_points_in_closed_form() -> None:
    p, q = ca.SX.sym("p"), ca.SX.sym("q")
    both = hopf_pairs([p, p - q], ca.vertcat(p, q), [1.0, 1.7])
    hopf = find_equilibrium(both, np.zeros(4), parameters={"p": -1.0, "q": 0.5}).follow("p", 0.25).special_points[0]
    has_points(hopf.curve("q", -0.5), [("hopf-hopf", 0.0)], 1e-10)

    def rates(x: Any, u: Any, v: Any, p: Any, q: Any) -> list[Any]:
        r2 = u**2 + v**2
        growth = q + x - r2
        return [p + x**2 - r2, growth * u - 1.3 * v, 1.3 * u + growth * v]

    points = branch_of("x u v", rates, [-1.0, 0.0, 0.0], 0.5, p=-1.0, q=0.5).special_points
    assert [point.kind for point in points] == ["hopf", "fold"]
    for start, beyond in zip(points, ([("generalized hopf", -0.5)], []), strict=True):
        curve = start.curve("q", -0.5)  # l1 is a multiple of 1/(2 x) - 1, and x = -q
        has_points(curve, [("zero-hopf", 0.0), *beyond], 1e-9)
        assert abs(curve.special_points[0].parameters["p"]) < 1e-9


def lorenz(x: Any, y: Any, z: Any, r: Any, s: Any) -> list[Any]:
    return [s * (y - x), r * x - y - x * z, x * y - 8 * z / 3]


@pytest.mark.slow
def test_the_hopf_curve_of_lorenz_in_closed_form() -> None:
    """r = s (s + b + 3)/(s - b - 1), with b = 8/3, in s from 10 to 20."""
    (hopf,) = branch_of("x y z", lorenz, [6.0, 6.0, 13.0], 30.0, r=14.0, s=10.0).special_points
    curve = hopf.curve("s", 20.0, at=[15.0])
    s_, b = curve["s"], 8.0 / 3.0
    np.testing.assert_allclose(curve["r"], s_ * (s_ + b + 3.0) / (s_ - b - 1.0), rtol=1e-11)
    assert curve.at(s=15.0)["r"] == pytest.approx(15.0 * (18.0 + b) / (14.0 - b), rel=1e-12)


@pytest.mark.slow
def test_a_hopf_curve_of_a_large_model_is_that_in_closed_form() -> None:
    """128 components, 387 unknowns: B = 1 + A^2 + (d1 + d2) mu_1 for the uniform state of the Brusselator."""
    problem = Brusselator(64)
    branch = find_equilibrium(problem.model, problem.uniform(4.0)).follow("B", 5.5)
    curve = branch.special_points[0].curve("A", 2.4)
    exact = 1.0 + curve["A"] ** 2 + (problem.d1 + problem.d2) * problem.decay()[0]
    assert curve.complete
    np.testing.assert_allclose(curve["B"], exact, rtol=1e-10)


def test_curves_are_refused_in_one_line() -> None:
    branch = find_equilibrium(ab(), [0, 0]).follow("p", 0.25)
    fold = branch.special_points[0]
    with pytest.raises(ValueError, match="parameter: given 'p', in which the fold was found; accepted: p2, p3"):
        fold.curve("p", 1.0)
    with pytest.raises(ValueError, match="parameter: given 'q'"):
        fold.curve("q", 1.0)
    with pytest.raises(ValueError, match="follow: given a fold, where the equations at a held p2 are singular"):
        fold.curve("p3", 2.1).solutions[-1].follow("p2", 13.0)
    (point,) = branch_of("x", lambda x, p, q: [p * x - x**2 + q], [0.0], 1.0, p=-1.0, q=0.0).special_points
    with pytest.raises(ArithmeticError, match="the branch point is none at other values of q"):
        point.curve("q", 1.0)


@pytest.mark.slow
def test_branch_points_that_a_symmetry_keeps_are_followed_in_closed_form() -> None:
    """Lorenz's pitchfork at r = 1 for any sigma; x'' = p x + q x' - x^3 - x^2 x'."""
    (pitchfork,) = branch_of("x y z", lorenz, [0.0, 0.0, 0.0], 2.0, r=0.5, s=10.0).special_points
    curve = pitchfork.curve("s", 20.0)
    assert curve.complete
    np.testing.assert_allclose(curve["r"], 1.0, rtol=1e-12)
    rates = lambda x, y, p, q: [y, p * x + q * y - x**3 - x**2 * y]  # noqa: E731
    (pitchfork,) = branch_of("x y", rates, [0.0, 0.0], 1.0, p=-1.0, q=-1.0).special_points
    curve = pitchfork.curve("q", 1.0)
    np.testing.assert_allclose(curve["p"], 0.0, atol=1e-12)
    has_points(curve, [("bogdanov-takens", 0.0)], 1e-9)


@pytest.mark.slow
def test_a_hopf_curve_goes_on_where_its_plane_turns_by_a_right_angle() -> None:
    """The pair p +- i in a plane that turns by 180 degrees for q from 0 to 1: at p = 0 for every q."""
    p, q, x = ca.SX.sym("p"), ca.SX.sym("q"), ca.SX.sym("x", 4)
    c, s = ca.cos(np.pi * q), ca.sin(np.pi * q)
    one, zero = ca.SX.eye(2), ca.SX(2, 2)
    turned = ca.vertcat(ca.horzcat(c * one, -s * one), ca.horzcat(s * one, c * one))
    pair, damped = ca.vertcat(ca.horzcat(p, -1), ca.horzcat(1, p)), ca.DM([[-1.0, -0.3], [0.2, -2.0]])
    matrix = ca.vertcat(ca.horzcat(pair, zero), ca.horzcat(zero, damped))
    rhs = turned @ matrix @ turned.T @ x - ca.dot(x, x) * x
    model = OdeModel("turning", x, rhs, ca.vertcat(p, q), nominal=(-1.0, 0.0))
    (hopf,) = find_equilibrium(model, np.zeros(4)).follow("p", 0.5).special_points
    curve = hopf.curve("q", 1.0)
    assert curve.complete
    np.testing.assert_allclose(curve["p"], 0.0, atol=1e-13)


def test_a_coefficient_that_is_not_computed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cusp of folds, which the coefficient finds, without it."""
    x, p, a = symbols("x p a")
    model = OdeModel("cubic", x, p - a * x + x**3, ca.vertcat(p, a), nominal=(3.0, 1.2))
    fold = find_equilibrium(model, [-2.0]).follow("p", -3.0).special_points[0]
    assert [point.kind for point in fold.curve("a", -1.0).special_points] == ["cusp"]

    def none(*_: Any) -> None:
        raise RuntimeError("no second\nderivatives")

    monkeypatch.setattr("casadi_skin.follow.codimension_two.quadratic_term", none)
    curve = fold.curve("a", -1.0)
    assert not curve.special_points
    assert {(gap.kind, gap.reason) for gap in curve.unresolved} == {
        ("cusp", "the coefficient of the normal form is not computed: no second derivatives")
    }
