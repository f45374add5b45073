"""A statement of the paper beside what this program computes, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum


class Verdict(Enum):
    """How a statement of the paper compares with the computation."""

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
    where: str, statement: str, paper: str, ours: str, verdict: Verdict, reason: str = "", error: float | str = ""
) -> Claim:
    """A claim without its number; a numerical error is written with one digit."""
    bar = error if isinstance(error, str) else f"{error:.0e}"
    return Claim(0, where, statement, paper, ours, bar, verdict.value, reason)


def rounds_to(value: float, stated: str) -> Verdict:
    """AGREES where `value`, rounded to the decimals of the stated number, is that number; else DISAGREES."""
    decimals = len(stated.partition(".")[2])
    return Verdict.AGREES if f"{value:.{decimals}f}" == stated else Verdict.DISAGREES


def holds(condition: bool) -> Verdict:
    """AGREES where a statement holds, DISAGREES where it does not."""
    return Verdict.AGREES if condition else Verdict.DISAGREES
