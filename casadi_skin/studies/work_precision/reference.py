"""The exact orbits and mu that true errors are measured against, and how far the package's own best are from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.stability.result import ReversibleFloquet
from casadi_skin.studies.exact import LONG_DOUBLES, exact_orbit
from casadi_skin.studies.exact_multipliers import exact_mu, paired
from casadi_skin.studies.work_precision.computing import Computation, requested_orbits
from casadi_skin.studies.work_precision.settings import FamilyCase, Kind, Setting

TIGHTEST = 1e-13
PHASES = 65  # of a quarter of the period, at which profiles are compared
REFERENCE_COLUMNS = ("S", "Omega", "harmonics", "Omega_difference", "profile_difference", "mu_difference")


class Errors(NamedTuple):
    """Largest relative errors of Omega, profile and mu; of mu relative to max(1, |mu|), nan where there is none."""

    Omega: float
    profile: float
    mu: float = np.nan


class Reference:
    """The orbits of a family at the requested S, and their mu, in long double.

    `orbits` are those from which they start: the package's, by odd cosines and Newton's method to the tightest
    tolerance. Raises ArithmeticError where the family does not reach them.
    """

    def __init__(self, family: FamilyCase) -> None:
        tightest = Setting(Kind.ORBITS, family, TIGHTEST, corrector="newton", flow="gauss")
        computation = Computation(tightest)
        self.multipliers = computation.multipliers
        self.orbits = requested_orbits(computation.follow())
        self.exact = [exact_orbit(orbit, LONG_DOUBLES) for orbit in self.orbits]
        self.mu = [exact_mu(exact)[0] for exact in self.exact]
        second = Computation(replace(tightest, transcription="gauss", walker="arclength")).follow()
        orbits = requested_orbits(second)
        self.differences = list(self._errors(orbits, self.multipliers(orbits)))

    @property
    def agreement(self) -> Errors:
        """Largest differences between the reference and orbits and mu by collocation."""
        return _largest(self.differences)

    def errors_of(self, orbits: Sequence[Orbit], floquets: Iterable[ReversibleFloquet]) -> Errors:
        """Largest true errors of orbits and of mu; raises ArithmeticError where they are not at the same S."""
        if [orbit.S for orbit in orbits] != [orbit.S for orbit in self.orbits]:
            raise ArithmeticError(
                f"{len(orbits)} points at the S asked for, where the reference has {len(self.orbits)}"
            )
        return _largest(self._errors(orbits, floquets))

    def _errors(self, orbits: Iterable[Orbit], floquets: Iterable[ReversibleFloquet]) -> Iterator[Errors]:
        for orbit, found, exact, mu in zip(orbits, floquets, self.exact, self.mu, strict=True):
            known = mu.size == found.mu.size > 0
            off = np.abs(paired(mu, found.mu) - mu) / np.maximum(1.0, np.abs(mu)) if known else np.nan
            relative = exact.Omega_error(orbit.Omega) / orbit.Omega
            yield Errors(relative, exact.profile_error(orbit, PHASES), float(np.max(off)))

    def rows(self) -> Iterator[dict[str, object]]:
        """Rows of reference.csv: each orbit and how far the confirming method is from it."""
        for orbit, exact, errors in zip(self.orbits, self.exact, self.differences, strict=True):
            values = (orbit.S, float(exact.Omega), exact.scaled.shape[1], *errors)
            yield dict(zip(REFERENCE_COLUMNS, values, strict=True))


def _largest(errors: Iterable[Errors]) -> Errors:
    """The largest of each error."""
    return Errors(*(max(column) for column in zip(*errors, strict=True)))
