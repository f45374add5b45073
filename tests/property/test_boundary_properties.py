"""Properties of boundary-value problems and periodic orbits over random linear problems, whose answers are exact."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from effort import examples
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import brentq

from casadi_skin import BoundaryValueProblem
from casadi_skin.follow.find import find_orbit
from casadi_skin.model.ode import OdeModel

few = examples(25, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def linear(n: int, seed: int) -> tuple[OdeModel, np.ndarray, np.ndarray, np.ndarray]:
    """x' = A x with n conditions B x(0) + C x(1) = b; well posed where B + C exp(A) is well conditioned."""
    generator = np.random.default_rng(seed)
    matrix = generator.normal(size=(n, n))
    x = ca.SX.sym("x", n)
    return OdeModel("linear", x, matrix @ x), matrix, *(generator.normal(size=(2, n, n)))


@few
@given(st.integers(1, 4), seeds, st.sampled_from(["gauss", "radau"]), st.sampled_from(["ipopt", "newton"]))
def test_linear_problems_have_their_matrix_exponential(n: int, seed: int, transcription: str, corrector: str) -> None:
    model, matrix, at_start, at_end = linear(n, seed)
    closing = at_start + at_end @ expm(matrix)
    assume(np.linalg.cond(closing) < 1e3)
    x = model.state
    conditions = [at_start @ model.start(x) + at_end @ model.end(x) - np.ones(n)]
    solution = BoundaryValueProblem(model, conditions).solve(
        [0.0] * n, tolerance=1e-7, transcription=transcription, corrector=corrector
    )
    t = np.linspace(0.0, 1.0, 21)
    exact = np.stack([expm(matrix * s) @ np.linalg.solve(closing, np.ones(n)) for s in t])
    errors = np.abs(solution.evaluate(t) - exact).max(axis=0) / np.abs(exact).max(axis=0)
    rounding = 1e-14 * np.linalg.cond(closing)  # of what it is compared with
    assert np.all(errors <= max(solution.error, rounding))
    assert solution.error <= 1e-7


@few
@given(st.floats(-5.0, 5.0), st.floats(0.1, 20.0), st.floats(1e-6, 1e6))
def test_place_length_and_size_of_a_problem_do_not_matter(start: float, length: float, size: float) -> None:
    """u'' = exp(u) on any interval, in any unit of u: log(c^2/2) in the middle, where c = 2^(1/2) cos(c/4)."""
    c = brentq(lambda c: c - np.sqrt(2.0) * np.cos(c / 4.0), 0.0, 2.0, xtol=1e-15)
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    rhs = ca.vertcat(v / length, size * ca.exp(u / size) / length)
    model = OdeModel("scaled", ca.vertcat(u, v), rhs)
    conditions = [model.start(u), model.end(u)]
    solution = BoundaryValueProblem(model, conditions, interval=(start, start + length)).solve([0.0, 0.0])
    middle = solution.evaluate(start + length / 2)[0] / size
    assert abs(middle - np.log(c**2 / 2.0)) < 1e-8


@pytest.mark.filterwarnings("ignore::casadi_skin.stability.result.LostMultiplierWarning")  # of CVODES; matrices count
@few
@example(n=2, seed=2269, cycles=3)  # an eigenvalue of the inverse that rounding makes zero
@given(st.integers(2, 3), seeds, st.integers(1, 3))
def test_forced_linear_orbits_have_the_multipliers_of_their_matrix(n: int, seed: int, cycles: int) -> None:
    generator = np.random.default_rng(seed)
    matrix, force = generator.normal(size=(n, n)) - 1.5 * np.eye(n), generator.normal(size=n)
    w = float(generator.uniform(1.0, 6.0))
    x, t = ca.SX.sym("x", n), ca.SX.sym("t")
    model = OdeModel("forced", x, matrix @ x + force * ca.cos(w * t), time=t, forcing_period=2 * np.pi / w)
    period = cycles * 2 * np.pi / w
    exact = np.exp(np.linalg.eigvals(matrix) * period)
    assume(np.max(np.abs(exact)) < 1e2)
    assume(np.min(np.abs(exact - 1.0)) > 1e-2)
    orbit = find_orbit(model, [0.0] * n, cycles=cycles, tolerance=1e-8)
    at = np.linspace(0.0, period, 9)
    response = np.linalg.solve(1j * w * np.eye(n) - matrix, force)
    np.testing.assert_allclose(orbit.evaluate(at), np.real(response * np.exp(1j * w * at)[:, None]), atol=1e-6)
    found = orbit.floquet().monodromy
    scale = max(1.0, float(np.linalg.norm(expm(matrix * period), 2)))
    np.testing.assert_allclose(found, expm(matrix * period), atol=1e-7 * scale)
    np.testing.assert_allclose(orbit.floquet("cvodes").monodromy, found, atol=1e-5 * scale)


@few
@given(seeds)
def test_a_problem_backwards_has_the_solution_backwards(seed: int) -> None:
    model, matrix, at_start, at_end = linear(3, seed)
    assume(np.linalg.cond(at_start + at_end @ expm(matrix)) < 1e3)
    x, b = model.state, np.array([1.0, -1.0, 2.0])
    forwards = BoundaryValueProblem(model, [at_start @ model.start(x) + at_end @ model.end(x) - b]).solve([0.0] * 3)
    back = replace(model, rhs=-model.rhs)
    backwards = BoundaryValueProblem(back, [at_start @ back.end(x) + at_end @ back.start(x) - b]).solve([0.0] * 3)
    t = np.linspace(0.0, 1.0, 11)
    scale = np.abs(forwards.states).max()
    np.testing.assert_allclose(forwards.evaluate(t), backwards.evaluate(1.0 - t), atol=1e-7 * scale)


@few
@given(seeds, st.integers(1, 5))
def test_integral_conditions_hold(seed: int, k: int) -> None:
    """u' = a with the mean of u^(2k-1) given and u(0) = 0: a is the root of it."""
    target = float(np.random.default_rng(seed).uniform(0.1, 2.0))
    u, a = ca.SX.sym("u"), ca.SX.sym("a")
    model = OdeModel("slope", u, a, a)
    power = 2 * k - 1
    problem = BoundaryValueProblem(model, [model.start(u)], [u**power - target], parameters={"a": 1.0}, free=["a"])
    found = problem.solve(lambda t: [t], tolerance=1e-9).parameters["a"]
    assert abs(found / (target * (power + 1)) ** (1 / power) - 1) < 1e-8
