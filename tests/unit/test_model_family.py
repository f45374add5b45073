"""Searches among the families of second-order models in odd cosines: against the chain's own and closed forms."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

from casadi_skin import Chain, OdeModel, search_orbit
from casadi_skin.optimise.result import SearchStatus
from casadi_skin.optimise.search_orbit import stated_search
from casadi_skin.optimise.search_problem import Ending, solve_start

CHAIN = Chain(sites=6, alpha=1.0, gamma=0.3, g=1.0)


def pendulum(**changes: Any) -> OdeModel:
    q, v, w = (ca.SX.sym(name) for name in "qvw")
    declared: dict[str, Any] = {
        "reversal": (1, -1), "half_period": (-1, -1), "hamiltonian": v**2 / 2 - w * ca.cos(q), "nominal": (1.0,),
    }  # fmt: skip
    return OdeModel("pendulum", q, -w * ca.sin(q), w, 2, v, **(declared | changes))


def frequency(S: float, w: float = 1.0) -> float:
    """Of a pendulum whose largest angle is sqrt(S), by the complete elliptic integral."""
    return float(np.pi * np.sqrt(w) / (2.0 * ellipk(np.sin(0.5 * np.sqrt(S)) ** 2)))


def test_a_chain_as_a_model_in_physical_coordinates_has_the_optimum_of_the_chain() -> None:
    asked: dict[str, Any] = {"objective": "Omega_slope", "free": ("gamma",), "bounds": {"gamma": (0.2, 0.8)}}
    own = search_orbit(CHAIN, starts=2, **asked).best
    best = search_orbit(CHAIN.tunable_model(), mode="last", starts=2, **asked).best
    assert best.gamma == pytest.approx(own.gamma, abs=1e-9)
    assert best.objective == pytest.approx(own.objective, abs=1e-12)
    assert best.curvature == pytest.approx(own.curvature, rel=1e-6)
    np.testing.assert_allclose(np.abs(best.orbit.profile), np.abs(own.orbit.profile), atol=1e-9)
    assert (best.starts, best.on_family) == ((1, 2), True)


def test_a_pendulum_meets_its_closed_form() -> None:
    """The largest amplitude whose frequency is 0.8 or more, and dOmega/dS there."""
    result = search_orbit(
        pendulum(), objective="S", maximise=True, free=("S",), bounds={"S": (0.1, 5.0), "Omega": (0.8, None)},
        constraints=[(lambda o: o.Omega_slope, -1.0, 1.0)], starts=2,
    )  # fmt: skip
    assert result.status is SearchStatus.ON_BOUND
    best, S = result.best, brentq(lambda S: frequency(S) - 0.8, 0.1, 5.0, xtol=1e-13)
    assert best.active == ("Omega >= 0.8",)
    assert pytest.approx(S, abs=1e-8) == best.S
    assert best.energy == pytest.approx(-np.cos(np.sqrt(S)), abs=1e-8)
    assert best.Omega_slope == pytest.approx((frequency(S + 1e-4) - frequency(S - 1e-4)) / 2e-4, abs=1e-7)
    assert abs(best.check.Omega_difference) < 1e-10
    assert best.check.family_difference == pytest.approx(0.0, abs=1e-8)


def test_a_parameter_and_several_amplitudes() -> None:
    """The w whose frequencies at S = 0.5 and 2 have the mean 1.2."""
    result = search_orbit(
        pendulum(), S=[0.5, 2.0], objective=lambda orbits: ((orbits[0].Omega + orbits[1].Omega) / 2 - 1.2) ** 2,
        free=("w",), bounds={"w": (0.5, 4.0)}, starts=1,
    )  # fmt: skip
    w = (2.4 / (frequency(0.5) + frequency(2.0))) ** 2
    assert result.best.w == pytest.approx(w, abs=1e-7)
    assert [o.Omega for o in result.best.orbits] == pytest.approx([frequency(S, w) for S in (0.5, 2.0)], abs=1e-7)


def test_a_search_that_was_pickled_leads_to_the_same() -> None:
    problem = stated_search(CHAIN.tunable_model(), mode="last", objective="Omega", free=("g",),
                            bounds={"g": (0.5, 2.0)})  # fmt: skip
    start = problem.starts(1, 0)[0]
    problem = problem.prepared(start)
    one, other = solve_start(problem, start), solve_start(pickle.loads(pickle.dumps(problem)), start)
    assert one.ending is Ending.CONVERGED
    np.testing.assert_array_equal(one.free, other.free)


@pytest.mark.parametrize(
    ("model", "changes", "words"),
    [
        (pendulum(half_period=None), {}, "guess: given none for pendulum; accepted: a guess of an orbit, or a model"),
        (pendulum().first_order(), {}, "guess: given none for pendulum"),
        (pendulum(parameter_labels=("S",)), {}, "given a parameter or output called S; accepted: other names"),
        (pendulum(), {"mode": 2}, "mode: given 2; accepted: 1..1, first, last"),
        (pendulum(normalisation=ca.SX(0)), {}, "normalisation: given with pendulum"),
        (pendulum(), {"mode": "middle"}, "mode: given 'middle'"),
        (pendulum(), {"parameters": {"w": -1.0}}, "mode 1 of pendulum does not oscillate: omega.2 = -1; accepted: "),
        (pendulum(), {"parameters": {"u": 1.0}}, "parameters: given 'u'"),
        (pendulum(), {"free": ("u",)}, "free: given 'u'"),
        (pendulum(hamiltonian=None), {"objective": "energy"}, "objective: given 'energy'"),
        (pendulum(), {"bounds": {"S": (-1.0, 2.0)}}, "bounds.S.: given"),
        (pendulum(), {"period": 6.0}, "unexpected keyword argument 'period'"),
    ],
)
def test_what_cannot_be_meant_is_refused(model: OdeModel, changes: dict[str, Any], words: str) -> None:
    asked: dict[str, Any] = {"objective": "Omega", "free": ("S",), "bounds": {"S": (0.1, 1.0)}}
    with pytest.raises((ValueError, TypeError), match=words) as caught:
        search_orbit(model, **(asked | changes))
    assert len(str(caught.value).splitlines()) == 1
