"""Tails of long lattices of any cells, eliminated: against matrices, closed forms, harmonic balance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lattices import GAINS

from casadi_skin import Bond, Chain, Lattice, LongLattice, Site, follow_family, read_result, save_result
from casadi_skin.lattice.linear import lattice_modes
from casadi_skin.lattice.tail import Place, Tail
from casadi_skin.lattice.tail_parameter import Regime

DIMER = ([Site("a", "y + g*y^3"), Site("b", "y + g*y^3")], [Bond("a", "b", (0,), "u*d", GAINS), Bond("b", "a", (1,))])
VALUES = {"u": 0.4, "gamma": 0.4, "g": 1.0}
RESONATORS: tuple[list[Site], list[Bond]] = (
    [Site("a", "0.5*y + 0.4*y^3"), Site("b", "0.2*y", mass="0.7")],
    [Bond("a", "b", (0,), "0.8*d + d^3"), Bond("a", "a", (1,), "d + 0.5*d^3", GAINS)],
)
PUSHING: tuple[list[Site], list[Bond]] = (
    [Site("a", "y + y^3"), Site("b", "1.2*y - 0.3*y^3"), Site("c", "sin(y)")],
    [Bond("a", "b", (0,), "-0.4*d", GAINS), Bond("b", "c", (0,), "0.6*d"), Bond("c", "a", (1,), "-0.3*d", GAINS)],
)


# One harmonic -------------------------------------------------------------------------------------------------------


def test_an_angle_is_found_far_in_a_band_that_widens_from_its_edge() -> None:
    tail = Tail(2, np.array([[2.6, -0.24, 0.0], [-0.24, 3.6, -0.6], [0.0, -0.6, 3.4]]), 1.4, 0, 0, 0.3)
    for part in np.linspace(0.05, 0.95, 19):
        place = Place(3, -part * tail.width(Place(3)))
        assert tail.at_angle(2, tail.angle(place)).off == pytest.approx(place.off, rel=1e-9)


@pytest.mark.parametrize("wall", [0.0, 0.3])
@pytest.mark.parametrize(
    ("cells", "sites", "inlet", "outlet"),
    [(9, 1, 0, 0), (9, 2, 0, 1), (9, 3, 1, 1), (9, 4, 3, 1), (2, 3, 1, 1), (2, 3, 0, 0)],
)
def test_the_tail_moves_as_all_its_sites_do(cells: int, sites: int, inlet: int, outlet: int, wall: float) -> None:
    """Angle, slope, frequency of an angle and motion, in gaps and in bands, by matrices of the whole tail."""
    generator, s = np.random.default_rng(0), 0.7
    A = generator.normal(size=(sites, sites))
    A = A + A.T + 8.0 * np.eye(sites)
    K = np.kron(np.eye(cells), A)
    for j in range(cells - 1):  # the first cell is beside the core
        a, b = j * sites + inlet, (j + 1) * sites + outlet
        K[a, b] = K[b, a] = -s
    far = (cells - 1) * sites + inlet
    K[far, far] -= s * wall
    tail = Tail(cells, A, s, inlet, outlet, wall)
    for square in np.linspace(0.1, tail.edges[-1] + 3.0, 83):
        place = tail.anywhere(square)
        if np.sum([edge < square for edge in tail.edges]) % 2:
            assert place.in_band
            with pytest.raises(ArithmeticError, match="in a band"):
                tail.place(square)
        G = np.linalg.inv(K - square * np.eye(len(K)))
        ratio, growth = s * G[outlet, outlet], s * (G @ G)[outlet, outlet]
        angle = tail.angle(place)
        assert np.sin(angle - np.arctan(ratio)) == pytest.approx(0.0, abs=1e-11)
        assert tail.slope(place) == pytest.approx(growth / (1.0 + ratio**2), rel=1e-9)
        assert tail.square(tail.at_angle(place.gap, angle)) == pytest.approx(square, rel=1e-9)
        logs, parts = tail.motion(place, angle, np.arange(1, cells + 1))
        known = s * G[:, outlet].reshape(cells, sites) * np.cos(angle)
        np.testing.assert_allclose(np.exp(logs)[:, None] * parts, known, rtol=1e-9, atol=1e-11)


# Families -----------------------------------------------------------------------------------------------------------


def long(cell: Any, cells: float, boundary: str = "fixed", edge: str | None = None, **values: float) -> LongLattice:
    return LongLattice(cells, *cell, boundary, values, edge)


def nearest(lattice: Lattice, square: float) -> int:
    """The number of the mode whose omega^2 is nearest."""
    return int(np.argmin(np.abs(lattice_modes(lattice).squares - square))) + 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "boundary", "edge", "mode", "values", "S"),
    [
        (DIMER, "fixed", "first", 1, VALUES, 0.6),  # bound at the edge that displacements lean away from
        (PUSHING, "free", None, 7, {"gamma": 0.3}, 0.6),
    ],
)
def test_an_eliminated_tail_changes_nothing(
    cell: Any, boundary: str, edge: str | None, mode: int, values: dict[str, float], S: float
) -> None:
    lattice = long(cell, 90, boundary, edge, **values)
    branch = follow_family(lattice, mode=mode, amplitude_max=S, at=(S,), tolerance=1e-9)
    whole = lattice.of_cells(90)
    other = follow_family(whole, nearest(whole, lattice.modes[mode - 1].square), S, at=(S,), tolerance=1e-9).at(S=S)
    found = branch.at(S=S)
    assert found.Omega == pytest.approx(other.Omega, rel=1e-13)
    assert found.Omega_shift == pytest.approx(other.Omega_shift, rel=1e-8)
    sites = branch.space.coordinates.output_sites
    np.testing.assert_allclose(found.evaluate(0.7), other.evaluate(0.7, sites=sites), atol=1e-9)
    if edge is None:  # else the whole lattice has its weights from its other end
        assert found.energy == pytest.approx(other.energy, rel=1e-9)


def test_the_edge_mode_is_accepted_where_the_cut_of_its_cells_has_another_of_the_same_frequency() -> None:
    """Without nonreciprocity the dimer is its own mirror image; sites b alone move, by -u from cell to cell."""
    lattice = long(DIMER, math.inf, edge="last", **{**VALUES, "gamma": 0.0})
    orbit = follow_family(lattice, 1, 1e-4, at=(1e-4,), tolerance=1e-8).at(S=1e-4)
    shape = orbit.evaluate(0.0)[-6:] / orbit.evaluate(0.0)[-1]
    np.testing.assert_allclose(shape, [0.0, 0.4**2, 0.0, -0.4, 0.0, 1.0], atol=1e-3)


@pytest.mark.slow
def test_the_edge_breather_of_a_dimer_agrees_with_harmonic_balance() -> None:
    """Newton's method on odd cosines of 40 cells, written by hand in physical coordinates without nonreciprocity."""
    S, H, n, u = 0.3, 6, 80, 0.4
    orbits = []
    for cells in (10**6, math.inf):
        lattice = long(DIMER, cells, edge="last", **{**VALUES, "gamma": 0.0})
        orbits.append(follow_family(lattice, 1, S, at=(S,), tolerance=1e-10).at(S=S))
    inner = np.where(np.arange(n - 1) % 2 == 0, u, 1.0)
    K = np.diag(1.0 + u + np.ones(n)) - np.diag(inner, 1) - np.diag(inner, -1)
    k, theta = 2 * np.arange(H) + 1, (np.arange(4 * H) + 0.5) * np.pi / (8 * H)
    C = np.cos(np.outer(theta, k))
    a, Omega = np.zeros((H, n)), float(np.sqrt(1.0 + u + 1.0))
    a[0, 1::2] = (-u) ** np.arange(40)[::-1] * np.sqrt(S * (1 - u**2))
    for _ in range(12):
        y = C @ a
        residual = a @ K - (Omega * k)[:, None] ** 2 * a + 2.0 / theta.size * C.T @ y**3
        J = np.zeros((H * n + 1, H * n + 1))
        for i in range(H):
            for j in range(H):
                block = np.diag(2.0 / theta.size * (C[:, i] * C[:, j]) @ (3.0 * y**2))
                J[i * n : (i + 1) * n, j * n : (j + 1) * n] = block + (i == j) * (K - (Omega * k[i]) ** 2 * np.eye(n))
        J[:-1, -1] = (-2.0 * Omega * k[:, None] ** 2 * a).ravel()
        J[-1, :-1] = np.tile(2.0 * a.sum(axis=0), H)
        step = np.linalg.solve(J, -np.append(residual.ravel(), np.sum(a.sum(axis=0) ** 2) - S))
        a, Omega = a + step[:-1].reshape(H, n), Omega + step[-1]
    for orbit in orbits:
        assert orbit.Omega == pytest.approx(Omega, abs=1e-11)
        np.testing.assert_allclose(np.abs(orbit.evaluate(0.0)[-6:]), np.abs(a.sum(axis=0)[-6:]), atol=1e-9)


@pytest.mark.slow
def test_a_mode_that_grows_into_the_tail_in_the_gauge_is_followed_as_well() -> None:
    """Its amplitudes at the edge are a millionth of those in the tail, and all that users see."""
    endless = long(DIMER, math.inf, **VALUES)
    by_series, by_steps = (
        follow_family(endless, 1, 2.0, at=(2.0,), tolerance=1e-7, corrector="newton", walker=walker).at(S=2.0)
        for walker in ("series", "arclength")
    )
    assert by_series.Omega == pytest.approx(by_steps.Omega, abs=1e-12)
    np.testing.assert_allclose(by_series.evaluate(0.0), by_steps.evaluate(0.0), atol=1e-7)
    assert np.ptp(np.log(np.abs(by_series.point.z[:-2]))) > math.log(1e6)


# Stability of localised perturbations -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "boundary", "mode", "values", "S", "cells", "count"),
    [
        (DIMER, "fixed", 3, {**VALUES, "g": -1.0}, 1.5, (60, 80), 2),  # a complex pair at the last cell
        (RESONATORS, "free", 4, {"gamma": 0.3}, 1.0, (50, 60), 2),  # on the circle; masses and nonlinear bonds
    ],
)
def test_localised_multipliers_are_those_of_finite_lattices_with_all_sites(
    cell: Any, boundary: str, mode: int, values: dict[str, float], S: float, cells: tuple[int, int], count: int
) -> None:
    """Which come nearer the longer they are; by their own families and variational systems."""
    endless = long(cell, math.inf, boundary, **values)
    found = follow_family(endless, mode, S, at=(S,), tolerance=1e-9).at(S=S).floquet()
    assert found.mu.size == count
    assert found.stable == (cell is RESONATORS)
    assert np.max(found.mu_error) < 1e-8
    distances = []
    for number in cells:
        whole = endless.of_cells(number)
        chosen = nearest(whole, long(cell, number, boundary, **values).modes[mode - 1].square)
        all_mu = follow_family(whole, chosen, S, at=(S,), tolerance=1e-9).at(S=S).floquet().mu
        distances.append(np.min(np.abs(found.mu[:, None] - all_mu), axis=1))
    assert np.all(distances[1] <= np.maximum(distances[0], 2e-9))
    assert np.max(distances[1]) < 1e-7
    fewer = follow_family(endless, mode, S, at=(S,), tolerance=1e-9, stability_sites=found.tail.sites + 30)
    other = fewer.at(S=S).floquet()
    assert other.tail.sites != found.tail.sites
    assert np.all(np.abs(other.mu - found.mu) <= other.mu_error + found.mu_error)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cells", "g", "mode"), [(math.inf, -1.0, "first"), (math.inf, 1.0, "last"), (400, -1.0, "first")]
)
def test_a_chain_declared_as_a_long_lattice_has_the_family_and_the_stability_of_the_chain(
    cells: float, g: float, mode: str, tmp_path: Path
) -> None:
    """Pinned, where the orbit fills the tail, and bound; results are saved and read back."""
    cell, at = ([Site("a", "y + g*y^3")], [Bond("a", "a", (1,), "d", GAINS)]), (0.2, 1.0, 3.0)
    branch = follow_family(long(cell, cells, gamma=0.25, g=g), mode, 3.0, at=at, tolerance=1e-9)
    other = follow_family(Chain(cells, 1.0, 0.25, g), mode, 3.0, at=at, tolerance=1e-9, stability_sites=190)  # type: ignore[arg-type]
    for S in at:
        one, two = branch.at(S=S), other.at(S=S)
        assert one.Omega == pytest.approx(two.Omega, rel=1e-14)
        assert one.energy == pytest.approx(two.energy, rel=1e-12)
        assert (branch.space.coordinates.regime(one.point) is Regime.PINNED) == (S < 0.3669)
        if S == 1.0:
            continue
        mine, theirs = one.floquet(), two.floquet()
        assert mine.tail.sites == theirs.tail.sites == 190
        np.testing.assert_allclose(mine.mu, theirs.mu, rtol=0, atol=float(np.max(mine.mu_error + theirs.mu_error)))
        np.testing.assert_allclose(mine.tail.continuous.arcs, theirs.tail.continuous.arcs, rtol=1e-12)
    save_result(branch, tmp_path / "branch")
    save_result(branch.at(S=3.0), tmp_path / "orbit.json")
    assert np.array_equal(read_result(tmp_path / "branch").Omega, branch.Omega)
    np.testing.assert_array_equal(read_result(tmp_path / "orbit.json").floquet().mu, branch.at(S=3.0).floquet().mu)


# Linear modes and refusals --------------------------------------------------------------------------------------------


def test_modes_at_an_edge_are_those_of_a_long_lattice_there() -> None:
    first, last = (long(DIMER, math.inf, edge=edge, **VALUES) for edge in ("first", "last"))
    assert [mode.square for mode in first.modes] == pytest.approx([2.24], rel=1e-12)  # 1 + w + u (1 - gamma)
    assert [mode.square for mode in last.modes if not mode.pinned] == pytest.approx([2.56], rel=1e-12)
    finite = long(DIMER, 40, **VALUES)
    squares = lattice_modes(finite.of_cells(40)).squares.real
    for mode in finite.modes:
        assert np.min(np.abs(squares - mode.square)) < 1e-11
    assert first.lean == -last.lean == pytest.approx(-0.5 * math.log(1.4 / 0.6))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cells": 5}, "cells: given 5; accepted: a whole number >= 8, or inf"),
        ({"boundary": "periodic"}, "boundary: given periodic, which has no edge"),
        ({"edge": "left"}, "edge: given 'left'; accepted: first, last"),
        ({"bonds": [*DIMER[1], Bond("a", "a", (1,), "d", GAINS)]}, "bonds: given cells joined otherwise"),
        ({"bonds": [*DIMER[1], Bond("b", "a", (2,), "d", GAINS)]}, "bonds: given cells joined otherwise"),
        ({"sites": [Site("a", "y + y^2"), Site("b", "y")]}, "given forces that are not odd: there are even harmonics"),
        ({"sites": [Site("a", "n*y"), Site("b", "y")]}, "given cells that differ by n; accepted with a linear tail"),
        ({"sites": [Site("a", "y", damping="0.1"), Site("b", "y")]}, "given forces that are damped or driven"),
    ],
)
def test_refusals_are_one_line_with_the_place(change: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"cells": math.inf, "sites": DIMER[0], "bonds": DIMER[1], "parameters": VALUES} | change
    with pytest.raises((ValueError, TypeError), match=message) as caught:
        LongLattice(**given)
    assert "\n" not in str(caught.value)


def test_modes_and_harmonics_without_a_linear_tail_are_refused() -> None:
    plain = LongLattice(math.inf, [Site("a", "y + y^3")], [Bond("a", "a", (1,))])
    with pytest.raises(ValueError, match="the lattice has no mode at this edge"):
        follow_family(plain, 1, 1.0)
    low = long(RESONATORS, math.inf, "free", gamma=0.3)
    with pytest.raises(
        ValueError, match="mode: given one with 3 times the frequency of the mode, which the tail carries"
    ):
        follow_family(low, 1, 1.0)
    uneven = DIMER[0], [*DIMER[1], Bond("b", "a", (1,), "d^3", GAINS)]  # a cubic bond of another ratio of gains
    with pytest.raises(ValueError, match="with a linear tail; stability is that of all sites, accepted: a Lattice"):
        follow_family(long(uneven, math.inf, **VALUES), 3, 0.1, stability=True)
    with pytest.raises(ValueError, match=r"stability_sites: given 20; accepted: more sites than those of \d+ cells"):
        follow_family(long(DIMER, math.inf, **VALUES), 3, 0.1, stability=True, stability_sites=20)
    leaning = long(DIMER, math.inf, edge="first", **{**VALUES, "u": 0.6, "gamma": 0.9})
    with pytest.raises(ValueError, match=r"mode: given one that falls by 0 a cell; accepted: 2000 nonlinear sites"):
        follow_family(leaning, 1, 0.1)


def test_a_family_that_ended_early_says_why() -> None:
    branch = follow_family(long(DIMER, math.inf, edge="last", **VALUES), 1, 0.3, tolerance=1e-6, max_points=3)
    assert not branch.complete
    assert "points" in branch.reason
