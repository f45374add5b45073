"""Searches among the periodic orbits of any model: against plain orbits, in processes, and what is refused.

At the end among the families of second-order models in odd cosines: against the chain's own and closed forms.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.io import netcdf_file
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ellipk

from casadi_skin import Chain, OdeModel, find_orbit, search_orbit
from casadi_skin.optimise.search import SearchResult, SearchStatus, pareto_front, stated_search
from casadi_skin.optimise.search import search as run_search
from casadi_skin.optimise.search_problem import Ending, Outcome
from casadi_skin.results.branch_records import data_of, value_of
from casadi_skin.results.tables import write_search

Q, V, OMEGA, T = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
FIELD = ca.vertcat(V, -Q - Q**3 - 0.2 * V + 0.1 * ca.cos(OMEGA * T))
DUFFING = OdeModel(
    "Duffing", ca.vertcat(Q, V), FIELD, OMEGA, time=T, forcing_period=2 * ca.pi / OMEGA, nominal=(1.0,),
    outputs={"square": Q**2},
)  # fmt: skip


ASKED: dict[str, Any] = {
    "guess": [0.0, 0.0], "free": ["omega"], "running": -(Q**2), "bounds": {"omega": (0.3, 2.0)},
}  # fmt: skip


def search(**changes: Any) -> SearchResult:
    return search_orbit(DUFFING, **(ASKED | {"starts": 3} | changes))


@pytest.fixture(scope="module")
def largest() -> SearchResult:
    return search()


def test_the_largest_response_is_that_of_a_search_over_plain_orbits(largest: SearchResult) -> None:
    best = largest.best
    assert largest.status is SearchStatus.FOUND
    assert (best.kkt.largest < 1e-8, best.check.difference < 1e-9, best.active) == (True, True, ())
    assert len(largest.outcomes) == 3

    def response(omega: float) -> float:
        orbit = find_orbit(DUFFING, best.orbit, parameters={"omega": omega}, tolerance=1e-10)
        return -float(np.mean(orbit.evaluate(orbit.period * np.arange(64) / 64)[:, 0] ** 2))

    found = minimize_scalar(response, bounds=(best.orbit["omega"] - 0.02, best.orbit["omega"] + 0.02))
    assert best.orbit["omega"] == pytest.approx(found.x, abs=1e-4)
    assert best.objective == pytest.approx(found.fun, abs=1e-8)


def test_an_optimum_on_a_bound_says_which() -> None:
    result = search(bounds={"omega": (0.3, 1.05)}, starts=1)
    assert result.status is SearchStatus.ON_BOUND
    assert result.best.active == ("omega <= 1.05",)
    assert "omega <= 1.05" in result.reason


def test_a_search_that_no_orbit_can_meet_tells_why() -> None:
    result = search(bounds={"omega": (1.0, 1.05), "q": (-1e-3, 1e-3)}, parameters={"omega": 1.02}, starts=1)
    assert (result.status, result.optima) == (SearchStatus.INFEASIBLE, ())
    assert "no start met the constraints; the equation of " in result.reason
    with pytest.raises(ValueError, match="search: no optimum"):
        _ = result.best


def test_names_say_the_same_as_expressions(largest: SearchResult) -> None:
    result = search(running="square", maximise=True, starts=1)
    assert result.best.objective == pytest.approx(-largest.best.objective, abs=1e-12)
    assert result.best.omega == pytest.approx(largest.best.omega, abs=1e-9)
    assert result.best.square == pytest.approx(result.best.q**2)  # at phase zero


@pytest.mark.parametrize("held", [("q", 0.2, 0.2), (Q, 0.2, 0.2), Q - 0.2])
def test_a_condition_holds_at_phase_zero(held: Any) -> None:
    best = search(running="square", maximise=True, constraints=[held], starts=1).best
    assert best.orbit.evaluate(0.0)[0] == pytest.approx(0.2, abs=1e-9)
    plain = find_orbit(DUFFING, [0.0, 0.0], parameters={"omega": best.omega})
    assert plain.evaluate(0.0)[0] == pytest.approx(0.2, abs=1e-7)
    assert best.curvature == np.inf  # one condition and one free number: nothing is left to optimise


@pytest.mark.slow
def test_a_condition_that_cannot_hold_is_off_by_the_least_at_the_nearest_orbit() -> None:
    result = search(running="square", maximise=True, constraints=[("q", 0.3, 0.3)], starts=1)
    assert result.status is SearchStatus.INFEASIBLE
    assert result.nearest is not None
    assert result.nearest.worst == "q"

    def response(omega: float) -> float:
        return -float(find_orbit(DUFFING, [0.0, 0.0], parameters={"omega": omega}).evaluate(0.0)[0])

    most = -minimize_scalar(response, bounds=(0.5, 1.1), options={"xatol": 1e-4}).fun
    assert result.nearest.gap == pytest.approx(0.3 - most, abs=1e-6)


@pytest.mark.slow
def test_a_bound_on_a_quantity_is_active() -> None:
    bounds = {"omega": (0.3, 2.0), "v": (None, 0.2)}
    result = search(running="square", maximise=True, bounds=bounds, constraints=[], starts=1)
    assert result.status is SearchStatus.ON_BOUND
    assert "v <= 0.2 at " in result.best.active[0]  # a state is bounded over the whole period
    assert np.max(result.best.orbit.states[:, 1]) <= 0.2 + 1e-9


@pytest.mark.slow
def test_conditions_on_one_quantity_are_two(largest: SearchResult) -> None:
    best = search(constraints=[("q", None, 10.0), ("q", -10.0, None)], starts=1).best
    assert list(best.conditions) == ["q", "q (2)"]
    assert best.curvature == pytest.approx(largest.best.curvature, rel=1e-6)


@pytest.mark.slow
def test_starts_that_are_known_are_not_run_again(largest: SearchResult, monkeypatch: pytest.MonkeyPatch) -> None:
    problem, kept = stated_search(DUFFING, **ASKED), list[Outcome]()
    result = run_search(problem, problem.starts(3, 0)[:2], keep=kept.append)
    assert [outcome.start.number for outcome in kept] == [1, 2]
    known = [value_of(data_of(outcome)) for outcome in result.outcomes]
    again = run_search(problem, problem.starts(3, 0), known=known, keep=kept.append)
    assert [outcome.start.number for outcome in kept] == [1, 2, 3]
    assert again.best.starts == largest.best.starts
    assert again.best.objective == pytest.approx(largest.best.objective, abs=1e-12)
    monkeypatch.setattr("casadi_skin.optimise.search.solve_start", lambda *_, **__: pytest.fail("run again"))
    complete = run_search(problem, problem.starts(3, 0), known=again.outcomes)
    assert complete.best.objective == again.best.objective


@pytest.mark.slow
def test_deflation_uses_repeated_starts_once_more(largest: SearchResult) -> None:
    result = search(deflate=True)
    assert [(o.start.number, o.deflated) for o in result.outcomes] == [(1, False), (2, False), (3, False), (2, True),
                                                                       (3, True)]  # fmt: skip
    assert result.best.objective == pytest.approx(largest.best.objective, abs=1e-12)


@pytest.mark.slow
def test_a_pareto_front_of_any_model() -> None:
    """Frequency against response: below resonance the least response asks for the longest period."""
    front = pareto_front(
        DUFFING, "period", "q", points=3, free=["omega"], guess=[0.0, 0.0], bounds={"omega": (0.3, 0.6)}, starts=1
    )
    assert front.complete
    assert np.all(np.diff(front.values[:, 0]) < 0)
    assert np.all(np.diff(front.values[:, 1]) > 0)
    for (period, q), optimum in zip(front.values, front.points, strict=True):
        orbit = find_orbit(DUFFING, [0.0, 0.0], parameters={"omega": 2 * np.pi / period})
        assert orbit.evaluate(0.0)[0] == pytest.approx(q, abs=1e-7)
        assert optimum.period == period


def lifted(name: str) -> OdeModel:
    """A driven linear oscillator at rest at the value of its parameter."""
    a = ca.SX.sym(name)
    field = ca.vertcat(V, a - Q - V + ca.cos(T))
    return OdeModel("driven", ca.vertcat(Q, V), field, a, time=T, forcing_period=2 * ca.pi, nominal=(0.5,))


def test_a_saddle_is_no_optimum(tmp_path: Path) -> None:
    """q(0) - q(0)^2 is largest at q = 1/2; a parameter called gamma is no nonreciprocity in files."""
    asked: dict[str, Any] = {"guess": [0.5, 0.0], "objective": Q - Q**2, "starts": 1}
    result = search_orbit(lifted("a"), free=["a"], **asked)
    assert result.outcomes[0].ending is Ending.NO_OPTIMUM
    assert "curvature" in result.reason
    largest = search_orbit(lifted("gamma"), free=["gamma"], maximise=True, **asked)
    assert largest.best.gamma == pytest.approx(0.5, abs=1e-8)
    assert largest.best.objective == pytest.approx(0.25, abs=1e-10)
    write_search(largest, tmp_path, "", "")
    with netcdf_file(tmp_path / "search.nc", mmap=False) as file:
        assert file.variables["optimum_gamma"].long_name == b"gamma of the optimum"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"running": None}, "objective: given neither objective nor running"),
        ({"free": []}, "free: given none; accepted: one or more of omega"),
        ({"free": ["omga"]}, "free: given 'omga'"),
        ({"starts": 0}, "starts: given 0; accepted: a whole number >= 1"),
        ({"workers": True}, "workers: given True"),
        ({"running": ca.vertcat(Q, V)}, "running: given shape"),
        ({"running": ca.SX.sym("stranger")}, "running: depends on stranger"),
        ({"parameters": {"om": 1.0}}, "parameters: given 'om'"),
        ({"guess": [0.0]}, "guess: "),
        ({"running": Q == 1}, "running: given a comparison"),
        ({"running": "sqare"}, "running: given 'sqare'; did you mean square"),
        ({"running": "period"}, "running: given 'period'"),
        ({"constraints": [("q", 1.0)]}, "constraints, item 1: given"),
        ({"constraints": [("p", 1.0, 2.0)]}, "constraints, item 1: given 'p'"),
        ({"bounds": {"p": (1.0, 2.0)}}, "bounds: given 'p'"),
        ({"symmetric": True}, "symmetric: given for Duffing, which is forced"),
        ({"bounds": {"omega": (2.0, 1.0)}}, r"bounds.omega.: given \(2.0, 1.0\); accepted: \(lower, upper\)"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_any_solve(
    changes: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("casadi_skin.zero.statement.Statement.solve", lambda *_, **__: pytest.fail("solved"))
    with pytest.raises((ValueError, TypeError), match=words) as caught:
        search(**changes)
    assert len(str(caught.value).splitlines()) == 1


# Families in odd cosines ----------------------------------------------------------------------------------------------

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


@pytest.mark.slow
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
        (pendulum(), {"period": 6.0}, "given the option 'period'"),
    ],
)
def test_searches_of_families_that_cannot_be_meant_are_refused(
    model: OdeModel, changes: dict[str, Any], words: str
) -> None:
    asked: dict[str, Any] = {"objective": "Omega", "free": ("S",), "bounds": {"S": (0.1, 1.0)}}
    with pytest.raises((ValueError, TypeError), match=words) as caught:
        search_orbit(model, **(asked | changes))
    assert len(str(caught.value).splitlines()) == 1
