"""What scripts give where the meaning is plain: lists, functions, scipy's layouts; else one line says why not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import (
    Bond,
    BoundaryValueProblem,
    Chain,
    Lattice,
    OdeModel,
    Site,
    find_equilibrium,
    find_orbit,
    follow_family,
    import_fmu,
    optimise,
    search_orbit,
    smallest_kick,
)
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.expressions import real_array, site_numbers

X, Y, MU, T = (ca.SX.sym(name) for name in ("x", "y", "mu", "t"))
RHS = ca.vertcat(Y, MU * (1 - X**2) * Y - X)
PLAIN = OdeModel("plain", ca.vertcat(X, Y), RHS, MU, nominal=(0.5,))


def field(t: Any, x: Any, p: Any) -> list[Any]:
    return [x[1], p[0] * (1 - x[0] ** 2) * x[1] - x[0]]


def circle(t: Any) -> list[Any]:
    return [2 * np.cos(t), -2 * np.sin(t)]


# Models ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        {"state": [X, Y], "rhs": [Y, MU * (1 - X**2) * Y - X], "parameters": [MU]},
        {"state": (X, Y), "rhs": field, "parameters": (MU,)},
        {"state": np.array([X, Y]), "rhs": np.array([Y, MU * (1 - X**2) * Y - X]), "parameters": MU},
        {"rhs": lambda t, x, p: RHS},
        {"rhs": ca.Function("f", [T, ca.vertcat(X, Y), MU], [RHS])},
        {"nominal": np.array([0.5])},
        {"nominal": {"mu": 0.5}},
    ],
)
def test_models_from_lists_arrays_and_functions(given: dict[str, Any]) -> None:
    declared = {"state": ca.vertcat(X, Y), "rhs": RHS, "parameters": MU, "nominal": (0.5,)} | given
    model = OdeModel("given", **declared)
    point = (0.0, [0.3, -0.7], [0.5])
    np.testing.assert_array_equal(model.vector_field(*point), PLAIN.vector_field(*point))
    assert (model.state_names, model.parameter_names, model.nominal) == (("x", "y"), ("mu",), (0.5,))


def test_models_without_parameters_and_with_numbers() -> None:
    for parameters in (None, [], ca.SX(0, 1)):
        model = OdeModel("drift", [X, Y], [1, 0.5], parameters)
        assert model.parameter_names == ()
        np.testing.assert_array_equal(np.array(model.vector_field(0.0, [0.0, 0.0], [])).ravel(), [1.0, 0.5])
    spring = OdeModel("spring", X, lambda t, x, p: -x, None, 2, Y, reversal=np.array([1, -1]), half_period=[-1.0, -1.0],
                      hamiltonian=X**2 + Y**2, outputs={"two": 2, "force": lambda t, x, p: -x})  # fmt: skip
    assert (spring.reversal, spring.half_period) == ((1, -1), (-1, -1))
    assert float(spring.function("two", spring.outputs["two"])(0.0, [1.0, 0.0], [])) == 2.0
    assert float(spring.function("force", spring.outputs["force"])(0.0, [3.0, 0.0], [])) == -3.0


def test_mx_models_from_functions() -> None:
    x, p = ca.MX.sym("x", 2), ca.MX.sym("mu")
    model = OdeModel("matrix", x, field, p)
    np.testing.assert_allclose(model.vector_field(0.0, [0.3, -0.7], 0.5), PLAIN.vector_field(0.0, [0.3, -0.7], 0.5))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"rhs": None},
            "given: rhs: given None; accepted: a CasADi expression of kind SX, a list of them, or a function",
        ),
        ({"rhs": [Y, None]}, "given: rhs: given None; accepted: a CasADi expression"),
        ({"rhs": "y"}, "given: rhs: given 'y'; accepted"),
        ({"rhs": [Y, float("nan")]}, "given: rhs: given nan; accepted"),
        ({"rhs": [[Y, X]]}, "given: rhs: given [SX(y), SX(x)]; accepted"),
        ({"rhs": lambda x: x}, "given: rhs: the function fails at CasADi symbols: TypeError: "),
        ({"rhs": lambda t, x, p: x.nothing}, "given: rhs: the function fails at CasADi symbols: AttributeError"),
        ({"rhs": ca.MX.sym("m", 2)}, "given: rhs: given MX(m); accepted: a CasADi expression of kind SX"),
        ({"state": ["x", "y"]}, "given: state: given ['x', 'y']; accepted: a CasADi symbol, or a list of SX symbols"),
        ({"state": None}, "given: state: given None; accepted: a CasADi symbol"),
        ({"state": ca.SX.sym("x", 1, 2)}, "given: state: given shape (1, 2); accepted: a column"),
        ({"parameters": 3.0}, "given: parameters: given 3.0; accepted: a CasADi symbol"),
        ({"nominal": {"nu": 1.0}}, "given: nominal: given 'nu'; accepted: mu"),
        ({"nominal": {"mu": "1"}}, "given: nominal, mu: given '1'; accepted: a finite number"),
        ({"nominal": {}}, "given: nominal: given none for mu; accepted: a number for each parameter"),
        ({"nominal": "1"}, "given: nominal: given '1'; accepted: a list of finite numbers"),
        ({"reversal": "+-"}, "given: reversal needs 2 signs, each +1 or -1; given '+-'"),
        ({"hamiltonian": [X, Y]}, "given: hamiltonian: given shape (2, 1); accepted: a scalar expression"),
        ({"outputs": [X]}, "given: outputs: given [SX(x)]; accepted: expressions by name"),
        ({"outputs": {"a\nb": X}}, "given: outputs: given {'a\\nb': SX(x)}; accepted: expressions by name"),
        ({"time": T, "forcing_period": -1.0}, "given: forcing_period: given -1.0; accepted: a number > 0"),
        ({"time": T, "forcing_period": "2"}, "given: forcing_period: given '2'; accepted: a number > 0"),
        ({"state_labels": "xy"}, "given: state_labels: given 'xy'; accepted: a list of names in one line"),
        ({"name": "two\nlines"}, "name: given 'two\\nlines'; accepted: a name in one line"),
        (
            {"parameters": X},
            "given: the symbol x twice among state, velocity, parameters and time; accepted: different",
        ),
        ({"state": [X, X]}, "given: the symbol x twice among state"),
        ({"checked": "no"}, "given: checked: given 'no'; accepted: True or False"),
        ({"order": "2"}, "given: order: given '2'; accepted: 1 or 2"),
    ],
)
def test_models_that_cannot_be_meant_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises((ValueError, TypeError)) as error:
        OdeModel(**{"name": "given", "state": ca.vertcat(X, Y), "rhs": RHS, "parameters": MU} | changes)
    assert str(error.value).startswith(words)
    assert "\n" not in str(error.value)


# Boundary-value problems and guesses ----------------------------------------------------------------------------------


def test_nominal_values_by_name_are_those_of_labels_and_not_in_the_order_of_the_mapping() -> None:
    model = OdeModel("two", X, -T * X + MU, [MU, T], parameter_labels=("in", "out"), nominal={"out": 2.0, "in": 1.0})
    assert model.nominal == (1.0, 2.0)


LINE = OdeModel("line", [X, Y], [Y, -MU * X], MU, nominal=(1.0,))
WANTED = BoundaryValueProblem(LINE, [LINE.start(X), LINE.end(X) - 1])


@pytest.mark.parametrize(
    "conditions",
    [
        lambda start, end, p: [start[0], end[0] - 1],  # as in scipy's solve_bvp
        lambda start, end, p: ca.vertcat(start[0], end[0] - 1),
        ca.vertcat(LINE.start(X), LINE.end(X) - 1),
        (LINE.start(X), LINE.end(X) - 1),
        np.array([LINE.start(X), LINE.end(X) - 1]),
        [LINE.start(X), lambda start, end, p: end[0] - 1],
    ],
)
def test_conditions_in_every_form_are_the_same_problem(conditions: Any) -> None:
    found = BoundaryValueProblem(LINE, conditions).solve([0.0, 1.0])
    np.testing.assert_array_equal(found.states, WANTED.solve([0.0, 1.0]).states)
    assert found.evaluate(0.5)[0] == pytest.approx(np.sin(0.5) / np.sin(1.0), rel=1e-8)


def test_integrals_objectives_and_running_costs_from_functions() -> None:
    """x'' = -mu x with x(0) = 0, x(1) = 1 and mean of x = 1/2: mu = 0, where x = t."""
    given: list[Any] = [X - 0.5, lambda t, x, p: x[0] - 0.5]
    for integral in given:
        problem = BoundaryValueProblem(LINE, WANTED.conditions, [integral], parameters={"mu": 0.3}, free=["mu"])
        assert problem.solve([0.0, 1.0]).parameters["mu"] == pytest.approx(0.0, abs=1e-8)
    values = []
    for running, objective in ((X**2, LINE.end(Y)), (lambda t, x, p: x[0] ** 2, lambda start, end, p: end[1])):
        problem = BoundaryValueProblem(
            LINE, WANTED.conditions, free=["mu"], bounds={"mu": (0.1, 1.0)}, running=running, objective=objective
        )
        values.append(problem.solve([0.0, 1.0], tolerance=1e-6).objective)
    assert values[0] == pytest.approx(values[1], rel=1e-12)


def test_a_first_mesh_of_one_interval_and_nothing_for_what_is_left_out() -> None:
    problem = BoundaryValueProblem(LINE, WANTED.conditions, parameters=None, bounds=None)  # type: ignore[arg-type]
    found = problem.solve([0.0, 1.0], intervals=1)
    assert found.evaluate(0.5)[0] == pytest.approx(np.sin(0.5) / np.sin(1.0), rel=1e-8)
    np.testing.assert_array_equal(found.evaluate(ca.DM([0.5, 1.0])), found.evaluate([0.5, 1.0]))


def test_a_guess_in_the_layout_of_scipy() -> None:
    t = np.linspace(0.0, 1.0, 7)
    rows = np.stack([t, np.ones(7)], axis=1)
    ours, scipys = (WANTED.solve((t, x)).states for x in (rows, rows.T))
    np.testing.assert_array_equal(ours, scipys)
    np.testing.assert_array_equal(WANTED.solve([list(t), rows.T.tolist()]).states, ours)
    two = np.array([[0.0, 2.0], [3.0, 5.0]])  # as many times as states: rows are times, as the documentation has it
    from casadi_skin.zero.orbit import sampled

    np.testing.assert_array_equal(sampled(WANTED, ([0.0, 1.0], two), np.array([0.0, 1.0])), two)


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        (X, "guess: given SX(x); accepted: numbers"),
        ([X, Y], "guess: given [SX(x), SX(y)]; accepted: numbers"),
        ({"x": X}, "guess: given SX(x) for x; accepted: a number, or a function of t"),
        (([0.0, 1.0], [[X, Y], [X, Y]]), "guess: given [[SX(x), SX(y)], [SX(x), SX(y)]]; accepted"),
        (lambda t: [t, None], "guess: the function fails: "),
        (lambda t: t.nothing, "guess: the function fails: AttributeError: "),
        (([0.0, 1.0, 2.0], np.ones((4, 5))), "guess: given times of shape (3,), states of shape (4, 5)"),
        (OdeModel, "guess: the function fails: TypeError"),
        (True, "guess: given True; accepted: numbers"),
    ],
)
def test_guesses_that_cannot_be_meant_are_refused_in_one_line(guess: Any, words: str) -> None:
    with pytest.raises((ValueError, TypeError)) as error:
        WANTED.solve(guess)
    message = str(error.value)
    assert message.startswith(words) or (words.endswith("fails: ") and "finite" in message)
    assert "\n" not in message


# Orbits ---------------------------------------------------------------------------------------------------------------


def test_sections_and_selections_from_functions() -> None:
    sections: list[Any] = [Y, lambda t, x, p: x[1], [Y]]
    found = [find_orbit(PLAIN, circle, 6.3, section=section, tolerance=1e-6) for section in sections]
    assert len({orbit.period for orbit in found}) == 1
    assert found[0].evaluate(0.0)[1] == pytest.approx(0.0, abs=1e-6)
    spring = OdeModel("spring", [X, Y], [Y, -X - X**3], hamiltonian=Y**2 / 2 + X**2 / 2 + X**4 / 4)
    selected: list[Callable[..., Any] | ca.SX] = [X - 1, lambda t, x, p: x[0] - 1]
    periods = [find_orbit(spring, circle, 5.0, select=s, tolerance=1e-6).period for s in selected]
    assert periods[0] == periods[1]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model": None}, "model: given None; accepted: an OdeModel"),
        ({"section": 1.0}, "section: given 1.0; accepted: a CasADi expression of kind SX"),
        ({"section": [X, Y]}, "section: given shape (2, 1); accepted: a scalar expression"),
        ({"section": ca.MX.sym("m")}, "section: given MX(m); accepted: a CasADi expression of kind SX"),
        ({"guess": lambda t: [1e200 * np.cos(t), 1e200 * np.sin(t)]}, "guess: given states up to 1e+200; accepted"),
        ({"symmetric": "yes"}, "symmetric: given 'yes'; accepted: True or False"),
        ({"parameters": [1.0]}, "parameters: given [1.0]; accepted: numbers by name"),
        ({"free": "mu"}, "free: given 'mu'; accepted: a list of names of parameters"),
        ({"period": "6"}, "period: given '6'; accepted: a number > 0"),
        ({"bounds": 3}, "bounds: given 3; accepted: (lower, upper) by name"),
    ],
)
def test_orbits_that_cannot_be_meant_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises((ValueError, TypeError)) as error:
        find_orbit(**{"model": PLAIN, "guess": circle, "period": 6.3} | changes)
    assert str(error.value).startswith(words)


# Names in place of places ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call",
    [
        lambda: OdeModel("spring", X, -X, None, 2, Y, (1, -1), (-1, -1)),  # type: ignore[misc]
        lambda: BoundaryValueProblem(LINE, [], (), (0.0, 1.0), {}, (), {}),  # type: ignore[misc]
        lambda: smallest_kick(None, 1.0, 0.5),  # type: ignore[misc, arg-type]
        lambda: import_fmu("model.fmu", ["x"], ["p"]),  # type: ignore[misc]
    ],
)
def test_what_is_likely_to_be_mixed_up_is_given_by_name(call: Callable[[], Any]) -> None:
    with pytest.raises(TypeError, match="positional argument"):
        call()


# Helpers --------------------------------------------------------------------------------------------------------------


def test_arrays_of_numbers_and_of_nothing_else() -> None:
    for value in ([1, 2.0], (1, 2), np.array([1, 2]), ca.DM([1, 2]), range(1, 3)):
        np.testing.assert_array_equal(real_array("t", value), [1.0, 2.0])
    for value in ("1", None, [None], [True], X, [X], object(), 1j, {"a": 1}, [[1], [1, 2]], b"1"):
        with pytest.raises(TypeError, match=r"^t: given .*; accepted: finite numbers$"):
            real_array("t", value)
    with pytest.raises(ValueError, match=r"^t: given "):
        real_array("t", [1.0, float("inf")])
    with pytest.raises(ValueError, match=r"^sites: given 1.5; accepted: whole numbers"):
        site_numbers(1.5)


def test_a_message_shows_any_value_in_one_short_line() -> None:
    deep = X
    for _ in range(20_000):
        deep = ca.sin(deep)

    class Broken:
        def __repr__(self) -> str:
            raise RuntimeError

    endless: list[Any] = []
    endless.append(endless)
    for value in (deep, [deep], Broken(), [Broken()], endless, 10**10_000, "a\nb" * 1000, np.ones((100, 100))):
        text = short_repr(value)
        assert len(text) <= 60
        assert text.isprintable()
    assert short_repr(deep) == "SX of shape (1, 1)"


def test_options_of_other_names_are_refused_with_the_nearest() -> None:
    chain = Chain(2, 1.0, 0.25, -1.0)
    family = r"^follow_family: given the option 'stabilty'; did you mean stability\? accepted: .*tolerance"
    with pytest.raises(TypeError, match=family):
        follow_family(chain, 1, 0.1, stabilty=True)
    with pytest.raises(TypeError, match=r"^follow_family: given the option 'tolerence'; did you mean tolerance\?"):
        follow_family(chain, 1, 0.1, tolerence=1e-6)
    x, mu = ca.SX.sym("x"), ca.SX.sym("mu")
    rest = find_equilibrium(OdeModel("line", x, mu - x, mu), [0.0], parameters={"mu": 0.0})
    with pytest.raises(TypeError, match=r"^follow: given the option 'max_point'; did you mean max_points\?"):
        rest.follow("mu", 1.0, max_point=5)
    problem = BoundaryValueProblem(OdeModel("line", x, -x), lambda start, end, p: start - 1.0)
    with pytest.raises(ValueError, match="options: given 'tol'; accepted: tolerance"):
        problem.solve([0.0], tol=1e-3)
    with pytest.raises(ValueError, match=r"^options: given 'bound'; accepted: tolerance"):
        search_orbit(problem.model, guess=[1.0], free=["x"], bound={"x": (0.1, 1.0)})
    with pytest.raises(TypeError, match="unexpected keyword argument 'free'"):
        optimise("S", rest, free=["S"])  # type: ignore[call-arg]
    with pytest.raises(KeyError, match=r"q; known: S, alpha, gamma, g"):
        follow_family(chain, 1, 0.1)["q"]


def test_an_offset_is_one_number_in_one_direction() -> None:
    one, two = (Lattice(4, [Site("a")], [Bond("a", "a", offset, "d")], "fixed") for offset in (1, (1,)))
    assert one.declaration == two.declaration
