"""Folds, branch points and Hopf points of equilibria against closed forms and published values."""

from __future__ import annotations

import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import Brusselator, ab, branch_of, carbon_monoxide, has_points, hopf_pairs, lorenz, symbols

from casadi_skin import OdeModel, find_equilibrium, read_result, save_result
from casadi_skin.follow.space import EquilibriumError


def test_ab_has_the_folds_and_the_hopf_point_of_auto() -> None:
    """AUTO-07p's demo `ab`: folds at (1 -+ sqrt(1 - 12/14))/2, the Hopf point at trace zero: 0.130900045."""
    *folds, hopf = find_equilibrium(ab(), [0, 0]).follow("p", 0.25).special_points
    assert [point.kind for point in (*folds, hopf)] == ["fold", "fold", "hopf"]
    for point, sign in zip(folds, (-1, 1), strict=True):
        x = 0.5 * (1.0 + sign * np.sqrt(1.0 - 12.0 / 14.0))
        exact = x * np.exp(-14.0 * x / 3.0) / (1.0 - x)
        assert abs(point.parameters["p"] - exact) <= 1e-16 + 2.0 * point.error < 2e-14
    assert abs(hopf.parameters["p"] - 0.130900045) < 5e-10
    x = hopf.solution["x"]
    rate = x / (1.0 - x)  # p e^y
    assert abs(-4.0 + rate * (14.0 * (1.0 - x) - 1.0)) < 1e-12
    assert abs(hopf.frequency - np.sqrt(3.0 * (1.0 + rate) - 14.0 * (1.0 - x) * rate)) < 1e-12
    assert hopf.criticality == "supercritical"


def test_lyapunov_coefficient_of_a_planar_model_agrees_with_the_real_formula() -> None:
    """Guckenheimer and Holmes 1983, (3.4.11), for u' = -w v + f, v' = w u + g."""
    u, v, m = symbols("u v m")
    w = 1.7
    f = m * u - w * v + 0.3 * u**2 - 0.8 * u * v + 1.1 * v**2 - 0.5 * u**3 + 0.2 * u * v**2
    g = w * u + m * v - 0.7 * u**2 + 0.4 * u * v - 0.6 * v**2 + 0.3 * u**2 * v - 0.9 * v**3
    (point,) = _from_below(OdeModel("planar", ca.vertcat(u, v), ca.vertcat(f, g), m), [0.0, 0.0], "m", -0.4, 0.5)
    cubic = (6 * -0.5 + 2 * 0.2 + 2 * 0.3 + 6 * -0.9) / 16
    fuv, guv, fuu, fvv, guu, gvv = -0.8, 0.4, 0.6, 2.2, -1.4, -1.2
    quadratic = (fuv * (fuu + fvv) - guv * (guu + gvv) - fuu * guu + fvv * gvv) / (16 * w)
    # r' = a r^3 with r = |(u, v)| and w' = omega l1 |z|^2 z with |z| = r/sqrt(2)
    assert abs(point.coefficient - 2.0 * (cubic + quadratic) / w) < 1e-12
    assert point.frequency == pytest.approx(w, rel=1e-13)


@pytest.mark.parametrize("turn", np.linspace(0.1, 1.5, 5))
def test_a_branch_that_starts_at_a_hopf_point_has_it_and_one_that_starts_beside_it_has_it_ahead_alone(
    turn: float,
) -> None:
    """Eigenvalues are p -+ 1.1 i, in coordinates that are turned and stretched: rounding is as it comes."""
    w, p, T = ca.SX.sym("w", 2), ca.SX.sym("p"), np.diag([1.0, 1.7]) @ [[np.cos(turn), -np.sin(turn)], [0.3, 1.0]]
    u, v = ca.vertsplit(np.linalg.inv(T) @ w - ca.vertcat(0.3 * p + 0.123, 0.7 * p**2))
    field = T @ ca.vertcat(p * u - 1.1 * v - u * (u**2 + v**2), 1.1 * u + p * v - v * (u**2 + v**2))
    model = OdeModel("turned", w, field, p)
    for start, to, listed in ((0.0, 1.0, 1), (0.0, -1.0, 1), (-1e-12, 1.0, 1), (1e-12, 1.0, 0)):
        at = T @ [0.3 * start + 0.123, 0.7 * start**2]
        branch = find_equilibrium(model, at, parameters={"p": start}).follow("p", to)
        assert [point.kind for point in branch.special_points] == listed * ["hopf"]
        assert all(abs(point.parameters["p"]) <= point.error < 1e-13 for point in branch.special_points)
        assert branch.unresolved == ()


def test_lorenz_has_its_pitchfork_and_its_subcritical_hopf_point() -> None:
    at_zero = _from_below(lorenz(), [0, 0, 0], "r", 0.2, 40.0)
    assert [point.kind for point in at_zero] == ["branch point"]
    assert abs(at_zero[0].parameters["r"] - 1.0) <= at_zero[0].error < 1e-12
    (hopf,) = _from_below(lorenz(), [6, 6, 13], "r", 14.0, 40.0)
    assert hopf.kind == "hopf"
    assert abs(hopf.parameters["r"] - 470.0 / 19.0) <= hopf.error < 1e-11
    assert hopf.criticality == "subcritical"
    assert abs(hopf.frequency**2 - 8.0 / 3.0 * (470.0 / 19.0 + 10.0)) < 1e-10


def test_carbon_monoxide_has_the_points_that_matcont_publishes() -> None:
    """MatCont's manual, example of a catalytic oscillator; its coefficient is omega l1, its fold's a has any sign."""
    branch = find_equilibrium(carbon_monoxide(), [0.001137, 0.891483, 0.062345]).follow("q2", 0.5)
    published = [
        ("hopf", [0.016357, 0.523973, 0.328336], 1.051558, 10.70259),
        ("fold", [0.024717, 0.450257, 0.375018], 1.042049, 0.1166509),
        ("fold", [0.054030, 0.302241, 0.459807], 1.052200, 0.1346534),
        ("hopf", [0.077929, 0.233063, 0.492149], 1.040991, 4.332247),
    ]
    assert [point.kind for point in branch.special_points] == [kind for kind, *_ in published]
    for point, (kind, state, q2, coefficient) in zip(branch.special_points, published, strict=True):
        np.testing.assert_allclose(point.solution.state, state, atol=4e-6)
        assert abs(point.parameters["q2"] - q2) < 1.5e-6
        found = point.coefficient * (point.frequency if kind == "hopf" else 1.0)
        assert abs(abs(found) - coefficient) < 3e-4 * coefficient


@pytest.mark.slow
def test_every_hopf_point_of_a_large_model_is_found_once() -> None:
    """128 components: the Brusselator with diffusion, whose pairs cross one after the other."""
    problem = Brusselator(64)
    exact = problem.hopf_values(9.0)
    start = find_equilibrium(problem.model, problem.uniform(4.0), parameters={"B": 4.0})
    points = start.follow("B", 9.0).special_points
    hopf = [point.parameters["B"] for point in points if point.kind == "hopf"]
    assert exact.size > 3
    np.testing.assert_allclose(hopf, exact, rtol=1e-10)
    turing = _turing_values(problem, 9.0)
    np.testing.assert_allclose([p.parameters["B"] for p in points if p.kind == "branch point"], turing, rtol=1e-10)
    assert all(point.parameters["B"] < after.parameters["B"] for point, after in pairwise(points))


def _turing_values(problem: Brusselator, largest: float) -> np.ndarray:
    """B at which a real eigenvalue of the uniform state is zero: det = 0 for a wave number."""
    mu = problem.decay()
    B = (1.0 + problem.d1 * mu) * (problem.A**2 + problem.d2 * mu) / (problem.d2 * mu)
    return np.sort(B[largest > B])


@pytest.mark.parametrize(("sense", "apart"), [(1, 1e-5), (-1, 1e-5), (1, 0.0)])
def test_two_pairs_that_cross_in_one_step_are_told_apart(sense: int, apart: float) -> None:
    """In the same sense, in opposite ones, where the number that is unstable is the same at both ends, and together."""
    p = ca.SX.sym("p")
    model = hopf_pairs([p, sense * (p - apart)], p, [1.0, 1.3])
    branch = find_equilibrium(model, np.zeros(4), parameters={"p": -1.0}).follow("p", 1.0)
    has_points(branch, [("hopf", 0.0), ("hopf", apart)], 1e-12)
    frequencies = sorted(point.frequency for point in branch.special_points)
    np.testing.assert_allclose(frequencies, [1.0, 1.3], rtol=1e-9)


def test_each_of_two_pairs_on_the_axis_has_its_own_frequency_coefficient_and_cycles() -> None:
    """r_k' = r_k (p - k r_k^2), so that omega l1 = -2 k; along p = q both are on the axis, a Hopf-Hopf point at 0."""
    p, q = ca.SX.sym("p"), ca.SX.sym("q")
    model = hopf_pairs([p, p + q], ca.vertcat(p, q), [1.0, 1.3])  # k = 1
    x = model.state
    damping = ca.vertcat(0, 0, x[2:] * ca.sumsqr(x[2:]))
    model = OdeModel("pairs", x, model.rhs - damping, model.parameters)
    start = find_equilibrium(model, np.zeros(4), parameters={"p": -1.0, "q": 0.0})
    points = start.follow("p", 1.0).special_points
    for point, k, omega in zip(sorted(points, key=lambda one: one.frequency), (1, 2), (1.0, 1.3), strict=True):
        assert point.coefficient * omega == pytest.approx(-2.0 * k, rel=1e-9)
        cycles = point.follow("p", 0.5)
        np.testing.assert_allclose(cycles["period"], 2.0 * np.pi / omega, rtol=1e-8)
    apart = find_equilibrium(model, np.zeros(4), parameters={"p": -1.0, "q": -0.5}).follow("p", 1.0).special_points
    for point, omega in zip(apart, (1.0, 1.3), strict=True):
        (both,) = point.curve("q", 0.5).special_points
        assert (both.kind, both.frequency) == ("hopf-hopf", pytest.approx(omega, rel=1e-9))
        assert not np.any(both.vector[slice(0, 2) if omega > 1.0 else slice(2, 4)].round(9))


def test_a_coefficient_is_not_given_at_a_resonance_of_one_to_two() -> None:
    x, p = ca.SX.sym("x", 4), ca.SX.sym("p")
    quadratic = ca.vertcat(x[0] * x[2] + x[1] * x[3], x[0] * x[3] - x[1] * x[2], x[0] ** 2 - x[1] ** 2, 2 * x[0] * x[1])
    rates = ca.vertcat(p * x[0] - x[1], p * x[1] + x[0], p * x[2] - 2 * x[3], p * x[3] + 2 * x[2])
    model = OdeModel("resonance", x, rates + quadratic, p)
    points = find_equilibrium(model, np.zeros(4), parameters={"p": -1.0}).follow("p", 1.0).special_points
    words = {round(point.frequency): point.criticality for point in points}
    assert words == {1: "unknown: resonance 1:2 there", 2: "degenerate"}


def test_pairs_of_one_frequency_are_named_together_also_in_files(tmp_path: Path) -> None:
    p = ca.SX.sym("p")
    branch = find_equilibrium(hopf_pairs([p, p], p, [1.0, 1.0]), np.zeros(4), parameters={"p": -1.0}).follow("p", 1.0)
    assert [point.kind for point in branch.special_points] == ["hopf", "hopf"]
    assert all(abs(point.parameters["p"]) <= point.error < 1e-3 for point in branch.special_points)
    (stretch,) = branch.unresolved
    assert (stretch.kind, stretch.parameter) == ("hopf", "p")
    assert stretch.start <= 0.0 <= stretch.end
    assert stretch.reason == "more than can be distinguished: hopf, 2 in all"
    assert "2 hopf, unresolved: 1 stretch;" in repr(branch)
    assert str(stretch) in str(branch)
    assert read_result(save_result(branch, tmp_path / "branch.result")).unresolved == branch.unresolved


HYSTERESIS, ENERGY = 2.0 * (1e-4 / 3.0) ** 1.5, 2.0 / 27.0**0.5
CLOSED_FORMS: dict[str, tuple[Any, ...]] = {  # states, rates, guess, from, to, special points, error
    "eigenvalues 1 + p and p - 2, a neutral saddle at 1/2":
        ("x y", lambda x, y, p: [(1 + p) * x + y**2, (p - 2) * y], [0.0, 0.0], 0.0, 1.0, [], 0.0),
    "two folds within a tenth of a step, 2.4e-6 apart":
        ("x", lambda x, p: [p - x**3 + 1e-4 * x], [-1.0], -1.0, 1.0,
         [("fold", HYSTERESIS), ("fold", -HYSTERESIS)], 1e-13),
    "an energy that is not declared, with pairs on the axis":
        ("x y", lambda x, y, p: [y, p + x - x**3], [-1.3, 0.0], -1.0, 1.0,
         [("fold", ENERGY), ("fold", -ENERGY)], 1e-12),
    "a pitchfork on the branch that leaves it":
        ("x", lambda x, p: [p * x - x**3], [2.0], 4.0, -1.0, [("branch point", 0.0)], 1e-10),
    "an imperfect pitchfork below":
        ("x", lambda x, p: [p * x - x**3 + 1e-6], [-1e-6], -1.0, -0.5, [], 0.0),
    "an imperfect pitchfork above":
        ("x", lambda x, p: [p * x - x**3 + 1e-6], [1e-6], -1.0, 2.0, [], 0.0),
    "a pair that is unstable for |p - 0.3| < 0.01 alone":
        ("u v", lambda u, v, p: _pair(u, v, 1e-4 - (p - 0.3) ** 2), [0.0, 0.0], -1.0, 1.0,
         [("hopf", 0.29), ("hopf", 0.31)], 1e-10),
}  # fmt: skip


def _pair(u: ca.SX, v: ca.SX, growth: ca.SX) -> list[ca.SX]:
    return [growth * u - v - (u**2 + v**2) * u, u + growth * v - (u**2 + v**2) * v]


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_special_points_are_those_in_closed_form(name: str) -> None:
    states, rhs, guess, start, to, known, error = CLOSED_FORMS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error", category=RuntimeWarning)
        has_points(branch_of(states, rhs, guess, to, p=start), known, error)


def _from_below(model: OdeModel, guess: object, name: str, start: float, to: float) -> tuple:
    with warnings.catch_warnings():
        warnings.simplefilter("error", category=RuntimeWarning)
        branch = find_equilibrium(model, guess, parameters={name: start}).follow(name, to)
    return branch.special_points


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e8])
def test_a_branch_on_which_derivatives_overflow_has_the_fold_before(unit: float) -> None:
    """p exp(x) = x: a fold at p = 1/e, x = 1; beyond it x grows until exp(x) has no room in a double."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    model = OdeModel("exponential", x, unit * (ca.exp(x / unit) * p - x / unit), p)
    points = find_equilibrium(model, [0.0], parameters={"p": 0.0}).follow("p", 1.0).special_points
    assert points[0].kind == "fold"
    assert abs(points[0].parameters["p"] - np.exp(-1.0)) <= points[0].error < 1e-12


def test_a_branch_that_goes_to_infinity_has_no_folds_of_rounding() -> None:
    """p = x exp(-x): a fold at (1, 1/e), then p goes to zero, also below what rounding leaves of its rate."""
    x, p = symbols("x p")
    model = OdeModel("to infinity", x, p - x * ca.exp(-x), p)
    far = lambda solution: solution.state[0] > 60.0  # noqa: E731
    branch = find_equilibrium(model, [0.0], parameters={"p": 0.0}).follow("p", 0.5, until=far)
    (fold,) = branch.special_points
    assert fold.parameters["p"] == pytest.approx(np.exp(-1.0), abs=1e-15)
    assert branch.stopped


def test_two_branch_points_that_symmetry_keeps_together_are_listed_and_not_followed() -> None:
    """Three other branches cross at p = 0, where the determinant keeps its sign."""
    branch = branch_of("x y", lambda x, y, p: [p * x - x**3, p * y - y**3], [0.0, 0.0], 1.0, p=-1.0)
    assert [stretch.kind for stretch in branch.unresolved] == ["branch point"]
    (point,) = branch.special_points
    assert point.kind == "branch point"
    assert abs(point.parameters["p"]) <= 2.0 * point.error < 1e-5
    with pytest.raises(EquilibriumError, match="2 eigenvalues vanish at once; accepted: a branch point of one"):
        point.follow("p", 1.0)


def test_a_hopf_point_where_the_parameter_stands_still_is_listed() -> None:
    """p = z^3 stands still at z = 0, where a pair with the real part p + z crosses; 0 = p - z^3 has no fold there."""
    branch = branch_of("x y z", lambda x, y, z, p: [*_pair(x, y, p + z), p - z**3], [0.0, 0.0, -0.8], 0.5, p=-0.5)
    has_points(branch, [("hopf", 0.0)], 1e-12)
    assert branch.special_points[0].criticality == "unknown: another eigenvalue vanishes there"
