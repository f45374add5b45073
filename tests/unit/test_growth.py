"""Transient growth against direct integration in physical coordinates, and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from variational import integrated

from casadi_skin import Chain, Orbit, follow_family
from casadi_skin.zero.problem import Array


def stable_orbit(sites: int, gamma: float, flow: str = "splitting") -> Orbit:
    chain = Chain(sites, 1.0, gamma, -1.0)
    branch = follow_family(chain, 1, 0.2, at=[0.2], tolerance=1e-10, corrector="newton", flow=flow)
    return branch.at(S=0.2)


def physical_flow(orbit: Orbit, times: Array) -> list[Array]:
    """Transition matrices in physical coordinates."""
    D, g = orbit.model.dynamical_matrix(), orbit.model.g
    return list(integrated(lambda y: -D @ y - g * y**3, orbit.profile, times, 1e-11, 1e-13)[1])


@pytest.mark.parametrize("gamma", [0.25, -0.4])
def test_growth_is_the_largest_singular_value_of_the_physical_flow(gamma: float) -> None:
    orbit = stable_orbit(8, gamma)
    growth = orbit.transient_growth(quarters=8)
    np.testing.assert_allclose(growth.t, 0.25 * orbit.period * np.arange(9), rtol=1e-15)
    kick = np.random.default_rng(0).normal(size=16)
    for k, flow in zip((3, 8), physical_flow(orbit, growth.t[[3, 8]]), strict=True):
        assert growth.log10_gain[k] == pytest.approx(np.log10(np.linalg.svd(flow)[1][0]), abs=1e-8)
        gain = np.linalg.norm(flow @ kick) / np.linalg.norm(kick)
        assert growth.of(kick)[k] == pytest.approx(np.log10(gain), abs=1e-8)


def test_the_optimal_perturbation_grows_by_the_bounded_gain_and_becomes_the_response() -> None:
    orbit = stable_orbit(8, 0.25)
    growth = orbit.transient_growth(quarters=20)
    best = int(np.argmax(growth.log10_bounded))
    flow = physical_flow(orbit, growth.t[[best]])[0]
    grown = flow @ growth.optimal
    assert np.linalg.norm(growth.optimal) == pytest.approx(1.0, rel=1e-12)
    assert np.log10(np.linalg.norm(grown)) == pytest.approx(growth.log10_bounded[best], abs=1e-8)
    np.testing.assert_allclose(grown / np.linalg.norm(grown), growth.response, atol=1e-7)


def test_without_the_trivial_pair_growth_stays_bounded_and_the_pair_alone_grows_linearly() -> None:
    orbit = stable_orbit(6, 0.25)
    growth = orbit.transient_growth(quarters=4000)
    periods = growth.t[4::4] / orbit.period
    bounded, trivial = 10.0 ** growth.log10_bounded[4::4], 10.0 ** growth.log10_trivial[4::4]
    assert bounded.max() < 10.0 * (1.25 / 0.75) ** 2.5
    slope = np.diff(trivial[-100:]) / np.diff(periods[-100:])
    assert np.ptp(slope) < 1e-3 * slope.mean()
    assert trivial[-1] > 3.0 * trivial[0]
    assert growth.log10_bounded[0] == pytest.approx(0.0, abs=1e-10)


def test_long_and_steep_chains_do_not_overflow() -> None:
    orbit = stable_orbit(120, 0.9)
    growth = orbit.transient_growth(quarters=8)
    for values in (growth.log10_gain, growth.log10_bounded, growth.log10_trivial, growth.optimal, growth.response):
        assert np.all(np.isfinite(values))
    assert 0.5 < growth.log10_gain[-1] < 76  # r^((N-1)/2) is 10^76; waves cross few sites in two periods


def test_growth_needs_the_splitting_flow_and_an_open_gauge() -> None:
    with pytest.raises(ValueError, match="splitting"):
        stable_orbit(3, 0.25, flow="cvodes").transient_growth()
    branch = follow_family(Chain(3, 1.0, 1.0, 1.0), 3, 0.2, corrector="newton")
    with pytest.raises(ValueError, match="gamma"):
        branch.orbits[-1].transient_growth()
