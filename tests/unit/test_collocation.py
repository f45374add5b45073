"""Collocation on a mesh that moves: meshes as constants, what their placement saves, and the degree."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from marks import slow
from orbit_problems import gauss_problem

from casadi_skin import Branch, Chain, Orbit
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchRun
from casadi_skin.lattice.closed_forms import duffing_frequency
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.results.branch_records import PointRecord, known_of, point_record
from casadi_skin.zero.butcher import gauss_table, radau_table
from casadi_skin.zero.collocation import CollocationProblem
from casadi_skin.zero.family import family_request
from casadi_skin.zero.problem import OrbitProblem

QUARTER, FULL = SymmetryClass.QUARTER, SymmetryClass.FULL
TABLES = {"gauss": gauss_table, "radau": radau_table}


# Placement along a branch -------------------------------------------------------------------------------------------


def followed(tools: Family) -> Branch:
    walk = BranchRun(tools)
    list(walk)
    return walk.branch()


def never_placed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes stay even; resolutions go up and down as ever."""
    monkeypatch.setattr(CollocationProblem, "imbalance", lambda *_: 1.0)
    monkeypatch.setattr(CollocationProblem, "expected_error", OrbitProblem.expected_error)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "most"), [("gauss", 0.55), ("radau", 0.55)])
def test_placing_saves_intervals_where_the_orbit_rests_for_long(
    kind: str, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One softening site next to the top of its well, S = 3, where it stays for most of the period."""
    request = family_request(
        Chain(1, 1.0, 0.0, -1.0), 1, 2.9999999, tolerance=1e-8, transcription=kind, corrector="newton", degree=8
    )
    placed = followed(Family(request))
    never_placed(monkeypatch)
    even = followed(Family(request))
    assert placed.complete
    assert even.complete
    sizes = [branch.orbits[-1].point.problem.resolution for branch in (placed, even)]
    assert sizes[0] <= most * sizes[1]
    assert placed.orbits[-1].point.error.profile <= 1e-8
    assert placed.orbits[-1].Omega == pytest.approx(duffing_frequency(3.0, -1.0, np.sqrt(2.9999999)), rel=1e-6)
    lengths = placed.orbits[-1].point.problem.constants
    assert np.max(lengths) > 3.0 * np.min(lengths)


@pytest.mark.slow
@pytest.mark.parametrize("S", [2.99, slow(2.9999)])
def test_a_mesh_survives_the_journal_and_the_walk_goes_on_as_if_not_broken_off(S: float) -> None:
    request = family_request(
        Chain(1, 1.0, 0.0, -1.0), 1, S, at=(2.0,), tolerance=1e-8, transcription="gauss", corrector="newton"
    )
    whole = [o for o in BranchRun(Family(request)) if isinstance(o, Orbit)]
    meshes = {o.point.problem.constants.tobytes() for o in whole}
    assert len(meshes) > 3  # it did move
    records = [msgspec.msgpack.encode(point_record("mode 1", k, o.point)) for k, o in enumerate(whole)]
    for kept in (len(whole) // 2, len(whole) - 3):
        known = known_of(
            [msgspec.msgpack.decode(r, type=PointRecord) for r in records[:kept]], "mode 1", Family(request), False
        )
        assert known.fault == ""
        walk = BranchRun(Family(request), solutions=known.solutions)
        list(walk)
        again = walk.branch().orbits
        assert len(again) == len(whole)
        for one, other in zip(again, whole, strict=True):
            np.testing.assert_array_equal(one.point.z, other.point.z)
            np.testing.assert_array_equal(one.point.problem.constants, other.point.problem.constants)


# Points that cannot be evaluated --------------------------------------------------------------------------------------


def test_points_of_one_programme_that_cannot_be_evaluated_leave_the_others_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = gauss_problem(Chain(4, 1.0, 0.3, -1.0).gauge_model(), 2, SymmetryClass.QUARTER, 3)
    z = np.random.default_rng(1).normal(size=(3, problem.size))
    assembled = CollocationProblem._values

    def values(self: CollocationProblem, point: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if np.array_equal(point, z[1]):
            raise ArithmeticError
        return assembled(self, point, numbers)

    monkeypatch.setattr(CollocationProblem, "_values", values)
    residuals, nonzeros = problem.evaluated(z, problem.numbers)
    assert np.all(np.isnan(residuals[1]))
    assert np.all(np.isnan(nonzeros[1]))
    expected = problem.evaluate_all(z[::2])
    np.testing.assert_allclose(residuals[::2], expected[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(nonzeros[::2], expected[1], rtol=0, atol=1e-13)


# Asked for by name --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degree", "kind"),
    [(2, "gauss"), (4, "radau"), *(slow(d, k) for d, k in ((2, "radau"), (4, "gauss"), (11, "gauss"), (11, "radau")))],
)
def test_a_degree_may_be_asked_for(kind: str, degree: int) -> None:
    tools = Family(
        family_request(
            Chain(1, 1.0, 0.0, -1.0), 1, 2.0, tolerance=1e-4, transcription=kind, corrector="newton", degree=degree
        )
    )
    branch = followed(tools)
    assert branch.complete
    problem = branch.orbits[-1].point.problem
    np.testing.assert_array_equal(problem.table.nodes, TABLES[kind](degree).nodes)
    assert problem.degree == degree
    assert branch.orbits[-1].Omega == pytest.approx(duffing_frequency(3.0, -1.0, np.sqrt(2.0)), rel=1e-4)


def test_degrees_that_make_no_sense_are_refused() -> None:
    chain = Chain(1, 1.0, 0.0, -1.0)
    for degree in (1, 13, 2.5):
        with pytest.raises(ValueError, match=r"degree: given .*; accepted: a whole number from 2 to 12"):
            family_request(chain, 1, 1.0, transcription="radau", degree=degree)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="degree: given 4; accepted: with gauss or radau only"):
        family_request(chain, 1, 1.0, degree=4)


@pytest.mark.parametrize(("tolerance", "degree"), [(1e-2, 4), (1e-4, 5), (1e-8, 8), (1e-12, 11), (1e-13, 12)])
def test_the_degree_left_out_goes_with_the_tolerance(tolerance: float, degree: int) -> None:
    for kind in ("gauss", "radau"):
        request = family_request(Chain(1, 1.0, 0.0, -1.0), 1, 1.0, tolerance=tolerance, transcription=kind)
        assert request.degree == degree


@pytest.mark.parametrize("tolerance", [1e-4, slow(1e-9)])
def test_radau_is_within_its_estimate_of_odd_cosines(tolerance: float) -> None:
    chain, at = Chain(4, 1.0, 0.4, -1.0), (0.3, 1.0, 1.5)
    branch = followed(
        Family(family_request(chain, 1, 1.5, at=at, tolerance=tolerance, transcription="radau", corrector="newton"))
    )
    exact = followed(Family(family_request(chain, 1, 1.5, at=at, tolerance=1e-12, corrector="newton")))
    for S in at:
        assert abs(branch.at(S).Omega - exact.at(S).Omega) <= branch.at(S).Omega_error + exact.at(S).Omega_error
        assert branch.at(S).Omega_error <= tolerance * branch.at(S).Omega
