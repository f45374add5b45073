"""Changes of localised multipliers: closed forms, dense tails, finite chains, cut problems, energies."""

from __future__ import annotations

import csv
import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone
from numpy.typing import NDArray

from casadi_skin import Bond, Branch, Chain, LongLattice, Site, follow_family, read_result
from casadi_skin.follow.family import Family
from casadi_skin.follow.localised_changes import EdgeOrbits, localised_changes
from casadi_skin.lattice.tail import Tail
from casadi_skin.native import eliminated
from casadi_skin.runs.program import main
from casadi_skin.stability.result import reversible_floquet
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.hill import Hill, Parity, count, zeros_in
from casadi_skin.stability.tongues.interpolation import OrbitNotFoundError
from casadi_skin.stability.tongues.medium import Layout

Array = NDArray[np.float64]

SOFT, HARD = Chain(math.inf, 1.0, 0.25, -1.0), Chain(math.inf, 1.0, 0.25, 1.0)
LOW, HIGH = (math.sqrt(square) for square in SOFT.band())
GAINS = ("1 - gamma", "1 + gamma")
DIMER = LongLattice(
    math.inf, [Site(name, onsite="y + g*y^3") for name in "ab"],
    [Bond("a", "b", [0], "u*d", GAINS), Bond("b", "a", [1])], "fixed", {"u": 0.4, "gamma": 0.4, "g": 1.0},
)  # fmt: skip
CHAIN = Tail(math.inf, np.array([[3.0]]), math.sqrt(1.0 - 0.25**2))
TWO_SITES = Tail(math.inf, np.array([[3.0, -0.4], [-0.4, 3.5]]), 0.9, 0, 1)
THREE_SITES = Tail(math.inf, np.array([[3.0, -0.4, 0.0], [-0.4, 3.5, -0.7], [0.0, -0.7, 2.8]]), 0.9, 0, 2)
MEDIA = [CHAIN, TWO_SITES, THREE_SITES]
PARITIES: tuple[Parity, Parity] = ("cosine", "sine")


@cache
def hard(S: float = 0.12) -> Branch:
    return follow_family(HARD, "last", S, tolerance=1e-9, stability=True)


@cache
def changes_of(chain: Chain | LongLattice, mode: str, S: float, tolerance: float = 1e-9) -> StabilityDiagram:
    """As `localised_diagram`, without multipliers of each orbit."""
    branch = follow_family(chain, mode, S, tolerance=tolerance)
    assert isinstance(branch.space, Family)
    return localised_changes(branch.space, [orbit.point for orbit in branch.orbits])


def diagram_of(branch: Branch) -> StabilityDiagram:
    found = branch.localised_diagram
    assert found is not None
    return found


def dense_tail(medium: Tail, cells: int) -> Array:
    """Stiffness of many cells in a row, that nearest to the edge last."""
    p = len(medium.stiffness)
    K = np.kron(np.eye(cells), medium.stiffness)
    for n in range(cells - 1):
        far, near = n * p + medium.outlet, (n + 1) * p + medium.inlet
        K[far, near] = K[near, far] = -medium.coupling
    return K


# The medium -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("frequency", [0.7 + 0.3j, 1.9 + 0.5j, -1.6 + 0.4j, 3.1 + 0.1j, 0.2j])
def test_a_medium_answers_as_many_cells_do(medium: Tail, frequency: complex) -> None:
    cells, p = 120, len(medium.stiffness)
    matrix = dense_tail(medium, cells) - frequency**2 * np.eye(cells * p)
    force = np.zeros(cells * p)
    force[(cells - 1) * p + medium.outlet] = 1.0
    moved = np.linalg.solve(matrix, force).reshape(cells, p)[::-1, medium.outlet]
    beta, response, free = medium.answers(np.array([frequency]))
    assert abs(moved[0] - response[0]) < 1e-12
    assert abs(moved[1] / moved[0] - beta[0]) < 1e-12
    (_, one), (_, more) = (np.linalg.slogdet(matrix[-n * p :, -n * p :]) for n in (cells - 1, cells))
    assert math.log(abs(free[0])) == pytest.approx(more - one, abs=1e-12)


@pytest.mark.parametrize("medium", MEDIA)
def test_real_frequencies_are_the_limit_from_above(medium: Tail) -> None:
    """In the bands of both signs of frequency, and in the gaps, where the answer is real."""
    at = np.linspace(-2.6, 2.6, 41)
    for near, exact in zip(medium.answers(at + 1e-7j), medium.answers(at), strict=True):
        assert np.max(np.abs(near - exact) / np.abs(exact)) < 1e-4
    assert medium.answers(np.array([0.01, 5.0]))[0].dtype == float


def test_bands_of_a_medium_are_those_of_bloch_waves() -> None:
    for medium in MEDIA:
        for phase in (0.0, 0.4, 2.0, np.pi):
            K = medium.stiffness.astype(complex)
            K[medium.inlet, medium.outlet] -= medium.coupling * np.exp(1j * phase)
            K[medium.outlet, medium.inlet] -= medium.coupling * np.exp(-1j * phase)
            C = medium.cosine(np.linalg.eigvalsh(K))
            assert np.allclose(np.abs(C), abs(math.cos(phase)), atol=1e-12) or len(medium.stiffness) > 1
            assert np.allclose(C, math.cos(phase), atol=1e-10)


def test_states_bound_at_the_end_of_a_medium_are_those_of_many_cells() -> None:
    """Cells joined more strongly than the sites within have one; the chain, and cells joined weakly, have none."""
    weak = Tail(math.inf, TWO_SITES.stiffness, 0.3, 0, 1)
    assert [medium.bound.size for medium in (CHAIN, weak, TWO_SITES)] == [0, 0, 1]
    for medium in (TWO_SITES, THREE_SITES):
        squares = np.linalg.eigvalsh(dense_tail(medium, 60))
        inside = np.abs(medium.cosine(squares)) <= 1.0
        far = [s for s in squares[~inside] if np.min(np.abs(medium.bound - s)) > 1e-9]
        assert all(np.min(np.abs(squares - bound)) < 1e-12 for bound in medium.bound)
        assert len(far) <= medium.bound.size  # those at the other end


# Hill's determinant ---------------------------------------------------------------------------------------------------


def example(medium: Tail, Omega: float = 1.3, strength: float = 0.5, swing: float = 0.05) -> Hill:
    """Two cells whose stiffness oscillates, and that of their bond by `swing`."""
    p = len(medium.stiffness)
    cells = np.zeros((2, 3, p, p))
    cells[:, 0] = medium.stiffness
    cells[0, 1:, medium.inlet, medium.inlet] = 0.1 * strength, 0.02
    cells[1, :, medium.outlet, medium.outlet] += [strength, -0.7 * strength, 0.1]
    bonds = np.zeros((1, 3, p, p))
    bonds[0, 0, medium.outlet, medium.inlet] = -medium.coupling
    bonds[0, 1, medium.outlet, medium.inlet] = swing
    return Hill(Omega, medium, cells, bonds, medium.inlet)


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("swing", [0.05, 0.0])
def test_the_determinant_is_that_of_many_cells(medium: Tail, swing: float) -> None:
    """Ratios at two exponents, with the free medium's determinant taken off by hand."""
    hill, tail = example(medium, swing=swing), dense_tail(medium, 24)
    p = len(medium.stiffness)
    m = np.arange(-hill.sidebands - 1, hill.sidebands + 1)

    def dense(sigma: complex) -> complex:
        size = 26 * p
        blocks = np.zeros((m.size, size, m.size, size), dtype=complex)
        for k in range(m.size):
            for other in range(m.size):
                apart = abs(k - other)
                K = np.zeros((size, size))
                if apart == 0:
                    K[: 24 * p, : 24 * p] = tail
                    K[23 * p + medium.outlet, 24 * p + medium.inlet] = -medium.coupling
                    K[24 * p + medium.inlet, 23 * p + medium.outlet] = -medium.coupling
                if apart < 3:
                    for n in (0, 1):
                        at = slice((24 + n) * p, (25 + n) * p)
                        K[at, at] += hill.cells[n, apart]
                    K[24 * p : 25 * p, 25 * p :] += hill.bonds[0, apart]
                    K[25 * p :, 24 * p : 25 * p] += hill.bonds[0, apart].T
                blocks[k, :, other, :] = K
        matrix = blocks.reshape(m.size * size, -1)
        matrix -= np.diag(np.repeat((sigma + 2.0 * m * hill.Omega) ** 2, size))
        sign, log = np.linalg.slogdet(matrix)
        poles = np.subtract.outer((sigma + 2.0 * m * hill.Omega) ** 2, medium.bound)  # are taken out
        return complex(np.log(sign) + log + np.sum(np.log(np.abs(poles))))

    def free(sigma: complex) -> complex:
        frequency = sigma + 2.0 * m * hill.Omega
        total = sum(np.linalg.slogdet(dense_tail(medium, 26) - w**2 * np.eye(26 * p))[1] for w in frequency)
        return complex(total)

    one, other = 0.3 + 1.6j, 0.8 + 1.4j
    logs, phases = hill.determinant(np.array([one, other]))
    expected = dense(one) - dense(other) - free(one) + free(other)
    assert logs[0] - logs[1] == pytest.approx(expected.real, abs=1e-9)
    assert np.all(np.abs(np.abs(phases) - 1.0) < 1e-12)


@needs_kernels
@pytest.mark.parametrize("medium", MEDIA)
def test_cells_are_eliminated_alike_by_the_kernel_and_by_numpy(medium: Tail) -> None:
    """At real exponents in arcs and gaps, at complex ones, and where cosines and sines part."""
    two = example(medium, swing=0.0)
    cells = np.concatenate([0.3 * two.cells[:1] + 0.7 * two.cells[1:], two.cells, two.cells])
    bonds = np.repeat(two.bonds, 4, axis=0) * np.array([1.0, 0.8, 1.1, 0.9])[:, None, None, None]
    hill, sigma = replace(two, cells=cells, bonds=bonds), np.linspace(0.05, 1.25, 9)

    def found() -> list[Array]:
        parts = [*hill.determinant(sigma), *hill.determinant(sigma + 0.2j)]
        return [*parts, np.array([hill.at_end(end, parity) for end in (0.0, 1.3) for parity in PARITIES])]

    compiled = found()
    with numpy_alone():
        plain = found()
    for one, other in zip(compiled, plain, strict=True):
        assert np.max(np.abs(one - other) / np.maximum(np.abs(other), 1.0)) < 1e-11


@needs_kernels
def test_a_pivot_that_vanishes_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        eliminated(np.zeros((2, 1, 1)), np.ones(1), (0, 0), 1, np.zeros((1, 1)))


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("end", [0.0, 1.3])
def test_cosines_and_sines_part_at_the_ends(medium: Tail, end: float) -> None:
    """The sign of the determinant is the product of both; Omega = 1.3 has no band edge there."""
    hill = example(medium, 9.0 if end == 0.0 else 6.0)
    end = 0.0 if end == 0.0 else hill.Omega
    logs, signs = hill.determinant(np.array([end]))
    parts = [hill.at_end(end, "cosine"), hill.at_end(end, "sine")]
    assert np.sign(np.real(signs[0])) == np.sign(parts[0] * parts[1])
    if end and not medium.bound.size:  # both have the same sidebands there
        assert math.log(abs(parts[0] * parts[1])) == pytest.approx(logs[0], abs=1e-9)


def defect(v: float, Omega: float = 1.6) -> tuple[Hill, Layout]:
    """A chain at rest whose last site has a stiffness more by v: above |v| = s it has a bound state."""
    cells = np.zeros((1, 2, 1, 1))
    cells[0, 0] = 3.0 + v
    return Hill(Omega, CHAIN, cells, np.zeros((0, 2, 1, 1)), 0), Layout(Omega, ((LOW, HIGH),))


@pytest.mark.parametrize("v", [-1.4, -1.05, -0.9, 0.9, 1.0, 1.4])
def test_bound_states_of_a_defect_are_counted(v: float) -> None:
    """omega^2 = 3 + v + s^2/v where |v| > s, in closed form."""
    hill, layout = defect(v)
    s = CHAIN.coupling
    expected = []
    if abs(v) > s:
        omega = math.sqrt(3.0 + v + s * s / v)
        sigma = omega % (2.0 * layout.Omega)
        expected = [min(sigma, 2.0 * layout.Omega - sigma)]
    found = [sigma for gap in layout.gaps if not gap.mirrored for sigma in zeros_in(hill, gap)]
    seen = [e for e in expected if not layout.covered(e)]
    assert found == pytest.approx(seen, abs=1e-10)


def test_a_bound_state_leaves_the_band_at_its_edge() -> None:
    """The determinant at the edge is zero at |v| = s."""
    s, layout = CHAIN.coupling, Layout(1.6, ((LOW, HIGH),))
    (edge,) = (end for end in layout.ends if end.edge == 0)
    below, at, above = (
        np.real(logs_and_sign[1][0]) * np.exp(logs_and_sign[0][0])
        for logs_and_sign in (defect(v)[0].determinant(np.array([edge.sigma])) for v in (-0.99 * s, -s, -1.01 * s))
    )
    assert below > 1e-3
    assert above < -1e-3
    assert abs(at) < 1e-12


# Arcs and gaps --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("Omega", [0.7, 0.82, 0.95, LOW, 1.6, HIGH, 2.5, 5.0])
def test_arcs_cover_the_exponents_of_waves(Omega: float) -> None:
    """Against folded frequencies of 20001 waves, with their signatures."""
    layout = Layout(Omega, ((LOW, HIGH),))
    omega = np.sqrt(np.linspace(LOW**2, HIGH**2, 20001))
    turned = omega % (2.0 * Omega)
    sigma, sign = np.minimum(turned, 2.0 * Omega - turned), np.where(turned <= Omega, 1, -1)
    for a, b, covered in layout.intervals:
        inside = (sigma > a.sigma + 1e-9) & (sigma < b.sigma - 1e-9)
        assert bool(inside.any()) == covered
        if covered:
            signs = set(layout.covered(0.5 * (a.sigma + b.sigma)))
            assert signs == set(sign[inside].tolist())
    assert layout.intervals[0][0].sigma == 0.0
    assert layout.intervals[-1][1].sigma == Omega
    assert layout.pinned == (Omega in (LOW, HIGH, 0.7, 1.6))
    assert layout.fills == (Omega in (0.7, 1.6))  # 3 * 0.7 is in the band


def test_ends_of_arcs_meet_at_frequencies_in_closed_form() -> None:
    """2 m Omega = a sum or a difference of band edges: there the order of ends changes, and nowhere else."""
    bands = ((LOW, HIGH),)
    sums = [(2 * LOW, m) for m in (1, 2)] + [(LOW + HIGH, m) for m in (1, 2, 3)] + [(2 * HIGH, m) for m in (1, 2, 3)]
    known = {total / (2 * m) for total, m in [*sums, (HIGH - LOW, 1)] if 0.75 < total / (2 * m) < 2.9}
    places = [2.9, *sorted(known, reverse=True), 0.75]
    before = None
    for a, b in itertools.pairwise(places):
        inside = [Layout(b + part * (a - b), bands).names for part in (1e-6, 0.01, 0.3, 0.6, 0.99, 1.0 - 1e-6)]
        assert len(set(inside)) == 1
        assert inside[0] != before
        before = inside[0]


# Stability of one orbit -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_count_decides_stability_where_the_cut_resolves_no_multiplier() -> None:
    """One leaves the circle at S = 0.1018: at 0.105 the cut problem does not show it, at 0.11 and beyond it does."""
    branch = follow_family(SOFT, "first", 0.3, at=(0.1, 0.105, 0.11), stability=True)
    (change,) = branch.changes
    assert 0.1 < change.S < 0.105
    assert [orbit.stable for orbit in branch.orbits] == [orbit.S < change.S for orbit in branch.orbits]
    for S, off, listed in ((0.1, 0, 0), (0.105, 1, 0), (0.3, 1, 1)):
        found = branch.at(S).floquet()
        assert (found.counted, found.listed, found.stable) == (off, listed, off == 0)
        assert (found.unstable_real, found.unstable_complex) == (off, 0)
        assert ("too weakly localised" in str(found)) == (off != listed)
        uncounted = replace(found, counted=None)
        assert (uncounted.stable, "not counted" in str(uncounted)) == (listed == 0, True)
    assert not branch.at(0.11).stable


@pytest.mark.parametrize(("counted", "numbers"), [(0, (0, 0)), (1, (1, 0)), (2, (0, 2)), (3, (1, 2)), (4, (0, 4))])
def test_counted_numbers_beside_a_complex_pair_leave_complex_ones_in_twos(
    counted: int, numbers: tuple[int, int]
) -> None:
    listed = reversible_floquet(np.array([-0.5 + 0.1j, -0.5 - 0.1j]), np.full(2, 1e-9), 0.0, 2)
    found = replace(listed, counted=counted)
    assert found.listed == 2
    assert (found.unstable_real, found.unstable_complex) == numbers
    assert found.stable == (counted == 0)


# Families -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_changes_of_the_softening_chain() -> None:
    """Four places: the first below the threshold, one at an extremum of the energy, a pair born at a band's edge."""
    found = changes_of(SOFT, "first", 2.9)
    kinds = [(change.kind, change.off_before, change.off_after) for change in found.all]
    assert kinds == [("real", 0, 1), ("real", 1, 0), ("band edge", 0, 0), ("complex", 0, 2)]
    assert not found.unresolved
    assert [change.kind for change in found.further] == ["band edge"]
    _, second, _, last = found.all
    before, after = last.S - 2e-6, last.S + 2e-6  # 500 sites: decay over 60 sites
    branch = follow_family(SOFT, "first", after + 0.01, at=(before, after), tolerance=1e-9, stability_sites=500)

    def slope(S: float) -> float:
        return float(branch.at(S + 1e-3).energy - branch.at(S - 1e-3).energy)

    low, high = slope(second.S - 2e-3), slope(second.S + 2e-3)
    assert low * high < 0.0  # the energy is extremal where multipliers leave 1 with the velocity
    assert second.S - 2e-3 - 4e-3 * low / (high - low) == pytest.approx(second.S, abs=1e-5)
    for S, stable in ((before, True), (after, False)):
        cut = branch.at(S).floquet()
        near = cut.mu[np.abs(cut.mu - last.mu) < 0.01]
        assert near.size == 2
        assert np.all(near.imag == 0.0) == stable
        assert abs(near.mean() - last.mu) < 1e-4


def test_orbits_that_are_not_found_where_arcs_meet_leave_a_named_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    """The three points about the threshold, where a stretch of the family ends, with and without orbits between."""
    branch = follow_family(HARD, "last", 0.5, tolerance=1e-9)
    assert isinstance(branch.space, Family)
    first = next(number for number, orbit in enumerate(branch.orbits) if orbit.Omega > HIGH + 1e-6)
    points = [orbit.point for orbit in branch.orbits[first - 2 : first + 1]]
    orbits = EdgeOrbits(branch.space, points)
    assert orbits.diagram().complete
    known = EdgeOrbits.names

    def names(self: EdgeOrbits, coordinate: float) -> tuple[str, ...]:
        if coordinate != round(coordinate):
            raise OrbitNotFoundError("no orbit is found there")
        return known(self, coordinate)

    monkeypatch.setattr(EdgeOrbits, "names", names)
    found = EdgeOrbits(branch.space, points).diagram()
    (gap,) = found.unresolved
    assert (gap.coordinate_start, gap.coordinate_end, gap.reason) == (1.0, 2.0, "no orbit is found there")
    assert (gap.S_start, gap.S_end) == pytest.approx([orbits.S(point) for point in points[1:]], rel=1e-6)


@pytest.mark.slow
def test_changes_do_not_depend_on_tolerance_and_are_those_of_finite_chains() -> None:
    """Above the threshold by exponentially little: 60 sites have the change at S = 1.86 to 1e-9."""
    (first, second) = changes_of(HARD, "last", 2.0).all
    assert (first.kind, second.kind) == ("real", "real")
    whole = follow_family(Chain(60, 1.0, 0.25, 1.0), 60, 2.0, tolerance=1e-9, stability=True)
    assert len(whole.changes) == 2
    assert abs(whole.changes[1].value - second.S) <= whole.changes[1].error + second.S_error
    assert whole.changes[0].value > first.S  # in the tail's band: it comes down as the chain becomes longer
    (again,) = changes_of(HARD, "last", 0.12, 1e-6).all
    assert abs(again.S - first.S) <= again.S_error + first.S_error + 1e-11


@pytest.mark.slow
def test_the_chain_as_a_long_lattice_and_its_mirror_image_have_the_same_changes() -> None:
    parameters = {"alpha": 1.0, "gamma": 0.25, "g": 1.0}
    site, bond = Site("a", onsite="alpha*y + g*y^3"), Bond("a", "a", [1], "d", ("1 - gamma", "1 + gamma"))
    lattice = LongLattice(math.inf, [site], [bond], "fixed", parameters)
    (expected,) = changes_of(HARD, "last", 0.12).all
    for other in (lattice, Chain(math.inf, 1.0, -0.25, 1.0)):
        (found,) = changes_of(other, "last", 0.12).all
        assert abs(found.S - expected.S) <= found.S_error + expected.S_error + 1e-11


@pytest.mark.slow
def test_multipliers_of_a_dimer_return_to_1_where_the_energy_is_extremal() -> None:
    """A cell of two sites: the place found by Hill's determinant is that of the energy along the family."""
    branch = follow_family(DIMER, 5, 0.82, tolerance=1e-10)
    assert isinstance(branch.space, Family)
    found = localised_changes(branch.space, [orbit.point for orbit in branch.orbits])
    assert found.complete
    assert [(change.kind, change.off_after) for change in found.all] == [("real", 1), ("band edge", 1), ("real", 0)]
    S = found.all[-1].S
    places = S + 0.004 * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    energy = np.polynomial.Polynomial.fit(places, [branch.at(float(place)).energy for place in places], 4)
    (extremum,) = (root.real for root in energy.deriv().roots() if abs(root - S) < 0.004)
    assert extremum == pytest.approx(S, abs=1e-6)


@pytest.mark.slow
def test_a_multiplier_of_a_dimer_that_passes_the_edge_of_a_band_is_listed() -> None:
    """One more or less is then in the gap, by its Chebyshev series with more sidebands."""
    branch = follow_family(replace(DIMER, edge="last"), 3, 1.21, tolerance=1e-9)
    assert isinstance(branch.space, Family)
    behind = next(number for number, orbit in enumerate(branch.orbits) if orbit.S > 1.189)
    orbits = EdgeOrbits(branch.space, [orbit.point for orbit in branch.orbits[behind - 1 : behind + 1]])
    found = orbits.diagram()
    (change,) = found.further
    assert found.complete
    assert not found.changes
    assert (change.kind, change.signatures) == ("band edge", (1,))
    assert pytest.approx(1.1889630050, abs=1e-9) == change.S
    before, after = (count(at.hill.with_more(3), at.layout) for at in map(orbits.orbit, map(orbits.at, (0.0, 1.0))))
    assert before.off == after.off == 0
    assert abs(sum(after.inside) - sum(before.inside)) == 1


@pytest.mark.slow
def test_nothing_changes_where_the_frequency_is_extremal() -> None:
    """Hill's equations have an even solution of the orbit's own frequency there, beside its velocity."""
    branch = follow_family(Chain(math.inf, 0.3, 0.3, 1.0), "last", 3.0, tolerance=1e-9)
    assert isinstance(branch.space, Family)
    points = [orbit.point for orbit in branch.orbits]
    found = EdgeOrbits(branch.space, points).diagram()
    assert np.count_nonzero(np.abs(np.diff(np.sign(np.diff(branch.Omega)))) == 2.0) == 2
    assert [(change.kind, change.off_before, change.off_after) for change in found.all] == [
        ("real", 0, 1), ("real", 1, 0), ("real", 0, 1),
    ]  # fmt: skip
    assert found.complete


@pytest.mark.slow
def test_counts_are_those_of_cut_problems() -> None:
    """At single orbits of a short stretch: on the circle and off it."""
    branch = follow_family(SOFT, "first", 0.2, at=(0.08, 0.2), tolerance=1e-7)
    orbits = EdgeOrbits(branch.space, [branch.at(S).point for S in (0.08, 0.2)])  # type: ignore[arg-type]
    for place, expected in ((0.0, 0), (1.0, 1)):
        orbit = orbits.orbit(orbits.at(place))
        assert orbit.counts is not None
        assert orbit.counts.off == expected
        assert count(orbit.hill.with_more(3), orbit.layout) == orbit.counts


@pytest.mark.slow
def test_scenes_write_changes_of_infinite_chains(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "long.toml"
    scene.write_text(
        "[chain]\nsites = inf\nalpha = 1.0\ngamma = 0.25\ng = 1.0\n"
        '[family]\nmode = "last"\namplitude_max = 0.12\n[stability]\nevents = true\n'
    )
    assert main(["check", str(scene)]) == 0
    assert "of localised multipliers" in capsys.readouterr().out
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "events.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert row["kind"] == "real"
    assert float(row["S"]) == pytest.approx(0.1018498977, abs=1e-8)
    assert (row["stable_before"], row["stable_after"], row["tongue"]) == ("1", "0", "")


@pytest.mark.slow
def test_results_print_become_tables_and_are_read_back(tmp_path: Path) -> None:
    branch = hard()
    found = diagram_of(branch)
    assert [change.S for change in branch.changes] == [change.S for change in found.changes]
    assert branch.first_instability().S == found.changes[0].S  # type: ignore[union-attr]
    assert "real at 0.10184" in str(found)
    assert "changes of stability" in str(branch)
    assert list(found.to_xarray()["kind"].values) == ["real"]
    branch.save(tmp_path / "branch.skin")
    again = read_result(tmp_path / "branch.skin")
    assert again.with_events
    with pytest.raises(ValueError, match="number: given 0; accepted: none"):
        branch.edge(0)
    with pytest.raises(ValueError, match="growth"):
        branch.first_instability(1e-3)
    assert [point.S_start for point in branch.not_located] == [found.changes[0].S]
