"""Any quantity of the table along a branch, and solutions at any of its values, against closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from small_models import circles, van_der_pol, wave

from casadi_skin import BoundaryValueProblem, Branch, OdeModel, find_equilibrium, find_orbit, follow_family
from casadi_skin.results.quantities import extremes


def hardening() -> Branch:
    """Free oscillations of y'' = -y - y^3: the energy is S/2 + S^2/4 with S = y(0)^2."""
    y, v = symbols("y v")
    energy = v**2 / 2 + y**2 / 2 + y**4 / 4
    model = OdeModel(
        "hardening", y, -y - y**3, order=2, velocity=v, reversal=(1, -1), half_period=(-1, -1), hamiltonian=energy
    )
    return follow_family(model, mode=1, amplitude_max=2.0, tolerance=1e-10)


@pytest.mark.parametrize("shift", [0.0, 1e-3, -2e-3])
def test_an_extreme_beside_the_end_of_the_period_is_as_accurate_as_others(shift: float) -> None:
    """The smallest x of van der Pol's orbit is minus the largest one, wherever the period begins."""
    model, orbit = van_der_pol(), find_orbit(van_der_pol(), lambda t: [2 * np.cos(t), -2 * np.sin(t)], 6.6)
    lowest = orbit.period * np.argmin(orbit.evaluate(np.linspace(0.0, orbit.period, 2001))[:, 0]) / 2000
    moved = find_orbit(model, lambda t: orbit.evaluate((t + lowest + shift) % orbit.period), orbit.period)
    low, high = extremes(moved)
    assert abs(low[0] + high[0]) < 1e-8


def test_a_family_is_found_at_an_energy() -> None:
    branch = hardening()
    np.testing.assert_allclose(branch["energy"], branch.S / 2 + branch.S**2 / 4, rtol=1e-9)
    np.testing.assert_array_equal(branch["Omega"], branch.Omega)
    np.testing.assert_array_equal(branch["period"], branch.period)
    assert branch["profile"].shape == (len(branch), 1)
    for energy in (1e-5, 0.3, 1.5):
        orbit = branch.at(energy=energy)
        assert orbit.energy == pytest.approx(energy, rel=1e-11)
        np.testing.assert_allclose(orbit.S, np.sqrt(1 + 4 * energy) - 1, rtol=1e-9)
    assert branch.at(energy=float(branch["energy"][5])) is branch.solutions[5]


def test_orbits_are_found_at_any_number_of_their_table() -> None:
    mu = ca.SX.sym("mu")
    branch = circles(mu, mu, 0.25).follow("mu", 0.75)
    np.testing.assert_allclose(branch["Omega"], 1 + branch["mu"], rtol=1e-9)
    np.testing.assert_allclose(branch["period"], 2 * np.pi / (1 + branch["mu"]), rtol=1e-9)
    np.testing.assert_allclose(branch["x_max"], np.sqrt(branch["mu"]), rtol=1e-8)
    assert branch.at(x_max=0.8).parameters["mu"] == pytest.approx(0.64, rel=1e-8)
    assert branch.at(y_min=-0.7).parameters["mu"] == pytest.approx(0.49, rel=1e-8)
    assert branch.at(Omega=1.5).parameters["mu"] == pytest.approx(0.5, rel=1e-9)


@pytest.mark.parametrize("at", [(), (-0.0007,)])
def test_an_orbit_is_found_where_an_extremum_between_two_points_reaches_the_value(at: tuple[float, ...]) -> None:
    """Also where one of them is beside the extremum."""
    mu = ca.SX.sym("mu")
    branch = circles(1 - mu**2, mu, -0.5).follow("mu", 0.75, at=at)
    height = 0.5 * (1 + float(np.max(branch["x_max"])))  # beyond all points, below the largest radius, 1
    assert np.max(branch["x_max"]) < height < 1.0
    found = [branch.at(x_max=height, which=which).parameters["mu"] for which in (0, 1)]
    np.testing.assert_allclose(found, np.sqrt(1 - height**2) * np.array([-1, 1]), rtol=1e-3)
    with pytest.raises(ValueError, match=r"which = 2; the branch covers .* and passes x_max 2 times"):
        branch.at(x_max=height, which=2)
    with pytest.raises(ValueError, match="passes x_max 0 times"):
        branch.at(x_max=1.0 + 1e-6)


def test_the_period_of_forced_orbits_is_a_quantity() -> None:
    x, w, t = symbols("x w t")
    model = OdeModel("relaxing", x, -x + ca.cos(w * t), w, time=t, forcing_period=2 * ca.pi / w)
    branch = find_orbit(model, lambda t: [0.0], parameters={"w": 1.0}).follow("w", 3.0)
    np.testing.assert_allclose(branch["period"], 2 * np.pi / branch["w"], rtol=1e-12)
    np.testing.assert_allclose(branch["Omega"], branch["w"], rtol=1e-12)
    assert branch.at(period=4.0).parameters["w"] == pytest.approx(np.pi / 2, rel=1e-11)
    assert branch.at(x_max=0.5).parameters["w"] == pytest.approx(np.sqrt(3), rel=1e-7)


def test_a_parameter_that_is_called_like_a_quantity_stays_that_parameter() -> None:
    x, Omega, t = symbols("x Omega t")
    model = OdeModel("relaxing", x, -x + ca.cos(2 * Omega * t), Omega, time=t, forcing_period=ca.pi / Omega)
    branch = find_orbit(model, lambda t: [0.0], parameters={"Omega": 1.0}).follow("Omega", 2.0)
    assert branch["Omega"][0] == 1.0
    assert branch.orbits[0].Omega == pytest.approx(2.0)
    assert branch.at(Omega=1.5).parameters["Omega"] == 1.5


def test_equilibria_are_found_at_a_state_on_both_sides_of_its_extremum() -> None:
    branch = wave()
    np.testing.assert_allclose(branch["y"], np.sin(3 * branch["p"]), atol=1e-10)
    assert branch.at(x=0.3).parameters["p"] == pytest.approx(0.3, rel=1e-10)
    for value in (0.5, 0.99999):
        first, second = (branch.at(y=value, which=which).parameters["p"] for which in (0, 1))
        assert first == pytest.approx(np.arcsin(value) / 3, abs=1e-8)
        assert second == pytest.approx((np.pi - np.arcsin(value)) / 3, abs=1e-8)


def test_solutions_of_a_boundary_value_problem_are_found_at_a_state_beyond_a_fold() -> None:
    x, a = symbols("x a")
    model = OdeModel("cubic", x, ca.SX(0.0), a)
    start = model.start(x)
    problem = BoundaryValueProblem(model, [start**3 - 3 * start - a], parameters={"a": -4.0})
    branch = problem.solve([-2.2], tolerance=1e-10).follow("a", 4.0)
    for value in (-1.5, 0.0, 0.7, 1.9):
        assert branch.at(x_max=value).parameters["a"] == pytest.approx(value**3 - 3 * value, abs=1e-8)


def test_a_curve_in_two_parameters_is_found_at_the_free_one() -> None:
    """Folds of x' = p + q x - x^3: q = 3 x^2, p = -2 x^3."""
    x, p, q = symbols("x p q")
    model = OdeModel("cusp", x, p + q * x - x**3, ca.vertcat(p, q))
    branch = find_equilibrium(model, [-2.0], parameters={"p": -4.0, "q": 1.0}).follow("p", 4.0)
    fold = next(point for point in branch.special_points if point.kind == "fold")
    curve = fold.curve("q", 3.0)
    sign = np.sign(fold.parameters["p"])
    assert curve.at(p=sign * 1.0).parameters["q"] == pytest.approx(3 * 0.5 ** (2 / 3), rel=1e-8)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"energi": 0.3}, "at: given energi; did you mean energy. accepted: S, Omega, period"),
        ({"requested": 1.0}, "at: given requested; accepted: S, Omega, period, .*energy"),
        ({"energy": 0.3, "S": 1.0}, "at: given S and energy; accepted: one of S, Omega, period, or another quantity"),
        ({"energy": 0.3, "which": 1}, "passes energy 1 times"),
    ],
)
def test_other_names_are_refused_in_one_line(given: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        hardening().at(**given)  # type: ignore[arg-type]
    assert "\n" not in str(refusal.value)


def test_a_name_that_no_quantity_has_is_refused_with_all_that_there_are() -> None:
    with pytest.raises(KeyError, match=r"speed; known: p, point, requested, special, x, y, stable, .*max_growth"):
        _ = wave()["speed"]
