"""The error of a solution from its defect on its own mesh, beside true errors of closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casadi_skin import BoundaryValueProblem, OdeModel, find_equilibrium, find_orbit
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.discretisation import missed

t, x, y, p = (ca.SX.sym(name) for name in ("t", "x", "y", "p"))


def oscillator() -> BoundaryValueProblem:
    """x = sin t on (0, 3), with its frequency free: x(0) = 0, x'(0) = 1, x(3) = sin 3."""
    model = OdeModel("oscillator", ca.vertcat(x, y), ca.vertcat(y, -(p**2) * x), p)
    conditions = [model.start(x), model.start(y) - 1, model.end(x) - np.sin(3.0)]
    return BoundaryValueProblem(model, conditions, interval=(0.0, 3.0), parameters={"p": 1.1}, free=["p"])


def growth() -> BoundaryValueProblem:
    """x = 3 t^2 exp(t), whose integral over (0, 1) is 3 (e - 2), with the factor 3 free."""
    rate = p * (2 * t + t**2) * ca.exp(t) + x - p * t**2 * ca.exp(t)
    model = OdeModel("growth", x, rate, p, time=t, forcing_period=1.0)
    mean = x - 3.0 * (np.e - 2.0)
    return BoundaryValueProblem(model, [model.start(x)], [mean], parameters={"p": 2.0}, free=["p"])


EXACT = {
    oscillator: lambda s: np.stack([np.sin(s), np.cos(s)], axis=1),
    growth: lambda s: (3 * s**2 * np.exp(s))[:, None],
}


METHODS = [("gauss", 2), ("gauss", 3), ("gauss", 4), ("radau", 2), ("radau", 3)]


def improvement(found: Solution, away: float = 0.0) -> tuple[np.ndarray, float] | None:  # type: ignore[type-arg]
    """The step to a better solution and its size, with factors from where the free parameter is larger."""
    problem, z = found.problem, found.point.z
    there = z.copy()
    there[problem.states] += away
    solve = BorderedSolver(problem).factor(there, problem.evaluate(there)[1], problem.parameter_row())
    improved = problem.improvement(z, solve)
    return None if improved is None else (improved[0], problem.profile_change(z, *improved))


@pytest.mark.parametrize("state", [oscillator, growth])
@pytest.mark.parametrize(("transcription", "degree"), METHODS)
def test_the_estimate_is_the_true_error(state, transcription: str, degree: int) -> None:  # type: ignore[no-untyped-def]
    method = {"transcription": transcription, "degree": degree, "intervals": 40}
    found = state().solve([0.0] * state().model.full_size, tolerance=1e-3, **method)
    s = np.linspace(*found.interval, 4001)
    exact = EXACT[state](s)
    off = np.abs(found.evaluate(s) - exact)
    true = np.max(np.max(off, axis=0) / np.max(np.abs(exact), axis=0))
    improved = improvement(found)
    step, error = improved
    of_parameter = abs(step[found.problem.states])
    assert 0.99 * true < error < 1.6 * true
    parameter = abs(found["p"] - {oscillator: 1.0, growth: 3.0}[state])
    assert 0.99 * parameter < of_parameter + 1e-14 < 3.0 * parameter + 1e-13
    assert found.error > 1.9 * true
    states = (found.point.z - step)[: found.problem.states].reshape(found.states.shape)
    assert np.max(np.abs(states - EXACT[state](found.t))) < 0.6 * np.max(np.abs(found.states - EXACT[state](found.t)))


def test_factors_of_another_jacobian_are_not_trusted() -> None:
    found = oscillator().solve([0.0, 0.0], tolerance=1e-8)
    assert improvement(found, 1e-3) is not None
    assert improvement(found, 2.0) is None


def test_a_defect_that_is_not_finite_leaves_the_error_to_a_finer_mesh() -> None:
    """x' = t log t: the field has no value at the start, which only the defect asks for."""
    model = OdeModel("logarithm", x, 0 * x + t * ca.log(t), time=t, forcing_period=1.0)
    stated = BoundaryValueProblem(model, [model.start(x)])
    found = stated.solve([0.0], tolerance=1e-4)
    problem, z = found.problem, found.point.z
    solve = BorderedSolver(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())
    assert problem.improvement(z, solve) is None
    assert abs(found.evaluate([1.0])[0, 0] + 0.25) <= found.error < 1e-4


def test_rounding_of_the_defect_does_not_grow_with_the_number_of_intervals() -> None:
    """A constant x = 1000 beside sin t: the defect of what does not change is zero to the last bit."""
    model = OdeModel("beside", ca.vertcat(x, y), ca.vertcat(0 * x, -ca.sin(t)), time=t, forcing_period=2 * np.pi)
    stated = BoundaryValueProblem(model, [model.start(x) - 1000, model.start(y) - 1], interval=(0.0, 3.0))
    found = stated.solve([1000.0, 1.0], tolerance=1e-8, intervals=200)
    left, _ = missed(found.problem.discretisation, found.point.z, found.problem.numbers)
    assert np.all(left[: found.problem.states - 2].reshape(-1, 2)[:, 0] == 0.0)


# Along branches: the error that is reported beside that of the same orbit on a mesh four times finer -----------------


def van_der_pol(**method: object) -> Branch:
    model = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, p * (1 - x**2) * y - x), p)
    guess = lambda t: [2.0 * np.cos(t), -2.0 * np.sin(t)]  # noqa: E731
    return find_orbit(model, guess, 6.6, parameters={"p": 1.0}, **method).follow("p", 8.0)


def duffing(**method: object) -> Branch:
    rate = -0.1 * y - x - x**3 + 0.5 * ca.cos(p * t)
    model = OdeModel("Duffing", ca.vertcat(x, y), ca.vertcat(y, rate), p, time=t, forcing_period=2 * ca.pi / p)
    guess = lambda t: [0.6 * np.cos(0.5 * t), -0.3 * np.sin(0.5 * t)]  # noqa: E731
    return find_orbit(model, guess, parameters={"p": 0.5}, **method).follow("p", 1.2)


def brusselator(tolerance: float) -> Branch:
    model = OdeModel("Brusselator", ca.vertcat(x, y), ca.vertcat(1 + x**2 * y - (p + 1) * x, p * x - x**2 * y), p)
    rests = find_equilibrium(model, [1.0, 1.5], parameters={"p": 1.5}).follow("p", 3.0)
    (hopf,) = (point for point in rests.special_points if point.kind == "hopf")
    return hopf.follow("p", 4.0, tolerance=tolerance)


def ratios(branch: Branch) -> list[float]:
    """Errors by true ones of some orbits whose parameter changes along the branch."""
    found = []
    for solution in branch.solutions[1 :: max(1, len(branch.solutions) // 6)]:
        point = solution.point
        problem, z, K = point.problem, point.z, point.problem.resolution
        fine = branch.space.levels._build(4 * K).with_constants(np.repeat(problem.constants / 4.0, 4))
        guess, row = problem.prolong(z, fine), fine.parameter_row()
        off = NewtonCorrector(fine, 1e-13).correct(guess, row, float(row @ guess)).z - guess
        true = max(fine.frequency_step(guess, off), fine.profile_change(guess, off))
        found.append(point.error.relative(1.0) / true)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-5, 1e-7, 1e-9])
@pytest.mark.parametrize("along", [van_der_pol, duffing, brusselator])
def test_errors_along_branches_are_twice_the_true_ones(along, tolerance: float) -> None:  # type: ignore[no-untyped-def]
    found = ratios(along(tolerance=tolerance))
    assert min(found) > 1.5
    assert 1.9 < np.median(found) < 2.3


@pytest.mark.slow
@pytest.mark.parametrize(("transcription", "degree"), [("gauss", 3), ("radau", 4)])
def test_errors_along_branches_by_other_methods(transcription: str, degree: int) -> None:
    for along in (van_der_pol, duffing):
        found = ratios(along(tolerance=1e-6, transcription=transcription, degree=degree))
        assert min(found) > 1.0
        assert np.median(found) < 4.0


@pytest.mark.slow
def test_errors_of_periods_are_honest_where_a_step_leaves_the_period_as_it_is() -> None:
    """Three coupled van der Pol oscillators: what a step changes of the period goes through zero along the branch."""
    xs, ys, squares = [ca.SX.sym(f"x{i}") for i in range(3)], [ca.SX.sym(f"y{i}") for i in range(3)], (1.0, 1.02, 0.97)
    pushes = [
        p * (1 - xs[i] ** 2) * ys[i] - squares[i] * xs[i] + 0.3 * (xs[(i + 1) % 3] - 2 * xs[i] + xs[i - 1])
        for i in range(3)
    ]
    model = OdeModel("three", ca.vertcat(*xs, *ys), ca.vertcat(*ys, *pushes), p)
    start = find_orbit(
        model, lambda t: [2 * np.cos(t)] * 3 + [-2 * np.sin(t)] * 3, 6.6, parameters={"p": 0.5}, tolerance=1e-5
    )
    orbits = [orbit for orbit in start.follow("p", 2.0).orbits if 1.41 < orbit.parameters["p"] < 1.6]
    assert len(orbits) > 4
    for orbit in orbits:
        exact = find_orbit(model, orbit, orbit.period, parameters={"p": orbit.parameters["p"]}, tolerance=1e-10)
        rounding = 1e-14 + exact.point.error.Omega
        assert abs(orbit.Omega - exact.Omega) <= orbit.point.error.Omega + rounding, orbit.parameters
