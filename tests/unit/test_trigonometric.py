"""Collocation in odd cosines: matrices, the band, and equations that models have in common."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from orbit_problems import dense_jacobian

from casadi_skin.follow.family import Family
from casadi_skin.lattice.chain import Chain
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.family import family_request

# Equations that models have in common --------------------------------------------------------------------------------


def test_chains_that_differ_in_numbers_share_what_is_built_and_keep_their_own() -> None:
    """Residual and Jacobian by the functions that chains share, and by those made of one chain's own expressions."""
    chains = Chain(5, 1.0, 0.3, -1.0), Chain(5, 2.0, 0.1, 3.0), Chain(5, 0.5, 0.0, 1.0), Chain(4, 1.0, 0.3, -1.0)
    one, other, third, shorter = (TrigonometricProblem(chain.gauge_model(), 6) for chain in chains)
    assert one.shared is other.shared
    assert one.shared is not shorter.shared
    assert not np.array_equal(one.numbers, other.numbers)
    generator = np.random.default_rng(5)
    for problem in (one, other, third):
        z = generator.normal(size=problem.size)
        z[problem.Omega_index] = 1.3
        residual, own_jacobian = problem.function(z, problem.constants)
        np.testing.assert_allclose(problem.evaluate(z)[0], np.array(residual).ravel(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(dense_jacobian(problem, z), np.array(ca.DM(own_jacobian)), rtol=0, atol=1e-12)


def test_families_followed_by_turns_are_those_followed_one_by_one() -> None:
    """What they share keeps nothing of either."""

    def points(gamma: float) -> Iterator[float]:
        tools = Family(family_request(Chain(4, 1.0, gamma, -1.0), 1, 1.5, tolerance=1e-9))
        return (point.Omega for point in tools.continuation((tools.start,)))

    alone = [list(points(gamma)) for gamma in (0.2, 0.4)]
    both = [points(gamma) for gamma in (0.2, 0.4)]
    turns = [[next(walk) for walk in both] for _ in range(min(map(len, alone)))]
    for k in range(2):
        assert [turn[k] for turn in turns] == alone[k][: len(turns)]
