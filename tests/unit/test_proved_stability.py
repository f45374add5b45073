"""Proofs of stability: what is known otherwise agrees with them, and no bound is too small."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_models import two_wells

from casadi_skin import Chain, follow_family

flint = pytest.importorskip("flint")

from casadi_skin.certify import balls
from casadi_skin.certify.certify import best_attempt
from casadi_skin.certify.stability import (
    Linearised,
    _bordered,
    _count,
    _Pair,
    _toeplitz,
    enclosed_exponent,
    linearised,
    negative_eigenvalues,
)


def hill(blocks):
    return Linearised(np.asarray(blocks, float), 0.0, flint.arb(1), True)


def dense(problem, sigma, highest):
    G = _toeplitz(problem, highest, highest)
    shifts = np.repeat(sigma + np.arange(-highest, highest + 1, 2), problem.positions)
    return G + np.diag(float(problem.square.mid()) * shifts**2)


@pytest.fixture(scope="module")
def pair():
    """Two equal sites: both in phase, the difference obeys v'' = -(4 + 3 g y^2) v (Lame's equation with n = 2)."""
    return follow_family(Chain(2, 1.0, 0.0, 1.0), mode=1, amplitude_max=12.0, tolerance=1e-11, stability=True)


def exponent_of_difference(orbit):
    """sigma of the difference of the two sites, from its equation and the orbit's integrated together."""

    def rhs(t, x):
        y, w, v1, u1, v2, u2 = x
        k = 4.0 + 3.0 * y * y
        return [w, -2.0 * y - y**3, u1, -k * v1, u2, -k * v2]

    start = [float(orbit.evaluate(0.0)[0]), 0.0, 1.0, 0.0, 0.0, 1.0]
    end = solve_ivp(rhs, (0.0, 0.5 * orbit.period), start, rtol=1e-13, atol=1e-13, method="DOP853").y[:, -1]
    return np.arccos(complex(0.5 * (end[2] + end[5]))) / np.pi


def test_brackets_hold_the_exponent_of_lames_equation(pair):
    for S in (0.5, 3.0, 12.0):
        orbit = pair.at(S=S)
        proof, sigma = orbit.proved_stability, exponent_of_difference(orbit)
        assert proof.verdict == "stable"
        assert proof.brackets[0, 0] < sigma.real < proof.brackets[0, 1]
        assert abs(sigma.imag) < 1e-9


def test_signatures_are_those_of_linear_modes_at_small_amplitude():
    chain, mode = Chain(5, 1.0, 0.25, -1.0), 1
    orbit = follow_family(chain, mode=mode, amplitude_max=1e-4, tolerance=1e-10).at(S=1e-4)
    proof = orbit.proved_stability
    assert proof.verdict == "stable"
    omega = np.sqrt(1.0 + 2.0 - 2.0 * np.sqrt(1 - 0.25**2) * np.cos(np.arange(1, 6) * np.pi / 6))
    turns = np.delete(omega / omega[mode - 1], mode - 1) % 2.0
    expected = sorted((min(s, 2.0 - s), 1 if s < 1.0 else -1) for s in turns)
    for (low, high), signature, (sigma, sign) in zip(proof.brackets, proof.signatures, expected, strict=True):
        assert low < sigma < high
        assert signature == sign


def test_one_site_is_stable_without_any_other_multiplier():
    proof = (
        follow_family(Chain(1, 1.0, 0.0, 1.0), mode=1, amplitude_max=2.0, tolerance=1e-10).at(S=2.0).proved_stability
    )
    assert (proof.verdict, len(proof.brackets)) == ("stable", 0)


def test_a_change_of_stability_is_proved_and_the_unstable_side_agrees_with_an_integration():
    chain = Chain(3, 1.0, 0.25, 1.0)
    branch = follow_family(chain, mode=2, amplitude_max=1.0, tolerance=1e-9, stability=True)
    (change,) = branch.changes
    low, high = branch.certify_change(change)
    assert low < change.S < high < low + 1e-4
    assert branch.at(S=low).proved_stability.verdict == "stable"
    proof = branch.at(S=1.0).proved_stability
    assert proof.verdict == "unstable"
    orbit, K = branch.at(S=1.0), np.array([[3.0, -0.75, 0.0], [-1.25, 3.0, -0.75], [0.0, -1.25, 3.0]])

    def rhs(t, x):
        y, V = x[:3], x[6:].reshape(6, 6)
        return np.concatenate([x[3:6], -K @ y - y**3, np.vstack([V[3:], -(K + 3.0 * np.diag(y**2)) @ V[:3]]).ravel()])

    start = np.concatenate([orbit.evaluate(0.0)[:3], np.zeros(3), np.eye(6).ravel()])
    end = solve_ivp(rhs, (0.0, 0.5 * orbit.period), start, rtol=1e-12, atol=1e-12, method="DOP853").y[:, -1]
    assert np.max(np.abs(end[:6] + start[:6])) < 1e-8
    multipliers = np.linalg.eigvals(end[6:].reshape(6, 6))
    expected = np.exp(1j * np.pi * proof.exponent)
    assert np.min(np.abs(multipliers - expected)) < 1e-6 + 10.0 * proof.radius


def test_stability_of_sums_of_all_cosines_agrees_with_an_integration_over_the_period():
    """Henon-Heiles, detuned: the family of y is a sum of all cosines; the exponent is that over the whole period."""
    branch = follow_family(two_wells(), mode=2, amplitude_max=0.45, tolerance=1e-10)
    for S in (0.02, 0.3, 0.45):
        orbit = branch.at(S=S)
        proof = orbit.proved_stability
        assert proof.step == 1

        def rhs(t, s):
            x, y, u, w = s[:4]
            K = np.array([[1.0 + 2.0 * y, 2.0 * x], [2.0 * x, 1.44 - 2.0 * y]])
            V = s[4:].reshape(4, 4)
            return np.concatenate(
                [[u, w, -x - 2 * x * y, -1.44 * y - x**2 + y**2], np.vstack([V[2:], -K @ V[:2]]).ravel()]
            )

        start = np.concatenate([orbit.evaluate(0.0)[:2], np.zeros(2), np.eye(4).ravel()])
        end = solve_ivp(rhs, (0.0, orbit.period), start, rtol=1e-12, atol=1e-12, method="DOP853").y[:, -1]
        multipliers = np.linalg.eigvals(end[4:].reshape(4, 4))
        others = multipliers[np.argsort(np.abs(multipliers - 1.0))[2:]]
        if proof.verdict == "stable":
            (low, high), turns = proof.brackets[0], np.angle(others) / (2.0 * np.pi)
            assert np.allclose(np.abs(others), 1.0, atol=1e-6)
            assert low < np.max(turns) < high
        else:
            assert proof.verdict == "unstable"
            assert np.min(np.abs(others - np.exp(2j * np.pi * proof.exponent))) < 1e-6 + 10.0 * proof.radius
    assert {branch.at(S=S).proved_stability.verdict for S in (0.02, 0.45)} == {"stable", "unstable"}


def test_rounding_of_sums_that_cancel_is_enclosed():
    """G_0 is nearly -lambda sigma^2: the rounding of the large terms counts, not that of their small sum."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        sigma, square = 0.123456789, 1.7
        problem = replace(hill([[[-square * sigma**2]], [[1e-9]]]), square=flint.arb(square))
        pair = _Pair.near(problem, complex(sigma), 4)
        J, unsure = pair.finite_part(_toeplitz(problem, 4, 4), square)
        for i, m in enumerate((-4, -2, 0, 2, 4)):
            exact = flint.arb(problem.blocks[0, 0, 0]) + square * (flint.acb(pair.sigma.real, pair.sigma.imag) + m) ** 2
            off = abs(exact - flint.acb(J[1 + i, 1 + i].real, J[1 + i, 1 + i].imag))
            assert off <= unsure[1 + i, 1 + i]
        assert unsure[3, 3] > 1e-18


# The bounds -----------------------------------------------------------------------------------------------------------


def test_numbers_of_negative_eigenvalues_are_those_of_large_matrices():
    generator = np.random.default_rng(1)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        for _ in range(20):
            blocks = generator.normal(size=(4, 3, 3)) * np.array([8.0, 3.0, 1.0, 0.3])[:, None, None]
            problem = hill(blocks + blocks.swapaxes(1, 2))
            sigma = float(generator.uniform(0.05, 0.95))
            expected = int(np.sum(np.linalg.eigvalsh(dense(problem, sigma, 60)) < 0.0))
            assert negative_eigenvalues(problem, sigma) == expected


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("coupling", [0.5, 2.0, 6.0])
def test_no_finite_part_is_trusted_with_an_eigenvalue_that_the_tail_moves(coupling, sign):
    """The nearest eigenvalue to 0 of the whole is moved there, to less than what the tail does to the finite part."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        for highest in (4, 6, 8):
            for part in (0.01, 0.3, 0.9):
                free = hill([[[0.0]], [[coupling]], [[0.4 * coupling]]])
                whole = np.linalg.eigvalsh(dense(free, 0.3, 80))
                moved = whole[2] - np.linalg.eigvalsh(dense(free, 0.3, highest))[2]
                shift = -whole[2] + sign * part * abs(moved)
                problem = hill([[[shift]], [[coupling]], [[0.4 * coupling]]])
                expected = int(np.sum(np.linalg.eigvalsh(dense(problem, 0.3, 80)) < 0.0))
                assert _count(problem, 0.3, highest)[0] in (None, expected)


def test_doubt_about_the_orbit_counts():
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        near = hill([[[-(0.3**2) + 1e-6]], [[0.0]]])
        assert negative_eigenvalues(near, 0.3) is not None
        assert negative_eigenvalues(replace(near, radius=2e-6), 0.3) is None
        assert negative_eigenvalues(replace(near, square=flint.arb(1, 3e-5)), 0.3) is None


def test_enclosed_exponents_are_bounded_by_dense_operators_and_disturbances():
    orbit = follow_family(Chain(2, 1.0, 0.2, 1.0), mode=2, amplitude_max=6.0, tolerance=1e-10).at(S=6.0)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        _, attempt = best_attempt(orbit)
        problem = linearised(attempt.series, flint.arb(1.02), attempt.radius, attempt.constants.reach)
        mu = orbit.floquet().mu[0]
        start = complex(np.log((np.sqrt(mu + 0j) + np.sqrt(1 + mu + 0j)) ** 2) / (1j * np.pi))
        pair = _Pair.near(problem, start, 12)
        constants, n = pair.constants(), problem.positions
        wide = 40  # the whole operator, nearly
        G = _toeplitz(problem, wide, wide)
        square = float(problem.square.mid())
        inner = (wide - 12) // 2 * n
        w = np.zeros(G.shape[0], complex)
        w[inner : inner + pair.w.size] = pair.w.ravel()
        DF, F = _bordered(G, square, pair.sigma, w, problem.harmonics(wide), w.conj())
        shifts = np.repeat(pair.sigma + np.arange(-wide, wide + 1, 2), n)
        A = np.diag(np.concatenate([[1.0], 1.0 / (square * shifts**2)])).astype(complex)
        place = np.concatenate([[0], 1 + inner + np.arange(pair.w.size)])
        A[np.ix_(place, place)] = pair.inverse
        norm = np.abs(np.eye(len(A)) - A @ DF).sum(axis=0).max()
        assert norm <= constants.Z
        assert norm > 0.1 * constants.Z
        assert np.abs(A @ F).sum() <= constants.Y * (1.0 + 1e-6) + 1e-13
        sigma, radius = enclosed_exponent(problem, start)
        moved_pair = replace(pair.exact, sigma=pair.exact.sigma + 1e-6)
        disturbed = replace(pair, exact=moved_pair, sigma=pair.sigma + 1e-6)
        for factor in (1.0, 0.5):
            moved = disturbed.constants()
            assert factor * 1e-6 * (1.0 - moved.Z) < moved.Y
        assert abs(sigma - pair.sigma) < 1e-6 + radius
