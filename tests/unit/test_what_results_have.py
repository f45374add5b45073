"""What a result has: every name of its class is a value or no attribute, and times, states and shapes agree."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import (
    BoundaryValueProblem,
    Chain,
    OdeModel,
    Orbit,
    find_equilibrium,
    find_orbit,
    follow_family,
    simulate,
)

X, Y, MU = (ca.SX.sym(name) for name in ("x", "y", "mu"))
HOPF = OdeModel(
    "Hopf", ca.vertcat(X, Y), ca.vertcat(MU * X - Y - X * (X**2 + Y**2), X + MU * Y - Y * (X**2 + Y**2)), MU
)


def member(**options: Any) -> Orbit:
    orbit = follow_family(Chain(3, 1.0, 0.25, -1.0), 1, 0.2, tolerance=1e-9, **options).at(S=0.2)
    assert isinstance(orbit, Orbit)
    return orbit


def cycle() -> Any:
    return find_orbit(HOPF, lambda t: [0.5 * np.cos(t), 0.5 * np.sin(t)], 2 * np.pi, parameters={"mu": 0.25})


def rest() -> Any:
    return find_equilibrium(HOPF, [0.0, 0.0], parameters={"mu": -0.25})


def line() -> Any:
    model = OdeModel("line", ca.vertcat(X, Y), ca.vertcat(Y, -MU * X), MU)
    return BoundaryValueProblem(model, [model.start(X), model.end(X) - 1], parameters={"mu": 1.0}).solve([0.0, 1.0])


def motion() -> Any:
    return simulate(HOPF, [0.1, 0.0], np.linspace(0.0, 60.0, 601), parameters={"mu": 0.25})


KINDS: dict[str, Callable[[], Any]] = {
    "orbit of a family": member,
    "orbit of a family by collocation": lambda: member(transcription="gauss"),
    "orbit of a family by shooting": lambda: member(transcription="shooting"),
    "orbit of an infinite chain": lambda: follow_family(Chain(np.inf, 1.0, 0.7, 1.0), "last", 0.5).orbits[-1],
    "cycle": cycle,
    "equilibrium": rest,
    "solution": line,
    "motion": motion,
    "family": lambda: follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.2, stability=True),
    "equilibria": lambda: rest().follow("mu", 0.25),
    "cycles": lambda: cycle().follow("mu", 0.5),
    "solutions": lambda: line().follow("mu", 2.0),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_name_of_a_result_is_a_value_or_no_attribute(kind: str) -> None:
    result = KINDS[kind]()
    names = [name for name in dir(type(result)) if not name.startswith("_")]
    assert [name for name in names if hasattr(result, name)]
    for name in names:  # hasattr itself raises what is no AttributeError
        if not hasattr(result, name):
            with pytest.raises(AttributeError) as reason:
                getattr(result, name)
            assert "\n" not in str(reason.value)


def test_what_a_kind_of_result_has_not_is_named() -> None:
    for result, missing in (
        (rest(), ("t", "mesh", "states", "intervals", "objective")),
        (cycle(), ("S", "energy", "objective", "Omega_shift")),
        (member(), ("mesh", "intervals", "problem", "statement", "objective")),
        (line(), ("stable", "objective", "status")),
    ):
        assert [name for name in missing if hasattr(result, name)] == []
    with pytest.raises(ValueError, match="energy: Hopf declares no hamiltonian"):
        _ = cycle().energy
    with pytest.raises(ValueError, match=r"mesh: the solution is not one of collocation; accepted: evaluate\(t\)"):
        _ = member().mesh


@pytest.mark.parametrize(
    ("options", "least", "intervals"),
    [({}, 4, False), ({"transcription": "gauss"}, 5, True), ({"transcription": "shooting"}, 2, False)],
)
def test_times_and_states_of_an_orbit_of_a_family(options: dict[str, Any], least: int, intervals: bool) -> None:
    """Within the quarter that was unknown, and on the orbit that odd cosines give."""
    orbit, exact = member(**options), member()
    assert orbit.t.size >= least
    assert np.all(np.diff(orbit.t) > 0.0)
    assert 0.0 <= orbit.t[0] < orbit.t[-1] <= 0.25 * orbit.period * (1 + 1e-14)
    assert orbit.states.shape == (orbit.t.size, 3)
    np.testing.assert_allclose(orbit.states, exact.evaluate(orbit.t), atol=1e-8)
    np.testing.assert_array_equal(orbit[orbit.space.state_names[1]], orbit.states[:, 1])
    assert hasattr(orbit, "mesh") == intervals
    if intervals:
        assert orbit.mesh.size == orbit.intervals + 1
        np.testing.assert_allclose(orbit.mesh[[0, -1]], [0.0, 0.25 * orbit.period], rtol=1e-14)
        assert np.isin(np.round(orbit.mesh, 12), np.round(orbit.t, 12)).all()


@pytest.mark.parametrize("kind", ["orbit of a family", "orbit of an infinite chain", "cycle", "solution", "motion"])
def test_one_time_gives_one_state_and_several_a_row_each(kind: str) -> None:
    result = KINDS[kind]()
    several = result.evaluate([0.1, 0.4, 0.7])
    one = result.evaluate(0.4)
    assert one.shape == several.shape[1:]
    np.testing.assert_allclose(one, several[1], rtol=1e-14)
    assert result.evaluate(np.float64(0.4)).shape == one.shape
    assert result.evaluate([0.4]).shape == (1, *one.shape)


def test_an_equilibrium_and_a_simulated_cycle_have_the_same_shapes() -> None:
    guess = motion().last_cycle()
    for result in (rest(), guess):
        assert result.evaluate(0.5).shape == (2,)
        assert result.evaluate([0.5]).shape == (1, 2)
        assert result.evaluate([0.5, 1.0]).shape == (2, 2)
