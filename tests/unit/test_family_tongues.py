"""Every change of stability along families of the chain, against scans that share nothing with the package."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from casadi_skin import Branch, Chain, follow_family
from casadi_skin.orbits import family_tongues
from casadi_skin.orbits.family import Family
from casadi_skin.stability import interpolation
from casadi_skin.stability.find_changes import find_changes
from casadi_skin.stability.tongues import StabilityDiagram


def slow(*values: Any) -> Any:
    """Parameters of a test that takes long."""
    return pytest.param(*values, marks=pytest.mark.slow)


@cache
def followed(chain: Chain, mode: int, S_max: float, tolerance: float = 1e-8) -> Branch:
    return follow_family(chain, mode, S_max, tolerance=tolerance, stability=False)


def tongues_along(branch: Branch, flow_tolerance: float = family_tongues.FLOW_TOLERANCE) -> StabilityDiagram:
    space = branch.space
    assert isinstance(space, Family)
    points = (branch.start, *(orbit.point for orbit in branch.orbits))
    return family_tongues.family_tongues(space, points, flow_tolerance)


@cache
def diagram_of(chain: Chain, mode: int, S_max: float, tolerance: float = 1e-8) -> StabilityDiagram:
    return tongues_along(followed(chain, mode, S_max, tolerance))


def test_the_first_family_has_the_changes_that_are_known() -> None:
    diagram = diagram_of(Chain(24, 1.0, 0.25, -1.0), 1, 3.0)
    assert len(diagram.changes) == 47
    assert not diagram.undecided
    assert not diagram.windows
    assert not diagram.unresolved


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
        assert abs(tongue.growth - other.growth) <= 1e-5 * tongue.growth + 10.0 * rounding  # of the samples the deepest
        assert (tongue.modes, tongue.order) == (other.modes, other.order)


@pytest.mark.parametrize(("chain", "mode", "S_max"), FAMILIES)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-12])
def test_the_list_does_not_depend_on_the_tolerance(chain: Chain, mode: int, S_max: float, tolerance: float) -> None:
    same(diagram_of(chain, mode, S_max), diagram_of(chain, mode, S_max, tolerance))


@pytest.mark.parametrize(("chain", "mode", "S_max"), FAMILIES)
@pytest.mark.parametrize(
    "more", [{"at": np.linspace(0.01, 2.99, 150).tolist()}, {"walker": "arclength"}, {"walker": "series"}]
)
def test_the_list_does_not_depend_on_the_points(chain: Chain, mode: int, S_max: float, more: dict[str, Any]) -> None:
    branch = follow_family(chain, mode, S_max, stability=False, **more)
    same(diagram_of(chain, mode, S_max), tongues_along(branch))


@pytest.mark.parametrize(("chain", "mode", "S_max"), FAMILIES)
@pytest.mark.parametrize(("tolerance", "degrees"), [(1e-9, (16, 32)), (1e-12, (16, 32)), (1e-11, (24, 48))])
def test_the_list_does_not_depend_on_the_interpolation(
    chain: Chain,
    mode: int,
    S_max: float,
    tolerance: float,
    degrees: tuple[int, int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reference = diagram_of(chain, mode, S_max)
    monkeypatch.setattr(interpolation, "DEGREES", degrees)
    monkeypatch.setattr(interpolation, "FIRST_LENGTH", 0.11)
    monkeypatch.setattr(family_tongues, "find_changes", partial(find_changes, tolerance=tolerance))
    same(reference, tongues_along(followed(chain, mode, S_max)))


def test_errors_of_edges_cover_what_a_finer_flow_moves_them_by() -> None:
    branch = followed(Chain(16, 0.5, 0.2, -1.0), 1, 1.0)
    coarse, fine = tongues_along(branch, 1e-6), tongues_along(branch, 1e-12)
    moved = np.array([abs(a.S - b.S) for a, b in zip(coarse.changes, fine.changes, strict=True)])
    assert np.all(moved <= np.array([edge.S_error for edge in coarse.changes]))


@pytest.mark.parametrize(("chain", "mode"), [(Chain(6, 1.0, 1.0, 1.0), 6), (Chain(1, 1.0, 0.0, 1.0), 1)])
def test_a_single_moving_site_has_no_changes(chain: Chain, mode: int) -> None:
    assert not tongues_along(follow_family(chain, mode, 1.0, stability=False)).changes


def test_folds_in_S_are_passed() -> None:
    branch = followed(Chain(16, 0.5, 0.1, -1.0), 1, 1.0)
    assert np.any(np.diff(branch.S) < 0.0)
    changes = diagram_of(Chain(16, 0.5, 0.1, -1.0), 1, 1.0).changes
    coordinates = [edge.place.coordinate for edge in changes]
    assert coordinates == sorted(coordinates)
    assert any(np.diff([edge.S for edge in changes]) < 0.0)
