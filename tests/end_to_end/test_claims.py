"""The claims of the paper: verdicts that follow from numbers known independently."""

from __future__ import annotations

import pytest
from claim import Claim, Verdict, rounds_to
from claims_families import LARGE, decay_rate, power_of_r
from paper_data import PaperData, sensitivity
from reproduce import all_claims


@pytest.mark.parametrize(
    ("gamma", "slope", "law"), [(0.25, 0.080, 320.2), (0.4, 0.098, 106.2), (0.55, 0.108, 44.1), (0.7, 0.113, 19.4)]
)
def test_local_decay_rates_and_the_law_in_the_end(gamma: float, slope: float, law: float) -> None:
    assert decay_rate(24, gamma) == pytest.approx(slope, abs=6e-4)  # computed independently
    limit = (LARGE + 1) ** 3 * sensitivity(LARGE, 1.0, gamma, 1.0, 1)
    assert limit == pytest.approx(law, abs=0.06)


@pytest.mark.parametrize(("sites", "power"), [(24, 2.2), (32, 2.7), (42, 3.2)])
def test_local_powers_of_r(sites: int, power: float) -> None:
    assert power_of_r(sites, 0.25) == pytest.approx(power, abs=0.06)


def test_rounding_compares_to_the_stated_digits() -> None:
    assert rounds_to(2.834, "2.83") is Verdict.AGREES
    assert rounds_to(2.836, "2.83") is Verdict.DISAGREES


def found(claims: list[Claim], words: str) -> Claim:
    """The one claim whose statement holds these words."""
    matches = [c for c in claims if words in c.statement]
    assert len(matches) == 1, (words, matches)
    return matches[0]


@pytest.mark.slow
def test_all_claims() -> None:
    claims = all_claims(PaperData())
    assert [c.number for c in claims] == list(range(1, len(claims) + 1))
    assert len(claims) >= 60
    assert {c.verdict for c in claims} == {v.value for v in Verdict}
    assert all(c.where and c.statement and c.paper and c.ours for c in claims)
    assert all("nan" not in " ".join((c.ours, c.error, c.reason)) for c in claims)
    for words, verdict, number in (
        ("omega_min = 1.04", Verdict.MISPRINT, "1.031265"),
        ("average spacing", Verdict.AGREES, "0.0512"),
        ("T_b = 2.83", Verdict.AGREES, "2.830986"),
        ("T_b = 6.06", Verdict.AGREES, "6.062550"),
        ("q = 0.06 at gamma = 0.25", Verdict.IN_RANGE, "0.080 at N = 24"),
        ("W is symplectic", Verdict.MISPRINT, "0e+00"),
        ("W is Hermitian", Verdict.MISPRINT, "0e+00"),
        ("right eigenvector r^(-n/2)", Verdict.MISPRINT, "residual"),
        ("real instability at S = 1", Verdict.AGREES, "1.17127573"),
        ("real and complex instabilities at S = 3", Verdict.AGREES, "10 complex"),
        ("higher harmonics of the family j = 1", Verdict.DISAGREES, "2.298"),
        ("generally stable", Verdict.IN_RANGE, "j = 24, g = -1: none to S = 3"),
        ("a kick of 0.005 at the left end", Verdict.AGREES, "per cent"),
        ("c_j = 2 delta", Verdict.MISPRINT, "25.000000"),
        ("collapse to omega_0^2", Verdict.AGREES, "0e+00"),
        ("windows alternate", Verdict.AGREES, "47 changes"),
        ("for gamma in (0, 1]", Verdict.IN_RANGE, "1 eigenvector"),
        ("V, of W = J V, is Hermitian and symplectic", Verdict.MISPRINT, "0e+00"),
        ("holds whenever U^T = U", Verdict.MISPRINT, "at gamma = 0"),
        ("j = 1 is similar to the linear skin mode", Verdict.AGREES, "0.9962"),
        ("a power law in N is expected", Verdict.AGREES, "at N = 4000"),
        ("S ~ r^p is expected", Verdict.MISPRINT, "falls with r"),
    ):
        claim = found(claims, words)
        assert claim.verdict == verdict.value, claim
        assert number in claim.ours, claim
