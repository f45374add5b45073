"""What holds for every nonreciprocal chain, however it is drawn (arXiv:2512.17483)."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
from effort import examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.ode import OdeModel

Array = NDArray[np.float64]

quick = examples(100)

couplings = st.floats(0.01, 3.0) | st.floats(-3.0, -0.01)
chains = st.builds(
    Chain,
    sites=st.integers(1, 30),
    alpha=st.floats(0.0, 5.0),
    gamma=st.floats(-0.95, 0.95),
    g=couplings,
)
amplitudes = st.floats(1e-3, 10.0)
seeds = st.integers(0, 2**32 - 1)


def points(chain: Chain, seed: int, count: int = 1) -> list[Array]:
    """Displacements of order one in the gauge."""
    return list(np.random.default_rng(seed).normal(size=(count, chain.sites)))


def evaluate(model: OdeModel, expression: ca.SX, state: Array, parameter: float) -> Array:
    """`expression` of positions, or of the full state where `state` has its length, as a dense array."""
    symbols = model.state if len(state) == model.size else model.full_state
    value = np.array(ca.DM(ca.Function("value", [symbols, model.parameters], [expression])(state, parameter)))
    return value.ravel() if value.shape[1] == 1 else value


def envelope(chain: Chain) -> Array:
    """rho_n = r^((n-c)/2) with r = (1+gamma)/(1-gamma), typed out here, c the favoured edge."""
    n = np.arange(1, chain.sites + 1)
    favoured = chain.sites if chain.gamma >= 0 else 1
    return np.asarray(((1 + chain.gamma) / (1 - chain.gamma)) ** ((n - favoured) / 2))


def force_scale(chain: Chain, q: Array, kappa: float) -> Array:
    """Absolute values of the terms of the gauge equations summed at each site: round-off's yardstick."""
    size = np.abs(q)
    neighbours = np.append(size[1:], 0.0) + np.insert(size[:-1], 0, 0.0)
    return (2 + chain.alpha) * size + neighbours + abs(kappa) * envelope(chain) ** 2 * size**3


def variational(chain: Chain, coordinates: str, state: Array, parameter: float) -> Array:
    return np.array(ca.DM(chain.variational_matrix(coordinates)(state, parameter)))


@quick
@given(chain=chains, S=amplitudes, seed=seeds)
def test_gauge_equations_are_the_physical_ones_in_other_coordinates(chain: Chain, S: float, seed: int) -> None:
    """y = sqrt(S) rho q moves as the gauge says, at every site relative to that site's own size."""
    (q,) = points(chain, seed)
    change = np.sqrt(S) * envelope(chain)
    physical, gauge = chain.physical_model(), chain.gauge_model()
    expected = evaluate(physical, physical.rhs, change * q, chain.g) / change
    found = evaluate(gauge, gauge.rhs, q, chain.g * S)
    assert np.all(np.abs(found - expected) <= 1e-13 * force_scale(chain, q, chain.g * S))


@quick
@given(chain=chains, S=amplitudes, seed=seeds)
def test_the_gauge_force_is_the_gradient_of_an_energy_that_is_conserved(chain: Chain, S: float, seed: int) -> None:
    model, kappa, x = chain.gauge_model(), chain.g * S, np.concatenate(points(chain, seed, 2))
    model.check_symmetries(trials=2, seed=seed)  # reversal, oddness and energy
    chain.physical_model().check_symmetries(trials=2, seed=seed)
    L = -evaluate(model, ca.jacobian(model.rhs, model.state), np.zeros(chain.sites), kappa)
    np.testing.assert_array_equal(L, L.T)
    gradient = evaluate(model, ca.gradient(model.hamiltonian, model.full_state), x, kappa)
    field = evaluate(model, model.full_rhs, x, kappa)
    scale = 1e-14 * force_scale(chain, x[: chain.sites], kappa)
    assert np.all(np.abs(gradient[: chain.sites] + field[chain.sites :]) <= scale)
    np.testing.assert_array_equal(gradient[chain.sites :], x[chain.sites :])
    assert abs(gradient @ field) <= 1e-14 * (np.abs(gradient) @ np.abs(field))


@quick
@given(chain=chains, S=amplitudes, seed=seeds)
def test_variational_matrices_are_similar_and_the_gauge_one_is_hamiltonian(chain: Chain, S: float, seed: int) -> None:
    """W = diag(rho, rho)^-1 Z diag(rho, rho) along the same orbit, and W^T J + J W = 0."""
    (q,) = points(chain, seed)
    rho = envelope(chain)
    Z = variational(chain, "physical", np.sqrt(S) * rho * q, chain.g)
    W = variational(chain, "gauge", q, chain.g * S)
    both = np.concatenate([rho, rho])
    np.testing.assert_allclose(W, Z * both / both[:, None], rtol=1e-12, atol=1e-13)
    zero, one = np.zeros((chain.sites, chain.sites)), np.eye(chain.sites)
    J = np.block([[zero, -one], [one, zero]])
    np.testing.assert_array_equal(W.T @ J + J @ W, np.zeros_like(W))


@quick
@given(chain=chains, seed=seeds)
def test_the_opposite_nonreciprocity_is_the_mirror_image(chain: Chain, seed: int) -> None:
    (q,) = points(chain, seed)
    size = np.abs(q)
    neighbours = np.append(size[1:], 0.0) + np.insert(size[:-1], 0, 0.0)
    scale = (2 + chain.alpha) * size + 2 * neighbours + abs(chain.g) * size**3
    mirrored = replace(chain, gamma=-chain.gamma)
    for form in (Chain.physical_model, Chain.gauge_model):
        model, image = form(chain), form(mirrored)
        there = evaluate(model, model.rhs, q, chain.g)
        back = evaluate(image, image.rhs, q[::-1], chain.g)[::-1]
        assert np.all(np.abs(there - back) <= 1e-15 * scale)
    np.testing.assert_array_equal(mirrored.rho[::-1], chain.rho)
    np.testing.assert_array_equal(mirrored.linear_frequencies(), chain.linear_frequencies())
    mode = 1 + seed % chain.sites
    there, back = chain.right_eigenvector(mode), mirrored.right_eigenvector(mode)[::-1]
    np.testing.assert_allclose(back / chain.rho, (-1) ** (mode + 1) * there / chain.rho, atol=5e-15)


@quick
@given(chain=chains)
def test_the_spectrum_of_the_equations_is_the_papers_closed_form(chain: Chain) -> None:
    """numpy diagonalises the physical equations' Jacobian after the similarity that makes it symmetric."""
    rho = envelope(chain)
    symmetric = chain.dynamical_matrix() * rho / rho[:, None]
    j = np.arange(1, chain.sites + 1)
    closed_form = 2 + chain.alpha - 2 * np.sqrt(1 - chain.gamma**2) * np.cos(j * np.pi / (chain.sites + 1))
    np.testing.assert_allclose(symmetric, symmetric.T, atol=1e-13)
    np.testing.assert_allclose(np.linalg.eigvalsh(symmetric), closed_form, rtol=0, atol=5e-14)
    np.testing.assert_allclose(chain.linear_frequencies() ** 2, closed_form, rtol=0, atol=5e-15)
    low, high = chain.band()
    assert low < closed_form[0] <= closed_form[-1] < high
