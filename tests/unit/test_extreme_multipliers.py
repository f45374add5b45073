"""Multipliers that no double holds, and several far from 1 at once, against exponents in closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit, read_result, save_result
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.stability.closed_maps import Spectrum, multipliers_along, no_trivial, spectrum_of
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.result import HugeMultiplierWarning, LostMultiplierWarning


def turning(exponents: list[float]) -> Solution:
    """x' = (Q D + Q') Q' (x - sin 2 pi t) + ..., with D the exponents times 1 + 0.3 cos 2 pi t and Q(t + 1) = Q(t).

    x - sin 2 pi t = Q exp(int D) Q(0)' c, so that the logarithms of the multipliers are the exponents.
    """
    n, t = len(exponents), ca.SX.sym("t")
    x, Q = ca.SX.sym("x", n), ca.SX.eye(n)
    for i in range(n - 1):
        plane, angle = ca.SX.eye(n), 2.0 * np.pi * t * (1 + i % 2)
        plane[i, i] = plane[i + 1, i + 1] = ca.cos(angle)
        plane[i + 1, i] = ca.sin(angle)
        plane[i, i + 1] = -plane[i + 1, i]
        Q = Q @ plane
    D = ca.diag(ca.vertcat(*exponents)) * (1 + 0.3 * ca.cos(2 * np.pi * t))
    rhs = (Q @ D + ca.jtimes(Q, t, 1)) @ Q.T @ (x - ca.sin(2 * np.pi * t)) + 2 * np.pi * ca.cos(2 * np.pi * t)
    model = OdeModel("turning", x, rhs, time=t, forcing_period=1.0)
    problem = BoundaryValueProblem(model, [model.start(x) - model.end(x)], interval=(0.0, 1.0))
    return problem.solve(lambda s: np.sin(2.0 * np.pi * s) * np.ones(n))


@pytest.mark.parametrize(
    "exponents",
    [
        [800.0, -800.0, 0.7],
        [900.0, 1.0, -0.5],
        [-900.0, 1.0, -0.5],
        [30.0, 1.0, -1.0, -30.0],
        [0.5, -100.0, -200.0, -300.0],
        pytest.param([800.0, 700.0, 0.2, -0.1, -600.0, -800.0], marks=pytest.mark.slow),
        [10.0, 9.9, 0.1, -9.8],
    ],
)
@pytest.mark.filterwarnings("ignore::casadi_skin.stability.result.HugeMultiplierWarning")
def test_exponents_of_any_size_are_the_known_ones(exponents: list[float]) -> None:
    solution = turning(exponents)
    floquet = solution.floquet()
    found = np.sort(floquet.log10_abs_multipliers)[::-1] * np.log(10.0)
    np.testing.assert_allclose(found, np.sort(exponents)[::-1], rtol=1e-12, atol=3e-9)
    assert np.all(np.isfinite(floquet.multipliers))
    assert np.all(np.isfinite(floquet.monodromy))
    assert not floquet.lost
    assert floquet.error < 0.03
    assert floquet.unstable_real == sum(value > 0.0 for value in exponents)


def test_a_multiplier_beyond_doubles_is_named_and_saved_with_its_logarithm(tmp_path: object) -> None:
    solution = turning([900.0, 1.0, -0.5])
    with pytest.warns(HugeMultiplierWarning, match="1 of the multipliers exceed the largest double"):
        floquet = solution.floquet()
    assert floquet.max_abs_multiplier == pytest.approx(np.finfo(float).max)
    save_result(floquet, f"{tmp_path}/floquet")
    again = read_result(f"{tmp_path}/floquet")
    assert np.array_equal(again.log10_abs_multipliers, floquet.log10_abs_multipliers)


@pytest.mark.filterwarnings("ignore::casadi_skin.stability.result.HugeMultiplierWarning")
def test_digits_that_no_number_of_parts_brings_back_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = turning([800.0, -800.0, 0.7])
    monkeypatch.setattr("casadi_skin.stability.full_period.MOST_PARTS", 100)
    with pytest.warns(LostMultiplierWarning, match="several multipliers are far from 1"):
        assert solution.floquet().lost


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casadi_skin.stability.result.HugeMultiplierWarning")
@pytest.mark.parametrize("sign", [1, -1])
def test_van_der_pols_relaxation_has_the_multiplier_of_liouvilles_formula(sign: int) -> None:
    """Forwards and backwards in time, mu = 30: the multiplier is beyond all doubles."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    mu = 30.0

    def rates(t: float, z: list[float]) -> list[float]:
        return [z[1], mu * (1 - z[0] ** 2) * z[1] - z[0], mu * (1 - z[0] ** 2)]

    def turns(t: float, z: list[float]) -> float:
        return z[1] if z[0] > 0.0 else 1.0

    turns.direction = -1.0  # type: ignore[attr-defined]
    known = solve_ivp(
        rates, (0.0, 170.0), [2.0, -0.1, 0.0], "LSODA", rtol=1e-11, atol=1e-11, max_step=0.5, dense_output=True,
        events=turns,
    )  # fmt: skip
    first, last = known.t_events[0][-2:]
    exponent = float(known.sol(last)[2] - known.sol(first)[2])
    rhs = sign * ca.vertcat(y, mu * (1 - x**2) * y - x)
    states = lambda t: known.sol(first + t if sign > 0 else last - t)[:2]  # noqa: E731
    orbit = find_orbit(OdeModel("van der Pol", ca.vertcat(x, y), rhs), states, last - first)
    assert orbit.period == pytest.approx(last - first, rel=1e-7)  # whose ends are interpolated
    found = orbit.floquet().log10_abs_multipliers * np.log(10.0)
    assert found[np.argmax(np.abs(found))] == pytest.approx(sign * exponent, rel=1e-6)
    assert abs(exponent) > 1000.0
    assert orbit.stable == (sign > 0)


def by_all_ways(maps: np.ndarray) -> list[Spectrum]:
    """Eigenvalues of the product by numpy, and by the kernel where there is one."""
    return [spectrum_of(maps), multipliers_along(maps, no_trivial(maps.shape[1]), np.ones(maps.shape[1])).others]


@pytest.mark.parametrize("seed", range(6))
def test_products_of_random_factors_have_the_eigenvalues_of_their_exact_product(seed: int) -> None:
    """Against mpmath with 600 digits; moduli in clusters and apart, pairs among them."""
    from mpmath import mp, mpf

    generator = np.random.default_rng(seed)
    n = int(generator.integers(2, 6))
    scales = np.exp(generator.choice([-6.0, -3.0, 0.0, 0.0, 2.0, 6.0], size=n))
    maps = np.array([np.eye(n) + 0.3 * generator.normal(size=(n, n)) for _ in range(40)]) * scales[:, None]
    with mp.workdps(600):
        product = mp.eye(n)
        for matrix in maps:
            product = mp.matrix([[mpf(float(v)) for v in row] for row in matrix]) * product
        exact = mp.eig(product, left=False, right=False)
        logs = sorted((float(mp.log(abs(value))) for value in exact), reverse=True)
    for found in by_all_ways(maps):
        np.testing.assert_allclose(found.logs, logs, rtol=0, atol=1e-9)


def test_a_pair_that_turns_beside_many_that_decay_is_not_taken_apart() -> None:
    """Of modulus 0.2; its triangular factors have diagonals that differ at each map, and others converge slowly."""
    generator, K, n = np.random.default_rng(0), 12, 14
    frames = np.linalg.qr(generator.normal(size=(K, n, n)))[0]
    logs = np.concatenate([[0.0, np.log(0.2), np.log(0.2)], -5.0 - 1.2 * np.arange(n - 4), [-60.0]])
    upper = np.triu(0.1 * generator.normal(size=(K, n, n)), 1) + np.diag(np.exp(logs / K))
    turn = np.array([[0.0, -3.0], [1.0 / 3.0, 0.0]])
    upper[:, 1:3, 1:3] = 0.2 ** (1 / K) * (np.cos(0.6) * np.eye(2) + np.sin(0.6) * turn)
    for found in by_all_ways(np.roll(frames, -1, axis=0) @ upper @ frames.swapaxes(1, 2)):
        assert found.extreme
        np.testing.assert_allclose(found.logs, logs, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.angle(found.phases[1:3])), 7.2 - 2 * np.pi, atol=1e-9)


def decaying(exponents: list[float]) -> Orbit:
    """x_k' = e_k (1 + 0.3 cos 2 pi t) (x_k - sin 2 pi t) + 2 pi cos 2 pi t, so that multipliers are exp(e_k)."""
    t, p, x = ca.SX.sym("t"), ca.SX.sym("p"), ca.SX.sym("x", len(exponents))
    rates = ca.vertcat(exponents[0] + p, *exponents[1:]) * (1 + 0.3 * ca.cos(2 * np.pi * t))
    rhs = rates * (x - ca.sin(2 * np.pi * t)) + 2 * np.pi * ca.cos(2 * np.pi * t)
    model = OdeModel("decaying", x, rhs, p, time=t, forcing_period=1.0, nominal=(0.0,))
    return find_orbit(model, lambda s: np.sin(2 * np.pi * s) * np.ones(len(exponents)), corrector="newton")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casadi_skin.stability.result.HugeMultiplierWarning")
@pytest.mark.parametrize("gap", [21.0, 24.4, 30.0, 39.0, 45.0])
def test_digits_of_a_block_do_not_depend_on_how_wide_the_gap_below_it_is(gap: float) -> None:
    """Subspaces at the start have had one round less than those at the end: exp(-gap) was left of a second round."""
    random, logs = np.random.default_rng(5), np.array([0.0, -2.6, -2.6 - gap, -120.0])
    bases = random.normal(size=(24, 4, 4))
    maps = np.roll(bases, -1, axis=0) @ (np.exp(logs / 24)[:, None] * np.linalg.inv(bases))
    for found in by_all_ways(maps):
        assert found.extreme
        np.testing.assert_allclose(found.logs, logs, atol=2e-12)


def test_tables_have_logarithms_where_doubles_hold_no_multiplier() -> None:
    branch = decaying([800.0, -1.0]).follow("p", 1.0, max_step=0.5, stability=True, events=False)
    table = branch.to_dataframe()
    np.testing.assert_allclose(table["log10_max_abs_multiplier"] * np.log(10.0), 800.0 + branch["p"], rtol=1e-9)
    assert list(table.columns).index("log10_max_abs_multiplier") > list(table.columns).index("trivial_deviation")
    logarithms = branch.to_xarray()["log10_abs_multipliers"].values
    np.testing.assert_allclose(logarithms.min(axis=1) * np.log(10.0), -1.0, rtol=1e-7)
    usual = decaying([8.0, -1.0]).follow("p", 1.0, stability=True, events=False)
    assert "log10_max_abs_multiplier" not in usual.to_dataframe()


@pytest.mark.filterwarnings("ignore::casadi_skin.stability.result.HugeMultiplierWarning")
def test_multipliers_that_sensitivities_do_not_hold_are_named() -> None:
    with pytest.raises(FlowError, match=r"a multiplier of 1e\+347 exceeds the largest double; accepted: by = 'colloc"):
        decaying([800.0, -1.0]).floquet(flow="cvodes")
    with pytest.warns(LostMultiplierWarning, match="1 of the multipliers by cvodes are smaller than errors"):
        floquet = decaying([-800.0, -1.0]).floquet(flow="cvodes")
    assert np.max(floquet.log10_abs_multipliers) * np.log(10.0) == pytest.approx(-1.0, rel=1e-7)
    with pytest.raises(ValueError, match="flow: given 'cvodes' with a boundary-value problem; accepted: collocation"):
        turning([0.5, -1.0]).floquet(flow="cvodes")
