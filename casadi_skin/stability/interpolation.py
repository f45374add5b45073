"""The matrices that decide stability, as Chebyshev series in a coordinate along a branch.

With Phi = [[A, B], [C, D]] over a quarter (half) of the period, the map over twice that time is M = [[I + 2K, 2Q],
[2P, I + 2K^T]] with K = B^T C, P = A^T C and Q = B^T D. P and Q are symmetric, K is symmetric with respect to both:
P K and K Q are symmetric, and P Q = K^T (I + K^T). All are analytic along the branch, so that a few orbits determine
them on a stretch of it, and everything else is asked of the series. The trivial direction a, with a^T K = -a^T or 0
and Q a = 0, is taken out: the matrices are those on what is orthogonal to a.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from casadi_skin.bvp.problem import EPSILON, Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.flow import FlowError

DEGREES = (12, 16, 24, 32)  # of the series; longer pieces of higher degree save little more
FIRST_LENGTH = 0.25  # of a section, of its first piece
SHORTEST = 1e-4  # of a section: shorter pieces are given up
MARGIN = 1.15  # of the rate of convergence that the next piece is planned with
PLATEAU = 3.0  # ratio of coefficients in the third and the last quarter below which they are noise
NOISIEST = 1e-6  # noise that is still accepted, relative to the largest entry


class OrbitNotFoundError(ArithmeticError):
    """The orbit at a coordinate of the branch is not found."""


@dataclass(frozen=True)
class Samples:
    """What a branch gives at several coordinates.

    `transitions` are Phi, shape (points, 2n, 2n), and `errors` matrices like their errors but for the sign.
    `directions` span the trivial direction, shape (points, n): q'' at phase zero for a symplectic Phi; for one that is
    only reversible the positions at phase zero of the direction along the family; None in a model without it.
    """

    transitions: Array
    errors: Array
    directions: Array | None
    S: Array
    Omega: Array


class BranchSampler(Protocol):
    """A stretch of branch with a coordinate along it, whatever computes its orbits.

    The coordinate is one to one, also where S folds, and everything is analytic in it within each of `sections`, (start,
    end) in ascending order. `fraction` of the period is that of the transition matrices, 0.25 or 0.5; `symplectic` tells
    whether these are.
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

    def local(self, coordinates: Array) -> Array:
        """Places in [-1, 1] of coordinates."""
        return np.asarray((2.0 * coordinates - self.start - self.end) / (self.end - self.start))

    def at(self, coordinates: Array) -> Array:
        """The matrices, shape (points, 3 or 1, m, m)."""
        weights = chebyshev.basis(self.local(coordinates), self.coefficients.shape[0] - 1)
        flat = weights @ self.coefficients.reshape(self.coefficients.shape[0], -1)
        return np.asarray(flat.reshape(-1, *self.coefficients.shape[1:]))

    def errors_at(self, coordinates: Array) -> Array:
        """Matrices like their errors, between nodes by straight lines, shape (points, 3 or 1, m, m)."""
        places = chebyshev.nodes(self.errors.shape[0] - 1)
        x = np.clip(self.local(coordinates), -1.0, 1.0)
        right = np.clip(np.searchsorted(places, x), 1, places.size - 1)
        weight = (x - places[right - 1]) / (places[right] - places[right - 1])
        weight = weight[:, None, None, None]
        return np.asarray((1.0 - weight) * self.errors[right - 1] + weight * self.errors[right])


@dataclass(frozen=True)
class Piece:
    """A piece of branch: its matrices, and the Chebyshev coefficients of S and Omega, each (degree + 1,)."""

    matrices: MatrixSeries
    S_coefficients: Array
    Omega_coefficients: Array

    def S(self, coordinates: Array) -> Array:
        """Amplitudes at coordinates."""
        return np.asarray(np.polynomial.chebyshev.chebval(self.matrices.local(coordinates), self.S_coefficients))

    def Omega(self, coordinates: Array) -> Array:
        """Frequencies at coordinates."""
        return np.asarray(np.polynomial.chebyshev.chebval(self.matrices.local(coordinates), self.Omega_coefficients))

    def slope(self, coordinate: float) -> float:
        """dS/d coordinate."""
        derivative = np.polynomial.chebyshev.chebder(self.S_coefficients)
        local = self.matrices.local(np.array([coordinate]))
        value = np.polynomial.chebyshev.chebval(local, derivative)[0]
        return float(2.0 * value / (self.matrices.end - self.matrices.start))


@dataclass(frozen=True)
class Gap:
    """A stretch of branch on which the matrices are not known, and why."""

    start: float
    end: float
    reason: str


@dataclass(frozen=True)
class Interpolated:
    """A branch as pieces in order, with what is missing between them; `samples` counts orbits."""

    pieces: tuple[Piece, ...]
    gaps: tuple[Gap, ...]
    samples: int


@dataclass
class _Plan:
    """The next length and degree to try, from the convergence of the last piece: the state of one section's loop."""

    tolerance: float
    radius: float = 0.0  # distance of the nearest singularity, were it at right angles to the branch
    lengths: dict[int, float] = field(default_factory=dict)

    def next(self, remaining: float) -> tuple[float, int]:
        """Length and degree of the next piece: the rest of the section in equal pieces of the lowest degree."""
        if self.radius == 0.0:
            return FIRST_LENGTH * remaining, DEGREES[1]
        for degree in DEGREES:
            if self._length(degree) >= remaining:
                return remaining, degree
        return remaining / np.ceil(remaining / self._length(DEGREES[-1])), DEGREES[-1]

    def _length(self, degree: int) -> float:
        rate = MARGIN * self.tolerance ** (-1.0 / degree)
        return 4.0 * self.radius / (rate - 1.0 / rate)

    def learn(self, length: float, degree: int, missed: float) -> None:
        """Update from the relative size of the last coefficients."""
        rate = max(max(missed, EPSILON) ** (-1.0 / degree), 1.0 + 1e-3)
        self.radius = 0.25 * length * (rate - 1.0 / rate)


def interpolate(branch: BranchSampler, tolerance: float) -> Interpolated:
    """The matrices along a branch, to `tolerance` relative to their largest entry.

    Arguments:
        branch: what gives transition matrices at any coordinate.
        tolerance: of the interpolation, relative to the largest entry of the matrices.

    Returns:
        Pieces in order; where orbits or transition matrices are not to be had, or do not converge, gaps.
    """
    pieces: list[Piece] = []
    gaps: list[Gap] = []
    samples = 0
    for start, end in branch.sections:
        plan, at, shortest = _Plan(tolerance), start, SHORTEST * (end - start)
        while at < end:
            length, degree = plan.next(end - at)
            stop = end if length >= (1.0 - 1e-9) * (end - at) else at + length
            try:
                piece, missed = _piece(branch, at, stop, degree, tolerance)
                samples += degree + 1
                reason = f"the multipliers do not converge along the branch: {missed:.1e} is left"
            except (OrbitNotFoundError, FlowError) as error:
                piece, missed, reason = None, 1.0, str(error)
            plan.learn(stop - at, degree, missed)
            if piece is not None:
                pieces.append(piece)
                at = stop
            elif stop - at <= shortest:
                gaps.append(Gap(at, stop, reason))
                at, plan = stop, _Plan(tolerance)
            else:
                plan.radius = min(plan.radius, 0.5 * (stop - at))
    return Interpolated(tuple(pieces), tuple(_joined(gaps)), samples)


def _joined(gaps: Sequence[Gap]) -> Iterator[Gap]:
    """Gaps that touch as one."""
    last: Gap | None = None
    for gap in gaps:
        if last is not None and last.end == gap.start:
            last = Gap(last.start, gap.end, last.reason)
            continue
        if last is not None:
            yield last
        last = gap
    if last is not None:
        yield last


def _piece(
    branch: BranchSampler, start: float, end: float, degree: int, tolerance: float
) -> tuple[Piece | None, float]:
    """The piece, None where it does not converge, and the relative size of the last coefficients."""
    samples = branch.sample(start + 0.5 * (end - start) * (1.0 + chebyshev.nodes(degree)))
    values, errors = reduced_matrices(samples, branch.symplectic)
    to_coefficients = chebyshev.transform(degree)
    coefficients = np.tensordot(to_coefficients, values, 1)
    sizes = np.max(np.abs(coefficients), axis=(2, 3))
    sizes = np.max(sizes / np.max(sizes, axis=0), axis=1)
    missed = float(np.max(sizes[-chebyshev.TAIL :]))
    if missed > tolerance:
        quarter = degree // 4
        before = float(np.max(sizes[2 * quarter : 3 * quarter]))
        if not (missed <= NOISIEST and before <= PLATEAU * missed):
            return None, missed
    noise = np.sqrt(np.sum(chebyshev.tail(coefficients) ** 2, axis=(1, 2)))
    noise += EPSILON * np.max(np.sqrt(np.sum(values**2, axis=(2, 3))), axis=0) * degree
    series = MatrixSeries(start, end, coefficients, errors, noise)
    return Piece(series, to_coefficients @ samples.S, to_coefficients @ samples.Omega), missed


def reduced_matrices(samples: Samples, symplectic: bool) -> tuple[Array, Array]:
    """(K, P, Q), or K alone, without the trivial direction, and matrices like their errors; (points, 3 or 1, m, m)."""
    n = samples.transitions.shape[1] // 2
    if symplectic:
        values, errors = _symplectic_matrices(samples.transitions, samples.errors)
    else:
        values, errors = _reversible_matrices(samples.transitions, samples.errors)
    if samples.directions is None:
        return values, errors
    frame = orthogonal_complements(samples.directions)[:, None]
    across = frame.swapaxes(2, 3)
    return np.asarray(across @ values @ frame), np.asarray(across @ errors @ frame).reshape(-1, len(values[0]), n - 1, n - 1)


def _symplectic_matrices(transitions: Array, errors: Array) -> tuple[Array, Array]:
    """K = B^T C, P = A^T C, Q = B^T D, and their first-order changes."""
    n = transitions.shape[1] // 2
    A, B, C, D = _blocks(transitions, n)
    dA, dB, dC, dD = _blocks(errors, n)
    At, Bt, dAt, dBt = (block.swapaxes(1, 2) for block in (A, B, dA, dB))
    values = np.stack([Bt @ C, _symmetric(At @ C), _symmetric(Bt @ D)], axis=1)
    changes = [dBt @ C + Bt @ dC, _symmetric(dAt @ C + At @ dC), _symmetric(dBt @ D + Bt @ dD)]
    return values, np.stack(changes, axis=1)


def _reversible_matrices(transitions: Array, errors: Array) -> tuple[Array, Array]:
    """K = -B' C with B' the upper right block of the inverse of Phi, and its first-order change."""
    n = transitions.shape[1] // 2
    inverse = np.linalg.inv(transitions)
    B, dB = inverse[:, :n, n:], -(inverse @ errors @ inverse)[:, :n, n:]
    C, dC = transitions[:, n:, :n], errors[:, n:, :n]
    return (-B @ C)[:, None], (-dB @ C - B @ dC)[:, None]


def _blocks(matrices: Array, n: int) -> tuple[Array, Array, Array, Array]:
    return matrices[:, :n, :n], matrices[:, :n, n:], matrices[:, n:, :n], matrices[:, n:, n:]


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + matrices.swapaxes(-1, -2)))


def orthogonal_complements(directions: Array) -> Array:
    """Orthonormal bases of what is orthogonal to each direction, smooth along them; (points, n) -> (points, n, n - 1).

    A reflection maps each direction to that of the middle one, whose complement is the same for all.
    """
    n = directions.shape[1]
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    middle = unit[len(unit) // 2]
    fixed = np.linalg.qr(np.column_stack([middle, np.eye(n)]))[0][:, 1:]
    u = unit + middle
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    return np.asarray(fixed - 2.0 * u[:, :, None] * (u @ fixed)[:, None, :])
