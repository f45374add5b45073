"""Newton steps at several states at once: dense elimination, determinants, and what is left to one state at a time."""

from __future__ import annotations

import numpy as np
import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.follow.polynomials import Stretch
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import Array


def dense(problem: TrigonometricProblem, nonzeros: Array, row: Array) -> Array:
    matrix = np.zeros((problem.size, problem.size))
    matrix[problem.pattern] = nonzeros
    matrix[-1] = row
    return matrix


def solver_of(problem: TrigonometricProblem) -> BorderedSolver:
    found = BorderedSolver.of(problem)
    assert found.takes_several
    return found


def random_states(problem: TrigonometricProblem, count: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """States, residuals with those of the closing rows, non-zeros, and closing rows."""
    random = np.random.default_rng(seed)
    z, rows = random.normal(size=(2, count, problem.size))
    z[:, problem.Omega_index] = 1.4
    residuals, nonzeros = problem.evaluate_all(z)
    return z, np.column_stack([residuals, random.normal(size=count)]), nonzeros, rows


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize(("sites", "harmonics"), [(4, 5), (24, 4), (24, 10), (60, 6)])
def test_steps_at_several_states_are_those_of_dense_elimination(sites: int, harmonics: int) -> None:
    problem = TrigonometricProblem(Chain(sites, 1.0, 0.1, 1.0).gauge_model(), harmonics)
    z, residuals, nonzeros, rows = random_states(problem, 7, sites)
    steps = solver_of(problem).steps(z, residuals, nonzeros, rows)
    assert steps is not None
    unit, probe = np.eye(problem.size)[-1], np.append(problem.probe, 0.0)
    signs = []
    for i in range(7):
        matrix = dense(problem, nonzeros[i], rows[i])
        signs.append(np.linalg.slogdet(matrix)[0])
        for found, b in ((steps.newton, residuals[i]), (steps.along, unit), (steps.response, probe)):
            expected = np.linalg.solve(matrix, b)
            allowed = 1e-14 * np.linalg.cond(matrix) * np.max(np.abs(expected))
            np.testing.assert_allclose(found[i], expected, rtol=0, atol=allowed)
    relative = steps.orientation * np.array(signs)  # one sign for all: that of a permutation
    assert np.all(np.abs(relative) == 1.0)
    assert np.all(relative == relative[0])
    assert len(set(signs)) == 2  # both signs are among the states


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("fault", ["singular", "not a number", "inaccurate"])
def test_one_state_that_cannot_be_solved_leaves_all_to_the_solver_of_one(
    fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = TrigonometricProblem(Chain(24, 1.0, 0.25, 1.0).gauge_model(), 4)
    z, residuals, nonzeros, rows = random_states(problem, 3, 0)
    assert solver_of(problem).steps(z, residuals, nonzeros, rows) is not None
    if fault == "singular":
        rows[1] = dense(problem, nonzeros[1], rows[1])[5]  # repeats an equation
    elif fault == "not a number":
        nonzeros[1, 7] = np.nan
    else:
        monkeypatch.setattr("casadi_skin.solve.bordered.ACCURATE_RESIDUAL", 0.0)
        problem.shared.clear()
    assert solver_of(problem).steps(z, residuals, nonzeros, rows) is None


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("others", [1, 2, 5, 11])
def test_the_last_bits_of_a_state_do_not_depend_on_the_others(others: int) -> None:
    """A run that goes on has other batches than one that was not interrupted, and ends with the same bytes."""
    problem, finer = (TrigonometricProblem(Chain(24, 1.0, 0.25, -1.0).gauge_model(), H) for H in (6, 8))
    z, residuals, nonzeros, rows = random_states(problem, 12, 3)
    solver, stretch = solver_of(problem), Stretch(np.random.default_rng(1).normal(size=(12, problem.size)), 1.0)

    def of(chosen: slice) -> list[Array]:
        steps = solver.steps(z[chosen], residuals[chosen], nonzeros[chosen], rows[chosen])
        assert steps is not None
        here = z[chosen]
        return [
            steps.newton, steps.along, steps.response, steps.orientation, problem.all_prolonged(here, finer),
            problem.roundings(here), problem.metrics(here, 2.0), problem.profile_changes(here, rows[chosen]),
            *problem.evaluate_all(here), *stretch.at_each(here[:, 0]),
        ]  # fmt: skip

    for alone, among in zip(of(slice(12 - others, 12)), of(slice(None)), strict=True):
        np.testing.assert_array_equal(alone, among[12 - others :])


def test_a_family_is_the_same_where_its_places_are_polished_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(24, 1.0, 0.25, -1.0)
    at_once = follow_family(chain, 1, 3.0, at=(0.2, 1.0), corrector="newton")
    monkeypatch.setattr(BorderedSolver, "takes_several", False)
    one_by_one = follow_family(chain, 1, 3.0, at=(0.2, 1.0), corrector="newton")
    assert at_once.complete
    assert one_by_one.complete
    np.testing.assert_allclose(at_once.S, one_by_one.S, rtol=0, atol=1e-10)
    np.testing.assert_allclose(at_once.Omega, one_by_one.Omega, rtol=0, atol=1e-13)
    errors = [[orbit.point.error.relative(orbit.Omega) for orbit in family.orbits] for family in (at_once, one_by_one)]
    np.testing.assert_allclose(*errors, rtol=1e-2, atol=1e-13)
