"""Searches among the periodic orbits of any model near a guess: against plain orbits, and what is refused."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import ellipk

from casadi_skin import Chain, OdeModel, find_orbit, search_orbit
from casadi_skin.search.conditions import sampled_starts
from casadi_skin.search.design import Design, Ending, best_of
from casadi_skin.solve.processes import SearchProgress

Q, V, OMEGA, T = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
FIELD = ca.vertcat(V, -Q - Q**3 - 0.2 * V + 0.1 * ca.cos(OMEGA * T))
DUFFING = OdeModel(
    "Duffing", ca.vertcat(Q, V), FIELD, OMEGA, time=T, forcing_period=2 * ca.pi / OMEGA, nominal=(1.0,),
    outputs={"square": Q**2},
)  # fmt: skip


ASKED: dict[str, Any] = {
    "guess": [0.0, 0.0], "free": ["omega"], "running": -(Q**2), "bounds": {"omega": (0.3, 2.0)},
}  # fmt: skip


def search(**changes: Any) -> Design:
    return search_orbit(DUFFING, **(ASKED | {"starts": 3} | changes))


@pytest.fixture(scope="module")
def largest() -> Design:
    return search()


def test_the_largest_response_is_that_of_a_search_over_plain_orbits(largest: Design) -> None:
    best = largest.best
    assert best is largest
    assert best.reason == "found an optimum inside its bounds; 3 of 3 starts led to it"
    assert max(best.optimality, 10.0 * best.violation, 10.0 * best.difference) < 1e-8
    assert best.active == ()
    assert len(largest.starts) == 3
    assert largest.orbits == (largest.orbit,)
    assert largest.path[-1] == [best.omega]
    assert largest.values[-1] == largest.objective

    def response(omega: float) -> float:
        orbit = find_orbit(DUFFING, best.orbit, parameters={"omega": omega}, tolerance=1e-10)
        return -float(np.mean(orbit.evaluate(orbit.period * np.arange(64) / 64)[:, 0] ** 2))

    found = minimize_scalar(response, bounds=(best.orbit["omega"] - 0.02, best.orbit["omega"] + 0.02))
    assert best.orbit["omega"] == pytest.approx(found.x, abs=1e-4)
    assert best.objective == pytest.approx(found.fun, abs=1e-8)


def test_an_optimum_on_a_bound_says_which() -> None:
    result = search(bounds={"omega": (0.3, 1.05)}, starts=1)
    assert result.best.active == ("omega <= 1.05",)
    low, high = (search(bounds={"omega": (0.3, bound)}, starts=1).value for bound in (1.0499, 1.0501))
    assert result.multipliers["omega <= 1.05"] == pytest.approx((high - low) / 0.0002, rel=1e-5)
    assert "omega <= 1.05" in result.reason


def test_a_search_that_no_orbit_can_meet_tells_why() -> None:
    result = search(bounds={"omega": (1.0, 1.05), "q": (-1e-3, 1e-3)}, parameters={"omega": 1.02}, starts=1)
    assert (result.status, result.found, result.optima) == (Ending.INFEASIBLE, False, ())
    assert "the constraints are not met; the equation of " in result.reason
    with pytest.raises(ValueError, match="design: no optimum; the constraints"):
        _ = result.best
    with pytest.raises(ValueError, match="design: nothing is located; the constraints"):
        _ = result.orbit
    with pytest.raises(AttributeError, match="design: given square; "):
        _ = result.square


def test_names_say_the_same_as_expressions(largest: Design) -> None:
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


def test_the_multiplier_of_an_equality_is_the_derivative_of_the_value() -> None:
    low, there, high = (
        search(running="square", maximise=True, constraints=[("q", q, q)], starts=1) for q in (0.199, 0.2, 0.201)
    )
    assert there.multipliers["q = 0.2"] == pytest.approx((high.value - low.value) / 0.002, rel=1e-4)
    assert there.active == ()


@pytest.mark.slow
def test_a_condition_that_cannot_hold_is_off_by_the_least_at_the_nearest_orbit() -> None:
    result = search(running="square", maximise=True, constraints=[("q", 0.3, 0.3)], starts=1)
    assert result.status is Ending.INFEASIBLE

    def response(omega: float) -> float:
        return -float(find_orbit(DUFFING, [0.0, 0.0], parameters={"omega": omega}).evaluate(0.0)[0])

    most = minimize_scalar(response, bounds=(0.5, 1.1), options={"xatol": 1e-6})
    assert result["omega"] == pytest.approx(most.x, abs=1e-4)
    assert f"q is off by {0.3 + most.fun:.3g} at the nearest design" in result.reason


@pytest.mark.slow
def test_a_bound_on_a_quantity_is_active() -> None:
    bounds = {"omega": (0.3, 2.0), "v": (None, 0.2)}
    result = search(running="square", maximise=True, bounds=bounds, constraints=[], starts=1)
    assert "the optimum sits on a bound: v <= 0.2 at " in result.reason
    assert "v <= 0.2 at " in result.best.active[0]  # a state is bounded over the whole period
    assert np.max(result.best.orbit.states[:, 1]) <= 0.2 + 1e-9


@pytest.mark.slow
def test_conditions_on_one_quantity_are_two(largest: Design) -> None:
    best = search(constraints=[("q", None, 10.0), ("q", -10.0, None)], starts=1).best
    assert best.conditions == {"q": pytest.approx(best.q, rel=1e-12)}  # of one name, as in other designs
    assert best.curvature == pytest.approx(largest.best.curvature, rel=1e-6)


def lifted(name: str) -> OdeModel:
    """A driven linear oscillator at rest at the value of its parameter."""
    a = ca.SX.sym(name)
    field = ca.vertcat(V, a - Q - V + ca.cos(T))
    return OdeModel("driven", ca.vertcat(Q, V), field, a, time=T, forcing_period=2 * ca.pi, nominal=(0.5,))


def test_orbits_of_a_conservative_model_are_searched_over_the_whole_period() -> None:
    """The unfolding of the Hamiltonian is zero but for rounding, which has no size of its own."""
    stiffness = ca.SX.sym("mu")
    model = OdeModel(
        "spring", ca.vertcat(Q, V), ca.vertcat(V, -Q - stiffness * Q**3), stiffness, nominal=(1.0,),
        hamiltonian=V**2 / 2 + Q**2 / 2 + stiffness * Q**4 / 4,
    )  # fmt: skip
    result = search_orbit(
        model, guess=lambda t: [np.cos(1.3 * t), -1.3 * np.sin(1.3 * t)], period=4.8, select=Q - 1.0, section=V,
        free=["mu"], bounds={"mu": (0.5, 2.0)}, objective="period", starts=1,
    )  # fmt: skip
    assert result.best.mu == pytest.approx(2.0, abs=1e-9)
    assert result.period == result.value == pytest.approx(4.0 / np.sqrt(3.0) * ellipk(1 / 3), rel=1e-9)
    low, high = (4.0 / np.sqrt(1.0 + mu) * ellipk(mu / (2.0 + 2.0 * mu)) for mu in (1.9999, 2.0001))
    assert result.multipliers["mu <= 2"] == pytest.approx((high - low) / 0.0002, rel=1e-6)


@pytest.mark.parametrize(("objective", "way"), [(Q, -1.0), (Q**2, 1.0)])
def test_a_free_number_without_a_bound_runs_off(objective: ca.SX, way: float) -> None:
    """q(0) = a + 0.5 or so: neither it nor its negative square is bounded from below."""
    result = search_orbit(
        lifted("a"), guess=[0.5, 0.0], free=["a"], objective=objective, maximise=way > 0.0, starts=1
    )  # fmt: skip
    assert (result.status, result.found) == (Ending.UNBOUNDED, False)
    assert way * result.value > 1e8
    assert result.reason.startswith(f"ran off without bound; a = {result.parameters['a']:.3g}, objective = ")


def test_a_saddle_is_no_optimum() -> None:
    """q(0) - q(0)^2 is largest at q = 1/2."""
    asked: dict[str, Any] = {"guess": [0.5, 0.0], "objective": Q - Q**2, "starts": 1}
    result = search_orbit(lifted("a"), free=["a"], **asked)
    assert result.status is Ending.NO_OPTIMUM
    assert "curvature" in result.reason
    largest = search_orbit(lifted("gamma"), free=["gamma"], maximise=True, **asked)
    assert largest.best.gamma == pytest.approx(0.5, abs=1e-8)
    assert largest.best.objective == pytest.approx(0.25, abs=1e-10)
    assert largest.engine.startswith("Ipopt")


@pytest.mark.slow
def test_two_processes_find_what_one_finds(largest: Design) -> None:
    told = list[SearchProgress]()
    together = search(workers=2, progress=told.append)
    assert together.best.objective == largest.best.objective
    assert together.starts == largest.starts
    assert together.reason == largest.reason
    assert {progress.start for progress in told} == {1, 2, 3}


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_keeps_the_best() -> None:
    import os
    import signal

    def tell(progress: SearchProgress) -> None:
        if progress.start == 2:
            os.kill(os.getpid(), signal.SIGINT)

    result = search(starts=6, progress=tell)
    assert result.found
    assert result.reason.startswith("interrupted after 2 of 6 starts; found an optimum")
    assert [words.partition(";")[0] for words in result.starts] == ["found an optimum inside its bounds", "interrupted"]


def ended(value: float, status: Ending, violation: float = 0.0, place: float = 0.0, maximise: bool = False) -> Design:
    """The design of a start that ended so."""
    path, words = np.array([[place]]), f"{status.value} with {value:g}"
    return Design(
        "height", maximise, value, 0.0, {"a": place}, {"a": (0.0, 1.0)}, path, np.array([value]), status, words,
        violation=violation,
    )  # fmt: skip


def test_the_best_of_several_starts_is_the_best_optimum() -> None:
    """Two starts lead to one optimum at 0.5, one to another at 0.7; what is not met or runs off is none."""
    ends = [
        ended(1.0, Ending.FOUND, place=0.7), ended(0.5, Ending.FOUND), ended(-9.0, Ending.INFEASIBLE, 1.0),
        ended(0.5, Ending.FOUND, place=1e-6), ended(0.6, Ending.FOUND), ended(-1e9, Ending.UNBOUNDED),
    ]  # fmt: skip
    best = best_of(ends)
    assert (best.value, best.found) == (0.5, True)
    assert (
        best.reason
        == "found an optimum with 0.5; 2 of 6 starts led to it; 1 ran off without bound, so it is a local one"
    )
    assert [one.value for one in best.others] == [0.6, 1.0]  # one at the place of the best has another value
    assert best.starts == tuple(end.reason for end in ends)
    largest = [replace(end, maximise=True) for end in ends]
    assert [one.value for one in best_of(largest).optima] == [1.0, 0.6, 0.5]


def test_without_an_optimum_the_nearest_start_tells_why() -> None:
    near, far = ended(5.0, Ending.INFEASIBLE, 0.1), ended(1.0, Ending.INFEASIBLE, 0.2)
    nowhere, away = ended(np.nan, Ending.NOT_LOCATED, np.inf), ended(-1e9, Ending.UNBOUNDED, 1.0)
    assert best_of([nowhere, far, near]).reason == near.reason
    assert best_of([nowhere, far, near, away]).status is Ending.UNBOUNDED
    assert best_of([nowhere, ended(3.0, Ending.FAILED), near]).status is Ending.FAILED
    assert (
        best_of([nowhere], "interrupted after 1 of 2 starts").reason
        == f"interrupted after 1 of 2 starts; {nowhere.reason}"
    )
    assert best_of([nowhere]).optima == ()


@pytest.mark.parametrize(("of_value", "of_parameter"), [(1.0, 1.0), (1e-8, 1.0), (1e8, 1.0), (1.0, 1e-6), (1.0, 1e6)])
def test_an_optimum_is_one_in_any_unit(of_value: float, of_parameter: float) -> None:
    """Van der Pol's largest position is 2.005 at mu = 0.728: in a unit of 1e8 the search ended where it began."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    field = ca.vertcat(y, mu / of_parameter * (1 - x**2) * y - x)
    model = OdeModel("van der Pol", ca.vertcat(x, y), field, mu, nominal=(of_parameter,))
    found = search_orbit(
        model, guess=lambda t: [2 * np.cos(t), -2 * np.sin(t)], period=6.3, section=y, free=["mu"], starts=1,
        objective=of_value * (x - 2.005) ** 2, bounds={"mu": (0.2 * of_parameter, 3 * of_parameter)},
    )  # fmt: skip
    assert found.reason == "found an optimum inside its bounds"
    assert found.parameters["mu"] == pytest.approx(0.727739 * of_parameter, rel=2e-6)
    assert max(found.optimality, found.violation) < 1e-10
    assert found.value < 1e-15 * of_value


def in_units(problem: str, x: float, t: float, p: float) -> Any:
    """One of three searches whose states, times and parameters have units of these sizes."""
    name = "mu" if problem == "vdp" else "omega"
    mu, position, velocity = ca.SX.sym(name), Q / x, V * t / x
    if problem == "vdp":
        force = p * mu * (1 - position**2) * velocity - position
        model = OdeModel("van der Pol", ca.vertcat(Q, V), ca.vertcat(V, x / t**2 * force), mu, nominal=(0.5 / p,))
        return search_orbit(
            model, guess=lambda s: [2 * x * np.cos(s / t), -2 * x / t * np.sin(s / t)], period=6.4 * t, section=V,
            free=[name], bounds={name: (0.1 / p, 4 / p)}, objective="q", maximise=True, starts=1,
        )  # fmt: skip
    force = 0.1 * ca.cos(p * mu * T / t) - position - position**3 - 0.2 * velocity
    model = OdeModel(
        "Duffing", ca.vertcat(Q, V), ca.vertcat(V, x / t**2 * force), mu, time=T,
        forcing_period=2 * ca.pi * t / (p * mu), nominal=(1.0 / p,),
    )  # fmt: skip
    bounds: dict[str, Any] = {name: (0.3 / p, 2.0 / p)}
    bounds |= {"v": (None, 0.2 * x / t)} if problem == "bounded" else {}
    return search_orbit(model, guess=[0.0, 0.0], free=[name], bounds=bounds, running=-(Q**2), starts=1)


UNITS = [(1e-9, 1, 1), (1e9, 1, 1), (1, 1e-9, 1), (1, 1e9, 1), (1, 1, 1e-9), (1, 1, 1e9), (1e6, 1e-6, 1e3)]


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "power"), [("vdp", 1), ("free", 2), ("bounded", 2)])
def test_searches_end_alike_in_units_of_states_times_and_parameters(problem: str, power: int) -> None:
    """A bound on states holds at the points of a mesh, which moves with the last digits: by less than the errors."""
    plain = in_units(problem, 1.0, 1.0, 1.0)
    (name,) = plain.parameters
    near = 1e-8 * abs(plain.value) if problem != "bounded" else 2.0 * plain.error
    for x, t, p in UNITS:
        found = in_units(problem, x, t, p)
        assert (found.status, found.found) == (plain.status, True)
        assert found.value / x**power == pytest.approx(plain.value, rel=0.0, abs=near)
        assert found.parameters[name] * p == pytest.approx(plain.parameters[name], rel=1e-7)
        assert max(found.optimality, found.violation) < 1e-10


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_free_parameter_that_is_zero_has_the_unit_that_it_moves_states_by(unit: float) -> None:
    """The bent oscillator's mean of (q - 0.1)^2; in a unit of 1e9 the search had ended without an optimum."""
    force = ca.SX.sym("F")
    field = ca.vertcat(V, force * unit + 0.3 * Q**2 - Q - Q**3 - 0.2 * V + 0.3 * ca.cos(1.4 * T))
    model = OdeModel(
        "bent", ca.vertcat(Q, V), field, force, time=T, forcing_period=2 * ca.pi / 1.4, nominal=(0.0,)
    )  # fmt: skip
    found = search_orbit(model, guess=[0.0, 0.0], free=["F"], running=(Q - 0.1) ** 2, starts=1)
    assert found.reason == "found an optimum inside its bounds"
    assert found.value == pytest.approx(0.04901211206763, rel=1e-10)
    assert found.parameters["F"] * unit == pytest.approx(0.098, rel=1e-6)


def test_starts_spread_as_far_as_something_says() -> None:
    """Of a 0 the limits that there are; without any it stays 0, whatever unit it has."""
    for unit in (1e-9, 1.0, 1e9):
        starts = np.array(
            sampled_starts([0.0, 0.0, unit], [(-np.inf, np.inf), (-np.inf, 3 * unit), (0, 9 * unit)], 20, 1)
        )
        assert not np.any(starts[:, 0])
        assert -3 * unit < starts[1:, 1].min() < -2 * unit < 2 * unit < starts[:, 1].max() < 3 * unit
        assert 8 * unit < starts[:, 2].max() < 9 * unit


def test_what_searches_are_not_for_is_named() -> None:
    with pytest.raises(TypeError, match=r"model: given Chain.*accepted: an OdeModel"):
        search_orbit(Chain(6, 1.0, 0.3, 1.0), guess=[0.0], objective="S", free=("S",))
    with pytest.raises(TypeError, match="model: given 3; accepted: a Chain or an OdeModel"):
        search_orbit(3, objective="S", free=("S",))  # type: ignore[arg-type]
    with ThreadPoolExecutor(1) as threads, pytest.raises(TypeError, match="between threads"):
        search(executor=threads)


class Square(ca.Callback):  # type: ignore[misc]
    """A program, which no other process can have."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.construct("square", {"enable_fd": True})

    def eval(self, arguments: Any) -> Any:
        return [arguments[0] ** 2]


def test_a_program_of_the_caller_stays_in_its_process() -> None:
    state, square = ca.MX.sym("state", 2), Square()
    model = OdeModel("oscillator", state, ca.vertcat(state[1], -state[0]), a := ca.MX.sym("a"), nominal=(0.1,))
    stated: dict[str, Any] = {"guess": [1.0, 0.0], "period": 6.3, "free": ["a"], "workers": 2}
    for objective in ({"objective": square(state[0])}, {"objective": a, "constraints": [square(state[0])]}):
        with pytest.raises(ValueError, match="workers: given with the program square; accepted: 1"):
            search_orbit(model, **objective, **stated)


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
