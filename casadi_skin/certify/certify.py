"""`certify`: a proof that an orbit of a polynomial model exists, with as many harmonics as it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.arguments import number, short_repr
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.certify import balls
from casadi_skin.certify.bounds import FiniteInverse, proved_radius, uniqueness_radius
from casadi_skin.certify.model_terms import energy_terms, evaluate, system_of
from casadi_skin.certify.odd_system import OddSeries, OddSystem, Terms
from casadi_skin.orbits.certificate import NO_ABSENCE, Certificate, Constants, Interval
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.threads import one_thread

if TYPE_CHECKING:
    from flint import arb

WEIGHT = 1.02
LARGEST = 6000  # finite unknowns: the inverse takes a minute and a gigabyte
MARGIN = 4  # harmonics beyond those that carry the orbit at its tolerance
GROWTH = 1.4  # of the number of harmonics after a trial
TRIALS = 8
FINE = 1e-17  # radius relative to the norm that is below what doubles tell apart
STEPS = 12  # of the iteration that refines the coefficients
NOTHING = (float("nan"), float("nan"))
ACCEPTED = "an orbit of a family whose model is of second order, odd and reversible, as sums of odd cosines"


def certify(orbit: Orbit, harmonics: int | None = None, weight: float = WEIGHT) -> Certificate:
    """Prove that an orbit exists near a computed one, by the Newton-Kantorovich theorem in ball arithmetic.

    Arguments:
        orbit: an orbit of a family whose model is of second order with odd polynomial forces, as a finite chain with
            |gamma| < 1 or an `OdeModel` with its half-period symmetry.
        harmonics: odd harmonics of the finite part; as many as a proof needs by default.
        weight: nu > 1 of the norm; the orbit is proved to be analytic in the strip |Im theta| < log(nu).

    Returns:
        Enclosures of the orbit's quantities with the theorem's constants, or the reason why there is no proof.

    Raises:
        ValueError: the model has no such forces or the orbit no such symmetry, in one line.
        ImportError: python-flint (the extra "certify") is missing.
    """
    flint = balls.flint()
    if number("weight", weight) <= 1.0:
        raise ValueError(f"weight: given {weight!r}; accepted: a finite number > 1")
    if harmonics is not None and (isinstance(harmonics, bool) or not isinstance(harmonics, int) or harmonics < 1):
        raise ValueError(f"harmonics: given {short_repr(harmonics)}; accepted: a whole number >= 1")
    with flint.ctx.workprec(balls.PRECISION), one_thread():
        family, attempt = best_attempt(orbit, harmonics, weight)
        return _certificate(orbit, family, attempt)


def best_attempt(orbit: Orbit, harmonics: int | None = None, weight: float = WEIGHT) -> tuple[Family, Attempt]:
    """What proves most of an orbit, in the precision of balls that is set; raises ValueError as `certify` does."""
    if not isinstance(orbit.space, Family):
        raise ValueError(f"certify: given an orbit of {orbit.model.name}; accepted: {ACCEPTED}")
    family = provable(orbit.space)
    system = system_of(family.coordinates, orbit.S)
    if harmonics is not None:
        return family, _attempt(orbit, system, harmonics, weight)
    best, H = None, orbit.harmonics + MARGIN
    for _ in range(TRIALS):
        attempt = _attempt(orbit, system, H, weight)
        if best is None or attempt.better_than(best):
            best = attempt
        elif not best.proved and attempt.constants.Z > 0.9 * best.constants.Z:
            break
        H = int(np.ceil(GROWTH * H))
        if (best.proved and best.radius <= FINE * best.size) or 1 + system.positions * H > LARGEST:
            break
    assert best is not None
    return family, best


def provable(family: Family) -> Family:
    """The family with every position an unknown.

    Raises ValueError, in one line, for a family that the theorem is not about, ImportError without python-flint.
    """
    flint, coordinates = balls.flint(), family.coordinates
    if family.symmetry is not SymmetryClass.QUARTER:
        raise ValueError(f"certify: given a family of {coordinates.model.name}; accepted: {ACCEPTED}")
    if not coordinates.is_whole:
        coordinates.check_whole("a certificate")
    whole = family.whole
    if whole.coordinates.mode.size != whole.coordinates.model.size:
        raise ValueError("certify: given |gamma| = 1, where positions at rest have no scale; accepted: |gamma| < 1")
    with flint.ctx.workprec(balls.PRECISION):
        system_of(whole.coordinates, family.request.amplitude_max)
    return whole


# One number of harmonics ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Attempt:
    """The bounds at one number of harmonics about refined coefficients, with the distance of the computed orbit."""

    series: OddSeries
    weight: float
    constants: Constants
    radius: float  # about the refined coefficients; nan without a proof
    distance: float
    size: float
    per_amplitude: float = float("nan")  # |A| on the amplitude's equation: what Y grows by per unit of S
    tangent: Array | None = None  # derivative of the finite unknowns with respect to S, nearly
    fault: str = ""  # why there are no bounds

    @property
    def proved(self) -> bool:
        """Whether the theorem holds."""
        return bool(self.radius < np.inf)

    def better_than(self, other: Attempt) -> bool:
        """Whether this one proves more, or comes nearer to a proof."""
        if self.proved and other.proved:
            return self.radius < other.radius
        return self.proved or (not other.proved and self.constants.Z < other.constants.Z)


def _attempt(orbit: Orbit, system: OddSystem, harmonics: int, weight: float) -> Attempt:
    from flint import arb

    sites = np.arange(1, system.positions + 1)
    columns = orbit.coefficients(harmonics, sites).T.tolist()
    coefficients = [[(arb(c) / d).mid() for c in column] for column, d in zip(columns, system.scale, strict=True)]
    return attempt_near(OddSeries(system, arb(orbit.Omega**2), coefficients), weight)


def attempt_near(start: OddSeries, weight: float) -> Attempt:
    """The bounds about the zero of the equations that Newton's method finds near a series."""
    from flint import arb

    nu = arb(weight)
    try:
        _check_size(start.system, start.harmonics)
        inverse = FiniteInverse(start, nu)
    except ValueError as error:  # too many unknowns, or a singular matrix
        nan = float("nan")
        return Attempt(start, weight, Constants(nan, nan, nan, nan), nan, nan, nan, fault=str(error))
    series = _refined(inverse)
    bounds = FiniteInverse(series, nu, inverse.matrix)
    constants = bounds.constants()
    radius = proved_radius(constants)
    distance = _distance(start, series, nu)
    size = balls.above(_norm(series.square, series.coefficients, nu))
    proved = float("nan") if radius is None else radius
    return Attempt(series, weight, constants, proved, distance, size, float(bounds.norms[0]), bounds.matrix[:, 0])


def _check_size(system: OddSystem, harmonics: int) -> None:
    """Raises ValueError where the finite part has too many unknowns."""
    unknowns = 1 + system.positions * harmonics
    if unknowns > LARGEST:
        words = f"{unknowns} unknowns of {system.positions} positions and {harmonics} odd harmonics"
        raise ValueError(f"{words}, accepted: up to {LARGEST}")


def _refined(inverse: FiniteInverse) -> OddSeries:
    """Coefficients after steps of Newton's method with a fixed inverse, as numbers of more digits than doubles have."""
    from flint import arb

    series, last = inverse.series, np.inf
    for _ in range(STEPS):
        residual = np.array([float(value) for value in inverse.residual(series)[0]])
        step = inverse.matrix @ residual
        largest = float(np.max(np.abs(step)))
        if not largest < 0.5 * last:
            break
        last = largest
        changes = step[1:].reshape(series.system.positions, -1).tolist()
        coefficients = [
            [(a - arb(change)).mid() for a, change in zip(row, changed, strict=True)]
            for row, changed in zip(series.coefficients, changes, strict=True)
        ]
        series = OddSeries(series.system, (series.square - arb(float(step[0]))).mid(), coefficients)
    return series


def _norm(square: arb, coefficients: Sequence[Sequence[arb]], nu: arb) -> arb:
    return sum((abs(a) * nu ** (2 * i + 1) for row in coefficients for i, a in enumerate(row)), abs(square))


def _distance(one: OddSeries, other: OddSeries, nu: arb) -> float:
    """Upper bound of the norm of a difference."""
    rows = [
        [a - b for a, b in zip(*pair, strict=True)] for pair in zip(one.coefficients, other.coefficients, strict=True)
    ]
    return balls.above(_norm(one.square - other.square, rows, nu))


# What it proves -------------------------------------------------------------------------------------------------------


def _certificate(orbit: Orbit, family: Family, attempt: Attempt) -> Certificate:
    from flint import arb

    series, r, constants = attempt.series, attempt.radius, attempt.constants
    positions = series.system.positions
    square = series.square + arb(0, r) if attempt.proved else arb("nan")
    proved = attempt.proved and bool(square > 0)
    Omega: Interval = NOTHING
    period: Interval = NOTHING
    energy: Interval | None = NOTHING
    profile, digits, error, least = np.full((2, positions), np.nan), "", float("nan"), False
    if proved:
        nu = arb(attempt.weight)
        frequency = square.sqrt()
        Omega, period, digits = _ends(frequency), _ends(2 * arb.pi() / frequency), str(frequency)
        error = balls.size(arb(orbit.Omega) - frequency)
        slack = arb(0, balls.above(arb(r) / nu))
        y = [d * (q + slack) for d, q in zip(series.system.scale, series.start, strict=True)]
        profile = np.array([_ends(value) for value in y]).T
        least = any(bool(abs(row[0]) > arb(r) / nu) for row in series.coefficients)
        terms: Terms | None = energy_terms(family.coordinates, series.system.forces)
        energy = None if terms is None else _ends(evaluate(terms, y))
    return Certificate(
        proved=proved,
        Omega=Omega,
        period=period,
        energy=energy,
        profile=profile,
        Omega_digits=digits,
        Omega_error=error,
        radius=float(np.nextafter(r + attempt.distance, np.inf)),
        uniqueness=max(0.0, uniqueness_radius(constants, r) - attempt.distance) if proved else float("nan"),
        size=attempt.size,
        least_period=least,
        S=orbit.S,
        constants=constants,
        harmonics=series.harmonics,
        weight=attempt.weight,
        scale=np.array([float(d) for d in series.system.scale]),
        reason="" if proved else reason_of(attempt),
        versions=_versions(),
    )


def _ends(ball: arb) -> Interval:
    return balls.below(ball), balls.above(ball)


def reason_of(attempt: Attempt) -> str:
    """Which constant is too large, and what would help."""
    c, H = attempt.constants, attempt.series.harmonics
    if attempt.fault:
        return f"{attempt.fault}; {NO_ABSENCE}"
    if not c.Z < 1.0:
        words = f"Z = {c.Z:.3g} with {H} odd harmonics, accepted: below 1"
        help_ = "more harmonics, another weight, or an orbit farther from a fold or a branch point"
    elif not 2.0 * c.Y * c.W < (1.0 - c.Z) ** 2:
        bound = (1.0 - c.Z) ** 2 / (2.0 * c.W)
        words = f"Y = {c.Y:.3g} with {H} odd harmonics, accepted: below {bound:.3g} at this Z and W"
        help_ = "an orbit computed more accurately, or more harmonics"
    else:
        words, help_ = "the radius reaches beyond what W is a bound for, or to Omega = 0", "more harmonics"
    return f"{words}; what may help: {help_}; {NO_ABSENCE}"


def _versions() -> dict[str, str]:
    from casadi_skin._version import __version__

    flint: Any = balls.flint()
    return {
        "casadi_skin": __version__,
        "numpy": np.__version__,
        "python-flint": flint.__version__,
        "FLINT": flint.__FLINT_VERSION__,
    }
