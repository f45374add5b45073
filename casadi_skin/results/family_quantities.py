"""Quantities of the orbits of a family, with its proofs."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from casadi_skin.certify.certificate import STABLE, UNSTABLE, Certificate
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.results.multiplier_quantities import multiplier_quantities
from casadi_skin.results.quantity import CSV, NETCDF, Place, Quantity

FAMILY: tuple[Quantity, ...] = (
    Quantity("mode", "linear mode j that the family grows from", lambda p: p.mode),
    Quantity("point", "place along the family", lambda p: p.index, where=CSV),
    Quantity("index", "place along the family", lambda p: p.index, where=NETCDF),
    Quantity("requested", "1 where S, Omega or the period was asked for", lambda p: int(p.requested)),
    Quantity("S", "total amplitude: sum of y_n^2 at t = 0", lambda p: p.orbit.S),
    Quantity("Omega", "frequency", lambda p: p.orbit.Omega),
    Quantity("Omega_shift", "Omega minus the linear frequency", lambda p: p.orbit.Omega_shift),
    Quantity("period", "2 pi/Omega", lambda p: p.orbit.period, where=CSV),
    Quantity("energy", "the conserved quantity", lambda p: energy_of(p.orbit), may_be_empty=True),
)
FAMILY_STABILITY: tuple[Quantity, ...] = (
    Quantity(
        "max_abs_multiplier", "largest modulus, the trivial pair left out", lambda p: p.floquet.max_abs_multiplier
    ),
    Quantity("stable", "1 where no multiplier is outside the unit circle", lambda p: int(p.floquet.stable)),
    Quantity("unstable_real", "multipliers outside the circle, real", lambda p: p.floquet.unstable_real, where=CSV),
    Quantity("unstable_complex", "the same, complex", lambda p: p.floquet.unstable_complex, where=CSV),
    Quantity("multiplier_error", "estimated error of the multipliers", lambda p: p.floquet.error),
)
FAMILY_ERRORS: tuple[Quantity, ...] = (
    Quantity("Omega_error", "estimated absolute error of Omega", lambda p: p.orbit.Omega_error),
    Quantity("residual", "largest residual relative to the largest term", lambda p: p.solution.residual),
    Quantity("profile_error", "estimated relative error of the profile", lambda p: p.orbit.profile_error),
    Quantity(
        "at_round_off", "1 where round-off keeps the errors above the tolerance", lambda p: int(p.solution.at_round_off)
    ),
    Quantity("S_error", "estimated absolute error of S", lambda p: p.orbit.S_error),
)
FAMILY_ARRAYS: tuple[Quantity, ...] = (
    Quantity(
        "resolution", "harmonics or intervals of the discretisation", lambda p: p.solution.point.problem.resolution,
        where=NETCDF,
    ),
    Quantity(
        "profile", "displacements y_n at t = 0", lambda p: p.orbit.evaluate(0.0, p.orbit.output_sites), ("site",)
    ),
    Quantity(
        "log10_profile", "log10 |y_n| at t = 0, also where y_n is below the smallest double; empty where it is 0",
        lambda p: p.orbit.log10_displacements(p.orbit.output_sites)[0], ("site",), may_be_empty=True,
    ),
    Quantity(
        "profile_sign", "sign of y_n at t = 0",
        lambda p: p.orbit.log10_displacements(p.orbit.output_sites)[1].astype(int), ("site",),
    ),
)  # fmt: skip


def _certificate(place: Place) -> Certificate | None:
    """The proof of an orbit, where one was requested, else None."""
    space = place.orbit.space
    assert isinstance(space, Family)
    return place.orbit.certificate if space.request.certify == "all" or place.requested else None


def _of_proof(value: Callable[[Certificate], float]) -> Callable[[Place], float]:
    def of(place: Place) -> float:
        certificate = _certificate(place)
        return math.nan if certificate is None else value(certificate)

    return of


def certified(branch: Branch) -> list[Orbit]:
    """The orbits of a branch for which a proof was requested."""
    requested = isinstance(branch.space, Family) and branch.space.request.certify
    return [o for o in branch.orbits if requested == "all" or o.point.requested] if requested else []


FAMILY_PROOFS: tuple[Quantity, ...] = (
    Quantity(
        "proved", "1 where the orbit is proved to exist, 0 where it is not; empty where no proof was asked for",
        _of_proof(lambda c: float(c.proved)), may_be_empty=True,
    ),
    Quantity(
        "Omega_lower", "proved lower bound of Omega", _of_proof(lambda c: c.Omega[0]), may_be_empty=True
    ),
    Quantity(
        "Omega_upper", "proved upper bound of Omega", _of_proof(lambda c: c.Omega[1]), may_be_empty=True
    ),
    Quantity(
        "proved_Omega_error", "proved bound of the error of Omega", _of_proof(lambda c: c.Omega_error),
        may_be_empty=True,
    ),
    Quantity(
        "proved_radius", "proved distance of the orbit from the computed one, in the norm of the certificate",
        _of_proof(lambda c: c.radius), may_be_empty=True,
    ),
)  # fmt: skip


def _proved_stable(place: Place) -> float:
    """1 or 0 where it is proved, NaN where it is not decided or no proof was requested."""
    if _certificate(place) is None:
        return math.nan
    return {STABLE: 1.0, UNSTABLE: 0.0}.get(place.orbit.proved_stability.verdict, math.nan)


PROVED_STABILITY = Quantity(
    "proved_stable", "1 where the orbit is proved to be stable, 0 where unstable; empty where neither is",
    _proved_stable, may_be_empty=True,
)  # fmt: skip


def energy_of(orbit: Orbit) -> float:
    """The energy; NaN for a model without a conserved quantity, infinite where an infinite tail moves along."""
    try:
        return orbit.energy
    except ValueError:
        return math.nan


def family_quantities(branch: Branch) -> list[Quantity]:
    """Quantities of the orbits of a family, columns of family.csv in their order and variables of family.nc."""
    assert isinstance(branch.space, Family)
    quantities = [*FAMILY, *(FAMILY_STABILITY if branch.with_stability else ()), *FAMILY_ERRORS]
    first = branch.space.coordinates.regime(branch.solutions[0].point) if len(branch) else None
    if first is not None:
        words = "; ".join(f"{i}: {regime.value}" for i, regime in enumerate(type(first)))
        quantities.append(Quantity("regime", words, lambda p: _regime(p).name.lower(), where=CSV))
        quantities.append(Quantity("regime", words, lambda p: list(type(_regime(p))).index(_regime(p)), where=NETCDF))
    if branch.space.request.certify:
        quantities += [*FAMILY_PROOFS, *([PROVED_STABILITY] if branch.with_stability else [])]
    quantities += FAMILY_ARRAYS
    harmonics = max((orbit.harmonics for orbit in branch.orbits), default=0)
    if branch.space.symmetry.value == 0.25:
        meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"

        def coefficients(place: Place) -> NDArray[np.float64]:
            return place.orbit.coefficients(harmonics, place.orbit.output_sites)

        quantities.append(Quantity("coefficients", meaning, coefficients, ("harmonic", "site")))
    return quantities + multiplier_quantities(branch)


def _regime(place: Place) -> Enum:
    """Regime of the linear tail of a long lattice."""
    space = place.solution.space
    assert isinstance(space, Family)
    regime = space.coordinates.regime(place.solution.point)
    assert regime is not None
    return regime
