"""A family as a power series in S, and how far it converges: the singularity nearest to S = 0 in the complex plane.

Near a branch point or a pole x_0 the series F = sum_k F_k x^k solves Q_1 F' + Q_0 F = P with polynomials of low degree,
Q_1(x_0) = 0 (differential approximants: Hunter and Baker 1979). Q_1 and Q_0 follow from coefficients of orders above
the degree of P, which they make vanish. Roots of Q_1 that approximants of most degrees have in common are singularities
of F; others come from rounding, or stand for cuts. Most families end at a pair of complex folds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike, NDArray

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import LARGEST_FAMILY_SIZE
from casadi_skin.model.arguments import number, short_repr, whole, with_error
from casadi_skin.model.expressions import real_array
from casadi_skin.model.polynomial import NotPolynomialError
from casadi_skin.model.result import Result, in_turn
from casadi_skin.zero.amplitude_series import amplitude_series
from casadi_skin.zero.cosines import PolynomialForm
from casadi_skin.zero.problem import Array

MOST_ORDERS = 200
# Of 150 planted series of three branch points or poles each the radius is within its error in 97 per cent from order 12
# on: 83 at order 8.
FEWEST_ORDERS = 6  # that the radius of convergence is estimated from
WEAKEST_DECAY = 1.5  # coefficients beside a square root fall as R^-k k^-1.5
FALLBACK_ERROR = 0.5  # of a radius that approximants do not agree on
DEGREE_SHARES, LOWEST_SHARES = (6, 4, 3), (8, 4)  # of the orders: degrees of Q_1 and Q_0; of P, or 0
ORDERS_DROPPED = 3  # series of the last orders, with which approximants are made
SAME_SINGULARITY_RTOL = 0.03
NEEDED_SHARES = (0.8, 0.6, 0.5)  # of the approximants that have a root in common, tried in turn
QUANTILES, SPREAD_FACTOR = (0.2, 0.8), 2.0  # of the moduli of their roots
RECENTRED = 2  # times that a common root is sought again about the middle


@dataclass(frozen=True, eq=False)
class FamilySeries(Result):
    """Omega = sum_k Omega[k] x^k and y_n(t) = sqrt(S) sum_k x^k sum_i profile[k, i, n] cos(harmonics[i] Omega t).

    x is S where all forces are odd; else sqrt(S). Errors are those of rounding, absolute.

    Attributes:
        variable: "S" or "sqrt(S)".
        mode: number of the linear mode.
        Omega, Omega_error: coefficients and their errors, shape (order + 1,).
        harmonics: numbers of the harmonics, shape (harmonics,).
        positions: names, in the order of the profile.
        profile, profile_error: shape (order + 1, harmonics, positions).
        singularity: the nearest in x, of those that show in the coefficients; of a pair the upper one, and NaN where
            approximants do not agree.
        radius, radius_error: of convergence, in S.
    """

    variable: str
    mode: int
    Omega: Array
    Omega_error: Array
    harmonics: NDArray[np.int64]
    positions: tuple[str, ...]
    profile: Array
    profile_error: Array
    singularity: complex
    radius: float
    radius_error: float

    def __repr__(self) -> str:
        words = f"order {self.order} in {self.variable}, radius in S {self.radius_in_words}"
        return f"<FamilySeries: mode {self.mode}, {words}>"

    @property
    def radius_in_words(self) -> str:
        """The radius with its error, or why there is none."""
        if np.isfinite(self.radius):
            return with_error(self.radius, self.radius_error)
        few = f"of order {FEWEST_ORDERS} and more" if self.order < FEWEST_ORDERS else "of two coefficients that show"
        return f"unknown: it is estimated {few}" if np.isnan(self.radius) else "infinite"

    @property
    def order(self) -> int:
        """Highest power of x."""
        return self.Omega.size - 1

    @property
    def digits(self) -> Array:
        """Decimal digits of the coefficients of Omega that rounding leaves, shape (order + 1,)."""
        return np.maximum(-np.log10(self.Omega_error / np.maximum(np.abs(self.Omega), self.Omega_error)), 0.0)

    def _x(self, S: ArrayLike) -> Array:
        return np.asarray(S, dtype=float) if self.variable == "S" else np.sqrt(S)

    def frequency(self, S: ArrayLike, order: int | None = None) -> Array:
        """The sum of Omega at S, up to an order, of all by default; shape of S."""
        last, S = self.order if order is None else whole("order", order, 0, self.order), real_array("S", S)
        if np.any(S < 0.0):
            raise ValueError(f"S: given {short_repr(S)}; accepted: numbers >= 0")
        return np.asarray(polyval(self._x(S), self.Omega[: last + 1]))

    def frequency_error(self, S: ArrayLike) -> Array:
        """Estimated error of `frequency` with all orders, shape of S; infinite beyond the radius less its error.

        Of orders left out |Omega_k| R^k is taken to be no larger than in the last half of the series.
        """
        x, count = np.abs(self._x(S)), self.Omega.size
        radius = float(self._x(max(self.radius - self.radius_error, 0.0)))
        ratio, k = np.divide(x, radius, out=np.ones_like(x), where=x < radius), np.arange(count // 2, count)
        parts = np.abs(self.Omega[k]) * x[..., None] ** k * ratio[..., None] ** (count - k)
        left_out = np.divide(np.max(parts, axis=-1), 1.0 - ratio, out=np.full_like(x, np.inf), where=ratio < 1.0)
        return np.asarray(left_out + polyval(x, self.Omega_error))

    def displacements(self, S: float, t: ArrayLike) -> Array:
        """The sum of y_n(t) at S with all orders, shape (t, positions)."""
        theta = self.frequency(number("S", S)) * np.atleast_1d(np.asarray(t, dtype=float))
        cosines = np.sqrt(S) * np.einsum("k,kin->in", self._x(S) ** np.arange(self.order + 1), self.profile)
        return np.asarray(np.cos(np.outer(theta, self.harmonics)) @ cosines)


@in_turn
def series(branch: Branch, order: int = 20) -> FamilySeries:
    """The family as a power series about its linear mode, with its radius of convergence.

    Arguments:
        branch: a family of `follow_family`, of any length, whose forces are polynomials.
        order: highest power of S; of sqrt(S) where forces are not odd.

    Returns:
        Coefficients of Omega and of the profile, with errors.

    Raises:
        ValueError: the branch is no family, its forces are no polynomials, or its tail is endless.
        ArithmeticError: a harmonic of the linear mode is in resonance, or numbers leave double precision.
    """
    if not branch.space.is_family:
        raise ValueError(f"series: given a branch in {branch.parameter}; accepted: a family of follow_family")
    branch.space.coordinates.check_whole("a series")
    coordinates, order = branch.space.whole.coordinates, whole("order", order, 1, MOST_ORDERS)
    size, name = coordinates.mode.size, coordinates.model.name
    if size * order**2 > LARGEST_FAMILY_SIZE:
        most = int((LARGEST_FAMILY_SIZE / size) ** 0.5)
        raise ValueError(f"order: given {order}; accepted with {size} positions: a whole number from 1 to {most}")
    try:
        form = PolynomialForm.of(coordinates.solved)
    except NotPolynomialError:
        raise ValueError(f"series: given forces of {name} that are no polynomials; accepted: polynomials") from None
    odd, unit = coordinates.S_rate == 1.0, float(coordinates.parameter_of(1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        harmonics, found, errors = amplitude_series(form, coordinates.mode, coordinates.frequency**2, order, odd)
        units = unit ** np.arange(order + 1)
        Omega, Omega_error = units * found[0], np.abs(units) * errors[0]
        as_samples: Any = SimpleNamespace(sample=lambda cosines, _: cosines)  # coefficients are scaled as samples are
        profile, profile_error = (
            np.array([coordinates.displacements(as_samples, c, harmonics, None) for c in by[:, None, None] * part])
            for by, part in ((units, found[1]), (np.abs(units), errors[1]))
        )
    if not (np.all(np.isfinite(Omega_error)) and np.all(np.isfinite(profile_error))):
        raise ArithmeticError(f"series: coefficients up to order {order} leave the range of double precision")
    place, radius, radius_error = nearest_singularity(np.where(np.abs(Omega) > Omega_error, Omega, 0.0))
    if not odd:
        radius, radius_error = radius**2, 2.0 * radius * radius_error
    return FamilySeries(
        "S" if odd else "sqrt(S)", int(coordinates.mode_number), Omega, Omega_error, harmonics,
        tuple(coordinates.position_names), profile, profile_error, place, radius, radius_error,
    )  # fmt: skip


# The radius of convergence --------------------------------------------------------------------------------------------


def nearest_singularity(F: Array) -> tuple[complex, float, float]:
    """The singularity of a power series F next to 0 that shows in its coefficients, its modulus, and the error of that.

    The modulus alone, from the decay of coefficients, where approximants of different degrees do not agree; infinite
    where all of the later ones are zero.
    """
    later = np.flatnonzero(F)
    later = later[later >= max(F.size // 2, 1)]
    if F.size <= FEWEST_ORDERS or later.size < 2:
        everywhere = F.size > FEWEST_ORDERS and not later.size
        return complex("nan"), *((np.inf, 0.0) if everywhere else (np.nan, np.inf))
    unit = float(np.exp(-np.polyfit(later, np.log(np.abs(F[later])), 1)[0]))
    scaled = F * unit ** np.arange(F.size)
    roots = [each for last in range(F.size - ORDERS_DROPPED, F.size) for each in _roots(scaled[: last + 1])]
    pool = np.concatenate(roots)
    for needed in NEEDED_SHARES:
        for root in sorted(pool[pool.imag >= 0.0], key=abs):
            for _ in range(1 + RECENTRED):
                nearest = np.array([each[np.argmin(np.abs(each - root))] for each in roots if each.size])
                common = nearest[np.abs(nearest - root) < SAME_SINGULARITY_RTOL * abs(root)]
                if common.size < needed * len(roots):
                    break
                root = complex(np.median(common.real), np.median(common.imag))
            else:
                low, high = np.quantile(np.abs(common), QUANTILES)
                blurred = abs(root) / (F.size - 1) ** 2  # singularities so near to one another look like one
                return unit * root, unit * abs(root), float(unit * (SPREAD_FACTOR * (high - low) + blurred))
    decay = np.polyfit(later, np.log(np.abs(F[later])) + WEAKEST_DECAY * np.log(later), 1)[0]
    return complex("nan"), float(np.exp(-decay)), FALLBACK_ERROR * float(np.exp(-decay))


def _roots(F: Array) -> Iterator[NDArray[np.complex128]]:
    """Roots of Q_1 within a factor of three of the unit circle, for polynomials of several degrees."""
    orders, F = F.size - 1, F / np.max(np.abs(F[1:]))
    slope = np.arange(1, orders + 1) * F[1:]
    for share in DEGREE_SHARES:
        for lowest in (0, *(orders // part for part in LOWEST_SHARES)):
            degree = max(orders // share, 2)
            other = min(degree, orders - 2 - lowest - degree)
            if other < 0:
                continue
            parts = []
            for f, last in ((slope, degree), (F, other)):
                places = np.arange(lowest + 1, orders)[:, None] - np.arange(last + 1)
                parts.append(np.where(places >= 0, f[np.maximum(places, 0)], 0.0))
            found = np.roots(np.linalg.svd(np.hstack(parts))[2][-1, degree::-1])
            yield found[(np.abs(found) > 1.0 / 3.0) & (np.abs(found) < 3.0)]
