"""Every change of stability of families of matrices that are unstable where they are made to be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from symplectic_families import Entries, ReversibleFamily, SymplecticFamily, cluster, collision, cubic, passage, real

from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.tongues import crossings, interpolation
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.find_changes import Entry, find_changes
from casadi_skin.stability.tongues.interpolation import (
    MatrixSeries,
    OrbitNotFoundError,
    Samples,
    Search,
    interpolate,
)

Array = np.ndarray
FAR = collision(cubic(3.0), 0.1, square=4.0)  # two modes that never meet


def places(diagram: StabilityDiagram) -> Array:
    return np.array([edge.S for edge in diagram.changes])


def agree(diagram: StabilityDiagram, expected: Array | list[float], within: float) -> None:
    """The changes are where they are expected, and their errors say so."""
    found = places(diagram)
    assert found.size == len(expected)
    off = np.abs(found - np.array(expected))
    assert np.max(off, initial=0.0) <= within
    assert np.all(off <= np.array([edge.S_error for edge in diagram.changes]) + 1e-14)


def exact_states(blocks: Entries, s: Array) -> Array:
    """Whether a block is stable, from its squared frequencies."""
    squares = np.array([np.linalg.eigvals(blocks(x)[1] @ blocks(x)[0]) for x in s.tolist()])
    return np.all((np.abs(squares.imag) < 1e-9) & (squares.real > 0.0), axis=1)


@pytest.mark.parametrize("width", [1e-1, 1e-2, 1e-4, 1e-6, 1e-8, 1e-9])
def test_a_krein_collision_is_found_however_narrow_its_window(width: float) -> None:
    diagram = find_changes(SymplecticFamily([collision(cubic(-0.6, 2.0), 0.5 * width), FAR]))
    agree(diagram, [0.3 - 0.5 * width, 0.3 + 0.5 * width], 1e-12)
    tongue = diagram.tongues[0]
    assert tongue.kind == "complex"
    assert tongue.width == pytest.approx(width, rel=1e-3)
    # The squared frequencies are 1.5 +- i coupling at the middle: the growth over the period is that of 2 omega.
    assert tongue.growth == pytest.approx(2.0 * np.sqrt(1.5 + 0.5j * width).imag, rel=1e-3)
    assert [edge.signatures for edge in diagram.changes] == [(1, -1)] * 2
    assert [(edge.stable_before, edge.stable_after) for edge in diagram.changes] == [(True, False), (False, True)]
    assert diagram.complete
    assert not diagram.further
    assert not diagram.undecided
    assert not diagram.windows


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("width", [1e-2, 1e-5, 1e-9])
def test_a_real_window_is_found_however_narrow_between_zeros_of_either_form(width: float, swapped: bool) -> None:
    diagram = find_changes(SymplecticFamily([real(cubic(-0.3, 1.0), cubic(-0.3 - width, 1.0)), FAR], swapped))
    agree(diagram, [0.3, 0.3 + width], 1e-12)
    assert {(edge.kind, edge.mu) for edge in diagram.changes} == {("real", -1.0 if swapped else 0.0)}
    # omega^2 = (s - 0.3)(s - 0.3 - width): |omega| is width/2 at the middle.
    assert diagram.tongues[0].growth == pytest.approx(width, rel=1e-3)


@pytest.mark.parametrize("middle", [0.25, 0.5, 0.625])
@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-9])
def test_an_edge_where_two_intervals_meet_is_there_once(middle: float, width: float) -> None:
    """The branch is halved there: the edge is at the end of one interval and at the start of the next."""
    for a, b in ((middle - width, middle), (middle, middle + width)):
        for block in (collision(cubic(-a - b, 2.0), 0.5 * width), real(cubic(-a, 1.0), cubic(-b, 1.0))):
            others = [FAR, collision(cubic(-0.9, 1.7), 1e-2, square=3.0)]
            diagram = find_changes(SymplecticFamily([block, *others]))
            expected = sorted([a, b, (0.9 - 0.02) / 1.7, (0.9 + 0.02) / 1.7])
            edges = sorted(edge.S for edge in (*diagram.changes, *diagram.further))
            assert edges == pytest.approx(expected, abs=1e-12)
            assert not diagram.undecided
            assert not diagram.windows


OUTER, INNER, TOUCH = np.sqrt(1e-6 + 2e-7), np.sqrt(1e-6 - 2e-7), np.sqrt(2e-7)


@pytest.mark.parametrize(
    ("block", "swapped", "expected"),
    [
        *((real(cubic(-0.3, 1.0)), swapped, [0.3]) for swapped in (False, True)),  # it begins unstable
        # Two crossings of one pair in one interval: squared frequencies (s - 1/2)^2 - 1e-6 apart, coupled by 1e-7.
        (collision(cubic(0.25 - 1e-6, -1.0, 1.0), 1e-7), False, [0.5 - OUTER, 0.5 - INNER, 0.5 + INNER, 0.5 + OUTER]),
        (collision(cubic(0.25, -1.0, 1.0), 1e-7), False, [0.5 - TOUCH, 0.5 + TOUCH]),  # a pair that touches
        (collision(cubic(0.25 + 3e-7, -1.0, 1.0), 1e-7), False, []),  # and one that nearly does
    ],
)
def test_changes_are_where_squared_frequencies_meet(block: Entries, swapped: bool, expected: list[float]) -> None:
    diagram = find_changes(SymplecticFamily([block, FAR], swapped))
    agree(diagram, expected, 1e-9)
    assert not diagram.undecided
    assert sum(tongue.open_start for tongue in diagram.tongues) == len(expected) % 2


UNCOUPLED = [0.05, 0.125, 0.17, 0.25, 0.3228753, 0.375, 0.4, 0.458148, 0.5, 0.5371041, 0.75, 0.9326634]


def test_multipliers_of_one_signature_pass_without_instability() -> None:
    """Once wherever they pass, also at ends of intervals."""
    for place in UNCOUPLED:
        diagram = find_changes(SymplecticFamily([passage(cubic(-place, 1.0)), FAR]))
        assert not diagram.changes
        assert not diagram.undecided
        (met,) = diagram.passages
        assert abs(met.place.S - place) <= 1e-9


@pytest.mark.parametrize(
    ("kind", "block", "swapped", "within"),
    [
        ("complex", lambda s: collision(cubic(-s, 1.0), 0.0), False, 1e-12),  # both functions are zero there
        ("complex", lambda s: collision(cubic(s**2, -2.0 * s, 1.0), 0.0), False, 1e-5),  # they touch
        ("real", lambda s: real(cubic(-s, 1.0), cubic(-s, 1.0)), False, 1e-12),  # omega^2 = (s - place)^2
        ("real", lambda s: real(cubic(-s, 1.0), cubic(-s, 1.0)), True, 1e-12),
    ],
)
def test_what_meets_uncoupled_is_not_decided_and_not_counted(
    kind: str, block: Callable[[float], Entries], swapped: bool, within: float
) -> None:
    """Opposite signatures that pass or touch, and a mode that touches the end of [-1, 0], wherever they do."""
    for place in UNCOUPLED:
        diagram = find_changes(SymplecticFamily([block(place), FAR], swapped))
        assert not diagram.changes
        (tongue,) = diagram.undecided
        assert tongue.kind == kind
        assert abs(tongue.start.S - place) <= (within if within < 1e-9 else tongue.start.S_error + 1e-9)


@pytest.mark.parametrize(("coupling", "decided"), [(1e-6, True), (1e-10, False)])
def test_a_tongue_shallower_than_the_flows_error_is_not_decided(coupling: float, decided: bool) -> None:
    diagram = find_changes(SymplecticFamily([collision(cubic(-0.4, 1.0), coupling), FAR], error=1e-9))
    assert (len(diagram.changes), len(diagram.undecided)) == ((2, 0) if decided else (0, 1))


@pytest.mark.parametrize("noise", [1e-8, *(pytest.param(noise, marks=pytest.mark.slow) for noise in (1e-10, 1e-12))])
def test_noise_of_the_flow_moves_edges_by_no_more_than_their_errors(noise: float) -> None:
    blocks = [collision(cubic(-0.6, 2.0), 0.01), real(cubic(-0.7, 1.0), cubic(-0.71, 1.0)), FAR]
    diagram = find_changes(SymplecticFamily(blocks, error=noise, noise=noise))
    agree(diagram, [0.29, 0.31, 0.7, 0.71], 300.0 * noise)
    assert max(edge.S_error for edge in diagram.changes) <= 1e4 * noise
    biased = find_changes(SymplecticFamily(blocks, error=noise, bias=-1.0))  # an error that is the same everywhere
    agree(biased, [0.29, 0.31, 0.7, 0.71], 100.0 * noise)


def test_a_pair_that_touches_within_the_flows_error_is_not_decided() -> None:
    """It would touch at 1/2 if its coupling were larger by 5e-11."""
    touching = collision(cubic(0.25 + 3e-10, -1.0, 1.0), 1e-10)
    diagram = find_changes(SymplecticFamily([touching, FAR], error=1e-8))
    assert not diagram.changes
    (tongue,) = diagram.undecided
    assert abs(tongue.start.S - 0.5) < 1e-3
    assert not find_changes(SymplecticFamily([touching, FAR])).undecided


def test_work_is_done_from_small_coordinates_on_and_ends_where_it_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    windows = [collision(cubic(-0.1, 2.0), 0.01), collision(cubic(-1.8, 2.0), 0.01, square=3.0)]
    family = SymplecticFamily([*windows, FAR])
    monkeypatch.setattr(crossings, "BATCH_WORK", 1.0)
    monkeypatch.setattr(interpolation, "EIGENVALUE_OVERHEAD", 0.0)
    monkeypatch.setattr(crossings, "first_intervals", eight_intervals)
    agree(find_changes(family), [0.04, 0.06, 0.89, 0.91], 1e-12)
    diagram = find_changes(family, work=1500.0)
    agree(diagram, [0.04, 0.06], 1e-12)
    (gap,) = diagram.unresolved
    assert 0.06 < gap.S_start < diagram.end - 0.05
    assert gap.S_end == 1.0


def eight_intervals(series: MatrixSeries) -> list[crossings.Interval]:
    stops = np.linspace(series.start, series.end, 9).tolist()
    return [crossings.Interval(series, a, b, 1.0) for a, b in pairwise(stops)]


@pytest.mark.parametrize("swapped", [False, True])
def test_a_second_conserved_quantity_makes_no_changes(swapped: bool) -> None:
    """A mode without stiffness has mu = 0 (-1) all along the branch."""
    blocks = [real(cubic(0.0)), collision(cubic(-0.6, 2.0), 0.01), FAR]
    diagram = find_changes(SymplecticFamily(blocks, swapped))
    agree(diagram, [0.29, 0.31], 1e-12)
    assert len(diagram.tongues) == 1


@pytest.mark.slow
def test_a_cluster_of_three_has_the_changes_of_its_characteristic_polynomial() -> None:
    couplings = np.array([[0.0, 0.01, 0.002], [0.01, 0.0, 0.02], [0.002, 0.02, 0.0]])
    blocks = cluster([cubic(1.5, 0.2), cubic(1.6, -0.1), cubic(1.7, -0.3)], [1, -1, 1], couplings)
    s = np.linspace(0.0, 1.0, 20_001)
    changes = np.flatnonzero(np.diff(exact_states(blocks, s).astype(int)))
    found = places(find_changes(SymplecticFamily([blocks, FAR])))
    assert found.size == changes.size > 0
    assert np.all((found >= s[changes]) & (found <= s[changes + 1]))


def test_overlapping_tongues_are_one_unstable_interval_with_further_edges() -> None:
    first, second = collision(cubic(-0.6, 2.0), 0.05), collision(cubic(-0.64, 2.0), 0.05, square=3.0)
    diagram = find_changes(SymplecticFamily([first, second]))
    agree(diagram, [0.25, 0.37], 1e-12)
    assert [edge.S for edge in diagram.further] == pytest.approx([0.27, 0.35], abs=1e-12)


@pytest.mark.parametrize("swapped", [False, True])
def test_edges_that_coincide_are_listed_once(swapped: bool) -> None:
    """Two equal modes become unstable at one place; and one tongue closes where another one opens."""
    twin = real(cubic(-0.3, 1.0))
    diagram = find_changes(SymplecticFamily([twin, twin, FAR], swapped, error=1e-9))
    assert places(diagram) == pytest.approx([0.3], abs=1e-7)
    assert not diagram.further
    first, then = real(cubic(-0.2, 1.0), cubic(-0.5, 1.0)), real(cubic(-0.5, 1.0), cubic(-0.9, 1.0))
    diagram = find_changes(SymplecticFamily([first, then, FAR], swapped, error=1e-9))
    assert places(diagram) == pytest.approx([0.2, 0.9], abs=1e-7)
    assert [edge.S for edge in diagram.further] == pytest.approx([0.5], abs=1e-7)


def test_a_stable_window_between_two_tongues_is_found_or_said_to_be_too_narrow() -> None:
    first = collision(cubic(-0.6, 2.0), 0.05)
    for gap in (1e-2, 1e-8, 5e-10):
        wide = find_changes(SymplecticFamily([first, collision(cubic(-0.8 - 2.0 * gap, 2.0), 0.05, square=3.0)]))
        agree(wide, [0.25, 0.35, 0.35 + gap, 0.45 + gap], 1e-12)
    narrow = SymplecticFamily([first, collision(cubic(-0.8 - 1e-10, 2.0), 0.05, square=3.0)], error=1e-9)
    diagram = find_changes(narrow)
    assert places(diagram) == pytest.approx([0.25, 0.45], abs=1e-8)
    assert abs(diagram.windows[0].start.S - 0.35) <= 1e-8


def test_the_result_does_not_depend_on_the_sections() -> None:
    blocks = [collision(cubic(-0.6, 2.0), 1e-3), real(cubic(-0.7, 1.0), cubic(-0.7001, 1.0)), FAR]
    whole = places(find_changes(SymplecticFamily(blocks)))
    for stops in ([0.0, 0.3, 0.7, 1.0], np.linspace(0.0, 1.0, 12).tolist(), [0.0, 0.2995, 0.30049999, 0.7, 1.0]):
        found = places(find_changes(SymplecticFamily(blocks, sections=list(pairwise(stops)))))
        assert found == pytest.approx(whole, abs=1e-12)


def test_a_fold_in_the_amplitude_does_no_harm() -> None:
    blocks = [collision(cubic(-0.6, 2.0), 0.05), FAR]
    diagram = find_changes(SymplecticFamily(blocks, S=lambda s: s * (0.6 - s)))  # the fold is at 0.3
    assert [edge.place.coordinate for edge in diagram.changes] == pytest.approx([0.25, 0.35], abs=1e-12)


@pytest.mark.parametrize(("lower", "expected"), [(-0.01, [0.34, 0.36]), (0.01, [])])
def test_without_a_symplectic_structure_any_two_mu_may_leave_the_axis(lower: float, expected: list[float]) -> None:
    diagram = find_changes(ReversibleFamily(lambda s: np.array([[1.5 + s, 0.01], [lower, 2.2 - s]])))
    agree(diagram, expected, 1e-10)
    assert all(edge.signatures == () for edge in diagram.changes)


@dataclass
class Failing(SymplecticFamily):
    """What goes wrong between two coordinates."""

    failure: Exception | None = None

    def sample(self, coordinates: Array) -> Samples:
        """Samples, but for those that fail or are no numbers."""
        wrong = (coordinates > 0.6) & (coordinates < 0.65)
        if wrong.any() and self.failure is not None:
            raise self.failure
        samples = super().sample(coordinates)
        samples.transitions[wrong] = np.nan
        return samples


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (np.linalg.LinAlgError("Singular matrix"), "Singular matrix"),
        (FlowError("the flow\n stops"), "the flow stops"),
        (RuntimeError("CasADi"), "CasADi"),
        (OrbitNotFoundError("no orbit is found"), "no orbit is found"),
        (None, "not finite"),
    ],
)
def test_what_fails_on_the_way_is_a_gap_with_the_reason(failure: Exception | None, words: str) -> None:
    diagram = find_changes(Failing([collision(cubic(-0.6, 2.0), 0.01), FAR], failure=failure))
    agree(diagram, [0.29, 0.31], 1e-12)
    (gap,) = diagram.unresolved
    assert words in gap.reason
    assert 0.55 < gap.S_start <= 0.6 < 0.65 <= gap.S_end < 0.7


def test_linear_algebra_that_fails_in_the_search_leaves_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eigenvalues are not found of any matrix near 0.62."""
    original = crossings.blocks_of

    def failing(matrices: Array, errors: Array) -> object:
        if np.any(np.abs(matrices[:, :, 0, 0, 0] - where) < 1e-3):
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return original(matrices, errors)

    family = SymplecticFamily([collision(cubic(-0.6, 2.0), 0.01), FAR])
    known = Search()
    (piece, *_) = [p for p in interpolate(family, 1e-11, known) if p.matrices.start <= 0.62 <= p.matrices.end]
    where = float(piece.matrices.at(np.array([0.62]))[0, 0, 0, 0])
    monkeypatch.setattr(crossings, "blocks_of", failing)
    diagram = find_changes(family)
    assert diagram.unresolved
    assert all("did not converge" in gap.reason for gap in diagram.unresolved)
    assert any(gap.S_start <= 0.62 <= gap.S_end for gap in diagram.unresolved)


@pytest.mark.parametrize("noise", [1e-10, 1e-12])
def test_noise_of_the_matrices_is_among_the_errors_whatever_the_flow_says(noise: float) -> None:
    """Orbits that differ by rounding make matrices whose series do not fall beyond it."""
    blocks = [collision(cubic(-0.6, 2.0), 0.01), real(cubic(-0.7, 1.0), cubic(-0.71, 1.0)), FAR]
    exact = list(interpolate(SymplecticFamily(blocks), 1e-11, Search()))
    for piece in interpolate(SymplecticFamily(blocks, noise=noise), 1e-11, Search()):
        for s in np.linspace(piece.matrices.start, piece.matrices.end, 101).tolist():
            true = next(p for p in exact if s <= p.matrices.end)
            off = np.linalg.norm((piece.matrices.at(np.array([s])) - true.matrices.at(np.array([s])))[0], axis=(1, 2))
            assert np.all(off <= piece.matrices.noise)
            assert np.all(piece.matrices.noise <= 100.0 * noise)


def entries_of(diagram: StabilityDiagram) -> list[Entry]:
    """What is known at 21 orbits of a branch."""
    coordinates = np.linspace(0.0, 1.0, 21)
    mu, _ = diagram.spectrum(coordinates)
    return [Entry(s, values, np.full(values.size, 1e-10)) for s, values in zip(coordinates.tolist(), mu, strict=True)]


@pytest.mark.parametrize("kind", ["real", "complex"])
def test_tongues_account_for_the_unstable_multipliers_at_orbits_or_the_stretch_is_unresolved(kind: str) -> None:
    """Orbits of one family, beside the tongues of another one that lacks an instability between 0.42 and 0.58."""
    window = real(cubic(-0.42, 1.0), cubic(-0.58, 1.0)) if kind == "real" else collision(cubic(-1.0, 2.0), 0.08)
    quiet = real(cubic(1.0), cubic(1.1)) if kind == "real" else collision(cubic(-3.0, 2.0), 0.08)
    with_window, without = SymplecticFamily([window, FAR]), SymplecticFamily([quiet, FAR])
    known = entries_of(find_changes(with_window)), entries_of(find_changes(without))
    assert find_changes(with_window, entries=known[0]).complete
    assert find_changes(without, entries=known[1]).complete
    for family, other in ((without, known[0]), (with_window, known[1])):
        (stretch,) = find_changes(family, entries=other).unresolved
        assert "account does not balance" in stretch.reason
        assert (stretch.start, stretch.end) == (pytest.approx(0.4), pytest.approx(0.6))
