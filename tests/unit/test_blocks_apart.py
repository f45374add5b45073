"""Multipliers that meet are kept in one block, and what two intervals do not agree on is no edge."""

from __future__ import annotations

import numpy as np
import pytest

from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.assembly import DISAGREEMENT_WORDS, groups_of
from casadi_skin.stability.tongues.blocks import PROBE_NODES, SERIES_DEGREE, Matrices, blocks_of, contracts
from casadi_skin.stability.tongues.pairs import Block, Segment, real_blocks

Array = np.ndarray
ALONE = np.eye(3, dtype=bool)[None]


def comes_apart(K: Array) -> bool:
    """Whether no block has more than two mu."""
    ((_, blocks),) = blocks_of(K[None, :, None], np.zeros_like(K)[None, :, None])
    return bool(blocks.done[0])


def linear(middle: list[float], slopes: list[float], couplings: list[list[float]]) -> Array:
    """A matrix that changes linearly, at the nodes of an interval, in the eigenvectors at its middle."""
    change = np.diag(slopes) + np.array(couplings)
    return np.diag(middle) + chebyshev.nodes(SERIES_DEGREE)[:, None, None] * change


@pytest.mark.parametrize(
    ("middle", "slopes", "couplings"),
    [
        ([0.0, 1.0, 3.4], [0.1, 0.2, -0.1], [[0.0, 0.2, -0.8], [-0.2, 0.0, 0.6], [0.8, 0.6, 0.0]]),
        ([0.0, 1.0, 3.4], [0.3, 0.3, -0.1], [[0.0, -0.3, 1.0], [0.3, 0.0, 0.0], [-1.0, 0.0, 0.0]]),
        ([0.0, 1.0, 3.9], [-0.3, -0.2, -0.2], [[0.0, -0.3, 1.0], [0.3, 0.0, 0.3], [-1.0, 0.3, 0.0]]),
    ],
)
def test_two_that_meet_by_way_of_a_third_do_not_come_apart(
    middle: list[float], slopes: list[float], couplings: list[list[float]]
) -> None:
    K = linear(middle, slopes, couplings)
    assert np.abs(np.linalg.eigvals(K[-1]).imag).max() > 0.05
    assert not comes_apart(K)


def test_couplings_that_leave_all_apart_come_apart() -> None:
    K = linear([0.0, 1.0, 3.4], [0.1, 0.2, -0.1], [[0.0, 0.02, -0.1], [-0.02, 0.0, 0.1], [0.1, 0.1, 0.0]])
    assert comes_apart(K)


def test_two_that_meet_and_part_between_the_nodes_that_are_asked_do_not_come_apart() -> None:
    """(mu_1 - mu_2)^2 = (s - s_1)(s - s_2), with both zeros between two of the nodes, beside a third mu."""
    low, high = chebyshev.nodes(SERIES_DEGREE)[PROBE_NODES][[3, 4]]
    squares = np.poly1d([low + 0.3 * (high - low), low + 0.6 * (high - low)], r=True)(chebyshev.nodes(SERIES_DEGREE))
    mu = 0.5 * np.sqrt(squares.astype(complex))
    K = np.zeros((1, SERIES_DEGREE + 1, 3, 3), dtype=complex)
    K[0, :, 0, 0], K[0, :, 1, 1], K[0, :, 2, 2] = mu, -mu, 4.0
    assert not contracts(K, ALONE)[0]
    K[0, :, 0, 0], K[0, :, 1, 1] = 1.0 + mu, -1.0 - mu
    assert contracts(K, ALONE)[0]


def test_no_block_has_complex_mu_beside_real_ones() -> None:
    """Real and imaginary parts of one pair may join others: those of another pair, which then are no longer complex."""
    random, seen = np.random.default_rng(3), 0
    for _ in range(40):
        A, B = random.normal(size=(2, 8, 8))
        K = (A + 0.3 * chebyshev.nodes(SERIES_DEGREE)[:, None, None] * B)[None, :, None]
        for _, blocks in blocks_of(K, np.zeros_like(K)):
            labels, real = blocks.labels[0], blocks.real[0]
            for label in np.unique(labels).tolist():
                assert len(set(real[labels == label].tolist())) == 1
                seen += bool(np.any(np.abs(blocks.mu[0][labels == label].imag) > 1e-9) and real[labels == label].all())
    assert seen > 10


def block_of(start: float, end: float, pi: Array, kappa: Array, error: float = 1e-12) -> Block:
    """One mu between 0 and -1 times pi and kappa."""
    parts = np.zeros((1, SERIES_DEGREE + 1, 3, 1, 1))
    parts[0, :, 1, 0, 0], parts[0, :, 2, 0, 0] = pi, kappa
    one, none = np.zeros(1, dtype=np.int64), np.zeros((1, 3))
    bounds = np.array([[start, end]])
    (block,), _, _ = real_blocks(
        Matrices(one, one[:, None], one == 0, bounds, parts, np.full(parts.shape, error), none, none)
    )
    return block


def test_an_edge_that_neither_of_two_intervals_has_is_not_invented() -> None:
    """A mu outside up to the end of its interval, and nothing beside it: that is not known, and no edge."""
    ones = np.ones(SERIES_DEGREE + 1)
    outside = block_of(0.0, 1.0, 0.1 * ones, 0.1 * ones)
    segment = Segment(outside, 0.0, 1.0, None, None, False, 1)
    groups, gaps = groups_of([segment], {0.0})
    assert groups[0].edges == ()
    assert [(gap.start, gap.end, gap.reason) for gap in gaps] == [(0.0, 2.0, DISAGREEMENT_WORDS)]


def test_an_edge_at_the_end_of_an_interval_that_errors_hide_is_there() -> None:
    ones, x = np.ones(SERIES_DEGREE + 1), chebyshev.nodes(SERIES_DEGREE)
    outside = block_of(0.0, 1.0, 0.1 * ones, 1.0 - x + 1e-12, error=1e-11)
    segment = Segment(outside, 0.0, 1.0, None, None, False, 1)
    groups, gaps = groups_of([segment], {0.0})
    assert not gaps
    (edge,) = groups[0].edges
    assert edge.coordinate == 1.0
    assert 1e-12 < edge.error < 1e-10
    assert (edge.kind, edge.mu) == ("real", 0.0)
