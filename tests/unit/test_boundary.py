"""Boundary-value problems against closed forms, published numbers and other programs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from boundary_cases import LAYERS
from marks import slow
from programs import Program
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk, mathieu_a

from casadi_skin import BoundaryValueProblem
from casadi_skin.model.ode import OdeModel


def second_order(name: str, rhs: Any, *parameters: ca.SX, time: ca.SX | None = None) -> tuple[OdeModel, ca.SX, ca.SX]:
    """u'' = rhs(u, u') as a model of first order, with the symbols of u and u'."""
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    forced = {} if time is None else {"time": time, "forcing_period": 1.0}
    p = ca.vertcat(*parameters) if parameters else ca.SX(0, 1)
    return OdeModel(name, ca.vertcat(u, v), ca.vertcat(v, rhs(u, v)), p, **forced), u, v


def bratu() -> BoundaryValueProblem:
    lam = ca.SX.sym("lambda")
    model, u, _ = second_order("Bratu", lambda u, v: -lam * ca.exp(u), lam)
    return BoundaryValueProblem(model, [model.start(u), model.end(u)], parameters={"lambda": 1.0})


def bratu_angles(lam: float) -> list[float]:
    """theta = sqrt(2 lambda) cosh(theta/4) of both solutions."""
    equation = lambda theta: theta - np.sqrt(2.0 * lam) * np.cosh(theta / 4.0)  # noqa: E731
    top = 4.0 * np.arcsinh(4.0 / np.sqrt(2.0 * lam))
    return [brentq(equation, 0.0, top, xtol=1e-15), brentq(equation, top, 40.0, xtol=1e-15)]


def bratu_solution(theta: float, x: np.ndarray) -> np.ndarray:
    return np.asarray(-2.0 * np.log(np.cosh(theta * (x - 0.5) / 2.0) / np.cosh(theta / 4.0)))


# Known answers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("corrector", [slow("ipopt"), "newton"])
def test_both_branches_of_bratu_and_the_fold_between_them(corrector: str) -> None:
    """Bratu (1914). With z = theta/4 lambda = 8 z^2 / cosh^2 z, stationary where z tanh z = 1: 3.513830719."""
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(25):
        z = mpmath.findroot(lambda z: z * mpmath.tanh(z) - 1, 1.2)
        fold = float(8 * z**2 / mpmath.cosh(z) ** 2)
    assert abs(fold - 3.513830719) < 1e-9
    start = bratu().with_parameters(**{"lambda": 0.5}).solve([0.0, 0.0], tolerance=1e-10, corrector=corrector)
    branch = start.follow("lambda", 4.0, at=[1.0, 3.0], until=lambda s: s.states[:, 0].max() > 4.5)
    assert branch.complete
    assert [abs(f.parameters["lambda"] / fold - 1) < 1e-9 for f in branch.folds] == [True]
    x = np.linspace(0.0, 1.0, 301)
    for lam in (1.0, 3.0):
        for which, theta in enumerate(bratu_angles(lam)):
            exact = bratu_solution(theta, x)
            assert np.abs(branch.at(lam, which).evaluate(x)[:, 0] - exact).max() / exact.max() < 1e-9


@pytest.mark.parametrize("eps", [1e-2, *(slow(eps) for eps in (1e-4, 1e-6))])
@pytest.mark.parametrize("name", [name for name in LAYERS if not name.startswith("20")])
def test_layers_are_met_at_the_tolerance_asked(name: str, eps: float) -> None:
    case = LAYERS[name]
    problem = case.problem(eps)
    for options in ({"tolerance": 1e-5}, {"tolerance": 1e-7, "corrector": "newton"}, {"tolerance": 1e-5, "degree": 4}):
        solution = problem.solve([0.0, 0.0], **options)
        assert solution.error <= options["tolerance"]
        assert case.error(solution, eps) <= solution.error
        assert solution.intervals <= 135


@pytest.mark.parametrize("degree", [2, 4, 6])
@pytest.mark.parametrize("name", ["1, two layers", slow("6, shock at a turning point"), slow("20, nonlinear corner")])
def test_estimates_are_honest(name: str, degree: int) -> None:
    """True errors below the estimate, and not far below where nothing but the mesh limits them."""
    case, eps = LAYERS[name], 1e-2
    for tolerance in (1e-3, 1e-5) if degree == 2 else (1e-3, 1e-5, 1e-7):
        for transcription in ("gauss", "radau"):
            options = {"tolerance": tolerance, "transcription": transcription, "degree": degree}
            solution = case.problem(eps).solve([1.0, 0.0], **options)
            assert case.error(solution, eps) <= solution.error <= tolerance


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_terms_as_large_as_1e6_leave_rounding_in_their_own_equations(corrector: str) -> None:
    """Residuals of size 1e-10 are rounding where derivatives are 1e6, and none of the other equations'."""
    case = LAYERS["2, layer at the end"]
    solution = case.problem(1e-6).solve([0.0, 0.0], tolerance=1e-10, corrector=corrector)
    assert not solution.at_round_off
    assert case.error(solution, 1e-6) <= solution.error < 1e-10
    assert not case.problem(1e-2).solve([0.0, 0.0], tolerance=1e-8).at_round_off


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 1e6])
def test_a_guess_of_zeros_knows_no_size(size: float) -> None:
    """Errors are relative to the solution, however small it is: u'' = 400 u, u(0) = size, u(1) = 0."""
    model, u, _ = second_order("layer", lambda u, v: 400.0 * u)
    problem = BoundaryValueProblem(model, [model.start(u) - size, model.end(u)])
    solution = problem.solve([0.0, 0.0], tolerance=1e-9)
    x = np.linspace(0.0, 1.0, 1001)
    exact = np.sinh(20.0 * (1.0 - x)) / np.sinh(20.0)
    assert np.abs(solution.evaluate(x)[:, 0] / size - exact).max() <= solution.error <= 1e-9


@pytest.mark.slow
def test_a_nonlinear_corner_is_followed_to_a_millionth() -> None:
    """No guess leads there directly; u = 1 + eps log cosh((x - 0.745) / eps) on the way and at the end."""
    case, eps = LAYERS["20, nonlinear corner"], ca.SX.sym("eps")
    model, u, _ = second_order("corner", lambda u, v: (1 - v**2) / eps, eps)
    outside = lambda s: 1 + s - eps * np.log(2.0) + eps * ca.log1p(ca.exp(-2 * s / eps))  # noqa: E731
    conditions = [model.start(u) - outside(0.745), model.end(u) - outside(0.255)]
    first = BoundaryValueProblem(model, conditions, parameters={"eps": 1e-2}).solve([1.5, 0.0], tolerance=1e-7)
    branch = first.follow("eps", 1e-6, at=[1e-3, 1e-4])
    assert branch.complete
    for solution in (branch.at(1e-3), branch.at(1e-4), branch.solutions[-1]):
        value = solution.parameters["eps"]
        assert case.error(solution, value) <= solution.error <= 1e-7
    assert branch.solutions[-1].parameters["eps"] == pytest.approx(1e-6, rel=1e-9)


@pytest.mark.parametrize(("order", "q"), [(1, 5.0), *(slow(*case) for case in ((0, 1.0), (2, 5.0)))])
def test_eigenvalues_of_mathieu_with_an_integral_normalisation(order: int, q: float) -> None:
    """u'' + (a - 2 q cos 2x) u = 0, even; the mean square is fixed, a is free. Against scipy.special.mathieu_a."""
    a, p, x = ca.SX.sym("a"), ca.SX.sym("q"), ca.SX.sym("x")
    model, u, v = second_order("Mathieu", lambda u, v: -(a - 2 * p * ca.cos(2 * x)) * u, a, p, time=x)
    end = v if order % 2 == 0 else u
    guess = {"u": lambda x: np.cos(order * x), "v": lambda x: -order * np.sin(order * x)}
    problem = BoundaryValueProblem(
        model, [model.start(v), model.end(end)], [u**2 - 1], (0.0, np.pi / 2), {"a": order**2, "q": 0.0}, ["a"]
    )
    found = problem.solve(guess, tolerance=1e-10).follow("q", q).solutions[-1]
    assert abs(found.parameters["a"] - mathieu_a(order, q)) < 1e-9 * max(1.0, abs(mathieu_a(order, q)))
    assert abs(np.mean(found.evaluate((np.arange(4000) + 0.5) * np.pi / 8000)[:, 0] ** 2) - 1) < 1e-6


def test_a_free_end_time() -> None:
    """A pendulum released at rest reaches the bottom after K(sin^2(a/2))."""
    T, a = ca.SX.sym("T"), 2.0
    model, u, v = second_order("pendulum", lambda u, v: -ca.sin(u), T)
    conditions = [model.start(u) - a, model.start(v), model.end(u)]
    problem = BoundaryValueProblem(model, conditions, (), (0.0, T), {"T": 1.5}, ["T"])
    solution = problem.solve({"u": lambda t: a * np.cos(t)}, tolerance=1e-11)
    exact = ellipk(np.sin(a / 2) ** 2)
    assert abs(solution["T"] / exact - 1) <= max(solution.parameter_error, 1e-14)
    assert solution.parameter_error <= 1e-11
    assert solution.interval[1] == solution["T"]


def test_a_two_point_problem_beside_scipy() -> None:
    """Emden's equation u'' + (2/x) u' + u^5 = 0: u = 1/sqrt(1 + x^2/3), and solve_bvp."""
    x = ca.SX.sym("x")
    model, u, v = second_order("Emden", lambda u, v: -2 * v / x - u**5, time=x)
    conditions = [model.start(v) + 0.1 / 3 / (1 + 0.01 / 3) ** 1.5, model.end(u) - np.sqrt(0.75)]
    solution = BoundaryValueProblem(model, conditions, interval=(0.1, 1.0)).solve([0.9, 0.0], tolerance=1e-10)
    t = np.linspace(0.1, 1.0, 101)
    assert np.abs(solution.evaluate(t)[:, 0] - 1 / np.sqrt(1 + t**2 / 3)).max() < 1e-10
    slope = -0.1 / 3 / (1 + 0.01 / 3) ** 1.5
    other = solve_bvp(
        lambda x, y: np.stack([y[1], -2 * y[1] / x - y[0] ** 5]),
        lambda a, b: np.array([a[1] - slope, b[0] - np.sqrt(0.75)]), t, np.stack([np.ones(101), np.zeros(101)]),
        tol=1e-8,
    )  # fmt: skip
    assert np.abs(other.sol(t).T - solution.evaluate(t)).max() < 1e-7


def test_carriers_problem_has_the_spikes_that_shooting_confirms() -> None:
    """eps^2 u'' + 2 (1 - x^2) u + u^2 = 1 (Bender and Orszag 1978, section 9.7), by integration from its left end."""
    eps, x = ca.SX.sym("eps"), ca.SX.sym("x")
    model, u, _ = second_order("Carrier", lambda u, v: (1 - u**2 - 2 * (1 - x**2) * u) / eps**2, eps, time=x)
    problem = BoundaryValueProblem(model, [model.start(u), model.end(u)], (), (-1.0, 1.0), {"eps": 0.2})
    solution = problem.solve([-0.5, 0.0], tolerance=1e-9)
    rhs = lambda x, y: [y[1], (1 - y[0] ** 2 - 2 * (1 - x**2) * y[0]) / 0.04]  # noqa: E731
    half = solve_ivp(rhs, (-1.0, 0.0), solution.evaluate(-1.0), "DOP853", rtol=1e-12, atol=1e-12, dense_output=True)
    t = np.linspace(-1.0, 0.0, 51)
    assert np.abs(half.sol(t).T - solution.evaluate(t)).max() < 1e-5  # errors grow as exp(1/eps)
    np.testing.assert_allclose(solution.evaluate(t)[:, 0], solution.evaluate(-t)[:, 0], atol=1e-9)


# Convergence ----------------------------------------------------------------------------------------------------------


# Guesses --------------------------------------------------------------------------------------------------------------


class Lifted:
    """Anything with states at times is a guess."""

    def evaluate(self, t: Any) -> np.ndarray:
        t = np.atleast_1d(t)
        return np.stack([0.14 * np.sin(np.pi * t), 0.4 * np.cos(np.pi * t)], axis=1)


T, FINE = np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 65)
SINE = Lifted().evaluate(T)
GUESSES: dict[str, tuple[Any, Any]] = {  # each with its states at T
    "numbers": ([0.0, 0.1], np.tile([0.0, 0.1], (9, 1))),
    "array": (np.array([0.1, 0.0]), np.tile([0.1, 0.0], (9, 1))),
    "function": (lambda t: [0.14 * np.sin(np.pi * t), 0.0], np.stack([SINE[:, 0], 0.0 * T], axis=1)),
    "by name": ({"u": lambda t: 0.1 * t * (1 - t)}, np.stack([0.1 * T * (1 - T), 0.0 * T], axis=1)),
    "by name, both": ({"u": 0.1, "v": lambda t: 1 - 2 * t}, np.stack([0.0 * T + 0.1, 1 - 2 * T], axis=1)),
    "samples": ((FINE, Lifted().evaluate(FINE)), SINE),
    "transposed lists": ((list(FINE), Lifted().evaluate(FINE).T.tolist()), SINE),
    "evaluated": (Lifted(), SINE),
    "beyond their times": (([0.25, 0.75], [[0.0, 0.4], [0.1, 0.0]]), np.interp(T, [0.25, 0.75], [0.0, 0.1])),
}


@pytest.mark.parametrize("kind", GUESSES)
def test_every_kind_of_guess_is_what_it_says_and_leads_to_the_solution(kind: str) -> None:
    from casadi_skin.zero.orbit import sampled

    guess, states = GUESSES[kind]
    found = sampled(bratu(), guess, T)
    np.testing.assert_allclose(found if np.ndim(states) == 2 else found[:, 0], states, atol=1e-7)
    exact = 2.0 * np.log(np.cosh(bratu_angles(1.0)[0] / 4.0))
    assert abs(bratu().solve(guess).evaluate(0.5)[0] - exact) < 1e-8


def test_a_solution_as_guess_brings_its_mesh() -> None:
    case = LAYERS["2, layer at the end"]
    first = case.problem(1e-4).solve([0.0, 0.0], tolerance=1e-6)
    np.testing.assert_array_equal(case.problem(1e-4).solve(first, tolerance=1e-6).mesh, first.mesh)


# What a solution knows ------------------------------------------------------------------------------------------------


def test_a_solution_reads_like_a_table() -> None:
    solution = bratu().solve([0.0, 0.0])
    assert solution.interval == (0.0, 1.0)
    assert solution["lambda"] == 1.0
    np.testing.assert_array_equal(solution["u"], solution.states[:, 0])
    np.testing.assert_allclose(solution.evaluate(solution.t), solution.states, atol=1e-15)
    assert solution.mesh.shape == (solution.intervals + 1,)
    assert solution.residual < 1e-12
    assert solution.parameter_error == 0.0
    with pytest.raises(KeyError, match="w; known: u, v, lambda"):
        solution["w"]


def test_a_model_of_second_order_has_velocities_among_its_ends() -> None:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = OdeModel("oscillator", q, -q, order=2, velocity=v)
    solution = BoundaryValueProblem(model, [model.start(q), model.end(v) - 1]).solve([0.0, 0.0], tolerance=1e-11)
    t = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(solution.evaluate(t)[:, 0], np.sin(t) / np.cos(1.0), atol=1e-11)


def test_a_statement_is_restated_and_stays_as_it_is() -> None:
    problem = bratu()
    assert problem.with_parameters(**{"lambda": 2.0}).values == {"lambda": 2.0}
    assert problem.values == {"lambda": 1.0}
    u = problem.model.state[0]
    other = replace(problem, conditions=[problem.model.start(u), problem.model.end(u) - 0.1])
    assert other.solve([0.0, 0.0]).evaluate(1.0)[0] == pytest.approx(0.1, abs=1e-12)


# Other kinds of models ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("opaque", [slow(False), True])
def test_models_in_mx_symbols_and_programs_with_their_own_derivatives(opaque: bool) -> None:
    x, lam = ca.MX.sym("x", 2), ca.MX.sym("lam")
    rhs = ca.vertcat(x[1], -lam * ca.exp(x[0]))
    field = Program(ca.Function("bratu", [x, lam], [rhs]))
    rhs = field(x, lam) if opaque else rhs
    model = OdeModel("Bratu", x, rhs, lam)
    problem = BoundaryValueProblem(model, [model.start(x)[0], model.end(x)[0]], parameters={"lam": 1.0})
    solution = problem.solve([0.0, 0.0], tolerance=1e-9)
    t = np.linspace(0.0, 1.0, 21)
    assert np.abs(solution.evaluate(t)[:, 0] - bratu_solution(bratu_angles(1.0)[0], t)).max() < 1e-9
    branch = solution.follow("lam", 4.0, until=lambda s: s.states[:, 0].max() > 2.0)
    assert abs(branch.folds[0].parameters["lam"] - 3.513830719125) < 1e-8


def test_interval_ends_may_depend_on_parameters() -> None:
    """u'' = -u on (0, L): u = sin(x)/sin(L); continued in L."""
    L = ca.SX.sym("L")
    model, u, _ = second_order("string", lambda u, v: -u, L)
    first = BoundaryValueProblem(model, [model.start(u), model.end(u) - 1], (), (0.0, L), {"L": 1.0}).solve([0.0, 1.0])
    last = first.follow("L", 2.5).solutions[-1]
    assert last.interval == (0.0, pytest.approx(2.5, rel=1e-12))
    assert abs(last.evaluate(1.0)[0] - np.sin(1.0) / np.sin(2.5)) < 1e-7
