"""Curves in two parameters of AUTO's demos: each end against shooting by Dormand-Prince, which shares nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from casadi_skin import OdeModel, find_equilibrium, find_orbit

pytestmark = pytest.mark.slow
Rates = Callable[..., tuple[Any, ...]]
Condition = Callable[[np.ndarray], float]


def stated(rates: Rates, states: str, **parameters: float) -> OdeModel:
    x, p = ([ca.SX.sym(name) for name in names] for names in (states.split(), parameters))
    return OdeModel("demo", ca.vertcat(*x), ca.vertcat(*rates(*x, *p)), ca.vertcat(*p), nominal=[*parameters.values()])


def shot(model: OdeModel, orbit: Any, first: str, condition: Condition, jump: np.ndarray) -> float:
    """The value of a parameter at which a closed orbit with its monodromy matrix fulfils a condition, by shooting."""
    n, values, symbol = model.full_size, dict(orbit.parameters), ca.SX.sym("x", model.full_size)
    names = model.parameter_names
    p = ca.SX.sym("p", len(names))
    rhs = model.vector_field(0.0, symbol, p)
    field = ca.Function("f", [symbol, p], [rhs, ca.jacobian(rhs, symbol)])
    ref = orbit.evaluate(0.0)

    def at(value: float) -> list[float]:
        return [value if name == first else values[name] for name in names]

    along = np.array(field(ref, at(values[first]))[0]).ravel()

    def conditions(u: np.ndarray) -> np.ndarray:
        def rate(_: float, y: np.ndarray) -> np.ndarray:
            f, J = field(y[:n], at(u[-1]))
            return np.concatenate([np.array(f).ravel(), (np.array(J) @ y[n:].reshape(n, n)).ravel()])

        start = np.concatenate([u[:n], np.eye(n).ravel()])
        end = solve_ivp(rate, (0.0, u[n]), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        closed = end[:n] - u[:n] - jump
        return np.array([*closed, along @ (u[:n] - ref), condition(end[n:].reshape(n, n))])

    guess = np.array([*(ref * (1.0 + 1e-4)), orbit.period * (1.0 + 1e-5), values[first] * (1.0 + 1e-5)])
    found = root(conditions, guess, tol=1e-13)
    assert np.max(np.abs(found.fun)) < 1e-8
    return float(found.x[-1])


def doubles(M: np.ndarray) -> float:
    return float(np.linalg.det(M + np.eye(len(M))))


def has_product_one(M: np.ndarray) -> float:
    """Of a fold in two dimensions, and of a torus in three."""
    return float(np.linalg.det(M)) - 1.0


def test_tor_by_its_torus_and_period_doubling() -> None:
    def rates(x: Any, y: Any, z: Any, nu: Any, beta: Any) -> tuple[Any, ...]:
        cubic = 0.933578 * (y - x) ** 3
        return (-(beta + nu) * x + beta * y - 0.328578 * x**3 + cubic) / 0.6, beta * x - (beta - 0.6) * y - z - cubic, y

    model = stated(rates, "x y z", nu=-0.9, beta=0.5)
    (hopf,) = (p for p in find_equilibrium(model, [0, 0, 0]).follow("nu", -0.55).special_points if p.kind == "hopf")
    cycles = hopf.follow("nu", -0.6, stability=True).special_points
    parts = next(p for p in cycles if p.kind == "branch point").follow("nu", -0.63, stability=True)
    known = {"torus": has_product_one, "period doubling": doubles}
    assert [point.kind for point in parts.special_points] == list(known)
    for point, number in zip(parts.special_points, (-0.5913553081030, -0.6156128795621), strict=True):
        last = point.curve("beta", 0.51).solutions[-1]
        assert last.parameters["nu"] == pytest.approx(
            shot(model, last, "nu", known[point.kind], np.zeros(3)), abs=1e-10
        )
        assert last.parameters["nu"] == pytest.approx(number, abs=1e-11)


def test_pen_by_its_period_doubling() -> None:
    def rates(a: Any, b: Any, u: Any, v: Any, current: Any, coupling: Any) -> tuple[Any, ...]:
        pull = coupling * (b - a)
        return u, v, -0.1 * u - ca.sin(a) + current + pull, -0.1 * v - ca.sin(b) + current - pull

    model = stated(rates, "a b u v", current=0.4, coupling=0.175)
    turning = find_orbit(model, lambda t: [4 * t, 4 * t, 4, 4], 1.574, rotations={"a": 1, "b": 1})
    (point,) = turning.follow("current", 0.15, stability=True).special_points
    last = point.curve("coupling", 0.17).solutions[-1]
    turn = np.array([2 * np.pi, 2 * np.pi, 0.0, 0.0])
    assert last.parameters["current"] == pytest.approx(shot(model, last, "current", doubles, turn), abs=1e-10)
    assert last.parameters["current"] == pytest.approx(0.177993541086789, abs=1e-11)


def test_plp_by_its_folds_which_lie_on_one_curve() -> None:
    def rates(s: Any, a: Any, rho: Any, a0: Any) -> tuple[Any, ...]:
        r = s * a / (1 + s + 0.1 * s**2)
        return 110 - s - rho * r, 0.2 * (a0 - a) - rho * r

    model = stated(rates, "s a", rho=2.021628, a0=500.0)
    points = find_equilibrium(model, [45.55974, 177.7987]).follow("rho", 6.0).special_points
    first = next(p for p in points if p.kind == "hopf")
    (fold,) = (p for p in first.follow("rho", 2.0).special_points if p.kind == "fold")
    curve = fold.curve("a0", 480.0)
    assert curve.at(a0=500.0, which=1).parameters["rho"] == pytest.approx(
        5.00784, rel=1e-6
    )  # the fold that AUTO prints
    turn = int(np.argmin(curve["a0"]))
    for orbit in (curve.solutions[turn - 1], curve.solutions[turn + 1]):
        known = shot(model, orbit, "rho", has_product_one, np.zeros(2))
        assert orbit.parameters["rho"] == pytest.approx(known, abs=1e-9)
