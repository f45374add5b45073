"""The linear tail of a long lattice of alike cells joined by one bond, as a boundary condition of its nonlinear core.

With lambda = (k Omega)^2, let a cell of stiffness K be joined by bonds of strength s at its site o to the core's side
and at its site i to the far side. A matrix P takes the amplitudes (across, down) of a bond, those of its site away from
the core and of its site towards it, to those of the bond one cell nearer to the core. With cofactors C_oo, C_oi, C_ii
of K - lambda, its determinant D, and C_2 that without o and i,

    P = [[-s^2 C_2, s C_oo], [-s C_ii, D]] / (s C_oi),  det P = 1,  trace P = 2 cos(wave number).

All cells together are a power of it (Chebyshev), whose eigenvector is all that is left of infinitely many. The angle
phi with tan(phi) = across/down at the core grows with lambda, in gaps and, for each mode of the tail by pi, in bands:
lambda may be read from it, also where an infinite tail pins lambda to the edge of a band. The chain is the cell of one
site: its ratio is sinh(c kappa) / sinh((c + 1) kappa) for c cells.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array, Indices

ComplexArray = NDArray[np.complex128]

COMPLEX_STEP = 1e-30  # imaginary: derivatives without subtraction
FARTHEST_FREQUENCY = 1e6  # of the highest edge: frequencies beyond are none
FAR_END_DECAY = 40.0  # cells times decay: beyond it the far end of the tail is not felt
UNSEEN_END_DECAY = 7.0  # cells times decay beyond which that is true to 1e-6 of the decay: for predictions
BESIDE_EDGE = 1e-8  # of (cells times decay)^2, below which derivatives of its exponentials cancel
ROUND_OFF = 1e-14
AT_END = 1e-10  # angle that rounding leaves at an end of a gap
SAME_AS_FAR_MODE = 1e-13  # of amplitudes at the far wall: less is left of them at the frequency of a mode of that end


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
class Tail:
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
    inlet: int = 0
    outlet: int = 0
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

    def anywhere(self, square: float) -> Place:
        """Where a lambda is, in a gap or in a band, from the nearest edge of it."""
        squares = self._squares
        below = bisect_left(squares, square)
        near = [below - 1, below] if below % 2 else [k for k in self.sides(below // 2) if k is not None]
        edge = min(near, key=lambda k: abs(square - squares[k]))
        return Place((edge + 1) // 2, edge, square - squares[edge])

    @cached_property
    def _squares(self) -> list[float]:
        """lambda of all edges."""
        return [edge.square for edge in self.edges]

    def place(self, square: float) -> Place:
        """Where a lambda is; raises ArithmeticError in a band."""
        found = self.anywhere(square)
        if found.off * self.side(found) < 0.0:
            raise ArithmeticError("a harmonic lies in a band: the tail carries it away")
        return found

    def side(self, place: Place) -> float:
        """1 where the gap of a place is above its edge, -1 where it is below."""
        return 1.0 if place.edge % 2 else -1.0

    def in_band(self, place: Place) -> bool:
        """Whether a place is in the band or at its edge."""
        return place.off * self.side(place) <= 0.0

    def square(self, place: Place) -> float:
        """lambda of a place."""
        return self.edges[place.edge].square + place.off

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

    def _phase(self, half: Any, at_edge: Any) -> Any:
        """Wave number from that of the edge, in a band, from half the trace of P s C_oi beyond that at the edge."""
        functions = _functions_of(half)
        return 2.0 * functions.asin(functions.sqrt(-0.5 * half / at_edge))

    def _vector(self, place: Place, off: Any) -> tuple[Any, Any]:
        """(amplitude across the bond, amplitude of the core's site), up to a factor; in a band of any lobe."""
        D, oo, ii, oi, C2, beyond = (_value(p, off) for p in self._polynomials[place.edge])
        sign, c, functions = self.edges[place.edge].sign, self.cells, _functions_of(off)
        first, second = -C2 * self.wall + oo, -ii * self.wall + D  # P s C_oi on the far wall
        half, at_edge = 0.5 * beyond, sign * oi  # half the trace is at_edge + half
        if math.isfinite(c) and abs(2.0 * half / at_edge) * c**2 < BESIDE_EDGE:  # kappa^2 c^2: to its first power
            small = at_edge * (c - 1.0) / c * (1.0 - (2.0 * c - 1.0) / 3.0 * half / at_edge)
            return first - small * self.wall, second - small
        square = half * (half + 2.0 * at_edge)  # of half the difference of the eigenvalues
        if square.real >= 0.0:
            middle = at_edge + half
            root = functions.sqrt(square)
            large = middle + (root if middle.real >= 0.0 else -root)
            kappa = functions.asinh(root / (oi if oi.real > 0.0 else -oi)) if oi != 0.0 else math.inf
            if root.real > 0.0 and not (math.isfinite(c) and c * kappa.real < FAR_END_DECAY):  # its end is not felt
                one, other = (oo, large + C2), (large - D, -ii)
                return max(one, other, key=lambda v: abs(v[0]) + abs(v[1]))
            small = oi * oi / large
            if math.isfinite(c):
                small = small * _expm1(-2.0 * (c - 1.0) * kappa) / _expm1(-2.0 * c * kappa)
            return first - small * self.wall, second - small
        if not math.isfinite(c):
            raise ArithmeticError("a harmonic lies in a band: the tail carries it away")
        theta = self._phase(half, at_edge)
        inside = c * theta - math.pi * math.floor((c * theta).real / math.pi)  # of its lobe, from 0 to pi
        near, far = functions.sin(inside), functions.sin(inside - theta) * at_edge
        return near * first - far * self.wall, near * second - far

    def decay(self, place: Place) -> float:
        """Logarithm by which amplitudes fall from cell to cell, away from the core; 0 in a band."""
        *_, oi, _, beyond = self._polynomials[place.edge]
        at_edge, half = self.edges[place.edge].sign * _value(oi, place.off), 0.5 * _value(beyond, place.off)
        square = half * (half + 2.0 * at_edge)
        if square <= 0.0:
            return 0.0
        return math.asinh(math.sqrt(square) / abs(at_edge)) if at_edge != 0.0 else math.inf

    def angle(self, place: Place) -> float:
        """phi, with tan(phi) the amplitude across the bond over that of the core's site; continuous about a gap."""
        return self._angle(place, *self._vector(place, place.off)) if place.off else self._angle(place, 0.0, 1.0)

    def angle_and_slope(self, place: Place) -> tuple[float, float]:
        """phi and d phi / d lambda, which is infinite at the edge of an infinite tail's band."""
        if place.off == 0.0 and not math.isfinite(self.cells):
            return self.angle(place), math.inf
        step = COMPLEX_STEP * (abs(place.off) or self.lobe(place.edge))
        across, down = self._vector(place, complex(place.off, step))
        turn = down.real * across.imag - across.real * down.imag
        return self._angle(place, across.real, down.real), turn / step / (across.real**2 + down.real**2)

    def _angle(self, place: Place, across: float, down: float) -> float:
        """phi from a vector in its direction, which says nothing at an edge."""
        below, above = self._gap_angles(place.gap)
        start = below if place.edge % 2 else above
        if place.off == 0.0:
            return start
        turned = math.atan2(across, down)
        if not self.in_band(place):
            upwards = 1.0 if place.gap else -1.0
            turn = upwards * (turned - below) % math.pi
            return below + upwards * (0.0 if turn > math.pi - ROUND_OFF else turn)
        outwards, lobe = -self.side(place), self._lobe(place)
        if lobe:
            start += outwards * (self.first_turn(place.edge) + (lobe - 1) * math.pi)
            _, _, _, oi, _, _ = (_value(p, place.off) for p in self._polynomials[place.edge])
            sign = math.copysign(1.0, self.edges[place.edge].sign * oi)
            before = math.atan2(sign * self.wall, sign)
        else:
            before = self._edge_angles[place.edge]
        turn = outwards * (turned - before) % (2.0 * math.pi)
        return start + outwards * (0.0 if turn > 1.5 * math.pi else turn)

    def _lobe(self, place: Place) -> int:
        """Number of modes of a finite tail between an edge of a band and a place in it."""
        _, _, _, oi, _, beyond = (_value(p, place.off) for p in self._polynomials[place.edge])
        return math.floor(self.cells * float(self._phase(0.5 * beyond, self.edges[place.edge].sign * oi)) / math.pi)

    def first_turn(self, edge: int) -> float:
        """The change of phi in the first lobe of a band from an edge of it."""
        outwards, oi = 1.0 if edge % 2 == 0 else -1.0, self._polynomials[edge][3][0]
        sign = -math.copysign(1.0, self.edges[edge].sign * oi)
        return outwards * (math.atan2(sign * self.wall, sign) - self._edge_angles[edge]) % (2.0 * math.pi)

    @cached_property
    def _edge_angles(self) -> list[float]:
        """Directions of the vectors at the edges."""
        return [float(np.arctan2(*self._vector(Place(0, k, 0.0), 0.0))) for k in range(len(self.edges))]

    def _gap_angles(self, gap: int) -> tuple[float, float]:
        """phi at the edges below and above a gap; the same for both where there is one alone."""
        below, above = self.sides(gap)
        start = self._edge_angles[above if below is None else below]  # type: ignore[index]
        if below is None or above is None:
            return start, start
        return start, start + (self._edge_angles[above] - start) % math.pi

    def slope(self, place: Place) -> float:
        """d phi / d lambda: infinite at the edge of an infinite tail's band."""
        return self.angle_and_slope(place)[1]

    def squares(self, place: Place) -> float:
        """Sum of all amplitudes squared over across^2 + down^2 at the core's site; infinite where the tail is free."""
        return self.coupling * self.slope(place)

    # From the angle to the frequency ----------------------------------------------------------------------------------

    def at_angle(self, gap: int, phi: float) -> Place:
        """Where the harmonic beside or in a gap is that has the angle phi; raises ArithmeticError for none."""
        for edge in self.sides(gap):
            if edge is not None:
                outwards = 1.0 if edge % 2 == 0 else -1.0
                turn = outwards * (phi - self.angle(Place(gap, edge, 0.0)))
                if turn >= 0.0:
                    return self._in_band(Place(gap, edge, 0.0), turn, phi)
        below, above = self.sides(gap)
        if below is not None and above is not None:
            middle = 0.5 * (self.edges[above].square - self.edges[below].square)
            lower = phi <= self.angle(Place(gap, below, middle))
            edge, width = (below, middle) if lower else (above, -middle)
            return self.solved(Place(gap, edge, 0.0), width, self.angle, phi)
        alone = above if below is None else below
        assert alone is not None
        farthest = -1.0 if below is None else FARTHEST_FREQUENCY
        return self.solved(Place(gap, alone, 0.0), farthest * self.edges[alone].square, self.angle, phi)

    def _in_band(self, edge: Place, turn: float, phi: float) -> Place:
        """At the edge of a band, or in a lobe of a finite tail's waves in it."""
        if not np.isfinite(self.cells):
            return edge
        first = self.first_turn(edge.edge)
        lobe = 0 if turn <= first else 1 + math.floor((turn - first) / math.pi)
        if lobe >= self.cells:
            raise ArithmeticError(f"no wave has the angle {phi:g}")
        low, high = (self.off_at_phase(edge.edge, k * math.pi / self.cells) for k in (lobe, lobe + 1))
        return self.solved(edge, high, self.angle, phi, low)

    def off_at_phase(self, edge: int, theta: float) -> float:
        """How far in lambda a wave in a band is from an edge by its wave number from that of the edge."""
        inwards = 1.0 if edge % 2 == 0 else -1.0
        if len(self.stiffness) == 1:
            return inwards * 4.0 * self.coupling * math.sin(0.5 * theta) ** 2
        from scipy.optimize import brentq

        width = abs(self.edges[edge + int(inwards)].square - self.edges[edge].square)
        *_, oi, _, beyond = self._polynomials[edge]
        sign = self.edges[edge].sign

        def missing(off: float) -> float:
            off *= inwards
            half_sine = -0.25 * sign * _value(beyond, off) / _value(oi, off)
            return 2.0 * math.asin(math.sqrt(min(max(half_sine, 0.0), 1.0))) - theta

        return inwards * (width if theta >= math.pi else float(brentq(missing, 0.0, width, xtol=1e-300, rtol=1e-15)))

    def solved(
        self, edge: Place, farthest: float, angle: Callable[[Place], float], phi: float, nearest: float = 0.0
    ) -> Place:
        """The place with the angle phi between two offsets from an edge; raises ArithmeticError for none."""
        from scipy.optimize import brentq

        def place(root: float) -> Place:
            return Place(edge.gap, edge.edge, math.copysign(root * root, farthest) if root else 0.0)

        ends = [math.sqrt(abs(off)) for off in (nearest, farthest)]
        first, last = (angle(place(end)) - phi for end in ends)
        if first * last > 0.0:
            if min(abs(first), abs(last)) > AT_END:
                raise ArithmeticError(f"no wave has the angle {phi:g}")
            return place(ends[0] if abs(first) < abs(last) else ends[1])
        return place(float(brentq(lambda root: angle(place(root)) - phi, ends[0], ends[1], xtol=1e-300, rtol=1e-15)))

    # Amplitudes in the tail -------------------------------------------------------------------------------------------

    def motion(self, place: Place, phi: float, numbers: Indices) -> tuple[Array, Array]:
        """Amplitudes of a harmonic in cells of the tail where those of its bond to the core are sin(phi), cos(phi).

        Arguments:
            place: of the harmonic.
            phi: its angle, which an infinite tail does not determine where it is pinned.
            numbers: of cells, from 1 on beside the core.

        Returns:
            Logarithms of a factor a cell, shape (cells,), and the amplitudes over it, shape (cells, sites).
        """
        D, oo, ii, oi, C2, beyond = (_value(p, place.off) for p in self._polynomials[place.edge])
        P, c, n = np.array([[-C2, oo], [-ii, D]]) / oi, self.cells, np.asarray(numbers, dtype=float)
        half, at_edge, wall = 0.5 * beyond, self.edges[place.edge].sign * oi, np.array([self.wall, 1.0])
        sign, kappa = math.copysign(1.0, (half + at_edge) / oi), self.decay(place)
        bonds = np.stack([n - 1.0, n])  # the outlet is across the first, the inlet down the second
        start = np.array([math.sin(phi), math.cos(phi)])
        if not np.isfinite(c):  # at the edge of a band no wave decays, and amplitudes are linear in the distance
            ends = start[:, None] - (bonds * (sign * P @ start - start)[:, None] if kappa == 0.0 else 0.0 * bonds)
        else:
            sign = sign if kappa > 0.0 else self.edges[place.edge].sign

            def sines(cells: Array | float) -> Any:
                if kappa > 0.0:
                    return -np.expm1(-2.0 * cells * kappa)
                theta = float(self._phase(half, at_edge)) if place.off else 0.0
                return np.sin(cells * theta) if theta else np.asarray(cells, dtype=float)

            def far(cells: Array | float, row: int) -> Any:
                return sines(cells) * (P @ wall)[row] - sign * math.exp(-kappa) * sines(cells - 1.0) * wall[row]

            size = far(c, 0) * start[0] + far(c, 1) * start[1]
            ends = np.stack([far(c - bonds[row], row) for row in (0, 1)])
            # Where the far end is not felt the wave is that of an endless tail. A mode of the far end may have the same
            # frequency: then the amplitudes from its wall are rounding.
            unseen = (c - bonds) * kappa > FAR_END_DECAY
            resonates = abs(size) <= SAME_AS_FAR_MODE * (np.linalg.norm(P @ wall) + np.linalg.norm(wall))
            ends = np.where(unseen | resonates, start[:, None], ends / size if size else ends)
        ends = ends * sign**bonds * np.array([[math.exp(kappa)], [1.0]])  # all over exp(-kappa n)
        found, i, o = np.empty((n.size, len(self.stiffness))), self.inlet, self.outlet
        found[:, o], found[:, i] = ends
        rest = [k for k in range(len(self.stiffness)) if k not in (i, o)]
        if rest:
            joined = sorted({i, o})
            inner = self.stiffness[np.ix_(rest, rest)] - self.square(place) * np.eye(len(rest))
            found[:, rest] = np.linalg.lstsq(inner, -self.stiffness[np.ix_(rest, joined)] @ found[:, joined].T)[0].T
        return -kappa * n, found

    # Changes by complex frequencies, for power series -----------------------------------------------------------------

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


def _with_none(changes: ComplexArray) -> ComplexArray:
    """Changes with no change as their first."""
    return np.concatenate([np.zeros((1, changes.shape[1])), changes])


def _turned(across: ComplexArray, down: ComplexArray) -> ComplexArray:
    """Changes of the angle of vectors from the first, which is left out."""
    turned = (across * down[0] - down * across[0]) / (down * down[0] + across * across[0])
    return np.asarray(np.arctan(turned[1:]))


def _functions_of(number: Any) -> Any:
    """Functions of a number, complex or not: those of numpy take ten times as long for one."""
    return cmath if isinstance(number, complex) else math


def _expm1(number: Any) -> Any:
    """exp(number) - 1; of a complex number for a step whose square is none."""
    if isinstance(number, complex):
        return complex(math.expm1(number.real), math.exp(number.real) * number.imag)
    return math.expm1(number)


def _value(coefficients: list[float], off: Any) -> Any:
    """A polynomial at a number, real or complex."""
    total = 0.0
    for coefficient in reversed(coefficients):
        total = total * off + coefficient
    return total
