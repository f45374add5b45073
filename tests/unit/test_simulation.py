"""Simulations of any model against closed forms, and the cycles found in them."""

from __future__ import annotations

import re
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.integrate
from lattices import chain as chain_as_a_lattice

from casadi_skin import Bond, Chain, LongLattice, OdeModel, Site, find_equilibrium, find_orbit, follow_family, simulate
from casadi_skin.model.integrators import IntegrationError

X, Y, MU, T = (ca.SX.sym(name) for name in ("x", "y", "mu", "t"))
VAN_DER_POL = OdeModel("van der Pol", ca.vertcat(X, Y), ca.vertcat(Y, MU * (1 - X**2) * Y - X), MU, nominal=(1.0,))


def test_the_last_cycle_is_a_guess_that_finds_the_orbit() -> None:
    cycle = simulate(VAN_DER_POL, [0.1, 0.0], np.linspace(0.0, 100.0, 2001)).last_cycle()
    assert cycle.period == pytest.approx(6.663286859323, abs=1e-3)
    assert find_orbit(VAN_DER_POL, cycle).period == pytest.approx(6.663286859323, abs=1e-9)


def test_jumps_between_output_times_are_followed_by_the_integrator_of_the_simulation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Van der Pol at mu = 100, whose period is 162.837071092 (collocation, +- 5e-12): no output time lies in a jump."""

    def refused(*arguments: object, **options: object) -> None:
        raise AssertionError("integrated again in Python")

    monkeypatch.setattr(scipy.integrate, "solve_ivp", refused)
    t = np.linspace(0.0, 567.0, 2001)
    cycle = simulate(VAN_DER_POL, [2.0, 0.0], t, parameters={"mu": 100.0}).last_cycle()
    assert cycle.period == pytest.approx(162.837071092, rel=1e-9)
    assert np.max(np.abs(cycle.evaluate(cycle.times)), axis=0) == pytest.approx([2.0, 133.3], rel=1e-2)
    between = 0.5 * (cycle.times[1:] + cycle.times[:-1])  # slopes of the cubics there are those of the equations
    h = 1e-4 * np.diff(cycle.times)
    slopes = (cycle.evaluate(between + h) - cycle.evaluate(between - h)) / (2.0 * h)[:, None]
    x, y = cycle.evaluate(between).T
    fields = np.stack([y, 100.0 * (1.0 - x**2) * y - x], axis=1)
    assert np.max(np.abs(slopes - fields) / np.max(np.abs(fields), axis=0)) < 1e-3


def test_a_state_at_rest_and_one_that_grows_have_no_cycle() -> None:
    for rate, words in ((0.0, "2.5 on the state rests: this is an equi"), (0.3, "0 to 5 the state does not come back")):
        model = OdeModel("growth", X, rate * X)
        with pytest.raises(ValueError, match=f"last_cycle: from t = {words}"):
            simulate(model, [1.0], np.linspace(0.0, 5.0, 51)).last_cycle()
    with pytest.raises(ValueError, match="last_cycle: given 2 output times; accepted: 40 or more"):
        simulate(VAN_DER_POL, [0.1, 0.0], [0.0, 60.0]).last_cycle()


def test_a_state_that_runs_away_is_told() -> None:
    """x' = x^2 from x(0) = 1 is 1/(1 - t): it is told with the time and the state, which are large together."""
    words = r"cvodes: the state was followed to t = 0.5 of 2: x runs to infinity: it is (\S+) at t = (\S+)$"
    with pytest.raises(IntegrationError, match=words) as caught:
        simulate(OdeModel("blow-up", ca.vertcat(X, Y), ca.vertcat(X**2, -Y)), {"x": 1.0}, [0.0, 0.5, 2.0])
    np.testing.assert_allclose(caught.value.trajectory.states, [[2.0, 0.0]], atol=1e-7)
    told = re.search(words, str(caught.value))
    x, t = map(float, told.groups())
    assert x > 100.0
    assert t == pytest.approx(1.0 - 1.0 / x, abs=1e-5)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"start": [0.0]}, "start: given 1 states; accepted: 2, x, y"),
        ({"start": {"z": 1.0}}, "start: given 'z'; accepted: x, y"),
        ({"start": {"x": np.nan}}, "start, x: given nan; accepted: a finite number"),
        ({"t": [0.0]}, "t: given .*; accepted: two or more times, ascending"),
        ({"t": [1.0, 0.0]}, "t: given .*; accepted: two or more times, ascending"),
        ({"parameters": {"nu": 1.0}}, "parameters: given 'nu'; accepted: mu"),
        ({"tolerance": 0.0}, "tolerance: given 0.0; accepted: 1e-13 to 1e-2"),
    ],
)
def test_what_cannot_be_meant_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        simulate(VAN_DER_POL, **({"start": [0.1, 0.0], "t": [0.0, 1.0]} | changes))


@pytest.mark.parametrize("model_of", [Chain, chain_as_a_lattice])
def test_orbits_and_simulations_of_a_chain_and_of_a_lattice_are_those_of_its_family(model_of: Any) -> None:
    """Two ways to one orbit: odd cosines in the gauge, and collocation or CVODES in physical coordinates."""
    of_family = follow_family(Chain(4, 1.0, 0.25, 1.0), mode=1, amplitude_max=0.3, at=[0.3]).at(S=0.3)
    model, at_rest = model_of(4, 1.0, 0.25, 1.0), [*of_family.evaluate(0.0), *np.zeros(4)]
    orbit = find_orbit(model, of_family, symmetric=True, select=lambda t, x, p: x[0] - at_rest[0])
    assert orbit.Omega == pytest.approx(of_family.Omega, rel=1e-11)
    t = np.linspace(0.0, of_family.period, 9)
    assert orbit.evaluate(t)[:, :4] == pytest.approx(of_family.evaluate(t), abs=1e-10)
    assert simulate(model, at_rest, t).states == pytest.approx(orbit.evaluate(t), abs=1e-6)


def test_models_without_equations_are_refused_in_one_line() -> None:
    endless = LongLattice(40, [Site("a", "y")], [Bond("a", "a", (1,))])
    for model, words in (
        (Chain(np.inf, 1.0, 0.25, 1.0), "sites: given an infinite chain; accepted: a whole number >= 1"),  # type: ignore[arg-type]
        (endless, "[lattice]: given one with a linear tail"),
    ):
        for call in (
            lambda m: simulate(m, [0.1], [0.0, 1.0]), lambda m: find_orbit(m, [0.1], 6.0),
            lambda m: find_equilibrium(m, [0.1]),
        ):  # fmt: skip
            with pytest.raises(ValueError, match=re.escape(words)):
                call(model)
