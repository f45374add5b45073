"""The stability of one orbit as numbers: its multipliers with their errors and kinds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.result import Result, warn_caller
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.problem import Array, Indices

Booleans = NDArray[np.bool_]
LARGEST_LOGARITHM = float(np.log(np.finfo(float).max))
ERROR_DIRECTIONS = np.exp(0.25j * np.pi * np.arange(8))  # in which a mu off the real axis may be wrong


class TrivialMultiplierWarning(UserWarning):
    """A multiplier that is 1 for every orbit has drifted from it: the others are not to be trusted either."""


class HugeMultiplierWarning(UserWarning):
    """A multiplier exceeds the largest double."""


class LostMultiplierWarning(UserWarning):
    """Several multipliers are so far from 1 that maps over the intervals of the mesh have lost their digits."""


@dataclass(frozen=True, eq=False, repr=False)
class Floquet(Result):
    """Linear stability of one orbit, from its multipliers, each with an error by which it is judged.

    Attributes:
        multipliers: all multipliers over the period, the trivial ones first, shape (components of the full state,);
            those of a reversible orbit then as lambda, 1/lambda of each mu in turn.
        log_moduli: natural logarithms of their moduli, also of those that no double holds; -inf of zeros.
        trivial: number of multipliers that are 1 for every orbit: one in an autonomous model, two in a conservative or
            reversible one, two more for each momentum that is conserved, none in a forced one.
        trivial_deviation: distance of the trivial ones from their exact value.
        other_errors: estimated absolute errors of `others`, of one shape with them.
        on_circle: which of `others` lie on the unit circle, within estimated errors.
        real: which of `others` are real within estimated errors, of those off the unit circle.
        error: estimated absolute error of the multipliers; relative of those that are larger than 1. The largest of
            those that are not inside the circle by more than their error; of all where all are. Of a reversible orbit
            the largest of any mu and, where it is unstable, of `max_abs_multiplier`.
        max_abs_multiplier: largest modulus of a multiplier, the trivial ones left out; 1 for a stable reversible orbit.
        mu, mu_error: eigenvalues of B^T C with their errors, of reversible orbits; empty of others. Where there is a
            `tail`, its cut is in the errors.
        power: of the map M of mu, lambda(M) + 1/lambda(M) = 2 + 4 mu, that gives the multipliers: 2 or 1.
        tail: of an orbit at the edge of a long linear tail, whose multipliers are those of localised vectors alone:
            the waves of the tail; None of others.
        counted: number of localised multipliers outside the circle of an infinite tail, by Hill's determinant, which
            nothing cuts: it decides `stable`, and how many are unstable. None where they are not counted.
        monodromy: matrix over the full period at phase zero, shape (n, n); None where it was not formed.
        allowed_deviation: largest `trivial_deviation` of multipliers that can be trusted.
        lost: whether maps over intervals have lost digits of multipliers that are far from 1.
        beyond: no multiplier that is left out has a larger modulus: of large systems the leading ones alone are
            computed. 0 where all are in the list, infinite where no bound was computed.
        blurred: how many multipliers are smaller than the errors of sensitivities: their logarithms are not known.
    """

    multipliers: ComplexArray
    log_moduli: Array
    trivial: int
    trivial_deviation: float
    other_errors: Array
    on_circle: Booleans
    real: Booleans
    error: float
    max_abs_multiplier: float
    mu: ComplexArray
    mu_error: Array
    power: int = 1
    tail: CutTail | None = None
    counted: int | None = None
    monodromy: Array | None = None
    allowed_deviation: float = np.inf
    lost: bool = False
    blurred: int = 0
    beyond: float = 0.0

    def __repr__(self) -> str:
        largest = f"largest modulus {self.max_abs_multiplier:.8g}, " if self.others.size else ""
        words = "stable" if self.stable else "unstable"
        return f"<{type(self).__name__}: {self.multipliers.size} multipliers, {largest}error {self.error:.1e}; {words}>"

    @property
    def others(self) -> ComplexArray:
        """Multipliers but the trivial ones."""
        return self.multipliers[self.trivial :]

    def passing(self, angle: float) -> Floquet:
        """Those of an orbit one of whose multipliers is exp(i angle): errors of all are no less than it is off by."""
        off = np.min(np.abs(self.others - np.exp(1j * angle)), initial=np.inf)
        errors = np.maximum(self.other_errors, off * np.maximum(1.0, np.abs(self.others)))
        on_circle, real, error = verdicts(self.others, errors)
        return replace(self, other_errors=errors, on_circle=on_circle, real=real, error=error)

    @cached_property
    def exponents(self) -> Exponents:
        """Logarithms of `others` with their errors, down to the smallest where a multiplier may be zero, or outside."""
        moduli = np.maximum(self.log_moduli[self.trivial :], SMALLEST_LOGARITHM)
        with np.errstate(over="ignore"):
            noise = np.log1p(self.other_errors * np.exp(-moduli))
        any_size = (noise >= SIGN_NOISE) & (moduli + noise > 0.0)
        noise = np.where(any_size, np.maximum(noise, moduli - SMALLEST_LOGARITHM), noise)
        return Exponents(moduli + 1j * np.angle(self.others), noise)

    @property
    def outside(self) -> Booleans:
        """Which of `others` lie off the unit circle on its outside, by more than errors allow."""
        return ~self.on_circle & (np.abs(self.others) > 1.0)

    @property
    def stable(self) -> bool:
        """Whether no multiplier lies outside the unit circle, within estimated errors, of those left out either."""
        if self.counted is not None:
            return self.counted == 0
        return not (np.any(self.outside) or self.beyond >= 1.0)

    @property
    def listed(self) -> int:
        """Number of multipliers outside the circle in the list, which of a cut tail may not have all."""
        return int(np.count_nonzero(self.outside))

    @property
    def unstable_real(self) -> int:
        """Number of multipliers outside the unit circle on the real axis.

        Where they are counted, the nearest to the list's, as complex ones come in twos.
        """
        real = int(np.count_nonzero(self.outside & self.real))
        return real if self.counted is None else min(real + (self.counted - real) % 2, self.counted)

    @property
    def unstable_complex(self) -> int:
        """Number of multipliers outside the unit circle off the real axis; a complex pair counts two."""
        return (self.listed if self.counted is None else self.counted) - self.unstable_real

    @property
    def log10_abs_multipliers(self) -> Array:
        """Decimal logarithms of the moduli of all multipliers, also of those that no double holds; -inf of zeros."""
        return np.asarray(self.log_moduli / np.log(10.0))

    @property
    def beyond_doubles(self) -> bool:
        """Whether a multiplier exceeds the largest double, which stands for it."""
        return bool(np.any(self.log_moduli > LARGEST_LOGARITHM))

    def warn(self) -> None:
        """Warn where the trivial multipliers have drifted by more than errors allow, and where digits are lost."""
        if self.trivial_deviation > self.allowed_deviation:
            words = f"the trivial multiplier is off by {self.trivial_deviation:.1e}"
            words += f", more than {self.allowed_deviation:.1e}; try a smaller tolerance"
            warn_caller(words, TrivialMultiplierWarning)
        if self.lost:
            words = "several multipliers are far from 1, and what grows and decays is not resolved: not even"
            warn_caller(f"{words} their orders of magnitude are known", LostMultiplierWarning)
        if self.blurred:
            words = f"{self.blurred} of the multipliers by cvodes are smaller than errors of its sensitivities: their"
            words += " orders of magnitude are not known; collocation has them"
            warn_caller(words, LostMultiplierWarning)
        if self.beyond_doubles:
            huge = int(np.count_nonzero(self.log_moduli > LARGEST_LOGARITHM))
            words = f"{huge} of the multipliers exceed the largest double, which stands for them"
            warn_caller(f"{words}: see log10_abs_multipliers", HugeMultiplierWarning)


def verdicts(others: ComplexArray, errors: Array) -> tuple[Booleans, Booleans, float]:
    """Which multipliers with these errors lie on the unit circle, which are real, and their error as a whole."""
    moduli = np.abs(others)
    decisive, relative = moduli >= 1.0 - errors, errors / np.maximum(1.0, moduli)
    error = float(relative[decisive | (not decisive.any())].max(initial=0.0))
    return np.abs(moduli - 1.0) <= errors, np.abs(others.imag) <= errors, error


def root_of(mu: ComplexArray, mu_error: Array) -> tuple[ComplexArray, Booleans, Booleans]:
    """sqrt(mu) + sqrt(1 + mu) with modulus >= 1, whose square is lambda(M); on the unit circle for a stable mu.

    Beside it which mu are real and in [-1, 0] within their errors, that is stable, and which are real within them.
    """
    real = np.abs(mu.imag) <= mu_error
    stable = real & (mu.real >= -1.0 - mu_error) & (mu.real <= mu_error)
    mu = np.where(stable, np.clip(mu.real, -1.0, 0.0), np.where(real, mu.real, mu)) + 0j
    root = np.sqrt(mu) + np.sqrt(1.0 + mu)
    return np.where(~stable & (np.abs(root) < 1.0), 1.0 / root, root), stable, real


def reversible_floquets(
    mu: ComplexArray, mu_error: Array, trivial_deviations: Sequence[float], power: int, pairs: int = 1
) -> list[Floquet]:
    """Stability of reversible orbits with n positions, from n - k values of mu beside k pairs of trivial multipliers.

    Of these `pairs` one is of time and of the family, one of each momentum that is conserved; mu and its errors have
    shape (orbits, n - k). The errors of the multipliers are from those at mu changed by its error: near the circle they
    go with the root of mu.
    """
    count, (root, stable, real) = len(mu), root_of(mu, mu_error)
    directions = np.where(real, np.sign(ERROR_DIRECTIONS.real)[:, None, None], ERROR_DIRECTIONS[:, None, None])
    moved = np.where(real, mu.real, mu) + mu_error * directions + 0j
    own, moved = (
        np.stack([outer, 1.0 / outer], axis=-1)  # the multipliers of a mu, in either order
        for outer in (root ** (2 * power), (np.sqrt(moved) + np.sqrt(1.0 + moved)) ** (2 * power))
    )
    errors = np.max(np.min(np.abs(own[..., :, None] - moved[..., None, :]), axis=-1), axis=0)
    moduli, away = np.where(stable, -np.inf, np.abs(own[..., 0])), errors[..., 0]
    largest, error = (np.max(each, axis=1, initial=least) for each, least in ((moduli, 1.0), (mu_error, 0.0)))
    with np.errstate(invalid="ignore"):
        high, low = (np.max(moduli + sign * away, axis=1, initial=-np.inf) for sign in (1.0, -1.0))
        off = np.where(stable.all(axis=1), 0.0, np.maximum(high - largest, largest - low))
    multipliers = np.concatenate([np.ones((count, 2 * pairs), complex), own.reshape(count, -1)], axis=1)
    logs, errors, error = np.log(np.abs(multipliers)), errors.reshape(count, -1), np.fmax(error, off)
    on_circle, real = np.repeat(stable, 2, axis=1), np.repeat(real, 2, axis=1)
    return [
        Floquet(
            multipliers[k], logs[k], 2 * pairs, trivial_deviations[k], errors[k], on_circle[k], real[k],
            float(error[k]), float(largest[k]), mu[k], mu_error[k], power,
        )
        for k in range(count)
    ]  # fmt: skip


def reversible_floquet(mu: ComplexArray, mu_error: Array, trivial_deviation: float, power: int) -> Floquet:
    """The same of one orbit."""
    return reversible_floquets(mu[None], mu_error[None], [trivial_deviation], power)[0]


# The continuous spectrum of an orbit at the edge of an infinite linear medium: arcs of the unit circle in closed form

HALF_TURN = np.pi
TOUCHING_ARC_LENGTH = 1e-12  # length of an overlap of arcs that only meet, as where the orbit is pinned to its band


@dataclass(frozen=True)
class Overlap:
    """Arcs of opposite signature that overlap: waves of two bands with omega + omega' = power `order` Omega.

    `bands` are their numbers from 0; `mu` is the interval in which both lie, `angles` the one of omega T that waves of
    the first band have there.
    """

    bands: tuple[int, int]
    order: int
    mu: tuple[float, float]
    angles: tuple[float, float]


@dataclass(frozen=True)
class ContinuousSpectrum:
    """Multipliers of the waves of linear bands, for an orbit of frequency Omega.

    Attributes:
        Omega: frequency of the orbit.
        bands: lowest and highest frequency of each band.
        power: of the map M whose multipliers to this power are those over the period: 2 or 1.
    """

    Omega: float
    bands: tuple[tuple[float, float], ...]
    power: int

    @property
    def arcs(self) -> Array:
        """Angles omega T between which the multipliers of each band lie, not reduced to a turn, shape (bands, 2).

        The multipliers of opposite signature have the opposite angles.
        """
        return 2.0 * np.pi * np.asarray(self.bands, dtype=float).reshape(-1, 2) / self.Omega

    @property
    def mu(self) -> Array:
        """Intervals of mu, shape (bands, 2)."""
        return np.array([_interval(low, high) for low, high in self._phases]).reshape(-1, 2)

    @property
    def _phases(self) -> Array:
        return self.arcs / (2.0 * self.power)

    @property
    def overlaps(self) -> tuple[Overlap, ...]:
        """Where arcs of opposite signature overlap, in order of bands and of the resonance."""
        found, phases = [], self._phases
        for a in range(len(phases)):
            for b in range(a, len(phases)):
                (low, high), (other_low, other_high) = phases[a], phases[b]
                first, last = np.ceil((low + other_low) / HALF_TURN), np.floor((high + other_high) / HALF_TURN)
                for order in range(int(first), int(last) + 1):
                    start = max(low, order * HALF_TURN - other_high)
                    end = min(high, order * HALF_TURN - other_low)
                    if end - start <= TOUCHING_ARC_LENGTH:
                        continue
                    mu = _interval(start, end)
                    angles = (2.0 * self.power * float(start), 2.0 * self.power * float(end))
                    found.append(Overlap((a, b), order, mu, angles))
        return tuple(found)

    def distance(self, mu: Array) -> Array:
        """Distances of values of mu from those of the bands, of the shape of `mu`."""
        nearest = np.full(np.shape(mu), np.inf)
        for low, high in self.mu:
            nearest = np.minimum(nearest, np.abs(mu - np.clip(np.real(mu), low, high)))
        return nearest


def _interval(low: float, high: float) -> tuple[float, float]:
    """Smallest and largest -sin^2 between two phases."""
    ends = -(np.sin([low, high]) ** 2)
    turns = np.arange(np.ceil(2.0 * low / np.pi), np.floor(2.0 * high / np.pi) + 1.0)
    between = np.where(turns % 2.0 == 0.0, 0.0, -1.0)
    values = np.concatenate([ends, between])
    return float(np.min(values)), float(np.max(values))


@dataclass(frozen=True, eq=False)
class CutTail:
    """The long linear tail that an orbit is at the edge of: its waves, and what is left of them where it is cut.

    Attributes:
        continuous: the multipliers of waves in closed form.
        sites: number of sites of the cut variational problem.
        finite_size: mu of this problem off the circle that are not localised: they depend on the number of sites, and
            say nothing about an infinite tail.
        unresolved: mu of this problem off the circle that decay into the tail, but not by as much as the tolerance
            asks for: more sites decide.
    """

    continuous: ContinuousSpectrum
    sites: int
    finite_size: ComplexArray
    unresolved: ComplexArray

    @property
    def finite_size_modulus(self) -> float:
        """Largest modulus of a multiplier of `finite_size`; 1 without any."""
        return self.of_finite_size.max_abs_multiplier

    @property
    def of_finite_size(self) -> Floquet:
        """The multipliers of `finite_size`, beside the trivial pair."""
        return reversible_floquet(self.finite_size, np.zeros(self.finite_size.size), 0.0, self.continuous.power)


# Multipliers of one orbit by their logarithms -------------------------------------------------------------------------

SMALLEST_LOGARITHM = float(np.log(np.finfo(float).tiny))  # of multipliers that are below the smallest double
RECIPROCAL_RTOL = 1e-7  # of a product mu_k mu_l that is 1 by a symmetry; dissipation within a period is seldom less
SIGN_NOISE = float(np.log(2.0))  # of a logarithm: an error as large as the multiplier itself
RECIPROCAL_NOISE = 1e-3  # largest error of a logarithm with which that product may be off
FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Exponents:
    """Multipliers of one orbit by their logarithms.

    Attributes:
        values: log mu, shape (m,).
        noise: estimated errors of these, shape (m,).
    """

    values: ComplexArray
    noise: Array

    def of_size(self, count: int) -> Exponents:
        """So many of the largest modulus; in place of those that are left out the smallest modulus of the list."""
        size = self.values.size
        if count == size:
            return self
        places = np.argsort(-self.values.real, kind="stable")[np.minimum(np.arange(count), size - 1)]
        values = np.where(np.arange(count) < size, self.values[places], self.values[places].real)
        return Exponents(values, self.noise[places])

    @cached_property
    def pairs(self) -> Indices | None:
        """Places of mu and of 1/mu, shape (m / 2, 2); None where multipliers are not such pairs."""
        values, noise, found = self.values.tolist(), self.noise.tolist(), list[tuple[int, int]]()
        left = list(range(len(values)))
        if len(left) % 2 or abs(self.values.real.sum()) > len(left) * (RECIPROCAL_RTOL + RECIPROCAL_NOISE):
            return None

        def off(k: int, other: int) -> float:
            total = values[k] + values[other]
            return math.hypot(total.real, math.remainder(total.imag, FULL_TURN))

        while left:
            k = max(left, key=lambda place: abs(values[place].real))
            left.remove(k)
            nearest = min(left, key=lambda other: off(k, other))
            if not off(k, nearest) <= RECIPROCAL_RTOL + min(noise[k] + noise[nearest], RECIPROCAL_NOISE):
                return None
            left.remove(nearest)
            found.append((k, nearest))
        return np.array(found, dtype=int).reshape(-1, 2)

    @cached_property
    def outside(self) -> tuple[int, int]:
        """The number of multipliers outside the circle by their values, and how many may be on either side of it."""
        pairs = self.pairs
        if pairs is None:
            away, noise = self.values.real, self.noise
        else:
            tau, noise = self.traces(pairs)
            away = np.where(tau.imag != 0.0, np.inf, np.abs(tau.real) - 2.0)
        return int(np.count_nonzero(away > 0.0)), int(np.count_nonzero(np.abs(away) <= noise))

    @cached_property
    def beyond(self) -> tuple[int | None, int | None] | None:
        """Whether the numbers of real multipliers above 1 and below -1 are odd: the signs of det(M - 1) and det(M + 1).

        Complex ones come in twos. None for one that errors leave open, or where these are not known; and in place of
        both where errors are as large as a multiplier, which has no sign.
        """
        odd: list[int | None] = [0, 0]
        for value, noise in zip(self.values.tolist(), self.noise.tolist(), strict=True):
            if SIGN_NOISE <= noise < math.inf and value.real > -noise:
                return None
            for k, off in enumerate((abs(value.imag), np.pi - abs(value.imag))):
                so_far = odd[k]
                if so_far is None or math.hypot(value.real, off) <= noise:
                    odd[k] = None
                elif off == 0.0 and value.real > 0.0:
                    odd[k] = 1 - so_far
        return odd[0], odd[1]

    def traces(self, pairs: Indices) -> tuple[ComplexArray, Array]:
        """tau of each pair, mu + 1/mu, and its error."""
        one, other = np.clip(self.values.real[pairs], -300.0, 300.0).T + 1j * self.values.imag[pairs].T
        tau = np.cosh(one) + np.cosh(other)
        slope = np.abs(np.sinh(one)) + np.abs(np.sinh(other))
        noise = np.minimum(self.noise[pairs].max(axis=1), 1.0)
        on_axis = np.abs(tau.imag) <= 0.5 * slope * noise + noise**2
        return np.where(on_axis, tau.real, tau), slope * noise + noise**2


def turned(values: ComplexArray, turn: float = FULL_TURN) -> ComplexArray:
    """Logarithms with imaginary parts in [-pi, pi]; eigenvalues, whose turn is infinite, as they are."""
    return np.asarray(values - 1j * turn * np.rint(values.imag / turn)) if math.isfinite(turn) else values
