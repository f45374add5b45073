"""Every change of stability along families of the chain, against scans that share nothing with the package."""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.follow.family_changes import family_tongues
from casadi_skin.stability.tongues.diagram import StabilityDiagram, StabilityEdge

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import scan_stability

SCANS = {path.stem: json.loads(path.read_text()) for path in sorted(scan_stability.DATA.glob("*.json"))}
QUICK = {"reciprocal_8", "weak_gamma_16_02"}
NAMES = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in SCANS]


@cache
def diagram_of(name: str) -> StabilityDiagram:
    family = SCANS[name]["family"]
    chain = Chain(family["sites"], family["alpha"], family["gamma"], family["g"])
    branch = follow_family(chain, family["mode"], family["S_max"], stability=False)
    return family_tongues(branch.space, (branch.start, *(orbit.point for orbit in branch.orbits)))


def without_partner(scan: dict[str, Any], diagram: StabilityDiagram) -> tuple[list[float], list[StabilityEdge]]:
    """Edges of the scan that are not among the changes, within the errors of both, and the reverse; each has one."""
    missed, extra = [], list(diagram.changes)
    for low, high, stable_after, error in scan["edges"]:
        S = 0.5 * (low + high)
        same = [e for e in extra if e.stable_after == stable_after and abs(e.S - S) <= error + e.S_error]
        if same:
            extra.remove(min(same, key=lambda e: abs(e.S - S)))
        else:
            missed.append(S)
    return missed, extra


def test_every_family_that_the_tool_knows_is_in_the_data_by_its_last_version() -> None:
    assert set(SCANS) == set(scan_stability.FAMILIES)
    for name, family in scan_stability.FAMILIES.items():
        assert all(getattr(family, key) == value for key, value in SCANS[name]["family"].items())


@pytest.mark.parametrize("name", NAMES)
def test_no_change_of_a_family_is_missed_and_none_is_invented(name: str) -> None:
    """Windows between two points of the scan, which it cannot have seen, are looked at with the scan's own flow."""
    scan = SCANS[name]
    diagram = diagram_of(name)
    assert diagram.complete
    missed, extra = without_partner(scan, diagram)
    assert not missed
    if extra:
        confirm(scan_stability.FAMILIES[name], diagram, extra)


@pytest.mark.parametrize("name", NAMES)
def test_multipliers_that_the_scan_saw_pass_each_other_are_a_tongue_too_narrow_for_it(name: str) -> None:
    diagram = diagram_of(name)
    for S in SCANS[name]["passed"]:
        near = [
            tongue
            for tongue in (*diagram.tongues, *diagram.undecided)
            if max(tongue.start.S - S - tongue.start.S_error, S - tongue.end.S - tongue.end.S_error)
            <= scan_stability.RESOLUTION
        ]
        assert near, f"the scan has a passage at S = {S}"


@pytest.mark.parametrize("name", NAMES)
def test_tongues_are_as_deep_as_the_scan_found_them(name: str) -> None:
    scan = SCANS[name]
    diagram = diagram_of(name)
    stops = [0.0, *[0.5 * (low + high) for low, high, *_ in scan["edges"]], scan["family"]["S_max"]]
    for start, end, depth in zip(stops[:-1], stops[1:], scan["depths"], strict=True):
        inside = [tongue for tongue in diagram.tongues if start - 1e-6 <= tongue.start.S <= tongue.end.S <= end + 1e-6]
        deepest = max((tongue.growth for tongue in inside), default=0.0)
        assert depth <= 1.001 * deepest + 1e-9
        if end - start > 20.0 * scan["family"]["step"] and depth:
            assert depth == pytest.approx(deepest, rel=0.01)


def confirm(family: scan_stability.Family, diagram: StabilityDiagram, edges: list[StabilityEdge]) -> None:
    """Assert that the scan's own flow has edges where its steps were too wide to see them.

    Halfway to the edges beside it, and no farther than a step of the scan, orbits are stable and unstable as the
    diagram says.
    """
    stability = scan_stability.Stability(scan_stability.Orbits(family))
    S = np.array([edge.S for edge in diagram.changes])
    for edge in edges:
        before = np.max(S[edge.S > S], initial=0.0)
        after = np.min(S[edge.S < S], initial=family.S_max)
        places = edge.S + 0.5 * np.array([max(before - edge.S, -family.step), min(after - edge.S, family.step)])
        states = stability.states(places, scan_stability.FINE)
        assert [state[0] for state in states] == [edge.stable_before, edge.stable_after], f"the edge at S = {edge.S}"
