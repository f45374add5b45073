"""The matrices that decide stability, as Chebyshev series in a coordinate along a branch.

They are analytic along the branch, so that a few orbits determine them on a stretch of it, and everything else is asked
of the series.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import Chebyshev

from casadi_skin.model.arguments import in_words
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.multipliers import reduced_matrices
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.rotation import Spectrum
from casadi_skin.zero.problem import EPSILON, Array

SERIES_DEGREES = (16, 32)  # of the series: for a short piece, and where longer pieces of higher degree save little more
FIRST_LENGTH = 0.25  # of a section, of its first piece
SHORTEST_PIECE = 1e-3  # of a section: shorter pieces are given up
SKIPPED_STRETCH = 0.03  # of a section, at most: the stretch given up at a time in the middle of a gap
ROUNDING_COEFFICIENT = 1e-14  # relative size of coefficients that say nothing of convergence
SMALLEST_NUMBER = 1e-300
LOWER_DEGREE_FACTOR = 1.5  # times shorter than a singularity allows are pieces of lower degrees: these converge later
SHORTER_PIECE_FACTOR, LONGER_PIECE_FACTOR = (
    0.6,
    3.0,
)  # lengths of a piece after one that failed and after one that did not, at most
TOLERANCE_MARGIN = 10.0  # of the tolerance over the error that a piece is planned with
PLATEAU_RATIO = 3.0  # ratio of coefficients in the third and the last quarter below which they are noise
NOISE_LEVEL_RATIO = 5.0  # the same ratio of their root mean squares, for what noise adds to errors
NOISE_DEVIATIONS = 3.0  # of that noise
NOISIEST_ACCEPTED = 1e-6  # noise that is still accepted, relative to the largest entry
FAILURE_ERRORS = (ArithmeticError, np.linalg.LinAlgError, RuntimeError)  # of orbits, flows and linear algebra


class OrbitNotFoundError(ArithmeticError):
    """The orbit at a coordinate of the branch is not found."""


@dataclass(frozen=True)
class Samples:
    """Samples of a branch at several coordinates.

    `transitions` are Phi, shape (points, 2n, 2n), and `errors` matrices like their errors but for the sign.
    `directions` are q'' at phase zero, which give the trivial mu, shape (points, n); None in a model without it.
    """

    transitions: Array
    errors: Array
    directions: Array | None
    S: Array
    Omega: Array


class BranchSampler(Protocol):
    """A stretch of branch with a coordinate along it, whatever computes its orbits.

    The coordinate is one to one, also where S folds, and everything is analytic in it within each of `sections`,
    (start, end) in ascending order. `fraction` of the period is that of the transition matrices, 0.25 or 0.5;
    `symplectic` is true where these are.
    """

    @property
    def sections(self) -> Sequence[tuple[float, float]]: ...
    @property
    def fraction(self) -> float: ...
    @property
    def symplectic(self) -> bool: ...

    def sample(self, coordinates: Array) -> Samples:
        """Samples at coordinates of one section; raises OrbitNotFoundError, FlowError."""
        ...

    def amplitude(self, coordinate: float) -> float:
        """S near a coordinate, to a few digits and without an orbit: it names places that are not known."""
        ...


@dataclass(frozen=True)
class MatrixSeries:
    """Matrices (K, P, Q), or K alone of a map that is not symplectic, on [start, end], with their errors.

    `coefficients` have shape (degree + 1, 3 or 1, m, m). `errors`, of the same shape, are matrices like the errors of
    flow and orbits at the nodes; `noise`, shape (3 or 1,), bounds the Frobenius norm of what interpolation and rounding
    add.
    """

    start: float
    end: float
    coefficients: Array
    errors: Array
    noise: Array

    @property
    def size(self) -> int:
        """Number of rows of each matrix."""
        return int(self.coefficients.shape[-1])

    def at(self, coordinates: Array, parts: int = 3) -> Array:
        """The matrices, or the first `parts` of them, at coordinates, of shape (..., 3 or 1, m, m)."""
        weights = chebyshev.basis(self._local(coordinates), len(self.coefficients) - 1)
        return np.tensordot(weights, self.coefficients[:, :parts], 1)

    def errors_at(self, coordinates: Array) -> Array:
        """Matrices like the errors, on straight lines between the nodes, alike."""
        places, x = chebyshev.nodes(len(self.errors) - 1), np.clip(self._local(coordinates), -1.0, 1.0)
        right = np.clip(np.searchsorted(places, x), 1, places.size - 1)
        share = ((x - places[right - 1]) / (places[right] - places[right - 1]))[..., None]
        weights = share * np.eye(places.size)[right] + (1.0 - share) * np.eye(places.size)[right - 1]
        return np.tensordot(weights, self.errors, 1)

    def _local(self, coordinates: Array) -> Array:
        """Places in [-1, 1] of coordinates."""
        return np.asarray((2.0 * coordinates - self.start - self.end) / (self.end - self.start))


@dataclass(frozen=True)
class Piece:
    """A piece of branch: its matrices, and the Chebyshev coefficients of S and Omega, each (degree + 1,)."""

    matrices: MatrixSeries
    S_coefficients: Array
    Omega_coefficients: Array

    @cached_property
    def S(self) -> Chebyshev:
        """Amplitude as a function of the coordinate."""
        return Chebyshev(self.S_coefficients, (self.matrices.start, self.matrices.end))

    @cached_property
    def slope(self) -> Chebyshev:
        """Derivative of the amplitude with respect to the coordinate."""
        return self.S.deriv()

    @cached_property
    def Omega(self) -> Chebyshev:
        """Frequency as a function of the coordinate."""
        return Chebyshev(self.Omega_coefficients, (self.matrices.start, self.matrices.end))


@dataclass(frozen=True)
class Gap:
    """A stretch of branch on which the matrices are not known, and why."""

    start: float
    end: float
    reason: str


EIGENVALUE_OVERHEAD = 3e4  # of an eigenvalue problem of any size, in units of m^3: measured, about a millisecond


@dataclass
class Search:
    """What is known of a branch.

    Attributes:
        pieces: in order, as far as they are computed.
        gaps: stretches on which matrices or instabilities are not known.
        samples: number of orbits.
        segments: unstable ones, in any order.
        passages: (coordinate, mu, distance) of pairs of one signature that meet within errors.
        intervals: number of eigenvalue problems by their size.
        spectra: mu, their rates and signatures at some coordinates.
    """

    pieces: list[Piece] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    samples: int = 0
    segments: list[Any] = field(default_factory=list)
    passages: list[tuple[float, float, float]] = field(default_factory=list)
    intervals: dict[int, int] = field(default_factory=dict)
    spectra: list[Spectrum] = field(default_factory=list)

    @property
    def work(self) -> float:
        """Sum of m^3, and of what small ones cost as well, over the eigenvalue problems."""
        return float(sum(count * (size**3 + EIGENVALUE_OVERHEAD) for size, count in self.intervals.items()))


@dataclass
class _Plan:
    """The next length and degree to try, from how the last series converged: the state of the loop of `interpolate`.

    `radius` is the distance of the nearest singularity, were it at right angles to the branch: infinite at first.
    `longest` and `lowest` limit length and degree after a failure.
    """

    tolerance: float
    radius: float = np.inf
    longest: float = np.inf
    lowest: int = SERIES_DEGREES[0]
    first: float = FIRST_LENGTH

    def next(self, remaining: float) -> tuple[float, int]:
        """Length and degree of the next piece: the rest of the section in equal pieces of the lowest degree."""
        if self.radius == np.inf and self.longest == np.inf:
            return self.first * remaining, self.lowest
        for degree in SERIES_DEGREES:
            needed = remaining if degree == SERIES_DEGREES[-1] else LOWER_DEGREE_FACTOR * remaining
            if degree >= self.lowest and self._length(degree) >= needed:
                return remaining, degree
        return float(remaining / np.ceil(remaining / self._length(SERIES_DEGREES[-1]))), SERIES_DEGREES[-1]

    def _length(self, degree: int) -> float:
        rate = (TOLERANCE_MARGIN / self.tolerance) ** (1.0 / degree)
        return float(min(4.0 * self.radius / (rate - 1.0 / rate), self.longest))

    def learn(self, length: float, sizes: Array) -> None:
        """Update from the relative sizes of the coefficients, as far as these are not rounding."""
        envelope = np.maximum.accumulate(sizes[::-1])[::-1]
        last = max(int(np.count_nonzero(envelope > ROUNDING_COEFFICIENT)) - 1, 1)
        rate = max(float(envelope[0] / max(envelope[last], ROUNDING_COEFFICIENT)) ** (1.0 / last), 1.0 + 1e-3)
        self.radius = 0.25 * length * (rate - 1.0 / rate)

    def limit(self, length: float, degree: int, failed: bool) -> None:
        """Limit the next piece by the outcome of this one: the same length in a higher degree, or a shorter one."""
        if not failed:
            self.longest, self.lowest = LONGER_PIECE_FACTOR * length, SERIES_DEGREES[0]
        elif degree < SERIES_DEGREES[-1]:
            self.longest, self.lowest = length, SERIES_DEGREES[-1]
        else:
            self.longest = SHORTER_PIECE_FACTOR * length


def interpolate(branch: BranchSampler, tolerance: float, known: Search, first: float = FIRST_LENGTH) -> Iterator[Piece]:
    """The matrices along a branch, to `tolerance` relative to their largest entry, piece by piece.

    Arguments:
        branch: the source of transition matrices at any coordinate.
        tolerance: of the interpolation, relative to the largest entry of the matrices.
        first: length of the first piece, as a share of the section.
        known: gets the pieces; where orbits or transition matrices are not to be had, or do not converge, gaps.

    Returns:
        Pieces in order.
    """
    plan = _Plan(tolerance, first=first)
    for start, end in branch.sections:
        at, shortest = start, SHORTEST_PIECE * (end - start)
        while at < end:
            length, degree = plan.next(end - at)
            stop = end if length >= (1.0 - 1e-9) * (end - at) else at + length
            piece = None
            try:
                piece, sizes = _piece(branch, at, stop, degree, tolerance)
                known.samples += degree + 1
                plan.learn(stop - at, sizes)
                rest = np.max(sizes[-chebyshev.TAIL_COEFFICIENTS :])
                reason = f"multipliers do not converge along the branch: {rest:.1e} is left"
            except FAILURE_ERRORS as error:
                reason, degree = in_words(error), SERIES_DEGREES[-1]  # a higher degree would not help
            plan.limit(length, degree, piece is None)
            if piece is not None:
                known.pieces.append(piece)
                at, shortest = stop, SHORTEST_PIECE * (end - start)
                yield piece
            elif stop - at <= shortest:
                known.gaps.append(Gap(at, stop, reason))
                at, shortest = stop, min(2.0 * shortest, SKIPPED_STRETCH * (end - start))
                plan = _Plan(tolerance, longest=shortest)  # one try each until the branch goes on


def joined(gaps: Sequence[Gap]) -> list[Gap]:
    """Gaps in order, those that touch or overlap as one with the reason of the first."""
    found: list[Gap] = []
    for gap in sorted(gaps, key=lambda gap: gap.start):
        if found and gap.start <= found[-1].end:
            found[-1] = Gap(found[-1].start, max(found[-1].end, gap.end), found[-1].reason)
        else:
            found.append(gap)
    return found


def _piece(
    branch: BranchSampler, start: float, end: float, degree: int, tolerance: float
) -> tuple[Piece | None, Array]:
    """The piece, None where it does not converge, and the relative sizes of its coefficients, (degree + 1,)."""
    samples = branch.sample(start + 0.5 * (end - start) * (1.0 + chebyshev.nodes(degree)))
    if not np.all(np.isfinite(samples.transitions)):
        raise FlowError("the transition matrices are not finite")
    values, errors = reduced_matrices(samples.transitions, samples.errors, samples.directions, branch.symplectic)
    to_coefficients = chebyshev.transform(degree)
    coefficients, scalars = (
        np.tensordot(to_coefficients, values, 1),
        to_coefficients @ np.stack([samples.S, samples.Omega], axis=1),
    )
    sizes = np.concatenate([np.max(np.abs(coefficients), axis=(2, 3), initial=0.0), np.abs(scalars)], axis=1)
    sizes = np.max(sizes / np.maximum(np.max(sizes, axis=0), SMALLEST_NUMBER), axis=1)
    missed = float(np.max(sizes[-chebyshev.TAIL_COEFFICIENTS :]))
    quarter = degree // 4
    noisy = missed <= NOISIEST_ACCEPTED and float(np.max(sizes[2 * quarter : 3 * quarter])) <= PLATEAU_RATIO * missed
    if missed > tolerance and not noisy:
        return None, sizes
    noise = np.sqrt(np.sum(chebyshev.tail(coefficients) ** 2, axis=(1, 2)))
    noise += _of_plateau(coefficients)
    noise += EPSILON * np.max(np.sqrt(np.sum(values**2, axis=(2, 3))), axis=0) * degree
    series = MatrixSeries(start, end, coefficients, errors, noise)
    return Piece(series, scalars[:, 0].copy(), scalars[:, 1].copy()), sizes  # in order, as files hold them


def _of_plateau(coefficients: Array) -> Array:
    """Frobenius norms of the noise of orbits that differ by rounding, (degree + 1, 3 or 1, m, m) -> (3 or 1,).

    Noise at the nodes is in all coefficients alike: where these do not fall in the second half, the series has it all.
    """
    degree = len(coefficients) - 1
    squares = np.sum(coefficients**2, axis=(2, 3))
    third, last = (np.sqrt(np.mean(part, axis=0)) for part in np.split(squares[-2 * (degree // 4) :], 2))
    return np.where(third <= NOISE_LEVEL_RATIO * last, NOISE_DEVIATIONS * np.sqrt(0.5 * degree) * last, 0.0)


# Matrices along a branch that a symmetry of its orbits makes copies of smaller ones: each of these once ---------------

RANDOM_COMBINATIONS = 4  # random ones, that couple what any of the matrices couples
EQUAL_EIGENVALUES_RTOL = 1e-7  # distance of eigenvalues that are one, relative to the largest
COPY_PLACES = np.array([0.21, 0.5, 0.83])  # of the series
COPIES_COUPLED = 1e-10  # entries relative to the largest: smaller ones are noise
ALIKE_COPIES_RTOL = 1e-9  # difference of copies, relative to the largest entries: noise of orbits and flows


def without_copies(series: MatrixSeries) -> list[MatrixSeries]:
    """A series, or where symmetries repeat its multipliers smaller ones with each of these once."""
    if series.size < 2:
        return [series]
    sizes = np.max(np.abs(series.coefficients), axis=(0, 2, 3))
    matrices = (series.coefficients / np.maximum(sizes, np.finfo(float).tiny)[:, None, None]).reshape(
        -1, series.size, series.size
    )
    weights = np.random.default_rng(0).normal(size=(RANDOM_COMBINATIONS, len(matrices)))
    combined = np.tensordot(weights, matrices, 1)
    values, vectors = np.linalg.eigh(combined[0] + combined[0].T)
    apart = np.flatnonzero(np.diff(values) > EQUAL_EIGENVALUES_RTOL * np.max(np.abs(values))) + 1
    if apart.size == series.size - 1 and not _repeats(series):
        return [series]
    spaces = [slice(a, b) for a, b in pairwise([0, *apart.tolist(), series.size])]
    entries = vectors.T @ np.concatenate([combined, combined.swapaxes(1, 2)]) @ vectors
    found: list[MatrixSeries] = []
    for group in _coupled(entries, spaces):
        copies = _copies(entries, group)
        once = None if copies is None else _restricted(series, [vectors @ basis for basis in copies])
        every = np.hstack([vectors[:, space] for space in group])
        found.append(once or _restricted(series, [every], np.inf) or series)
    return found


def _repeats(series: MatrixSeries) -> bool:
    """Whether two mu are equal at several places: symmetries in time as well as space do that without copies."""
    mu = np.linalg.eigvals(series.at(series.start + COPY_PLACES * (series.end - series.start), 1)[:, 0]).astype(complex)
    apart = np.abs(mu[:, :, None] - mu[:, None, :]) + np.eye(series.size)
    return bool(np.all(np.min(apart, axis=(1, 2)) <= EQUAL_EIGENVALUES_RTOL))


def _coupled(entries: Array, spaces: Sequence[slice]) -> Iterator[list[slice]]:
    """The eigenspaces in groups that nothing couples to each other; `entries` are those of matrices in their basis."""
    starts = [space.start for space in spaces]
    blocks = np.maximum.reduceat(np.maximum.reduceat(np.max(np.abs(entries), axis=0), starts, 0), starts, 1)
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(blocks > COPIES_COUPLED * np.max(blocks))
    for k in range(count):
        yield [spaces[i] for i in np.flatnonzero(part == k).tolist()]


def _copies(entries: Array, group: Sequence[slice]) -> list[Array] | None:
    """The bases of the copies that a group of eigenspaces of one size is, as columns; None where there is one.

    Each eigenspace is turned so that the largest block that couples it to those before is a multiple of the identity.
    """
    count = group[0].stop - group[0].start
    if count == 1 or any(space.stop - space.start != count for space in group):
        return None
    turned = {0: np.eye(count)}
    while len(turned) < len(group):
        blocks = [
            (turned[i].T @ entries[:, group[i], space], j)
            for i in turned
            for j, space in enumerate(group)
            if j not in turned
        ]
        block, j = max(
            ((max(each, key=lambda one: float(np.linalg.norm(one))), j) for each, j in blocks),
            key=lambda pair: float(np.linalg.norm(pair[0])),
        )
        left, _, right = np.linalg.svd(block)
        turned[j] = (left @ right).T
    bases = np.zeros((count, entries.shape[1], len(group)))
    for j, turn in turned.items():
        bases[:, group[j], j] = turn.T
    return list(bases)


def _restricted(series: MatrixSeries, copies: Sequence[Array], alike: float = ALIKE_COPIES_RTOL) -> MatrixSeries | None:
    """The mean of the copies, with what they differ by as noise; None where they are not `alike`."""
    parts = [basis.T @ series.coefficients @ basis for basis in copies]
    mean = np.mean(parts, axis=0)
    rest = np.zeros_like(series.noise)
    for basis in copies:
        right = np.linalg.norm(series.coefficients @ basis - basis @ mean, axis=(2, 3))
        left = np.linalg.norm(basis.T @ series.coefficients - mean @ basis.T, axis=(2, 3))
        rest = np.maximum(rest, np.sum(np.maximum(right, left), axis=0))
    if np.any(rest > alike * np.max(np.abs(series.coefficients), axis=(0, 2, 3))):
        return None
    errors = copies[0].T @ series.errors @ copies[0]
    return MatrixSeries(series.start, series.end, mean, errors, series.noise + rest)
