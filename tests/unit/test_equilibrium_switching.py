"""What leaves at special points: cycles at Hopf points, other branches at branch points; where orbits shrink away."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import ab, abc, hopf_pairs, lorenz, rosenzweig_macarthur, symbols

from casadi_skin import OdeModel, find_equilibrium, find_orbit
from casadi_skin.zero.settings import End


def test_cycles_of_the_normal_form_have_the_radius_in_closed_form_from_zero_on() -> None:
    p = ca.SX.sym("p")
    branch = find_equilibrium(hopf_pairs([p], p, [1.7]), [0, 0], parameters={"p": -1.0}).follow("p", 1.0)
    (hopf,) = branch.special_points
    cycles = hopf.follow("p", 0.5, stability=True)
    assert cycles.complete
    assert np.ptp(cycles.orbits[0].states) == 0.0
    for orbit in cycles.orbits[1:]:
        radius = np.sqrt(orbit.parameters["p"])
        np.testing.assert_allclose(np.linalg.norm(orbit.states, axis=1), radius, rtol=1e-6)
        assert abs(orbit.period - 2.0 * np.pi / 1.7) < 1e-7
        exact = np.exp(-2.0 * orbit.parameters["p"] * orbit.period)
        assert abs(orbit.floquet().others[0] - exact) < 1e-6


def test_cycles_grow_as_the_first_lyapunov_coefficient_says() -> None:
    """|z|^2 = -growth' (p - p0)/(omega l1), x = x0 + 2 Re(z q): from the eigenvalues, not from the orbits."""
    branch = find_equilibrium(ab(), [0, 0]).follow("p", 0.25)
    hopf = branch.special_points[2]
    h, p0 = 1e-5, hopf.parameters["p"]
    growth = [branch.at(p=p0 + sign * h).eigenvalues[0].real for sign in (1, -1)]
    rate = (growth[0] - growth[1]) / (2 * h)
    cycles = hopf.follow("p", 0.13)
    assert cycles.orbits[0].period == pytest.approx(2.0 * np.pi / hopf.frequency, rel=1e-12)
    orbit = cycles.at(p=p0 - 2e-6)
    size = np.sqrt(-rate * -2e-6 / (hopf.frequency * hopf.coefficient))
    low, high = np.min(orbit.evaluate(np.linspace(0, orbit.period, 400)), 0), np.max(orbit.states, 0)
    np.testing.assert_allclose(high - low, 4.0 * size * np.abs(hopf.vector), rtol=2e-3)


@pytest.mark.slow
def test_cycles_of_abc_end_at_the_hopf_points_of_auto_by_name() -> None:
    """AUTO-07p's demo `abc`: Hopf points at 0.204185, 0.229839, 0.259958; a branch with a fold joins the last two."""
    points = find_equilibrium(abc(), [0, 0, 0]).follow("p1", 0.4).special_points
    np.testing.assert_allclose([p.parameters["p1"] for p in points[:3]], [0.204185, 0.229839, 0.259958], atol=6e-7)
    cycles = points[1].follow("p1", 0.4)
    assert [point.kind for point in cycles.special_points] == ["fold", "hopf"]
    end = cycles.special_points[-1]
    assert abs(end.parameters["p1"] - points[2].parameters["p1"]) <= end.error + points[2].error
    assert end.criticality == points[2].criticality == "subcritical"
    assert cycles.reason == "the cycle shrinks to an equilibrium at a Hopf point"
    assert not cycles.complete


def test_a_cycle_that_shrinks_is_followed_to_its_hopf_point_and_not_back() -> None:
    """Rosenzweig and MacArthur: K = 3 in closed form, where prey is at 1, and no fold."""
    orbit = find_orbit(rosenzweig_macarthur(), _simulated(rosenzweig_macarthur(), {"K": 3.4}), parameters={"K": 3.4})
    branch = orbit.follow("K", 2.0)
    assert [point.kind for point in branch.special_points] == ["hopf"]
    (end,) = branch.special_points
    assert abs(end.parameters["K"] - 3.0) <= max(end.error, 1e-12)
    np.testing.assert_allclose(branch.orbits[-1].evaluate(0.0), [1.0, 4.0 / 3.0], rtol=1e-10)
    assert np.all(np.diff(branch["K"]) < 0.0)


def _simulated(model: OdeModel, parameters: dict[str, float]) -> object:
    from casadi_skin import simulate

    evolution = simulate(model, [0.5, 1.0], np.linspace(0.0, 400.0, 4001), parameters=parameters)
    return evolution.last_cycle()


def test_the_subcritical_cycles_of_lorenz_are_unstable() -> None:
    (hopf,) = find_equilibrium(lorenz(), [6, 6, 13], parameters={"r": 14.0}).follow("r", 30.0).special_points
    cycles = hopf.follow("r", 20.0, stability=True)
    assert cycles.complete
    assert not any(cycles.stable[1:])


def test_the_other_branches_of_a_pitchfork_are_found_on_both_sides() -> None:
    (point,) = find_equilibrium(lorenz(), [0, 0, 0], parameters={"r": 0.5}).follow("r", 2.0).special_points
    for side in (1, -1):
        other = point.follow("r", 20.0, side=side, at=[10.0])
        x = side * np.sqrt(8.0 / 3.0 * 9.0)
        np.testing.assert_allclose(other.at(r=10.0).state, [x, x, 9.0], rtol=1e-10)
        assert other.special_points == ()
        assert other.complete
    with pytest.raises(ValueError, match=r"to: given 0\.5; accepted: a value above 1, to which the other branch goes"):
        point.follow("r", 0.5)


def test_the_other_branch_of_a_transcritical_point_goes_both_ways() -> None:
    x, p = symbols("x p")
    model = OdeModel("crossing", x, p * x - x**2, p)
    (point,) = find_equilibrium(model, [0.0], parameters={"p": -1.0}).follow("p", 1.0).special_points
    for to in (0.7, -0.7):
        other = point.follow("p", to)
        assert other.solutions[-1].state[0] == pytest.approx(to, rel=1e-12)
        assert bool(other.solutions[-1].stable) == (to > 0.0)


@pytest.mark.parametrize("shift", [0.0, 1.0])
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_a_species_enters_where_it_and_its_predator_are_zero_but_for_rounding(unit: float, shift: float) -> None:
    """AUTO-07p's demo `pp3`: y enters at p = 3/4, with x = 1 - 4 y and p = y (15/4 - 16 y)/(1 - exp(-5 y)).

    Also with y in other units, or beside another zero; derivatives that are products with y are rounding at y = 0.
    """
    x, w, z, p = symbols("x w z p")
    y = w / unit - shift
    eaten = -0.25 * y + 4 * x * y - 3 * y * z - p * (1 - ca.exp(-5 * y))
    rates = ca.vertcat(x * (1 - x) - 4 * x * y, unit * eaten, -0.5 * z + 3 * y * z)
    model = OdeModel("pp3", ca.vertcat(x, w, z), rates, p)
    (point,) = find_equilibrium(model, [1, unit * shift, 0], parameters={"p": 0.0}).follow("p", 1.0).special_points
    assert point.kind == "branch point"
    assert abs(point.parameters["p"] - 0.75) <= point.error < 2e-9
    branch = point.follow("p", 0.7, side=1)
    entered = branch["w"][1:] / unit - shift
    assert np.ptp(entered) > 1e-3
    np.testing.assert_allclose(branch["x"][1:], 1 - 4 * entered, atol=1e-9)
    np.testing.assert_allclose(branch["p"][1:], entered * (3.75 - 16 * entered) / -np.expm1(-5 * entered), atol=1e-8)


@pytest.mark.slow
def test_a_branch_point_of_a_large_model_is_left_along_its_null_vector() -> None:
    """Chafee and Infante: u'' + p (u - u^3) = 0 on (0, pi) on 150 points leaves zero at 4 sin^2(k h/2)/h^2."""
    n = 150
    u, p = ca.SX.sym("u", n), ca.SX.sym("p")
    h = np.pi / (n + 1)
    around = ca.vertcat(0, u, 0)
    model = OdeModel("Chafee-Infante", u, (around[2:] - 2 * u + around[:-2]) / h**2 + p * (u - u**3), p)
    points = find_equilibrium(model, np.zeros(n), parameters={"p": 0.5}).follow("p", 10.0).special_points
    exact = (2.0 * np.sin(0.5 * h * np.arange(1, 4)) / h) ** 2
    np.testing.assert_allclose([point.parameters["p"] for point in points], exact, rtol=1e-9)
    other = points[1].follow("p", 6.0)
    profile = other.solutions[-1].state
    assert np.sum(np.diff(np.sign(profile)) != 0) == 1
    np.testing.assert_allclose(profile, -profile[::-1], atol=1e-9)
    assert other.solutions[-1].unstable == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("q", 1.0), "parameter: given 'q'"),
        (("r", 1.0), r"to: given \S+, where the branch starts"),
        (("r", 2.0, 3), "side: given 3; accepted: 1 or -1"),
    ],
)
def test_switching_is_refused_in_one_line(arguments: tuple, words: str) -> None:
    (point,) = find_equilibrium(lorenz(), [0, 0, 0], parameters={"r": 0.5}).follow("r", 2.0).special_points
    name, to, *side = arguments
    to = point.parameters["r"] if to == 1.0 else to
    with pytest.raises(ValueError, match=words):
        point.follow(name, to, **({"side": side[0]} if side else {}))


def test_nothing_leaves_at_a_fold() -> None:
    fold = find_equilibrium(ab(), [0, 0]).follow("p", 0.25).special_points[0]
    with pytest.raises(ValueError, match="follow: given a fold of equilibria; accepted: a Hopf point"):
        fold.follow("p", 0.2)


@pytest.mark.slow
def test_the_equilibria_to_which_orbits_shrink_are_followed_from_there() -> None:
    """x'' = (p - x'^2) x' - x + p in first order: cycles about x = p, born at p = 0."""
    x, v, p = symbols("x v p")
    model = OdeModel("Rayleigh", ca.vertcat(x, v), ca.vertcat(v, (p - v**2) * v - x + p), p)
    guess = lambda t: np.stack([1.0 + np.cos(t), -np.sin(t)], axis=-1)  # noqa: E731
    cycles = find_orbit(model, guess, 2.0 * np.pi, parameters={"p": 0.75}).follow("p", -1.0)
    end = cycles.special_points[-1]
    assert (end.kind, cycles.end) == ("hopf", End.HOPF)
    assert abs(end.parameters["p"]) <= end.error + 1e-15
    rest = end.follow("p", -0.5, at=[-0.25])
    assert rest.complete
    np.testing.assert_allclose([solution.state for solution in rest], np.outer(rest["p"], [1.0, 0.0]), atol=1e-12)
    assert all(solution.stable for solution in rest.solutions[1:])
