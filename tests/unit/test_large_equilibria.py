"""Equilibria of large systems: sparse matrices, eigenvalues near the imaginary axis alone, and a proof of their number.

Of the Brusselator on an interval (Dirichlet values on the uniform state) the Hopf points are known in closed form.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, diags

from casadi_skin import Branch, OdeModel, find_equilibrium
from casadi_skin.zero import balanced, half_plane, rest
from casadi_skin.zero.half_plane import HalfPlane, HalfPlaneError, pair_near

A, B, D = 2.0, 5.45, (0.008, 0.004)


def brusselator(cells: int, ring: bool = False) -> OdeModel:
    """Second differences of two species on an interval of length L, or round a ring."""
    x, L = ca.SX.sym("x", 2 * cells), ca.SX.sym("L")
    h, rates = 1.0 / (cells if ring else cells + 1), []
    reaction = A - (B + 1.0) * x[:cells] + x[:cells] ** 2 * x[cells:]
    for w, d, rest_value, f in ((x[:cells], D[0], A, reaction), (x[cells:], D[1], B / A, None)):
        ends = (w[-1], w[0]) if ring else (rest_value, rest_value)
        wide = ca.vertcat(ends[0], w, ends[1])
        second = (wide[2:] - 2.0 * wide[1:-1] + wide[:-2]) / h**2
        rates.append(d / L**2 * second + (B * x[:cells] - x[:cells] ** 2 * x[cells:] if f is None else f))
    return OdeModel("brusselator", x, ca.vertcat(*rates), L)


def branch_of_cells(cells: int, ring: bool = False, to: float = 1.2) -> Branch:
    uniform = np.repeat([A, B / A], cells)
    return find_equilibrium(brusselator(cells, ring), uniform, parameters={"L": 0.3}).follow("L", to)


def hopf_lengths(cells: int, count: int) -> NDArray[np.float64]:
    """Where the trace of the reaction with the j-th eigenvalue of the second differences vanishes."""
    kappa = 4.0 * (cells + 1) ** 2 * np.sin(0.5 * np.pi * np.arange(1, count + 1) / (cells + 1)) ** 2
    return np.asarray(np.sqrt(sum(D) * kappa / (B - 1.0 - A**2)))


def stable_and_not(n: int, seed: int) -> csc_matrix:
    """Second differences of two species that are advected and react at random, far from balanced."""
    random, m = np.random.default_rng(seed), n // 2
    blocks = [[None, None], [None, None]]
    for i in range(2):
        for j in range(2):
            local = diags(random.normal(scale=3.0, size=m))
            stiff = diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(m, m)) * (40.0 if i == j else 0.0)
            blocks[i][j] = (local + stiff).toarray()
    units = 2.0 ** (random.integers(-2, 2, 2 * m) + np.repeat(random.integers(-20, 20, 2), m))
    return csc_matrix(np.block(blocks) * units / units[:, None])


@pytest.mark.parametrize("seed", range(6))
def test_eigenvalues_near_the_axis_are_those_of_a_dense_matrix_and_all_of_them(seed: int) -> None:
    matrix = stable_and_not(240, seed)
    found, all_of_them = HalfPlane.of(matrix), np.linalg.eigvals(balanced.balanced(matrix.toarray())[0])
    inside = all_of_them[np.abs(all_of_them - found.shift) < found.radius]
    assert np.all(inside.size == found.values.size >= np.count_nonzero(all_of_them.real > -found.margin))
    for value, error in zip(found.values, found.errors(2.2e-16), strict=True):
        assert np.min(np.abs(inside - value)) <= max(error, 1e-11)
    assert found.missing == 0
    fewer = replace(found, values=found.values[2:], left=found.left[2:], right=found.right[:, 2:])
    assert fewer.missing == 2
    assert sum(found.numbers(2.2e-16)) == 2 * np.count_nonzero(all_of_them.real > 0.0)


def test_a_matrix_with_too_many_eigenvalues_near_the_axis_is_left_to_dense_ones() -> None:
    n = 300
    turning = diags([np.ones(n - 1), -np.ones(n - 1)], [1, -1]).tocsc()
    with pytest.raises(HalfPlaneError, match=r"too many|No convergence"):
        HalfPlane.of(turning)


def test_rates_and_a_pair_are_those_of_differences() -> None:
    first, random = stable_and_not(240, 0), np.random.default_rng(1)
    change = first.multiply(random.normal(size=(1, 240))).tocsc()
    found, ahead = HalfPlane.of(first), HalfPlane.of(first + 1e-7 * change)
    moved = (ahead.values[:4] - found.values[:4]) / 1e-7
    np.testing.assert_allclose(found.rates(change)[:4], moved, rtol=1e-4, atol=1e-5)
    upper = next(value for value in found.values if value.imag > 0.0)
    value, right, left = pair_near(first, upper.imag)
    assert abs(value - upper) <= 1e-9
    scale = np.abs(value) * np.abs(right)
    assert np.all(np.abs(first @ right - value * right) <= 1e-8 * np.max(scale / np.abs(right)) * np.abs(right).max())
    assert np.linalg.norm((left.conj() @ first - value * left.conj()) * np.abs(right)) <= 1e-8 * np.linalg.norm(
        left * right
    )


def test_units_of_a_sparse_system_are_those_of_a_dense_one(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for is_mostly_zero in (lambda *_: True, lambda *_: False):
        monkeypatch.setattr(rest, "is_mostly_zero", is_mostly_zero)
        uniform = np.repeat([A, B / A], 60)
        space = find_equilibrium(brusselator(60), uniform, parameters={"L": 0.3}).space
        found.append(space.problem.units_of_all(np.append(uniform / space.sizes, 0.0)))
    ratios = found[0] / found[1]
    assert np.all((ratios > 0.4) & (ratios < 2.5))  # each balanced to a factor of two


def test_hopf_points_of_a_large_system_are_those_of_the_closed_form() -> None:
    cells = 100
    branch = branch_of_cells(cells)
    assert branch.unresolved == ()
    points = branch.special_points
    assert [point.kind for point in points] == ["hopf", "hopf"]
    for point, exact in zip(points, hopf_lengths(cells, 2), strict=True):
        assert abs(point.parameters["L"] - exact) <= point.error + 1e-13
    kappa = (B - 1.0 - A**2) / sum(D)  # times L^2, at a Hopf point
    block = np.array([[B - 1.0 - D[0] * kappa, A**2], [-B, -(A**2) - D[1] * kappa]])
    assert points[0].frequency == pytest.approx(np.sqrt(np.linalg.det(block)), rel=1e-10)


def test_where_the_number_of_eigenvalues_is_not_proved_the_stretch_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    proofs = list[HalfPlane]()

    def missing(part: HalfPlane) -> int:
        proofs.append(part)
        return int(len(proofs) > 1)

    monkeypatch.setattr(HalfPlane, "missing", property(missing))
    branch = branch_of_cells(60, to=0.45)
    assert {gap.reason for gap in branch.unresolved} == {
        "the number of eigenvalues near the imaginary axis is not proved"
    }
    assert branch.unresolved[0].start == pytest.approx(0.3)
    assert branch.unresolved[-1].end == pytest.approx(0.45, abs=0.01)
    assert len(branch.unresolved) == len(proofs) - 1


def test_where_the_start_is_not_proved_all_eigenvalues_are_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HalfPlane, "missing", property(lambda _: 1))
    branch = branch_of_cells(60, to=0.6)
    assert branch.unresolved == ()
    assert [point.kind for point in branch.special_points] == ["hopf"]


@pytest.mark.parametrize("place", [0.3217, 0.71])
def test_a_narrow_bump_of_a_large_system_is_found(place: float) -> None:
    """A pair is unstable for |p - place| < 0.001 alone; the other states are those of a chain that diffuses."""
    x, y, p = symbols("x y p")
    chain, wide = ca.SX.sym("w", 118), None
    wide = ca.vertcat(0.0, chain, 0.0)
    growth = ca.exp(-(((p - place) / 1e-3) ** 2)) - np.exp(-1.0)
    rates = [growth * x - 2 * y - x * (x**2 + y**2), 2 * x + growth * y - y * (x**2 + y**2)]
    second = 50.0 * (wide[2:] - 2.0 * wide[1:-1] + wide[:-2]) - chain + 0.1 * p
    model = OdeModel("bump", ca.vertcat(x, y, chain), ca.vertcat(*rates, second), p)
    branch = find_equilibrium(model, np.zeros(120), parameters={"p": 0.0}).follow("p", 1.0)
    assert [point.kind for point in branch.special_points] == ["hopf", "hopf"]
    for point, exact in zip(branch.special_points, (place - 1e-3, place + 1e-3), strict=True):
        assert abs(point.parameters["p"] - exact) <= 1e-9


def test_the_contour_counts_without_any_known_value() -> None:
    """Turns of the determinant alone are the number of eigenvalues within the circle."""
    matrix = stable_and_not(160, 4)
    found = HalfPlane.of(matrix)
    turns = np.linspace(0.0, np.pi, 2000)
    shifted = half_plane._Shifted(found.matrix)
    many = half_plane._missing(shifted, found.shift, found.radius, np.zeros(0, dtype=complex), turns)
    assert many == found.values.size


@pytest.mark.parametrize("growth", [-1.0, 0.0, 5.0])
def test_of_a_symmetric_matrix_no_circle_is_empty_for_want_of_a_height(growth: float) -> None:
    n = 200
    matrix = csc_matrix(diags([30.0, growth - 60.0, 30.0], [-1, 0, 1], shape=(n, n)))
    found = HalfPlane.of(matrix)
    exact = growth - 120.0 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / (n + 1)) ** 2
    np.testing.assert_allclose(found.values, exact[: found.values.size], rtol=0, atol=1e-10)
    assert found.numbers(2.2e-16) == (np.count_nonzero(exact > 0.0),) * 2
    assert found.missing == 0


def test_numbers_of_unstable_eigenvalues_are_those_of_all_of_them() -> None:
    branch = branch_of_cells(60, to=1.2)
    counts = [solution.unstable for solution in branch.solutions]
    assert {0, 2, 4} <= set(counts)
    for solution in branch.solutions[::6]:
        whole = np.linalg.eigvals(
            solution.space.statics.jacobian(solution.positions, list(solution.parameters.values()))
        )
        assert solution.unstable == np.count_nonzero(whole.real > 1e-9)
        assert solution.stable == (solution.unstable == 0)


def test_a_large_system_of_second_order_buckles_where_the_closed_form_has_it() -> None:
    """x_k'' = 20 (x_(k+1) - 2 x_k + x_(k-1)) - a x_k - x_k^3: the margin of the eigenvalues vanishes with a."""
    n, a = 120, ca.SX.sym("a")
    x, v = ca.SX.sym("x", n), ca.SX.sym("v", n)
    wide = ca.vertcat(0.0, x, 0.0)
    rhs = 20.0 * (wide[2:] - 2.0 * wide[1:-1] + wide[:-2]) - a * x - x**3
    model = OdeModel("chain", x, rhs, a, order=2, velocity=v)
    branch = find_equilibrium(model, np.zeros(n), parameters={"a": 1.0}).follow("a", -0.06)
    exact = -80.0 * np.sin(0.5 * np.pi * np.arange(1, 3) / (n + 1)) ** 2
    assert [point.kind for point in branch.special_points] == ["branch point", "branch point"]
    np.testing.assert_allclose([point.parameters["a"] for point in branch.special_points], exact, rtol=1e-8)
    assert branch.unresolved == ()
    assert [solution.unstable for solution in (branch.solutions[0], branch.solutions[-1])] == [0, 2]
