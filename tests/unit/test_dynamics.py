"""Time evolution: exact solutions, other integrators, conserved energy, symmetries, the paper's two kicks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from casadi_skin import (
    Chain,
    EvolutionError,
    Orbit,
    distance_from_orbit,
    evolve,
    follow_family,
    perturbed,
    simulate_orbit,
)
from casadi_skin.dynamics.evolution import LONGEST_ENVELOPE
from casadi_skin.lattice.closed_forms import Array, duffing_displacement
from casadi_skin.model.methods import INTEGRATORS
from casadi_skin.runs import rules as task_checks

KICK = 0.005  # the paper's delta
METHODS = tuple(INTEGRATORS)


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    """The paper's stable breather: j = 1, g = -1, S = 0.2."""
    chain = Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    return follow_family(chain, mode=1, amplitude_max=0.2, at=[0.2], tolerance=1e-12).at(0.2)


def random_start(sites: int, size: float = 0.5) -> tuple[Array, Array]:
    generator = np.random.default_rng(7)
    return size * generator.normal(size=sites), size * generator.normal(size=sites)


def physical_matrix(chain: Chain) -> Array:
    """D of y'' = -D y, written out from the paper's equation of motion."""
    below = np.diag(np.full(chain.sites - 1, 1.0 + chain.gamma), -1)
    above = np.diag(np.full(chain.sites - 1, 1.0 - chain.gamma), 1)
    return np.asarray((2.0 + chain.alpha) * np.eye(chain.sites) - below - above)


# Exact solutions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("g", "amplitude"), [(1.0, 2.0), (-1.0, 1.2), (-1, 0.3)])
def test_one_site_is_duffing(method: str, g: float, amplitude: float) -> None:
    t = np.linspace(0.0, 30.0, 301)
    found = evolve(Chain(1, 1.0, 0.0, g), [amplitude], None, t, method, 1e-12)
    exact = duffing_displacement(3.0, g, amplitude, t)
    np.testing.assert_allclose(found.displacements[:, 0], exact, rtol=0, atol=2e-10)
    speed = np.sqrt(np.maximum(0.0, 2.0 * (found.energy[0] - 1.5 * exact**2 - g * exact**4 / 4)))
    np.testing.assert_allclose(np.abs(found.velocities[:, 0]), speed, rtol=0, atol=5e-5)  # a root near turning points


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("gamma", "g", "size"), [(0.4, 0.0, 1.0), (-0.25, -1.0, 1e-6), (0.0, 1.0, 1e-6)])
def test_small_displacements_move_as_the_matrix_exponential(method: str, gamma: float, g: float, size: float) -> None:
    chain = Chain(6, 0.7, gamma, g)
    y, v = random_start(6, size)
    t = np.array([0.0, 0.3, 1.7, 12.0, 25.0])
    found = evolve(chain, y, v, t, method, 1e-12)
    flow = np.block([[np.zeros((6, 6)), np.eye(6)], [-physical_matrix(chain), np.zeros((6, 6))]])
    exact = np.array([expm(time * flow) @ np.concatenate([y, v]) for time in t])
    largest = np.abs(exact).max()
    np.testing.assert_allclose(found.displacements, exact[:, :6], rtol=0, atol=1e-10 * largest)
    np.testing.assert_allclose(found.velocities, exact[:, 6:], rtol=0, atol=1e-10 * largest)


@pytest.mark.parametrize("method", METHODS)
def test_an_orbit_returns_to_itself(method: str, orbit: Orbit) -> None:
    t = np.linspace(0.0, orbit.period, 41)
    found = simulate_orbit(orbit, t, method=method, tolerance=1e-12)
    np.testing.assert_allclose(found.displacements, orbit.evaluate(t), rtol=0, atol=5e-12)
    np.testing.assert_allclose(found.velocities[-1], 0.0, rtol=0, atol=5e-12)
    assert found.energy == pytest.approx(orbit.energy, rel=1e-11)
    assert distance_from_orbit(orbit, found).max() < 2e-11
    assert found.status.startswith(f"{method} in gauge coordinates, tolerance 1e-12")
    assert "energy kept to" in found.status


# Methods against each other -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fine(orbit: Orbit) -> Array:
    """Gauge displacements after a kick at the left end, by a tiny fixed step, with the times in the first column."""
    t = np.linspace(0.0, 40.0, 201)
    positions, velocities = perturbed(orbit, KICK, site=1)
    run = evolve(orbit.model, positions, velocities, t, "symplectic", step=0.0125)
    return np.column_stack([t, run.displacements / orbit.model.rho])


@pytest.mark.parametrize("method", METHODS)
def test_errors_are_proportional_to_the_tolerance(method: str, orbit: Orbit, fine: Array) -> None:
    tolerances = 10.0 ** -np.arange(6, 13)
    errors = []
    for tolerance in tolerances:
        found = simulate_orbit(orbit, fine[:, 0], KICK, site=1, method=method, tolerance=tolerance)
        errors.append(np.abs(found.displacements / orbit.model.rho - fine[:, 1:]).max() / np.abs(fine[:, 1:]).max())
    ratios = np.array(errors) / tolerances
    assert np.all(ratios < (2.5 if method == "cvodes" else 30.0))
    assert np.all(ratios > 0.02)
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.75 < slope < 1.1


def test_samples_do_not_disturb_the_symplectic_trajectory() -> None:
    chain, (y, v) = Chain(5, 1.0, 0.3, 1.0), random_start(5)
    alone = evolve(chain, y, v, [20.0], "symplectic", step=0.13)
    among = evolve(chain, y, v, np.append(np.linspace(0.0, 19.99, 777), 20.0), "symplectic", step=0.13)
    np.testing.assert_array_equal(alone.displacements[0], among.displacements[-1])
    other = evolve(chain, y, v, among.t, "dop853", 1e-12)
    np.testing.assert_allclose(among.displacements, other.displacements, rtol=0, atol=5e-6)


def test_the_step_of_the_symplectic_method_follows_growing_amplitudes() -> None:
    """A kick from the far end stiffens a hardening chain when it arrives: a step fit for the start is then too long."""
    chain = Chain(24, 1.0, 0.25, 1.0)
    start = np.zeros(24)
    start[0] = 0.05
    t = np.linspace(0.0, 60.0, 121)
    runs = [evolve(chain, start, None, t, method, 1e-10).displacements for method in ("symplectic", "dop853")]
    assert np.abs(runs[0][:, -1]).max() > 1.0
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=2e-6)


@pytest.mark.parametrize("method", METHODS)
def test_physical_and_gauge_coordinates_agree(method: str, orbit: Orbit) -> None:
    t, kick = np.linspace(0.0, 40.0, 81), {"site": 1, "method": method, "tolerance": 1e-12}
    one, other = (simulate_orbit(orbit, t, KICK, **kick, coordinates=name) for name in ("gauge", "physical"))
    np.testing.assert_allclose(one.displacements, other.displacements, rtol=0, atol=5e-9)
    np.testing.assert_allclose(one.velocities, other.velocities, rtol=0, atol=5e-9)


# Symmetries and energy ----------------------------------------------------------------------------------------------


def test_energy_that_is_not_kept_shows() -> None:
    chain, (y, v) = Chain(5, 1.0, 0.3, 1.0), random_start(5)
    t = np.linspace(0.0, 50.0, 101)
    crude, good = (np.abs(evolve(chain, y, v, t, "dop853", tol).energy_drift).max() for tol in (1e-4, 1e-11))
    assert crude > 1e-4
    assert good < 1e-9
    assert evolve(chain, np.zeros(5), None, t).energy_drift == pytest.approx(0.0)


@pytest.mark.slow
def test_over_ten_thousand_periods_the_symplectic_method_alone_does_not_drift(orbit: Orbit) -> None:
    t = np.linspace(0.0, 10_000 * orbit.period, 3931)  # no small multiple of the period between two samples
    slopes, spreads, ends = {}, {}, {}
    for method in ("symplectic", "dop853", "cvodes"):
        run = simulate_orbit(orbit, t, method=method, tolerance=1e-11)
        drift = run.energy_drift
        slopes[method], offset = np.polyfit(t / t[-1], drift, 1)
        spreads[method] = np.ptp(drift - slopes[method] * t / t[-1] - offset)
        ends[method] = distance_from_orbit(orbit, run).max()
    assert spreads["symplectic"] < 1e-10
    assert abs(slopes["symplectic"]) < 0.02 * spreads["symplectic"]
    assert slopes["dop853"] < -1e-9
    assert abs(slopes["dop853"]) > 50 * spreads["dop853"]
    assert abs(slopes["cvodes"]) > 50 * abs(slopes["symplectic"])
    assert ends["symplectic"] < 1e-9


# The paper's kicks --------------------------------------------------------------------------------------------------


def test_a_kick_is_kept_small_at_the_favoured_end_and_amplified_from_the_other(orbit: Orbit) -> None:
    t = np.linspace(0.0, 40.0, 401)
    right, left = (distance_from_orbit(orbit, simulate_orbit(orbit, t, KICK, site=site)) for site in (24, 1))
    kick = KICK / np.sqrt(orbit.S)
    assert left[0] == pytest.approx(kick, rel=1e-3)
    assert right[0] == pytest.approx(kick, rel=1e-2)
    assert right.max() < 2.0 * kick
    assert left.max() > 200.0 * kick
    assert left.max() > 1.0  # farther from the breather than the breather is from rest


def test_perturbations_have_the_size_asked_for(orbit: Orbit) -> None:
    for positions, velocities in (
        perturbed(orbit, 0.01, site=3),
        perturbed(orbit, 0.01, vector=np.arange(24.0) * 1e200),
        perturbed(orbit, 0.01, vector=np.arange(48.0)),
        perturbed(orbit, 0.01, seed=5),
    ):
        change = np.concatenate([positions - orbit.profile, velocities])
        assert np.linalg.norm(change) == pytest.approx(0.01, rel=1e-12)
    assert perturbed(orbit, 0.01, vector=np.arange(48.0))[1][-1] > 0
    np.testing.assert_array_equal(perturbed(orbit, 0.01, seed=5)[0], perturbed(orbit, 0.01, seed=5)[0])
    assert np.any(perturbed(orbit, 0.01, seed=5)[0] != perturbed(orbit, 0.01, seed=6)[0])
    assert perturbed(orbit, 0.01, site=3)[0][2] == pytest.approx(orbit.profile[2] + 0.01, abs=1e-16)


# The exceptional point ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [pytest.param(m, marks=pytest.mark.slow) if m != "cvodes" else m for m in METHODS])
def test_at_gamma_one_other_sites_move_in_physical_coordinates_only(method: str) -> None:
    chain, start, t = Chain(3, 1.0, -1.0, 1.0), [0.1, 0.4, -0.3], np.linspace(0.0, 10.0, 21)
    with pytest.raises(ValueError, match=r'no image in the gauge; accepted: zero there, or coordinates = "physical"'):
        evolve(chain, start, None, t, method)
    found = evolve(chain, start, None, t, method, coordinates="physical")

    def equations(_: float, x: Array) -> Array:
        y, v = x[:3], x[3:]
        return np.concatenate([v, -3 * y + 2 * np.append(y[1:], 0.0) - y**3])  # each site hears its right neighbour

    expected = solve_ivp(equations, (0.0, 10.0), [*start, 0, 0, 0], "Radau", t, rtol=1e-9, atol=1e-10).y[:3].T
    np.testing.assert_allclose(found.displacements, expected, rtol=0, atol=2e-6)
    assert "energy" not in found.status
    with pytest.raises(ValueError, match="energy: at y_2"):
        _ = found.energy


# Errors -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_an_escape_is_named_and_what_was_computed_is_kept(method: str) -> None:
    t = np.linspace(0.0, 10.0, 201)
    with pytest.raises(EvolutionError) as caught:
        evolve(Chain(1, 1.0, 0.0, -1.0), [2.5], None, t, method)
    message, kept = str(caught.value), caught.value.evolution
    assert message.startswith(f"{method}: the state was followed to t = ")
    assert "leaves the well" in message
    assert message.count("\n") == 0
    assert 0.7 < kept.t[-1] < 0.88  # it is at infinity at t = 0.8799, by quadrature
    assert np.abs(kept.energy_drift).max() < 1e-9
    with pytest.raises(EvolutionError) as caught:
        evolve(Chain(1, 1.0, 0.0, -1.0), [2.5], None, [1e4], method)
    assert caught.value.evolution is None


def test_a_state_that_escapes_is_refused_soon_and_not_after_all_steps() -> None:
    """At infinity at t = 0.8799, by quadrature, of 1e7 steps to t = 1e5; and with a step that is too long."""
    with pytest.raises(EvolutionError, match=r"symplectic: the state was followed to t = .* it is not finite then"):
        evolve(Chain(3, 1.0, 0.2, 1.0), [0.5, 0.1, 0.3], None, [100.0], "symplectic", step=3.0)
    with pytest.raises(EvolutionError, match="it is not finite then") as caught:
        evolve(Chain(1, 1.0, 0.0, -1.0), [2.5], None, [0.0, 0.5, 1e5], "symplectic", step=0.01)
    kept = caught.value.evolution
    assert list(kept.t) == [0.0, 0.5]
    assert kept.evaluations < 1e5


GOOD = {"positions": [0.1, 0.2, 0.3], "velocities": [0.0, 0.0, 0.1], "t": [0.0, 1.0]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": [0.1, 0.2]}, r"positions: given shape \(2,\); accepted: shape \(3,\)"),
        ({"velocities": [[0.1, 0.2, 0.0]]}, r"velocities: given shape \(1, 3\)"),
        ({"positions": [0.1, np.nan, 0.3]}, "positions: given a value that is not finite at y_2"),
        ({"t": [0.0, np.nan]}, "t: given times that are not finite, not ascending or negative"),
        ({"t": [0.0, 0.0]}, "t: given times that are not finite"),
        ({"t": []}, r"t: given shape \(0,\)"),
        ({"t": [1e12]}, r"t: given up to 1e\+12, which is .* radians of the fastest vibration"),
        ({"positions": [1e100, 0.0, 0.0]}, "t: given up to 1, which is .* radians"),
        ({"method": "rk4"}, "method: given 'rk4'; accepted: cvodes, dop853, symplectic"),
        ({"coordinates": "polar"}, "coordinates: given 'polar'; accepted: gauge, physical"),
        ({"tolerance": 0.0}, "tolerance: given 0.0; accepted: 1e-13 to 1e-2"),
        ({"step": 0.1}, "step: given 0.1 with cvodes; accepted: with symplectic"),
        ({"step": -0.1, "method": "symplectic"}, "step: given -0.1; accepted: a finite number > 0"),
    ],
)
def test_wrong_arguments_are_named_in_one_line(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        evolve(Chain(3, 1.0, 0.2, 1.0), **(GOOD | changes))  # type: ignore[arg-type]
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "perturbation: given none; accepted: one of site, vector, seed"),
        ({"site": 1, "seed": 1}, "perturbation: given site and seed; accepted: one of"),
        ({"site": 0}, r"site: given 0; accepted: 1\.\.24"),
        ({"site": 1.5}, r"site: given 1\.5"),
        ({"vector": np.ones(23)}, r"vector: given shape \(23,\); accepted: shape \(24,\) or \(48,\)"),
        ({"vector": np.zeros(24)}, "vector: given zeros"),
        ({"seed": 1, "size": np.nan}, "size: given nan; accepted: a finite number"),
    ],
)
def test_wrong_perturbations_are_named_in_one_line(arguments: dict[str, object], message: str, orbit: Orbit) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        perturbed(orbit, **({"size": 0.1} | arguments))  # type: ignore[arg-type]
    assert str(caught.value).isprintable()


def test_a_far_end_below_the_smallest_double_is_refused() -> None:
    assert LONGEST_ENVELOPE == task_checks.LONGEST_ENVELOPE
    with pytest.raises(ValueError, match=r"positions span exp\(-866.4\); accepted: down to exp\(-700\)"):
        evolve(Chain(1000, 1.0, 0.7, -1.0), np.zeros(1000), None, [1.0])
