"""Checks of computed orbits by means that share no code with what computed them, as findings."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.follow import follow_family
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.studies.stress.case import Finding, RefusedError, relative
from casadi_skin.studies.stress.exact import (
    exact_duffing,
    exact_linear_frequency,
    exact_orbit,
    many_digits,
)
from casadi_skin.studies.stress.flow import return_error
from casadi_skin.theory.multiple_scales import frequency_slope

TOLERANCE = 1e-12
SHIFT_ALLOWED = 1e-6
RETURN_ALLOWED = 1e-9  # of the largest position, after a period: the integrator's own errors grow on the way
SAME_ALLOWED = 1e-12  # relative difference of two computations of the same orbit

BY_DIGITS = "50 digits"
BY_ELLIPTIC = "exact Duffing"
BY_MIRROR = "mirror image"
BY_SCALING = "g = +-1"
BY_TIME = "DOP853"


def chain_words(chain: Chain, mode: int) -> str:
    """A chain and a mode in a few words; gamma near +-1 by its distance from it."""
    near = 0 < 1.0 - abs(chain.gamma) < 1e-4
    sign = "-" if chain.gamma < 0 else ""
    gamma = f"{sign}(1 - {1.0 - abs(chain.gamma):.0e})" if near else f"{chain.gamma:g}"
    return f"N = {chain.sites}, alpha = {chain.alpha:g}, gamma = {gamma}, g = {chain.g:g}, j = {mode}"


def family(chain: Chain, mode: int, S: float, tolerance: float = TOLERANCE, stability: bool = False) -> Branch:
    """The family to S with a point there; raises RefusedError without an orbit."""
    branch = follow_family(chain, mode, S, at=(S,), tolerance=tolerance, stability=stability, corrector="newton")
    if not len(branch):
        raise RefusedError(branch.reason)
    return branch


def orbit_at(chain: Chain, mode: int, S: float, tolerance: float = TOLERANCE) -> Orbit:
    """The family's first orbit at S; raises RefusedError with the finding of the last orbit where it ends before."""
    branch = family(chain, mode, S, tolerance)
    if not branch.complete:
        raise RefusedError(branch.reason, against_digits(branch.orbits[-1]))
    return branch.at(S=S)


def orbit_words(orbit: Orbit) -> str:
    """The orbit in a few words."""
    flag = ", at round-off" if orbit.at_round_off else ""
    return f"S = {orbit.S:.6g}: Omega = {orbit.Omega:.14g}{flag}"


def _allowed(orbit: Orbit) -> float:
    """The tolerance, or, where the result says that round-off stands in the way, its estimated error."""
    tolerance = orbit.space.request.tolerance
    if not orbit.at_round_off:
        return tolerance
    return max(tolerance, orbit.profile_error, orbit.Omega_error / orbit.Omega)


def _finite(orbit: Orbit) -> None:
    """Raises FloatingPointError for an orbit with numbers that are none."""
    numbers = (orbit.Omega, orbit.Omega_shift, orbit.energy, orbit.S, orbit.Omega_error, orbit.profile_error)
    for values in (orbit.profile, orbit.coefficients(4), np.array(numbers)):
        if not np.all(np.isfinite(values)):
            raise FloatingPointError("a result is not finite")


def against_digits(orbit: Orbit) -> Finding:
    """Omega and profile against the orbit to 50 digits in physical coordinates; |gamma| < 1."""
    _finite(orbit)
    exact = exact_orbit(orbit)
    error = max(exact.Omega_error(orbit.Omega), exact.profile_error(orbit))
    return Finding(orbit_words(orbit), error, max(_allowed(orbit), exact.left_out))


def shift_against_digits(orbit: Orbit) -> Finding:
    """Omega_shift against the difference of 50 digits."""
    _finite(orbit)
    exact, omega = exact_orbit(orbit), exact_linear_frequency(orbit.model, orbit.space.coordinates.mode_number)
    with many_digits():
        shift = float(exact.Omega - omega)
    by_subtraction = orbit.Omega - float(omega)
    words = f"Omega - omega_j = {orbit.Omega_shift:.12g} (by subtraction {by_subtraction:.3g})"
    return Finding(words, relative(orbit.Omega_shift, shift), SHIFT_ALLOWED)


def against_duffing(orbit: Orbit) -> Finding:
    """Omega of one site that moves by itself against the elliptic integral."""
    _finite(orbit)
    chain = orbit.model
    exact = exact_duffing(2 + Decimal(chain.alpha), chain.g, orbit.S)
    return Finding(orbit_words(orbit), relative(orbit.Omega, float(exact)), _allowed(orbit))


def mirrored(chain: Chain, mode: int, S: float, tolerance: float = TOLERANCE) -> Finding:
    """Orbits of the chain and of that with -gamma, computed each by itself."""
    orbit = orbit_at(chain, mode, S, tolerance)
    other = orbit_at(Chain(chain.sites, chain.alpha, -chain.gamma, chain.g), mode, S, tolerance)
    a, b = orbit.profile, other.profile[::-1]
    off = min(float(np.max(np.abs(a - b))), float(np.max(np.abs(a + b)))) / float(np.max(np.abs(a)))
    return Finding(orbit_words(orbit), max(relative(orbit.Omega, other.Omega), off), SAME_ALLOWED)


def scaled(chain: Chain, mode: int, S: float) -> Finding:
    """Omega of the chain against that with g = +-1 and the same g S."""
    orbit = orbit_at(chain, mode, S)
    other = orbit_at(Chain(chain.sites, chain.alpha, chain.gamma, float(np.sign(chain.g))), mode, S * abs(chain.g))
    factor = np.sqrt(abs(chain.g))
    off = float(np.max(np.abs(factor * orbit.profile - other.profile)) / np.max(np.abs(other.profile)))
    return Finding(orbit_words(orbit), max(relative(orbit.Omega, other.Omega), off), SAME_ALLOWED)


def against_first_order(orbit: Orbit, allowed: float) -> Finding:
    """Omega_shift against the multiple-scale slope: the orbit belongs to the mode asked for, and to no neighbour."""
    _finite(orbit)
    chain, mode = orbit.model, orbit.space.coordinates.mode_number
    shift = frequency_slope(chain.sites, chain.alpha, chain.gamma, chain.g, mode) * orbit.S
    return Finding(f"Omega - omega_j = {orbit.Omega_shift:.12g}", relative(orbit.Omega_shift, shift), allowed)


def returning(orbit: Orbit) -> Finding:
    """Positions and velocities after one period of the physical equations in time."""
    _finite(orbit)
    return Finding(orbit_words(orbit), return_error(orbit), RETURN_ALLOWED)


def at_S(
    chain: Chain, mode: int, S: float, check: Callable[[Orbit], Finding] = against_digits, tolerance: float = TOLERANCE
) -> Callable[[], Finding]:
    """A case's computation: the family to S, then the check."""
    return lambda: check(orbit_at(chain, mode, S, tolerance))
