"""`certify`: a proof that an orbit of a polynomial model exists, with as many harmonics as it needs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from scipy.fft import dct

from casadi_skin.certify import balls
from casadi_skin.certify.balls import arb
from casadi_skin.certify.bounds import FiniteInverse, proved_radius, series_norms, uniqueness_radius
from casadi_skin.certify.certificate import NO_ABSENCE, Certificate, Constants, Interval
from casadi_skin.certify.system import (
    CosineSeries,
    CosineSystem,
    energy_terms,
    evaluate,
    system_of,
    tailed_system,
)
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain_coordinates import LongChain
from casadi_skin.model.arguments import number, short_repr
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.result import in_turn
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.problem import Array

# The bounds of the theorem at one number of harmonics, about the zero near a computed orbit; series of orbits ---------

MOST_FINITE_UNKNOWNS = 6000  # finite unknowns: the inverse takes a minute and a gigabyte
REFINEMENT_STEPS = 12  # of the iteration that refines the coefficients
HALF_PERIOD_SAMPLES = 128  # in half a period, of orbits that need all cosines


@dataclass(frozen=True, eq=False)
class Attempt:
    """The bounds at one number of harmonics about refined coefficients, with the distance of the computed orbit."""

    series: CosineSeries
    nu: arb
    constants: Constants
    radius: float  # about the refined coefficients; nan without a proof
    distance: float
    size: float
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


def attempt_of(orbit: Orbit, system: CosineSystem, harmonics: int, weight: float) -> Attempt:
    computed = computed_series(orbit, system, harmonics)
    coefficients = [[a.mid() for a in row[:harmonics]] for row in computed.coefficients]
    return attempt_near(CosineSeries(system, computed.square.mid(), coefficients), arb(weight), computed)


def computed_series(orbit: Orbit, system: CosineSystem, harmonics: int) -> CosineSeries:
    """The doubles of an orbit as balls: its frequency, and at least so many of its coefficients and all it has."""
    count = max(harmonics, carrying(orbit, system))
    columns = cosine_coefficients(orbit, system, count).T.tolist()
    rows = [[arb(c) / d for c in column] for column, d in zip(columns, system.scale, strict=True)]
    return CosineSeries(system, arb(orbit.Omega) ** 2, rows)


def cosine_coefficients(orbit: Orbit, system: CosineSystem, count: int) -> Array:
    """Coefficients of the harmonics of an orbit in doubles, shape (count, positions)."""
    sites = np.arange(system.positions) + (1 if system.tail is None else system.tail.first_site)
    if system.step == 2:
        return orbit.coefficients(count, sites)
    samples = max(count, HALF_PERIOD_SAMPLES)
    phases = (np.arange(samples) + 0.5) * np.pi / samples
    return cosines_of(orbit.evaluate(phases / orbit.Omega, sites))[:count]


def cosines_of(values: Array) -> Array:
    """Coefficients of cos(k theta) along the first axis from values at theta = (i + 1/2) pi/len(values)."""
    coefficients = np.asarray(dct(values, axis=0)) / len(values)
    coefficients[0] *= 0.5
    return coefficients


def carrying(orbit: Orbit, system: CosineSystem) -> int:
    """How many harmonics carry an orbit at its tolerance."""
    if system.step == 2:
        return orbit.harmonics
    sizes = np.max(np.abs(cosine_coefficients(orbit, system, HALF_PERIOD_SAMPLES)), axis=1)
    return int(np.flatnonzero(sizes > orbit.space.tolerance * np.max(sizes))[-1]) + 1


def attempt_near(start: CosineSeries, nu: arb, computed: CosineSeries | None = None) -> Attempt:
    """The bounds about the zero that Newton's method finds near a series, and its distance from the computed orbit."""
    try:
        _check_size(start.system, start.harmonics)
        inverse = FiniteInverse(start, nu)
        series = refined(inverse)
        constants = FiniteInverse(series, nu, inverse.matrix).constants()
    except ValueError as error:  # too many unknowns, a singular matrix, or a tail in the band
        nan = float("nan")
        return Attempt(start, nu, Constants(nan, nan, nan, nan), nan, nan, nan, fault=str(error))
    radius = proved_radius(constants)
    away = distance(start if computed is None else computed, series, nu)
    size = balls.above(norm(series, nu))
    return Attempt(series, nu, constants, float("nan") if radius is None else radius, away, size)


def _check_size(system: CosineSystem, harmonics: int) -> None:
    """Raises ValueError where the finite part has too many unknowns."""
    unknowns = 1 + system.positions * harmonics
    if unknowns > MOST_FINITE_UNKNOWNS:
        words = f"{unknowns} unknowns of {system.positions} positions and {harmonics} harmonics"
        raise ValueError(f"{words}, accepted: up to {MOST_FINITE_UNKNOWNS}")


def refined(inverse: FiniteInverse) -> CosineSeries:
    """Coefficients after steps of Newton's method with a fixed inverse, as numbers of more digits than doubles have."""
    series, last = inverse.series, np.inf
    for _ in range(REFINEMENT_STEPS):
        step = inverse.matrix @ np.array([float(value) for value in inverse.residual(series)[0]])
        largest = float(np.max(np.abs(step)))
        if not largest < 0.5 * last:
            break
        last = largest
        changed = [(z - change).mid() for z, change in zip(series.unknowns, step.tolist(), strict=True)]
        series = CosineSeries.of(series.system, changed)
    return series


def norm(series: CosineSeries, nu: arb) -> arb:
    return sum(series_norms(series, nu), abs(series.square))


def distance(one: CosineSeries, other: CosineSeries, nu: arb) -> float:
    """Upper bound of the norm of a difference; terms that only one series has count."""
    nothing = arb(0)
    pairs = zip(one.coefficients, other.coefficients, strict=True)
    rows = [[a - b for a, b in zip_longest(*pair, fillvalue=nothing)] for pair in pairs]
    return balls.above(norm(CosineSeries(one.system, one.square - other.square, rows), nu))


HARMONIC_WEIGHT = 1.02
MOST_SITES = 500  # of a long chain whose tail is no unknown elsewhere, that are all unknowns here
HARMONICS_MARGIN = 4  # harmonics beyond those that carry the orbit at its tolerance
HARMONICS_GROWTH = 1.4  # of the number of harmonics after a trial
MOST_TRIALS = 8
FINE_RADIUS = 1e-17  # radius relative to the norm that is below the resolution of doubles
ACCEPTED_ORBITS = "an orbit of a family whose model is of second order and reversible, as sums of cosines"


@in_turn
def certify(
    orbit: Orbit, harmonics: int | None = None, weight: float = HARMONIC_WEIGHT, decimals: bool | None = None
) -> Certificate:
    """Prove that an orbit exists near a computed one, by the Newton-Kantorovich theorem in ball arithmetic.

    Arguments:
        orbit: an orbit of a family whose model is of second order with polynomial forces, as a finite chain with
            |gamma| < 1 or a reversible `OdeModel`.
        harmonics: harmonics of the finite part; as many as a proof needs by default.
        weight: nu > 1 of the norm; the orbit is proved to be analytic in the strip |Im theta| < log(nu).
        decimals: whether parameters and S are the decimals that Python prints for their doubles, 0.1 a tenth, and
            numbers in the formulas of a `Lattice` the decimals that are written, in place of the doubles; by default so
            for families of a scene, and not otherwise.

    Returns:
        Enclosures of the orbit's quantities with the theorem's constants, or the reason why there is no proof.

    Raises:
        ValueError: the model has no such forces or the orbit no such symmetry, in one line; with `decimals` also where
            a model of CasADi expressions holds a double that may stand for another decimal, as 0.1 may.
        ImportError: python-flint (the extra "certify") is missing.
    """
    flint = balls.flint()
    if number("weight", weight) <= 1.0:
        raise ValueError(f"weight: given {weight!r}; accepted: a finite number > 1")
    if harmonics is not None and (isinstance(harmonics, bool) or not isinstance(harmonics, int) or harmonics < 1):
        raise ValueError(f"harmonics: given {short_repr(harmonics)}; accepted: a whole number >= 1")
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS), one_thread():
        family, attempt = best_attempt(orbit, harmonics, weight, decimals)
        return _certificate(orbit, family, attempt, family.request.decimals if decimals is None else decimals)


def best_attempt(
    orbit: Orbit, harmonics: int | None = None, weight: float = HARMONIC_WEIGHT, decimals: bool | None = None
) -> tuple[Family, Attempt]:
    """The attempt that proves most of an orbit, in the current precision of balls; raises ValueError as `certify`."""
    if not orbit.space.is_family:
        raise ValueError(f"certify: given an orbit of {orbit.model.name}; accepted: {ACCEPTED_ORBITS}")
    decimals = orbit.space.request.decimals if decimals is None else decimals
    family = provable(orbit.space, decimals)
    system = equations_of(family, orbit.S, decimals)
    if harmonics is not None:
        return family, attempt_of(orbit, system, harmonics, weight)
    best, H = None, carrying(orbit, system) + HARMONICS_MARGIN
    for _ in range(MOST_TRIALS):
        attempt = attempt_of(orbit, system, H, weight)
        if best is None or attempt.better_than(best):
            best = attempt
        elif attempt.fault or (not best.proved and attempt.constants.Z > 0.9 * best.constants.Z):
            break
        H = int(np.ceil(HARMONICS_GROWTH * H))
        if (best.proved and best.radius <= FINE_RADIUS * best.size) or 1 + system.positions * H > MOST_FINITE_UNKNOWNS:
            break
    assert best is not None
    return family, best


def provable(family: Family, decimals: bool | None = None) -> Family:
    """The family with every position an unknown; `decimals` are those of its request unless given.

    Raises ValueError, in one line, for a family that the theorem is not about, ImportError without python-flint.
    """
    flint, coordinates = balls.flint(), family.coordinates
    decimals = family.request.decimals if decimals is None else decimals
    if family.symmetry is SymmetryClass.FULL:
        raise ValueError(f"certify: given a family of {coordinates.model.name}; accepted: {ACCEPTED_ORBITS}")
    if not (isinstance(coordinates, LongChain) and coordinates.chain.sites > MOST_SITES):
        if not coordinates.is_whole:
            coordinates.check_whole("a certificate")
        family = family.whole
        if family.coordinates.mode.size != family.coordinates.model.size:
            raise ValueError("certify: given |gamma| = 1, where positions at rest have no scale; accepted: |gamma| < 1")
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        equations_of(family, family.request.amplitude_max, decimals)
    return family


def equations_of(family: Family, S: float, decimals: bool) -> CosineSystem:
    """Those of the orbits of a family at an S."""
    if isinstance(family.coordinates, LongChain):
        return tailed_system(family.coordinates, S, decimals)
    return system_of(family.coordinates, S, step_of(family), decimals)


def step_of(family: Family) -> int:
    """The step of the harmonics of a family's orbits: 2 for odd cosines, 1 for all."""
    return 2 if family.symmetry is SymmetryClass.QUARTER else 1


# Results of the proof -------------------------------------------------------------------------------------------------


def _certificate(orbit: Orbit, family: Family, attempt: Attempt, decimals: bool) -> Certificate:
    series, r, constants = attempt.series, attempt.radius, attempt.constants
    proved = attempt.proved and bool(series.square > r)
    away = arb(0, r) if proved else arb("nan")  # without a proof all bounds are nan
    nu, first, frequency = attempt.nu, series.system.harmonic(0), (series.square + away).sqrt()
    y = [d * (q + away / nu**first) for d, q in zip(series.system.scale, series.start, strict=True)]
    terms = None if series.system.tail else energy_terms(family.coordinates, series.system.forces, decimals)
    return Certificate(
        proved=proved,
        Omega=_ends(frequency),
        period=_ends(2 * arb.pi() / frequency),
        energy=None if terms is None else _ends(evaluate(terms, y)),
        profile=np.array([_ends(value) for value in y]).T,
        Omega_digits=str(frequency) if proved else "",
        Omega_error=balls.size(arb(orbit.Omega) - frequency),
        radius=float(np.nextafter(r + attempt.distance, np.inf)),
        uniqueness=_difference(uniqueness_radius(constants, r), attempt.distance) if proved else float("nan"),
        size=attempt.size,
        least_period=any(
            bool(abs(a) > abs(away) / nu) for row in series.coefficients for a in row[1 - first : 2 - first]
        ),
        S=orbit.S,
        constants=constants,
        harmonics=series.harmonics,
        weight=float(attempt.nu),
        scale=np.array([float(d) for d in series.system.scale]),
        reason="" if proved else reason_of(attempt),
        versions=_versions(),
        step=series.system.step,
        decimals=decimals,
    )


def _difference(one: float, other: float) -> float:
    """A double below a difference, not below 0."""
    return max(0.0, float(np.nextafter(one - other, -np.inf)))


def _ends(ball: arb) -> Interval:
    return balls.below(ball), balls.above(ball)


def reason_of(attempt: Attempt) -> str:
    """The constant that is too large, and a remedy."""
    c, odd = attempt.constants, "odd " if attempt.series.system.step == 2 else ""
    size = f"with {attempt.series.harmonics} {odd}harmonics"
    if attempt.fault:
        return f"{attempt.fault}; {NO_ABSENCE}"
    if not c.Z < 1.0:
        words = f"Z = {c.Z:.3g} {size}, accepted: below 1"
        help_ = "more harmonics, another weight, or an orbit farther from a fold or a branch point"
    elif not 2.0 * c.Y * c.W < (1.0 - c.Z) ** 2:
        bound = (1.0 - c.Z) ** 2 / (2.0 * c.W)
        words = f"Y = {c.Y:.3g} {size}, accepted: below {bound:.3g} at this Z and W"
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
