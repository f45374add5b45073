"""What boundary-value problems refuse, before any solve and in one line; and how failures name their cause."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from small_models import bratu

from casadi_skin import BoundaryValueProblem
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.ode import OdeModel

U, V, K = ca.SX.sym("u"), ca.SX.sym("v"), ca.SX.sym("stiffness")
STRING = OdeModel("string", ca.vertcat(U, V), ca.vertcat(V, -K * U), K)
START, END = STRING.start(U), STRING.end(U)
GIVEN = {"parameters": {"stiffness": 1.0}}


def stated(**changes: Any) -> BoundaryValueProblem:
    return BoundaryValueProblem(**({"model": STRING, "conditions": [START, END - 1]} | GIVEN | changes))  # type: ignore[arg-type]


def told(kinds: Any, make: Callable[[], object]) -> str:
    """The message of a refusal, in one line."""
    with pytest.raises(kinds) as error:
        make()
    message = str(error.value)
    assert "\n" not in message
    return message


def refused(make: Callable[[], object]) -> str:
    return told((ValueError, TypeError), make)


def failing(make: Callable[[], object]) -> str:
    return told(BoundaryError, make)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"conditions": [START]}, "conditions: given 1 (1 at the ends and 0 integrals); accepted: 2, for 2 states"),
        ({"conditions": [START, END, END]}, "conditions: given 3"),
        ({"free": ["stiffness"]}, "conditions: given 2 (2 at the ends and 0 integrals); accepted: 3, for 2"),
        ({"conditions": [START, U]}, "conditions, number 2: depends on u; accepted: u(start), v(start)"),
        ({"conditions": [START, 0.0]}, "conditions, number 2: given 0.0; accepted: a CasADi expression of kind SX"),
        ({"conditions": "START"}, "conditions: given 'START'; accepted: a list of expressions, or a function f(start"),
        ({"conditions": lambda start, end: start}, "conditions: the function fails at CasADi symbols: TypeError"),
        ({"conditions": lambda start, end, p: None}, "conditions: given None; accepted: a CasADi expression"),
        ({"integrals": 3, "free": ["stiffness"]}, "integrals: given 3; accepted: a list of expressions"),
        ({"integrals": [START], "free": ["stiffness"]}, "integrals, number 1: depends on u(start); accepted: t, u"),
        ({"parameters": {"stifness": 1.0}}, "parameters: given 'stifness'; did you mean stiffness? accepted"),
        ({"parameters": {"stiffness": np.nan}}, "parameters, stiffness: given nan; accepted: a finite number"),
        ({"parameters": [1.0]}, "parameters: given [1.0]; accepted: numbers by name"),
        ({"free": "stiffness"}, "free: given 'stiffness'; accepted: a list"),
        ({"free": ["stiffness"] * 2}, "free: given ['stiffness', 'stiffness']; accepted: each parameter once"),
        ({"interval": (1.0, 0.0)}, "interval: given (1, 0); accepted: finite ends, the second larger"),
        ({"interval": (0.0, -K)}, "interval: given (0, -1); accepted: finite ends, the second larger"),
        ({"interval": (0.0, 1.0, 2.0)}, "interval: given (0.0, 1.0, 2.0); accepted: (start, end)"),
        ({"interval": ("a", 1.0)}, "interval: given 'a'; accepted: numbers or expressions in parameters"),
        ({"interval": (0.0, U)}, "interval: depends on u; accepted: stiffness"),
        ({"interval": (0.0, ca.vertcat(K, K))}, "interval: given an end of shape (2, 1); accepted: scalars"),
        ({"bounds": {"w": (0.0, 1.0)}}, "bounds: given 'w'; accepted: u, v"),
        ({"bounds": {"u": (1.0, 0.0)}}, "bounds[u]: given (1.0, 0.0); accepted: (lower, upper), lower <= upper"),
        ({"bounds": [(0.0, 1.0)]}, "bounds: given [(0.0, 1.0)]; accepted: (lower, upper) by name"),
        ({"objective": ca.vertcat(START, END)}, "objective: given shape (2, 1); accepted: a scalar expression"),
        ({"running": ca.vertcat(U, V)}, "running: given shape (2, 1); accepted: a scalar expression"),
        ({"objective": U}, "objective: depends on u; accepted: u(start)"),
        ({"running": U, "conditions": [START, END, START - 1]}, "given 3 with an objective; accepted: at most 2"),
        ({"model": "string"}, "model: given 'string'; accepted: an OdeModel"),
    ],
)  # fmt: skip
def test_statements_that_do_not_fit_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    assert words in refused(lambda: stated(**changes))


def test_ends_of_another_model_are_told_apart() -> None:
    other = OdeModel("other", ca.vertcat(U, V), ca.vertcat(V, -K * U), K)
    with pytest.raises(ValueError, match=r"number 1: depends on u\(start\) of another model; accepted: u\(start\)"):
        stated(conditions=[other.start(U), END])


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        ([0.0], "guess: given 1 at a time; accepted: 2 states: u, v"),
        ("zero", "guess: given 'zero'; accepted: numbers, one a state; a function of t"),
        ([np.nan, 0.0], "guess: given [nan, 0.0]; accepted: numbers, one a state"),
        ({"w": 0.0}, "guess: given 'w'; accepted: u, v"),
        ({"u": "x"}, "guess: given 'x' for u; accepted: a number, or a function of t"),
        (lambda t: "x", "guess: the function fails: ValueError: could not convert string to float: 'x'"),
        (([0.0, 1.0, 2.0], np.ones((2, 2))), "guess: given times of shape (3,), states of shape (2, 2)"),
        (([0.0, 1.0], np.ones((2, 3))), "guess: given 3 at a time; accepted: 2 states: u, v"),
        (([1.0, 0.0], np.ones((2, 2))), "accepted: two or more ascending times, one row of states each"),
        (([0.0, np.nan], np.ones((2, 2))), "guess: given [0.0, nan]; accepted: numbers"),
        (([0.0, 1.0], np.full((2, 2), np.inf)), "guess: given array("),
    ],
)
def test_guesses_that_are_none_are_refused(guess: Any, words: str) -> None:
    assert words in refused(lambda: stated().solve(guess))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance": 0.0}, "tolerance: given 0.0; accepted: 1e-13 to 0.1"),
        ({"transcription": "gaus"}, "transcription: given 'gaus'; accepted: gauss, radau"),
        ({"corrector": "snopt"}, "corrector: given 'snopt'; accepted: ipopt, newton"),
        ({"degree": 13}, "degree: given 13; accepted: a whole number from 1 to 12"),
        ({"degree": 2.0}, "degree: given 2.0; accepted: a whole number"),
        ({"intervals": "many"}, "intervals: given 'many'; accepted: a whole number from 1 to 1500"),
        ({"tolerence": 1e-6}, "options: given 'tolerence'; did you mean tolerance? accepted: tolerance, transcription"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], words: str) -> None:
    assert words in refused(lambda: stated().solve([0.0, 0.0], **options))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"parameter": "stifness", "to": 2.0}, "parameter: given 'stifness'; did you mean stiffness?"),
        ({"parameter": "stiffness", "to": 1.0}, "to: given 1.0, where the branch starts; accepted: another number"),
        (
            {"parameter": "stiffness", "to": 2.0, "at": [3.0]},
            "at: given 3.0 as item 1; accepted: numbers from 1.0 to 2.0",
        ),
        ({"parameter": "stiffness", "to": 2.0, "max_points": 0}, "max_points: given 0; accepted: a whole number >= 2"),
        ({"parameter": "stiffness", "to": 2.0, "max_step": -1.0}, "max_step: given -1.0; accepted: a number > 0"),
    ],
)
def test_branches_that_cannot_be_are_refused(arguments: dict[str, Any], words: str) -> None:
    solution = stated().solve([0.0, 0.0])
    assert words in refused(lambda: solution.follow(**arguments))


@pytest.mark.parametrize("t", [2.0, -0.1, np.nan, "a"])
def test_times_outside_are_refused(t: Any) -> None:
    with pytest.raises((ValueError, TypeError), match=r"t: given .*; accepted: "):
        stated().solve([0.0, 0.0]).evaluate(t)


# Failures -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_an_infeasible_string_names_both_ends(corrector: str) -> None:
    """u'' = -pi^2 u with u(0) = 0, u(1) = 1 has no solution."""
    problem = stated(parameters={"stiffness": np.pi**2})
    message = failing(lambda: problem.solve([0.0, 0.0], corrector=corrector))
    assert "string: no solution near the guess" in message
    assert "at condition 2 (u(end)-1)" in message
    assert "condition 1 (u(start)) and condition 2 (u(end)-1) repeat or contradict each other" in message
    assert "leave v (most at t = 0) undetermined" in message


@pytest.mark.parametrize("corrector", [pytest.param("ipopt", marks=pytest.mark.slow), "newton"])
@pytest.mark.parametrize(("second", "text"), [(START - 1, "u(start)-1"), (2 * START, "2*u(start)")])
def test_a_condition_given_twice_is_named(corrector: str, second: ca.SX, text: str) -> None:
    message = failing(lambda: stated(conditions=[START, second]).solve([1.0, 0.0], corrector=corrector))
    message = message.replace("2.*", "2*")  # as CasADi 3.8 writes it
    assert f"condition 1 (u(start)) and condition 2 ({text}) repeat or contradict each other" in message
    # Every c (sin t, cos t) has u(0) = 0 and 2 u(0) = 0: beside one of them, relative to its sizes, u and v tie.
    tied = "u (most at t = 1)" in message and text.startswith("2")
    assert "v (most at t = 0)" in message or tied


@pytest.mark.parametrize(
    ("changes", "corrector", "words"),
    [
        *(({"parameters": {"stiffness": 0.0}, "conditions": [STRING.start(V), STRING.end(V)]}, corrector,  # u'' = 0
           ("condition 1 (v(start)) and condition 2 (v(end)) repeat or contradict", "leave u (most at t = "))
          for corrector in ("newton", "ipopt")),
        ({"conditions": [START, END], "integrals": [U**2 + 1], "free": ["stiffness"]}, "ipopt",
         ("integral 1 (sq(u)+1)", " stiffness undetermined")),
        ({"conditions": [START**2 + 1, END]}, "newton", ("condition 1 (sq(u(start))+1) leaves",)),
    ],
    ids=["a level", "a level by Ipopt", "a parameter", "no real solution"],
)  # fmt: skip
def test_what_nothing_fixes_is_named(changes: dict[str, Any], corrector: str, words: tuple[str, ...]) -> None:
    message = failing(lambda: stated(**changes).solve([1.0, 0.0], corrector=corrector))
    assert all(one in message for one in words)


@pytest.mark.parametrize("corrector", [pytest.param("ipopt", marks=pytest.mark.slow), "newton"])
def test_beyond_a_fold_the_variable_and_the_place_are_named(corrector: str) -> None:
    message = failing(lambda: bratu(4.0).solve([0.0, 0.0], corrector=corrector))
    assert message.startswith("Bratu: no solution near the guess: ")
    assert "at the equation of v at t = " in message
    assert "with lam = 4" in message


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_a_guess_where_the_field_has_no_value_is_named(corrector: str, capfd: pytest.CaptureFixture[str]) -> None:
    model = OdeModel("logarithm", ca.vertcat(U, V), ca.vertcat(V, ca.log(U)))
    problem = BoundaryValueProblem(model, [model.start(U) - 1, model.end(U) - 1])
    message = failing(lambda: problem.solve([-1.0, 0.0], corrector=corrector))
    assert "not finite at the equation of v at t = " in message
    assert capfd.readouterr() == ("", "")


def test_a_tolerance_out_of_reach_is_told() -> None:
    problem = stated(parameters={"stiffness": 4.0})
    message = failing(lambda: problem.solve([0.0, 0.0], degree=1, tolerance=1e-12))
    assert "more than 1500 intervals are needed for the tolerance; try a larger one" in message


def test_the_place_of_a_failure_follows_a_free_end() -> None:
    """u = log x left of zero: places are those of the interval at the guessed length, not of parameters that are 0."""
    T = ca.SX.sym("T")
    model = OdeModel("free", ca.vertcat(U, V), ca.vertcat(V, ca.log(U)), T)
    conditions = [model.start(U) - 1, model.end(U) - 2, model.end(V)]
    problem = BoundaryValueProblem(model, conditions, (), (2.0, 2.0 + T), {"T": 4.0}, ["T"])
    message = failing(lambda: problem.solve(lambda t: [4.0 - t, 0.0]))
    place = float(message.split(" at t = ")[1].split(",")[0])
    assert 4.0 < place < 6.0


def test_conditions_are_counted_one_by_one() -> None:
    x = ca.SX.sym("x", 2)
    model = OdeModel("line", x, ca.vertcat(x[1], -x[0]))
    problem = BoundaryValueProblem(model, lambda start, end, p: [start[0], end[0] - 1.0])
    assert repr(problem) == "<BoundaryValueProblem: line from 0.0 to 1.0, 2 conditions, 0 integrals>"
