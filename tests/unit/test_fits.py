"""Parameters from measured diagrams: planted ones are found again, deviations are calibrated; what is refused."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import ab, symbols

from casadi_skin import Chain, OdeModel, find_equilibrium, find_orbit, fit_parameters, follow_family

PLANTED = {"p2": 14.1, "p3": 1.95}


def reaction(**parameters: float) -> Any:
    """The special points of a reaction in p: two Hopf points and two folds."""
    return find_equilibrium(ab(), [0, 0], parameters={"p": 0.0, **parameters}).follow("p", 0.2).special_points


def cubic(a: float, b: float) -> Any:
    """The folds of x' = p - a x + b x^3, at p = -+ (2/3) a sqrt(a/(3 b))."""
    x, p, one, two = symbols("x p a b")
    model = OdeModel("cubic", x, p - one * x + two * x**3, ca.vertcat(p, one, two))
    start = find_equilibrium(model, [-2.0], parameters={"p": 10.0, "a": a, "b": b})
    return [point for point in start.follow("p", -5.0).special_points if point.kind == "fold"]


def circle(mu: float, w: float) -> Any:
    """The cycle of radius sqrt(mu) and period 2 pi/w."""
    x, y, one, two = symbols("x y mu w")
    growth = one - x**2 - y**2
    rates = ca.vertcat(growth * x - two * y, two * x + growth * y)
    model = OdeModel("circle", ca.vertcat(x, y), rates, ca.vertcat(one, two))
    guess = lambda t: np.sqrt(mu) * np.array([np.cos(w * t), np.sin(w * t)])  # noqa: E731
    return find_orbit(model, guess, 2 * np.pi / w, parameters={"mu": mu, "w": w}, tolerance=1e-8)


def test_planted_parameters_are_found_again() -> None:
    start, planted = reaction(), reaction(**PLANTED)
    assert len(start) == len(planted) > 2
    pairs = list(zip(start, planted, strict=True))
    fit = fit_parameters([(a, b.parameters["p"], 1e-4) for a, b in pairs], over=["p2", "p3"])
    assert fit.found
    assert fit.values == pytest.approx(PLANTED, rel=1e-9)
    for point, (_, there) in zip(fit.located, pairs, strict=True):
        assert point.kind == there.kind
        assert point.parameters == pytest.approx(there.parameters, rel=1e-9)
    J = np.array([[point.gradient()[name] for name in PLANTED] for point in planted]) / 1e-4
    covariance = np.linalg.inv(J.T @ J)
    assert list(fit.deviations.values()) == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)
    both = np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert fit.correlation == pytest.approx(np.array([[1, covariance[0, 1] / both], [covariance[1, 0] / both, 1]]))
    assert fit.chi_square < 1e-8


@pytest.mark.slow
def test_deviations_of_a_hundred_fits_are_calibrated() -> None:
    """Squares of errors over deviations are 1 in the mean, sums of squares their degrees of freedom."""
    generator, deviation = np.random.default_rng(1), 1e-5
    start, planted = reaction(), reaction(**PLANTED)
    errors, sums = [], []
    for _ in range(100):
        noise = deviation * generator.normal(size=len(planted))
        measured = [(a, b.parameters["p"] + e, deviation) for a, b, e in zip(start, planted, noise, strict=True)]
        fit = fit_parameters(measured, over=["p2", "p3"])
        assert fit.found
        errors.append([(fit[name] - value) / fit.deviations[name] for name, value in PLANTED.items()])
        sums.append(fit.chi_square)
    squares, free = np.mean(np.square(errors), axis=0), len(planted) - 2  # deviations of these means: sqrt(2/100)
    assert np.all(np.abs(squares - 1.0) < 0.42)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.3)
    assert abs(np.mean(sums) - free) < 3.0 * np.sqrt(2.0 * free / 100.0)


def test_a_torus_and_a_branch_point_of_cycles_are_fitted() -> None:
    """At a = k^2 and a = 0.5 + k; the second is no branch point at another e."""
    x, y, z, u, v, a, k, e = symbols("x y z u v a k e")
    growth, rate = 1 - x**2 - y**2, a - k**2 - u**2 - v**2
    rhs = [growth * x - y, growth * y + x, (a - 0.5 - k) * z - z**3 + e, rate * u - 0.3 * v, 0.3 * u + rate * v]
    model = OdeModel("turning", ca.vertcat(x, y, z, u, v), ca.vertcat(*rhs), ca.vertcat(a, k, e))
    guess = lambda t: [np.cos(t), np.sin(t), 0.0, 0.0, 0.0]  # noqa: E731
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"a": -0.3, "k": 0.2, "e": 0.0}, tolerance=1e-9)
    torus, other = orbit.follow("a", 1.0, stability=True).special_points
    fit = fit_parameters([(torus, 0.09, 0.01), (other, 0.8, 0.02)], over=["k"])
    assert fit["k"] == pytest.approx(0.3, abs=1e-8)
    assert fit.deviations["k"] == pytest.approx((0.6**2 / 0.01**2 + 1.0 / 0.02**2) ** -0.5, rel=1e-6)
    with pytest.raises(ArithmeticError, match="derivatives by e"):
        fit_parameters([(other, 0.8, 0.02)], over=["e"])


def test_a_doubling_is_fitted() -> None:
    """At a = k^2: beside a cycle (u, v) = R(theta/2) (p, q), which a period turns by pi, with p' = (a - k^2) p."""
    x, y, u, v, a, k = symbols("x y u v a k")
    growth, grows, falls = 1 - x**2 - y**2, a - k**2, 0.7
    mean, half, least = (grows - falls) / 2, (grows + falls) / 2, u**2 + v**2
    rhs = [growth * x - y, growth * y + x, (mean - least) * u + half * (x * u + y * v) - v / 2,
           (mean - least) * v + half * (y * u - x * v) + u / 2]  # fmt: skip
    model = OdeModel("half turn", ca.vertcat(x, y, u, v), ca.vertcat(*rhs), ca.vertcat(a, k))
    guess = lambda t: [np.cos(t), np.sin(t), 0.0, 0.0]  # noqa: E731
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"a": -0.3, "k": 0.2}, tolerance=1e-9)
    (doubling,) = orbit.follow("a", 0.5, stability=True).special_points
    assert doubling.kind == "period doubling"
    fit = fit_parameters([(doubling, 0.09, 0.01)], over=["k"])
    assert fit.found
    assert fit["k"] == pytest.approx(0.3, abs=1e-8)
    assert fit.deviations["k"] == pytest.approx(0.01 / 0.6, rel=1e-6)
    assert fit.located[0].parameters["a"] == pytest.approx(0.09, abs=1e-8)


@pytest.mark.slow
def test_edges_of_tongues_are_fitted() -> None:
    near, planted = (
        follow_family(Chain(8, 1.0, gamma, g), 1, 1.0, stability=True, tolerance=1e-9)
        for gamma, g in ((0.2, -1.0), (0.21, -1.05))
    )
    fit = fit_parameters([(near.edge(k), planted.edge(k).parameters["S"], 1e-4) for k in (0, 2)], over=["gamma", "g"])
    assert fit.found
    assert fit.values == pytest.approx({"gamma": 0.21, "g": -1.05}, abs=1e-8)


def test_quantities_of_orbits_are_fitted_too() -> None:
    orbit = circle(0.5, 1.0)
    fit = fit_parameters([(orbit, "period", 5.0, 0.01), (orbit, "x_max", 0.8, 0.02)], over=["mu", "w"])
    assert fit.values == pytest.approx({"mu": 0.64, "w": 2 * np.pi / 5.0}, rel=1e-6)
    assert fit.deviations == pytest.approx({"mu": 2 * 0.8 * 0.02, "w": 2 * np.pi / 25.0 * 0.01}, rel=1e-5)
    assert fit.located[0] is fit.located[1]
    assert fit.located[0].period == pytest.approx(5.0, rel=1e-9)


def test_points_located_at_different_parameters_have_the_same_at_the_fit() -> None:
    first, second = cubic(1.0, 1.0)[0], cubic(1.2, 1.1)[1]
    place = 2 / 3 * 1.5 * np.sqrt(1.5 / 3.9)
    measured = [(first, place * np.sign(first.parameters["p"]), 0.1), (second, -0.5, 0.1)]
    fit = fit_parameters(measured, over=["a"], bounds={"a": (0.5, None)})
    assert [point.parameters["a"] for point in fit.located] == pytest.approx([fit["a"]] * 2, rel=1e-12)
    assert [point.parameters["b"] for point in fit.located] == [1.0, 1.1]
    known = [2 / 3 * fit["a"] * np.sqrt(fit["a"] / (3 * b)) for b in (1.0, 1.1)]
    assert [abs(point.parameters["p"]) for point in fit.located] == pytest.approx(known, rel=1e-9)


def test_a_fit_on_a_bound_says_so() -> None:
    first, _ = cubic(1.0, 1.0)
    far = (first, 3.0 * first.parameters["p"], 0.1)
    fit = fit_parameters([far], over=["a"], bounds={"a": (0.5, 1.3)})
    assert fit["a"] == pytest.approx(1.3, abs=1e-9)
    assert fit.found
    assert fit.reason.endswith("on a bound: a")


def test_what_is_refused() -> None:
    first, second = cubic(1.0, 1.0)
    good = (first, 0.4, 0.1)
    for measured, over, words in (
        ([], ["a"], r"measured: given \[\]; accepted: a list of"),
        ([first], ["a"], "measured, item 1: given <fold"),
        ([good, ()], ["a"], r"measured, item 2: given \(\); accepted"),
        ([good, (3, "x", 0.0, 0.1)], ["a"], r"measured, item 2: given \(3, .x., 0.0, 0.1\); accepted"),
        ([(first, "p", 0.4, 0.1)], ["a"], "measured, item 1: given"),
        ([(first, 0.4, 0.0)], ["a"], "measured, item 1: given the standard deviation 0; accepted: one > 0"),
        ([(first, np.nan, 0.1)], ["a"], "measured, item 1: given nan"),
        ([good], ["p"], "over: given p, which item 1 of measured locates; accepted: other parameters"),
        ([good], ["c"], "over: given 'c'"),
        ([(first.solution, "size", 0.4, 0.1)], ["a"], "quantity: given size; accepted"),
    ):
        with pytest.raises((ValueError, TypeError), match=words):
            fit_parameters(measured, over=over)
    with pytest.raises(ValueError, match="bounds: given 'p'"):
        fit_parameters([good], over=["a"], bounds={"p": (0.0, 1.0)})
    for measured in ([good], [good, (second, -0.4, 0.1)]):  # a^3/b alone
        with pytest.raises(ArithmeticError, match="what is measured does not determine a, b"):
            fit_parameters(measured, over=["a", "b"])
