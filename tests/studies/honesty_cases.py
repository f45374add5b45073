"""Random orbits of random chains by random methods: their true errors, and the errors that they estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.stability.result import Floquet, reversible_floquet
from tests.studies.exact import LONG_DOUBLES, ExactOrbit, exact_orbit
from tests.studies.exact_multipliers import Complex, exact_mu, paired

POINTS = 100  # of a family, at most: softening families may fold again and again
NEAR = 0.1  # of the state and of Omega: farther away the reference is another orbit
STABLE_WITHIN = 1e-14  # of [-1, 0]: a mu of the reference that is inside
PHASES = 97  # of a quarter of the period, at which profiles are compared
LARGEST_SITES = {"trigonometric": 60, "gauss": 24, "radau": 24, "shooting": 4}
LARGEST_SITES_OF_FLOW = {"splitting": 60, "cvodes": 12}


class UnjudgedError(ArithmeticError):
    """No reference that can judge was found."""


class _Enough(Exception):  # noqa: N818
    """Raised by a progress callback where the family has all orbits that a case needs."""


@dataclass(frozen=True)
class Case:
    """One orbit to compute: case `index` of the draw `seed`.

    It is the family's point at `S` or, where `S` is None or is not met within POINTS points, that at `place`, a
    fraction of the points.
    """

    seed: int
    index: int
    sites: int
    alpha: float
    gamma: float
    g: float
    mode: int
    amplitude_max: float
    S: float | None
    place: float
    tolerance: float
    transcription: str
    corrector: str
    walker: str
    flow: str

    def __str__(self) -> str:
        return f"N = {self.sites}, g = {self.g:.2g}, tolerance {self.tolerance:.0e}, {self.transcription}"


def draw(seed: int, index: int) -> Case:
    """Case `index` of the draw `seed`, which depends on nothing else."""
    random = np.random.default_rng([seed, index])

    def one_of(**shares: float) -> str:
        return str(random.choice(list(shares), p=list(shares.values())))

    def log_uniform(low: float, high: float) -> float:
        return float(math.exp(random.uniform(math.log(low), math.log(high))))

    transcription = one_of(trigonometric=0.64, gauss=0.14, radau=0.12, shooting=0.1)
    corrector = one_of(newton=0.5, ipopt=0.5)
    flow = one_of(splitting=0.8, cvodes=0.2)
    series = one_of(series=0.4, arclength=0.6)
    largest = min(LARGEST_SITES[transcription], LARGEST_SITES_OF_FLOW[flow])
    sites = int(log_uniform(3.0, largest + 3.0)) - 2  # shifted, or one case in five has a single site
    alpha, gamma = float(random.uniform(0.0, 5.0)), float(random.uniform(-0.9, 0.95))
    g = float(random.choice([-1.0, 1.0])) * log_uniform(0.3, 3.0)
    amplitude_max = log_uniform(0.03, 10.0) / abs(g)
    at_S, S = bool(random.random() < 0.5), amplitude_max * float(random.uniform(0.02, 1.0))
    mode, place, tolerance = int(random.integers(1, sites + 1)), float(random.random()), log_uniform(1e-12, 1e-3)
    family = (sites, alpha, gamma, g, mode, amplitude_max, S if at_S else None, place, tolerance)
    walker = series if transcription == "trigonometric" else "arclength"
    return Case(seed, index, *family, transcription, corrector, walker, flow)


@dataclass(frozen=True)
class Quantity:
    """True and estimated error, absolute, of something of size `scale`.

    `bounded` is the relative error that the tolerance is to bound, `expected` the result's own estimate of that one.
    `excused` is true where the result says that round-off keeps it from the tolerance.
    """

    name: str
    true: float
    estimate: float
    scale: float
    tolerance: float
    bounded: float
    expected: float
    excused: bool = False

    @property
    def relative(self) -> float:
        """True error over the scale."""
        return self.true / self.scale

    @property
    def covered(self) -> bool:
        """Whether the estimate is no smaller than the true error."""
        return self.true <= self.estimate

    @property
    def far_off(self) -> bool:
        """Whether the true error is more than ten times the estimate."""
        return not self.true <= 10.0 * self.estimate

    @property
    def misses_tolerance(self) -> bool:
        """Whether the true error exceeds the tolerance and the result does not speak of round-off."""
        return not self.excused and not self.bounded <= self.tolerance

    @property
    def announced(self) -> bool:
        """Whether the tolerance is missed and the estimate of the multipliers says so."""
        return self.name == "multipliers" and self.misses_tolerance and self.expected > self.tolerance

    @property
    def verdict(self) -> str:
        """The outcome in a word or two."""
        words = "far off" if self.far_off else "covered" if self.covered else "low"
        if not self.misses_tolerance:
            return words
        return f"{words}, tolerance missed{' as declared' if self.announced else ''}"


@dataclass(frozen=True)
class Outcome:
    """A case with its results; `reason` names those that could not be computed or judged; empty where none."""

    case: Case
    quantities: tuple[Quantity, ...] = ()
    S: float = math.nan
    Omega: float = math.nan
    points: int = 0
    at_round_off: bool = False
    stable: bool | None = None
    reference_stable: bool | None = None
    reason: str = ""


def measure(case: Case) -> Outcome:
    """The outcome of a case; a failure is its `reason`."""
    outcome = Outcome(case)
    try:
        orbit, points = find(case)
        outcome = replace(outcome, S=orbit.S, Omega=orbit.Omega, points=points, at_round_off=orbit.at_round_off)
        exact = reference_of(orbit)
        outcome = replace(outcome, quantities=_orbit_quantities(case, orbit, exact))
        _check_sharp(outcome.quantities[1], exact.left_out)
        if case.sites == 1:  # no multipliers but the trivial pair
            return outcome
        floquet, (mu, uncertain) = orbit.floquet(), exact_mu(exact)
        quantity = _multiplier_quantity(case, floquet, mu)
        outcome = replace(outcome, quantities=(*outcome.quantities, quantity), stable=floquet.stable)
        _check_sharp(quantity, uncertain)
        known = reversible_floquet(mu.astype(complex), np.full(mu.size, STABLE_WITHIN), 0.0, floquet.power)
        return replace(outcome, reference_stable=known.stable)
    except Exception as error:  # whatever it is, the case is counted and shown
        return replace(outcome, reason=f"{type(error).__name__}: {' '.join(str(error).split())}"[:200])


def find(case: Case) -> tuple[Orbit, int]:
    """The orbit of a case, and the number of points of the family that were computed; raises ArithmeticError."""
    orbits: list[Orbit] = []

    def keep(orbit: Orbit) -> None:
        orbits.append(orbit)
        if orbit.S == case.S or len(orbits) == POINTS:
            raise _Enough

    chain = Chain(case.sites, case.alpha, case.gamma, case.g)
    methods = {name: getattr(case, name) for name in ("transcription", "corrector", "walker", "flow", "tolerance")}
    at = () if case.S is None else (case.S,)
    try:
        branch = follow_family(chain, case.mode, case.amplitude_max, at=at, progress=keep, **methods)
    except _Enough:
        pass
    else:
        if not orbits:
            raise ArithmeticError(branch.reason)
    return orbits[-1] if orbits[-1].S == case.S else orbits[int(case.place * len(orbits))], len(orbits)


def reference_of(orbit: Orbit) -> ExactOrbit:
    """The exact orbit near an orbit, in long double; raises UnjudgedError where there is none near."""
    exact = exact_orbit(orbit, LONG_DOUBLES)
    distance = exact.profile_error(orbit, PHASES)
    if max(distance, exact.Omega_error(orbit.Omega) / orbit.Omega) > NEAR:
        raise UnjudgedError(f"the reference is {distance:.1g} of the state away, with Omega = {exact.Omega:.6g}")
    return exact


def _orbit_quantities(case: Case, orbit: Orbit, exact: ExactOrbit) -> tuple[Quantity, ...]:
    """Errors of Omega, and of the profile at equal phases over all sites, relative to the largest displacement."""
    error, off, size = exact.profile_error(orbit, PHASES), exact.Omega_error(orbit.Omega), orbit.Omega
    known = (case.tolerance, off / size, orbit.Omega_error / size, orbit.at_round_off)
    of_profile = (case.tolerance, error, orbit.profile_error, orbit.at_round_off)
    return (
        Quantity("Omega", off, orbit.Omega_error, size, *known),
        Quantity("profile", error, orbit.profile_error, 1.0, *of_profile),
    )


def _multiplier_quantity(case: Case, floquet: Floquet, exact: Complex) -> Quantity:
    """Error of mu and, for an unstable orbit, of the largest modulus of a multiplier (see `Floquet.error`).

    The tolerance bounds that of mu alone, relative to max(1, |mu|).
    """
    distances = np.abs(paired(floquet.mu.astype(np.clongdouble), exact) - floquet.mu).astype(float)
    scales = np.maximum(1.0, np.abs(floquet.mu))
    worst = int(np.argmax(distances / scales))
    largest, scale = float(np.max(distances)), float(scales[worst])
    bounded, expected = float(distances[worst] / scales[worst]), float(np.max(floquet.mu_error / scales))
    if not floquet.stable:
        root = np.abs(np.sqrt(exact) + np.sqrt(1 + exact))
        modulus = np.max(np.maximum(root, 1 / root)) ** (2 * floquet.power)
        of_modulus = float(abs(floquet.max_abs_multiplier - modulus))
        if of_modulus > largest:
            largest, scale = of_modulus, max(1.0, float(modulus))
    return Quantity("multipliers", largest, floquet.error, scale, case.tolerance, bounded, expected)


def _check_sharp(quantity: Quantity, uncertain: float) -> None:
    """Raises UnjudgedError where an uncertain reference could change the verdict on an estimate."""
    if uncertain > max(0.1 * quantity.true, 1e-3 * quantity.estimate):
        raise UnjudgedError(f"the reference is known to {uncertain:.1e}, too little to judge {quantity.name}")
