"""Newton's method and Ipopt behind one interface, and the bordered linear algebra under Newton and the walk."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone
from numpy.typing import NDArray
from orbit_problems import gauss_problem, linear_mode
from small_models import oscillation

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit
from casadi_skin.follow.find import packed, space_of
from casadi_skin.follow.point import LocalCurve
from casadi_skin.follow.space import BoundaryError
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.core_with_tail import CoreWithTailProblem
from casadi_skin.lattice.tail import Place, Tail
from casadi_skin.lattice.tail_parameter import TailParameter
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.solve import ipopt, watch
from casadi_skin.solve.bordered import BorderedSolver, DenseFactors
from casadi_skin.solve.ipopt import STEP_SHRINKAGE, ArbitratedCorrector, IpoptCorrector
from casadi_skin.solve.newton import Correction, NewtonCorrector, Status
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import OrbitProblem, Problem, SingularError
from casadi_skin.zero.stated_problem import BoundaryProblem, stated

Array = NDArray[np.float64]

CORRECTORS: list[type[NewtonCorrector] | type[IpoptCorrector]] = [NewtonCorrector, IpoptCorrector]
KINDS = ["trigonometric", "gauss quarter", "gauss half", "gauss full"]


def problem_of(chain: Chain, kind: str = "trigonometric", harmonics: int = 8) -> OrbitProblem:
    if kind == "trigonometric":
        return TrigonometricProblem(chain.gauge_model(), harmonics)
    symmetry = SymmetryClass[kind.split()[1].upper()]
    return gauss_problem(chain.gauge_model(), round(8 * symmetry.value), symmetry, degree=4)


def mode_of(problem: OrbitProblem, chain: Chain, mode: int) -> Array:
    return problem.pack(linear_mode(chain, mode), chain.linear_frequency(mode), 0.0)


def dense(problem: Problem, nonzeros: Array, row: Array) -> Array:
    matrix = np.zeros((problem.size, problem.size))
    np.add.at(matrix, problem.pattern, nonzeros)
    matrix[-1] = row
    return matrix


def line() -> tuple[BoundaryProblem, Array]:
    """u'' = u, u(0) = 0, u(1) = 1 on five intervals, and zeros as a guess."""
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    model = OdeModel("line", ca.vertcat(u, v), ca.vertcat(v, u))
    problem = BoundaryValueProblem(model, [model.start(u), model.end(u) - 1.0])
    found = stated(space_of(problem, [0.0, 0.0], {}).levels.problem(5))
    return found, np.zeros(found.size)


# Correctors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("sites", "mode", "kappa"), [(1, 1, -1.0), (2, 2, 1.0), (6, 1, -0.4), (24, 24, 0.5)])
def test_ipopt_and_newton_agree_to_round_off(kind: str, sites: int, mode: int, kappa: float) -> None:
    chain = Chain(sites, 1.0, 0.25, np.sign(kappa))
    problem = problem_of(chain, kind)
    # First near the mode, then from there: what each corrector does with a guess of the usual quality.
    guess = mode_of(problem, chain, mode)
    near = NewtonCorrector(problem).correct(guess, problem.parameter_row(), 0.8 * kappa).z
    before = near.copy()
    found = [make(problem).correct(near, problem.parameter_row(), kappa) for make in CORRECTORS]
    np.testing.assert_array_equal(near, before)
    for correction in found:
        assert correction.converged
        assert 1 <= correction.iterations <= 8
        assert problem.relative_residual(correction.z) < 1e-13
        assert correction.z[problem.parameter_index] == pytest.approx(kappa, rel=1e-14)
    newton, by_ipopt = (correction.z for correction in found)
    assert by_ipopt[problem.Omega_index] == pytest.approx(newton[problem.Omega_index], rel=1e-12)
    np.testing.assert_allclose(by_ipopt, newton, rtol=0, atol=1e-12 * np.abs(newton).max())
    assert found[1].message == "Solve_Succeeded"


@pytest.mark.parametrize("together", [1, 2, 4])
@pytest.mark.parametrize("kind", ["trigonometric", "gauss full"])
def test_ipopt_confirms_several_orbits_at_once_and_moves_or_names_what_is_none(kind: str, together: int) -> None:
    """Two stay the arrays they are, one that is put off comes back; rows and values are those of each."""
    chain = Chain(4, 1.0, 0.25, 1.0)
    problem = problem_of(chain, kind)
    mode, row, newton = mode_of(problem, chain, 2), problem.parameter_row(), NewtonCorrector(problem)
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
    good, bad = corrector.confirm_all([held[0], (orbits[2], np.zeros(problem.size), 1.0)])
    assert good.z is orbits[0]
    assert not bad.converged
    assert "Ipopt" in bad.message


def test_newton_gives_way_to_ipopt_where_its_steps_do_not_shrink(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else they may lead anywhere: from 1.9 by 4.8 and 13.5 to the root 4 pi of the sine."""
    x = ca.SX.sym("x")
    model = OdeModel("constant", x, ca.SX(0.0))
    problem = BoundaryValueProblem(model, [ca.sin(model.start(x))])
    by_newton, found = (problem.solve([1.9], corrector=c).states[0, 0] for c in ("newton", "ipopt"))
    assert by_newton == pytest.approx(4 * np.pi, abs=1e-12)
    assert found == pytest.approx(np.pi, abs=1e-12)
    chain = Chain(4, 1.0, 0.25, 1.0)
    family = problem_of(chain)
    row, guess = family.parameter_row(), mode_of(family, chain, 2)
    expected = NewtonCorrector(family).correct(guess, row, 0.2).z
    monkeypatch.setattr(ipopt, "STEP_SHRINKAGE", 1e-9)
    correction = ArbitratedCorrector(family, 1e-11).correct(guess, row, 0.2)
    assert correction.message == "Solve_Succeeded"
    np.testing.assert_allclose(correction.z, expected, rtol=0, atol=1e-9)


def test_the_last_word_is_ipopts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solution stays as it is where Ipopt agrees, becomes Ipopt's where it moves it, and is refused with it."""
    problem, guess = line()
    corrector, row = ArbitratedCorrector(problem, far=True), problem.parameter_row()
    z = corrector.correct(guess, row, 0.0).z
    assert problem.sample(z, np.array([0.5]))[0, 0] == pytest.approx(np.sinh(0.5) / np.sinh(1.0), abs=1e-12)
    for one_scalar in (False, True):
        other = IpoptCorrector(problem, 1e-12, 20, one_scalar).correct(guess, row, 0.0)
        np.testing.assert_allclose(other.z, z, atol=1e-11)
    assert corrector.confirm_all([(z, row, 0.0)])[0].z is z
    (moved,) = corrector.confirm_all([(z + 1e-4 * (row == 0.0), row, 0.0)])
    np.testing.assert_allclose(moved.z, z, atol=1e-11)
    with monkeypatch.context() as patch:
        patch.setattr(NewtonCorrector, "correct", lambda *_: Correction(guess, Status.DIVERGED, 1))
        assert corrector.correct(guess, row, 0.0).converged
    refuse = lambda self, z, *_: Correction(z + 1e-6, Status.INFEASIBLE, 3, "Ipopt: no")  # noqa: E731
    monkeypatch.setattr(IpoptCorrector, "correct", refuse)
    monkeypatch.setattr(ArbitratedCorrector, "_is_optimal", lambda *_: False)  # or Ipopt is not asked
    with pytest.raises(BoundaryError, match="no point near the guess satisfies the equations"):
        oscillation()


def test_newton_with_smaller_residuals_finds_what_ipopt_finds() -> None:
    """A wave around a ring of van der Pol oscillators: from a guess whose first steps do not halve, both halve them."""
    units, T = 30, ca.SX.sym("T")
    x, y = (ca.SX.sym(name, units) for name in "xy")
    beside = ca.vertcat(x[-1], x[:-1]) + ca.vertcat(x[1:], x[0]) - 2 * x
    model = OdeModel("ring", ca.vertcat(x, y), T * ca.vertcat(y, 0.5 * (1 - x**2) * y - x + 0.1 * beside), T)
    closure = model.start(model.full_state) - model.end(model.full_state)
    phase = [lambda t, x, p: ca.sin(2 * np.pi * t) * x[0]]
    problem = BoundaryValueProblem(model, [closure], phase, parameters={"T": 6.4}, free=["T"])
    phases = 2 * np.pi * np.arange(units) / units
    wave = lambda t: 2 * np.concatenate([np.cos(2 * np.pi * t - phases), -np.sin(2 * np.pi * t - phases)])  # noqa: E731
    discrete = stated(space_of(problem, wave, {}).levels.problem(5))
    guess, row = 1.3 * packed(discrete, wave), discrete.parameter_row()
    assert not NewtonCorrector(discrete, shrink=STEP_SHRINKAGE).correct(guess, row, 0.0).converged
    found = NewtonCorrector(discrete, 1e-10, 30, decreasing=True).correct(guess, row, 0.0)
    expected = IpoptCorrector(discrete, 1e-10, 60).correct(guess, row, 0.0)
    assert found.converged
    assert expected.converged
    np.testing.assert_allclose(found.z, expected.z, rtol=0, atol=1e-7)


@pytest.mark.parametrize("make", CORRECTORS)
@pytest.mark.parametrize("sites", [1, 6])
def test_what_cannot_be_corrected_is_a_named_failure(make: Any, sites: int) -> None:
    chain = Chain(sites, 1.0, 0.25, -1.0)
    problem = problem_of(chain)
    mode, row = mode_of(problem, chain, 1), problem.parameter_row()
    for guess in (100.0 * mode, np.full(problem.size, np.nan)):
        correction = make(problem).correct(guess, row, -0.3)
        assert not correction.converged
        assert correction.status in set(Status) - {Status.CONVERGED}
    contradictory = make(problem).correct(mode, np.zeros(problem.size), 1.0)  # 0 . z = 1
    assert contradictory.status is (Status.SINGULAR if make is NewtonCorrector else Status.INFEASIBLE)
    assert contradictory.message
    for limit in (1, 2):
        correction = make(problem, 1e-12, limit).correct(mode, row, -0.4)
        assert (correction.status, correction.iterations) == (Status.TOO_MANY_ITERATIONS, limit)
    if sites == 1:  # oscillates for S < 3 only; coarse equations may have solutions of their own
        for S in (5.0, 40.0):
            correction = make(problem).correct(mode, row, -S)
            assert not correction.converged or correction.z[problem.Omega_index] <= 0
    mode[problem.Omega_index] = 0.0
    assert not NewtonCorrector(problem).correct(mode, row, -0.4).converged


def test_ipopt_ends_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, guess = line()
    corrector, calls = IpoptCorrector(problem), iter(range(1000))
    monkeypatch.setattr(watch, "is_over", lambda: next(calls) > 1)
    monkeypatch.setattr(ipopt, "is_over", watch.is_over)
    with watch.watched(10.0), pytest.raises(watch.TimeLimitError, match="the time allowed, 10 s, is over, at Ipopt"):
        corrector.correct(guess, problem.parameter_row(), 0.0)


# Linear algebra: one state --------------------------------------------------------------------------------------------


@pytest.fixture
def only_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """No way out to SuperLU: what follows is the band with the border, compiled."""

    def refuse(*_: object) -> None:
        raise AssertionError("the band was not enough")

    monkeypatch.setattr(BorderedSolver, "unchecked", refuse)


def check_solved(problem: Problem, z: Array, row: Array, nonzeros: Array | None = None) -> None:
    """One right-hand side and several are solved for as by dense elimination."""
    given = problem.evaluate(z)[1] if nonzeros is None else nonzeros
    matrix = dense(problem, given, row)
    b = np.random.default_rng(1).normal(size=(problem.size, 3))
    solve, expected = BorderedSolver(problem).factor(z, given, row), np.linalg.solve(matrix, b)
    allowed = 1e-13 * np.linalg.cond(matrix) * np.abs(expected).max()
    np.testing.assert_allclose(solve(b), expected, rtol=0, atol=allowed)
    np.testing.assert_allclose(solve(b[:, 1]), expected[:, 1], rtol=0, atol=allowed)


def circle(faint: bool) -> tuple[BoundaryProblem, Array]:
    """Of radius 1 about a point, with a third state of no size where it is `faint`; and the circle a little off."""
    x, y, w, mu = (ca.SX.sym(name) for name in ("x", "y", "w", "mu"))
    grows = mu - x**2 - y**2
    model = OdeModel("circle", [x, y, w], [grows * x - y, x + grows * y, -w + (0 if faint else x * y)], mu)

    def guess(t: float) -> list[float]:
        return [np.cos(t), np.sin(t), 0.0 if faint else 0.2 * np.sin(2.0 * t)]

    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"mu": 1.0})
    space = replace(orbit.space, parameter="mu", to=2.0)
    problem = stated(space.levels.problem(9))
    mesh = 1.0 + 0.3 * np.cos(np.arange(9.0))
    problem = problem.with_constants(mesh / mesh.sum())
    return problem, orbit.problem.prolong(orbit.point.z, problem)


@needs_kernels
@pytest.mark.parametrize("faint", [False, True])
@pytest.mark.parametrize(("off", "value", "shrink", "status"), [
    (0.0, 0.0, None, Status.CONVERGED), (1e-9, 1e-4, 0.2, Status.CONVERGED), (1e-4, 0.01, 0.2, Status.CONVERGED),
    (0.03, 0.3, None, Status.CONVERGED), (1.0, 0.3, 0.2, Status.DIVERGED), (1.0, 0.3, None, Status.TOO_MANY_ITERATIONS),
])  # fmt: skip
def test_a_correction_in_one_call_takes_the_steps_of_numpy(
    faint: bool, off: float, value: float, shrink: float | None, status: Status
) -> None:
    """It ends alike, in as many steps, at the same point, also where it diverges; factors are of a matrix there."""
    problem, z = circle(faint)
    guess = z + off * np.random.default_rng(3).normal(size=z.size)
    row, corrector = problem.parameter_row(), NewtonCorrector(problem, 1e-11, 8, shrink)
    weights = problem.metric(guess, 1.0)
    compiled = corrector._in_one_call(guess, row, value, weights)
    with numpy_alone():
        other, _ = circle(faint)
        assert NewtonCorrector(other)._in_one_call(guess, row, value, weights) is None
        np.testing.assert_allclose(other.metric(guess, 1.0), weights, rtol=1e-15)
        assert other.speed_ratio(guess) == pytest.approx(problem.speed_ratio(guess), rel=1e-14)
        plain = NewtonCorrector(other, 1e-11, 8, shrink)._in_steps(guess, row, value, weights)
    assert compiled.status is plain.status is status
    assert compiled.iterations == plain.iterations
    np.testing.assert_allclose(compiled.z, plain.z, rtol=0, atol=1e-12)
    if compiled.converged:
        residual, nonzeros = problem.evaluate(compiled.z)
        assert max(np.max(np.abs(residual)), abs(row @ compiled.z - value)) < 1e-11
        np.testing.assert_allclose(residual, other.evaluate(compiled.z)[0], rtol=0, atol=1e-14)
        b = np.ones(z.size)
        np.testing.assert_allclose(dense(problem, nonzeros, row) @ compiled.solve(b), b, rtol=0, atol=0.1)


def random_state(problem: OrbitProblem, seed: int) -> tuple[Array, Array]:
    z, row = np.random.default_rng(seed).normal(size=(2, problem.size))
    z[problem.Omega_index] = 1.4
    return z, row


@needs_kernels
@pytest.mark.usefixtures("only_the_band")
@pytest.mark.parametrize("sites", [4, 5, 24, 60])
@pytest.mark.parametrize("largest", [None, 0.0, 0.5, 1.0])
def test_the_band_is_solved_wherever_its_largest_entry_is(sites: int, largest: float | None) -> None:
    """The pinned unknown sits at either end of the band or inside it; couplings need not be symmetric."""
    chain = Chain(sites, 1.0, 0.1, 1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 5)
    z, row = random_state(problem, sites)
    if largest is not None:
        z[round(largest * (problem.states - 1))] = 6.0
    check_solved(problem, z, row)
    model = replace(chain, gamma=0.5).physical_model()
    other = TrigonometricProblem(replace(model, normalisation=ca.dot(model.state, model.state) - 1), 5)
    check_solved(other, z, row)


@needs_kernels
@pytest.mark.usefixtures("only_the_band")
@pytest.mark.parametrize("attached", [0, 18, 37])
def test_the_band_is_wider_next_to_a_tail(attached: int) -> None:
    """Rows of the site at a tail are those of its harmonics: entries of its neighbours are farther off than others."""
    chain = Chain(38, 1.0, 0.4, -1.0)
    tail = TailParameter(Tail(399.0, np.array([[3.0]]), chain.coupling), Place(0), 6)
    problem = CoreWithTailProblem(chain.gauge_model(), 6, tail, attached)
    assert problem.half_bandwidth == 11
    z, row = random_state(problem, attached)
    check_solved(problem, z, row, np.random.default_rng(attached).normal(size=problem.pattern[0].size))


def test_a_band_that_is_given_up_is_solved_by_superlu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("casadi_skin.native.BorderedKernel.steps", lambda *_: None)
    problem = problem_of(Chain(8, 1.0, 0.25, 1.0), harmonics=4)
    check_solved(problem, *random_state(problem, 0))


@pytest.mark.parametrize("sites", [1, 3, 8])
def test_what_is_singular_is_refused(sites: int) -> None:
    """A row that repeats an equation, or is empty; and all frequencies at once: at |gamma| = 1 sites are uncoupled."""
    problem = problem_of(Chain(sites, 1.0, 0.25, 1.0), harmonics=4)
    z, _ = random_state(problem, 0)
    nonzeros = problem.evaluate(z)[1]
    cases = [(problem, z, nonzeros, 2.0 * dense(problem, nonzeros, np.zeros(problem.size))[-2])]
    cases.append((problem, z, nonzeros, np.zeros(problem.size)))
    if sites > 1:
        alone = problem_of(Chain(sites, 1.0, 1.0, 1.0), harmonics=4)
        at = alone.pack(np.eye(sites)[-1], np.sqrt(3.0), 0.0)
        cases.append((alone, at, alone.evaluate(at)[1], alone.parameter_row()))
    for of, at, values, row in cases:
        with pytest.raises(SingularError, match=r"singular|factorised"):
            BorderedSolver(of).factor(at, values, row)


# Linear algebra: several states ---------------------------------------------------------------------------------------


def random_states(problem: TrigonometricProblem, count: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """States, residuals with those of the closing rows, non-zeros, and closing rows."""
    random = np.random.default_rng(seed)
    z, rows = random.normal(size=(2, count, problem.size))
    z[:, problem.Omega_index] = 1.4
    residuals, nonzeros = problem.evaluate_all(z)
    return z, np.column_stack([residuals, random.normal(size=count)]), nonzeros, rows


@needs_kernels
@pytest.mark.parametrize(("sites", "harmonics"), [(4, 5), (24, 4), (24, 10), (60, 6)])
def test_steps_at_several_states_are_those_of_dense_elimination(sites: int, harmonics: int) -> None:
    problem = TrigonometricProblem(Chain(sites, 1.0, 0.1, 1.0).gauge_model(), harmonics)
    z, residuals, nonzeros, rows = random_states(problem, 7, sites)
    steps = BorderedSolver.of(problem).steps(z, residuals, nonzeros, rows)
    unit, probe, signs = np.eye(problem.size)[-1], np.append(problem.probe, 0.0), []
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


@needs_kernels
@pytest.mark.parametrize("fault", ["singular", "not a number", "inaccurate"])
def test_one_state_that_cannot_be_solved_leaves_all_to_the_solver_of_one(
    fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = TrigonometricProblem(Chain(24, 1.0, 0.25, 1.0).gauge_model(), 4)
    z, residuals, nonzeros, rows = random_states(problem, 3, 0)
    assert BorderedSolver.of(problem).steps(z, residuals, nonzeros, rows) is not None
    if fault == "singular":
        rows[1] = dense(problem, nonzeros[1], rows[1])[5]  # repeats an equation
    elif fault == "not a number":
        nonzeros[1, 7] = np.nan
    else:
        monkeypatch.setattr("casadi_skin.solve.bordered.ACCURATE_RESIDUAL", 0.0)
        problem.shared.clear()
    assert BorderedSolver.of(problem).steps(z, residuals, nonzeros, rows) is None


@needs_kernels
@pytest.mark.parametrize("others", [1, 2, 5, 11])
def test_the_last_bits_of_a_state_do_not_depend_on_the_others(others: int) -> None:
    """A run that goes on has other batches than one that was not interrupted, and ends with the same bytes."""
    problem, finer = (TrigonometricProblem(Chain(24, 1.0, 0.25, -1.0).gauge_model(), H) for H in (6, 8))
    z, residuals, nonzeros, rows = random_states(problem, 12, 3)
    solver, stretch = (
        BorderedSolver.of(problem),
        LocalCurve(np.random.default_rng(1).normal(size=(12, problem.size)), 1.0),
    )

    def of(chosen: slice) -> list[Array]:
        steps = solver.steps(z[chosen], residuals[chosen], nonzeros[chosen], rows[chosen])
        here = z[chosen]
        return [
            steps.newton, steps.along, steps.response, steps.orientation, problem.all_prolonged(here, finer),
            problem.roundings(here), problem.metrics(here, 2.0), problem.profile_changes(here, rows[chosen]),
            *problem.evaluate_all(here), *stretch.at_each(here[:, 0]),
        ]  # fmt: skip

    for alone, among in zip(of(slice(12 - others, 12)), of(slice(None)), strict=True):
        np.testing.assert_array_equal(alone, among[12 - others :])


@pytest.mark.parametrize("size", [2, 5, 9])
def test_dense_factors_solve_and_know_the_sign_of_the_determinant(size: int) -> None:
    for matrix in np.random.default_rng(size).normal(size=(8, size, size)):
        factors, b = DenseFactors(matrix), np.arange(2.0 * size).reshape(size, 2)
        np.testing.assert_allclose(matrix @ factors(b), b, rtol=0, atol=1e-10)
        assert factors.orientation == np.sign(np.linalg.det(matrix))
    with pytest.raises(SingularError, match="pivot 2 is zero"):
        DenseFactors(np.ones((2, 2)))
