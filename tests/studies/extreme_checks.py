"""Checks of computed orbits by means that share no code with their computation, as findings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from casadi_skin.follow.branch import Branch, harmonic_shares
from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import duffing_frequency, frequency_slope
from tests.studies.exact import exact_linear_frequency, exact_orbit, many_digits
from tests.studies.exact_multipliers import exact_mu, paired
from tests.studies.extreme_case import Finding, RefusedError, relative
from tests.studies.honesty_cases import reference_of
from tests.studies.integration import physical_multipliers, return_error

TOLERANCE = 1e-12
SHIFT_ALLOWED = 1e-6
FIRST_ORDER_ALLOWED = 1e-2  # of the shift: an orbit of the mode, and not of one beside it
RETURN_ALLOWED = 1e-9  # of the largest position, after a period: the integrator's own errors grow on the way
SAME_ALLOWED = 1e-12  # relative difference of two computations of the same orbit
TIME_ALLOWED = 1e-8  # relative difference of multipliers from those of the physical full-period matrix


@dataclass(frozen=True)
class Setup:
    """The orbit of the family of a mode at S, to a tolerance."""

    chain: Chain
    mode: int
    S: float
    tolerance: float = TOLERANCE

    def __str__(self) -> str:
        """The chain and the mode in a few words; gamma near +-1 by its distance from it."""
        chain, near = self.chain, 0 < 1.0 - abs(self.chain.gamma) < 1e-4
        sign = "-" if chain.gamma < 0 else ""
        gamma = f"{sign}(1 - {1.0 - abs(chain.gamma):.0e})" if near else f"{chain.gamma:g}"
        return f"N = {chain.sites}, alpha = {chain.alpha:g}, gamma = {gamma}, g = {chain.g:g}, j = {self.mode}"

    def family(self, stability: bool = False) -> Branch:
        """The family to S with a point there; raises RefusedError without an orbit."""
        options = {"at": (self.S,), "tolerance": self.tolerance, "corrector": "newton"}
        branch = follow_family(self.chain, self.mode, self.S, stability=stability, **options)  # type: ignore[arg-type]
        if not len(branch):
            raise RefusedError(branch.reason)
        return branch

    def orbit(self) -> Orbit:
        """The family's first orbit at S; raises RefusedError, with its last orbit, where it ends before."""
        branch = self.family()
        if not branch.complete:
            raise RefusedError(branch.reason, against_digits(branch.orbits[-1], self))
        orbit: Orbit = branch.at(S=self.S)
        return orbit

    def allowed(self, orbit: Orbit) -> float:
        """The tolerance, or, where the result says that round-off stands in the way, its estimated error."""
        if not orbit.at_round_off:
            return self.tolerance
        return max(self.tolerance, orbit.profile_error, orbit.Omega_error / orbit.Omega)


Check = Callable[[Orbit, Setup], Finding]


def orbit_words(orbit: Orbit) -> str:
    """The orbit in a few words."""
    flag = ", at round-off" if orbit.at_round_off else ""
    return f"S = {orbit.S:.6g}: Omega = {orbit.Omega:.14g}{flag}"


def _check_finite(orbit: Orbit) -> None:
    """Raises FloatingPointError for an orbit with numbers that are none."""
    numbers = (orbit.Omega, orbit.Omega_shift, orbit.energy, orbit.S, orbit.Omega_error, orbit.profile_error)
    for values in (orbit.profile, orbit.coefficients(4), np.array(numbers)):
        if not np.all(np.isfinite(values)):
            raise FloatingPointError("a result is not finite")


def against_digits(orbit: Orbit, setup: Setup) -> Finding:
    """Omega and profile against the orbit to 50 digits in physical coordinates; |gamma| < 1."""
    _check_finite(orbit)
    exact = exact_orbit(orbit)
    error = max(exact.Omega_error(orbit.Omega) / orbit.Omega, exact.profile_error(orbit))
    return Finding(orbit_words(orbit), error, max(setup.allowed(orbit), exact.left_out))


def with_third_harmonic(orbit: Orbit, setup: Setup) -> Finding:
    """As `against_digits`, with the share of the third harmonic."""
    finding = against_digits(orbit, setup)
    return replace(finding, got=f"{finding.got}; third {harmonic_shares(orbit)[1]:.3g}")


def shift_against_digits(orbit: Orbit, setup: Setup) -> Finding:
    """Omega_shift against the difference of 50 digits."""
    _check_finite(orbit)
    exact, omega = exact_orbit(orbit), exact_linear_frequency(setup.chain, setup.mode)
    with many_digits():
        shift = float(exact.Omega - omega)
    by_subtraction = orbit.Omega - float(omega)
    words = f"Omega - omega_j = {orbit.Omega_shift:.12g} (by subtraction {by_subtraction:.3g})"
    return Finding(words, relative(orbit.Omega_shift, shift), SHIFT_ALLOWED)


def against_duffing(orbit: Orbit, setup: Setup) -> Finding:
    """Omega of one site that moves by itself against the elliptic integral."""
    _check_finite(orbit)
    exact = duffing_frequency(2.0 + setup.chain.alpha, setup.chain.g, math.sqrt(setup.S))
    return Finding(orbit_words(orbit), relative(orbit.Omega, exact), setup.allowed(orbit))


def against_mirror(orbit: Orbit, setup: Setup) -> Finding:
    """The orbit of the chain with -gamma, computed by itself."""
    other = replace(setup, chain=replace(setup.chain, gamma=-setup.chain.gamma)).orbit()
    a, b = orbit.profile, other.profile[::-1]
    off = min(float(np.max(np.abs(a - b))), float(np.max(np.abs(a + b)))) / float(np.max(np.abs(a)))
    return Finding(orbit_words(orbit), max(relative(orbit.Omega, other.Omega), off), SAME_ALLOWED)


def against_scaled(orbit: Orbit, setup: Setup) -> Finding:
    """The orbit of the chain with g = +-1 at the same g S."""
    g = setup.chain.g
    other = replace(setup, chain=replace(setup.chain, g=float(np.sign(g))), S=setup.S * abs(g)).orbit()
    off = np.max(np.abs(np.sqrt(abs(g)) * orbit.profile - other.profile)) / np.max(np.abs(other.profile))
    return Finding(orbit_words(orbit), max(relative(orbit.Omega, other.Omega), float(off)), SAME_ALLOWED)


def against_first_order(orbit: Orbit, setup: Setup) -> Finding:
    """Omega_shift against the slope of multiple scales: the orbit is one of its mode, and of no neighbour."""
    _check_finite(orbit)
    chain = setup.chain
    shift = frequency_slope(chain.sites, chain.alpha, chain.gamma, chain.g, setup.mode) * orbit.S
    words = f"Omega - omega_j = {orbit.Omega_shift:.12g}"
    return Finding(words, relative(orbit.Omega_shift, shift), FIRST_ORDER_ALLOWED)


def against_short_chain(orbit: Orbit, setup: Setup) -> Finding:
    """The end breather of 24 sites: at S = 3 it is so short that the chain's length does not matter."""
    shorter = replace(setup, chain=replace(setup.chain, sites=24))
    short = shorter.orbit()
    error = relative(orbit.Omega, short.Omega) + against_digits(short, shorter).error
    return Finding(f"S = 3: Omega = {orbit.Omega:.14g}", error, SAME_ALLOWED)


def returning(orbit: Orbit, setup: Setup) -> Finding:
    """Positions and velocities after one period of the physical equations in time."""
    _check_finite(orbit)
    return Finding(orbit_words(orbit), return_error(orbit), RETURN_ALLOWED)


def against_long_double(orbit: Orbit, setup: Setup) -> Finding:
    """Each mu against the reference; the estimate is that of the mu that uses most of its own.

    An estimate above the tolerance says that the tolerance is not reached.
    """
    known, (mu, _) = orbit.floquet(), exact_mu(reference_of(orbit))
    size = np.maximum(1.0, np.abs(known.mu))
    off = np.abs(known.mu - paired(known.mu.astype(np.clongdouble), mu)).astype(float) / size
    estimates = known.mu_error / size
    worst = int(np.argmax(off / estimates))
    largest = known.max_abs_multiplier
    relative_error = known.error / largest
    flag = ", flagged" if max(relative_error, float(np.max(estimates))) > setup.tolerance else ""
    words = f"max |multiplier| = {largest:.10g}, estimated to {relative_error:.0e}{flag}"
    return Finding(words, float(off[worst]), float(estimates[worst]))


def against_physical(orbit: Orbit, setup: Setup) -> Finding:
    """Multipliers but the trivial pair, which the physical matrix splits by the root of its errors."""
    known, found = orbit.floquet(), physical_multipliers(orbit)
    others, rest = known.multipliers[2:], found[np.argsort(np.abs(found - 1.0))[2:]]
    off = np.abs(others - paired(others, rest)) / np.maximum(1.0, np.abs(others))
    return Finding(f"max |multiplier| = {known.max_abs_multiplier:.10g}", float(np.max(off)), TIME_ALLOWED)


CHECKS: Mapping[Check, str] = MappingProxyType({
    against_digits: "50 digits",
    with_third_harmonic: "50 digits",
    shift_against_digits: "50 digits",
    against_duffing: "exact Duffing",
    against_mirror: "mirror image",
    against_scaled: "g = +-1",
    against_first_order: "multiple scales",
    against_short_chain: "N = 24",
    returning: "DOP853",
    against_physical: "DOP853",
    against_long_double: "long double",
})  # fmt: skip
