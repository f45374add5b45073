"""Every number and checkable sentence of arXiv:2512.17483 beside what this program computes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

from casadi_skin.studies.paper_data import PaperData


class Verdict(Enum):
    """How a statement of the paper compares with the computation."""

    AGREES = "agrees"
    IN_RANGE = "agrees in a stated range only"
    DISAGREES = "disagrees"
    MISPRINT = "misprint"


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, its value there and here with an error bar, and what follows; all texts."""

    where: str
    statement: str
    paper: str
    ours: str
    error: str
    verdict: str
    reason: str
    number: int = 0


COLUMNS = ("number", "where", "statement", "paper", "ours", "error", "verdict", "reason")


def claim(
    where: str, statement: str, paper: str, ours: str, verdict: Verdict, reason: str = "", error: float | str = ""
) -> Claim:
    """A claim; a numerical error is written with one digit."""
    bar = error if isinstance(error, str) else f"{error:.0e}"
    return Claim(where, statement, paper, ours, bar, verdict.value, reason)


def rounds_to(value: float, stated: str) -> Verdict:
    """AGREES where `value`, rounded to the decimals of the stated number, is that number; else DISAGREES."""
    decimals = len(stated.partition(".")[2])
    return Verdict.AGREES if f"{value:.{decimals}f}" == stated else Verdict.DISAGREES


def holds(condition: bool) -> Verdict:
    """AGREES where a statement holds, DISAGREES where it does not."""
    return Verdict.AGREES if condition else Verdict.DISAGREES


def all_claims(data: PaperData) -> list[Claim]:
    """All claims in the order of the paper, numbered from 1."""
    return [replace(c, number=i) for i, c in enumerate(_claims(data), start=1)]


def _claims(data: PaperData) -> Iterator[Claim]:
    from casadi_skin.studies.claims_families import family_claims
    from casadi_skin.studies.claims_linear import linear_claims
    from casadi_skin.studies.claims_sensitivity import sensitivity_claims
    from casadi_skin.studies.claims_stability import stability_claims

    yield from linear_claims(data)
    yield from family_claims(data)
    yield from sensitivity_claims(data)
    yield from stability_claims(data)
