"""The linear tail of a long lattice of any cells joined by one bond, as a boundary condition of the nonlinear core.

With lambda = (k Omega)^2, let a cell of stiffness K be joined by bonds of strength s at its site o to the core's side
and at its site i to the far side. A matrix P takes the ratio of amplitudes across a bond from the far side of the cell
to its near side. With cofactors C_oo, C_oi, C_ii of K - lambda, its determinant D, and C_2 that without o and i,

    P = [[-s^2 C_2, s C_oo], [-s C_ii, D]],  det P = (s C_oi)^2,  trace P = 2 s C_oi cos(wave number).

All cells together are a power of it (Chebyshev), which is a fixed point of the ratio for infinitely many. The angle phi
of the ratio grows with lambda in all gaps, so that lambda may be read from it, also where an infinite tail pins lambda
to the edge of a band. The chain is the cell of one site: its ratio is sinh((c-1) kappa) / sinh(c kappa).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array

ComplexArray = NDArray[np.complex128]

COMPLEX_STEP = 1e-30  # imaginary: derivatives without subtraction
FARTHEST_FREQUENCY = 1e6  # of the highest edge: frequencies beyond are none
FAR_END_DECAY = 40.0  # cells times decay: beyond it the far end of the tail is not felt
UNSEEN_END_DECAY = 7.0  # cells times decay beyond which that is true to 1e-6 of the decay: for predictions
ROUND_OFF = 1e-14
LOBE_END_RTOL = 1e-12  # of the end of a lobe
AT_END = 1e-10  # angle that rounding leaves there


@dataclass(frozen=True)
class Edge:
    """An edge of a band: lambda there, and the sign that neighbouring cells have relative to each other."""

    square: float
    sign: float


@dataclass(frozen=True)
class Place:
    """Where a harmonic is: in the gap above `gap` bands, or at or in the band beside it, `off` from edge `edge`."""

    gap: int
    edge: int
    off: float


@dataclass(frozen=True, eq=False)
class CellTail:
    """A tail of alike cells in the gauge, with unit masses.

    Attributes:
        cells: their number, which may be infinite.
        stiffness: symmetric, of one cell, shape (sites, sites).
        coupling: s > 0 of the bonds that join cells.
        inlet, outlet: sites of a cell that are joined to the far side and to the core's side.
        wall: amplitude beyond the far end over that at its last site: 0 at a fixed wall.
    """

    cells: float
    stiffness: Array
    coupling: float
    inlet: int
    outlet: int
    wall: float = 0.0

    # Bands ------------------------------------------------------------------------------------------------------------

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """Edges of all bands, ascending."""
        found = []
        for sign in (1.0, -1.0):
            K = self.stiffness.copy()
            K[self.inlet, self.outlet] -= sign * self.coupling
            K[self.outlet, self.inlet] -= sign * self.coupling
            found += [Edge(float(square), sign) for square in np.linalg.eigvalsh(K)]
        return tuple(sorted(found, key=lambda edge: edge.square))

    def sides(self, gap: int) -> tuple[int | None, int | None]:
        """Numbers of the edges below and above a gap; None below the lowest band and above the highest."""
        last = len(self.edges) // 2
        return (2 * gap - 1 if gap else None), (2 * gap if gap < last else None)

    def place(self, square: float) -> Place:
        """Where a lambda is; raises ArithmeticError in a band."""
        squares = np.array([edge.square for edge in self.edges])
        below = int(np.searchsorted(squares, square))
        if below % 2:
            raise ArithmeticError("a harmonic lies in a band: the tail carries it away")
        edge = min((k for k in self.sides(below // 2) if k is not None), key=lambda k: abs(square - squares[k]))
        return Place(below // 2, edge, square - float(squares[edge]))

    # One harmonic -----------------------------------------------------------------------------------------------------

    @cached_property
    def _polynomials(self) -> list[tuple[list[float], ...]]:
        """Of each edge the coefficients of D, s C_oo, s C_ii, s C_oi, s^2 C_2, 2 s C_oi (cos - sign) in lambda off."""
        found, s, i, o = [], self.coupling, self.inlet, self.outlet
        rest = [n for n in range(len(self.stiffness)) if n not in (i, o)]
        for edge in self.edges:
            K = self.stiffness - edge.square * np.eye(len(self.stiffness))
            values, vectors = np.linalg.eigh(K)

            def product(roots: Any) -> Array:
                return np.asarray((-1.0) ** len(roots) * polynomial.polyfromroots(roots) if len(roots) else [1.0])

            others = [product(np.delete(values, n)) for n in range(len(values))]
            oo, ii, oi = (
                sum(vectors[a, n] * vectors[b, n] * others[n] for n in range(len(values)))
                for a, b in ((o, o), (i, i), (o, i))
            )
            D = product(values)
            C2 = product(np.linalg.eigvalsh(K[np.ix_(rest, rest)])) if i != o else np.zeros(1)
            beyond = polynomial.polysub(polynomial.polysub(D, s**2 * C2), 2.0 * edge.sign * s * oi)
            beyond[0] = 0.0  # at the edge
            found.append(tuple(p.tolist() for p in (D, s * oo, s * ii, s * oi, s**2 * C2, beyond)))
        return found

    def _vector(self, place: Place, off: Any) -> tuple[Any, Any]:
        """(amplitude across the bond, amplitude of the core's site), up to a factor."""
        D, oo, ii, oi, C2, beyond = (_value(p, off) for p in self._polynomials[place.edge])
        sign, c = self.edges[place.edge].sign, self.cells
        first, second = -C2 * self.wall + oo, -ii * self.wall + D  # P on the far wall
        half, at_edge = 0.5 * beyond, sign * oi  # P has half its trace at_edge + half
        square = half * (half + 2.0 * at_edge)  # of half the difference of its eigenvalues
        if np.real(square) >= 0.0:
            middle = at_edge + half
            root = np.sqrt(square)
            large = middle + (root if np.real(middle) >= 0.0 else -root)
            kappa = np.arcsinh(root / (oi if np.real(oi) > 0.0 else -oi)) if oi != 0.0 else np.inf
            if np.real(root) > 0.0 and not (
                np.isfinite(c) and c * np.real(kappa) < FAR_END_DECAY
            ):  # the far end is not felt
                one, other = (oo, large + C2), (large - D, -ii)
                return max(one, other, key=lambda v: abs(v[0]) + abs(v[1]))
            small = oi * oi / large
            if np.isfinite(c):
                at_rest = np.real(root) == 0.0
                ratio = (c - 1.0) / c if at_rest else np.expm1(-2.0 * (c - 1.0) * kappa) / np.expm1(-2.0 * c * kappa)
                small = small * ratio
            return first - small * self.wall, second - small
        if not np.isfinite(c):
            raise ArithmeticError("a harmonic lies in a band: the tail carries it away")
        theta = 2.0 * np.arcsin(np.sqrt(-0.5 * half / at_edge))
        near, far = np.sin(c * theta), np.sin((c - 1.0) * theta) * at_edge
        return near * first - far * self.wall, near * second - far

    def vector(self, place: Place) -> tuple[float, float]:
        """Amplitude across the bond and that of the core's site, up to a factor."""
        across, down = self._vector(place, place.off)
        return float(across), float(down)

    def end_unseen(self, place: Place) -> bool:
        """Whether the far end of the tail is not felt in predictions."""
        return not np.isfinite(self.cells) or self.cells * self.decay(place) > UNSEEN_END_DECAY

    def lobe(self, edge: int) -> float:
        """The change of lambda at an edge of a finite tail's band by which (cells times decay)^2 changes by 1."""
        _, _, _, oi, _, beyond = self._polynomials[edge]
        return abs(2.0 * oi[0] / beyond[1]) / self.cells**2

    def turns(self, edge: int, offs: Array, changes: ComplexArray, seen: bool) -> ComplexArray:
        """Changes of phi by complex changes of lambda from places beside an edge; shapes (places,), (any, places).

        Changes meet no edge of a band, but for that of the places where the far end of the tail is `seen`.
        """
        D, oo, ii, oi, C2, beyond = (_value(p, offs + _with_none(changes)) for p in self._polynomials[edge])
        half, at_edge = 0.5 * beyond, self.edges[edge].sign * oi
        if seen:
            kappa = 2.0 * np.arcsinh(np.sqrt(half / (2.0 * at_edge)))
            ratio = np.expm1(-2.0 * (self.cells - 1.0) * kappa) / np.expm1(-2.0 * self.cells * kappa)
            small = at_edge * np.exp(-kappa) * ratio
            return _turned(oo - (C2 + small) * self.wall, D - ii * self.wall - small)
        return self._turned_unseen(D, oo, ii, C2, half + at_edge, np.sqrt(half * (half + 2.0 * at_edge)))

    def turns_by_root(self, place: Place, changes: ComplexArray) -> ComplexArray:
        """The same by changes of the square root of the distance to the edge, which they may meet: no end is felt."""
        root = np.sqrt(abs(place.off)) + _with_none(changes[:, None])
        off, polynomials = self.side(place) * root**2, self._polynomials[place.edge]
        D, oo, ii, oi, C2, _ = (_value(p, off) for p in polynomials)
        slope, at_edge = 0.5 * _value(polynomials[-1][1:], off), self.edges[place.edge].sign * oi
        half = slope * off
        apart = root * np.sqrt(self.side(place) * slope * (half + 2.0 * at_edge))
        return self._turned_unseen(D, oo, ii, C2, half + at_edge, apart)[:, 0]

    def _turned_unseen(self, D: Any, oo: Any, ii: Any, C2: Any, middle: Any, apart: Any) -> ComplexArray:
        """Changes of phi from half the sum and half the difference of the eigenvalues of P."""
        large = middle + np.where(middle[0].real >= 0.0, 1.0, -1.0) * apart
        one, other = (oo + 0.0 * large, large + C2), (large - D, -ii + 0.0 * large)
        sizes = [np.abs(across[0]) + np.abs(down[0]) for across, down in (one, other)]
        first = sizes[0] >= sizes[1]
        return _turned(np.where(first, one[0], other[0]), np.where(first, one[1], other[1]))

    def side(self, place: Place) -> float:
        """1 where a place is above its edge of a band, -1 below it; at the edge by the gap that it belongs to."""
        return float(np.sign(place.off)) or (1.0 if place.edge % 2 else -1.0)

    def angle(self, place: Place) -> float:
        """phi, with tan(phi) the amplitude across the bond over that of the core's site; continuous about a gap."""
        below, above = self.sides(place.gap)
        reference = below if below is not None else above
        assert reference is not None
        if place.edge == reference and place.off == 0.0:
            return self._edge_angles[reference]
        start = self._edge_angles[reference]
        upwards = 1.0 if place.edge != reference or place.off > 0.0 else -1.0
        turn = float(np.mod(upwards * (np.arctan2(*self._vector(place, place.off)) - start), np.pi))
        return start + upwards * (0.0 if turn > np.pi - ROUND_OFF else turn)

    @cached_property
    def _edge_angles(self) -> list[float]:
        return [float(np.arctan2(*self._vector(Place(0, k, 0.0), 0.0))) for k in range(len(self.edges))]

    def slope(self, place: Place) -> float:
        """d phi / d lambda: infinite at the edge of an infinite tail's band."""
        off = place.off
        if off == 0.0:
            if not np.isfinite(self.cells):
                return float("inf")
            off = 1e-12 * abs(self.edges[place.edge].square) / self.cells**2
        step = COMPLEX_STEP * abs(off)
        across, down = self._vector(place, off + 1j * step)
        turn = down.real * across.imag - across.real * down.imag
        return float(turn / step / (across.real**2 + down.real**2))

    def transfer(self, edge: int) -> Array:
        """P at the edge of a band, up to a factor, shape (2, 2)."""
        D, oo, ii, _, C2, _ = (p[0] for p in self._polynomials[edge])
        return np.array([[-C2, oo], [-ii, D]])

    def squares(self, place: Place) -> float:
        """Sum of all amplitudes squared over across^2 + down^2 at the core's site; infinite where the tail is free."""
        return self.coupling * self.slope(place)

    def decay(self, place: Place) -> float:
        """Logarithm by which amplitudes fall from cell to cell, away from the core; 0 in a band."""
        _, _, _, oi, _, beyond = (_value(p, place.off) for p in self._polynomials[place.edge])
        half, at_edge = 0.5 * beyond, self.edges[place.edge].sign * oi
        square = half * (half + 2.0 * at_edge)
        if square <= 0.0:
            return 0.0
        return float(np.arcsinh(np.sqrt(square) / abs(oi))) if oi != 0.0 else float("inf")

    # From the angle to the frequency ----------------------------------------------------------------------------------

    def at_angle(self, gap: int, phi: float) -> Place:
        """Where the harmonic beside or in a gap is that has the angle phi; raises ArithmeticError for none."""
        below, above = self.sides(gap)
        for edge, direction in ((below, 1.0), (above, -1.0)):
            if edge is not None and direction * (phi - self.angle(Place(gap, edge, 0.0))) <= 0.0:
                return self._in_band(Place(gap, edge, 0.0), -direction, phi)
        edges = self.edges
        if below is not None and above is not None:
            middle = 0.5 * (edges[above].square - edges[below].square)
            if phi <= self.angle(Place(gap, below, middle)):
                return self._solved(Place(gap, below, 0.0), middle, phi)
            return self._solved(Place(gap, above, 0.0), -middle, phi)
        if above is not None:
            return self._solved(Place(gap, above, 0.0), -edges[above].square, phi)
        assert below is not None
        return self._solved(Place(gap, below, 0.0), FARTHEST_FREQUENCY * edges[below].square, phi)

    def _in_band(self, edge: Place, direction: float, phi: float) -> Place:
        """At the edge, or in the first lobe of a finite tail's waves."""
        end = self.end_of_lobe(edge, direction)
        return self._solved(edge, end.off, phi) if end.off else edge

    def end_of_lobe(self, edge: Place, direction: float) -> Place:
        """Where the first lobe of waves in the band above (1) or below (-1) an edge ends; an infinite tail has none."""
        if not np.isfinite(self.cells):
            return edge
        from scipy.optimize import brentq

        partner = edge.edge + int(direction)
        width = abs(self.edges[partner].square - self.edges[edge.edge].square)
        _, _, _, oi, _, beyond = self._polynomials[edge.edge]
        sign = self.edges[edge.edge].sign

        def phase(off: float) -> float:
            half_sine = -0.25 * sign * _value(beyond, off) / _value(oi, off)
            return 2.0 * float(np.arcsin(np.sqrt(np.clip(half_sine, 0.0, 1.0)))) - np.pi / self.cells

        end = float(brentq(lambda x: phase(direction * x), 0.0, width, xtol=1e-300, rtol=1e-15))
        return Place(edge.gap, edge.edge, direction * end * (1.0 - LOBE_END_RTOL))

    def _solved(self, edge: Place, farthest: float, phi: float) -> Place:
        """The place with the angle phi between an edge and the farthest offset from it."""
        from scipy.optimize import brentq

        def off(root: float) -> float:
            return float(np.sign(farthest)) * root * root

        def missing(root: float) -> float:
            return self.angle(Place(edge.gap, edge.edge, off(root))) - phi

        end = float(np.sqrt(abs(farthest)))
        first, last = missing(0.0), missing(end)
        if first * last > 0.0:
            if min(abs(first), abs(last)) > AT_END:
                raise ArithmeticError(f"no wave has the angle {phi:g}")
            return edge if abs(first) < abs(last) else Place(edge.gap, edge.edge, off(end))
        return Place(edge.gap, edge.edge, off(float(brentq(missing, 0.0, end, xtol=1e-300, rtol=1e-15))))

    def square(self, place: Place) -> float:
        """lambda of a place."""
        return self.edges[place.edge].square + place.off


def _with_none(changes: ComplexArray) -> ComplexArray:
    """Changes with no change as their first."""
    return np.concatenate([np.zeros((1, changes.shape[1])), changes])


def _turned(across: ComplexArray, down: ComplexArray) -> ComplexArray:
    """Changes of the angle of vectors from the first, which is left out."""
    turned = (across * down[0] - down * across[0]) / (down * down[0] + across * across[0])
    return np.asarray(np.arctan(turned[1:]))


def _value(coefficients: list[float], off: Any) -> Any:
    """A polynomial at a number, real or complex."""
    total = 0.0
    for coefficient in reversed(coefficients):
        total = total * off + coefficient
    return total
