"""Equilibria: found, followed, with eigenvalues and errors; what is refused."""

from __future__ import annotations

from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
from equilibrium_models import ab, carbon_monoxide, lorenz, symbols
from programs import Program

from casadi_skin import Chain, OdeModel, find_equilibria, find_equilibrium, simulate
from casadi_skin.follow.space import EquilibriumError


def test_a_stiff_equilibrium_agrees_with_a_solution_to_forty_digits() -> None:
    """Robertson's kinetics with an inflow: rates 0.04 to 3e7; components from 1e-6 to 1."""
    a, b, c, k = symbols("a b c k")
    slow, fast = 0.04 * a - 1e4 * b * c, 3e7 * b**2
    rhs = ca.vertcat(-slow + 0.1 - 0.1 * a, slow - fast - 0.1 * b, fast - k * c)
    model = OdeModel("Robertson", ca.vertcat(a, b, c), rhs, k)
    found = find_equilibrium(model, [1.0, 0.0, 0.0], parameters={"k": 0.1}, transient=1e4)
    mpmath.mp.dps = 40

    def exact(a, b, c):  # type: ignore[no-untyped-def]
        f = mpmath.mpf
        return [
            -f("0.04") * a + f(10) ** 4 * b * c + f("0.1") - f("0.1") * a,
            f("0.04") * a - f(10) ** 4 * b * c - 3 * f(10) ** 7 * b**2 - f("0.1") * b,
            3 * f(10) ** 7 * b**2 - f("0.1") * c,
        ]

    known = mpmath.findroot(exact, tuple(map(mpmath.mpf, found.state)))
    apart = max(abs(float((mpmath.mpf(x) - y) / y)) for x, y in zip(found.state, known, strict=True))
    assert apart <= max(found.error, 1e-15)
    assert found.error <= 1e-10
    assert found.stable


def test_equilibria_from_a_guess_by_name_from_a_simulation_and_from_another_model_agree() -> None:
    model = lorenz()
    by_name = find_equilibrium(model, {"x": 5.0, "y": 5.0, "z": 12.0}, parameters={"r": 14.0})
    settled = find_equilibrium(model, [1.0, 1.0, 1.0], parameters={"r": 14.0}, transient=60.0)
    evolution = simulate(model, [1.0, 1.0, 1.0], np.linspace(0.0, 60.0, 100), parameters={"r": 14.0})
    exact = np.array([np.sqrt(8.0 / 3.0 * 13.0)] * 2 + [13.0])
    for found in (by_name, settled, find_equilibrium(model, evolution, parameters={"r": 14.0})):
        np.testing.assert_allclose(found.state, exact, rtol=1e-12)
        assert found.stable


def test_several_starts_find_the_three_equilibria_of_lorenz() -> None:
    found = find_equilibria(lorenz(), {"x": (-20, 20), "y": (-20, 20), "z": (0, 40)}, parameters={"r": 28.0}, starts=32)
    assert len(found) == 3
    x = np.sqrt(8.0 / 3.0 * 27.0)
    np.testing.assert_allclose([e.state[0] for e in found], [-x, 0.0, x], atol=1e-10)
    assert not any(e.stable for e in found)


def test_a_box_of_two_corners_is_the_same_and_warns() -> None:
    box = {"x": (-20, 20), "y": (-20, 20), "z": (0, 40)}
    found = find_equilibria(lorenz(), box, parameters={"r": 28.0}, starts=8)
    with pytest.warns(DeprecationWarning, match=r"lower and upper are bounds, \(lower, upper\) by name") as warned:
        older = find_equilibria(lorenz(), [-20, -20, 0], [20, 20, 40], parameters={"r": 28.0}, starts=8)  # type: ignore
    assert [warning.filename for warning in warned] == [__file__]
    assert [one.state.tolist() for one in older] == [one.state.tolist() for one in found]


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({"x": (0, 1), "y": (0, 1)}, r"bounds: given none of z; accepted: \(lower, upper\) of each of x, y, z"),
        ({"x": (0, 1), "y": (0, 1), "w": (0, 1)}, "bounds: given 'w'; accepted: x, y, z"),
        ({"x": (0, 1), "y": (2, 1), "z": (0, 1)}, r"bounds\[y\]: given \(2, 1\); accepted: \(lower, upper\)"),
        (
            {"x": (0, 1, 2), "y": (0, 1), "z": (0, 1)},
            r"bounds\[x\]: given \(0, 1, 2\); accepted: a pair",
        ),
        ({"x": 1, "y": (0, 1), "z": (0, 1)}, r"bounds\[x\]: given 1; accepted: a pair \(lower, upper\)"),
        ({"x": (None, 1), "y": (0, 1), "z": (0, 1)}, "bounds: given .*; accepted: finite numbers"),
        ([(0, 1)] * 3, r"bounds: given \[.*\]; accepted: \(lower, upper\) by name"),
    ],
)
def test_a_box_that_is_none_is_refused(bounds: Any, words: str) -> None:
    with pytest.raises((ValueError, TypeError), match=f"^{words}"):
        find_equilibria(lorenz(), bounds, parameters={"r": 28.0})


def test_static_states_of_second_order_models_have_pairs_of_eigenvalues() -> None:
    """A chain of pendula: hanging it is stable, upright it is not."""
    q, v = ca.SX.sym("q", 6), ca.SX.sym("v", 6)
    d = ca.diff(ca.vertcat(q[0], q, q[-1]))
    model = OdeModel("pendula", q, 0.7 * ca.diff(d) - ca.sin(q), order=2, velocity=v)
    hanging = find_equilibrium(model, np.full(6, 0.1))
    assert hanging.stable
    assert np.all(hanging.eigenvalues.real == 0.0)
    assert hanging.state.shape == (12,)
    upright = find_equilibrium(model, np.full(6, 3.0))
    np.testing.assert_allclose(upright.state[:6], np.pi, rtol=1e-14)
    assert not upright.stable
    squares = 1.0 - 1.4 * (1.0 - np.cos(np.arange(6) * np.pi / 6))
    found = np.sort((upright.eigenvalues**2).real)[::2]
    np.testing.assert_allclose(found, np.sort(squares), atol=1e-12)


def test_static_states_of_a_chain() -> None:
    """With alpha = -3, g = 1 a reciprocal site of one rests at y^2 = -(2 + alpha)/g, and the chain at 0 is unstable."""
    found = find_equilibrium(Chain(1, -3.0, 0.0, 1.0), [0.8])
    np.testing.assert_allclose(found.state, [1.0, 0.0], atol=1e-13)
    chain = Chain(40, 1.0, 0.25, -1.0)
    rest = find_equilibrium(chain, np.zeros(40))
    assert rest.stable
    np.testing.assert_allclose(np.max(rest.eigenvalues.imag), chain.linear_frequency("last"), rtol=1e-12)


def test_the_branch_is_the_one_in_closed_form_at_given_values() -> None:
    branch = find_equilibrium(ab(), [0, 0]).follow("p", 0.25, at=[0.1])
    assert branch.complete
    for which in range(3):
        x, y = branch.at(p=0.1, which=which).state
        assert abs(y - 14 * x / 3) < 1e-12
        assert abs(x * np.exp(-y) / (1 - x) - 0.1) < 1e-13
    assert [s.point.requested for s in branch.solutions].count(True) == 3
    with pytest.raises(ValueError, match="passes p 3 times"):
        branch.at(0.1, which=3)


def test_a_branch_ends_where_a_condition_holds_and_where_it_comes_back() -> None:
    start = find_equilibrium(lorenz(), [6, 6, 13], parameters={"r": 14.0})
    stopped = start.follow("r", 40.0, until=lambda equilibrium: equilibrium["z"] > 20.0)
    assert stopped.stopped
    assert stopped.solutions[-1]["z"] > 20.0 > stopped.solutions[-2]["z"]
    back = start.follow("r", 0.0)
    assert "came back to the value of the parameter" in back.reason
    np.testing.assert_allclose(back.solutions[-1]["x"], -back.at(r=14.0)["x"], rtol=0.2)


def test_a_black_box_in_mx_is_followed_by_first_derivatives_alone() -> None:
    """As an FMU is: its Jacobian has no derivatives of its own; a fold is located by its parameter's turn."""
    x, p = ca.MX.sym("x"), ca.MX.sym("p")
    cubic = Program(ca.Function("cubic", [x, p], [p + x - x**3]), orders=1)
    model = OdeModel("box", x, cubic(x, p), p)
    branch = find_equilibrium(model, [-1.5], parameters={"p": -2.0}).follow("p", 2.0)
    assert [point.kind for point in branch.special_points] == ["fold", "fold"]
    for point, exact in zip(branch.special_points, (1.0, -1.0), strict=True):
        assert abs(point.parameters["p"] - exact * 2 / 3**1.5) <= max(point.error, 1e-12)
        assert abs(point.coefficient) == pytest.approx(np.sqrt(3.0), rel=1e-6)  # by differences of the Jacobian


# Refusals -------------------------------------------------------------------------------------------------------------


A, B, P, T = symbols("a b p t")


@pytest.mark.parametrize(
    ("model", "guess", "options", "words"),
    [
        (OdeModel("forced", A, ca.cos(T) - A, time=T, forcing_period=2 * np.pi), [0.0], {},
         r"^model: given forced, which is forced: .*depends on time, with period 6.28319"),
        (OdeModel("exchange", ca.vertcat(A, B), ca.vertcat(B - A, A - B)), [1.0, 2.0], {},
         "the equation of a and the equation of b depend on each other"),
        (OdeModel("none", A, A**2 + P, P), [1.0], {"parameters": {"p": 1.0}},
         r"no equilibrium near the guess: newton: .*the equation of a"),
        (lorenz(), [1.0, 1.0, 1.0], {"parameters": {"r": 28.0}, "transient": 50.0},
         "does not settle: over its last quarter"),
    ],
)  # fmt: skip
def test_what_has_no_equilibrium_says_why(model: OdeModel, guess: list[float], options: dict, words: str) -> None:
    with pytest.raises(ValueError if "forced" in words else EquilibriumError, match=words):
        find_equilibrium(model, guess, **options)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"guess": [0.0]}, "guess: given 1; accepted: 2 numbers: x, y"),
        ({"guess": {"z": 1.0}}, "guess: given 'z'; accepted: x, y"),
        ({"guess": [0.0, np.nan]}, "guess: given numbers that are not finite"),
        ({"guess": "here"}, "guess: given 'here'; accepted: numbers, one a state"),
        ({"parameters": {"q": 1.0}}, "parameters: given 'q'"),
        ({"tolerance": 1.0}, "tolerance: given 1.0; accepted: 1e-13 to 0.01"),
        ({"corrector": "magic"}, "corrector: given 'magic'; accepted: ipopt, newton"),
        ({"transient": -1.0}, "transient: given -1.0; accepted: a finite number > 0"),
    ],
)
def test_arguments_are_refused_in_one_line(change: dict, words: str) -> None:
    arguments = {"guess": [0.0, 0.0]} | change
    with pytest.raises(ValueError, match=words) as caught:
        find_equilibrium(ab(), **arguments)
    assert "\n" not in str(caught.value)


def test_following_is_refused_for_names_and_values_that_do_not_fit() -> None:
    start = find_equilibrium(carbon_monoxide(), [0.001, 0.89, 0.06])
    for arguments, words in (
        (("q3", 1.0), "parameter: given 'q3'"),
        (("q2", 2.204678), "to: given 2.204678, where the branch starts"),
    ):
        with pytest.raises(ValueError, match=words):
            start.follow(*arguments)
    with pytest.raises(ValueError, match=r"^at: given 3\.0 as item 1; accepted: numbers from"):
        start.follow("q2", 1.0, at=[3.0])


def test_an_isola_is_walked_once_and_reported_as_closed() -> None:
    """x' = 1 - x^2 - p^2 rests on a circle."""
    x, p = symbols("x p")
    start = find_equilibrium(OdeModel("circle", x, 1 - x**2 - p**2, p), [0.9], parameters={"p": 0.3})
    branch = start.follow("p", 2.0, at=[0.9])
    assert branch.complete
    assert "closed" in branch.reason
    states = np.array([solution["x"] for solution in branch.solutions])
    np.testing.assert_allclose(states**2 + branch["p"] ** 2, 1.0, atol=1e-11)
    np.testing.assert_allclose([point.parameters["p"] for point in branch.special_points], [1.0, -1.0], atol=1e-14)
    angles = np.unwrap(np.arctan2(branch["p"], states))
    assert angles[-1] - angles[0] == pytest.approx(2.0 * np.pi)
    assert [solution["p"] for solution in branch.solutions].count(0.9) == 2
    assert "beyond its start" in start.follow("p", 2.0, back_to=-0.5).reason
    with pytest.raises(ValueError, match=r"back_to: given 0\.5; accepted: a number below 0\.3"):
        start.follow("p", 2.0, back_to=0.5)


@pytest.mark.slow
def test_a_branch_that_comes_back_and_does_not_close_ends_there_unless_it_is_to_go_on() -> None:
    x, p = symbols("x p")
    start = find_equilibrium(OdeModel("parabola", x, p - x**2, p), [0.9], parameters={"p": 1.0})
    branch = start.follow("p", -1.0)
    assert "came back" in branch.reason
    assert max(branch["p"][:-1]) <= 1.0
    assert max(start.follow("p", -1.0, back_to=2.0)["p"]) >= 2.0
