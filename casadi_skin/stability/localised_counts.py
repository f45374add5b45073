"""The number of localised multipliers of an orbit: those on the circle gap by gap, and those off it by the argument.

The determinant of Hill's equations tends to 1 where perturbations grow fast, and is periodic along the real axis, so
that its argument turns there once for every zero above. Zeros on the axis are those in gaps, where it is real: they,
and the one of the velocity of the flow, are passed above, by half a turn each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.gaps import HALF, START, End, Layout
from casadi_skin.stability.hill import Hill

FIRST = 12  # values of sigma under each part of an arc, at first
TURN = 0.6  # of the argument from one value to the next, at most
MOST = 4000  # values of sigma under arcs
DEGREES = (16, 32, 64, 128)  # of the series in a gap
CONVERGED = 1e-6
ROUGH = 1e-8  # of the stiffness: what the argument does without
WHOLE = 0.02  # distance of a count from a whole number, at most
NEAR = 0.04  # of the gap: how far from sigma = Omega its double zero is divided out


class CountError(ArithmeticError):
    """The multipliers of an orbit cannot be counted."""


@dataclass(frozen=True)
class Counts:
    """Localised multipliers of an orbit: exponents in each gap, in the order of gaps, and how many are off the circle.

    Of these a pair of real ones counts one, four complex ones two.
    """

    zeros: tuple[tuple[float, ...], ...]
    off: int

    @property
    def inside(self) -> tuple[int, ...]:
        """Numbers of exponents in the gaps."""
        return tuple(len(some) for some in self.zeros)


def count(hill: Hill, layout: Layout) -> Counts:
    """Count localised multipliers; raises CountError where the argument does not turn by whole half turns."""
    zeros = tuple(zeros_in(hill, start, end) for start, end in layout.gaps)
    rough = hill.coarser(ROUGH)
    turned = sum(_turned(rough, a.sigma, b.sigma) for a, b, covered in layout.intervals if covered) / np.pi
    total = turned - sum(map(len, zeros)) - (0 if layout.pinned else 1) + hill.medium.bound.size
    if abs(total - round(total)) > WHOLE or round(total) < 0:
        raise CountError(f"the argument of Hill's determinant turns by {total:.3f} half turns")
    return Counts(zeros, round(total))


def _turned(hill: Hill, start: float, end: float) -> float:
    """The change of the argument of D under an arc, from one end to the other."""
    angles = np.pi * np.arange(FIRST + 1) / FIRST

    def phases(angle: Array) -> Array:
        sigma = 0.5 * (start + end) - 0.5 * (end - start) * np.cos(angle)
        sigma[angle == 0.0], sigma[angle == np.pi] = start, end
        return np.asarray(hill.determinant(sigma)[1], dtype=complex)

    known = phases(angles)
    while True:
        turns = np.angle(known[1:] / known[:-1])
        wide = np.flatnonzero(np.abs(turns) > TURN)
        if not wide.size:
            return float(np.sum(turns))
        if known.size > MOST or np.min(np.diff(angles)[wide]) < 1e-9:
            raise CountError("a localised multiplier is on an arc of the continuous spectrum")
        middle = 0.5 * (angles[wide] + angles[wide + 1])
        angles = np.insert(angles, wide + 1, middle)
        known = np.insert(known, wide + 1, phases(middle))


@dataclass(frozen=True)
class Gap:
    """A gap between arcs in a variable x from -1 to 1 in which D is analytic; up to Omega with its mirror image."""

    start: End
    end: End

    @property
    def mirrored(self) -> bool:
        """Whether it ends at Omega, where the velocity of the flow makes a double zero."""
        return self.end.name == HALF

    @property
    def half(self) -> float:
        """Half its length, of both images."""
        return (self.end.sigma - self.start.sigma) * (1.0 if self.mirrored else 0.5)

    def sigma(self, x: Array) -> Array:
        """Exponents at values of x."""
        away = 2.0 * self.half * np.sin(0.25 * np.pi * (1.0 + x)) ** 2
        return np.asarray(np.minimum(self.start.sigma + away, self.end.sigma))

    def place(self, sigma: float) -> float:
        """x of an exponent."""
        return 4.0 / np.pi * float(np.arcsin(np.sqrt((sigma - self.start.sigma) / (2.0 * self.half)))) - 1.0

    def values(self, hill: Hill, x: Array) -> Array:
        """D at values of x, not at the mirrored end, divided by its double zero there."""
        sigma = self.sigma(x)
        logs, signs = hill.determinant(sigma)
        if self.mirrored:
            logs = logs - 2.0 * np.log((self.end.sigma - sigma) / self.half)
        return np.asarray(np.real(signs) * np.exp(logs))


def zeros_in(hill: Hill, start: End, end: End) -> tuple[float, ...]:
    """Exponents in a gap, all of them as zeros of a converged series."""
    gap = Gap(start, end)
    values = np.empty(0)
    middle = [by_velocity(hill, gap.half)] if gap.mirrored else []
    for degree in DEGREES:
        x = chebyshev.nodes(degree)
        x, known = (x[x < 0.0] if gap.mirrored else x), values
        values = np.empty(x.size)
        new = np.full(x.size, True)
        new[: 2 * known.size : 2] = False  # nodes of half the degree
        values[~new], values[new] = known, gap.values(hill, x[new])
        everywhere = np.concatenate([values, middle, values[::-1]]) if gap.mirrored else values
        series = chebyshev.transform(degree) @ everywhere
        if np.sum(np.abs(series[-chebyshev.TAIL :])) <= CONVERGED * np.max(np.abs(series)):
            break
    else:
        raise CountError("Hill's determinant does not converge in a gap")
    _, places, crosses = chebyshev.real_zeros(series[:, None])
    kept = places[crosses & (np.abs(places) < 1.0) & ((places < 0.0) | (not gap.mirrored))]
    return tuple(sorted(gap.sigma(kept).tolist()))


def by_velocity(hill: Hill, gap: float) -> float:
    """D over ((Omega - sigma)/gap)^2 at sigma = Omega, where the velocity of the flow makes a double zero.

    It is even about Omega: from two distances along either axis errors are of the eighth order.
    """
    h = NEAR * gap * np.array([1.0, 0.5])
    logs, phases = hill.determinant(hill.Omega + np.concatenate([-h, 1j * h]))
    values = np.exp(logs) * np.real(phases) * np.tile((gap / h) ** 2, 2)
    wide, near = 0.5 * (values[:2] - values[2:])
    return float((16.0 * near - wide) / 15.0)


def at_end(hill: Hill, end: End, gap: float) -> dict[str, float]:
    """Real functions of an orbit that vanish where a localised multiplier passes an end of a gap, by name."""
    if end.name == START:
        return {f"{START} {parity}": hill.at_end(0.0, parity) for parity in ("cosine", "sine")}
    if end.name == HALF:
        return {f"{HALF} cosine": hill.at_end(hill.Omega, "cosine"), f"{HALF} velocity": by_velocity(hill, gap)}
    logs, signs = hill.determinant(np.array([end.sigma]))
    return {end.name: float(np.real(signs[0]) * np.exp(logs[0]))}
