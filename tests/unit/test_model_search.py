"""Searches among the periodic orbits of any model: against plain orbits, in processes, and what is refused."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from casadi_skin import OdeModel, find_orbit, search_orbit
from casadi_skin.optimise.processes import SearchProgress
from casadi_skin.optimise.result import SearchResult, SearchStatus

Q, V, OMEGA, T = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
FIELD = ca.vertcat(V, -Q - Q**3 - 0.2 * V + 0.1 * ca.cos(OMEGA * T))
DUFFING = OdeModel(
    "Duffing", ca.vertcat(Q, V), FIELD, OMEGA, time=T, forcing_period=2 * ca.pi / OMEGA, nominal=(1.0,),
)  # fmt: skip


def search(**changes: Any) -> SearchResult:
    asked: dict[str, Any] = {
        "guess": [0.0, 0.0], "free": ["omega"], "running": -(Q**2), "bounds": {"omega": (0.3, 2.0)}, "starts": 3,
    }  # fmt: skip
    return search_orbit(DUFFING, **(asked | changes))


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


def test_progress_tells_of_every_start() -> None:
    told: list[SearchProgress] = []
    search(starts=2, progress=told.append)
    assert [p.done for p in told] == sorted(p.done for p in told)
    assert {(p.start, p.done) for p in told} == {(1, 0), (1, 1), (2, 1), (2, 2)}
    assert str(told[-1]).startswith("2 of 2 starts done; start 2, iteration")


@pytest.mark.slow
def test_processes_find_the_same(largest: SearchResult) -> None:
    result = search(workers=2)
    assert [o.starts for o in result.optima] == [o.starts for o in largest.optima]
    assert result.best.objective == pytest.approx(largest.best.objective, abs=1e-12)


def test_a_model_that_was_pickled_is_the_same_model() -> None:
    again: OdeModel = pickle.loads(pickle.dumps(DUFFING))
    point = (0.3, [0.1, -0.2], [1.2])
    assert np.array_equal(np.array(again.vector_field(*point)), np.array(DUFFING.vector_field(*point)))
    assert (again.state_names, again.nominal, again.forced) == (DUFFING.state_names, DUFFING.nominal, True)


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
        ({"bounds": {"omega": (2.0, 1.0)}}, r"bounds.omega.: given \(2.0, 1.0\); accepted: \(lower, upper\)"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_any_solve(
    changes: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("casadi_skin.optimise.orbit_search.OrbitSearch.plain", lambda *_: pytest.fail("solved"))
    with pytest.raises(ValueError, match=words) as caught:
        search(**changes)
    assert len(str(caught.value).splitlines()) == 1
