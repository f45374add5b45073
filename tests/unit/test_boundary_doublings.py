"""Solutions that close after two turns, and doublings and tori of problems that close in two parameters."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from critical_models import across_circle
from equilibrium_models import symbols
from scipy.integrate import solve_ivp

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import BoundaryError
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.settings import End


def first_point(turn: float, sign: float, even: float = 0.0) -> SpecialPoint:
    """z' = (a - k - i q turn) z - |z|^2 z with z(1) = sign z(0), at z = 0; Im z is damped where turn = 0."""
    x, y, a, k, q, b = symbols("x y a k q b")
    damping = 0.0 if turn else 2.0
    rate = ca.vertcat((a - k) * x - q * turn * y, q * turn * x + (a - k - damping) * y)
    rate = rate - (x**2 + y**2) * ca.vertcat(x, y) + b * ca.vertcat(x**2, 0)
    model = OdeModel("closed", ca.vertcat(x, y), rate, ca.vertcat(a, k, q, b))
    ends = [model.end(x) - sign * model.start(x), model.end(y) - sign * model.start(y)]
    problem = BoundaryValueProblem(model, ends, parameters={"a": -0.3, "k": 0.0, "q": 1.0, "b": even})
    (point,) = problem.solve([0.0, 0.0]).follow("a", 0.4, stability=True).special_points
    return point


def test_solutions_of_two_turns_leave_where_signs_alternate() -> None:
    """x(1) = -x(0) has x = 0 alone; after two turns x(2) = x(0), which the equilibria x = +- sqrt(a) solve."""
    point = first_point(0.0, -1.0)
    assert point.kind == "period doubling"
    assert abs(point.parameters["a"]) <= point.error < 1e-13
    for side in (1, -1):
        branch = point.follow("a", 0.4, side=side, stability=True)
        last = branch.solutions[-1]
        assert last.interval == (0.0, 2.0)
        t = np.linspace(0.0, 2.0, 9)
        np.testing.assert_allclose(last.evaluate(t)[:, 0], side * np.sqrt(0.4), rtol=1e-8)
        assert last.stable
        # x' = -2 a x and y' = -2 y beside it, for two turns
        np.testing.assert_allclose(last.floquet().multipliers, np.exp([-4.0 * 0.4, -4.0]), rtol=1e-7)
    assert (point.coefficient, point.criticality) == (pytest.approx(-1.0, rel=1e-9), "supercritical")
    found = point.curve("k", 1.0)
    assert found.complete
    np.testing.assert_allclose(found["a"], found["k"], rtol=0, atol=1e-10)


def test_a_field_that_is_another_one_after_a_turn_is_refused() -> None:
    with pytest.raises(BoundaryError, match=r"no solutions of two turns leave .* the field does not repeat itself"):
        first_point(0.0, -1.0, even=0.3).follow("a", 0.4)
    with pytest.raises(ValueError, match="accepted: one that closes, where the field repeats itself"):
        _ = first_point(0.0, -1.0, even=0.3).vector


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_tori_of_a_problem_that_closes_pass_the_resonances_of_their_angle(sign: float) -> None:
    """Multipliers sign exp(a - k +- i q): on the circle along a = k, whose angle is that of the resonances."""
    point = first_point(1.0, sign)
    assert point.kind == "torus"
    assert abs(point.parameters["a"]) <= point.error < 1e-13
    assert point.coefficient == pytest.approx(-2.0, rel=1e-9)  # w v + c.c. is z, with v of mean square 1
    found = point.curve("q", 2.5)
    np.testing.assert_allclose(found["a"], 0.0, rtol=0, atol=1e-10)
    shift = 0.0 if sign > 0.0 else np.pi
    angles = {"1:4 resonance": 0.5 * np.pi, "1:3 resonance": 2.0 * np.pi / 3.0 if sign > 0.0 else np.pi / 3.0}
    for special in found.special_points:
        assert special.parameters["q"] == pytest.approx(angles.pop(special.kind), abs=1e-9)
    assert set(angles) <= ({"1:3 resonance"} if shift else set())


@pytest.mark.slow
def test_a_cycle_stated_with_its_free_period_doubles_as_an_orbit_does() -> None:
    """Roessler's cycle: places, periods, multipliers and the curve in two parameters are those of `find_orbit`."""
    x, y, z, a, c, T = symbols("x y z a c T")
    rhs = ca.vertcat(-y - z, x + a * y, 0.2 + z * (x - c))

    def crosses(t: float, s: list[float]) -> float:
        return s[1]

    crosses.direction = 1.0  # type: ignore[attr-defined]
    known = solve_ivp(
        lambda t, s: [-s[1] - s[2], s[0] + 0.2 * s[1], 0.2 + s[2] * (s[0] - 2.0)],
        (0.0, 300.0), [3.0, 0.0, 0.0], rtol=1e-9, atol=1e-11, events=crosses, dense_output=True,
    )  # fmt: skip
    first, last = known.t_events[0][-2:]
    guess = lambda t: known.sol(first + t)  # noqa: E731
    stated = OdeModel("stated", ca.vertcat(x, y, z), rhs, ca.vertcat(a, c, T))
    ends = [stated.start(stated.state) - stated.end(stated.state), stated.start(y)]
    values = {"a": 0.2, "c": 2.0, "T": last - first}
    cycle = BoundaryValueProblem(stated, ends, interval=(0.0, T), parameters=values, free=["T"]).solve(guess)
    model = OdeModel("cycle", ca.vertcat(x, y, z), rhs, ca.vertcat(a, c))
    orbit = find_orbit(model, guess, last - first, parameters={"a": 0.2, "c": 2.0})
    (mine,), (known_point,) = (s.follow("c", 3.0, stability=True).special_points for s in (cycle, orbit))
    assert mine.kind == known_point.kind == "period doubling"
    assert abs(mine.parameters["c"] - known_point.parameters["c"]) <= mine.error + known_point.error < 1e-10
    assert mine.coefficient == pytest.approx(known_point.coefficient, rel=1e-6)
    assert mine.frequency == pytest.approx(known_point.frequency, rel=1e-9)
    doubled, known_doubled = (point.follow("c", 3.0, stability=True) for point in (mine, known_point))
    assert 2.0 * doubled["T"][-1] == pytest.approx(known_doubled.period[-1], rel=1e-10)
    np.testing.assert_allclose(
        doubled.solutions[-1].floquet().others, known_doubled.solutions[-1].floquet().others, rtol=0, atol=1e-7
    )
    curves = [point.curve("a", 0.22) for point in (mine, known_point)]
    assert curves[0].end is End.REACHED
    assert curves[0]["c"][-1] == pytest.approx(curves[1]["c"][-1], abs=1e-9)


def with_free_period(model: OdeModel, values: dict[str, float], guess: Callable[[float], list[float]]) -> Solution:
    """The cycle near a guess of the period 2 pi as a problem on the unit interval, with the field times T.

    Coefficients are T times those of `find_orbit`.
    """
    T = ca.SX.sym("T")
    stated = OdeModel("stated", model.state, T * model.rhs, ca.vertcat(model.parameters, T))
    ends = [stated.start(stated.state) - stated.end(stated.state), stated.start(stated.state)[1]]
    problem = BoundaryValueProblem(stated, ends, parameters={**values, "T": 2.0 * np.pi}, free=["T"])
    return problem.solve(lambda s: guess(2.0 * np.pi * s))


@pytest.mark.slow
def test_tori_of_cycles_with_a_stated_free_period_are_followed_to_their_resonances() -> None:
    """Bogdanov and Takens' normal form across a circle: a = -k^2, and the angle 2 pi sqrt(2 k) of the multipliers."""

    def rates(xi: ca.SX, eta: ca.SX, a: ca.SX, k: ca.SX) -> tuple[ca.SX, ca.SX]:
        turn = 1 + 0.7 * xi**2
        return turn * eta, turn * (a + k * eta + xi**2 + xi * eta)

    model, values = across_circle(rates, half=False), {"a": -0.0045, "k": 0.058}
    guess = lambda t: [0.935 * np.cos(t), 0.935 * np.sin(t), 0.0]  # noqa: E731
    cycle = with_free_period(model, values, guess)
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters=values, corrector="newton")
    (mine,), (known,) = (s.follow("a", -0.0028, stability=True).special_points for s in (cycle, orbit))
    assert mine.kind == "torus"
    assert abs(mine.parameters["a"] + 0.058**2) <= mine.error < 1e-13
    unit = known.solution.period
    assert mine.coefficient == pytest.approx(unit * known.coefficient, rel=1e-7)
    assert mine.frequency == pytest.approx(unit * known.frequency, rel=1e-9)
    curve = mine.curve("k", -0.1)
    assert curve.end is End.RESONANCE_ONE
    np.testing.assert_allclose(curve["a"], -(curve["k"] ** 2), rtol=0, atol=1e-9)
    exact = {"1:3 resonance": 1.0 / 18.0, "1:4 resonance": 1.0 / 32.0, "1:1 resonance": 0.0}
    assert [point.kind for point in curve.special_points] == list(exact)
    for point, k in zip(curve.special_points, exact.values(), strict=True):
        assert abs(point.parameters["k"] - k) <= 3.0 * point.error < 1e-9


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_coefficients_of_stated_problems_vanish_where_they_are_known_to(turn: float) -> None:
    """z' = (a + 2 i turn) z + (q - 0.3) |z|^2 z - |z|^4 z with z(1) = -z(0), Im z damped where it does not turn."""
    x, y, a, q = symbols("x y a q")
    square = x**2 + y**2
    growth = a + (q - 0.3) * square - square**2
    rhs = ca.vertcat(growth * x - 2 * turn * y, 2 * turn * x + (growth - (0.0 if turn else 2.0)) * y)
    model = OdeModel("closed", ca.vertcat(x, y), rhs, ca.vertcat(a, q))
    ends = [model.end(x) + model.start(x), model.end(y) + model.start(y)]
    problem = BoundaryValueProblem(model, ends, parameters={"a": -0.3, "q": 0.0})
    (point,) = problem.solve([0.0, 0.0]).follow("a", 0.4, stability=True).special_points
    (found,) = point.curve("q", 0.5).special_points
    assert found.kind == ("chenciner" if turn else "generalized period doubling")
    assert abs(found.parameters["q"] - 0.3) <= 3.0 * found.error < 1e-9


def blocks(first: str) -> tuple[BoundaryValueProblem, list[float]]:
    """Uncoupled blocks on an interval of length 1, the first critical at a = q/5; one with its zero for a start.

    x' = (q - r) x - x^3 for r = 0.2 with x(1) = -x(0) and for r = 0.3 with x(1) = x(0), w' = (q - 0.1 + 0.7 i) w - ...
    """
    x, a, q = ca.SX.sym("x", 5 + (first == "torus")), ca.SX.sym("a"), ca.SX.sym("q")

    def spiral(w: ca.SX, rate: ca.SX, turn: float) -> ca.SX:
        return ca.vertcat(rate * w[0] - turn * w[1], turn * w[0] + rate * w[1]) - ca.sumsqr(w) * w

    rate = a - q / 5
    rates = [spiral(x[:2], q - 0.1, 0.7), (q - 0.2) * x[2] - x[2] ** 3, (q - 0.3) * x[3] - x[3] ** 3]
    one = rate - x[4] ** 2 if first == "fold" else rate * x[4] - x[4] ** 3
    critical = spiral(x[4:], rate, 1.3) if first == "torus" else one
    model = OdeModel("blocks", x, ca.vertcat(*rates, critical), ca.vertcat(a, q))
    signs = np.array([1.0, 1.0, -1.0, 1.0, -1.0 if first == "period doubling" else 1.0, 1.0])[: x.numel()]
    ends = [model.end(x) - ca.DM(signs) * model.start(x)]
    start = {"a": 0.3 if first == "fold" else -0.3, "q": 0.0}
    guess = [0.0] * 4 + [0.55 if first == "fold" else 0.0] + [0.0] * (x.numel() - 5)
    return BoundaryValueProblem(model, ends, parameters=start), guess


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "pair", "minus", "plus"),
    [
        ("fold", "fold-torus", "fold-flip", "1:1 resonance"),
        ("period doubling", "flip-torus", "1:2 resonance", "fold-flip"),
        ("torus", "torus-torus", "flip-torus", "fold-torus"),
        ("branch point", "fold-torus", "fold-flip", "double branch point"),
    ],
)
def test_other_multipliers_pass_the_circle_on_curves_of_problems_that_close(
    first: str, pair: str, minus: str, plus: str
) -> None:
    """Multipliers exp(q - 0.1 +- 0.7 i), -exp(q - 0.2) and exp(q - 0.3) beside the critical one."""
    problem, guess = blocks(first)
    (point,) = problem.solve(guess).follow("a", -0.2 if first == "fold" else 0.2, stability=True).special_points
    assert point.kind == first
    curve = point.curve("q", 0.5)
    assert curve.complete
    assert curve.with_stability
    np.testing.assert_allclose(curve["a"], 0.2 * curve["q"], rtol=0, atol=1e-12)
    assert [special.kind for special in curve.special_points] == [pair, minus, plus]
    for special, q in zip(curve.special_points, (0.1, 0.2, 0.3), strict=True):
        assert abs(special.parameters["q"] - q) <= special.error + 1e-15 < 1e-5
    known = [*np.exp(0.4 + np.array([0.7j, -0.7j])), -np.exp(0.3), np.exp(0.2)]
    found = curve.solutions[-1].floquet().multipliers
    assert all(np.min(np.abs(found - value)) < 1e-8 for value in known)
