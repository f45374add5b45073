"""What holds for every nonlinear mode, whatever the chain: symmetries, scaling, conservation, and time evolution."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from effort import examples
from hypothesis import assume, example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from casadi_skin import Branch, Chain, Orbit, SymmetryClass, follow_family
from casadi_skin.lattice import closed_forms as multiple_scales

Array = NDArray[np.float64]

few = examples(20)
fewer = examples(10)


@st.composite
def families(draw: st.DrawFn, largest_gamma: float = 0.8, sites: int = 8) -> tuple[Chain, int, float]:
    """A chain, a mode and an S at which softening is far from its end; gS as large as a third of the stiffness."""
    n = draw(st.integers(1, sites))
    chain = Chain(
        sites=n,
        alpha=draw(st.floats(0.8, 3.0)),
        gamma=draw(st.floats(-largest_gamma, largest_gamma)),
        g=draw(st.sampled_from([-1.0, 1.0])) * draw(st.floats(0.2, 3.0)),
    )
    strength = draw(st.floats(0.05, 1.0))
    return chain, draw(st.integers(1, n)), float(strength / abs(chain.g))


@cache
def branch_to(chain: Chain, mode: int, S: float, tolerance: float = 1e-12, **options: Any) -> Branch:
    return follow_family(chain, mode, S, tolerance=tolerance, corrector="newton", **options)


def orbit_at(chain: Chain, mode: int, S: float, tolerance: float = 1e-12, **options: Any) -> Orbit:
    """The last orbit of a family that is followed up to S."""
    branch = branch_to(chain, mode, S, tolerance, **options)
    assume(branch.complete)
    orbit = branch.orbits[-1]
    assert orbit.S == S
    return orbit


def stiffness_matrix(chain: Chain) -> Array:
    """D of Eq. (1) of arXiv:2512.17483, typed out: y'' = -D y - g y^3."""
    n = chain.sites
    return np.asarray(
        (2 + chain.alpha) * np.eye(n) - (1 + chain.gamma) * np.eye(n, k=-1) - (1 - chain.gamma) * np.eye(n, k=1)
    )


def integrated(orbit: Orbit, t: Array) -> tuple[Array, Array]:
    """Displacements and velocities, shape (time, site) each, from the profile at rest by DOP853."""
    chain, n, D = orbit.model, orbit.model.sites, stiffness_matrix(orbit.model)

    def field(_: float, x: Array) -> Array:
        return np.concatenate([x[n:], -D @ x[:n] - chain.g * x[:n] ** 3])

    start = np.concatenate([orbit.profile, np.zeros(n)])
    path = solve_ivp(field, (0.0, t[-1]), start, "DOP853", t, rtol=1e-12, atol=1e-14)
    return path.y[:n].T, path.y[n:].T


def velocities(orbit: Orbit, t: Array) -> Array:
    """Time derivative of `evaluate`, from its odd cosine coefficients found here by sampling."""
    H = 64
    theta = (np.arange(H) + 0.5) * np.pi / (2 * H)
    odd = 2 * np.arange(H) + 1
    coefficients = 2.0 / H * np.cos(np.outer(odd, theta)) @ orbit.evaluate(theta / orbit.Omega)
    return np.asarray(-orbit.Omega * (np.sin(np.outer(orbit.Omega * t, odd)) * odd) @ coefficients)


def skin_amplification(chain: Chain) -> float:
    """How much larger round-off becomes in physical coordinates than in the gauge."""
    r = (1 + abs(chain.gamma)) / (1 - abs(chain.gamma))
    return float(r ** ((chain.sites - 1) / 2))


@few
@given(family=families(), factor=st.floats(0.2, 5.0))
def test_only_the_product_of_nonlinearity_and_amplitude_matters(
    family: tuple[Chain, int, float], factor: float
) -> None:
    chain, mode, S = family
    orbit = orbit_at(chain, mode, S)
    scaled = orbit_at(replace(chain, g=chain.g * factor), mode, S / factor)
    assert abs(scaled.Omega / orbit.Omega - 1) < 1e-12
    t = np.linspace(0, orbit.period, 9)
    # Two walks of the same family that round differently; the shapes agree as far as both were asked to.
    sign = np.sign(scaled.profile @ orbit.profile)  # sites may tie for the largest displacement
    difference = sign * np.sqrt(factor) * scaled.evaluate(t) - orbit.evaluate(t)
    assert np.abs(difference).max() < 1e-11 * np.abs(orbit.profile).max()
    assert scaled.floquet().stable == orbit.floquet().stable or abs(orbit.floquet().max_abs_multiplier - 1) < 1e-5


@few
@given(family=families())
@example(family=(Chain(6, 1.0, 0.5, -1.0), 1, 1.0))
@example(family=(Chain(5, 1.0, -0.3, 1.0), 4, 1.0))
def test_the_opposite_nonreciprocity_has_the_mirrored_orbit(family: tuple[Chain, int, float]) -> None:
    chain, mode, S = family
    orbit, mirror = orbit_at(chain, mode, S), orbit_at(replace(chain, gamma=-chain.gamma), mode, S)
    assert abs(mirror.Omega / orbit.Omega - 1) < 1e-12
    # Up to the sign, which ties between sites leave open.
    overlap = np.sign(orbit.profile @ mirror.profile[::-1])
    np.testing.assert_allclose(
        mirror.profile[::-1] * overlap, orbit.profile, rtol=0, atol=1e-11 * np.abs(orbit.profile).max()
    )
    assert abs(mirror.energy / orbit.energy - 1) < 1e-11
    a, b = (np.sort_complex(np.round(o.floquet().mu, 7)) for o in (orbit, mirror))
    tolerance = 2 * float(np.max([*orbit.floquet().mu_error, *mirror.floquet().mu_error], initial=0.0)) + 1e-6
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)
    np.testing.assert_allclose(
        np.sort(np.abs(orbit.floquet().multipliers)), np.sort(np.abs(mirror.floquet().multipliers)), atol=1e-5
    )


@few
@given(family=families(largest_gamma=0.5, sites=6))
def test_an_orbit_integrates_back_to_itself(family: tuple[Chain, int, float]) -> None:
    """DOP853 in physical coordinates over one period; unstable orbits and the skin amplify its errors."""
    chain, mode, S = family
    orbit = orbit_at(chain, mode, S)
    t = np.linspace(0.0, orbit.period, 25)
    y, v = integrated(orbit, t)
    growth = orbit.floquet().max_abs_multiplier * skin_amplification(chain)
    allowed = 3e-10 * growth * np.abs(orbit.profile).max()
    np.testing.assert_allclose(y[-1], orbit.profile, rtol=0, atol=allowed)
    np.testing.assert_allclose(v[-1], 0.0, atol=3 * allowed)
    np.testing.assert_allclose(orbit.evaluate(t), y, rtol=0, atol=allowed)
    np.testing.assert_allclose(velocities(orbit, t), v, rtol=0, atol=10 * allowed)


@few
@given(family=families())
def test_the_equations_of_motion_hold_at_every_site_relative_to_its_size(family: tuple[Chain, int, float]) -> None:
    """Second derivative by the coefficients of odd cosines, at times that are no nodes; sites differ by decades."""
    chain, mode, S = family
    orbit = orbit_at(chain, mode, S)
    H = 48
    coefficients = orbit.coefficients(H)
    odd = 2 * np.arange(H) + 1
    theta = np.random.default_rng(0).uniform(-10, 10, 20)
    cosines = np.cos(np.outer(theta, odd))
    y = cosines @ coefficients
    acceleration = -(orbit.Omega**2) * (cosines * odd**2) @ coefficients
    force = -y @ stiffness_matrix(chain).T - chain.g * y**3
    # Errors of the state, 1e-12 of it, come in with the square of the harmonics that carry anything.
    envelope = np.exp(chain.log_rho) * np.abs(orbit.profile / np.exp(chain.log_rho)).max()
    assert np.all(np.abs(acceleration - force) <= 1e-9 * (3 + chain.alpha) * envelope)
    np.testing.assert_allclose(orbit.evaluate(theta / orbit.Omega), y, rtol=0, atol=1e-11 * envelope.max())


@few
@given(family=families(), seed=st.integers(0, 99))
def test_orbits_are_symmetric_odd_and_periodic_in_time_and_have_the_norm_of_their_family(
    family: tuple[Chain, int, float], seed: int
) -> None:
    orbit = orbit_at(*family, tolerance=1e-8)
    t = np.random.default_rng(seed).uniform(-3, 3, 20) * orbit.period
    y, atol = orbit.evaluate(t), 1e-12 * np.abs(orbit.profile).max()
    assert y.shape == (20, orbit.model.sites)
    np.testing.assert_allclose(orbit.evaluate(-t), y, rtol=0, atol=atol)
    np.testing.assert_allclose(orbit.evaluate(t + orbit.period / 2), -y, rtol=0, atol=10 * atol)
    np.testing.assert_allclose(orbit.evaluate(t - 2 * orbit.period), y, rtol=0, atol=10 * atol)
    np.testing.assert_array_equal(orbit.evaluate(0.0), orbit.profile)
    np.testing.assert_allclose(orbit.evaluate(orbit.period / 4), 0.0, atol=atol)
    for one in branch_to(*family, tolerance=1e-8).orbits:
        assert abs(np.sum(one.profile**2) / one.S - 1) < 1e-11
        assert one.residual < 1e-10
        assert one.profile.max() >= (1 - 2e-6) * np.abs(one.profile).max()


@few
@given(family=families())
def test_energy_is_conserved_along_the_orbit_and_is_the_one_reported(family: tuple[Chain, int, float]) -> None:
    """The Hamiltonian in the gauge, typed out, with velocities from the coefficients of `evaluate`."""
    chain, mode, S = family
    orbit = orbit_at(chain, mode, S)
    n = np.arange(1, chain.sites + 1)
    r = (1 + chain.gamma) / (1 - chain.gamma)
    rho = r ** ((n - (chain.sites if chain.gamma >= 0 else 1)) / 2)
    t = np.linspace(0.0, 0.9 * orbit.period, 13)
    eta, rate = orbit.evaluate(t) / rho, velocities(orbit, t) / rho
    s = np.sqrt(1 - chain.gamma**2)
    kinetic = 0.5 * np.sum(rate**2, axis=1)
    harmonic = 0.5 * (2 + chain.alpha) * np.sum(eta**2, axis=1) - s * np.sum(eta[:, 1:] * eta[:, :-1], axis=1)
    quartic = 0.25 * chain.g * (eta**4 @ rho**2)
    np.testing.assert_allclose(kinetic + harmonic + quartic, orbit.energy, rtol=1e-10)
    assert kinetic.max() > 0.1 * abs(orbit.energy)


@fewer
@given(family=families(largest_gamma=0.6, sites=4))
def test_quarter_half_and_full_period_find_the_same_orbit(family: tuple[Chain, int, float]) -> None:
    chain, mode, S = family
    cosines = orbit_at(chain, mode, S)
    for symmetry in SymmetryClass:
        orbit = orbit_at(chain, mode, S, 1e-7, transcription="gauss", symmetry=symmetry)
        assert abs(orbit.Omega / cosines.Omega - 1) < 1e-7
        t = np.linspace(0, orbit.period, 17)
        sign = np.sign(orbit.profile @ cosines.profile)
        difference = sign * orbit.evaluate(t) - cosines.evaluate(t)
        assert np.abs(difference).max() < 1e-6 * np.abs(cosines.profile).max()


@few
@given(family=families())
@example(family=(Chain(8, 1.0, 0.8, -1.0), 1, 1.0))
@example(family=(Chain(1, 1.0, 0.0, 1.0), 1, 1.0))
def test_the_shift_is_the_difference_of_frequencies_and_a_tiny_one_that_of_multiple_scales(
    family: tuple[Chain, int, float],
) -> None:
    """S = 1e-12: the shift is far below the round-off of Omega, and still known to six digits and more."""
    chain, mode, _ = family
    large = orbit_at(*family)
    difference = large.Omega - chain.linear_frequency(mode)
    assert abs(large.Omega_shift - difference) <= 1e-10 * abs(difference) + 1e-14 * large.Omega
    assert np.sign(large.Omega_shift) == np.sign(chain.g)
    slope = multiple_scales.frequency_slope(chain.sites, chain.alpha, chain.gamma, chain.g, mode)
    orbit = orbit_at(chain, mode, 1e-12, 1e-8)
    assert abs(orbit.Omega_shift / (slope * 1e-12) - 1) < 1e-6
    # And where both are known, the shift falls on the expansion's line from the weakly nonlinear side.
    small = orbit_at(chain, mode, 1e-6, 1e-8)
    assert abs(small.Omega_shift / (slope * 1e-6) - 1) < 1e-2
    assert abs(small.Omega_shift - (small.Omega - chain.linear_frequency(mode))) < 2e-14


@few
@given(family=families(largest_gamma=0.9))
def test_the_linear_mode_is_the_limit_of_small_amplitude(family: tuple[Chain, int, float]) -> None:
    chain, mode, _ = family
    orbit, u = orbit_at(chain, mode, 1e-10, 1e-8), chain.right_eigenvector(mode)
    moving = np.abs(u) > 1e-9 * np.exp(chain.log_rho)
    ratio = orbit.profile[moving] / np.sqrt(orbit.S) / (u[moving] / np.linalg.norm(u))
    np.testing.assert_allclose(ratio, np.sign(ratio[0]), rtol=1e-5)
    assert orbit.floquet().multipliers.shape == (2 * chain.sites,)
