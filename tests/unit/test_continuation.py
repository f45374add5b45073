"""The walk along families of chains: exact frequencies, requested points, ends by name, folds, and honest errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from marks import slow

from casadi_skin import Branch, Chain, Orbit, follow_family
from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.family import Family
from casadi_skin.follow.point import LocalCurve, PointSolver, predictor
from casadi_skin.lattice.closed_forms import duffing_displacement, duffing_frequency
from casadi_skin.solve.ipopt import ArbitratedCorrector
from casadi_skin.solve.newton import Correction, HeldState, Status
from casadi_skin.zero.family import family_request
from casadi_skin.zero.settings import End, Point

ROUND_OFF = 5e-15  # of Omega: some units in the last place, which no estimate resolves

# N = 24, alpha = 1, gamma = 0.25 and S -> Omega, computed independently.
SOFTENING_END = {0.2: 1.036393147166972, 1.0: 1.018532435491958, 3.0: 0.765958900020734}  # j = 1, g = -1
HARDENING_END = {0.2: 2.219433261085633, 1.0: 2.227561552547991, 3.0: 2.320036427769367}  # j = 24, g = +1
LONG_CHAIN = {0.2: 1.0313667541205, 3.0: 0.7659589000207}  # N = 200, j = 1, g = -1

# Families that fold in S and come back, found by search: chain, mode, S beyond the fold.
FOLDED = [
    (Chain(6, 2.342, 0.33, 1.0), 3, 10.0),
    (Chain(4, 1.219, 0.57, 1.0), 3, 10.0),
    (Chain(2, 1.224, 0.86, -1.0), 1, 3.2),
]


@cache
def followed(
    chain: Chain,
    mode: int,
    amplitude_max: float,
    tolerance: float,
    at: tuple[float, ...] = (),
    method: str = "trigonometric",
) -> Branch:
    """A family followed once for all tests, by Newton."""
    return follow_family(
        chain, mode, amplitude_max, at=at, tolerance=tolerance, transcription=method, corrector="newton"
    )


def exact_frequency(chain: Chain, S: float) -> float:
    return duffing_frequency(2.0 + chain.alpha, chain.g, np.sqrt(S))


# One site: the Duffing oscillator -----------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-6, slow(1e-11)])
@pytest.mark.parametrize(("g", "amplitude_max"), [(1.0, 50.0), (-1.0, 2.5)])
def test_one_site_at_requested_amplitudes_is_within_the_estimated_error_of_the_exact_frequency(
    g: float, amplitude_max: float, tolerance: float
) -> None:
    chain, at = Chain(1, 1.0, 0.0, g), tuple(float(S) for S in amplitude_max * np.linspace(0.05, 1.0, 12))
    branch = followed(chain, 1, amplitude_max, tolerance, at)
    for S in at:
        orbit = branch.at(S)
        exact = exact_frequency(chain, S)
        assert abs(orbit.Omega - exact) <= orbit.Omega_error + ROUND_OFF * exact
        assert orbit.Omega_error <= tolerance * exact
        t = np.linspace(0.0, orbit.period, 41)
        y = duffing_displacement(3.0, g, np.sqrt(S), t * orbit.Omega / exact)
        assert np.abs(orbit.evaluate(t)[:, 0] - y).max() <= (orbit.profile_error + 1e-14) * np.sqrt(S)


# Reference values ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("corrector", ["newton", slow("ipopt")])
@pytest.mark.parametrize("walker", ["series", slow("arclength")])
@pytest.mark.parametrize(
    ("mode", "g", "expected"), [(1, -1.0, SOFTENING_END), (24, 1.0, HARDENING_END)], ids=["softening", "hardening"]
)
def test_end_breathers_have_the_reference_frequencies(
    mode: int, g: float, expected: dict[float, float], walker: str, corrector: str
) -> None:
    options: dict[str, Any] = {"tolerance": 1e-12, "walker": walker, "corrector": corrector}
    branch = follow_family(Chain(24, 1.0, 0.25, g), mode, 3.0, at=tuple(expected), **options)
    assert branch.complete
    for S, Omega in expected.items():
        orbit = branch.at(S)
        assert orbit.point.requested or S == 3.0
        assert orbit.Omega == pytest.approx(Omega, rel=3e-14)
        assert abs(orbit.Omega - Omega) <= orbit.Omega_error + ROUND_OFF


def test_a_long_chain_stays_on_its_family_where_others_lie_close() -> None:
    """With steps in S alone Omega(3) = 1.0314, on another family, and every solve reports success."""
    branch = followed(Chain(200, 1.0, 0.25, -1.0), 1, 3.0, 1e-10, (0.2,))
    assert branch.complete
    for S, Omega in LONG_CHAIN.items():
        assert branch.at(S).Omega == pytest.approx(Omega, abs=1e-9)
    # The family leaves the band's edge continuously: neighbouring profiles overlap.
    for a, b in pairwise(branch.orbits):
        cosine = a.profile @ b.profile / np.linalg.norm(a.profile) / np.linalg.norm(b.profile)
        assert cosine > 0.9


def walked_with(
    chain: Chain, mode: int, amplitude_max: float, **changes: float
) -> tuple[ArclengthContinuation, list[Point]]:
    """A walk with changed settings and its points."""
    tools = Family(family_request(chain, mode, amplitude_max, tolerance=1e-6, corrector="newton"))
    point_solver = PointSolver(tools.levels, replace(tools.request.continuation_settings(), **changes))  # type: ignore[arg-type]
    start = point_solver.start(tools.coordinates.mode, tools.coordinates.core.linear_frequency(mode))
    walk = ArclengthContinuation(point_solver, (start,))
    return walk, list(walk)


def test_the_guard_alone_keeps_a_walk_of_far_too_long_steps_on_its_family() -> None:
    """Without it the walk lands on another family, converged at every point."""
    eager = {"aim_angle": 1000.0, "max_step": 10.0, "max_parameter_step": 1.0, "first_step": 2.0}
    chain = Chain(60, 1.0, 0.7, -1.0)
    right = followed(chain, 1, 2.5, 1e-8).at(2.5).Omega
    walk, points = walked_with(chain, 1, 2.5, **eager)
    assert walk.end is End.REACHED
    assert walk.rejected > 5
    assert points[-1].Omega == pytest.approx(right, rel=1e-6)
    walk, points = walked_with(chain, 1, 2.5, **eager, guard_distance=8.0, guard_angle=180.0)
    assert walk.end is End.REACHED
    assert abs(points[-1].Omega - right) > 0.1


# Points asked for ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("corrector", ["newton", slow("ipopt")])
@pytest.mark.parametrize("g", [-1.0, 0.7, 3.0])
def test_points_lie_exactly_at_the_amplitudes_asked_for(g: float, corrector: str) -> None:
    """Equal as floating-point numbers, though the walk's parameter is g S."""
    at = (0.1, 0.3, 0.35, 0.7, 1.1, 1.3)
    branch = follow_family(Chain(5, 1.0, 0.3, g), 1, 1.5, at=at, corrector=corrector)
    assert branch.complete
    assert tuple(o.S for o in branch.orbits if o.point.requested) == at
    assert branch.S[-1] == 1.5
    assert not branch.orbits[-1].point.requested
    assert np.all(np.diff(branch.S) > 0)
    for S in at:
        assert branch.at(S) in branch.orbits
        assert np.sum(branch.at(S).profile ** 2) == pytest.approx(S, rel=1e-10)


def test_what_is_asked_for_does_not_change_the_walk() -> None:
    chain = Chain(4, 1.0, 0.3, 1.0)
    plain, asked = followed(chain, 2, 2.0, 1e-8), followed(chain, 2, 2.0, 1e-8, (0.4, 1.7))
    walked = [o for o in asked.orbits if not o.point.requested]
    np.testing.assert_array_equal([o.S for o in walked], plain.S)
    np.testing.assert_array_equal([o.Omega for o in walked], plain.Omega)


def test_an_orbit_asked_for_later_is_corrected_exactly_there() -> None:
    """Also beside a stored one, whatever the nonlinearity; and refused where the branch does not pass."""
    chain = Chain(5, 1.0, 0.3, -1.0)
    branch, exact = (followed(chain, 1, 1.5, 1e-10, at) for at in ((), (0.123, 1.31)))
    for S in (0.123, 1.31):
        orbit = branch.at(S)
        assert orbit not in branch.orbits
        assert orbit.S == S
        assert orbit.Omega == pytest.approx(exact.at(S).Omega, rel=1e-10)
        assert orbit.residual < 1e-13
    np.testing.assert_array_equal(branch.at(float(branch.S[3])).Omega, branch.Omega[3])
    for k in (4, 9, 20):
        for offset in (1e-13, -1e-13, 5e-13):
            S = float(branch.S[k] * (1 + offset))
            assert branch.at(S).S == S
            assert branch.at(S).Omega == pytest.approx(branch.Omega[k], rel=1e-11)
    for S in (0.3, 0.7, 1.1):
        assert followed(Chain(2, 1.0, 0.2, 0.1), 1, 2.0, 1e-8).at(S).S == S
    for S, which in ((1.6, 0), (-0.2, 0), (0.5, 1)):
        with pytest.raises(ValueError, match=r"the branch covers .* to 1.5 and passes"):
            branch.at(S, which)
    with pytest.raises(ValueError, match="which"):
        branch.at(0.4, which=-1)


def test_a_point_asked_for_where_the_walk_goes_anyway_is_there_once_and_marked() -> None:
    """At the point of a walk, at its end, and beside one; and progress hears of all in order."""
    chain = Chain(5, 1.0, 0.25, -1.0)
    walked = followed(chain, 1, 2.0, 1e-6).S
    for S in (*walked[1:8].tolist(), 2.0, float(walked[6] * (1 + 2e-13))):
        heard: list[Orbit] = []
        branch = follow_family(chain, 1, 2.0, at=[S], tolerance=1e-6, corrector="newton", progress=heard.append)
        assert tuple(heard) == branch.orbits
        assert (branch.end, branch.reason) == (End.REACHED, "reached the end asked for")
        assert [o.S for o in branch.orbits if o.point.requested] == [S]
        assert np.count_nonzero(branch.S == S) == 1


@pytest.mark.parametrize(("sites", "mode", "g", "S"), [(6, 5, -1.0, 4.0), (5, 5, 1.0, 6.0)])
def test_the_largest_displacement_is_positive_also_where_it_moves_to_another_site(
    sites: int, mode: int, g: float, S: float
) -> None:
    branch = followed(Chain(sites, 1.0, 0.42, g), mode, S, 1e-8)
    largest = [int(np.argmax(np.abs(orbit.profile))) for orbit in branch.orbits]
    assert len(set(largest)) > 1
    assert all(orbit.profile[n] > 0 for orbit, n in zip(branch.orbits, largest, strict=True))


# Ends ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("walker", ["series", "arclength"])
def test_resolutions_and_points_that_do_not_suffice_end_the_walk_by_name(walker: str) -> None:
    """Two resolutions only: what a stronger nonlinearity needs is not there."""
    options: dict[str, Any] = {"tolerance": 1e-10, "corrector": "newton", "walker": walker}
    tools = Family(family_request(Chain(1, 1.0, 0.0, 1.0), 1, 50.0, **options))
    tools.levels.resolutions = (4, 6)
    walk = tools.continuation((tools.start,))
    points = list(walk)
    assert walk.end is End.RESOLUTION
    assert 0 < len(points) < 60
    short = Family(family_request(Chain(2, 1.0, 0.3, 1.0), 1, 1.0, max_points=3, **options))
    walk = short.continuation((short.start,))
    assert len(list(walk)) >= 3
    assert (walk.end, walk.detail) == (End.POINTS, "3 points")


# Folds --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("chain", "mode", "amplitude_max"), FOLDED)
def test_the_walk_passes_folds_in_the_amplitude(chain: Chain, mode: int, amplitude_max: float) -> None:
    branch = followed(chain, mode, amplitude_max, 1e-10)
    assert branch.complete
    turns = np.flatnonzero(np.diff(np.sign(np.diff(branch.S)))) + 1
    assert len(turns) == 2
    high, low = branch.S[turns]
    assert high > low
    # Three passages between the folds, one outside.
    S = 0.5 * (low + high)
    orbits = [branch.at(S, which) for which in range(3)]
    with pytest.raises(ValueError, match="passes S 3 times"):
        branch.at(S, 3)
    for orbit in orbits:
        assert abs(orbit.S - S) <= 1e-15 * S
        assert orbit.residual < 1e-12
        assert np.sum(orbit.profile**2) == pytest.approx(S, rel=1e-12)
    for a, b in pairwise(orbits):
        assert abs(a.Omega - b.Omega) > 1e-4
        assert np.abs(a.profile - b.profile).max() > 1e-2
    outside = 0.5 * (high + amplitude_max)
    assert branch.at(outside).Omega > 0
    with pytest.raises(ValueError, match="passes S 1 times"):
        branch.at(outside, 1)


def test_requested_points_are_given_at_every_passage() -> None:
    chain, mode, amplitude_max = FOLDED[1]
    branch = followed(chain, mode, amplitude_max, 1e-8, (6.05, 7.0))
    assert [o.S for o in branch.orbits if o.point.requested] == [6.05, 6.05, 6.05, 7.0]
    found = [o.Omega for o in branch.orbits if o.S == 6.05]
    assert found == [branch.at(6.05, which).Omega for which in range(3)]
    assert len(set(found)) == 3


def test_the_walk_ends_at_its_end_when_a_fold_lies_just_beyond() -> None:
    """The fold is at S = 6.1224905; the walk is to stop a little before it, the first time it gets there."""
    chain, mode, _ = FOLDED[1]
    for below in (1e-7, 1e-6, 1e-5, 4e-5):
        branch = followed(chain, mode, 6.1224904737 - below, 1e-8)
        assert list(branch.S).count(6.1224904737 - below) == 1
        assert np.all(np.diff(branch.S) > 0)


# Errors -------------------------------------------------------------------------------------------------------------

COMBINATIONS = [
    (Chain(24, 1.0, 0.25, -1.0), 1, 3.0),
    (Chain(24, 1.0, 0.25, 1.0), 24, 3.0),
    (Chain(8, 1.0, 0.6, -1.0), 1, 2.0),
    (Chain(6, 2.342, 0.33, 1.0), 3, 7.0),
    (Chain(5, 0.5, -0.3, -1.0), 4, 3.0),
    (Chain(12, 1.0, 0.4, 1.0), 1, 3.0),
]


@pytest.mark.parametrize(
    ("chain", "mode", "amplitude_max"),
    [*COMBINATIONS[2:5], *(slow(*case) for case in (*COMBINATIONS[:2], COMBINATIONS[5]))],
)
@pytest.mark.parametrize("tolerance", [1e-6, *(slow(t) for t in (1e-3, 1e-9))])
def test_the_estimated_error_covers_the_true_one(
    chain: Chain, mode: int, amplitude_max: float, tolerance: float
) -> None:
    at = tuple(float(S) for S in amplitude_max * np.linspace(0.1, 1.0, 7))
    reference = followed(chain, mode, amplitude_max, 1e-12, at)
    branch = followed(chain, mode, amplitude_max, tolerance, at)
    assert reference.complete
    assert branch.complete
    for S in at:
        orbit, exact = branch.at(S), reference.at(S)
        error = abs(orbit.Omega - exact.Omega)
        assert error <= orbit.Omega_error + exact.Omega_error + ROUND_OFF * exact.Omega
        # Honest the other way too: not so large that it tells nothing.
        assert orbit.Omega_error <= 100.0 * error + 1e-12
        assert orbit.Omega_error <= tolerance * orbit.Omega
        t = np.linspace(0.0, 0.25, 17)
        difference = orbit.evaluate(t * orbit.period) - exact.evaluate(t * exact.period)
        largest = np.abs(exact.profile).max()
        # In the gauge, where it is estimated, the largest component is another one than in the chain.
        gauge = difference / chain.rho
        largest_gauge = np.abs(exact.evaluate(t * exact.period) / chain.rho).max()
        assert np.abs(gauge).max() <= 1.1 * (orbit.profile_error + exact.profile_error + 1e-13) * largest_gauge
        assert np.abs(difference).max() <= tolerance * largest


@pytest.mark.parametrize("tolerance", [1e-4, *(slow(t) for t in (1e-6, 1e-8))])
def test_the_estimated_error_covers_the_true_one_at_points_walked(tolerance: float) -> None:
    """A point of the table is (S, Omega): the error of Omega is meant at that S."""
    chain = Chain(24, 1.0, 0.25, -1.0)
    reference, branch = followed(chain, 1, 3.05, 1e-12), followed(chain, 1, 3.0, tolerance)
    for orbit in branch.orbits:
        exact = reference.at(orbit.S)
        assert abs(orbit.Omega - exact.Omega) <= orbit.Omega_error + exact.Omega_error + 2 * ROUND_OFF


# Local curve --------------------------------------------------------------------------------------------------------


ROOTS: list[tuple[float, ...]] = [
    (), (0.2,), (0.2, 0.7), (0.1, 0.5, 0.9), (0.3, 0.31), (-0.2, 0.4), (0.4, 1.4), (-0.5, 0.25, 2.0), (-1.0,),
    (0.2, 0.7, 1.0), (0.1, 0.104, 0.9),
]  # fmt: skip


@pytest.mark.parametrize("roots", ROOTS)
@pytest.mark.parametrize("value", [0.0, -2.5, 1e3])
def test_every_crossing_is_found_and_no_other(roots: tuple[float, ...], value: float) -> None:
    """A fold passes a value twice, and both passages count; those behind the start and beyond the end do not."""
    polynomial = np.zeros(4)
    polynomial[: len(roots) + 1] = np.atleast_1d(np.poly(roots))[::-1]
    polynomial[0] += value
    curve = LocalCurve(np.column_stack([[0.0, 1.0, 0.0, 0.0], polynomial]), 1.1)
    found = [sigma for sigma, _ in curve.crossings(1, [value])]
    assert found == pytest.approx([r for r in roots if 0 < r <= 1.1], abs=1e-8 if value > 100 else 1e-12)
    assert found == sorted(found)


@pytest.mark.parametrize("wanted", [0.3, 0.6, 1.0])
def test_ipopt_that_refuses_one_of_several_points_leaves_it_named(
    wanted: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    true_confirm = ArbitratedCorrector.confirm_all

    def confirm_all(self: ArbitratedCorrector, points: Sequence[HeldState]) -> list[Correction]:
        found = true_confirm(self, points)
        refused = [abs(value) == wanted and np.count_nonzero(row) == 1 for _, row, value in points]
        return [replace(c, status=Status.INFEASIBLE) if no else c for c, no in zip(found, refused, strict=True)]

    monkeypatch.setattr(ArbitratedCorrector, "confirm_all", confirm_all)
    branch = follow_family(Chain(2, 1.0, 0.3, 1.0), 1, 1.0, at=[0.3, 0.6], walker="series")
    check_missed(branch, wanted)


def test_a_prediction_from_four_points_is_exact_to_degree_seven() -> None:
    """Checked on the graph of a polynomial; with fewer points the degree falls by two a point."""
    graph = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.2, -0.4, 0.1, 0.3, -0.2])

    def point(x: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([x, graph(x)]), 1.7 * np.array([1.0, graph.deriv()(x)])  # tangents of any length

    row = np.array([1.0, 0.0])
    points = np.array([point(x) for x in (0.0, -0.2, -0.5, -0.6)])
    np.testing.assert_allclose(predictor(points, row)(0.4), point(0.4)[0], atol=1e-12)
    misses = [abs(predictor(points[: n + 1], row)(0.1)[1] - graph(0.1)) for n in range(4)]
    assert misses[0] > 5 * misses[1]
    assert misses[1] > misses[2] > 1e6 * misses[3]


def test_what_does_not_change_is_predicted_as_it_is() -> None:
    """To the last bit: where steps grow, what a prediction is off by is multiplied by the next ones."""
    points = np.array([[[x, 1.2769861417560822], [1.0, 0.0]] for x in (0.0, -0.55, -0.86, -1.03)])
    row = np.array([1.0, 0.0])
    assert [predictor(points[:n], row)(1.0)[1] for n in range(1, 5)] == 4 * [1.2769861417560822]


def test_a_prediction_leaves_out_points_that_lie_behind_a_turn() -> None:
    z, t, row = np.array([0.0, 0.0]), np.array([1.0, 0.0]), np.array([1.0, 0.0])
    good = (np.array([-0.1, 0.01]), np.array([1.0, -0.2]))
    behind = (np.array([-0.05, 1.0]), np.array([-1.0, 0.0]))
    with_all, with_good = (predictor(np.array([(z, t), *before]), row) for before in ([good, behind], [good]))
    np.testing.assert_array_equal(with_all(0.1), with_good(0.1))


def check_missed(branch: Branch, wanted: float) -> None:
    """The branch went on to its end, and says which amplitude is missing."""
    assert branch.end is End.REACHED
    assert not branch.complete
    assert branch.missed == (wanted,)
    assert f"S = {wanted:g}" in branch.reason
    assert [o.S for o in branch.orbits if o.point.requested] == [S for S in (0.3, 0.6) if wanted != S]
