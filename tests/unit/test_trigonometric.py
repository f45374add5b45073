"""Collocation in odd cosines: matrices, the band, and equations that models have in common."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import dense_jacobian

from casadi_skin.follow.family import Family
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import lifted
from casadi_skin.zero.cosines import TrigonometricProblem, cosine_matrix, second_derivative_matrix
from casadi_skin.zero.request import family_request

Array = NDArray[np.float64]


@pytest.mark.parametrize("harmonics", [1, 2, 5, 16, 128])
def test_node_values_and_coefficients_are_each_others_transform(harmonics: int) -> None:
    V = cosine_matrix(harmonics)
    i = np.arange(harmonics)
    expected = np.cos(np.outer(2 * i + 1, (i + 0.5) * np.pi / (2 * harmonics)))
    np.testing.assert_array_equal(V, V.T)
    np.testing.assert_allclose(V, expected, atol=1e-15 * harmonics**2)
    np.testing.assert_allclose(V @ V, harmonics / 2 * np.eye(harmonics), atol=1e-14 * harmonics)


@pytest.mark.parametrize("harmonics", [1, 3, 8])
def test_second_derivative_is_exact_on_odd_cosines(harmonics: int) -> None:
    theta = (np.arange(harmonics) + 0.5) * np.pi / (2 * harmonics)
    D2 = second_derivative_matrix(harmonics)
    for k in range(harmonics):
        cosine = np.cos((2 * k + 1) * theta)
        np.testing.assert_allclose(D2 @ cosine, -((2 * k + 1) ** 2) * cosine, atol=2e-14 * harmonics**3)


@pytest.mark.parametrize("reach", [1, 2, 3])
def test_half_bandwidth_holds_every_coupling(reach: int) -> None:
    """Couplings as far as `reach` sites; the band is what the linear solver is told."""
    n = 8
    q, v, p = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("p")
    i = np.arange(n)
    K = np.where(np.abs(i[:, None] - i) <= reach, -0.2, 0.0) + 3 * np.eye(n)
    model = OdeModel(
        "far", q, -ca.sparsify(ca.DM(K)) @ q - p * q**3, p, 2, v,
        reversal=(1,) * n + (-1,) * n, half_period=(-1,) * (2 * n), normalisation=ca.dot(q, q) - 1,
    )  # fmt: skip
    problem = TrigonometricProblem(model, 4)
    rows, columns = problem.pattern
    inside = (rows < problem.states) & (columns < problem.states)
    assert problem.half_bandwidth is not None
    assert np.abs(rows - columns)[inside].max() <= problem.half_bandwidth


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


def results(x: ca.SX, y: ca.SX, c: list[float]) -> list[ca.SX]:
    return [ca.vertcat(c[0] * ca.sin(x[0]) + y / c[1], ca.fmin(x[1], c[2]) ** 2), c[3] * x[0] * x[1] - 0.25]


def test_programs_are_equal_where_numbers_alone_differ_and_give_what_they_were_made_of() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    cases = [0.3, 1.2, 1.1, 2.5], [7.1, -0.2, 3.3, 9.0], [5.0, 5.0, 5.0, 5.0], [1.0, 1.2, 1.1, 2.5]
    programs = []
    for numbers in cases:
        found = lifted([x, y], results(x, y, numbers), 100)
        assert found is not None
        program, values = found
        c = ca.SX.sym("c", values.size)
        symbolic = ca.Function("symbolic", [x, y, c], program.expressions([x, y], c))
        exact = ca.Function("exact", [x, y], results(x, y, numbers))
        for one, other in zip(symbolic([0.3, 1.2], -0.7, values), exact([0.3, 1.2], -0.7), strict=True):
            np.testing.assert_allclose(np.array(one), np.array(other), rtol=1e-14)
        programs.append(program)
    assert programs[0] == programs[1]
    assert programs[0] != programs[3]  # of a product with 1 no instruction is left
    assert lifted([x, y], results(x, y, cases[0]), 3) is None
