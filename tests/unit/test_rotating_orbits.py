"""Orbits that close but for turns of their angles, and multipliers of any solution that closes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipk

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit

q, v, E, current = (ca.SX.sym(name) for name in ("q", "v", "E", "I"))
ENERGY = v**2 / 2 - ca.cos(q)


def pendulum() -> OdeModel:
    return OdeModel("pendulum", ca.vertcat(q, v), ca.vertcat(v, -ca.sin(q)), E, reversal=(-1, 1), hamiltonian=ENERGY)


def turn_time(energy: float) -> float:
    """Time of one turn of the pendulum: 2 k K(k^2) with k^2 = 2/(1 + E)."""
    m = 2.0 / (1.0 + energy)
    return float(2.0 * np.sqrt(m) * ellipk(m))


def test_a_junction_under_current_turns_in_the_closed_form_of_its_period() -> None:
    """Overdamped: q' = I - sin q turns in 2 pi/sqrt(I^2 - 1); its only multiplier is that of time."""
    junction = OdeModel("junction", q, current - ca.sin(q), current)
    orbit = find_orbit(junction, lambda t: [t], 6.0, parameters={"I": 1.5}, rotations={"q": 1})
    assert orbit.period == pytest.approx(2.0 * np.pi / np.sqrt(1.25), rel=1e-12)
    assert orbit.floquet().multipliers == pytest.approx([1.0], abs=1e-9)
    ends = orbit.evaluate([0.0, orbit.period, -2.0 * orbit.period])[:, 0]
    assert np.diff(ends) == pytest.approx([2.0 * np.pi, -6.0 * np.pi], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("turns", [1, -1])
def test_a_pendulum_goes_round(symmetric: bool, turns: int) -> None:
    period = turn_time(2.0)
    orbit = find_orbit(
        pendulum(), lambda t: [2.0 * np.pi * turns * t / period, 1.7 * turns], period, parameters={"E": 2.0},
        select=ENERGY - E, rotations={"q": turns}, symmetric=symmetric,
    )  # fmt: skip
    assert orbit.period == pytest.approx(period, rel=1e-12)
    times = np.linspace(0.0, 2.7 * period, 40)
    states = orbit.evaluate(times)
    assert states[:, 1] ** 2 / 2 - np.cos(states[:, 0]) == pytest.approx(2.0, abs=1e-8)
    assert np.all(np.diff(turns * states[:, 0]) > 0.0)
    branch = orbit.follow("E", 1.05)
    assert branch.orbits[-1].period == pytest.approx(turn_time(1.05), rel=1e-9)


@pytest.mark.slow
def test_two_turns_are_one_turn_taken_twice() -> None:
    """A driven pendulum that turns with its drive, and the same over two periods of the drive."""
    t, A, w = (ca.SX.sym(name) for name in ("t", "A", "w"))
    rhs = ca.vertcat(v, -0.2 * v - ca.sin(q) + A * ca.cos(w * t))
    driven = OdeModel("driven", ca.vertcat(q, v), rhs, ca.vertcat(A, w), time=t, forcing_period=2 * ca.pi / w)
    values = {"A": 1.6, "w": 0.9}
    once = find_orbit(driven, lambda s: [0.9 * s - 2.0, 0.9], parameters=values, rotations={"q": 1})
    twice = find_orbit(driven, once, parameters=values, rotations={"q": 2}, cycles=2)
    assert np.prod(once.floquet().multipliers) == pytest.approx(np.exp(-0.2 * once.period), rel=1e-7)
    assert twice.evaluate([1.0, 8.0]) == pytest.approx(once.evaluate([1.0, 8.0]), abs=1e-6)
    assert np.sort(np.abs(twice.floquet().multipliers)) == pytest.approx(
        np.sort(np.abs(once.floquet().multipliers)) ** 2, rel=1e-5
    )


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"v": 1}, "rotations: given v, in which pendulum has no period 2 pi; accepted: states that are angles"),
        ({"p": 1}, "rotations: given 'p'; accepted: q, v"),
    ],
)
def test_rotations_that_cannot_be_meant_are_refused(given: dict[str, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        find_orbit(pendulum(), [1.0, 1.0], 5.0, parameters={"E": 2.0}, select=ENERGY - E, rotations=given)


def test_turns_that_are_no_whole_numbers_are_refused() -> None:
    with pytest.raises(TypeError, match=r"rotations: given 0\.5 for q; accepted: a whole number of turns"):
        find_orbit(pendulum(), [1.0, 1.0], 5.0, select=ENERGY - E, rotations={"q": 0.5})  # type: ignore[dict-item]


def test_angles_that_the_reversal_leaves_cannot_rotate_in_a_symmetric_orbit() -> None:
    mirrored = OdeModel("pendulum", ca.vertcat(q, v), ca.vertcat(v, -ca.sin(q)), E, reversal=(1, -1))
    with pytest.raises(ValueError, match="rotations: given q, which the reversal leaves as it is; accepted: angles"):
        find_orbit(mirrored, [0.0, 1.0], 5.0, select=ENERGY - E, rotations={"q": 1}, symmetric=True)


# Multipliers of any solution that closes --------------------------------------------------------------------------


@pytest.mark.slow
def test_a_problem_that_closes_has_the_multipliers_of_the_orbit() -> None:
    """Van der Pol in scaled time, closed, and with x(T/2) = -x(0): squares of the multipliers of half of the orbit."""
    T, mu = ca.SX.sym("T"), ca.SX.sym("mu")
    field = T * ca.vertcat(v, mu * (1 - q**2) * v - q)
    model = OdeModel("van der Pol", ca.vertcat(q, v), field, ca.vertcat(T, mu), nominal=(6.6, 1.0))
    found = {}
    for part, sign in ((1.0, -1), (0.5, 1)):
        conditions = [model.end(model.state) + sign * model.start(model.state), model.start(v)]
        problem = BoundaryValueProblem(model, conditions, free=["T"], parameters={"T": 6.6 * part})
        found[part] = problem.solve(lambda s, w=2.0 * np.pi * part: [2.0 * np.cos(w * s), -2.0 * np.sin(w * s)])
    whole, half = (found[part].floquet() for part in (1.0, 0.5))
    assert found[1.0]["T"] == pytest.approx(6.66328685932313, rel=1e-10)
    assert whole.multipliers == pytest.approx([1.0, 8.59695064e-4], rel=1e-7)
    assert half.multipliers**2 == pytest.approx(whole.multipliers, rel=1e-7)
    assert whole.trivial == half.trivial == 1
    assert found[0.5].stable
    branch = found[1.0].follow("mu", 1.1, stability=True)
    assert np.all(branch.stable)


def test_a_problem_that_does_not_close_has_no_multipliers() -> None:
    model = pendulum()
    problem = BoundaryValueProblem(model, [model.start(q), model.end(q) - 1.0], parameters={"E": 0.0})
    solution = problem.solve([0.5, 1.0])
    with pytest.raises(ValueError, match=r"no stability; accepted: an orbit, or conditions x\(end\) = S x\(start\)"):
        _ = solution.stable
