"""The linear tail of long chains, eliminated: against recurrences in 50 digits, whole chains and harmonic balance."""

from __future__ import annotations

import itertools
import math
from functools import cache

import mpmath
import numpy as np
import pytest
from marks import slow
from scipy.optimize import fsolve

from casadi_skin import Branch, Chain, follow_family
from casadi_skin.dynamics.resonances import threshold
from casadi_skin.follow.family import Family
from casadi_skin.follow.point import LocalCurve
from casadi_skin.lattice.core_with_tail import CoreWithTailProblem
from casadi_skin.lattice.tail import Place, Tail
from casadi_skin.lattice.tail_parameter import Regime, TailParameter
from casadi_skin.solve.ipopt import ArbitratedCorrector
from casadi_skin.zero.cosines import PolynomialForm
from casadi_skin.zero.family import family_request

GAP = math.sqrt(1.0 - 0.25**2)  # the coupling s at gamma = 0.25
AMPLITUDES = (1e-9, 0.2, 1.0, 3.0)


def chain_tail(sites: float) -> Tail:
    """The tail of a chain of which the core's first site is number `sites` from its other end."""
    return Tail(sites - 1, np.array([[3.0]]), GAP)


def parameter_of(sites: float, edge: int, harmonics: int) -> TailParameter:
    """Of the mode at the lower (1) or the upper (-1) edge of the band."""
    number = 0 if edge > 0 else 1
    return TailParameter(chain_tail(sites), Place(number), harmonics)


def edge_of(parameter: TailParameter) -> float:
    """u where the fundamental is at the edge of the band."""
    return parameter.at(parameter.tail.angle(parameter.mode))


# One harmonic -------------------------------------------------------------------------------------------------------


def recurred_angle(sites: int, x: mpmath.mpf) -> mpmath.mpf:
    """phi of the last two of a_0 = 0, a_1 = 1, a_(n+1) = 2 x a_n - a_(n-1), counted on where a changes its sign."""
    last, current, turns = mpmath.mpf(0), mpmath.mpf(1), 0
    for _ in range(sites - 1):
        last, current = current, 2 * x * current - last
        turns += current * last < 0
    return mpmath.atan2(last * mpmath.sign(current), abs(current)) + turns * mpmath.pi


@pytest.mark.parametrize("sites", [2, 7, 120])
@pytest.mark.parametrize("phi", [0.36, 0.4, 0.7, 0.784, 0.79, 1.2, 1.57, 1.6, 3.0, 4.5])
def test_a_wave_has_the_angle_that_the_recurrence_gives_it(sites: int, phi: float) -> None:
    tail = chain_tail(sites)
    edge = tail.angle(Place(0))
    if phi >= (sites - 1) * np.pi - edge:  # where the other edge of the band is
        return
    place = tail.at_angle(0, phi)
    with mpmath.workdps(50):
        found = recurred_angle(sites, 1 - mpmath.mpf(place.off) / (2 * mpmath.mpf(GAP)))
    assert float(found) == pytest.approx(phi, abs=2e-13 * sites)
    assert place.in_band == (phi >= edge)
    assert tail.angle(place) == pytest.approx(phi, abs=2e-13 * sites)


# The parameter ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sites", [150, 10**6, math.inf])
@pytest.mark.parametrize(
    ("edge", "u"), [*((1, u) for u in (1.5, 0.7, 0.3, 0.1, -0.3, -0.9, -1.6)), (-1, -1.2), (-1, -0.3)]
)
def test_what_the_core_needs_is_consistent(sites: float, edge: int, u: float) -> None:
    parameter, step = parameter_of(sites, edge, 5), 1e-5
    here, after, before = (parameter.values(u + off) for off in (0.0, step, -step))
    for name in ("Omega", "across", "down"):
        difference = (getattr(after, name) - getattr(before, name)) / (2 * step)
        np.testing.assert_allclose(getattr(here, f"{name}_slope"), difference, atol=2e-8)
    np.testing.assert_allclose(np.hypot(here.across, here.down), 1.0, rtol=1e-14)
    assert (here.phi[0] + here.phi[1] if edge > 0 else here.phi[0]) == pytest.approx(u, abs=1e-14)


@pytest.mark.parametrize("sites", [120, 925, 10**6, math.inf])
@pytest.mark.parametrize(
    ("edge", "u"), [*((1, u) for u in (0.637, 0.6, 0.4, 0.1, -0.2)), *((-1, -u) for u in (0.787, 0.78, 0.3))]
)
def test_power_series_of_the_tail_are_its_values_beside_the_place(sites: float, edge: int, u: float) -> None:
    """In and beside the band, up to where it is not analytic if the tail is endless."""
    parameter = parameter_of(sites, edge, 6)
    series = parameter.series(u, 24)
    found = series.coefficients
    reach = 0.5 * min((1e-6 / np.max(np.abs(found[k]))) ** (1 / k) for k in (23, 24))
    reach = min(reach, 0.02, 0.25 * abs(u - edge_of(parameter_of(math.inf, edge, 6))))
    for v in (-reach, -0.5 * reach, 0.5 * reach, reach):
        there = parameter.values(u + v)
        known = np.concatenate([[there.Omega], there.across, there.down])
        np.testing.assert_allclose(v ** np.arange(25) @ found, known, atol=2e-8 if np.isfinite(sites) else 1e-13)


def test_an_endless_tail_has_no_power_series_across_the_edge_of_its_band() -> None:
    parameter = parameter_of(math.inf, 1, 6)
    edge = edge_of(parameter)
    end = edge + 2e-3 + parameter.series(edge + 2e-3, 24).end
    assert 0.0 < edge - end < 1e-3
    assert 0.0 < parameter.values(edge).Omega - parameter.values(end).Omega < 1e-7
    assert math.isnan(parameter.series(edge - 1e-3, 24).end)


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize(
    ("sites", "mode"), [(120, 1), *(slow(*more) for more in ((math.inf, 1), (300, 300), (math.inf, "last")))]
)
def test_power_series_of_a_branch_solve_the_equations(sites: float, mode: int | str) -> None:
    """Residuals fall as the 25th power of the distance, from points in and beside the band."""
    chain = Chain(sites, 1.0, 0.4, -1.0 if mode == 1 else 1.0)  # type: ignore[arg-type]
    request = family_request(chain, mode, 2.0, tolerance=1e-10, corrector="newton", tail="eliminated")
    tools, form = Family(request), PolynomialForm.of(request.coordinates.scaled)
    points = [point for point in tools.continuation((tools.start,)) if point.walked]
    for point in (tools.start, points[1], points[-2]):
        problem, z = point.problem, point.z
        solve = tools.point_solver.factor(problem, z, tools.point_solver.metric(problem, z) * point.tangent)
        z = z - solve(np.append(problem.evaluate(z)[0], 0.0))
        if point is tools.start:
            z[-1] = 0.0
        recursion = problem.recursion(form, 24)
        series = recursion.series(z, tools.point_solver.tangent(problem, z, solve), solve)
        sizes = np.sqrt(np.sum(tools.point_solver.metric(problem, z) * series[-2:] ** 2, axis=1))
        reach = float(np.min((1e-6 / sizes) ** (1.0 / np.array([23, 24]))))
        if recursion.end is not None:
            reach = min(
                [reach, *(tau for tau, _ in LocalCurve(series, reach).crossings(recursion.end[0], [recursion.end[1]]))]
            )
        left = [np.max(np.abs(problem.evaluate((part * reach) ** np.arange(25) @ series)[0])) for part in (0.25, 0.5)]
        rounding = 1000.0 * problem.rounding(z)
        assert left[0] < rounding
        assert left[1] < max(rounding, 1e-9 if np.isfinite(sites) else 1e-11)


@pytest.mark.parametrize("edge", [1, -1])
def test_the_jacobian_is_that_of_the_residual(edge: int) -> None:
    model = Chain(9, 1.0, 0.25, -float(edge)).gauge_model()
    problem = CoreWithTailProblem(model, 4, parameter_of(81, edge, 4))
    z = np.append(0.1 * np.random.default_rng(0).normal(size=36), [0.9 * edge, 0.5])
    nonzeros, step = problem.evaluate(z)[1], 1e-6
    dense = np.zeros((problem.size - 1, problem.size))
    dense[problem.pattern] = nonzeros
    for column, unit in enumerate(np.eye(problem.size)):
        difference = (problem.evaluate(z + step * unit)[0] - problem.evaluate(z - step * unit)[0]) / (2 * step)
        np.testing.assert_allclose(dense[:, column], difference, atol=1e-8)


def test_problems_with_the_same_core_share_ipopt_and_are_confirmed_each_with_its_own_tail() -> None:
    shared = list[dict[object, object]]()
    for sites in (120, 58, 120):
        tools = Family(family_request(Chain(sites, 1.0, 0.4, -1.0), 1, 2.0, tail="eliminated"))
        _, point = itertools.islice(tools.continuation((tools.start,)), 2)
        problem, z = point.problem, point.z
        (found,) = ArbitratedCorrector(problem).confirm_all([(z, problem.parameter_row(), z[problem.parameter_index])])
        assert found.converged
        np.testing.assert_allclose(found.z, z, atol=1e-9)
        shared.append(problem.shared)
    assert all(one is shared[0] for one in shared)


# Families -----------------------------------------------------------------------------------------------------------


@cache
def family(
    sites: float, gamma: float, g: float, tail: str | None, end: float = 3.0, tolerance: float = 1e-11
) -> Branch:
    chain = Chain(sites, 1.0, gamma, g)  # type: ignore[arg-type]
    at = (*(S for S in AMPLITUDES if end > S), end)
    mode = "first" if g < 0 else "last"
    return follow_family(chain, mode, end, at=at, tolerance=tolerance, corrector="newton", tail=tail)


@pytest.mark.parametrize(
    ("sites", "gamma", "g"),
    [
        (70, -0.7, 1.0),
        *(slow(70, *signs) for signs in ((0.7, -1.0), (0.7, 1.0), (-0.7, -1.0))),
        *(slow(140, 0.4, g) for g in (1.0, -1.0)),
    ],
)
def test_an_eliminated_tail_changes_nothing(sites: int, gamma: float, g: float) -> None:
    end = 2.0 if abs(gamma) == 0.7 else 3.0  # 3 Omega reaches the band near S = 2.7 at gamma = 0.7
    tailed, whole = (family(sites, gamma, g, tail, end) for tail in ("eliminated", "full"))
    assert tailed.complete
    assert tailed.space.coordinates.core.cells < 0.6 * sites
    for S in (S for S in AMPLITUDES if end >= S):
        one, other = tailed.at(S), whole.at(S)
        assert abs(one.Omega - other.Omega) < 1e-11
        assert one.Omega_shift == pytest.approx(other.Omega_shift, rel=1e-9)
        assert one.energy == pytest.approx(other.energy, rel=1e-9)
        t = np.linspace(0.0, 3.0, 7)
        np.testing.assert_allclose(one.evaluate(t), other.evaluate(t), atol=1e-10 * np.sqrt(S))
        chosen = [1, sites // 2, sites]
        np.testing.assert_allclose(one.log10_profile, other.log10_profile, atol=1e-9)
        np.testing.assert_array_equal(one.profile_sign, other.profile_sign)
        np.testing.assert_array_equal(one.evaluate(t, sites=chosen), one.evaluate(t)[:, np.array(chosen) - 1])
    if (gamma, g) == (0.7, -1.0):
        mine, theirs = (np.sort_complex(branch.at(1.0).floquet().mu) for branch in (tailed, whole))
        np.testing.assert_allclose(mine, theirs, atol=1e-10)
        assert tailed.at(1.0).floquet_vectors().shape == (140, 140)


@pytest.mark.slow
def test_the_third_harmonic_takes_over_as_in_the_whole_chain() -> None:
    tailed, whole = (family(200, 0.25, -1.0, tail, 3.2, 1e-9) for tail in ("eliminated", "full"))
    assert abs(tailed.at(3.2).Omega - whole.at(3.2).Omega) < 1e-9
    regimes = [tailed.space.coordinates.regime(orbit.point) for orbit in tailed.orbits]
    assert whole.space.coordinates.regime(whole.orbits[0].point) is whole.threshold is None
    assert tailed.threshold == pytest.approx(0.366992903607, abs=1e-11)
    assert [regimes[0], regimes[len(regimes) // 2], regimes[-1]] == [Regime.PINNED, Regime.BOUND, Regime.THIRD]


@pytest.mark.slow
@pytest.mark.parametrize(("g", "known"), [(1.0, 2.3200364277694), slow(-1.0, 0.7659589000207)])
def test_a_million_sites_and_infinitely_many(g: float, known: float) -> None:
    million, infinite = (family(N, 0.25, g, None, 3.0, 1e-11) for N in (10**6, math.inf))
    assert million.complete
    assert infinite.complete
    assert million.at(3.0).Omega == pytest.approx(known, abs=1e-11)
    assert infinite.at(1.0).Omega == pytest.approx(million.at(1.0).Omega, abs=1e-14)
    edge = math.sqrt(3.0 + 2.0 * math.copysign(GAP, g))
    assert infinite.at(0.2).Omega == pytest.approx(edge, abs=1e-15)
    assert infinite.at(0.2).energy == math.inf
    assert infinite.at(3.0).energy == pytest.approx(million.at(3.0).energy, rel=1e-10)


@pytest.mark.parametrize("S", [0.5, slow(3.0)])
def test_sites_of_an_infinite_chain_are_counted_from_its_edge(S: float) -> None:
    right, left = (family(math.inf, gamma, 1.0, None, S).at(S) for gamma in (0.25, -0.25))
    near = right.evaluate(0.0, sites=[0, -1, -2, -300])
    np.testing.assert_allclose(left.evaluate(0.0, sites=[1, 2, 3, 301]), near, rtol=1e-9)
    whole = family(10**6, 0.25, 1.0, None, S).at(S).evaluate(0.0, sites=[10**6, 10**6 - 1, 10**6 - 2, 10**6 - 300])
    np.testing.assert_allclose(near, whole, rtol=1e-9)
    with pytest.raises(ValueError, match="sites: given 0 to 1; accepted: whole numbers up to 0"):
        right.evaluate(0.0, sites=[0, 1])


# The threshold ------------------------------------------------------------------------------------------------------


def balanced_threshold(g: float, gamma: float, sites: int) -> float:
    """S_c by four harmonics of the whole problem in numpy; at the band's edge the tail is constant but for signs."""
    s, decay, e = math.sqrt(1 - gamma**2), math.atanh(gamma), -math.copysign(1.0, g)
    odd, Omega = np.array([1, 3, 5, 7]), math.sqrt(3.0 - 2.0 * e * s)
    basis = np.cos(np.outer((np.arange(8) + 0.5) * np.pi / 16, odd))
    weights = np.exp(-2.0 * decay * np.arange(sites))  # the edge first
    x = (3.0 - (odd * Omega) ** 2) / (2.0 * s)
    ratio = np.append(e, x[1:] + np.sqrt(x[1:] ** 2 - 1.0))  # of neighbours in the tail, by harmonic

    def residual(unknown: np.ndarray) -> np.ndarray:
        q, kappa = unknown[:-1].reshape(sites, odd.size), unknown[-1]
        cubic = (q @ basis.T) ** 3 @ basis / odd.size
        neighbours = np.vstack([np.zeros(odd.size), q[:-1]]) + np.vstack([q[1:], ratio * q[-1]])
        balance = (3.0 - (odd * Omega) ** 2) * q - s * neighbours + kappa * weights[:, None] * cubic
        return np.append(balance.ravel(), np.sum(weights * q.sum(axis=1) ** 2) - 1.0)

    guess = np.zeros((sites, odd.size))
    guess[:, 0] = e ** np.arange(sites) * np.minimum(np.arange(sites) + 1.0, 6.0)
    guess /= math.sqrt(np.sum(weights * guess[:, 0] ** 2))
    found, _, status, words = fsolve(residual, np.append(guess.ravel(), 0.4 * g), xtol=1e-13, full_output=True)
    assert status == 1, words
    return float(found[-1] / g)


@pytest.mark.parametrize("g", [1.0, -1.0])
def test_the_threshold_agrees_with_harmonic_balance(g: float) -> None:
    assert threshold(Chain(24, 1.0, 0.5, g)) == pytest.approx(balanced_threshold(g, 0.5, 40), rel=1e-8)


def test_thresholds_scale_with_g_and_do_not_know_sites_or_direction() -> None:
    S = threshold(Chain(24, 1.0, 0.25, 1.0))
    assert abs(S - 0.367762016876) < 1e-11  # by an independent code, 12 digits
    assert threshold(Chain(24, 1.0, 0.25, -1.0)) == pytest.approx(0.366992903607, abs=1e-11)
    assert threshold(Chain(7, 1.0, -0.25, 4.0)) == pytest.approx(S / 4.0, rel=1e-11)


# Refusals -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chain", "mode", "more", "words"),
    [
        (Chain(200, 1.0, 0.25, 1.0), 1, {"tail": "eliminated"}, "the highest mode with g > 0"),
        (Chain(200, 1.0, 0.0, 1.0), 200, {"tail": "eliminated"}, "0 < |gamma| < 1"),
        (Chain(50, 1.0, 0.25, 1.0), 50, {"tail": "eliminated"}, "more than 9. sites"),
        (Chain(200, 0.1, 0.25, -1.0), 1, {"tail": "eliminated"}, "three times the lowest frequency"),
        (Chain(200, 1.0, 0.25, 1.0), 200, {"tail": "eliminated", "transcription": "gauss"}, "n trigonometric"),
        (Chain(200, 1.0, 0.25, 1.0), 200, {"tail": "cut"}, "tail: given 'cut'; accepted: eliminated, full"),
        (Chain(math.inf, 1.0, 0.25, 1.0), 5, {}, "accepted in an infinite chain: first, last"),  # type: ignore[arg-type]
        (Chain(math.inf, 1.0, 0.25, 1.0), "first", {}, "sites: given an infinite chain; accepted: the highest"),  # type: ignore[arg-type]
        (Chain(math.inf, 1.0, 0.25, 1.0), "last", {"tail": "full"}, 'tail: given "full" with an infinite chain'),  # type: ignore[arg-type]
    ],
)
def test_what_has_no_linear_tail_is_refused(chain: Chain, mode: int | str, more: dict[str, str], words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("|", r"\|")):
        family_request(chain, chain.mode_number(mode), 1.0, **more)  # type: ignore[arg-type]


def test_elimination_is_used_by_itself_where_it_pays() -> None:
    assert not family_request(Chain(1000, 1.0, 0.25, 1.0), 1000, 3.0).coordinates.is_whole
    assert family_request(Chain(200, 1.0, 0.25, 1.0), 200, 3.0).coordinates.is_whole
    assert family_request(Chain(1000, 1.0, 0.25, 1.0), 1000, 3.0, tail="full").coordinates.is_whole
    assert family_request(Chain(1000, 1.0, 0.25, 1.0), 500, 3.0).coordinates.is_whole
    tools = Family(family_request(Chain(10**6, 1.0, 0.25, 1.0), 10**6, 3.0))
    with pytest.raises(ValueError, match="what is asked for is that of all sites"):
        _ = tools.whole


def test_a_linear_chain_has_no_threshold() -> None:
    chain = Chain(24, 1.0, 0.3, 0.0)
    for asked in (chain.threshold, chain.threshold_gradient):
        with pytest.raises(ValueError, match="g: given 0; accepted: not 0"):
            asked()
