"""Orbits of large systems: sparse factors of the intervals, leading multipliers alone, and a bound of all others.

The homogeneous oscillation of a reaction that diffuses on an interval without flux has the multipliers of one problem
of two components for each wave: x' = (J(t) + kappa_j D) x with kappa_j the eigenvalues of the second differences.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from casadi_skin import OdeModel, Orbit, find_orbit
from casadi_skin.points.lost_symmetry import critical_vector
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.intervals import IntervalFactors
from casadi_skin.stability import full_period, leading

A, B = 1.0, 2.5
STABLE, PATTERNS = (1.0, 0.3), (0.07, 1.0)  # coefficients of diffusion; with the second ones waves grow in some lengths


def brusselator(cells: int, D: tuple[float, float] = STABLE) -> OdeModel:
    """Two species on an interval of length L without flux; without L of one cell."""
    x, L = ca.SX.sym("x", 2 * cells), ca.SX.sym("L")
    rates = []
    u, v = x[:cells], x[cells:]
    reaction = A - (B + 1.0) * u + u**2 * v, B * u - u**2 * v
    for w, d, f in zip((u, v), D, reaction, strict=True):
        wide = ca.vertcat(w[0], w, w[-1])
        rates.append(f + d * (cells / L) ** 2 * (wide[2:] - 2.0 * w + wide[:-2]))
    return OdeModel("Brusselator", x, ca.vertcat(*rates), L)


def homogeneous(cells: int, L: float, D: tuple[float, float] = STABLE) -> Orbit:
    one = find_orbit(brusselator(1), lambda t: [1.0 + np.cos(t), 2.5 - np.sin(t)], 6.7, parameters={"L": L})
    guess = lambda t: np.repeat(one.evaluate(t), cells, axis=-1)  # noqa: E731
    return find_orbit(brusselator(cells, D), guess, one.period, parameters={"L": L}, tolerance=1e-9)


def by_waves(cells: int, L: float, waves: int, period: float, D: tuple[float, float] = STABLE) -> Any:
    """Multipliers of the first waves, by decreasing modulus, by integration of two components."""
    start = find_orbit(brusselator(1), lambda t: [1.0 + np.cos(t), 2.5 - np.sin(t)], 6.7, parameters={"L": L}).evaluate(
        0.0
    )
    kappa = -((2.0 * cells / L * np.sin(0.5 * np.pi * np.arange(waves) / cells)) ** 2)

    def rhs(t: float, y: Any) -> Any:
        u, v = y[:2]
        P = y[2:].reshape(waves, 2, 2)
        J = np.array([[-(B + 1.0) + 2.0 * u * v, u * u], [B - 2.0 * u * v, -u * u]])
        moved = J @ P + kappa[:, None, None] * np.array(D)[:, None] * P
        return np.concatenate([[A - (B + 1.0) * u + u * u * v, B * u - u * u * v], moved.ravel()])

    y0 = np.concatenate([start, np.tile(np.eye(2).ravel(), waves)])
    found = solve_ivp(rhs, (0.0, period), y0, method="DOP853", rtol=1e-12, atol=1e-13)
    values = np.linalg.eigvals(found.y[2:, -1].reshape(waves, 2, 2)).ravel()
    return values[np.argsort(-abs(values), kind="stable")]


def apart(found: Any, exact: Any) -> Any:
    """The distance of each multiplier from the nearest exact one."""
    return np.min(np.abs(found[:, None] - exact), axis=1)


@pytest.mark.parametrize("cells", [60, pytest.param(500, marks=pytest.mark.slow)])
def test_a_homogeneous_oscillation_has_the_multipliers_of_its_waves(cells: int) -> None:
    """120 and 1,000 states, by problems of two components each."""
    orbit = homogeneous(cells, 10.0)
    found, exact = orbit.floquet(), by_waves(cells, 10.0, 8, orbit.period)
    assert found.trivial == 1
    assert found.monodromy is None
    assert found.stable
    assert not replace(found, beyond=np.inf).stable  # where nothing is known of those that are left out
    assert np.all(apart(found.others, exact) <= found.other_errors + 1e-12)
    assert np.all(found.other_errors < 1e-11)
    assert found.others.size >= leading.FEWEST
    assert np.sum(np.abs(exact[1:]) > found.beyond) <= found.others.size
    assert np.all(np.abs(found.others) >= np.abs(exact[1 : found.others.size + 1]) - 1e-9)  # none is passed over


def test_leading_multipliers_are_those_of_dense_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    orbit = homogeneous(50, 14.0)
    found = orbit.floquet()
    monkeypatch.setattr(full_period, "MANY_STATES", 10**6)
    dense = orbit.space.floquets([orbit.point])[0]  # type: ignore[attr-defined]
    assert dense.others.size == 99
    assert dense.beyond == 0.0 < found.beyond < 0.1
    assert apart(found.others, dense.others).max() < 1e-12
    assert np.all(found.other_errors < 1e-11)
    assert found.outside.sum() == dense.outside.sum()


def test_a_bound_sees_a_multiplier_that_was_passed_over() -> None:
    """Of a matrix that is not normal with eigenvalues 1.3, 0.8 and small ones."""
    rng = np.random.default_rng(5)
    values = np.append([1.3, 0.8, 0.3, -0.2], 0.01 * rng.normal(size=116))
    triangle = np.diag(values) + np.triu(0.002 * rng.normal(size=(120, 120)), 1)
    turn = np.linalg.qr(rng.normal(size=(120, 120)))[0]
    N = turn @ triangle @ turn.T
    found = leading._invariant(lambda x: N @ x, 120, 4, 4)
    assert np.allclose(np.sort(np.linalg.eigvals(found.matrix).real)[::-1][:3], [1.3, 0.8, 0.3], atol=1e-11)
    assert leading._bound(lambda x: N @ x, found) < 0.2
    second = np.linalg.qr(turn @ np.linalg.eig(triangle)[1][:, [1]].real)[0]  # without that of 1.3
    passed_over = leading._Invariant(second, np.array([[0.8]]), found.norm, 0.5)
    assert 1.3 <= leading._bound(lambda x: N @ x, passed_over) < 1.7


def test_six_equal_multipliers_are_found() -> None:
    """More than there are columns in a block: the bound shows that some are missing, and a wider block has them."""
    small = 0.01 * np.random.default_rng(1).normal(size=(394, 394)) / 20.0
    N = np.zeros((400, 400))
    N[:6, :6], N[6:, 6:] = 1.2 * np.eye(6), small
    four = leading._invariant(lambda x: N @ x, 400, 4, 2)
    assert leading._bound(lambda x: N @ x, four) >= 1.2
    sixteen = leading._invariant(lambda x: N @ x, 400, 16, 2)
    assert leading._bound(lambda x: N @ x, sixteen) < 1.0


def test_many_multipliers_on_the_circle_are_those_of_dense_maps() -> None:
    """Fifty oscillators that do not feel each other: fifty multipliers are 1, and no few vectors have them."""
    x, y = ca.SX.sym("x", 50), ca.SX.sym("y", 50)
    model = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, (1.0 - x**2) * y - x))
    orbit = find_orbit(model, lambda t: np.repeat([2.0 * np.cos(t), -2.0 * np.sin(t)], 50), 6.66)
    assert np.count_nonzero(np.abs(orbit.floquet().multipliers - 1.0) < 1e-6) == 50


def test_branch_points_are_located_by_leading_multipliers() -> None:
    """Where the multiplier of a wave, by two components, passes 1."""
    orbit = homogeneous(60, 4.2, PATTERNS)
    branch = orbit.follow("L", 3.6, stability=True)

    def second(L: float) -> float:  # but for the homogeneous wave's 1
        values = by_waves(60, L, 6, orbit.period, PATTERNS).real
        return float(np.delete(values, np.argmin(np.abs(values - 1.0)))[1]) - 1.0

    assert [point.kind for point in branch.special_points] == ["branch point"] * 2
    for point in branch.special_points:
        L = point.parameters["L"]
        assert np.sign(second(L - 1e-7)) != np.sign(second(L + 1e-7))
    assert not branch.unresolved
    assert max(orbit.floquet().multipliers.size for orbit in branch.orbits) < 30
    vector = critical_vector(branch.special_points[0].solution)
    waves = np.cos(np.pi * np.outer([1, 2], np.arange(60) + 0.5) / 60)
    u = vector[:60] / np.linalg.norm(vector[:60])
    assert np.max(np.abs(waves @ u)) / np.sqrt(30.0) > 1.0 - 1e-9


@pytest.mark.parametrize("held", ["parameter", "tangent"])
def test_minimal_residuals_are_the_solutions_of_sparse_factors(held: str) -> None:
    """Solutions and the sign of the determinant, of an orbit and a right-hand side in general position."""
    orbit = homogeneous(50, 10.0)
    problem, z = orbit.problem, orbit.point.z
    nonzeros, row = problem.evaluate(z)[1], problem.parameter_row()
    if held == "tangent":
        row = np.cos(np.arange(problem.size) ** 2 % 6.25)
    found = IntervalFactors(problem, nonzeros, row, problem.sizes_at(z)[0])
    direct = BorderedSolver(problem).unchecked(nonzeros, row)
    b = np.random.default_rng(3).normal(size=(problem.size, 2))
    x, exact = found(b), direct(b)
    assert np.max(np.abs(x - exact)) < 1e-9 * np.max(np.abs(exact))
    assert found.orientation == direct.orientation
    flipped = row.copy()
    flipped[:] = -row
    other = IntervalFactors(problem, nonzeros, flipped, problem.sizes_at(z)[0])
    assert np.allclose(
        other(b * np.where(np.arange(problem.size) == problem.size - 1, -1.0, 1.0)[:, None]), x, rtol=1e-6
    )
    assert other.orientation == -found.orientation
