"""Power series, in the unknown u in place of Omega, of what the core of a long lattice needs of its tail.

All of it is an analytic function of the frequency, in closed form for complex frequencies too. So the coefficients are
integrals over a circle about the place of one harmonic, by the trapezoidal rule; the same integrals invert u
(Lagrange's theorem; Lyness and Moler 1967 for derivatives by such sums).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from casadi_skin.lattice.tail import ComplexArray, Place, Tail
from casadi_skin.native import TAIL, Structure
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.problem import Array, Indices, SingularError, Solve
from casadi_skin.zero.recursion import CosineUnknowns, PolynomialForm, TaylorRecursion

CIRCLE_NODES = 64  # of the circle
CIRCLE_RADIUS_RATIO = 0.5  # of the distance to the next edge of a band that the circle may have
LOBE_CHANGE = 2.0  # of (cells times decay)^2, which waves of the far end change by
CIRCLE_HALVINGS = 40  # of the circle, until no singularity lies within
NEGATIVE_POWER_RATIO = 1e-7  # of the largest coefficient: those of negative powers, which a singularity within has
ENDLESS_CELLS = 8000.0  # cells from which on waves of the far end move Omega by less than the precision of a prediction
BAND_EDGE_RTOL = 1e-8  # of a band's width: how far Omega may leave its edge before a prediction needs it


@dataclass(frozen=True)
class TailSeries:
    """Coefficients by powers of u from its value: of Omega, and by harmonic of the sine and cosine of the angle phi.

    Shapes are (orders + 1,) and (orders + 1, harmonics). They hold up to u = `end` where that is a number: functions of
    an endless tail are not analytic where a harmonic leaves an edge of a band.
    """

    Omega: Array
    across: Array
    down: Array
    end: float = np.nan


@dataclass(frozen=True)
class Harmonics:
    """Places and angles phi of all odd harmonics; place number `resolved` is known best.

    u grows by the sum of the changes of the angles times `in_u`.
    """

    tail: Tail
    places: Sequence[Place]
    phi: Array
    resolved: int
    in_u: Array

    def series(self, orders: int) -> TailSeries:
        """The series by changes of u, as is `end`; raises ArithmeticError where no circle has no singularity within."""
        place, tail = self.places[self.resolved], self.tail
        k2 = np.asarray((2.0 * np.arange(self.phi.size) + 1.0) ** 2, dtype=np.float64)
        squared = tail.square(place) / k2[self.resolved]
        if self._is_pinned(place):
            return self._pinned(place, squared, orders)
        by_root = tail.end_unseen(place)
        radius, root = self._widest(place, k2, by_root), float(np.sqrt(abs(place.off)))
        for _ in range(CIRCLE_HALVINGS):
            zeta = radius * np.exp(2j * np.pi * np.arange(CIRCLE_NODES // 2 + 1) / CIRCLE_NODES)
            change = (tail.side(place) * zeta * (2.0 * root + zeta) if by_root else zeta) / k2[self.resolved]
            turns = np.empty((zeta.size, self.phi.size), dtype=complex)
            for (edge, seen), these in self._alike.items():
                offs = np.array([self.places[h].off for h in these])
                turns[:, these] = tail.turns(edge, offs, np.outer(change, k2[these]), seen)
            if by_root:
                turns[:, self.resolved] = tail.turns_by_root(place, zeta)
            found = self._integrals(turns, change, squared, orders)
            if found is not None:
                return found
            radius *= 0.5
        raise ArithmeticError("the tail has no power series there")

    @cached_property
    def _alike(self) -> dict[tuple[int, bool], list[int]]:
        """Harmonics by their edge and whether the far end of the tail is felt, but for one at a root of its own."""
        found: dict[tuple[int, bool], list[int]] = {}
        for h, place in enumerate(self.places):
            unseen = self.tail.end_unseen(place)
            if not (unseen and h == self.resolved):
                found.setdefault((place.edge, not unseen), []).append(h)
        return found

    def _is_pinned(self, place: Place) -> bool:
        """Whether the frequency hardly changes with u, as on an edge of an endless tail's band."""
        return self.tail.cells >= ENDLESS_CELLS and self.tail.decay(place) == 0.0

    def _pinned(self, place: Place, squared: float, orders: int) -> TailSeries:
        """The angle of the harmonic that is pinned changes alone."""
        h, k = self.resolved, np.arange(orders + 1)
        Omega, across, down = np.zeros(orders + 1), *np.zeros((2, orders + 1, self.phi.size))
        Omega[0], across[0], down[0] = np.sqrt(squared), np.sin(self.phi), np.cos(self.phi)
        rates = np.cumprod(np.append(1.0, 1.0 / (self.in_u[h] * k[1:])))  # of phi by u, and factorials
        across[:, h], down[:, h] = (rates * np.sin(self.phi[h] + (k + turn) * 0.5 * np.pi) for turn in (0, 1))
        endless, outwards = replace(self.tail, cells=np.inf), 1.0 if place.edge % 2 else -1.0
        width = self.tail.edges[place.edge].square - self.tail.edges[place.edge - int(outwards)].square
        turn = endless.angle(Place(place.gap, place.edge, outwards * BAND_EDGE_RTOL * abs(width))) - self.phi[h]
        return TailSeries(Omega, across, down, self.in_u[h] * (turn - np.pi * np.round(turn / np.pi)))

    def _widest(self, place: Place, k2: Array, by_root: bool) -> float:
        """The radius of a circle on which no harmonic meets an edge of a band, but for the one that is resolved."""
        reach = np.inf
        for h, at in enumerate(self.places):
            edges = [abs(self.tail.square(at) - edge.square) for k, edge in enumerate(self.tail.edges) if k != at.edge]
            if h != self.resolved:
                edges.append(abs(at.off))
            reach = min(reach, CIRCLE_RADIUS_RATIO * min(edges) * k2[self.resolved] / k2[h])
        if by_root:
            return float(reach / (np.sqrt(abs(place.off)) + np.sqrt(abs(place.off) + reach)))
        return float(min(reach, CIRCLE_RADIUS_RATIO * abs(place.off) + LOBE_CHANGE * self.tail.lobe(place.edge)))

    def _integrals(self, turns: ComplexArray, change: ComplexArray, squared: float, orders: int) -> TailSeries | None:
        """Coefficients from values on half of the circle; None where that is too wide."""
        w = turns @ self.in_u
        whole = np.concatenate([w, np.conj(w[-2:0:-1])])
        coefficients = np.fft.fft(whole).real / CIRCLE_NODES
        powers = np.fft.fftfreq(CIRCLE_NODES, 1.0 / CIRCLE_NODES)
        if not np.max(np.abs(coefficients[CIRCLE_NODES // 2 :])) <= NEGATIVE_POWER_RATIO * np.max(np.abs(coefficients)):
            return None
        slope = (CIRCLE_NODES * np.fft.ifft(powers * coefficients))[: w.size]
        weights = np.full(w.size, 2.0 / CIRCLE_NODES)
        weights[[0, -1]] = 1.0 / CIRCLE_NODES
        turning = weights * slope / w
        if not abs(np.sum(turning).real - 1.0) <= NEGATIVE_POWER_RATIO:
            return None
        inverse = turning[:, None] * np.cumprod(np.column_stack([np.ones_like(w), *[1.0 / w] * orders]), axis=1)
        values = np.column_stack([np.sqrt(squared + change), np.sin(self.phi + turns), np.cos(self.phi + turns)])
        found = (inverse.T @ values).real
        count = self.phi.size
        return TailSeries(found[:, 0], found[:, 1 : 1 + count], found[:, 1 + count :])


# Power series of a branch of a nonlinear core whose linear tail is eliminated, order by order -------------------------


class Series(Protocol):
    """A tail, as a power series of the unknown u in place of Omega."""

    @property
    def coupling(self) -> float: ...

    def series(self, u: float, orders: int) -> TailSeries: ...


class TailedCore(CosineUnknowns, Protocol):
    """A core by itself, and the balance of its site that is attached to a tail."""

    attached: int

    @property
    def core(self) -> CosineUnknowns: ...

    @property
    def tail(self) -> Series: ...

    @property
    def touched(self) -> Indices: ...

    @property
    def own_Omega(self) -> int: ...

    def attached_balance(self, own: Array) -> tuple[Array, Array, Array]: ...


class _Orders:
    """Orders of a branch in turn, with those of all that depends on it."""

    def __init__(self, problem: TailedCore, tail: TailSeries, z: Array) -> None:
        H, orders, place = problem.resolution, tail.Omega.size - 1, problem.Omega_index
        self._place, self._touched, self._own_Omega = place, problem.touched, problem.own_Omega
        self._first, self._rows = problem.attached * H, slice(problem.attached * H, (problem.attached + 1) * H)
        self._transform, self._bond = (2.0 / H) * cosine_matrix(H), problem.tail.coupling / tail.Omega[0] ** 2
        self._by_u = np.column_stack([tail.Omega, tail.across, tail.down])  # by powers of u
        self._along, self._powers = np.zeros(self._by_u.shape), np.zeros((orders + 1, orders + 1))
        self._across, self._down = self._along[:, 1 : 1 + H], self._along[:, 1 + H :]
        self.found, self._balance, self._site = (np.zeros((orders + 1, size)) for size in (problem.size, H, H))
        self.own = z.copy()  # of the core: Omega in the place of u
        self.own[place] = tail.Omega[0]
        self._along[0], self.found[0] = self._by_u[0], z
        self._balance[0], self._block, self._by_Omega = problem.attached_balance(self.own)
        self._site[0] = self._transform @ z[self._rows]

    def first(self, slope: Array) -> None:
        """The first order."""
        self._put(1, slope, np.zeros(self._by_u.shape[1]), np.zeros(self._transform.shape[0]))

    def solved(self, k: int, right: Array, solve: Solve) -> None:
        """Order k from the right-hand side of the core by itself."""
        H, u, powers = self._transform.shape[0], self._powers[1], self._powers
        powers[2 : k + 1, k] = powers[1:k, k - 1 : 0 : -1] @ u[1:k]
        without = powers[2 : k + 1, k] @ self._by_u[2 : k + 1]  # as if u had no part of order k
        known = self._block[:, self._own_Omega] * without[0] - self._transform @ right[self._rows]
        right[:-1] -= self._by_Omega * without[0]
        lower = np.einsum("jh,jh->h", self._down[1:k], self._balance[k - 1 : 0 : -1])
        lower -= self._bond * np.einsum("jh,jh->h", self._across[1:k], self._site[k - 1 : 0 : -1])
        lower += without[1 + H :] * self._balance[0] - self._bond * without[1 : 1 + H] * self._site[0]
        right[self._rows] = -self._down[0] * known - lower
        self._put(k, solve(right), without, known)

    def _put(self, k: int, z: Array, without: Array, known: Array) -> None:
        """Take over order k, and complete what depends on it."""
        u = float(z[self._place])
        self.found[k], self.own, self._powers[1, k] = z, z.copy(), u
        self._along[k] = without + u * self._by_u[1]
        self._site[k] = self._transform @ z[self._rows]
        self.own[self._place] = u * self._by_u[1, 0]
        self._balance[k] = known + self._block @ self.own[self._touched]
        self.own[self._place] = self._along[k, 0]

    def structure(self) -> Structure:
        """What the compiled kernel needs for the same from order 2 on."""
        orders, size = self.found.shape
        return Structure(
            TAIL, orders - 1, self._transform.shape[0], size, self._first, self._place, self._touched.size,
            self._own_Omega, self._touched, self._by_u, self._transform, self._block, self._by_Omega, self._along,
            self._powers, self._balance, self._site, self.found, self._bond,
        )  # fmt: skip


class TailRecursion:
    """Coefficients of a branch of one problem with an eliminated tail, by the recursion of its core alone."""

    def __init__(self, problem: TailedCore, form: PolynomialForm, orders: int) -> None:
        self.problem, self.orders = problem, orders
        self._core = TaylorRecursion(problem.core, form, orders)
        self.end: tuple[int, float] | None = None

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients z_0 = z, z_1 = slope, z_2, ..., shape (orders + 1, size); see `TaylorRecursion`.

        Raises SingularError where the tail has no series.
        """
        core, u = self._core, float(z[self.problem.Omega_index])
        try:
            tail = self.problem.tail.series(u, self.orders)
        except ArithmeticError as error:
            raise SingularError(str(error)) from error
        self.end = None if np.isnan(tail.end) else (self.problem.Omega_index, u + tail.end)
        orders = _Orders(self.problem, tail, z)
        core.put(0, orders.own)
        orders.first(slope)
        core.put(1, orders.own)
        if core.solve_all(solve, orders.structure):
            return orders.found
        for k in range(2, self.orders + 1):
            orders.solved(k, core.right_side(k), solve)
            core.put(k, orders.own)
        return orders.found
