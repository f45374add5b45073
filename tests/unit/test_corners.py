"""Corners that steps of a continuation would cut: narrow resonances in which a family goes aside and comes back."""

from __future__ import annotations

import numpy as np
import pytest
from marks import slow

from casadi_skin import Chain, follow_family
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.point import predictor

CHAIN = Chain(19, 0.405, 0.019, -1.0)
OUT, BACK = 0.116823, 0.083189  # S at which the first excursion of its first family turns
SETTINGS = [(1e-6, "series"), (1e-12, "series"), (1e-7, "arclength"), (1e-9, "arclength")]


def _folds(branch: Branch) -> list[float]:
    assert branch.complete
    return [point.parameters["S"] for point in branch.special_points if point.kind == "fold"]


@pytest.mark.parametrize(
    ("sites", "transcription"), [(2, "trigonometric"), (7, "trigonometric"), (3, "gauss"), slow(3, "shooting")]
)
def test_orientation_is_the_sign_of_the_determinant(sites: int, transcription: str) -> None:
    branch = follow_family(Chain(sites, 0.4, 0.1, -1.0), 1, 0.5, tolerance=1e-5, transcription=transcription)
    signs = set()
    for orbit in branch.orbits[::4]:
        problem, solver = orbit.point.problem, orbit.space.point_solver
        for turned in (1.0, -1.0):
            row = turned * solver.metric(problem, orbit.point.z) * orbit.point.tangent
            matrix = np.zeros((problem.size, problem.size))
            matrix[problem.pattern] = problem.evaluate(orbit.point.z)[1]
            matrix[-1] = row
            sign = np.linalg.slogdet(matrix)[0]
            assert solver.factor(problem, orbit.point.z, row).orientation == sign
            signs.add(sign)
    assert signs == {-1.0, 1.0}


@pytest.mark.parametrize(("tolerance", "walker"), [*SETTINGS[:3:2], *(slow(*s) for s in SETTINGS[1::2])])
def test_excursion_whose_two_sides_predict_one_another_is_followed(tolerance: float, walker: str) -> None:
    """Both sides are 1e-3 of a step apart; the family returns as it was, half a period later."""
    branch = follow_family(CHAIN, 1, 0.2, tolerance=tolerance, walker=walker)
    assert _folds(branch) == pytest.approx([OUT, BACK], abs=2e-6)


def test_excursion_reaches_the_orbits_of_the_mode_that_resonates() -> None:
    """Where the excursion turns back, its orbit is one of another mode's family three times over."""
    branch = follow_family(CHAIN, 1, 0.2, tolerance=1e-10)
    turn = next(p.solution for p in branch.special_points if p.kind == "fold" and p.parameters["S"] < 0.1)
    frequencies = CHAIN.linear_frequencies()
    mode = 1 + int(np.argmin(np.abs(frequencies - 3.0 * turn.Omega)))
    other = follow_family(CHAIN, mode, 0.2, at=[turn.S], tolerance=1e-10).at(S=turn.S)
    assert other.Omega == pytest.approx(3.0 * turn.Omega, abs=1e-9)


@pytest.mark.slow
def test_corners_that_lie_elsewhere_on_coarser_levels_are_walked_round() -> None:
    """7, 5 and 3 Omega meet modes of a chain of hardly coupled lowest mode; the corners are 2e-5 to 2e-4 wide."""
    runs = [(1e-7, "series"), (1e-9, "series"), (1e-8, "arclength")]
    folds = [_folds(follow_family(Chain(24, 1e-8, 0.25, 1.0), 1, 3.0, tolerance=t, walker=w)) for t, w in runs]
    known = [0.015447, 0.011112, 0.059918, 0.030412, 1.457849, 0.324977]
    for found in folds:
        assert found == pytest.approx(known, abs=1e-6)


def test_a_prediction_goes_along_the_tangent_where_rounding_spoils_the_polynomial() -> None:
    """A line whose places are off by 1e-9 and the steps 1e-6; a circle keeps its history."""
    noise = np.random.default_rng(0).normal(size=(5, 2))
    line = [(np.array([1e-6 * k, 0.0]) + 1e-9 * noise[k], np.array([1.0, 0.0]) + 1e-4 * noise[k]) for k in range(5)]
    angles = 0.2 * np.arange(5)
    circle = [(np.array([np.sin(a), np.cos(a)]), np.array([np.cos(a), -np.sin(a)])) for a in angles]
    for points, kept in ((line, 1), (circle, 5)):
        known, row = np.array(points[::-1]), points[-1][1]
        found, all_of_them, others = (
            predictor(*each)(0.2) for each in ((known, row, np.ones(2)), (known, row), (known[:kept], row))
        )
        np.testing.assert_array_equal(found, others)
        assert np.array_equal(found, all_of_them) == (kept == 5)


@pytest.mark.slow
def test_folds_and_changes_do_not_depend_on_how_a_family_is_followed() -> None:
    whole = [_folds(follow_family(CHAIN, 1, 2.705, tolerance=t, walker=w)) for t, w in SETTINGS[::3]]
    assert [len(folds) for folds in whole] == [18, 18]
    assert np.sort(whole[0]) == pytest.approx(np.sort(whole[1]), abs=1e-5)
    short = [follow_family(CHAIN, 1, 0.15, tolerance=t, walker=w, stability=True) for t, w in SETTINGS[1:3]]
    changes = [sorted(change.S for change in branch.changes) for branch in short]
    assert len(changes[0]) > 3
    assert changes[0] == pytest.approx(changes[1], abs=1e-8)
    assert not any(branch.unresolved for branch in short)
