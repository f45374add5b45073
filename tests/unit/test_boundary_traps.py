"""Numbers that would be wrong without a word: multipliers, intervals, degenerate points, stationary points, sizes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit
from casadi_skin.dynamics.evolve import simulate
from casadi_skin.follow.space import BoundaryError
from casadi_skin.search.design import Ending
from casadi_skin.search.nlp import Outcome, Solution, Start
from casadi_skin.search.orbit_search import difference

X, Y, Z, MU = (ca.SX.sym(name) for name in ("x", "y", "z", "mu"))


def turning(x: float = 2.0, y: float = -2.0) -> Callable[[float], list[float]]:
    return lambda t: [x * np.cos(t), y * np.sin(t)]


def van_der_pol(x: float = 1.0, y: float = 1.0, direction: float = 1.0) -> OdeModel:
    """The oscillator with its states in units of 1/x and 1/y; repelling with `direction` -1."""
    u, v = X / x, Y / y
    field = ca.vertcat(x * v, y * (direction * MU * (1 - u**2) * v - u))
    return OdeModel("oscillator", ca.vertcat(X, Y), field, MU)


def test_a_multiplier_beside_a_tiny_one_keeps_its_digits() -> None:
    """Roessler's orbit of two turns: -0.4187354 by DOP853 beside one of 1e-16, which spoils the inverse products."""
    field = ca.vertcat(-Y - Z, X + 0.2 * Y, 0.2 + Z * (X - 3.5))
    model = OdeModel("Roessler", ca.vertcat(X, Y, Z), field)
    cycle = simulate(model, [1.0, 1.0, 0.0], np.linspace(0.0, 400.0, 8001)).last_cycle()
    orbit = find_orbit(model, cycle)

    def variations(_: float, s: np.ndarray) -> np.ndarray:
        x, y, z = s[:3]
        J = np.array([[0, -1, -1], [1, 0.2, 0], [z, 0, x - 3.5]])
        return np.concatenate([[-y - z, x + 0.2 * y, 0.2 + z * (x - 3.5)], (J @ s[3:].reshape(3, 3)).ravel()])

    start = np.concatenate([orbit.evaluate(0.0), np.eye(3).ravel()])
    end = solve_ivp(variations, (0.0, orbit.period), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    reference = sorted(np.linalg.eigvals(end[3:].reshape(3, 3)), key=abs)[1]
    assert reference == pytest.approx(-0.41873542, abs=1e-7)
    assert orbit.floquet().others[0].real == pytest.approx(reference, abs=1e-7)


@pytest.mark.parametrize(
    ("x", "y", "by"),  # the tolerance of CVODES is relative to the largest component
    [(1.0, 1.0, "collocation"), (1e-4, 1e4, "collocation"), (1e3, 1e-3, "collocation"), (1.0, 1.0, "cvodes")],
)
def test_stability_does_not_depend_on_units(x: float, y: float, by: str) -> None:
    orbit = find_orbit(van_der_pol(x, y, -1.0), turning(2 * x, -2 * y), 6.3, parameters={"mu": 0.1})
    found = orbit.floquet(by)
    assert found.others[0].real == pytest.approx(1.87592885, abs=1e-6)
    assert not found.stable
    assert found.error < 1e-4


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_an_orbit_against_time_is_none(corrector: str) -> None:
    times = np.linspace(0.0, 6.6, 201)
    jumping = times, np.array([turning(2.0, 2.0)(t) for t in times])  # which does not close after 6.6
    with pytest.raises(BoundaryError, match=r"the interval found, 0 to -\d.*, does not end after its start"):
        find_orbit(van_der_pol(), jumping, 6.6, parameters={"mu": 1.0}, corrector=corrector)


def test_a_free_end_before_the_start_is_refused() -> None:
    model = OdeModel("path", X, ca.SX(1.0), MU, nominal=(1.0,))
    problem = BoundaryValueProblem(model, [model.start(X), model.end(X) + 2], interval=(0.0, MU), free=["mu"])
    with pytest.raises(BoundaryError, match="the interval found, 0 to -2, does not end after its start"):
        problem.solve([0.0])


def hopf() -> OdeModel:
    square = X**2 + Y**2
    turn = 1 + 0.3 * square
    field = ca.vertcat(MU * X - turn * Y - X * square, turn * X + MU * Y - Y * square)
    return OdeModel("Hopf", ca.vertcat(X, Y), field, MU)


@pytest.mark.slow
def test_the_equilibrium_at_a_hopf_point_is_no_orbit() -> None:
    with pytest.raises(BoundaryError, match=r"Hopf: no solution near the guess: rounding alone leaves an error of"):
        find_orbit(hopf(), turning(0.1, 0.1), 6.28, parameters={"mu": 0.0})


@pytest.mark.slow
def test_a_weak_hopf_point_conserves_nothing() -> None:
    """Its orbits have the square radius 20 mu: at mu = 0 there is the equilibrium alone."""
    square = X**2 + Y**2
    field = ca.vertcat(MU * X - Y - 0.05 * X * square, X + MU * Y - 0.05 * Y * square)
    model = OdeModel("weak Hopf", ca.vertcat(X, Y), field, MU)
    with pytest.raises(BoundaryError) as refused:
        find_orbit(model, turning(0.1, 0.1), 6.28, parameters={"mu": 0.0})
    assert "conserve" not in str(refused.value)


def test_a_branch_to_a_hopf_point_ends_there_by_name() -> None:
    """Orbits shrink to the equilibrium at mu = 0: their square radius is mu, their frequency 1 + 0.3 mu."""
    orbit = find_orbit(hopf(), turning(0.3, 0.3), 6.28, parameters={"mu": 0.1})
    branch = orbit.follow("mu", -0.1)
    assert not branch.complete
    assert branch.reason == "the cycle shrinks to an equilibrium at a Hopf point"
    (end,) = branch.special_points
    assert end.kind == "hopf"
    assert abs(end.parameters["mu"]) <= end.error < 1e-12
    assert np.ptp(branch.solutions[-1].states) == 0.0
    for solution in branch.solutions:
        np.testing.assert_allclose(np.sum(solution.states**2, axis=1), solution["mu"], rtol=0, atol=1e-7)
        assert solution.period == pytest.approx(2 * np.pi / (1 + 0.3 * solution["mu"]), abs=1e-6)


def test_an_end_that_is_passed_but_not_met_is_told() -> None:
    """The orbits of a double well end in a homoclinic one at sqrt(2); beside it steps in the amplitude are too long."""
    a = ca.SX.sym("a")
    energy = Y**2 / 2 - X**2 / 2 + X**4 / 4
    model = OdeModel("well", ca.vertcat(X, Y), ca.vertcat(Y, X - X**3), a, reversal=(1, -1), hamiltonian=energy)
    guess = lambda t: [1 + 0.2 * np.cos(1.414 * t), -0.28 * np.sin(1.414 * t)]  # noqa: E731
    orbit = find_orbit(model, guess, 4.5, parameters={"a": 1.2}, select=X - a, symmetric=True)
    end = np.sqrt(2.0) - 1e-8
    branch = orbit.follow("a", end)
    assert branch.complete == (branch.values[-1] == pytest.approx(end, abs=1e-12))
    assert branch.complete or branch.reason.startswith("no solution was found at a = 1.41421355237")


@pytest.mark.parametrize("start", [0.0, 1e-9])
def test_a_maximum_is_no_minimum(start: float) -> None:
    """cos(mu) is stationary at 0, and largest there; the Ipopt of CasADi 3.7 leaves 1e-9, and fails at pi."""
    words = r"stationary, but no minimum: curvature -.*; try another guess" + ("|no way on: " if start else "")
    model = OdeModel("line", X, MU, MU)
    problem = BoundaryValueProblem(
        model, [model.start(X)], free=["mu"], parameters={"mu": start}, objective=ca.cos(model.end(X))
    )
    with pytest.raises(BoundaryError, match=words):
        problem.solve([start])
    assert problem.with_parameters(mu=0.1).solve([0.1]).status == "a local optimum"  # type: ignore[attr-defined]


@pytest.mark.parametrize("size", [1e-11, 1e-9, 1e-6])
@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_a_small_solution_is_found_from_zeros(size: float, corrector: str) -> None:
    """Bratu's problem in other units: u(1/2) = 0.140539214400 of them."""
    model = OdeModel("small", ca.vertcat(X, Y), ca.vertcat(Y, -size * ca.exp(X / size)))
    solution = BoundaryValueProblem(model, [model.start(X), model.end(X)]).solve([0.0, 0.0], corrector=corrector)
    assert solution.evaluate(0.5)[0] / size == pytest.approx(0.1405392144, abs=1e-9)
    assert solution.error < 1e-8


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_optima_at_one_place_with_other_values_are_two_in_any_unit(unit: float) -> None:
    """Two orbits of a forced model may share period and parameters."""
    place, none = np.array([1.0, 6.0]), np.zeros(0)
    one, other = (
        Outcome(
            Start(1, (1.0,)), Ending.FOUND, "", none, unit * np.array([0.6, value]),
            Solution(none, none, none, unit * value, "", 1), place,
        )
        for value in (0.5, 0.4)
    )  # fmt: skip
    assert not one.is_near(other)
    assert one.is_near(one)


def test_the_check_of_a_forced_optimum_sees_other_states() -> None:
    """Duffing's oscillator has two stable orbits at omega = 1.8: of one period, but not the same."""
    t = ca.SX.sym("t")
    field = ca.vertcat(Y, -X - X**3 - 0.1 * Y + 0.5 * ca.cos(MU * t))
    model = OdeModel("Duffing", ca.vertcat(X, Y), field, MU, time=t, forcing_period=2 * ca.pi / MU, nominal=(1.8,))
    small = find_orbit(model, [0.0, 0.0])
    large = find_orbit(model, lambda s: [1.7 * np.sin(1.8 * s), 1.7 * 1.8 * np.cos(1.8 * s)])
    assert difference(small, small) == 0.0
    assert difference(small, large) > 0.1


SEARCH = """
import casadi as ca
from casadi_skin import OdeModel, search_orbit
if __name__ == "__main__":
    q, v, omega, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
    field = ca.vertcat(v, -q - q**3 - 0.1 * v + 0.1 * ca.cos(omega * t))
    model = OdeModel("D", ca.vertcat(q, v), field, omega, time=t, forcing_period=2 * ca.pi / omega, nominal=(1.0,))
    result = search_orbit(model, guess=[0.0, 0.0], free=["omega"], bounds={"omega": (0.2, 2.0)}, running=-(q**2),
                          starts=200, workers=2, progress=lambda words: print(words, flush=True))
    print(result.reason)
"""


@pytest.mark.usefixtures("interruptible")
@pytest.mark.slow
def test_an_interruption_of_processes_keeps_what_they_found(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SEARCH)
    command = [sys.executable, str(script)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as p:
        assert "done" in p.stdout.readline()
        assert "done" in p.stdout.readline()
        os.killpg(p.pid, signal.SIGINT)
        said, errors = p.communicate(timeout=60)
    assert (p.returncode, errors) == (0, "")
    assert said.splitlines()[-1].startswith("interrupted after ")
    assert "found an optimum" in said.splitlines()[-1]


@pytest.mark.parametrize("rate", ["log(u)", "1/u", "exp(1e3*u)"])
def test_fields_that_are_not_finite_end_in_a_line_without_warnings(rate: str, recwarn: pytest.WarningsRecorder) -> None:
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    field = {"log(u)": ca.log(u), "1/u": 1 / u, "exp(1e3*u)": ca.exp(1e3 * u)}[rate]
    model = OdeModel("pole", ca.vertcat(u, v), ca.vertcat(v, field))
    problem = BoundaryValueProblem(model, [model.start(u), model.end(u) - 1.0])
    with pytest.raises(BoundaryError) as failure:
        problem.solve([2e5 if rate.startswith("exp") else 0.0, 0.0])
    assert "\n" not in str(failure.value)
    assert "not finite at the equation of v" in str(failure.value)
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]
