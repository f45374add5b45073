"""Results of a proof: enclosures of an orbit's quantities, and the constants of the theorem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.result import Result
from casadi_skin.zero.problem import Array

Interval = tuple[float, float]

NORM_IN_WORDS = (
    "|Omega^2| + sum over positions n and harmonics k of |a_nk| nu^k, y_n(t) = d_n sum of a_nk cos(k Omega t)"
)
STABLE, UNSTABLE, UNDECIDED = "stable", "unstable", "not decided"
NO_ABSENCE = "this is no proof that there is no orbit"


@dataclass(frozen=True)
class Constants:
    """Constants of the theorem: |A F| <= Y, |I - A DF| <= Z, and W a Lipschitz constant of A DF within `reach`."""

    Y: float
    Z: float
    W: float
    reach: float


@dataclass(frozen=True, eq=False)
class Certificate(Result):
    """A proof that an orbit exists near a computed one, or why there is none; dimensionless, or in the model's units.

    Every pair is (lower, upper) in doubles rounded outwards, and holds the value of the true orbit, whose S is exactly
    the double `S`, or with `decimals` the decimal that it is printed as. Without a proof the pairs are empty intervals
    of (nan, nan).

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
        harmonics: how many of the finite part.
        weight: nu of the norm.
        scale: the factors d_n of the norm, shape (positions,).
        reason: why there is no proof and what would help; empty with a proof.
        versions: of the programs that computed it.
        step: of the harmonics: 2 for odd cosines, 1 for all.
        decimals: whether parameters and S are the decimals that Python prints for their doubles.
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
    step: int = 2
    decimals: bool = False

    norm = NORM_IN_WORDS

    def __repr__(self) -> str:
        if not self.proved:
            return f"<Certificate: not proved: {self.reason}>"
        near = f"one orbit with S = {self.S!r} within {self.radius:.2g} of the computed one"
        return f"<Certificate: proved: {near}, Omega = {self.Omega_digits}>"


@dataclass(frozen=True, eq=False)
class ProvedStability(Result):
    """Proof about the Floquet multipliers exp(2 pi i sigma/step), those of q' left out.

    They are those over half a period for orbits of odd cosines (step 2), over the period for the others (step 1).

    Attributes:
        verdict: "stable": all are on the unit circle and simple, each with its conjugate alone between two numbers;
            "unstable": one is off the circle; or "not decided".
        brackets: intervals of sigma in (0, step/2) with an exponent in each, shape (exponents, 2).
        signatures: their Krein signatures, +1 or -1, shape (exponents,).
        exponent: one off the real axis, known within `radius`; nan where none is proved.
        radius: see exponent.
        S: the amplitude.
        reason: why it is not decided; empty where it is.
        step: 2 or 1, see above.
    """

    verdict: str
    brackets: Array
    signatures: NDArray[np.int64]
    exponent: complex
    radius: float
    S: float
    reason: str = ""
    step: int = 2

    def __repr__(self) -> str:
        where = f"at S = {self.S!r}"
        if self.verdict == STABLE:
            plus = int(np.sum(self.signatures > 0))
            counts = f"{plus} of Krein signature +, {self.signatures.size - plus} of -"
            return f"proved stable {where}: {self.signatures.size} pairs of simple multipliers on the circle, {counts}"
        if self.verdict == UNSTABLE:
            return f"proved unstable {where}: an exponent within {self.radius:.2g} of {self.exponent:.6g}"
        return f"stability {UNDECIDED} {where}: {self.reason}"


@dataclass(frozen=True, eq=False)
class ProvedStretch(Result):
    """A stretch of a family on which there is, for each S, one orbit near the computed ones, and all are one curve.

    Attributes:
        S_start, S_end: where it starts, and how far it is proved.
        pieces: intervals of S that it was proved on.
        reason: why it ends before its requested end; empty where it does not.
        breaks: values of S between the pieces.
        radius: largest distance of an orbit from the polynomial of its piece, in the norm for positions over sqrt(S).
    """

    S_start: float
    S_end: float
    pieces: int
    reason: str = ""
    breaks: tuple[float, ...] = ()
    radius: float = float("nan")

    @property
    def complete(self) -> bool:
        """Whether the whole requested stretch is proved."""
        return not self.reason

    def __repr__(self) -> str:
        words = f"proved from S = {self.S_start!r} to {self.S_end!r} in {self.pieces} pieces: one orbit for each S"
        return f"{words}, one curve without fold or branch point" + (f"; {self.reason}" if self.reason else "")
