"""Flow maps and Floquet multipliers against independent integrations, reference values and exact relations."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import gauss_problem
from scipy.optimize import linear_sum_assignment
from variational import integrated

from casadi_skin import Branch, Chain, OdeModel, Orbit, SymmetryClass, follow_family
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability.flows import SplittingFlow
from casadi_skin.stability.multipliers import floquet
from casadi_skin.stability.result import reversible_floquet

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SOFT, HARD = Chain(24, 1.0, 0.25, -1.0), Chain(24, 1.0, 0.25, 1.0)
# S -> largest modulus of a multiplier, computed independently.
SOFT_MULTIPLIERS = {0.2: 1.0, 1.0: 1.1712757347898, 3.0: 1.2016342571861}  # j = 1
HARD_MULTIPLIERS = {0.2: 1.0, 1.0: 1.0314315571659, 3.0: 1.0}  # j = 24


@cache
def followed(
    chain: Chain, mode: int, amplitude_max: float, tolerance: float, at: tuple[float, ...] = (), flow: str = "splitting"
) -> Branch:
    """A family followed once for all tests, by Newton, without its stability."""
    return follow_family(chain, mode, amplitude_max, at=at, tolerance=tolerance, corrector="newton", flow=flow)


@cache
def with_changes(chain: Chain, mode: int, amplitude_max: float, tolerance: float) -> Branch:
    """A family with its stability and its changes."""
    return follow_family(chain, mode, amplitude_max, tolerance=tolerance, corrector="newton", stability=True)


def physical_monodromy(orbit: Orbit) -> Array:
    """Monodromy matrix of Eq. (1) of arXiv:2512.17483 in physical coordinates, by DOP853 over the whole period."""
    chain, n = orbit.model, orbit.model.sites
    A = (
        np.diag(np.full(n, -(2 + chain.alpha)))
        + (1 + chain.gamma) * np.eye(n, k=-1)
        + (1 - chain.gamma) * np.eye(n, k=1)
    )

    _, (matrix,) = integrated(lambda y: A @ y - chain.g * y**3, orbit.profile, [orbit.period])
    return matrix


def set_distance(a: ComplexArray, b: ComplexArray) -> float:
    """Largest distance of two sets of numbers, matched one to one."""
    cost = np.abs(a[:, None] - b)
    rows, columns = linear_sum_assignment(cost)
    return float(cost[rows, columns].max())


def without_trivial_pair(multipliers: ComplexArray) -> ComplexArray:
    """All but the two nearest to 1."""
    return np.asarray(multipliers[np.argsort(np.abs(multipliers - 1))[2:]])


# Reversible orbits ---------------------------------------------------------------------------------------------------


def test_a_reversible_orbit_that_is_not_odd_has_the_multipliers_of_its_monodromy_matrix() -> None:
    """Two sites with a quadratic force, written by hand; its monodromy matrix by DOP853."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p")
    K = np.array([[2.0, -0.6], [-0.6, 3.1]])
    force = -ca.DM(K) @ q - p * ca.vertcat(q[0] ** 2 + q[0] * q[1], 0.5 * q[0] ** 2 - q[1] ** 2)
    model = OdeModel("quadratic", q, force, p, 2, v, reversal=(1, 1, -1, -1), normalisation=ca.dot(q, q) - 0.25)
    problem = gauss_problem(model, 16, SymmetryClass.HALF, degree=6)
    squares, modes = np.linalg.eigh(K)
    corrector, z = NewtonCorrector(problem), problem.pack(0.5 * modes[:, 1], float(np.sqrt(squares[1])), 0.0)
    for value in np.linspace(0.0, 0.8, 9):
        z = corrector.correct(z, problem.parameter_row(), value).z
    start, Omega = problem.sample(z, np.zeros(1))[0], z[problem.Omega_index]
    acceleration = np.array(model.rhs_and_jacobian()(start, 0.8)[0]).ravel()
    result = floquet(SplittingFlow(model, 1e-11).transition(problem, z), acceleration)
    assert result.power == 1
    assert result.trivial_deviation < 1e-9

    def by_hand(x: Array) -> Array:
        a, b = x
        return -K @ x - 0.8 * np.array([a * a + a * b, 0.5 * a * a - b * b])

    (end,), (matrix,) = integrated(by_hand, start, [2 * np.pi / Omega])
    np.testing.assert_allclose(end, np.append(start, np.zeros(2)), atol=1e-9)
    expected = np.linalg.eigvals(matrix)
    assert set_distance(without_trivial_pair(result.multipliers), without_trivial_pair(expected)) < 1e-8


# Multipliers against the whole period in physical coordinates -------------------------------------------------------


@pytest.mark.parametrize(
    ("sites", "mode", "gamma", "g", "S"),
    [(3, 1, 0.3, -1.0, 1.2), (3, 3, 0.3, -1.0, 2.0), (6, 4, 0.3, 1.0, 3.0), (4, 2, -0.4, 1.0, 5.0)],
)
def test_multipliers_and_vectors_are_those_of_the_physical_monodromy_matrix(
    sites: int, mode: int, gamma: float, g: float, S: float
) -> None:
    orbit = followed(Chain(sites, 1.0, gamma, g), mode, S, 1e-11).at(S)
    M, vectors, multipliers = physical_monodromy(orbit), orbit.floquet_vectors(), orbit.floquet().multipliers
    np.testing.assert_array_equal(multipliers[:2], [1.0, 1.0])
    # The trivial pair of the matrix is lost to the root of its errors; the others are not.
    eigenvalues = np.linalg.eigvals(M)
    assert set_distance(without_trivial_pair(eigenvalues), without_trivial_pair(multipliers)) < 2e-8
    assert set_distance(eigenvalues, multipliers) < 1e-4
    assert vectors.shape == (2 * sites, 2 * sites)
    np.testing.assert_allclose(np.abs(vectors).max(axis=0), 1.0, atol=1e-14)
    for k in (0, *range(2, 2 * sites)):
        np.testing.assert_allclose(M @ vectors[:, k], multipliers[k] * vectors[:, k], rtol=0, atol=3e-8)
    # The first is the velocity of the flow; the second moves along the family, and the period with it.
    np.testing.assert_array_equal(vectors[:sites, 0], 0.0)
    along = M @ vectors[:, 1] - vectors[:, 1]
    parallel = (along @ vectors[:, 0].conj()) / (vectors[:, 0] @ vectors[:, 0].conj()) * vectors[:, 0]
    np.testing.assert_allclose(along, parallel, rtol=0, atol=1e-7)
    assert np.linalg.norm(along) > 1e-3
    assert np.linalg.matrix_rank(vectors, tol=1e-8) == 2 * sites


# Reference values ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chain", "mode", "expected"), [(SOFT, 1, SOFT_MULTIPLIERS), (HARD, 24, HARD_MULTIPLIERS)], ids=["soft", "hard"]
)
@pytest.mark.parametrize("tolerance", [1e-6, 1e-11])
def test_largest_multipliers_are_the_reference_values(
    chain: Chain, mode: int, expected: dict[float, float], tolerance: float
) -> None:
    branch = followed(chain, mode, 3.0, tolerance, tuple(expected))
    for S, value in expected.items():
        result = branch.at(S).floquet()
        if value == 1.0:
            assert result.max_abs_multiplier == 1.0  # exactly
            assert result.stable
        else:
            assert result.max_abs_multiplier == pytest.approx(value, abs=max(3e-11, 100 * tolerance))
            assert not result.stable
        assert result.trivial_deviation < max(1e-10, 100 * tolerance)


@pytest.mark.parametrize(("S", "real", "complex_"), [(0.2, 0, 0), (1.0, 1, 0), (3.0, 1, 10)])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_kinds_of_instability_are_counted(S: float, real: int, complex_: int, tolerance: float) -> None:
    result = followed(SOFT, 1, 3.0, tolerance, tuple(SOFT_MULTIPLIERS)).at(S).floquet()
    assert (result.unstable_real, result.unstable_complex) == (real, complex_)
    assert result.stable == (real + complex_ == 0)
    outside = np.abs(result.multipliers) > 1 + 1e-6
    assert np.count_nonzero(outside) == real + complex_
    assert np.count_nonzero(outside & (np.abs(result.multipliers.imag) < 1e-6)) == real
    assert result.multipliers.shape == (48,)
    if S == 3.0:  # 1.118111 beside complex pairs of 1.2016, computed independently
        found = result.multipliers[np.abs(result.multipliers.imag) < 1e-8].real
        assert found.max() == pytest.approx(1.118111, abs=max(1e-6, 10 * tolerance))


@pytest.mark.parametrize(("mode", "g", "expected"), [(1, -1.0, 1.0212776), (48, 1.0, 1.0064013)])
@pytest.mark.parametrize("gamma", [0.6, -0.6])
def test_strong_nonreciprocity_leaves_no_false_instability(mode: int, g: float, gamma: float, expected: float) -> None:
    """N = 48: physical coordinates lose r^((N-1)/2) of the digits, and stable orbits seem unstable in them."""
    branch = followed(Chain(48, 1.0, gamma, g), mode, 0.3, 1e-8, (0.1, 0.2, 0.3))
    for S in (0.1, 0.2):
        result = branch.at(S).floquet()
        assert result.stable
        assert result.max_abs_multiplier == 1.0
        np.testing.assert_allclose(np.abs(result.multipliers), 1.0, rtol=0, atol=1e-14)
    assert not branch.at(0.3).floquet().stable
    assert branch.at(0.3).floquet().max_abs_multiplier == pytest.approx(expected, abs=1e-7)


# Limits -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("gamma", "g", "mode"), [(1.0, 1.0, 4), (1.0, -1.0, 1), (-1.0, 1.0, 4), (-1.0, -1.0, 1)])
def test_at_the_strongest_nonreciprocity_the_resting_sites_are_linear_oscillators(
    gamma: float, g: float, mode: int
) -> None:
    orbit = followed(Chain(4, 1.0, gamma, g), mode, 1.0, 1e-9).at(1.0)
    found = orbit.floquet().multipliers
    phase = np.exp(1j * np.sqrt(3.0) * orbit.period)
    assert found.shape == (8,)
    assert set_distance(found, np.array([1.0, 1.0, *[phase] * 3, *[phase.conjugate()] * 3])) < 1e-12
    assert orbit.floquet().stable
    # The matrix has Jordan blocks of three: its computed eigenvalues are off by the cube root of its errors.
    assert set_distance(np.linalg.eigvals(physical_monodromy(orbit)), found) < 5e-3
    edge = 3 if gamma > 0 else 0
    np.testing.assert_array_equal(np.flatnonzero(orbit.profile), [edge])
    with pytest.raises(ValueError, match="Jordan chains"):
        orbit.floquet_vectors()


def test_in_the_limit_of_no_amplitude_all_multipliers_are_linear_phases() -> None:
    chain = Chain(5, 1.0, 0.4, 1.0)
    orbit = followed(chain, 2, 1e-9, 1e-8).at(1e-9)
    phases = np.exp(2j * np.pi * chain.linear_frequencies() / chain.linear_frequency(2))
    assert set_distance(orbit.floquet().multipliers, np.concatenate([phases, phases.conj()])) < 1e-6
    assert orbit.floquet().stable


# Classification -----------------------------------------------------------------------------------------------------


def test_a_mu_outside_by_less_than_its_error_is_not_called_unstable() -> None:
    """On mu the trivial pair's neighbour -1 - 1e-13 is harmless; on the multipliers it would be 1 + 1e-6."""
    for mu in (-1.0 - 1e-13, 1e-13, -0.4 + 1e-13j):
        result = reversible_floquet(np.array([mu], complex), np.array([1e-12]), 0.0, 2)
        assert result.stable
        assert result.max_abs_multiplier == 1.0
        np.testing.assert_allclose(np.abs(result.multipliers), 1.0, atol=1e-15)
        assert not reversible_floquet(np.array([mu], complex), np.array([1e-14]), 0.0, 2).stable


def test_the_trivial_deviation_shows_an_orbit_that_is_none() -> None:
    """An Omega off by 1e-5 is seen in the eigenvalue that should be -1."""
    orbit = followed(Chain(3, 1.0, 0.3, -1.0), 1, 1.5, 1e-12).at(1.5)
    z = orbit.point.z.copy()
    z[orbit.point.problem.Omega_index] *= 1 + 1e-5
    wrong = floquet(orbit.space.flow.transition(orbit.point.problem, z), orbit.space.transition(orbit.point)[1])
    assert orbit.floquet().trivial_deviation < 1e-11
    assert wrong.trivial_deviation > 1e-6


# Changes of stability -----------------------------------------------------------------------------------------------


def energy(orbit: Orbit) -> float:
    """Hamiltonian of the gauge, typed out, from the physical displacements at t = 0."""
    chain, n = orbit.model, orbit.model.sites
    r = (1 + chain.gamma) / (1 - chain.gamma)
    rho = r ** ((np.arange(1, n + 1) - n) / 2)
    eta = orbit.profile / rho
    bonds = np.sqrt(1 - chain.gamma**2) * (eta[:-1] @ eta[1:])
    return float(0.5 * (2 + chain.alpha) * eta @ eta - bonds + 0.25 * chain.g * rho**2 @ eta**4)


def test_real_instability_is_born_at_an_extremum_of_the_energy() -> None:
    branch = with_changes(SOFT, 1, 0.6, 1e-11)
    (change,) = branch.changes
    np.testing.assert_array_equal(branch.stable, change.value > branch.S)
    assert abs(change.S - 0.43174) < 2e-5  # computed independently
    assert (change.kind, change.stable_before, change.stable_after) == ("real", True, False)
    assert change.mu == pytest.approx(-1.0, abs=1e-6)
    assert change.S_width <= 1e-6
    offsets = 0.02 * np.arange(-4, 5)
    energies = [energy(branch.at(change.S + d)) for d in offsets]
    np.testing.assert_allclose(energies, [branch.at(change.S + d).energy for d in offsets], rtol=1e-12)
    slope = np.polynomial.Polynomial.fit(offsets, energies, 7).deriv()
    # The extremum is where the slope passes zero, and at nothing else nearby.
    roots = slope.roots()
    near = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots) < 0.08)].real
    assert near == pytest.approx([0.0], abs=2e-6)
    assert slope(-0.05) * slope(0.05) < 0


def test_without_stability_nothing_of_it_is_built_and_without_events_there_are_no_changes() -> None:
    branch = follow_family(Chain(2, 1.0, 0.3, 1.0), 1, 1.0, corrector="newton")
    assert "flow" not in vars(branch.space)
    assert (branch.changes, branch.with_stability) == ((), False)
    assert branch.stable.all()  # computed when asked
    assert "flow" in vars(branch.space)
    without = follow_family(SOFT, 1, 0.6, corrector="newton", stability=True, events=False)
    assert without.changes == ()
    assert not without.stable.all()


def test_the_digits_of_multipliers_do_not_depend_on_the_orbits_computed_with_them() -> None:
    """A run that goes on has other batches than one that never stopped, and ends with the same bytes."""
    branch = followed(SOFT, 1, 3.0, 1e-9)
    points = [solution.point for solution in branch.solutions]
    together = branch.space.floquets(points)
    in_fives = [found for k in range(0, len(points), 5) for found in branch.space.floquets(points[k : k + 5])]
    alone = [branch.space.floquets([point])[0] for point in reversed(points)][::-1]
    for others in (in_fives, alone):
        for one, other in zip(together, others, strict=True):
            np.testing.assert_array_equal(one.mu, other.mu)
            np.testing.assert_array_equal(one.mu_error, other.mu_error)
