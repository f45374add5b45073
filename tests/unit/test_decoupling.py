"""Bases that make matrices block diagonal, by the compiled kernel and by numpy; zeros of series."""

from __future__ import annotations

import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone
from numpy.polynomial import chebyshev as chebyshev_polynomial

from casadi_skin import native
from casadi_skin.stability.tongues import blocks as decoupling
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import SERIES_DEGREE

Array = np.ndarray


def random_intervals(size: int, dtype: type, seed: int = 7) -> tuple[Array, Array, Array]:
    """K at the nodes of six intervals, diagonal at their middles, who belongs together, and columns of whole blocks.

    Of the first two intervals mu 0 and 1 are of one block; the last one does not come apart.
    """
    generator = np.random.default_rng(seed)
    mu = np.arange(size) + 0.2 * generator.normal(size=size)
    linear, bent = generator.normal(size=(2, 6, size, size)).astype(dtype)
    if dtype is complex:
        mu = mu + 1j * generator.normal(size=size)
        linear += 1j * generator.normal(size=linear.shape)
    x = chebyshev.nodes(SERIES_DEGREE)[:, None, None]
    sizes = np.array([0.3, 0.2, 0.1, 0.1, 0.01, 40.0])[:, None, None, None] / size
    K = np.diag(mu) + sizes * (x * linear[:, None] + x**2 * bent[:, None])
    same = np.tile(np.eye(size, dtype=bool), (6, 1, 1))
    same[:2, 0, 1] = same[:2, 1, 0] = True
    columns = np.full((6, min(size, 5)), -1, dtype=np.int64)
    for i in range(6):
        count = 2 if i < 2 else int(generator.integers(1, columns.shape[1] + 1))
        columns[i, :count] = np.arange(count)
    return K, same, columns


def invariance(K: Array, T: Array, same: Array, columns: Array) -> float:
    """What is left of K T - T L with L block diagonal, from the rows of K T that T has unit blocks in."""
    valid = columns[columns >= 0]
    T = T[..., : valid.size]
    L = np.where(same[np.ix_(valid, valid)], (K @ T)[:, valid], 0.0)
    return float(np.max(np.abs(K @ T - T @ L)))


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("size", [2, 3, 8, 23])
def test_bases_are_invariant(size: int, dtype: type) -> None:
    K, same, columns = random_intervals(size, dtype)
    T, found = decoupling._invariant(K, same, columns)
    assert found.tolist() == [True] * 5 + [False]
    for i in range(5):
        count = np.count_nonzero(columns[i] >= 0)
        assert invariance(K[i], T[i], same[i], columns[i]) < 1e-8
        assert np.array_equal(
            T[i, SERIES_DEGREE // 2], np.eye(size, columns.shape[1]) * (np.arange(columns.shape[1]) < count)
        )


@needs_kernels
@pytest.mark.parametrize("dtype", [float, complex])
@pytest.mark.parametrize("size", [2, 3, 8, 23])
def test_kernel_and_numpy_find_the_same(size: int, dtype: type) -> None:
    K, same, columns = random_intervals(size, dtype)
    compiled, apart = decoupling._invariant(K, same, columns), decoupling.contracts(K, same)
    with numpy_alone():
        plain, also = decoupling._invariant(K, same, columns), decoupling.contracts(K, same)
    assert np.array_equal(compiled[1], plain[1])
    assert apart.tolist() == also.tolist()
    np.testing.assert_allclose(compiled[0][:5], plain[0][:5], rtol=0, atol=1e-12)


@needs_kernels
@pytest.mark.parametrize("dtype", [float, complex])
def test_steps_from_the_identity_give_all_mu(dtype: type) -> None:
    """Within the square of the last step, which is small but not zero."""
    K, same, _ = random_intervals(6, dtype)
    K = K[2:, decoupling.PROBE_NODES]
    values, fine = native.contracts(K, same[2:], decoupling.MOST_STEPS, 1e-9, decoupling.LARGEST_STEP)
    assert fine.tolist() == [True] * 3 + [False]
    for here, matrices in zip(values[:3], K[:3], strict=True):
        exact = np.linalg.eigvals(matrices)
        assert np.sort_complex(here) == pytest.approx(np.sort_complex(exact), abs=1e-9)


def test_forms_have_the_eigenvalues_of_their_columns() -> None:
    """K between its left and right bases is block diagonal, with mu of K, in whatever coordinates it is given."""
    own, same, columns = (each[:5] for each in random_intervals(8, float))
    vectors = np.random.default_rng(2).normal(size=(5, 8, 8))
    inverse = np.linalg.inv(vectors)
    K = vectors[:, None] @ own @ inverse[:, None]
    near = np.zeros((5, 8), dtype=bool)
    forms = decoupling.decoupled(own, same, columns, near, vectors, inverse, K[:, :, None], None)
    for i in range(5):
        count = np.count_nonzero(columns[i] >= 0)
        for node in (0, 3, SERIES_DEGREE // 2, SERIES_DEGREE):
            block = forms.values[i, node, 0, :count, :count]
            assert np.max(np.abs(np.where(same[i, :count, :count], 0.0, block))) < 1e-8
            exact = np.linalg.eigvals(own[i, node])
            assert max(np.min(np.abs(exact - mu)) for mu in np.linalg.eigvals(block)) < 1e-8


@needs_kernels
@pytest.mark.parametrize("dtype", [float, complex])
def test_what_is_no_number_is_not_found(dtype: type) -> None:
    K, same, columns = random_intervals(3, dtype)
    K[2, 5, 1, 2] = np.nan
    assert decoupling._invariant(K, same, columns)[1].tolist() == [True, True, False, True, True, False]
    K[2, 4, 1, 2] = np.nan
    assert not decoupling.contracts(K, same)[2]


@pytest.mark.parametrize("place", [-1.0, -0.5, 0.0, 0.5, 1.0, 1.0 - 1e-14])
def test_zeros_in_one_place_are_found_there(place: float) -> None:
    """One, and where two come together, or nearly."""
    coefficients = np.zeros((17, 3))
    coefficients[:2, 0] = -place, 1.0
    coefficients[:3, 1] = place**2 + 0.5, -2.0 * place, 0.5  # (x - place)^2
    coefficients[:3, 2] = coefficients[:3, 1]
    coefficients[0, 2] += 1e-10
    of, x, _ = chebyshev.real_zeros(coefficients)
    assert x[of == 0] == pytest.approx([place], abs=1e-15)
    for i in (1, 2):
        assert x[of == i] == pytest.approx(place, abs=1e-4)
        assert np.count_nonzero(of == i) >= 1


@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_a_zero_beyond_the_end_by_rounding_alone_is_at_the_end(end: float) -> None:
    """Of x - place and of (x - place)(x^2 + 0.1): no place is outside of [-1, 1]."""
    place = end * (1.0 + 0.5 * chebyshev.END_SLACK)
    coefficients = np.zeros((17, 2))
    coefficients[:2, 0] = -place, 1.0
    coefficients[:4, 1] = chebyshev_polynomial.poly2cheb([-0.1 * place, 0.1, -place, 1.0])
    of, x, crosses = chebyshev.real_zeros(coefficients)
    assert x[crosses].tolist() == [end, end]
    assert sorted(of[crosses].tolist()) == [0, 1]
