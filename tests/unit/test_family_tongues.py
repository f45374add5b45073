"""Every change of stability along families: what is known of some, and that the list is the same by every way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from small_models import fput, pendulums

from casadi_skin import Branch, Chain, OdeModel, follow_family
from casadi_skin.follow import family_changes
from casadi_skin.follow.family import Family
from casadi_skin.stability.tongues import interpolation
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.find_changes import find_changes


def slow(*values: Any) -> Any:
    """Parameters of a test that takes long."""
    return pytest.param(*values, marks=pytest.mark.slow)


@cache
def followed(chain: Chain, mode: int, S_max: float, tolerance: float = 1e-8) -> Branch:
    return follow_family(chain, mode, S_max, tolerance=tolerance, stability=False)


def tongues_along(branch: Branch, flow_tolerance: float = family_changes.FLOW_TOLERANCE) -> StabilityDiagram:
    space = branch.space
    assert isinstance(space, Family)
    points = (branch.start, *(orbit.point for orbit in branch.orbits))
    return family_changes.family_tongues(space, points, flow_tolerance)


@cache
def diagram_of(chain: Chain, mode: int, S_max: float, tolerance: float = 1e-8) -> StabilityDiagram:
    return tongues_along(followed(chain, mode, S_max, tolerance))


def test_the_first_family_has_the_changes_that_are_known() -> None:
    diagram = diagram_of(Chain(24, 1.0, 0.25, -1.0), 1, 3.0)
    assert len(diagram.changes) == 47
    assert not diagram.undecided
    assert not diagram.windows
    assert not diagram.unresolved


@pytest.mark.parametrize(
    ("chain", "S_max", "starts"),
    [
        (Chain(15, 1.978, 0.572, -1.0), 1.47, [0.155305, 0.364046]),
        (Chain(17, 1.495, -0.456, -1.0), 1.881, [0.164208, 0.426239]),
    ],
)
def test_two_tongues_that_overlap_are_two(chain: Chain, S_max: float, starts: list[float]) -> None:
    """Two pairs off the circle to the end, each from an edge of its own; the second edge is no change of stability."""
    diagram = diagram_of(chain, 4, S_max)
    assert [tongue.modes for tongue in diagram.tongues] == [(3, 5), (1, 6)]
    assert [tongue.start.S for tongue in diagram.tongues] == pytest.approx(starts, abs=1e-6)
    assert all(tongue.open_end for tongue in diagram.tongues)
    assert (len(diagram.changes), len(diagram.further)) == (1, 1)
    outside = np.sum(np.abs(diagram.spectrum(np.linspace(diagram.start, diagram.end, 60))[0].imag) > 1e-9, axis=1)
    assert set(outside.tolist()) == {0, 2, 4}


def test_tongues_are_named_by_the_modes_that_meet() -> None:
    """omega_k + omega_l = 2 m Omega where the orbit is so small that frequencies are those of linear modes."""
    chain = Chain(16, 0.5, 0.3, -1.0)
    tongue = diagram_of(chain, 1, 1.0).tongues[0]
    assert tongue.modes is not None
    assert tongue.order is not None
    total = sum(chain.linear_frequency(k) for k in tongue.modes)
    assert total == pytest.approx(2.0 * tongue.order * tongue.start.Omega, rel=2e-3)


@pytest.mark.parametrize(
    ("gamma", "first", "width", "deep"), [(0.2, 0.15880, 2.6e-4, 0.54694), (0.3, 0.02295, 1.8e-5, 0.52894)]
)
def test_the_first_instability_of_short_chains(gamma: float, first: float, width: float, deep: float) -> None:
    diagram = diagram_of(Chain(16, 0.5, gamma, -1.0), 1, 1.0)
    tongue, deeper = diagram.first_instability(), diagram.first_instability(growth=2e-4)
    assert tongue is not None
    assert deeper is not None
    assert abs(tongue.start.S - first) <= 1e-5
    assert tongue.width == pytest.approx(width, rel=0.05)
    assert abs(deeper.start.S - deep) <= 1e-5


FAMILIES = [
    (Chain(24, 1.0, 0.25, -1.0), 18, 3.0),
    slow(Chain(24, 1.0, 0.25, -1.0), 1, 3.0),
    slow(Chain(16, 2.0, 0.6, -1.0), 1, 3.0),
    slow(Chain(24, 1.0, 0.25, 1.0), 1, 3.0),
]


def same(reference: StabilityDiagram, diagram: StabilityDiagram) -> None:
    """Two lists have the same changes, further edges and tongues, at places that agree within their errors."""
    for name in ("changes", "further"):
        edges, others = getattr(reference, name), getattr(diagram, name)
        assert len(edges) == len(others)
        for edge, other in zip(edges, others, strict=True):
            assert abs(edge.S - other.S) <= edge.S_error + other.S_error
            assert (edge.kind, edge.signatures) == (other.kind, other.signatures)
            assert edge.stable_after == other.stable_after
    assert len(diagram.tongues) == len(reference.tongues)
    assert len(diagram.undecided) == len(reference.undecided)
    assert reference.complete
    assert diagram.complete
    for tongue, other in zip(reference.tongues, diagram.tongues, strict=True):
        # What an error of an edge makes of a growth that is like the root of a distance from it.
        rounding = tongue.growth * (tongue.start.S_error + tongue.end.S_error) / max(tongue.width, 1e-300)
        if not tongue.open_end:  # else it is cut where the branch ends, at an S that is as good as the tolerance
            assert abs(tongue.growth - other.growth) <= 1e-5 * tongue.growth + 10.0 * rounding
        assert None in (tongue.modes, other.modes) or (tongue.modes, tongue.order) == (other.modes, other.order)


@pytest.mark.parametrize(("chain", "mode", "S_max"), FAMILIES)
@pytest.mark.parametrize(
    "other",
    [
        *({"tolerance": tolerance} for tolerance in (1e-4, 1e-6, 1e-12)),
        *({"walker": walker} for walker in ("arclength", "series")),
        {"at": np.linspace(0.01, 2.99, 150).tolist()},
    ],
)
def test_the_list_does_not_depend_on_the_points(chain: Chain, mode: int, S_max: float, other: dict[str, Any]) -> None:
    branch = follow_family(chain, mode, S_max, stability=False, **other)
    same(diagram_of(chain, mode, S_max), tongues_along(branch))


@pytest.mark.parametrize(("chain", "mode", "S_max"), FAMILIES)
@pytest.mark.parametrize(("tolerance", "degrees"), [(1e-9, (16, 32)), (1e-12, (16, 32)), (1e-11, (24, 48))])
def test_the_list_does_not_depend_on_the_interpolation(
    chain: Chain, mode: int, S_max: float, tolerance: float, degrees: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = diagram_of(chain, mode, S_max)
    monkeypatch.setattr(interpolation, "SERIES_DEGREES", degrees)
    monkeypatch.setattr(interpolation, "FIRST_LENGTH", 0.11)
    monkeypatch.setattr(family_changes, "find_changes", partial(find_changes, tolerance=tolerance))
    same(reference, tongues_along(followed(chain, mode, S_max)))


def test_errors_of_edges_cover_what_a_finer_flow_moves_them_by() -> None:
    branch = followed(Chain(16, 0.5, 0.2, -1.0), 1, 1.0)
    coarse, fine = tongues_along(branch, 1e-6), tongues_along(branch, 1e-12)
    moved = np.array([abs(a.S - b.S) for a, b in zip(coarse.changes, fine.changes, strict=True)])
    assert np.all(moved <= np.array([edge.S_error for edge in coarse.changes]))


@pytest.mark.parametrize(("chain", "mode"), [(Chain(6, 1.0, 1.0, 1.0), 6), (Chain(1, 1.0, 0.0, 1.0), 1)])
def test_a_single_moving_site_has_no_changes(chain: Chain, mode: int) -> None:
    assert not tongues_along(follow_family(chain, mode, 1.0, stability=False)).changes


HARD = [
    (Chain(1, 1.0, 0.25, -1.0), 1, 0.5),
    (Chain(2, 1.0, 0.25, -1.0), 1, 2.0),
    (Chain(8, 1.0, 0.999, 1.0), 8, 2.0),
    (Chain(24, 4.0, 0.25, -1.0), 1, 3.0),
    (Chain(24, 1.0, 0.25, -1.0), 1, 1e-6),
    slow(Chain(24, 1.0, 0.25, 1.0), 24, 100.0),
    slow(Chain(16, 1.0, 0.25, 1.0), 3, 100.0),
    slow(Chain(16, 1.0, -0.999, -1.0), 1, 1.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("chain", "mode", "S_max"), HARD)
def test_small_long_and_lopsided_chains_are_known_from_start_to_end(chain: Chain, mode: int, S_max: float) -> None:
    """Between changes orbits are as stable as their own multipliers say, of which the flow is another one."""
    branch = follow_family(chain, mode, S_max, stability=True, events=False)
    diagram = tongues_along(branch)
    assert diagram.complete
    agrees(branch, diagram)


def agrees(branch: Branch, diagram: StabilityDiagram) -> None:
    """Orbits of a branch without folds have the multipliers that the diagram has at their S."""
    assert np.all(np.diff(branch.S) > 0.0)
    for orbit in branch.orbits:
        ends = float(diagram.S(np.array([diagram.start]))[0]), float(diagram.S(np.array([diagram.end]))[0])
        S = float(np.clip(orbit.S, *ends))
        place = brentq(lambda at, S=S: diagram.S(np.array([at]))[0] - S, diagram.start, diagram.end, xtol=1e-13)
        here = np.array([place])
        found = float(diagram.max_abs_multiplier(here)[0])
        assert abs(found - np.max(np.abs(orbit.floquet().multipliers))) <= 1e-6 * found + 10.0 * orbit.multiplier_error


def test_a_branch_that_has_no_orbits_has_no_changes() -> None:
    branch = follow_family(Chain(4, 1.0, 0.25, 1.0), 1, 1.0, stability=False)
    assert isinstance(branch.space, Family)
    diagram = family_changes.family_tongues(branch.space, (branch.start,))
    assert not diagram.changes
    assert diagram.samples == 0


@pytest.mark.parametrize("lost", [slow(-1), 20])
def test_a_stretch_to_an_orbit_that_is_not_solved_again_is_named(lost: int) -> None:
    """One point that is none, at the end or in the middle: the changes elsewhere are those of the whole family."""
    branch = followed(Chain(4, 0.5, 0.3, 1.0), 2, 2.0)
    points = [branch.start, *(solution.point for solution in branch.solutions)]
    z = 100.0 * np.cos(np.arange(points[lost].z.size))
    points[lost] = replace(points[lost], z=np.append(z[:-2], points[lost].z[-2:]))
    diagram = family_changes.family_tongues(cast(Family, branch.space), points)
    S = branch.S[lost] if lost < 0 else branch.S[lost - 1]
    assert any(S in (gap.S_start, gap.S_end) and gap.reason for gap in diagram.unresolved)
    gaps = [sorted((gap.S_start, gap.S_end)) for gap in diagram.unresolved]
    whole = (edge.S for edge in tongues_along(branch).changes)
    known = [S for S in whole if not any(start <= S <= end for start, end in gaps)]
    assert [edge.S for edge in diagram.changes] == pytest.approx(known, abs=1e-9)
    assert len(known) >= 2


def test_the_rest_of_a_branch_that_is_too_much_work_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(24, 1.0, 0.25, -1.0)
    full = diagram_of(chain, 1, 3.0)
    monkeypatch.setattr(family_changes, "find_changes", partial(find_changes, work=5e5))
    diagram = tongues_along(followed(chain, 1, 3.0))
    (gap,) = diagram.unresolved
    assert "not looked at" in gap.reason
    assert abs(gap.S_end - 3.0) < 1e-9
    assert 0.1 < gap.S_start < 2.9
    S, expected = (np.array([edge.S for edge in each.changes]) for each in (diagram, full))
    count = np.count_nonzero(expected < gap.S_start - 1e-9)
    assert S[:count] == pytest.approx(expected[:count], abs=1e-9)


@pytest.mark.parametrize(("sites", "within"), [(15, 0.1), (31, 0.04), slow(63, 0.02)])
def test_waves_of_fermi_pasta_and_ulam_become_unstable_where_they_are_known_to(sites: int, within: float) -> None:
    """6 beta E (N + 1)/pi^2 = 1 + O(1/N) for mode 3 by modes 2 and 4 (Flach et al., Phys. Rev. Lett. 95, 064102)."""
    branch = follow_family(fput(sites), 3, 0.05 * sites, stability=False)
    diagram = tongues_along(branch)
    change = diagram.changes[0]
    stretched = np.diff(branch.at(S=change.S).evaluate(np.zeros(1)).ravel()[:sites], prepend=0.0, append=0.0)
    energy = np.sum(stretched**2 / 2.0 + stretched**4 / 4.0)
    assert abs(6.0 * energy * (sites + 1) / np.pi**2 - 1.0) <= within
    assert diagram.tongues[0].modes in ((2, 4), None)


def test_pendulums_and_maps_that_are_only_reversible_agree_with_the_multipliers_of_their_orbits() -> None:
    for model, mode, symplectic in ((pendulums(5), 1, True), (one_sided(6), 2, False)):
        branch = follow_family(model, mode, 3.0, stability=True, events=False)
        diagram = tongues_along(branch)
        assert diagram.symplectic == symplectic
        assert diagram.complete
        assert len(diagram.changes) == (0 if symplectic else 2)
        assert all(edge.signatures == () for edge in diagram.changes)
        agrees(branch, diagram)


def one_sided(sites: int) -> OdeModel:
    """A chain whose sites feel the square of their left neighbour: the forces are of no potential."""
    q, v = ca.SX.sym("q", sites), ca.SX.sym("v", sites)
    bonds = ca.vertcat(q, 0) - ca.vertcat(0, q)
    force = bonds[1:] - bonds[:-1] - q**3 + 1.5 * ca.vertcat(0, q[:-1]) ** 2 * q
    signs = (1,) * sites + (-1,) * sites
    return OdeModel("one-sided", q, force, order=2, velocity=v, reversal=signs, half_period=(-1,) * (2 * sites))


@pytest.mark.slow
def test_beyond_a_fold_a_pair_meets_where_it_does() -> None:
    """By a scan that shares nothing with the package it is at S = 0.9493916867, next to the fold at 0.9523."""
    diagram = diagram_of(Chain(16, 0.5, 0.14, -1.0), 1, 0.97, 1e-6)
    assert diagram.complete
    near = [edge for edge in diagram.changes if 0.93 < edge.S < 0.96 and edge.stable_before]
    assert [edge.kind for edge in near] == ["complex"]
    assert abs(near[0].S - 0.9493916867) <= near[0].S_error + 1e-10
    at_the_tip = [
        edge for edge in diagram.changes if edge.S < 0.49 and edge.place.coordinate > near[0].place.coordinate
    ]
    assert [(edge.stable_before, edge.stable_after) for edge in at_the_tip] == [(False, True)]


@pytest.mark.slow
def test_changes_in_a_narrow_resonance_that_the_points_pass_by_are_found() -> None:
    """Beyond S = 0.474 the family turns aside; a walk in long steps goes straight on: orbits are added."""
    chain = Chain(8, 0.399, 0.057, -1.0)
    branches = [follow_family(chain, 1, 0.6, tolerance=1e-9, walker=walker) for walker in ("series", "arclength")]
    first, other = (tongues_along(branch) for branch in branches)
    assert min(np.min(np.diff(branches[0].S)), 0.0) < 0.0
    assert first.complete
    assert other.complete
    assert [(e.kind, e.stable_after) for e in first.changes] == [(e.kind, e.stable_after) for e in other.changes]
    assert all(abs(a.S - b.S) <= a.S_error + b.S_error for a, b in zip(first.changes, other.changes, strict=True))


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_a_tongue_that_goes_on_ends_where_the_family_does(tolerance: float) -> None:
    """Multipliers grow to the end: the deepest place is there, whatever the tolerance of the last point."""
    branch = follow_family(Chain(24, 1.0, 0.25, -1.0), 1, 1.5, stability=True, tolerance=tolerance)
    assert branch.stability_diagram is not None
    (last,) = (tongue for tongue in branch.stability_diagram.tongues if tongue.open_end)
    assert pytest.approx(1.5, rel=1e-14) == last.end.S
    assert last.S_deepest == pytest.approx(1.5, rel=1e-14)
