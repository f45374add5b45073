"""A statement of the paper beside the result of this program, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum

import numpy as np


class Verdict(Enum):
    """Verdict of the comparison of a statement of the paper with the computation."""

    AGREES = "agrees"
    IN_RANGE = "agrees in a stated range only"
    DISAGREES = "disagrees"
    MISPRINT = "misprint"


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, its value there and here with an error bar, the verdict and its reason; all texts."""

    number: int
    where: str
    statement: str
    paper: str
    ours: str
    error: str
    verdict: str
    reason: str


COLUMNS = tuple(field.name for field in fields(Claim))


def claim(
    where: str,
    statement: str,
    paper: str,
    ours: str,
    verdict: Verdict | bool | np.bool_,
    reason: str = "",
    error: float | str = "",
) -> Claim:
    """A claim without its number, which agrees or not where its verdict is a truth value; errors have one digit."""
    bar = error if isinstance(error, str) else f"{error:.0e}"
    verdict = verdict if isinstance(verdict, Verdict) else Verdict.AGREES if verdict else Verdict.DISAGREES
    return Claim(0, where, statement, paper, ours, bar, verdict.value, reason)


def rounds_to(value: float, stated: str) -> Verdict:
    """AGREES where `value`, rounded to the decimals of the stated number, is that number; else DISAGREES."""
    decimals = len(stated.partition(".")[2])
    return Verdict.AGREES if f"{value:.{decimals}f}" == stated else Verdict.DISAGREES
