"""Boundary-value problems beside scipy.integrate.solve_bvp: time and nodes for the same true error.

Each program is given the loosest tolerance of a grid that brings the true error below what is asked. Times
are the whole of a call; ours also of a second solve of the same problem, which keeps what was built. solve_bvp gets
exact derivatives. Run with `pytest -m benchmark -s tests/benchmarks/test_boundary_speed.py`.
"""

from __future__ import annotations

import importlib.util
import itertools
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_bvp
from stopwatch import seconds

from casadi_skin import BoundaryValueProblem
from casadi_skin.follow.find import find_orbit
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.ode import OdeModel

pytestmark = pytest.mark.benchmark

Record = Callable[[str, float, int], None]
TOLERANCES = 10.0 ** -np.arange(2, 13)
NODES = 200_000  # that solve_bvp may use
STEP = 1e-30  # of the complex-step derivative


@pytest.fixture(scope="module")
def cases() -> ModuleType:
    path = Path(__file__).parents[1] / "unit" / "boundary_cases.py"
    spec = importlib.util.spec_from_file_location("boundary_cases", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["boundary_cases"] = module
    spec.loader.exec_module(module)
    return module


def by_scipy(case: Any, eps: float, tolerance: float) -> Any:
    def fun(x: Any, y: Any) -> Any:
        return np.stack([y[1], case.rhs(np, x, y[0], y[1], eps) / eps])

    def jac(x: Any, y: Any) -> Any:
        derivative = np.zeros((2, 2, x.size))
        derivative[0, 1] = 1.0
        for k in range(2):
            moved = y.astype(complex)
            moved[k] += 1j * STEP
            derivative[1, k] = np.imag(case.rhs(np, x, moved[0], moved[1], eps)) / STEP / eps
        return derivative

    left, right = case.exact(np.array([case.start, 1.0]), eps)
    x = np.linspace(case.start, 1.0, 11)
    ends = np.eye(2)[0]
    with np.errstate(all="ignore"):  # failures are told by `success`
        return solve_bvp(
            fun, lambda a, b: np.array([a[0] - left, b[0] - right]), x, np.zeros((2, x.size)), fun_jac=jac,
            bc_jac=lambda a, b: (np.stack([ends, 0 * ends]), np.stack([0 * ends, ends])), tol=tolerance,
            max_nodes=NODES,
        )  # fmt: skip


@pytest.mark.parametrize("accuracy", [1e-6, 1e-10])
@pytest.mark.parametrize(
    ("name", "eps"),
    [
        *[("1, two layers", eps) for eps in (1e-2, 1e-4, 1e-6)],
        *[("2, layer at the end", eps) for eps in (1e-2, 1e-4, 1e-6)],
        *[("6, shock at a turning point", eps) for eps in (1e-2, 1e-4, 1e-6)],
        *[("7, corner at a turning point", eps) for eps in (1e-2, 1e-4, 1e-6)],
        ("20, nonlinear corner", 1e-2),
        *[("21, nonlinear layer", eps) for eps in (1e-2, 1e-4, 1e-6)],
    ],
)
def test_layers_beside_solve_bvp(record: Record, cases: ModuleType, name: str, eps: float, accuracy: float) -> None:
    case = cases.LAYERS[name]
    words = f"{name}, eps = {eps:g}, to {accuracy:g}"
    x, problem, guess = case.grid(eps), case.problem(eps), [0.0, 0.0]
    exact = case.exact(x, eps)

    for tolerance in TOLERANCES:
        solution = problem.solve(guess, tolerance=tolerance)
        if case.error(solution, eps) <= accuracy:
            break
    ours = seconds(lambda: case.problem(eps).solve(guess, tolerance=tolerance), 3)
    columns, error = solution.t.size, case.error(solution, eps)
    warm = seconds(lambda: problem.solve(guess, tolerance=tolerance), 3)
    record(f"BVP {words}, built and solved", ours, columns)
    record(f"BVP {words}, solved", warm, columns)
    assert error <= accuracy

    for tolerance in TOLERANCES:
        started = time.process_time()
        other = by_scipy(case, eps, tolerance)
        theirs = time.process_time() - started
        wrong = float(np.max(np.abs(other.sol(x)[0] - exact)) / np.max(np.abs(exact)))
        met = other.success and wrong <= accuracy
        if met or theirs > 10.0:
            break
    if theirs < 1.0:
        theirs = seconds(lambda: by_scipy(case, eps, tolerance), 3)
    record(f"solve_bvp {words}{'' if met else ', not met'}", theirs, other.x.size)
    parts = (f"{theirs / ours:.2g}", f"{theirs / warm:.2g}") if met else (f"not met: {other.message}", "")
    row = (name, f"{eps:g}", f"{accuracy:g}", f"{columns}", f"{other.x.size}" if met else "", *parts)
    print(f"| {' | '.join(row)} |")


def test_bratu_and_its_branch(record: Record) -> None:
    u, v, lam = (ca.SX.sym(name) for name in ("u", "v", "lambda"))
    model = OdeModel("Bratu", ca.vertcat(u, v), ca.vertcat(v, -lam * ca.exp(u)), lam)

    def stated() -> BoundaryValueProblem:
        return BoundaryValueProblem(model, [model.start(u), model.end(u)], parameters={"lambda": 1.0})

    problem = stated()
    record("BVP Bratu, built and solved", seconds(lambda: stated().solve([0.0, 0.0], tolerance=1e-8), 5), 1)
    record("BVP Bratu, solved", seconds(lambda: problem.solve([0.0, 0.0], tolerance=1e-8), 5), 1)
    values = itertools.count(0.5, 0.01)
    other = lambda: problem.with_parameters(**{"lambda": next(values)}).solve([0.0, 0.0], tolerance=1e-8)  # noqa: E731
    record("BVP Bratu, another value of its parameter", seconds(other, 5), 1)
    x = np.linspace(0.0, 1.0, 11)
    theirs = lambda: solve_bvp(  # noqa: E731
        lambda x, y: np.stack([y[1], -np.exp(y[0])]),
        lambda a, b: np.array([a[0], b[0]]),
        x,
        np.zeros((2, 11)),
        tol=1e-8,
    )
    record("solve_bvp Bratu", seconds(theirs, 5), 1)
    start = problem.with_parameters(**{"lambda": 0.5}).solve([0.0, 0.0], tolerance=1e-7)
    branch = start.follow("lambda", 4.0)
    assert abs(branch.folds[0].parameters["lambda"] - 3.513830719) < 1e-7
    record("BVP Bratu's branch through its fold", seconds(lambda: start.follow("lambda", 4.0), 3), len(branch))


@pytest.mark.parametrize("units", [3, 10, 25, 50, 100])
def test_rings_of_van_der_pol_oscillators(record: Record, units: int) -> None:
    """The rotating wave, whose period is that of one oscillator with the coupling's share of its neighbours."""
    x, y = ca.SX.sym("x", units), ca.SX.sym("y", units)
    before, after = ca.vertcat(x[-1], x[:-1]), ca.vertcat(x[1:], x[0])
    rate = 0.5 * (1 - x**2) * y - x + 0.1 * (before + after - 2 * x)
    model = OdeModel("ring", ca.vertcat(x, y), ca.vertcat(y, rate))
    phases = 2 * np.pi * np.arange(units) / units
    guess = lambda t: np.concatenate([2 * np.cos(t - phases), -2 * np.sin(t - phases)])  # noqa: E731
    orbit = find_orbit(model, guess, 6.4, tolerance=1e-8)
    wave = orbit.evaluate(np.array([0.0, orbit.period / units]))
    np.testing.assert_allclose(wave[1, :units], np.roll(wave[0, :units], 1), atol=1e-6)
    record(f"ring of {units} oscillators", seconds(lambda: find_orbit(model, guess, 6.4, tolerance=1e-8), 1), 1)


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_orbits_of_general_models(record: Record, corrector: str) -> None:
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    model = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu)

    def find() -> Any:
        guess = lambda t: [2 * np.cos(t), -2 * np.sin(t)]  # noqa: E731
        return find_orbit(model, guess, 6.6, parameters={"mu": 1.0}, tolerance=1e-9, corrector=corrector)

    orbit = find()
    assert abs(orbit.period - 6.66328685932313) < 1e-9
    record(f"van der Pol's orbit, {corrector}, built and solved", seconds(find, 5), 1)
    branch = orbit.follow("mu", 10.0, max_step=0.5)
    assert abs(branch.solutions[-1].period - 19.078369567) < 1e-8
    record(f"van der Pol from mu = 1 to 10, {corrector}", seconds(lambda: orbit.follow("mu", 10.0), 1), len(branch))


def test_a_nonlinear_corner_by_continuation(record: Record, cases: ModuleType) -> None:
    """eps = 1e-6 from a guess that leads nowhere near: neither program finds it directly."""
    case = cases.LAYERS["20, nonlinear corner"]
    with pytest.raises(BoundaryError):
        case.problem(1e-6).solve([1.5, 0.0])

    def walk() -> Any:
        return start.follow("eps", 1e-6)

    eps, u, v = ca.SX.sym("eps"), ca.SX.sym("u"), ca.SX.sym("v")
    model = OdeModel("corner", ca.vertcat(u, v), ca.vertcat(v, (1 - v**2) / eps), eps)
    outside = lambda s: 1 + s - eps * np.log(2.0) + eps * ca.log1p(ca.exp(-2 * s / eps))  # noqa: E731
    conditions = [model.start(u) - outside(0.745), model.end(u) - outside(0.255)]
    start = BoundaryValueProblem(model, conditions, parameters={"eps": 1e-2}).solve([1.5, 0.0], tolerance=1e-6)
    branch = walk()
    assert case.error(branch.solutions[-1], 1e-6) < 1e-6
    record("BVP 20, nonlinear corner, from eps = 1e-2 to 1e-6", seconds(walk, 1), len(branch))
    assert not by_scipy(case, 1e-6, 1e-3).success
