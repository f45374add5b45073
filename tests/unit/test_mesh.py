"""Placement of intervals: equidistribution of a known density, limits on lengths, and layers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin.zero import mesh

Array = NDArray[np.float64]


def interpolants(u: Callable[[Array], Array], lengths: Array, degree: int) -> tuple[Array, float]:
    """Leading coefficients of polynomials through Chebyshev nodes of each interval, and the largest error between."""
    s = 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    fine = np.linspace(0.0, 1.0, 101)
    leading, error = [], 0.0
    for start, h in zip(mesh.edges(lengths)[:-1], lengths, strict=True):
        polynomial = np.polyfit(s, u(start + h * s), degree)
        leading.append([polynomial[0]])
        error = max(error, float(np.abs(np.polyval(polynomial, fine) - u(start + h * fine)).max()))
    return np.array(leading), error


def adapted(u: Callable[[Array], Array], intervals: int, degree: int, rounds: int) -> Array:
    lengths = mesh.uniform(intervals)
    for _ in range(rounds):
        wanted = mesh.density(lengths, interpolants(u, lengths, degree)[0], degree)
        lengths = mesh.equidistributed(lengths, wanted, intervals)
    return lengths


@pytest.mark.parametrize("intervals", [1, 3, 7, 20])
def test_intervals_hold_equal_parts_of_the_density(intervals: int) -> None:
    random = np.random.default_rng(intervals)
    lengths, wanted = random.dirichlet(np.ones(9)), random.uniform(0.5, 5.0, 9)
    placed = mesh.equidistributed(lengths, wanted, intervals)
    assert placed.shape == (intervals,)
    assert np.sum(placed) == pytest.approx(1.0, abs=1e-15)
    # The integral of the density up to each edge, added up by hand on a grid of all edges.
    ends = np.union1d(mesh.edges(lengths), mesh.edges(placed))
    middles = 0.5 * (ends[1:] + ends[:-1])
    values = wanted[np.searchsorted(mesh.edges(lengths), middles) - 1]
    total = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
    parts = np.diff(np.interp(mesh.edges(placed), ends, total))
    np.testing.assert_allclose(parts, total[-1] / intervals, rtol=1e-12)
    assert mesh.imbalance(lengths, 1.0 / lengths) == pytest.approx(1.0)
    assert mesh.imbalance(lengths, wanted) == pytest.approx(np.max(lengths * wanted) / np.mean(lengths * wanted))


def test_the_density_does_not_depend_on_the_size_of_the_function() -> None:
    lengths = np.random.default_rng(1).dirichlet(5 * np.ones(10))
    leading = interpolants(lambda x: np.tanh(5 * x - 2), lengths, 3)[0]
    one, other = (mesh.density(lengths, factor * leading, 3) for factor in (1.0, 1e-9))
    np.testing.assert_allclose(one / one.mean(), other / other.mean(), rtol=1e-9)


@pytest.mark.parametrize("leading", [np.zeros((5, 2)), 1e-16 * np.random.default_rng(0).normal(size=(5, 2))])
def test_nothing_but_noise_wants_an_even_mesh(leading: Array) -> None:
    lengths = np.array([0.1, 0.3, 0.2, 0.1, 0.3])
    wanted = mesh.density(lengths, leading, 4, noise=1e-15)
    np.testing.assert_allclose(mesh.equidistributed(lengths, wanted, 5), 0.2, rtol=1e-12)
    assert mesh.density(np.ones(1), np.ones((1, 2)), 4) == pytest.approx(1.0)


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_a_boundary_layer_is_resolved_and_neighbours_stay_of_like_length(width: float) -> None:
    """u = exp(-x/width) on forty intervals of degree 4; an even mesh does not see thin layers at all."""
    degree, K = 4, 40
    lengths = adapted(lambda x: np.exp(-x / width), K, degree, rounds=10)
    ratios = lengths[1:] / lengths[:-1]
    assert np.max(np.maximum(ratios, 1.0 / ratios)) < 1.3 * mesh.NEIGHBOUR_LENGTH_RATIO
    assert np.max(lengths) < 1.3 / (mesh.DENSITY_FLOOR * K)
    placed, even = (interpolants(lambda x: np.exp(-x / width), h, degree)[1] for h in (lengths, mesh.uniform(K)))
    assert placed < 3e-8
    assert even > 1e4 * placed
    assert width > 1e-3 or even > 0.1


@pytest.mark.parametrize("intervals", [12, 40, 91])
def test_a_graded_mesh_grows_from_both_ends(intervals: int) -> None:
    lengths = mesh.graded(intervals, 1e-8)
    assert lengths.shape == (intervals,)
    assert lengths.sum() == pytest.approx(1.0, rel=1e-14)
    assert lengths[0] == pytest.approx(1e-8)
    np.testing.assert_allclose(lengths, lengths[::-1], rtol=1e-6, atol=1e-15)
    outer = intervals // 3
    assert np.all(np.diff(lengths[1:outer]) > 0)


def test_a_mesh_on_which_all_is_rounding_stays_as_it_is() -> None:
    """Noise had drawn the intervals to where it is largest: they grew by a thousand elsewhere."""
    lengths, degree = mesh.uniform(300), 6
    leading = 1e-15 * np.random.default_rng(0).normal(size=(300, 2))
    wanted = mesh.density(lengths, leading, degree, noise=1e-15)
    assert mesh.imbalance(lengths, wanted) < 1.3
