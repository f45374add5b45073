"""The checks of the extremes against other means, and what they find in results that are wrong."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from functools import partial

import mpmath
import numpy as np
import pytest

from casadi_skin import Chain, Orbit, follow_family
from casadi_skin.follow.branch import harmonic_shares, third_harmonic_leads
from tests.studies.exact import (
    LONG_DOUBLES,
    PI,
    cosine,
    exact_linear_frequency,
    exact_orbit,
    many_digits,
)
from tests.studies.extreme_case import Case, Finding, RefusedError, digits_of, measure
from tests.studies.extreme_checks import Setup, against_digits, against_duffing, shift_against_digits
from tests.studies.extreme_physical import compare
from tests.studies.integration import physical_multipliers, return_error

SOFTENING = Chain(24, 1.0, 0.25, -1.0)


def test_constants_and_frequencies_agree_with_mpmath() -> None:
    with mpmath.workdps(60), many_digits():
        assert abs(mpmath.mpf(str(PI)) - mpmath.pi) < mpmath.mpf(10) ** -55
        assert abs(mpmath.mpf(str(cosine(Decimal("0.7")))) - mpmath.cos(mpmath.mpf("0.7"))) < mpmath.mpf(10) ** -55
        coupling = mpmath.sqrt(1 - mpmath.mpf(SOFTENING.gamma) ** 2)
        for mode in (1, 12, 13, 24):
            omega = mpmath.sqrt(3 - 2 * coupling * mpmath.cos(mpmath.pi * mode / 25))
            assert abs(mpmath.mpf(str(exact_linear_frequency(SOFTENING, mode))) - omega) < mpmath.mpf(10) ** -50


def test_an_orbit_to_many_digits_satisfies_the_equations_of_motion() -> None:
    """By mpmath, between the nodes; and the orbit of one site has the frequency of the elliptic integral."""
    chain = Chain(2, 1.0, 0.25, -1.0)
    exact = exact_orbit(Setup(chain, 1, 1.0).orbit())
    with mpmath.workdps(50):
        c = [[mpmath.mpf(str(value)) for value in row] for row in exact.coefficients]
        Omega, theta = mpmath.mpf(str(exact.Omega)), mpmath.mpf("0.3")
        k = range(len(c[0]))
        y, second = (
            [sum(row[i] * (2 * i + 1) ** power * mpmath.cos((2 * i + 1) * theta) for i in k) for row in c]
            for power in (0, 2)
        )
        gamma = mpmath.mpf(chain.gamma)
        forces = (-3 * y[0] + (1 - gamma) * y[1] + y[0] ** 3, -3 * y[1] + (1 + gamma) * y[0] + y[1] ** 3)
        for acceleration, force in zip(second, forces, strict=True):
            assert abs(Omega**2 * acceleration + force) < mpmath.mpf(10) ** -20
    with mpmath.workdps(50):
        duffing = mpmath.pi * mpmath.sqrt(13) / (2 * mpmath.ellipk(mpmath.mpf(10) / 26))
        for sites, gamma in ((1, 0.0), (3, 1.0), (3, -1.0)):  # where |gamma| = 1 the edge site moves by itself
            single = Setup(Chain(sites, 1.0, gamma, 1.0), sites, 10.0).orbit()
            exact = exact_orbit(single)
            assert abs(mpmath.mpf(str(exact.Omega)) / duffing - 1) < 1e-22
            assert exact.profile_error(single) < 1e-12


def test_long_doubles_and_decimals_give_the_same_orbit() -> None:
    orbit = Setup(Chain(5, 1.0, -0.6, 1.0), 3, 2.0, 1e-6).orbit()
    long, many = exact_orbit(orbit, LONG_DOUBLES), exact_orbit(orbit)
    assert abs(float(long.Omega) / float(many.Omega) - 1) < 1e-15
    assert long.profile_error(orbit) == pytest.approx(many.profile_error(orbit), rel=1e-6)
    assert 1e-12 < many.profile_error(orbit) < 1e-6


def test_a_wrong_result_is_a_fault() -> None:
    setup = Setup(SOFTENING, 1, 1.0)
    orbit = setup.orbit()
    point, index = orbit.point, orbit.point.problem.Omega_index
    z = point.z.copy()
    z[index] *= 1.0 + 1e-9
    wrong = Orbit(orbit.space, replace(point, z=z), exact={"S": 1.0})
    outcome = measure(Case("theme", "name", "asked", "check", partial(against_digits, wrong, setup)))
    assert outcome.verdict == "fault"
    assert outcome.fault == "9.0 digits agree, 12.0 are promised"
    assert measure(Case("theme", "name", "asked", "check", partial(against_digits, orbit, setup))).verdict == "holds"


def _refuse(error: Exception) -> Finding:
    raise error


def test_refusals_are_those_expected() -> None:
    case = Case("theme", "name", "asked", "check", partial(_refuse, ValueError("g: given 0")))
    assert measure(case).fault == "refused: g: given 0"
    assert measure(replace(case, refusal="given 0")).verdict == "refused"
    assert "without" in measure(replace(case, refusal="mode")).fault
    computed = Case("theme", "name", "asked", "check", lambda: Finding("it", 0.0, 1.0), "ends")
    assert measure(computed).fault == "not refused"
    assert measure(replace(computed, may_hold=True)).verdict == "holds"
    bad = partial(_refuse, RefusedError("it ends", Finding("the last orbit", 1e-3, 1e-6)))
    assert "3.0 digits" in measure(Case("t", "n", "a", "c", bad, "ends", may_hold=True)).fault
    overflow = measure(replace(case, compute=lambda: Finding(str(np.exp(np.float64(1e3))), 0.0, 1.0)))
    assert "FloatingPointError" in overflow.fault


def test_digits() -> None:
    assert digits_of(0.0) == digits_of(1e-30) == 16.0
    assert digits_of(1e-9) == pytest.approx(9.0)
    assert digits_of(2.0) == digits_of(float("nan")) == 0.0


def test_a_shift_of_the_frequency_that_subtraction_does_not_see() -> None:
    setup = Setup(SOFTENING, 1, 1e-14)
    finding = shift_against_digits(setup.orbit(), setup)
    assert finding.error < 1e-13


def test_physical_coordinates_agree_where_they_work() -> None:
    orbit = Setup(Chain(3, 1.0, 0.25, 1.0), 2, 5.0, 1e-10).orbit()
    assert abs(abs(physical_multipliers(orbit)[0]) - orbit.floquet().max_abs_multiplier) < 1e-9
    assert return_error(orbit) < 1e-10


@pytest.mark.slow
def test_physical_coordinates_go_wrong_where_the_gauge_does_not() -> None:
    far = compare(40, 0.7)
    assert far.multiplier_physical > 1e-7
    assert far.frequency_physical > 1e-4
    assert max(far.multiplier_gauge, far.frequency_gauge, far.orbit_gauge) < 1e-13
    near = compare(8, 0.25)
    assert max(near.multiplier_physical, near.frequency_physical, near.orbit_physical) < 1e-13


# Harmonics ----------------------------------------------------------------------------------------------------------


def test_the_third_harmonic_takes_over_at_the_resonance() -> None:
    branch = follow_family(SOFTENING, 1, 3.5, tolerance=1e-9, corrector="newton")
    orbit = third_harmonic_leads(branch)
    assert abs(orbit.S - 3.17502) < 1e-4
    shares = harmonic_shares(orbit)
    assert abs(shares[0] - shares[1]) < 1e-6
    assert abs(shares.sum() - 1.0) < 1e-14
    physical = harmonic_shares(orbit, "physical")
    assert 0.01 < physical[1] < 0.1
    assert third_harmonic_leads(branch, "physical") is None
    with pytest.raises(ValueError, match="accepted: gauge, physical"):
        harmonic_shares(orbit, "modal")


def test_shares_of_a_nearly_linear_orbit_are_the_fundamental_alone() -> None:
    assert harmonic_shares(Setup(SOFTENING, 1, 1e-6, 1e-9).orbit())[0] == pytest.approx(1.0, abs=1e-10)


def test_a_single_site_against_the_elliptic_integral() -> None:
    setup = Setup(Chain(1, 1.0, 0.0, -1.0), 1, 2.5)
    assert against_duffing(setup.orbit(), setup).error < 1e-12
    assert against_duffing(setup.orbit(), replace(setup, S=2.5 + 1e-6)).error > 1e-8
