"""Every change of stability along families of the chain, against scans that share nothing with the package."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from casadi_skin import Branch, Chain, follow_family
from casadi_skin.orbits.family_tongues import family_tongues
from casadi_skin.stability.tongues import StabilityDiagram

SCANS = Path(__file__).parents[1] / "data" / "stability_changes"
NAMES = sorted(path.stem for path in SCANS.glob("*.json"))
LONG = {"long_softening_60", "longest_hardening_100"}
SCANNED = 1e-8  # what the scans know the place of a change to


@cache
def followed(chain: Chain, mode: int, S_max: float, tolerance: float = 1e-8) -> Branch:
    return follow_family(chain, mode, S_max, tolerance=tolerance)


@cache
def diagram_of(chain: Chain, mode: int, S_max: float, tolerance: float = 1e-8) -> StabilityDiagram:
    return family_tongues(followed(chain, mode, S_max, tolerance))


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in NAMES])
def test_the_changes_of_a_family_are_those_of_an_independent_scan(name: str) -> None:
    """No change is missed and none invented; windows that the scan is too coarse for are where it saw a passage."""
    scan = json.loads((SCANS / f"{name}.json").read_text())
    family = scan["family"]
    chain = Chain(family["sites"], family["alpha"], family["gamma"], family["g"])
    diagram = diagram_of(chain, family["mode"], family["S_max"])
    assert diagram.complete
    edges = [(0.5 * (low + high), stable_after) for low, high, stable_after in scan["edges"]]
    passed = np.array(scan["passed"])
    for edge in diagram.changes:
        near = [stable for S, stable in edges if abs(S - edge.S) <= SCANNED + edge.S_error]
        if edge.stable_after not in near:  # too narrow for the scan: it saw two multipliers pass each other
            assert edge.width < 1e-8
            assert np.min(np.abs(passed - edge.S)) <= 1e-7
    for S, stable in edges:
        same = [e for e in diagram.changes if e.stable_after == stable and abs(e.S - S) <= SCANNED + e.S_error]
        assert same, f"the scan has a change at S = {S}"
    known = np.array([t.start.S for t in (*diagram.undecided, *diagram.tongues) if t.width < 1e-8])
    for S in passed.tolist():
        assert np.min(np.abs(known - S), initial=np.inf) <= 1e-7, f"the scan has a passage at S = {S}"


def test_the_first_family_has_the_changes_that_are_known() -> None:
    diagram = diagram_of(Chain(24, 1.0, 0.25, -1.0), 1, 3.0)
    assert len(diagram.changes) == 47
    assert not (diagram.undecided or diagram.windows or diagram.unresolved)


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
    assert tongue.start.S == pytest.approx(first, abs=1e-5)
    assert tongue.width == pytest.approx(width, rel=0.05)
    assert deeper.start.S == pytest.approx(deep, abs=1e-5)


def test_the_list_does_not_depend_on_tolerance_points_or_way() -> None:
    chain = Chain(24, 1.0, 0.25, -1.0)
    reference = diagram_of(chain, 18, 3.0)
    assert len(reference.changes) == 3
    branches = [followed(chain, 18, 3.0, tolerance) for tolerance in (1e-4, 1e-6, 1e-12)]
    branches.append(follow_family(chain, 18, 3.0, at=np.linspace(0.01, 2.99, 150).tolist()))
    branches.append(follow_family(chain, 18, 3.0, walker="arclength"))
    for branch in branches:
        diagram = family_tongues(branch)
        assert len(diagram.changes) == 3
        for edge, other in zip(reference.changes, diagram.changes, strict=True):
            assert abs(edge.S - other.S) <= edge.S_error + other.S_error
            assert (edge.kind, edge.stable_after) == (other.kind, other.stable_after)


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-10, 1e-12])
def test_the_list_of_the_hardest_family_does_not_depend_on_the_tolerance(tolerance: float) -> None:
    chain = Chain(24, 1.0, 0.25, -1.0)
    reference, diagram = diagram_of(chain, 1, 3.0), diagram_of(chain, 1, 3.0, tolerance)
    assert len(diagram.tongues) == len(reference.tongues)
    for edge, other in zip(reference.changes, diagram.changes, strict=True):
        assert abs(edge.S - other.S) <= edge.S_error + other.S_error


def test_errors_of_edges_cover_what_a_finer_flow_moves_them_by() -> None:
    branch = followed(Chain(16, 0.5, 0.2, -1.0), 1, 1.0)
    coarse, fine = family_tongues(branch, 1e-6), family_tongues(branch, 1e-12)
    moved = np.array([abs(a.S - b.S) for a, b in zip(coarse.changes, fine.changes, strict=True)])
    assert np.all(moved <= np.array([edge.S_error for edge in coarse.changes]))


@pytest.mark.parametrize(("chain", "mode"), [(Chain(6, 1.0, 1.0, 1.0), 6), (Chain(1, 1.0, 0.0, 1.0), 1)])
def test_a_single_moving_site_has_no_changes(chain: Chain, mode: int) -> None:
    assert not family_tongues(follow_family(chain, mode, 1.0)).changes


def test_folds_in_S_are_passed() -> None:
    branch = followed(Chain(16, 0.5, 0.1, -1.0), 1, 1.0)
    assert np.any(np.diff(branch.S) < 0.0)
    changes = diagram_of(Chain(16, 0.5, 0.1, -1.0), 1, 1.0).changes
    coordinates = [edge.place.coordinate for edge in changes]
    assert coordinates == sorted(coordinates)
    assert any(np.diff([edge.S for edge in changes]) < 0.0)
