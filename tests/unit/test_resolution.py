"""Resolution along a branch: up and down with the orbit, and what round-off leaves when it is fine enough."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from marks import slow

from casadi_skin import Branch, Chain, follow_family
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchRun
from casadi_skin.lattice.closed_forms import duffing_frequency


@cache
def followed(chain: Chain, mode: int, amplitude_max: float, tolerance: float, method: str = "trigonometric") -> Branch:
    """A family followed once for all tests, by Newton."""
    return follow_family(chain, mode, amplitude_max, tolerance=tolerance, transcription=method, corrector="newton")


def exact_frequency(chain: Chain, S: float) -> float:
    return duffing_frequency(2.0 + chain.alpha, chain.g, np.sqrt(S))


# Resolution that follows the orbit ----------------------------------------------------------------------------------

# Needs most harmonics about the folds and fewer after them, found by search.
HARDEST_AMID = (Chain(2, 0.808, 0.65, -1.0), 1, 3.3)


@pytest.mark.parametrize("method", ["trigonometric", slow("gauss")])
def test_the_resolution_comes_down_where_less_will_do_and_does_not_waver(method: str) -> None:
    chain, mode, amplitude_max = HARDEST_AMID
    branch = followed(chain, mode, amplitude_max, 1e-8, method=method)
    assert branch.complete
    resolutions = np.array([o.point.problem.resolution for o in branch.orbits])
    assert resolutions[0] < resolutions.max()
    assert resolutions[-1] < resolutions.max()
    for orbit in branch.orbits:
        assert orbit.point.error.relative(orbit.Omega) <= 1e-8
    changes = np.diff(resolutions)
    down_and_up = np.count_nonzero((changes[:-1] < 0) & (changes[1:] > 0))
    assert np.count_nonzero(changes < 0) >= 1
    assert down_and_up <= 1


def test_the_error_expected_of_fewer_harmonics_is_about_the_error_found() -> None:
    branch = followed(Chain(6, 1.0, 0.4, -1.0), 1, 2.0, 1e-12)
    levels = branch.space.levels
    ratios = []
    for orbit in branch.orbits[len(branch) // 2 :: 3]:
        point, coarser = orbit.point, levels.problem(6)
        expected = point.problem.expected_error(point.z, 1e-12, coarser)
        correction = levels.corrector(coarser).correct(
            point.problem.prolong(point.z, coarser), coarser.parameter_row(), point.parameter
        )
        ratios.append(levels.refined(coarser, correction.z)[0].relative(point.Omega) / expected)
    assert min(ratios) > 0.1
    assert max(ratios) < 3.0  # less than 1/COARSEN: or a coarser level would be left as soon as it is tried


def test_a_walk_that_comes_down_is_broken_off_and_goes_on_as_if_it_had_not_been() -> None:
    chain, mode, amplitude_max = HARDEST_AMID
    branch = followed(chain, mode, amplitude_max, 1e-8)
    resolutions = [o.point.problem.resolution for o in branch.orbits]
    # just before the last step down
    kept = 1 + max(k for k in range(len(resolutions) - 1) if resolutions[k + 1] < resolutions[k])
    again = BranchRun(Family(branch.space.request), solutions=branch.orbits[:kept])
    list(again)
    np.testing.assert_array_equal(again.branch().S, branch.S)
    np.testing.assert_array_equal(again.branch().Omega, branch.Omega)


# Round-off ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("g", "amplitude_max"), [(1.0, 50.0), slow(-1.0, 2.9), slow(0.5, 3.0)])
@pytest.mark.parametrize("method", ["trigonometric", "gauss", slow("radau")])
def test_at_the_tightest_tolerance_the_estimates_cover_the_true_errors_or_tell_of_round_off(
    g: float, amplitude_max: float, method: str
) -> None:
    branch = followed(Chain(1, 1.0, 0.0, g), 1, amplitude_max, 1e-13, method=method)
    assert branch.complete
    for orbit in branch.orbits:
        exact = exact_frequency(branch.space.model, orbit.S)
        assert abs(orbit.Omega - exact) <= 1.2 * orbit.Omega_error + 1e-15 * exact
        assert orbit.Omega_error >= 2e-15 * orbit.Omega
        assert orbit.at_round_off == (orbit.point.error.relative(orbit.Omega) > 1e-13)


@pytest.mark.parametrize("sites", [2, 10, slow(40)])
def test_rounding_of_the_derivative_matrix_does_not_show_in_the_frequency(sites: int) -> None:
    """The same orbit on many resolutions: they differ by round-off only, and by less than the estimates say."""
    chain = Chain(sites, 0.9, 0.25, -1.0)
    branch = followed(chain, 1, 0.8, 1e-12)
    levels, point = branch.space.levels, branch.orbits[-1].point
    found, estimates = [], []
    for harmonics in (14, 16, 20, 24, 28, 32, 40):
        problem = levels.problem(harmonics)
        z = point.problem.prolong(point.z, problem)
        z = levels.corrector(problem).correct(z, problem.parameter_row(), point.parameter).z
        found.append(z[problem.Omega_index] / point.Omega)
        estimates.append(levels.refined(problem, z)[0].Omega / point.Omega)
    assert np.ptp(found) < 4e-15
    assert np.ptp(found) <= 2.0 * min(estimates)


def test_where_round_off_stands_in_the_way_the_orbit_says_so() -> None:
    """Near the top of its well an oscillator's frequency is so sensitive that round-off is seen."""
    branch = followed(Chain(1, 1.0, 0.0, -1.0), 1, 2.99, 1e-13)
    flags = [o.at_round_off for o in branch.orbits]
    assert not any(flags[: len(flags) // 4])
    assert flags[-1]
    assert not any(o.at_round_off for o in followed(Chain(1, 1.0, 0.0, -1.0), 1, 2.99, 1e-8).orbits)
