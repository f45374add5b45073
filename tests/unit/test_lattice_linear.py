"""Linear modes and bands of lattices against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from lattices import GAINS, chain, dimer, fput, plane

from casadi_skin import Bond, Chain, Lattice, Site, follow_family
from casadi_skin.lattice.linear import bands, brillouin_zone, lattice_modes, winding_numbers
from casadi_skin.results.figures.bands import band_figure, skin_figure
from casadi_skin.results.figures.families import plane_figure
from casadi_skin.runs.plan import lattice_lines


def test_modes_of_the_chain_are_those_in_closed_form() -> None:
    lattice, closed = chain(24, 1.0, 0.25, -1.0), Chain(24, 1.0, 0.25, -1.0)
    modes = lattice_modes(lattice)
    assert modes.real
    assert modes.frequencies.real == pytest.approx(closed.linear_frequencies(), rel=1e-14)
    for j in (1, 7, 24):
        for mine, theirs in ((modes.right, closed.right_eigenvector(j)), (modes.left, closed.left_eigenvector(j))):
            expected = theirs / np.linalg.norm(theirs)
            assert abs(mine[:, j - 1].real @ expected) == pytest.approx(1.0, abs=1e-12)
    envelope = closed.right_eigenvector(1) / np.linalg.norm(closed.right_eigenvector(1))
    assert modes.participation[0] == pytest.approx(1.0 / np.sum(envelope**4), rel=1e-12)
    assert modes.centre[0, 0] == pytest.approx(np.arange(1, 25) @ envelope**2, rel=1e-12)
    assert modes.decay[:, 0] == pytest.approx(0.5 * np.log(5 / 3), rel=0.05)  # the skin envelope's


def test_bands_of_the_chain_end_at_its_cutoffs_and_lean_by_the_skin_factor() -> None:
    found = bands(chain(24, 1.0, 0.25, -1.0))
    assert (found.squares.real.min(), found.squares.real.max()) == pytest.approx(Chain(9, 1.0, 0.25, 1.0).band())
    assert np.max(np.abs(found.squares.imag)) < 1e-14
    assert found.beta == pytest.approx((np.sqrt(5 / 3),))


def test_a_ring_without_gauge_has_the_complex_frequencies_of_its_waves() -> None:
    ring = Lattice(20, [Site("a", "y")], [Bond("a", "a", (1,), gain=GAINS)], "periodic", {"gamma": 0.2})
    modes, k = lattice_modes(ring), 2 * np.pi * np.arange(20) / 20
    expected = 3.0 - 0.8 * np.exp(1j * k) - 1.2 * np.exp(-1j * k)
    assert not modes.real
    assert np.sort_complex(modes.squares.round(10)) == pytest.approx(np.sort_complex(expected.round(10)), abs=1e-9)
    squares = bands(ring, points=21).squares[:-1, 0]
    assert np.sort_complex(squares.round(10)) == pytest.approx(np.sort_complex(expected.round(10)), abs=1e-9)


def test_the_dimer_has_its_gap_and_edge_modes_in_it() -> None:
    u, w, s = 0.5, 1.0, 0.5 * np.sqrt(1 - 0.3**2)
    # in the gauge: diagonal 1 + u (1 -+ gamma) + w, couplings s and w
    k = np.linspace(-np.pi, np.pi, 201)
    half = np.sqrt((0.3 * u) ** 2 + s**2 + w**2 + 2 * s * w * np.cos(k))
    found = bands(dimer(20))
    assert found.squares.real == pytest.approx(np.stack([2.5 - half, 2.5 + half], axis=1), rel=1e-12)
    ((low, high),) = found.gaps
    modes = lattice_modes(dimer(20))
    inside = (modes.squares.real > low + 0.05) & (modes.squares.real < high - 0.05)
    assert modes.squares.real[inside] == pytest.approx([2.35, 2.65], abs=1e-6)
    assert np.all(modes.participation[inside] < 3)
    assert np.all(modes.participation[~inside] > 3)


def test_modes_of_a_plane_are_products() -> None:
    modes, n, m = lattice_modes(plane((6, 5))), np.arange(1, 7), np.arange(1, 6)
    x = 2 - 2 * np.sqrt(1 - 0.3**2) * np.cos(n * np.pi / 7)
    y = 2 - 2 * np.sqrt(1 - 0.15**2) * np.cos(m * np.pi / 6)
    assert modes.squares.real == pytest.approx(np.sort((1 + x[:, None] + y).ravel()), rel=1e-13)
    assert np.all(modes.decay[0] > 0)
    assert np.all(modes.centre[0] > [3.5, 3.0])


def test_cells_that_differ_have_no_bands() -> None:
    lattice = Lattice(5, [Site("a", "n*k*y")], [Bond("a", "a", (1,))], parameters={"k": [1, 2, 3, 4, 5.0]})
    with pytest.raises(ValueError, match="given cells that differ by k, n; accepted: cells alike"):
        bands(lattice)


@pytest.mark.parametrize("lattice", [dimer(6), plane((3, 3))])
def test_pictures_of_bands(lattice: Lattice) -> None:
    figure = band_figure(lattice)
    assert len(figure.axes) == 3


def test_profiles_in_the_plane_are_drawn_of_two_dimensions_alone() -> None:
    drawn = plane_figure(follow_family(plane((3, 2)), mode=1, amplitude_max=0.2, at=(0.1,)))
    values = drawn.axes[0].images[0].get_array()
    assert values.shape == (2, 3)
    assert np.linalg.norm(values) == pytest.approx(1.0, rel=1e-6)
    assert plane_figure(follow_family(chain(3, 1.0, 0.2, -1.0), mode=1, amplitude_max=0.2, at=(0.1,))) is None


# The skin effect ------------------------------------------------------------------------------------------------------


def test_the_spectrum_of_a_ring_winds_round_the_modes_of_a_leaning_lattice() -> None:
    """Hatano and Nelson: omega^2 = 3 - 0.75 e^(ik) - 1.25 e^(-ik) is an ellipse of half axes 2 and 0.5 about 3."""
    lattice = chain(24, 1.0, 0.25, -1.0)
    inside, outside = [3.0, 3.0 + 0.49j, 1.01], [3.0 + 0.51j, 0.99, 5.01]
    assert winding_numbers(lattice, [*inside, *outside]).tolist() == [1, 1, 1, 0, 0, 0]
    assert np.all(winding_numbers(lattice, lattice_modes(lattice).squares) == 1)
    assert np.all(winding_numbers(chain(24, 1.0, -0.25, -1.0), inside) == -1)
    reciprocal = chain(24, 1.0, 0.0, -1.0)
    assert np.all(np.isnan(winding_numbers(reciprocal, lattice_modes(reciprocal).squares)))
    assert np.abs(brillouin_zone(lattice, lattice_modes(lattice).squares)) == pytest.approx(np.sqrt(5 / 3), rel=1e-9)
    assert np.abs(brillouin_zone(dimer(12), [1.7])) == pytest.approx(np.sqrt(1.3 / 0.7), rel=1e-9)


def test_the_plan_names_frequencies_bands_and_gaps() -> None:
    """By closed forms: a dimer's bands at k = 0 and pi; a free chain rests in one mode; a soft site is unstable."""
    found = dict(lattice_lines(dimer(8), {"u": 0.5, "w": 1.0, "gamma": 0.3, "g": 1.0, "M": 1.0}))["linear"]
    far, near = (np.hypot(0.15, 1.0 + sign * 0.5 * np.sqrt(1 - 0.3**2)) for sign in (1, -1))  # stiffness 2.5 -+ 0.15
    edges = np.sqrt([2.5 - far, 2.5 - near, 2.5 + near, 2.5 + far])
    low, first, second, high = (f"{edge:.6g}" for edge in edges)
    assert found.endswith(f"bands from {low} to {first}, from {second} to {high}; gaps from {first} to {second}")
    assert (
        f"omega from 0 to {np.sqrt(2 + np.sqrt(3)):.6g}; bands from 0 to 2; no gap"
        == dict(lattice_lines(fput(6, "free"), {"beta": 1.0}))["linear"]
    )
    unstable = Lattice(3, [Site("a", "-3*y")], [Bond("a", "a", (1,))])
    assert (
        f"omega from {np.sqrt(1 + np.sqrt(2)):.6g}i to {np.sqrt(np.sqrt(2) - 1):.6g}"
        in dict(lattice_lines(unstable, {}))["linear"]
    )
    ring = Lattice(5, [Site("a", "y")], [Bond("a", "a", (1,), gain=GAINS)], "periodic", {"gamma": 0.2})
    words = dict(lattice_lines(ring, {"gamma": 0.2}))["linear"]
    assert "4 of 5 omega^2 are complex: it has no families; real part of a ring's bands" in words


def test_without_a_gauge_the_modes_of_a_long_lattice_show_its_generalised_brillouin_zone() -> None:
    """Two waves of the same size must meet the two ends: the middle roots of a polynomial written by hand."""
    bonds = [Bond("a", "a", (1,), "d", ("0.7", "1.3")), Bond("a", "a", (2,), "d", ("0.5", "0.2"))]
    lattice = Lattice(40, [Site("a", "4*y")], bonds)
    squares = lattice_modes(lattice).squares
    assert np.all(winding_numbers(lattice, squares) == 1)
    zone = brillouin_zone(lattice, squares)
    assert np.max(np.abs(zone[:, 1]) / np.abs(zone[:, 0])) < 1.01
    assert np.ptp(np.abs(zone)) > 0.2  # no circle
    by_hand = np.roots([-0.5, -0.7, 4 + 0.7 + 1.3 + 0.5 + 0.2 - squares[7], -1.3, -0.2])
    middle = np.sort_complex(by_hand[np.argsort(np.abs(by_hand))][1:3])  # of equal size, in either order
    assert np.sort_complex(zone[7]) == pytest.approx(middle, rel=1e-9)
    with pytest.raises(ValueError, match="lattice: given 2 dimensions; accepted: one"):
        winding_numbers(plane((3, 3)), [1.0])
    assert len(skin_figure(lattice).axes) == 2
