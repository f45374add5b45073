"""A hard case: the request, the result, and how far an independent check agrees with it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

MOST_DIGITS = 16.0  # that numbers in double precision can agree to
SPARE = 1.0 + 1e-9  # of a bound that is met but for its own rounding


class RefusedError(Exception):
    """The program did not meet the request, and said why; its results so far may be judged in `finding`."""

    def __init__(self, message: str, finding: Finding | None = None) -> None:
        super().__init__(message)
        self.finding = finding


@dataclass(frozen=True)
class Finding:
    """A result in words, its relative difference from the check, and the difference that is allowed."""

    got: str
    error: float
    allowed: float

    @property
    def digits(self) -> float:
        """Digits of agreement, at most those of double precision."""
        return digits_of(self.error)

    @property
    def promised(self) -> float:
        """Digits that the result promises, or that the case requires."""
        return digits_of(self.allowed)


@dataclass(frozen=True)
class Case:
    """One hard case: `compute` gives the finding, or raises ValueError, ArithmeticError or RefusedError for a refusal.

    A refusal is accepted where its message contains `refusal`, and expected unless it `may_hold`.
    """

    theme: str
    name: str
    asked: str
    check: str
    compute: Callable[[], Finding]
    refusal: str = ""
    may_hold: bool = False
    quick: bool = False


@dataclass(frozen=True)
class Outcome:
    """A case with its finding, or with the words of its refusal."""

    case: Case
    finding: Finding | None
    refused: str
    seconds: float

    def __str__(self) -> str:
        return f"{self.case.name}: {self.fault or self.verdict}"

    @property
    def fault(self) -> str:
        """Why the outcome is not the expected one, in words; empty where it is."""
        case, finding = self.case, self.finding
        if self.refused:
            if not case.refusal:
                return f"refused: {self.refused}"
            if case.refusal not in self.refused:
                return f'refused without "{case.refusal}": {self.refused}'
        elif case.refusal and not case.may_hold:
            return "not refused"
        if finding is None or finding.error <= SPARE * finding.allowed:
            return ""
        return f"{finding.digits:.1f} digits agree, {finding.promised:.1f} are promised"

    @property
    def verdict(self) -> str:
        """The outcome in a word."""
        return "fault" if self.fault else "refused" if self.refused else "holds"


def digits_of(error: float) -> float:
    """Decimal digits to which numbers with this relative difference agree, from 0 to those of double precision."""
    if not error < 1.0:  # NaN agrees with nothing
        return 0.0
    return min(MOST_DIGITS, -math.log10(error)) if error > 0 else MOST_DIGITS


def relative(value: float, other: float) -> float:
    """Difference of a value from another, relative to that one."""
    return abs(value - other) / abs(other) if other else float(value != 0) * math.inf


def measure(case: Case) -> Outcome:
    """The outcome of a case; an error other than a refusal in words is named with its kind."""
    began = time.perf_counter()
    finding, refused = None, ""
    try:
        with np.errstate(over="raise", invalid="raise"):
            finding = case.compute()
    except RefusedError as error:
        finding, refused = error.finding, str(error)
    except (ValueError, ArithmeticError) as error:
        refused = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
    return Outcome(case, finding, " ".join(refused.split()), time.perf_counter() - began)
