"""Every number and checkable sentence of arXiv:2512.17483 beside what this program computes."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

from casadi_skin.studies.paper.claim import Claim
from casadi_skin.studies.paper.claims_families import family_claims
from casadi_skin.studies.paper.claims_linear import linear_claims
from casadi_skin.studies.paper.claims_sensitivity import sensitivity_claims
from casadi_skin.studies.paper.claims_stability import stability_claims
from casadi_skin.studies.paper.paper_data import PaperData

COLUMNS = ("number", "where", "statement", "paper", "ours", "error", "verdict", "reason")


def all_claims(data: PaperData) -> list[Claim]:
    """All claims in the order of the paper, numbered from 1."""
    parts = (linear_claims(data), family_claims(data), sensitivity_claims(data), stability_claims(data))
    return [replace(c, number=i) for i, c in enumerate(chain.from_iterable(parts), start=1)]
