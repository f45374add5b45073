"""Time evolution of models of one's own and of their orbits: families, forced and self-excited orbits."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm
from small_models import duffing, forced_orbit, fput, limit_cycle, pendulums, two_wells, van_der_pol

from casadi_skin import (
    Chain,
    OdeModel,
    Orbit,
    distance_from_orbit,
    evolve,
    follow_family,
    perturbed,
    simulate,
    simulate_orbit,
)
from casadi_skin.dynamics.evolution import equations_of_motion
from casadi_skin.model.methods import INTEGRATORS

METHODS = tuple(INTEGRATORS)


@cache
def orbit_of(kind: str) -> Orbit:
    if kind == "pendula":
        return follow_family(pendulums(), 5, 1.5, at=[1.5], tolerance=1e-11).at(1.5)
    if kind == "even harmonics":
        return follow_family(two_wells(), 1, 0.02, at=[0.02], tolerance=1e-10).at(0.02)
    return forced_orbit() if kind == "response" else limit_cycle()


# Orbits close ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "method", "coordinates", "error", "distance"),
    [
        *(("pendula", method, name, 2e-11, 1e-10) for method in METHODS for name in ("gauge", "physical")),
        *(("even harmonics", method, None, 2e-11, 1e-9) for method in METHODS),
        *(("response", method, None, 1e-9, 1e-9) for method in ("cvodes", "dop853")),
        *(("cycle", method, None, 1e-8, 1e-8) for method in ("cvodes", "dop853")),
    ],
)
def test_orbits_close_and_keep_their_energy(
    kind: str, method: str, coordinates: str | None, error: float, distance: float
) -> None:
    orbit = orbit_of(kind)
    t = np.linspace(0.0, orbit.period, 41)
    found, known = simulate_orbit(orbit, t, method=method, tolerance=1e-12, coordinates=coordinates), orbit.evaluate(t)
    np.testing.assert_allclose(found.states[:, : known.shape[1]], known, rtol=0, atol=error)
    assert distance_from_orbit(orbit, found).max() < distance
    if found.has_energy:
        assert found.energy == pytest.approx(orbit.energy, rel=2e-11)
        assert np.abs(found.energy_drift).max() < 2e-11
        assert "energy kept to" in found.status


def test_the_nearest_point_of_an_orbit_with_even_harmonics_is_found() -> None:
    orbit = orbit_of("even harmonics")
    off = evolve(orbit.model, orbit.profile + np.array([0.0, 1e-4]), None, [0.0])
    near = distance_from_orbit(orbit, off)[0]
    assert 0.1 * 1e-4 / np.sqrt(0.02) < near <= 1.0001 * 1e-4 / np.sqrt(0.02)


@pytest.mark.parametrize("method", ["cvodes", "dop853"])
def test_a_forced_response_draws_neighbours_in(method: str) -> None:
    response = orbit_of("response")
    kicked = simulate_orbit(response, response.period * np.arange(11), 1e-5, site=1, method=method)
    monodromy = response.floquet().monodromy
    linear = 1e-5 * np.array([np.linalg.matrix_power(monodromy, k)[:, 0] for k in range(11)])
    np.testing.assert_allclose(kicked.states - response.evaluate(0.0), linear, rtol=0, atol=2e-9)
    distance = distance_from_orbit(response, kicked)
    assert 0.01 * distance[0] < distance[-1] < 0.3 * distance[0]
    shifted = evolve(duffing(), response.evaluate(0.25 * response.period), None, [0.0])
    assert distance_from_orbit(response, shifted)[0] > 0.5  # the forcing fixes the phase


@pytest.mark.parametrize("method", ["cvodes", "dop853"])
def test_a_shift_of_phase_along_a_limit_cycle_is_no_distance(method: str) -> None:
    cycle = orbit_of("cycle")
    shifted = evolve(van_der_pol(), cycle.evaluate(0.3), None, np.linspace(0.0, cycle.period, 41))
    assert distance_from_orbit(cycle, shifted).max() < 1e-8
    kicked = simulate_orbit(cycle, [0.0, 3.0 * cycle.period], 0.1, site=2, method=method)
    distance = distance_from_orbit(cycle, kicked)
    assert distance[0] > 1e-3
    assert distance[1] < 1e-7


# Any start ------------------------------------------------------------------------------------------------------------


def test_the_chain_as_a_model_of_ones_own_moves_as_the_chain() -> None:
    """The same gauge is found from the equations alone: coordinates, energy per S and displacements agree."""
    chain = Chain(12, 1.0, 0.4, -1.0)
    model, parameters = chain.tunable_model(), {"alpha": 1.0, "gamma": 0.4, "g": -1.0}
    y = 0.4 * np.random.default_rng(3).normal(size=12) * chain.rho
    t = np.linspace(0.0, 30.0, 61)
    ours, theirs = evolve(chain, y, None, t), evolve(model, y, None, t, parameters=parameters)
    assert theirs.coordinates == "gauge"
    np.testing.assert_allclose(theirs.displacements, ours.displacements, rtol=0, atol=1e-11)
    found = equations_of_motion(model, parameters).gauge
    np.testing.assert_allclose(found.log_scale, chain.log_rho, rtol=0, atol=1e-13)


def test_a_model_without_a_gauge_is_integrated_as_it_is() -> None:
    for model in (fput(), pendulums()):
        n = model.size
        run = evolve(model, 0.1 * np.ones(n), None, [0.0, 1.0])
        assert run.coordinates == "physical"
        assert run.names[:2] == model.state_names[:2]
    assert evolve(pendulums(5, gamma=0.3), 0.1 * np.ones(5), None, [1.0]).coordinates == "gauge"
    with pytest.raises(
        ValueError, match="coordinates: given gauge for van der Pol, which has none; accepted: physical"
    ):
        evolve(van_der_pol(), [1.0, 0.0], None, [1.0], coordinates="gauge")


@pytest.mark.parametrize("method", ["cvodes", "dop853"])
def test_a_model_of_first_order_follows_the_matrix_exponential(method: str) -> None:
    matrix = np.array([[0.0, 1.0, 0.0], [-4.0, -0.1, 0.3], [0.0, -0.5, -0.2]])
    x = ca.SX.sym("x", 3)
    model = OdeModel("linear", x, ca.SX(ca.DM(matrix)) @ x)
    t = np.array([0.0, 0.4, 3.0, 11.0])
    run = evolve(model, [1.0, -0.5, 2.0], None, t, method, 1e-12)
    exact = np.array([expm(time * matrix) @ [1.0, -0.5, 2.0] for time in t])
    np.testing.assert_allclose(run.states, exact, rtol=0, atol=3e-10)
    np.testing.assert_allclose(run.evaluate([0.4]), exact[1:2], rtol=0, atol=3e-10)
    for name in ("displacements", "velocities"):
        with pytest.raises(ValueError, match=f"{name}: linear is of first order; accepted: states"):
            getattr(run, name)
    with pytest.raises(ValueError, match="energy: linear declares no hamiltonian"):
        _ = run.energy


@pytest.mark.parametrize("method", ["cvodes", "dop853", "simulate"])
def test_forcing_of_a_model_of_second_order_is_followed(method: str) -> None:
    """q'' + q = cos(2 t) from rest: q = (cos t - cos 2t)/3."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    model = OdeModel("driven", q, -q + ca.cos(2 * t), order=2, velocity=v, time=t, forcing_period=np.pi)
    times, between = np.linspace(0.0, 20.0, 41), np.linspace(0.0, 20.0, 777)
    if method == "simulate":
        run = simulate(model, {"v": 0.0}, times, tolerance=1e-11)
    else:
        run = evolve(model, [0.0], None, times, method, 1e-12)
    np.testing.assert_allclose(run.states[:, 0], (np.cos(times) - np.cos(2 * times)) / 3, rtol=0, atol=1e-9)
    exact = (np.cos(between) - np.cos(2 * between)) / 3
    np.testing.assert_allclose(run.evaluate(between)[:, 0], exact, rtol=0, atol=1e-2)
    with pytest.raises(ValueError, match="method: given symplectic for driven; accepted: cvodes, dop853, or a model"):
        evolve(model, [0.0], None, times, "symplectic")


def test_a_stiff_model_is_followed() -> None:
    """x' = -1e6 (x - cos t): after a millionth of a unit of time the state is at cos t + 1e-6 sin t."""
    x, t = ca.SX.sym("x"), ca.SX.sym("t")
    model = OdeModel("stiff", x, -1e6 * (x - ca.cos(t)), time=t, forcing_period=2 * np.pi)
    run = evolve(model, [2.0], None, [1.0, 5.0], tolerance=1e-9)
    np.testing.assert_allclose(run.states[:, 0], np.cos(run.t) + 1e-6 * np.sin(run.t), rtol=0, atol=1e-8)
    assert run.evaluations < 20_000


# Errors ---------------------------------------------------------------------------------------------------------------


def test_arguments_that_do_not_fit_a_model_are_named() -> None:
    model = van_der_pol()
    for arguments, words in (
        (([1.0], None, [1.0]), r"positions: given shape \(1,\); accepted: shape \(2,\)"),
        (([1.0, np.nan], None, [1.0]), "positions: given a value that is not finite at y"),
        (([1.0, 0.0], [0.0], [1.0]), "velocities: given for van der Pol, of first order; accepted: None"),
    ):
        with pytest.raises(ValueError, match=words):
            evolve(model, *arguments)
    with pytest.raises(ValueError, match="parameters: given 'nu'"):
        evolve(model, [1.0, 0.0], None, [1.0], parameters={"nu": 1.0})
    with pytest.raises(ValueError, match=r"parameters: given .*; accepted: with an OdeModel alone"):
        evolve(Chain(2, 1.0, 0.0, 1.0), [1.0, 0.0], None, [1.0], parameters={"g": 1.0})
    with pytest.raises(TypeError, match="model: given 'chain'; accepted: a Chain or an OdeModel"):
        evolve("chain", [1.0], None, [1.0])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="sites: given an infinite chain; accepted for time evolution"):
        evolve(Chain(np.inf, 1.0, 0.2, 1.0), [1.0], None, [1.0])


def test_perturbations_of_a_state_of_first_order() -> None:
    cycle = orbit_of("cycle")
    start = cycle.evaluate(0.0)
    state, nothing = perturbed(cycle, 0.01, site=2)
    assert nothing.size == 0
    np.testing.assert_allclose(state - start, [0.0, 0.01], atol=1e-15)
    assert np.linalg.norm(perturbed(cycle, 0.01, seed=1)[0] - start) == pytest.approx(0.01)
    assert np.linalg.norm(perturbed(cycle, 0.01, vector=[3.0, -4.0])[0] - start) == pytest.approx(0.01)
    with pytest.raises(ValueError, match=r"vector: given shape \(3,\); accepted: shape \(2,\)$"):
        perturbed(cycle, 0.01, vector=[1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"site: given 3; accepted: 1\.\.2"):
        perturbed(cycle, 0.01, site=3)
