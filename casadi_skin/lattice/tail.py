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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array, Indices

ComplexArray = NDArray[np.complex128]

COMPLEX_STEP = 1e-30  # imaginary: derivatives without subtraction
FARTHEST_FREQUENCY = 1e6  # of the highest edge: frequencies beyond are none
FAR_END_DECAY = 40.0  # cells times decay: beyond it the far end of the tail is not felt
UNSEEN_END_DECAY = 7.0  # cells times decay beyond which that is true to 1e-6 of the decay: for predictions
BESIDE_EDGE = 1e-8  # of (cells times decay)^2, below which derivatives of its exponentials cancel
ROUND_OFF = 1e-14
WITHIN_BAND = 1.0 - 1e-12  # of the width of a band: short of its other edge
AT_BAND_EDGE = 1e-13  # of the cosine of the wave number: nearer to 1 or -1 a frequency is at the edge of a band
AT_END = 1e-10  # angle that rounding leaves at an end of a gap
SAME_AS_FAR_MODE = 1e-13  # of amplitudes at the far wall: less is left of them at the frequency of a mode of that end


@dataclass(frozen=True)
class Place:
    """Where a harmonic is: `off` in lambda from an edge of a band, counted from 0, in the gap beside it or the band."""

    edge: int
    off: float = 0.0

    @property
    def gap(self) -> int:
        """Number of bands below the gap."""
        return (self.edge + 1) // 2

    @property
    def side(self) -> float:
        """1 where the gap is above the edge, -1 where it is below."""
        return 1.0 if self.edge % 2 else -1.0

    @property
    def in_band(self) -> bool:
        """Whether this is in the band or at its edge."""
        return self.off * self.side <= 0.0


class End(NamedTuple):
    """An end of a gap: the harmonic that meets an edge of a band there, and an angle there that grows with lambda."""

    harmonic: int
    edge: Place
    angle: float


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
    def _edges(self) -> list[tuple[float, float]]:
        """lambda at the edges of all bands, ascending, with the sign of neighbouring cells relative to each other."""
        found = []
        for sign in (1.0, -1.0):
            K = self.stiffness.copy()
            K[self.inlet, self.outlet] -= sign * self.coupling
            K[self.outlet, self.inlet] -= sign * self.coupling
            found += [(square, sign) for square in np.linalg.eigvalsh(K).tolist()]
        return sorted(found, key=lambda edge: edge[0])

    @cached_property
    def edges(self) -> tuple[float, ...]:
        """lambda at the edges of all bands, ascending."""
        return tuple(square for square, _ in self._edges)

    @cached_property
    def signs(self) -> tuple[float, ...]:
        """The signs that neighbouring cells have there relative to each other."""
        return tuple(sign for _, sign in self._edges)

    def width(self, place: Place) -> float:
        """Width in lambda of the band at the edge of a place."""
        return abs(self.edges[place.edge] - self.edges[place.edge - int(place.side)])

    def sides(self, gap: int) -> tuple[Place | None, Place | None]:
        """The edges below and above a gap; None below the lowest band and above the highest."""
        last = len(self.edges) // 2
        return (Place(2 * gap - 1) if gap else None), (Place(2 * gap) if gap < last else None)

    def anywhere(self, square: float) -> Place:
        """Where a lambda is, in a gap or in a band, from the nearest edge of it."""
        below = bisect_left(self.edges, square)
        near = (k for k in (below - 1, below) if 0 <= k < len(self.edges))
        edge = min(near, key=lambda k: abs(square - self.edges[k]))
        return Place(edge, square - self.edges[edge])

    def place(self, square: float) -> Place:
        """Where a lambda is; raises ArithmeticError in a band."""
        found = self.anywhere(square)
        if found.off * found.side < 0.0:
            raise ArithmeticError("a harmonic lies in a band: the tail carries it away")
        return found

    def square(self, place: Place) -> float:
        """lambda of a place."""
        return self.edges[place.edge] + place.off

    # One harmonic -----------------------------------------------------------------------------------------------------

    @cached_property
    def _spectral(self) -> tuple[list[float], list[float], list[list[float]]]:
        """Eigenvalues of a cell, those without o and i, and of each eigenvector the products for s C_oo, C_ii, C_oi."""
        values, vectors = np.linalg.eigh(self.stiffness)
        o, i = vectors[self.outlet], vectors[self.inlet]
        rest = np.delete(np.arange(len(values)), [self.inlet, self.outlet])
        without = np.linalg.eigvalsh(self.stiffness[np.ix_(rest, rest)]).tolist() if rest.size else []
        return values.tolist(), without, (self.coupling * np.stack([o * o, i * i, o * i], axis=1)).tolist()

    def cofactors(self, square: Any, off: Any = 0.0) -> tuple[Any, Any, Any, Any, Any]:
        """D, s C_oo, s C_ii, s C_oi and s^2 C_2 where lambda is `off` from a square, each a number or an array."""
        values, rest, weights = self._spectral
        apart, oo, ii, oi = [value - square - off for value in values], 0.0, 0.0, 0.0
        for n, (of_oo, of_ii, of_oi) in enumerate(weights):
            others = math.prod(apart[:n] + apart[n + 1 :])
            oo, ii, oi = oo + of_oo * others, ii + of_ii * others, oi + of_oi * others
        if self.inlet == self.outlet:
            return math.prod(apart), oo, ii, oi, 0.0
        return math.prod(apart), oo, ii, oi, self.coupling**2 * math.prod([value - square - off for value in rest])

    @cached_property
    def _apart(self) -> list[list[float]]:
        """Of each edge the distances in lambda to the others of its sign."""
        return [[square - at for k, (square, s) in enumerate(self._edges) if s == sign and k != edge]
                for edge, (at, sign) in enumerate(self._edges)]  # fmt: skip

    def _slope(self, edge: int, off: Any) -> Any:
        """2 s C_oi (cosine of the wave number - that at an edge), over lambda off: it vanishes at edges of one sign."""
        return -math.prod([distance - off for distance in self._apart[edge]])

    def _trace(self, place: Place) -> tuple[Any, Any]:
        """Half the trace of P s C_oi with the cosine of the edge's wave number, and what is beyond that."""
        oi = self.cofactors(self.edges[place.edge], place.off)[3]
        return self.signs[place.edge] * oi, 0.5 * place.off * self._slope(place.edge, place.off)

    @staticmethod
    def _phase(at_edge: Any, half: Any) -> Any:
        """Wave number from that of the edge, in a band, from both parts of the trace."""
        functions = _functions_of(half)
        return 2.0 * functions.asin(functions.sqrt(-0.5 * half / at_edge))

    def _vector(self, place: Place, off: Any) -> tuple[Any, Any]:
        """(amplitude across the bond, amplitude of the core's site), up to a factor; in a band of any lobe."""
        D, oo, ii, oi, C2 = self.cofactors(self.edges[place.edge], off)
        sign, c, functions = self.signs[place.edge], self.cells, _functions_of(off)
        first, second = -C2 * self.wall + oo, -ii * self.wall + D  # P s C_oi on the far wall
        half, at_edge = 0.5 * off * self._slope(place.edge, off), sign * oi  # half the trace is their sum
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
        theta = self._phase(at_edge, half)
        inside = c * theta - math.pi * math.floor((c * theta).real / math.pi)  # of its lobe, from 0 to pi
        near, far = functions.sin(inside), functions.sin(inside - theta) * at_edge
        return near * first - far * self.wall, near * second - far

    def decay(self, place: Place) -> float:
        """Logarithm by which amplitudes fall from cell to cell, away from the core; 0 in a band."""
        at_edge, half = self._trace(place)
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
        below, above = self._gap_angles[place.gap]
        start = below if place.edge % 2 else above
        if place.off == 0.0:
            return start
        turned = math.atan2(across, down)
        if not place.in_band:
            upwards = 1.0 if place.gap else -1.0
            turn = upwards * (turned - below) % math.pi
            return below + upwards * (0.0 if turn > math.pi - ROUND_OFF else turn)
        outwards, lobe = -place.side, self._lobe(place)
        if lobe:
            start += outwards * (self.first_turn(place.edge) + (lobe - 1) * math.pi)
            sign = math.copysign(1.0, self._trace(place)[0])
            before = math.atan2(sign * self.wall, sign)
        else:
            before = self._edge_angles[place.edge]
        turn = outwards * (turned - before) % (2.0 * math.pi)
        return start + outwards * (0.0 if turn > 1.5 * math.pi else turn)

    def _lobe(self, place: Place) -> int:
        """Number of modes of a finite tail between an edge of a band and a place in it."""
        return math.floor(self.cells * float(self._phase(*self._trace(place))) / math.pi)

    def first_turn(self, edge: int) -> float:
        """The change of phi in the first lobe of a band from an edge of it."""
        outwards, sign = -Place(edge).side, -math.copysign(1.0, self._trace(Place(edge))[0])
        return outwards * (math.atan2(sign * self.wall, sign) - self._edge_angles[edge]) % (2.0 * math.pi)

    @cached_property
    def _edge_angles(self) -> list[float]:
        """Directions of the vectors at the edges."""
        return [float(np.arctan2(*self._vector(Place(k), 0.0))) for k in range(len(self.edges))]

    @cached_property
    def _gap_angles(self) -> list[tuple[float, float]]:
        """phi at the edges below and above each gap; the same for both where there is one alone."""
        found = []
        for gap in range(len(self.edges) // 2 + 1):
            first, *others = (self._edge_angles[edge.edge] for edge in self.sides(gap) if edge is not None)
            found.append((first, first + (others[0] - first) % math.pi if others else first))
        return found

    def slope(self, place: Place) -> float:
        """d phi / d lambda: infinite at the edge of an infinite tail's band."""
        return self.angle_and_slope(place)[1]

    def squares(self, place: Place) -> float:
        """Sum of all amplitudes squared over across^2 + down^2 at the core's site; infinite where the tail is free."""
        return self.coupling * self.slope(place)

    # From the angle to the frequency ----------------------------------------------------------------------------------

    def at_angle(self, gap: int, phi: float) -> Place:
        """Where the harmonic beside or in a gap is that has the angle phi; raises ArithmeticError for none."""
        ends = [None if edge is None else End(1, edge, self.angle(edge)) for edge in self.sides(gap)]
        return self.resolved(ends, lambda _, place: self.angle(place), phi)[1]

    def resolved(
        self, ends: Sequence[End | None], angle: Callable[[int, Place], float], value: float
    ) -> tuple[int, Place]:
        """Where an angle has a value: in a gap, at the edge of an infinite tail's band, or in a finite tail's band.

        Arguments:
            ends: the lower and the upper one of the gap; None for one that is absent.
            angle: function of a harmonic and its place, monotone in the gap and in bands.
            value: of the angle.

        Returns:
            The harmonic of the nearer end, and its place; raises ArithmeticError for none.
        """
        lower, upper = ends
        for end in ends:
            if end is not None and (turn := end.edge.side * (end.angle - value)) >= 0.0:
                if not np.isfinite(self.cells):
                    return end.harmonic, end.edge
                side, edge = end.edge.side, end.edge.edge
                farthest = -side * WITHIN_BAND * self.width(end.edge)
                lobes = -side * self.lobe(edge) * (turn + 2.0 * math.pi) ** 2  # near the edge
                if abs(lobes) < abs(farthest) and side * (end.angle - angle(end.harmonic, Place(edge, lobes))) >= turn:
                    farthest = lobes
                return end.harmonic, self._solved(end, farthest, angle, value)
        end = lower or upper
        assert end is not None
        farthest = FARTHEST_FREQUENCY if end is lower else -1.0
        farthest *= self.square(end.edge)
        if lower is not None and upper is not None:
            middle = 0.5 * (self.square(lower.edge) / lower.harmonic**2 + self.square(upper.edge) / upper.harmonic**2)
            end = lower if value <= angle(1, self.place(middle)) else upper
            farthest = end.harmonic**2 * middle - self.square(end.edge)
        return end.harmonic, self._solved(end, farthest, angle, value)

    def _solved(self, end: End, farthest: float, angle: Callable[[int, Place], float], value: float) -> Place:
        """The place between an end of a gap and an offset from it; raises ArithmeticError for none."""
        from scipy.optimize import brentq

        def missing(root: float) -> float:
            return angle(end.harmonic, place(root)) - value

        def place(root: float) -> Place:
            return Place(end.edge.edge, math.copysign(root * root, farthest) if root else 0.0)

        far = math.sqrt(abs(farthest))
        try:
            return place(float(brentq(missing, 0.0, far, xtol=1e-300, rtol=1e-15)))
        except ValueError:  # it has one sign between the ends
            first, last = (abs(missing(root)) for root in (0.0, far))
            if not min(first, last) <= AT_END:
                raise ArithmeticError(f"no wave has the angle {value:g}") from None
            return place(0.0 if first < last else far)

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
        D, oo, ii, oi, C2 = self.cofactors(self.edges[place.edge], place.off)
        P, c, n = np.array([[-C2, oo], [-ii, D]]) / oi, self.cells, np.asarray(numbers, dtype=float)
        wall, kappa = np.array([self.wall, 1.0]), self.decay(place)
        sign = math.copysign(1.0, sum(self._trace(place)) / oi)
        bonds = np.stack([n - 1.0, n])  # the outlet is across the first, the inlet down the second
        start = np.array([math.sin(phi), math.cos(phi)])
        if not np.isfinite(c):  # at the edge of a band no wave decays, and amplitudes are linear in the distance
            ends = start[:, None] - (bonds * (sign * P @ start - start)[:, None] if kappa == 0.0 else 0.0 * bonds)
        else:
            sign = sign if kappa > 0.0 else self.signs[place.edge]

            def sines(cells: Array | float) -> Any:
                if kappa > 0.0:
                    return -np.expm1(-2.0 * cells * kappa)
                theta = float(self._phase(*self._trace(place))) if place.off else 0.0
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

    def motions(self, places: Sequence[Place], phi: Array, sizes: Array, numbers: Indices) -> tuple[Array, Array]:
        """The same of harmonics by their amplitudes `sizes` at the core's site.

        Returns:
            Logarithms of a factor, shape (harmonics, cells), and the amplitudes over it, (harmonics, cells, sites).
        """
        found = [self.motion(place, angle, numbers) for place, angle in zip(places, phi, strict=True)]
        parts = (sizes / np.cos(phi))[:, None, None] * np.stack([part for _, part in found])
        return np.stack([logs for logs, _ in found]), parts

    # Changes by complex frequencies, for power series -----------------------------------------------------------------

    def end_unseen(self, place: Place) -> bool:
        """Whether the far end of the tail is not felt in predictions."""
        return not np.isfinite(self.cells) or self.cells * self.decay(place) > UNSEEN_END_DECAY

    def lobe(self, edge: int) -> float:
        """The change of lambda at an edge of a finite tail's band by which (cells times decay)^2 changes by 1."""
        return float(abs(2.0 * self._trace(Place(edge))[0] / self._slope(edge, 0.0))) / self.cells**2

    def turns(self, places: Sequence[Place], roots: ComplexArray, seen: NDArray[np.bool_]) -> ComplexArray:
        """Changes of phi from the first to other distances from an edge, for each of some places.

        Arguments:
            places: beside their edges.
            roots: of the distance into the gap, complex, shape (any, places). They change their sign round an edge.
            seen: whether the far end of the tail is felt there. Else the tail is taken for one without end.
        """
        edges, sides = [place.edge for place in places], np.array([place.side for place in places])
        off = sides * roots**2
        D, oo, ii, oi, C2 = np.broadcast_arrays(*self.cofactors(np.array(self.edges)[edges], off))
        slope = np.array([self._slope(edge, off[:, h]) for h, edge in enumerate(edges)]).T
        at_edge = np.array(self.signs)[edges] * oi
        kappa = 2.0 * np.arcsinh(roots * np.sqrt(0.25 * sides * slope / at_edge))
        small = at_edge * np.exp(-kappa)
        if seen.any():
            ratio = np.expm1(-2.0 * (self.cells - 1.0) * kappa) / np.expm1(-2.0 * self.cells * kappa)
            small = np.where(seen, ratio, 1.0) * small
        first, second = (-C2 - small, -ii), (oo, D - small)  # columns of P without the part that decays inwards
        larger = np.abs(first[0][0]) + np.abs(first[1][0]) > np.abs(second[0][0]) + np.abs(second[1][0])
        a, b = np.where(seen, self.wall, larger), np.where(seen, 1.0, ~larger)
        across, down = (a * one + b * other for one, other in zip(first, second, strict=True))
        turned = (across * down[0] - down * across[0]) / (down * down[0] + across * across[0])
        return np.asarray(np.arctan(turned[1:]))

    # The answer to any frequency --------------------------------------------------------------------------------------

    @cached_property
    def bound(self) -> Array:
        """lambda of states bound at the end of an infinite tail: where it answers without limit."""
        kept = np.delete(np.arange(len(self.stiffness)), self.inlet)  # the inlet is at rest in such a state
        squares = np.linalg.eigvalsh(self.stiffness[np.ix_(kept, kept)]) if kept.size else np.empty(0)
        D, _, _, oi, _ = self.cofactors(squares)
        return np.asarray(squares[np.abs(D) < np.abs(oi)])

    def cosine(self, square: Any) -> Any:
        """The cosine of the wave number at values of lambda: within -1 and 1 in the bands."""
        D, _, _, oi, C2 = self.cofactors(square)
        return (D - C2) / (2.0 * oi)

    def answers(self, frequency: Any) -> tuple[Any, Any, Any]:
        """The answer of an infinite tail to each frequency, to real ones the limit from above.

        Returns:
            The factor of amplitudes from cell to cell; the response at the outlet of the first cell to a force there;
            and the determinant of a cell with the rest of the tail behind it, which is nowhere zero.
        """
        square = np.asarray(frequency) ** 2
        (D, oo, _, oi, _), C = self.cofactors(square), self.cosine(square)
        beta = _beyond(C) if np.iscomplexobj(square) else self._on_axis(C, square, np.asarray(frequency))
        return beta, oo / self.coupling / (D - oi * beta), oi / beta

    def _on_axis(self, C: Array, square: Array, frequency: Array) -> Any:
        C = np.where(np.abs(np.abs(C) - 1.0) <= AT_BAND_EDGE, np.sign(C), C)
        root, inside = np.sqrt(np.abs(C * C - 1.0)), np.abs(C) < 1.0
        decays = 1.0 / (C + np.where(C >= 0.0, root, -root))
        if not inside.any():
            return decays
        slope = np.imag(self.cosine(square + 1j * COMPLEX_STEP * np.maximum(np.abs(square), 1.0)))
        return np.where(inside, C - 1j * np.sign(slope * frequency) * root, decays)


def _beyond(C: Any) -> Any:
    """The factor of waves that decay, from the cosine of a complex wave number."""
    root = np.sqrt(C - 1.0) * np.sqrt(C + 1.0)
    return 1.0 / np.where(np.abs(C + root) >= np.abs(C - root), C + root, C - root)


def _functions_of(number: Any) -> Any:
    """Functions of a number, complex or not: those of numpy take ten times as long for one."""
    return cmath if isinstance(number, complex) else math


def _expm1(number: Any) -> Any:
    """exp(number) - 1; of a complex number for a step whose square is none."""
    if isinstance(number, complex):
        return complex(math.expm1(number.real), math.exp(number.real) * number.imag)
    return math.expm1(number)
