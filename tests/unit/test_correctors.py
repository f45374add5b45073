"""Ipopt and Newton behind one interface, and the bordered linear algebra under Newton and the walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import gauss_problem

from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import duffing_frequency
from casadi_skin.lattice.tail import Place, Tail
from casadi_skin.lattice.tail_parameter import TailParameter
from casadi_skin.lattice.tail_problem import CoreWithTailProblem
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.ipopt import ArbitratedCorrector, IpoptCorrector
from casadi_skin.solve.newton import Corrector, NewtonCorrector, Status
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import OrbitProblem, SingularError

Array = NDArray[np.float64]
Make = Callable[[OrbitProblem], Corrector]

CORRECTORS: list[Make] = [NewtonCorrector, IpoptCorrector]
KINDS = ["trigonometric", "gauss quarter", "gauss half", "gauss full"]


def problem_of(chain: Chain, kind: str) -> OrbitProblem:
    if kind == "trigonometric":
        return TrigonometricProblem(chain.gauge_model(), 8)
    symmetry = SymmetryClass[kind.split()[1].upper()]
    return gauss_problem(chain.gauge_model(), round(8 * symmetry.value), symmetry, degree=4)


def linear_mode(problem: OrbitProblem, chain: Chain, mode: int) -> Array:
    q = np.sin(mode * np.pi * np.arange(1, chain.sites + 1) / (chain.sites + 1))
    return problem.pack(q / np.sqrt(chain.weights @ q**2), chain.linear_frequency(mode), 0.0)


def dense(problem: OrbitProblem, nonzeros: Array, row: Array) -> Array:
    matrix = np.zeros((problem.size, problem.size))
    np.add.at(matrix, problem.pattern, nonzeros)
    matrix[-1] = row
    return matrix


# Correctors ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("sites", "mode", "kappa"), [(1, 1, -1.0), (2, 2, 1.0), (6, 1, -0.4), (24, 24, 0.5)])
def test_ipopt_and_newton_agree_to_round_off(kind: str, sites: int, mode: int, kappa: float) -> None:
    chain = Chain(sites, 1.0, 0.25, np.sign(kappa))
    problem = problem_of(chain, kind)
    guess = linear_mode(problem, chain, mode)
    # First near the mode, then from there: what each corrector does with a guess of the usual quality.
    near = NewtonCorrector(problem).correct(guess, problem.parameter_row(), 0.8 * kappa).z
    found = [make(problem).correct(near, problem.parameter_row(), kappa) for make in CORRECTORS]
    for correction in found:
        assert correction.converged
        assert 1 <= correction.iterations <= 8
        assert problem.relative_residual(correction.z) < 1e-13
        assert correction.z[problem.parameter_index] == pytest.approx(kappa, rel=1e-14)
    newton, ipopt = (correction.z for correction in found)
    assert ipopt[problem.Omega_index] == pytest.approx(newton[problem.Omega_index], rel=1e-12)
    np.testing.assert_allclose(ipopt, newton, rtol=0, atol=1e-12 * np.abs(newton).max())


@pytest.mark.parametrize("together", [1, 2, 4])
@pytest.mark.parametrize("kind", ["trigonometric", "gauss full"])
def test_ipopt_confirms_several_orbits_at_once_and_moves_what_is_none(kind: str, together: int) -> None:
    """Three orbits: two stay the arrays they are, one that is put off comes back; rows and values are those of each."""
    chain = Chain(4, 1.0, 0.25, 1.0)
    problem = problem_of(chain, kind)
    mode, row = linear_mode(problem, chain, 2), problem.parameter_row()
    newton = NewtonCorrector(problem)
    orbits = [newton.correct(mode, row, kappa).z for kappa in (0.1, 0.2, 0.3)]
    mixed = np.cos(np.arange(problem.size))
    off = orbits[1] * (1.0 + 1e-3 * np.sin(np.arange(problem.size)))
    corrector = ArbitratedCorrector(problem, 1e-11, together=together)
    held = [(orbits[0], row, 0.1), (off, mixed, float(mixed @ orbits[1])), (orbits[2], mixed, float(mixed @ orbits[2]))]
    first, moved, last = corrector.confirm_all(held)
    assert all(correction.converged for correction in (first, moved, last))
    assert first.z is orbits[0]
    assert last.z is orbits[2]
    np.testing.assert_allclose(moved.z, orbits[1], rtol=0, atol=1e-10)


def test_ipopt_names_the_one_of_several_points_that_it_cannot_solve() -> None:
    chain = Chain(2, 1.0, 0.3, -1.0)
    problem = problem_of(chain, "trigonometric")
    row = problem.parameter_row()
    orbit = NewtonCorrector(problem).correct(linear_mode(problem, chain, 1), row, -0.1).z
    nowhere = np.zeros(problem.size)
    good, bad = ArbitratedCorrector(problem, 1e-11, together=3).confirm_all([(orbit, row, -0.1), (orbit, nowhere, 1.0)])
    assert good.z is orbit
    assert not bad.converged
    assert "Ipopt" in bad.message


def test_newton_gives_way_to_ipopt_where_its_steps_do_not_shrink(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(4, 1.0, 0.25, 1.0)
    problem = problem_of(chain, "trigonometric")
    row, corrector = problem.parameter_row(), ArbitratedCorrector(problem, 1e-11)
    expected = NewtonCorrector(problem).correct(linear_mode(problem, chain, 2), row, 0.2).z
    monkeypatch.setattr("casadi_skin.solve.ipopt.STEP_SHRINKAGE", 1e-9)
    found = corrector.correct(linear_mode(problem, chain, 2), row, 0.2)
    assert found.converged
    assert found.message == "Solve_Succeeded"
    np.testing.assert_allclose(found.z, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("make", CORRECTORS)
def test_a_row_that_mixes_all_unknowns_is_held(make: Make) -> None:
    """The arclength condition is one; any other that is not tangent to the family will do."""
    chain = Chain(5, 1.0, 0.3, 1.0)
    problem = problem_of(chain, "trigonometric")
    z = NewtonCorrector(problem).correct(linear_mode(problem, chain, 3), problem.parameter_row(), 0.5).z
    row = np.random.default_rng(0).normal(size=problem.size)
    row[problem.parameter_index] = 10.0
    value = float(row @ z) + 0.05
    correction = make(problem).correct(z, row, value)
    assert correction.converged
    assert row @ correction.z == pytest.approx(value, abs=1e-12)
    assert np.abs(problem.evaluate(correction.z)[0]).max() < 1e-11
    assert correction.z[problem.parameter_index] != z[problem.parameter_index]


@pytest.mark.parametrize("make", CORRECTORS)
def test_the_corrected_orbit_is_the_duffing_oscillators(make: Make) -> None:
    chain = Chain(1, 1.0, 0.0, 1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 20)
    correction = make(problem).correct(linear_mode(problem, chain, 1), problem.parameter_row(), 0.7)
    assert correction.converged
    exact = duffing_frequency(3.0, 1.0, np.sqrt(0.7))
    assert correction.z[problem.Omega_index] == pytest.approx(exact, rel=1e-14)


@pytest.mark.parametrize("make", CORRECTORS)
def test_the_guess_is_left_as_it_was(make: Make) -> None:
    chain = Chain(2, 1.0, 0.3, 1.0)
    problem = problem_of(chain, "trigonometric")
    guess = linear_mode(problem, chain, 1)
    before = guess.copy()
    assert make(problem).correct(guess, problem.parameter_row(), 0.2).converged
    np.testing.assert_array_equal(guess, before)


@pytest.mark.parametrize("make", CORRECTORS)
@pytest.mark.parametrize("sites", [1, 5, 24])
def test_a_guess_far_off_is_a_named_failure(make: Make, sites: int) -> None:
    chain = Chain(sites, 1.0, 0.25, -1.0)
    problem = problem_of(chain, "trigonometric")
    guess = 100.0 * linear_mode(problem, chain, 1)
    correction = make(problem).correct(guess, problem.parameter_row(), -0.3)
    assert not correction.converged
    assert correction.status in set(Status) - {Status.CONVERGED}


@pytest.mark.parametrize("make", CORRECTORS)
def test_an_amplitude_at_which_no_orbit_exists_is_a_named_failure(make: Make) -> None:
    """One softening site oscillates for S < 3 only."""
    chain = Chain(1, 1.0, 0.0, -1.0)
    problem = problem_of(chain, "trigonometric")
    for S in (5.0, 40.0):
        correction = make(problem).correct(linear_mode(problem, chain, 1), problem.parameter_row(), -S)
        # Coarse equations may have solutions of their own; an orbit that oscillates is none of them.
        assert not correction.converged or correction.z[problem.Omega_index] <= 0


@pytest.mark.parametrize(("make", "status"), [(NewtonCorrector, Status.SINGULAR), (IpoptCorrector, Status.INFEASIBLE)])
@pytest.mark.parametrize("sites", [1, 6])
def test_a_contradictory_condition_is_a_named_failure(make: Make, status: Status, sites: int) -> None:
    """0 . z = 1 has no solution."""
    chain = Chain(sites, 1.0, 0.25, -1.0)
    problem = problem_of(chain, "trigonometric")
    correction = make(problem).correct(linear_mode(problem, chain, 1), np.zeros(problem.size), 1.0)
    assert correction.status is status
    assert correction.message


@pytest.mark.parametrize(("make", "limit"), [(NewtonCorrector, 2), (IpoptCorrector, 2)])
def test_too_few_iterations_are_a_named_failure(
    make: Callable[[OrbitProblem, float, int], Corrector], limit: int
) -> None:
    chain = Chain(5, 1.0, 0.25, -1.0)
    problem = problem_of(chain, "trigonometric")
    correction = make(problem, 1e-12, limit).correct(linear_mode(problem, chain, 1), problem.parameter_row(), -0.4)
    assert correction.status is Status.TOO_MANY_ITERATIONS
    assert correction.iterations == limit


@pytest.mark.parametrize("make", CORRECTORS)
def test_a_guess_that_is_no_number_is_a_named_failure(make: Make) -> None:
    problem = problem_of(Chain(5, 1.0, 0.25, -1.0), "trigonometric")
    assert not make(problem).correct(np.full(problem.size, np.nan), problem.parameter_row(), -0.4).converged


def test_a_guess_of_frequency_zero_is_a_named_failure() -> None:
    chain = Chain(1, 1.0, 0.25, -1.0)
    problem = problem_of(chain, "trigonometric")
    guess = linear_mode(problem, chain, 1)
    guess[problem.Omega_index] = 0.0
    assert not NewtonCorrector(problem).correct(guess, problem.parameter_row(), -0.4).converged


def test_every_status_is_a_sentence_of_its_own() -> None:
    sentences = [status.value for status in Status]
    assert len(set(sentences)) == len(sentences) == len(list(Status))
    assert all(len(sentence) > 3 and sentence == sentence.strip() for sentence in sentences)


def test_ipopts_own_words_are_kept() -> None:
    chain = Chain(1, 1.0, 0.0, 1.0)
    problem = problem_of(chain, "trigonometric")
    correction = IpoptCorrector(problem).correct(linear_mode(problem, chain, 1), problem.parameter_row(), 0.1)
    assert correction.message == "Solve_Succeeded"


# Linear algebra -----------------------------------------------------------------------------------------------------


@pytest.fixture
def only_the_band(way: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """No way out to SuperLU: what follows is the band with the border, compiled and by LAPACK."""

    def refuse(*_: object) -> None:
        raise AssertionError("the band was not enough")

    monkeypatch.setattr(BorderedSolver, "_factor_sparse", refuse)


@pytest.mark.usefixtures("only_the_band")
@pytest.mark.parametrize("sites", [4, 5, 24, 60])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_band_agrees_with_dense_elimination_at_random_points(sites: int, seed: int) -> None:
    problem = TrigonometricProblem(Chain(sites, 1.0, 0.1, 1.0).gauge_model(), 5)
    random = np.random.default_rng(seed)
    z, row = random.normal(size=problem.size), random.normal(size=problem.size)
    z[problem.Omega_index] = 1.4
    _, nonzeros = problem.evaluate(z)
    solve = BorderedSolver(problem).factor(z, nonzeros, row)
    matrix = dense(problem, nonzeros, row)
    b = random.normal(size=(problem.size, 3))
    expected = np.linalg.solve(matrix, b)
    scale = np.abs(expected).max() * max(1.0, 1e-3 * float(np.linalg.cond(matrix)))
    np.testing.assert_allclose(solve(b), expected, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(solve(b[:, 1]), expected[:, 1], rtol=0, atol=1e-12 * scale)
    assert solve(b[:, 0]).shape == (problem.size,)


@pytest.mark.usefixtures("only_the_band")
@pytest.mark.parametrize("sites", [4, 24, 60])
@pytest.mark.parametrize("position", [0.0, 0.5, 1.0])
def test_the_largest_entry_may_be_anywhere(sites: int, position: float) -> None:
    """The pinned unknown sits at either end of the band or inside it."""
    problem = TrigonometricProblem(Chain(sites, 1.0, 0.1, 1.0).gauge_model(), 4)
    random = np.random.default_rng(7)
    z, row, b = (random.normal(size=problem.size) for _ in range(3))
    z[problem.Omega_index] = 1.4
    z[round(position * (problem.states - 1))] = 6.0
    _, nonzeros = problem.evaluate(z)
    expected = np.linalg.solve(dense(problem, nonzeros, row), b)
    found = BorderedSolver(problem).factor(z, nonzeros, row)(b)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.usefixtures("only_the_band")
@pytest.mark.parametrize(("sites", "mode"), [(4, 1), (5, 3), (23, 12), (24, 13), (24, 24), (60, 2)])
def test_the_band_is_solved_at_the_linear_mode_where_alone_it_is_singular(sites: int, mode: int) -> None:
    chain = Chain(sites, 1.0, 0.25, 1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 5)
    z = linear_mode(problem, chain, mode)
    _, nonzeros = problem.evaluate(z)
    row = problem.parameter_row()
    matrix = dense(problem, nonzeros, row)
    inner = matrix[: problem.states, : problem.states]
    assert np.linalg.norm(inner @ z[: problem.states]) < 1e-12 * np.linalg.norm(z)  # the mode is its null vector
    b = np.random.default_rng(1).normal(size=problem.size)
    expected = np.linalg.solve(matrix, b)
    found = BorderedSolver(problem).factor(z, nonzeros, row)(b)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(matrix @ found, b, rtol=0, atol=1e-10 * np.abs(matrix).max() * np.abs(found).max())


@pytest.mark.usefixtures("only_the_band")
def test_the_band_of_a_model_whose_couplings_are_not_symmetric_is_not_transposed() -> None:
    model = Chain(6, 1.0, 0.5, 1.0).physical_model()
    problem = TrigonometricProblem(replace(model, normalisation=ca.dot(model.state, model.state) - 1), 4)
    random = np.random.default_rng(3)
    z, row, b = (random.normal(size=problem.size) for _ in range(3))
    z[problem.Omega_index] = 1.4
    _, nonzeros = problem.evaluate(z)
    expected = np.linalg.solve(dense(problem, nonzeros, row), b)
    found = BorderedSolver(problem).factor(z, nonzeros, row)(b)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.usefixtures("only_the_band")
@pytest.mark.parametrize("attached", [0, 18, 37])
def test_the_band_is_wider_next_to_a_tail(attached: int) -> None:
    """Rows of the site at a tail are those of its harmonics: entries of its neighbours are farther off than others."""
    chain = Chain(38, 1.0, 0.4, -1.0)
    tail = TailParameter(Tail(399.0, np.array([[3.0]]), chain.coupling), Place(0, 0, 0.0), 6)
    problem = CoreWithTailProblem(chain.gauge_model(), 6, tail, attached)
    assert problem.half_bandwidth == 11
    random = np.random.default_rng(attached)
    z, row, b = (random.normal(size=problem.size) for _ in range(3))
    nonzeros = random.normal(size=problem.pattern[0].size)
    matrix = dense(problem, nonzeros, row)
    expected = np.linalg.solve(matrix, b)
    found = BorderedSolver(problem).factor(z, nonzeros, row)(b)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.linalg.cond(matrix) * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sites", [1, 3, 5])
def test_every_transcription_is_solved_as_dense_elimination_does(kind: str, sites: int) -> None:
    problem = problem_of(Chain(sites, 1.0, 0.25, 1.0), kind)
    random = np.random.default_rng(sites)
    z, row, b = (random.normal(size=problem.size) for _ in range(3))
    z[problem.Omega_index] = 1.4
    _, nonzeros = problem.evaluate(z)
    matrix = dense(problem, nonzeros, row)
    expected = np.linalg.solve(matrix, b)
    found = BorderedSolver(problem).factor(z, nonzeros, row)(b)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.linalg.cond(matrix) * np.abs(expected).max())


def test_a_band_that_is_given_up_is_solved_by_superlu(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = TrigonometricProblem(Chain(8, 1.0, 0.25, 1.0).gauge_model(), 4)
    random = np.random.default_rng(0)
    z, row, b = (random.normal(size=problem.size) for _ in range(3))
    z[problem.Omega_index] = 1.4
    _, nonzeros = problem.evaluate(z)
    solver = BorderedSolver(problem)
    if solver._kernel is not None:
        monkeypatch.setattr(solver._kernel, "steps", lambda *arguments: None)
    expected = np.linalg.solve(dense(problem, nonzeros, row), b)
    np.testing.assert_allclose(solver.factor(z, nonzeros, row)(b), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("sites", [1, 3, 8])
def test_a_row_that_repeats_an_equation_is_singular(sites: int) -> None:
    problem = TrigonometricProblem(Chain(sites, 1.0, 0.25, 1.0).gauge_model(), 4)
    z = np.random.default_rng(0).normal(size=problem.size)
    z[problem.Omega_index] = 1.4
    _, nonzeros = problem.evaluate(z)
    row = 2.0 * dense(problem, nonzeros, np.zeros(problem.size))[-2]
    for held in (row, np.zeros(problem.size)):
        with pytest.raises(SingularError, match=r"singular|factorised"):
            BorderedSolver(problem).factor(z, nonzeros, held)


@pytest.mark.parametrize("sites", [2, 6])
def test_a_linear_mode_where_all_frequencies_meet_is_singular(sites: int) -> None:
    """At |gamma| = 1 the gauge uncouples the sites: the Jacobian's null space has one dimension a site."""
    chain = Chain(sites, 1.0, 1.0, 1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 4)
    z = problem.pack(np.eye(sites)[-1], np.sqrt(3.0), 0.0)
    _, nonzeros = problem.evaluate(z)
    with pytest.raises(SingularError, match=r"singular|factorised"):
        BorderedSolver(problem).factor(z, nonzeros, problem.parameter_row())
