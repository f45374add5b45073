"""What a proof gives: enclosures of an orbit's quantities, and the constants of the theorem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from casadi_skin.bvp.problem import Array

Interval = tuple[float, float]

NORM = "|Omega^2| + sum over positions n and odd k of |a_nk| nu^k, y_n(t) = d_n sum of a_nk cos(k Omega t)"
NO_ABSENCE = "this is no proof that there is no orbit"


@dataclass(frozen=True)
class Constants:
    """What the theorem needs: |A F| <= Y, |I - A DF| <= Z, and W a Lipschitz constant of A DF within `reach`."""

    Y: float
    Z: float
    W: float
    reach: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """A proof that an orbit exists near a computed one, or why there is none; dimensionless, or in the model's units.

    Every pair is (lower, upper) in doubles rounded outwards, and holds the value of the true orbit, whose S is exactly
    the double `S`. Without a proof the pairs are empty intervals of (nan, nan).

    Attributes:
        proved: whether the orbit is proved to exist.
        Omega, period, energy: enclosures; the energy is None where the model conserves none that is known.
        profile: enclosures of the displacements at t = 0, shape (2, positions): lower and upper ends.
        Omega_digits: decimals of Omega that are proved, more than a double has.
        Omega_error: proved bound of the error of the computed orbit's Omega.
        radius: bound of the distance of the true orbit from the computed one, in the norm.
        uniqueness: radius about the computed orbit within which there is no other orbit of this S and symmetry.
        size: the norm of the computed orbit, which `radius` compares with.
        least_period: whether the period is proved to be the least one.
        S: the amplitude.
        constants: Y, Z and W of the theorem.
        harmonics: odd harmonics of the finite part.
        weight: nu of the norm.
        scale: the factors d_n of the norm, shape (positions,).
        reason: why there is no proof and what would help; empty with a proof.
        versions: what computed it.
    """

    proved: bool
    Omega: Interval
    period: Interval
    energy: Interval | None
    profile: Array
    Omega_digits: str
    Omega_error: float
    radius: float
    uniqueness: float
    size: float
    least_period: bool
    S: float
    constants: Constants
    harmonics: int
    weight: float
    scale: Array
    reason: str
    versions: Mapping[str, str]

    norm = NORM

    def __repr__(self) -> str:
        if not self.proved:
            return f"not proved: {self.reason}"
        c = self.constants
        return "\n".join(
            [
                f"proved: one orbit with S = {self.S!r} within {self.radius:.2g} of the computed one (of norm "
                f"{self.size:.3g}), and no other within {self.uniqueness:.2g}",
                f"Omega = {self.Omega_digits}; the computed one is off by {self.Omega_error:.2g} at most",
                f"Y = {c.Y:.3g}, Z = {c.Z:.3g}, W = {c.W:.3g}; {self.harmonics} odd harmonics, nu = {self.weight!r}",
            ]
        )
