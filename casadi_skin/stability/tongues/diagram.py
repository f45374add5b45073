"""Tongues of instability and changes of stability of a branch, as results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.result import NoQuantityError, Result
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.interpolation import Piece
from casadi_skin.stability.tongues.pairs import growth_of
from casadi_skin.zero.kinds import Unresolved, count_in_words
from casadi_skin.zero.problem import Array

LOG_MULTIPLIER_NOISE = 1e-7  # of log |multiplier|: the effect of rounding on two mu that nearly meet


@dataclass(frozen=True)
class Place:
    """A place on a branch, with the errors of its coordinate and of S."""

    coordinate: float
    coordinate_error: float
    S: float
    S_error: float
    Omega: float


REAL, COMPLEX, BAND_EDGE, RESONANCE, OVERLAP = "real", "complex", "band edge", "resonance", "overlap"


@dataclass(frozen=True)
class StabilityEdge:
    """The place where an instability begins, ends or changes its kind; or the number of localised ones.

    `kind` is "real" where a multiplier leaves the unit circle through 1 (`mu` is -1 or 0), "complex" where two meet,
    on the circle (a Krein collision, -1 < mu < 0) or on the real axis. Localised multipliers of an orbit at the edge of
    an endless medium have three more: "band edge" where one becomes localised, or ceases to be, as it meets the end of
    an arc of the continuous spectrum; "resonance" where complex ones leave an arc under which waves of both signatures
    are, or come back to it; "overlap" where arcs of opposite signature begin to overlap, or end.

    `signatures` are the Krein signatures of the multipliers or waves that meet: opposite ones where a collision is on
    the circle, one for "real" of a tongue, none where there are none. `stable_before` and `stable_after` are those of
    the orbits next to it, in order of the branch; `off_before` and `off_after` count localised multipliers outside the
    circle. `tongue` is the place in `StabilityDiagram.tongues` of the tongue that it bounds, `width` that tongue's in
    S. `power` of lambda(M) gives multipliers over the period.
    """

    place: Place
    kind: str
    mu: float
    signatures: tuple[int, ...]
    stable_before: bool
    stable_after: bool
    power: int
    tongue: int | None = None
    width: float = np.nan
    off_before: int | None = None
    off_after: int | None = None

    @property
    def S(self) -> float:
        """Amplitude."""
        return self.place.S

    @property
    def value(self) -> float:
        """S, the continuation parameter of a family."""
        return self.place.S

    @property
    def error(self) -> float:
        """Estimated error of S."""
        return self.place.S_error

    @property
    def S_width(self) -> float:
        """Length of the interval of S that holds the place."""
        return 2.0 * self.place.S_error

    @property
    def S_error(self) -> float:
        """Estimated error of S: the effect of the errors of flow, orbits and interpolation."""
        return self.place.S_error

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.place.Omega

    @property
    def angle(self) -> float:
        """Angle of lambda(M) where multipliers meet, in [0, pi]; 0 or pi where they meet on the real axis."""
        return float(np.arccos(np.clip(1.0 + 2.0 * self.mu, -1.0, 1.0)))

    @property
    def multiplier(self) -> complex:
        """The multiplier over the period where two meet, that of them in the upper half plane or on the real axis."""
        root = np.sqrt(self.mu + 0j) + np.sqrt(1.0 + self.mu + 0j)
        value = complex(root ** (2 * self.power))
        return value if value.imag >= 0.0 else value.conjugate()


@dataclass(frozen=True)
class Tongue:
    """A stretch of branch, from `start` to `end`, on which one group of multipliers is off the unit circle.

    Where `open_start` (`open_end`) it reaches to the end of the computed branch, and no edge is there. `kind`
    is that of the instability at its start: "real" or "complex". `modes` are the linear modes whose rotation angles
    meet, twice the same for a real one, and `order` the m of p_k + p_l = 2 pi m: omega_k + omega_l = 2 m Omega at small
    amplitude of an odd orbit (m Omega of one that is only reversible); None where they are not known. `growth` is
    log |multiplier| over one period at its deepest place, at S = `S_deepest`. Where it is not `decided`, it is narrower
    than the errors of its edges: `growth` may be 0 or a few times its value here.
    """

    start: Place
    end: Place
    open_start: bool
    open_end: bool
    kind: str
    modes: tuple[int, int] | None
    order: int | None
    growth: float
    S_deepest: float
    decided: bool

    @property
    def width(self) -> float:
        """Length in S."""
        return abs(self.end.S - self.start.S)

    @property
    def max_abs_multiplier(self) -> float:
        """Largest modulus of a multiplier in it."""
        return float(np.exp(self.growth))


@dataclass(frozen=True)
class StableWindow:
    """Orbits between two tongues that may be stable: the window is narrower than the errors of its ends."""

    start: Place
    end: Place


@dataclass(frozen=True)
class Passage:
    """Two mu of one signature that meet, within their errors, without instability."""

    place: Place
    mu: float
    distance: float


@dataclass(frozen=True, eq=False)
class StabilityDiagram(Result):
    """Every change of stability along a branch, and stability as a function of the coordinate along it.

    Of `all` edges in order along the branch `changes` are those between stable and unstable, `further` those where
    orbits are unstable on both sides. `tongues` are in order of their starts. Not counted are `undecided` tongues,
    which are shallower than errors, `windows` between tongues that are narrower than these, and `passages` of
    multipliers of one signature. `unresolved` lists the unresolved parts. `symplectic` is true where signatures exist;
    without them any two mu may leave the real axis where they meet. `power` of lambda(M) gives the multipliers over the
    period, `samples` counts the orbits that were computed. A `localised` diagram is that of the localised multipliers
    of orbits at the edge of an endless linear medium: it has changes alone, between which nothing is stored.
    """

    all: tuple[StabilityEdge, ...]
    unresolved: tuple[Unresolved, ...]
    samples: int
    tongues: tuple[Tongue, ...] = ()
    undecided: tuple[Tongue, ...] = ()
    windows: tuple[StableWindow, ...] = ()
    passages: tuple[Passage, ...] = ()
    symplectic: bool = True
    power: int = 2
    pieces: tuple[Piece, ...] = ()
    localised: bool = False

    def __repr__(self) -> str:
        left = f", {len(self.unresolved)} stretches unresolved" if self.unresolved else ""
        others = "further" if self.localised else "tongues"
        counts = [count_in_words(len(each), self.unresolved) for each in (self.changes, getattr(self, others))]
        return f"<StabilityDiagram: {counts[0]} changes of stability, {counts[1]} {others}{left}>"

    @property
    def complete(self) -> bool:
        """Whether no stretch of the branch is unresolved."""
        return not self.unresolved

    @cached_property
    def changes(self) -> tuple[StabilityEdge, ...]:
        """Edges between stable and unstable, in order along the branch."""
        return tuple(edge for edge in self.all if edge.stable_before != edge.stable_after)

    @cached_property
    def further(self) -> tuple[StabilityEdge, ...]:
        """The others."""
        return tuple(edge for edge in self.all if edge.stable_before == edge.stable_after)

    @property
    def first_loss(self) -> StabilityEdge | None:
        """The first change from stable to unstable; None where there is none."""
        return next((change for change in self.changes if change.stable_before), None)

    def first_instability(self, growth: float = 0.0) -> Tongue | None:
        """The first tongue that is as deep as `growth`, log |multiplier| over a period; None where there is none."""
        return next((tongue for tongue in self.tongues if tongue.growth >= growth), None)

    # Stability as a function of the coordinate ----------------------------------------------------------------------

    @property
    def start(self) -> float:
        """Coordinate at which the computed branch begins."""
        return self._ends[0]

    @property
    def end(self) -> float:
        """Coordinate at which the computed branch ends."""
        return self._ends[1]

    @property
    def _ends(self) -> tuple[float, float]:
        if not self.pieces:
            raise NoQuantityError("start, end: localised multipliers are looked at orbit by orbit; accepted: changes")
        return self.pieces[0].matrices.start, self.pieces[-1].matrices.end

    def S(self, coordinates: Array) -> Array:
        """Amplitudes at coordinates, shape (points,)."""
        return self._values(coordinates, "S")

    def Omega(self, coordinates: Array) -> Array:
        """Frequencies at coordinates, shape (points,)."""
        return self._values(coordinates, "Omega")

    def _values(self, coordinates: Array, name: str) -> Array:
        result = np.empty(len(coordinates))
        for piece, chosen in by_piece(self.pieces, coordinates):
            result[chosen] = getattr(piece, name)(coordinates[chosen])
        return result

    def spectrum(self, coordinates: Array) -> tuple[ComplexArray, NDArray[np.int64]]:
        """All mu at coordinates, and their Krein signatures, each (points, m); signature 0 where there is none."""
        size = self.pieces[0].matrices.size
        mu, signatures = np.empty((len(coordinates), size), complex), np.zeros((len(coordinates), size), np.int64)
        for piece, chosen in by_piece(self.pieces, coordinates):
            mu[chosen], signatures[chosen] = spectra(piece.matrices.at(coordinates[chosen], 2))
        return mu, signatures

    def is_stable(self, coordinate: float) -> bool:
        """Whether a coordinate lies in no tongue."""
        return not self._inside(np.array([coordinate]))[0]

    def _inside(self, coordinates: Array) -> NDArray[np.bool_]:
        """Whether coordinates lie in tongues, or at an end where one goes on."""
        if not self.tongues:
            return np.zeros(len(coordinates), dtype=bool)
        ends = np.array([(t.start.coordinate, t.end.coordinate) for t in self.tongues])
        is_open = np.array([(t.open_start, t.open_end) for t in self.tongues])
        after, before = coordinates[:, None] - ends[:, 0], ends[:, 1] - coordinates[:, None]
        after_start, before_end = (
            (apart > 0) | (is_open[:, side] & (apart == 0)) for side, apart in enumerate((after, before))
        )
        return np.asarray(np.any(after_start & before_end, axis=1))

    def max_abs_multiplier(self, coordinates: Array) -> Array:
        """Largest modulus of a multiplier at coordinates, 1 outside tongues, shape (points,)."""
        return np.asarray(np.exp(np.max(self.growths(coordinates), axis=1, initial=0.0)))

    def growths(self, coordinates: Array) -> Array:
        """log |multiplier| >= 0 over a period of each mu at coordinates, 0 outside tongues, shape (points, m)."""
        inside = self._inside(coordinates)
        growth = np.zeros((len(coordinates), self.pieces[0].matrices.size))
        for piece, chosen in by_piece(self.pieces, coordinates[inside]) if inside.any() else ():
            rows = np.flatnonzero(inside)[chosen]
            growth[rows] = self.power * growth_of(
                np.linalg.eigvals(piece.matrices.at(coordinates[rows], 1)[:, 0]).astype(complex)
            )
        return np.where(growth > LOG_MULTIPLIER_NOISE, growth, 0.0)

    def angles_and_growths(self, coordinates: Array) -> tuple[Array, Array]:
        """Signed rotation angles in (-pi, pi] and `growths` at coordinates, shape (points, m) each.

        An angle is the signature times the angle of lambda(M), not a number off the unit circle. Where two of them add
        up to a multiple of 2 pi, multipliers of opposite signatures meet.
        """
        mu, signatures = self.spectrum(coordinates)
        angles = np.arccos(np.clip(1.0 + 2.0 * mu.real, -1.0, 1.0))
        growth = np.where(self._inside(coordinates)[:, None], self.power * growth_of(mu), 0.0)
        return np.where(signatures == 0, np.nan, signatures * angles), np.where(
            growth > LOG_MULTIPLIER_NOISE, growth, 0.0
        )

    def coordinates(self, points: int = 400, in_tongue: int = 17) -> Array:
        """Coordinates to draw curves with: evenly along the branch, and in each tongue, its edges among them."""
        even = [np.linspace(self.start, self.end, points)]
        bent = 0.5 - 0.5 * np.cos(np.pi * np.arange(in_tongue) / (in_tongue - 1))
        even += [t.start.coordinate + bent * (t.end.coordinate - t.start.coordinate) for t in self.tongues]
        return np.unique(np.concatenate(even))


def spectra(matrices: Array) -> tuple[ComplexArray, NDArray[np.int64]]:
    """mu of K, and Krein signatures of those in (-1, 0); (points, 2 or more, or 1, m, m) -> (points, m) each.

    The signature is +1 for the modes of a linear conservative system: minus the sign of x^T P x.
    """
    mu, vectors = np.linalg.eig(matrices[:, 0])
    mu = np.asarray(mu, dtype=complex)
    return mu, signatures_of(mu, vectors, matrices)


def signatures_of(mu: ComplexArray, vectors: NDArray[Any], matrices: Array) -> NDArray[np.int64]:
    """Those of mu with their vectors as columns, (points, m) and (points, m, m)."""
    if matrices.shape[1] == 1:
        return np.zeros(mu.shape, dtype=np.int64)
    forms = np.sum(vectors * (matrices[:, 1] @ vectors), axis=1).real
    on_circle = (mu.imag == 0.0) & (mu.real > -1.0) & (mu.real < 0.0)
    return np.where(on_circle, -np.sign(forms), 0.0).astype(np.int64)


def places(pieces: Sequence[Piece], coordinates: Array, errors: Array) -> list[Place]:
    """Places on a branch; the error of S is by slope and, near folds, by curvature."""
    found: list[Place | None] = [None] * len(coordinates)
    for piece, chosen in by_piece(pieces, coordinates):
        start, end = piece.matrices.start, piece.matrices.end
        at, error = np.clip(coordinates[chosen], start, end), errors[chosen]
        S = piece.S(np.clip(np.stack([at, at - error, at + error]), start, end))
        S_errors = np.maximum(np.max(np.abs(S[1:] - S[0]), axis=0), np.abs(piece.slope(at)) * error)
        rows = zip(at.tolist(), error.tolist(), S[0].tolist(), S_errors.tolist(), piece.Omega(at).tolist(), strict=True)
        for i, row in zip(chosen.tolist(), rows, strict=True):
            found[i] = Place(*row)
    return [place for place in found if place is not None]


def by_piece(pieces: Sequence[Piece], coordinates: Array) -> list[tuple[Piece, NDArray[np.int64]]]:
    """The pieces that coordinates are on, or nearest to, with the numbers of these coordinates."""
    starts, ends = (np.array([getattr(piece.matrices, name) for piece in pieces]) for name in ("start", "end"))
    away = np.maximum(np.maximum(starts - coordinates[:, None], coordinates[:, None] - ends), 0.0)
    which = np.argmin(away, axis=1)
    return [(pieces[k], np.flatnonzero(which == k)) for k in np.unique(which).tolist()]
