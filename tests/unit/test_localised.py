"""Localised multipliers at the edge of infinite chains, beside Hill's equations with exact tails and whole chains."""

from __future__ import annotations

import itertools
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import block_diag, csc_array, diags_array
from scipy.sparse.linalg import splu

from casadi_skin import Branch, Chain, Orbit, follow_family, read_result
from casadi_skin.stability.result import ContinuousSpectrum, CutTail, Floquet

Array = NDArray[np.float64]

SOFT = Chain(math.inf, 1.0, 0.25, -1.0)
AT = (0.2, 1.0, 3.0)


@cache
def followed(chain: Chain = SOFT, mode: str = "first", sites: int | None = None) -> Branch:
    return follow_family(chain, mode, 3.0, at=AT, tolerance=1e-9, stability_sites=sites)


def localised(orbit: Orbit) -> tuple[Floquet, CutTail]:
    found = orbit.floquet()
    assert found.tail is not None
    return found, found.tail


def hill(orbit: Orbit, sigma: complex, sites: int = 110, sidebands: int = 12) -> csc_array:
    """Hill's equations of exp(i sigma t) sum_m X_nm exp(2 i m Omega t) on sites at the edge, the tail in closed form.

    Sites are numbered from the edge inwards; of the orbit its displacements alone are used.
    """
    chain, Omega = orbit.model, orbit.Omega
    s = math.sqrt(1.0 - chain.gamma**2)
    numbers = -np.arange(sites) if chain.gamma >= 0 else np.arange(1, sites + 1)
    t = np.arange(256) * orbit.period / 512
    squares = 3.0 * chain.g * orbit.evaluate(t, numbers) ** 2
    by_harmonic = np.fft.fft(squares, axis=0) / 256  # of exp(2 i k Omega t)
    m = np.arange(-sidebands, sidebands + 1)
    own = 2.0 + chain.alpha - (sigma + 2.0 * m * Omega) ** 2
    half = own / (2.0 * s)
    decay = half - np.sqrt(half - 1.0) * np.sqrt(half + 1.0)
    decay = np.where(np.abs(decay) > 1.0, 1.0 / decay, decay)
    blocks = [np.diag(own) + by_harmonic[(m[:, None] - m) % 256, n] for n in range(sites)]
    blocks[-1] = blocks[-1] - s * np.diag(decay)
    beside = diags_array([-s * np.ones((sites - 1) * m.size)] * 2, offsets=[-m.size, m.size])
    return csc_array(block_diag([csc_array(block) for block in blocks]) + beside)


def exact_mu(orbit: Orbit, mu: complex) -> complex:
    """The root of Hill's equations near a mu, by the secant method on 1/(u . H^-1 v)."""
    size = hill(orbit, 0.1j).shape[0]
    u, v = np.random.default_rng(1).normal(size=(2, size))

    def value(sigma: complex) -> complex:
        return complex(1.0 / (u @ splu(hill(orbit, sigma)).solve(v.astype(complex))))

    before = 4.0 / orbit.period * np.arcsin(np.sqrt(complex(-mu)))
    before, sigma = before, before * (1.0 + 1e-7)
    f = value(before)
    for _ in range(30):
        g = value(sigma)
        step = -g * (sigma - before) / (g - f)
        before, f, sigma = sigma, g, sigma + step
        if abs(step) < 1e-15:
            break
    return complex(-(np.sin(sigma * orbit.period / 4.0) ** 2))


LEANING = Chain(math.inf, 1.0, -0.4, 1.0)  # hardening, to its first site


@pytest.mark.parametrize(
    ("chain", "mode", "S", "count"),
    [
        pytest.param(SOFT, "first", 0.2, 1, marks=pytest.mark.slow),
        (SOFT, "first", 1.0, 1),
        (SOFT, "first", 3.0, 2),
        *(pytest.param(LEANING, "last", S, 1, marks=pytest.mark.slow) for S in (1.0, 3.0)),
    ],
)
def test_localised_multipliers_solve_hills_equations_with_exact_tails(
    chain: Chain, mode: str, S: float, count: int
) -> None:
    """In the pinned regime, where the orbit fills the tail, too; real instabilities and a complex one."""
    orbit = followed(chain, mode).at(S)
    found, tail = localised(orbit)
    assert found.mu.size == count
    assert found.stable == (chain is LEANING and S == 3.0)
    assert not tail.unresolved.size
    assert chain is SOFT or tail.finite_size_modulus == 1.0
    for mu, error in zip(found.mu, found.mu_error, strict=True):
        assert error < 1e-8
        assert abs(exact_mu(orbit, mu) - mu) <= error + 1e-12


@pytest.mark.slow
def test_whole_chains_have_the_localised_multipliers() -> None:
    """The others of a whole chain lie on the arcs but for weak instabilities, fewer per site the longer it is."""
    whole = follow_family(Chain(300, 1.0, 0.25, -1.0), 1, 3.0, at=AT, tolerance=1e-9, tail="eliminated")
    for S in AT[1:]:  # below the threshold orbits depend on the length
        (found, tail), all_sites = localised(followed().at(S)), whole.at(S).floquet()
        known = all_sites.mu
        for mu, error in zip(found.mu, found.mu_error, strict=True):
            assert np.min(np.abs(known - mu)) <= error + all_sites.error
        distance = tail.continuous.distance(known)
        far = [mu for mu in known[distance > 5e-3] if np.min(np.abs(found.mu - mu)) > 1e-6]
        assert not far


@pytest.mark.slow
@pytest.mark.parametrize("S", AT)
def test_the_error_of_the_cut_is_honest(S: float) -> None:
    """Few sites beside many: multipliers are within their errors, or are not counted as localised."""
    many, _ = localised(followed(sites=300).at(S))
    for sites in (100, 140):
        few, tail = localised(followed(sites=sites).at(S))
        assert tail.sites == sites
        for mu, error in zip(few.mu, few.mu_error, strict=True):
            assert np.min(np.abs(many.mu - mu)) <= error
        assert few.mu.size + tail.unresolved.size == many.mu.size


@pytest.mark.slow
def test_weak_instabilities_fall_with_the_number_of_sites() -> None:
    """Growth of those of finite size at S = 3, from 300 sites to 600; the localised instability stays."""
    growths = []
    for sites in (300, 600):
        found, tail = localised(followed(sites=sites).at(3.0))
        assert found.max_abs_multiplier == pytest.approx(1.20056749, abs=1e-8)
        growths.append(math.log(tail.finite_size_modulus))
    assert growths[1] < 0.7 * growths[0]


@pytest.mark.parametrize(("Omega", "count"), [(0.7, 2), (0.95, 1), (1.0312, 1), (2.5, 0), (4.7, 0)])
def test_arcs_are_those_of_the_linear_dispersion_relation(Omega: float, count: int) -> None:
    """Waves of a chain of 4000 sites: their mu fill the arcs, and both signatures are where arcs overlap."""
    low, high = (math.sqrt(square) for square in SOFT.band())
    spectrum = ContinuousSpectrum(Omega, ((low, high),), 2)
    omega = Chain(4000, 1.0, 0.25, -1.0).linear_frequencies()
    theta = np.pi * omega / (2.0 * Omega)
    mu, signature = -(np.sin(theta) ** 2), np.sign(np.sin(2.0 * theta))
    ((least, most),) = spectrum.mu
    assert np.all((mu >= least - 1e-15) & (mu <= most + 1e-15))
    assert mu.min() == pytest.approx(least, abs=1e-5)
    assert mu.max() == pytest.approx(most, abs=1e-5)
    assert np.allclose(spectrum.arcs, 2.0 * np.pi * np.array([[low, high]]) / Omega, rtol=1e-14)
    assert len(spectrum.overlaps) == count
    edges = np.linspace(least, most, 40)
    for start, end in itertools.pairwise(edges):
        middle = 0.5 * (start + end)
        both = len(set(signature[(mu > start) & (mu < end)])) == 2
        inside = [o.mu for o in spectrum.overlaps if o.mu[0] < end and o.mu[1] > start]
        surely = any(a <= start and end <= b for a, b in inside)
        assert inside or not both, middle
        assert both or not surely, middle
    assert np.max(spectrum.distance(mu)) == 0.0
    assert spectrum.distance(np.array([0.3 + 0.4j]))[0] >= 0.5


def test_waves_of_two_bands_and_orbits_without_half_period_symmetry() -> None:
    spectrum = ContinuousSpectrum(1.0, ((0.9, 0.95), (1.3, 1.35)), 1)
    assert [(o.bands, o.order) for o in spectrum.overlaps] == []
    spectrum = ContinuousSpectrum(1.0, ((0.9, 0.95), (1.07, 1.2)), 1)
    (overlap,) = spectrum.overlaps
    assert (overlap.bands, overlap.order) == ((0, 1), 2)  # omega + omega' = 2 Omega
    assert np.allclose(overlap.angles, 2.0 * np.pi * np.array([0.9, 0.93]))
    assert np.allclose(overlap.mu, sorted(-(np.sin(np.pi * np.array([0.9, 0.93])) ** 2)))


def test_results_print_become_tables_and_are_read_back(tmp_path: Path) -> None:
    branch = follow_family(SOFT, "first", 0.1, tolerance=1e-6, stability=True, stability_sites=120, max_points=4)
    words = str(branch.orbits[-1].floquet())
    assert "localised" in words
    assert "omega T from" in words
    assert "on 120 sites" in words
    assert branch.with_events
    assert branch.changes == ()
    assert branch.unresolved == ()
    branch.save(tmp_path / "branch.skin")
    again = read_result(tmp_path / "branch.skin")
    for orbit, other in zip(branch.orbits, again.orbits, strict=True):
        (floquet, first), (same, second) = localised(orbit), localised(other)
        assert np.array_equal(floquet.mu, same.mu)
        assert first.continuous == second.continuous
        assert np.array_equal(first.finite_size, second.finite_size)
        assert first.sites == second.sites
    table = branch.to_xarray()
    assert list(table["stability_sites"].values) == [120] * len(branch)
    assert table["arc_end"].shape == (len(branch), 1)


@pytest.mark.parametrize(
    ("chain", "options", "words"),
    [
        (Chain(24, 1.0, 0.25, -1.0), {"stability_sites": 20}, "stability_sites: given 20; accepted: "),
        (Chain(900, 1.0, 0.25, -1.0), {"stability_sites": 20}, "stability_sites: given 20; accepted: "),
        (SOFT, {"stability_sites": 1.5}, "stability_sites: given 1.5; accepted: a whole number from 8 to 2000"),
        (Chain(900, 1.0, 0.25, -1.0), {"stability_sites": 200, "tail": "full"}, 'with tail "full"'),
    ],
)
def test_sites_that_are_refused(chain: Chain, options: dict[str, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        follow_family(chain, "first", 1.0, stability=True, **options)


def test_vectors_and_growth_of_infinite_chains_are_refused() -> None:
    orbit = follow_family(SOFT, "first", 0.1, tolerance=1e-6, max_points=2).orbits[-1]
    for act in (orbit.floquet_vectors, orbit.transient_growth):
        with pytest.raises(ValueError, match="accepted: "):
            act()
