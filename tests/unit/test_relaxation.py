"""Branches of orbits with layers that move: canards, relaxation oscillations, orbits that come to a saddle-focus."""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from scipy.integrate import solve_ivp
from small_models import oscillation

from casadi_skin import OdeModel, find_equilibrium
from casadi_skin.follow import moving
from casadi_skin.follow.branch import Branch, End


def from_hopf(branch: Branch, place: int, parameter: str, to: float, **options: object) -> Branch:
    """The orbits that leave at one of the Hopf points of a branch of equilibria."""
    points = [point for point in branch.special_points if point.kind == "hopf"]
    return points[place].follow(parameter, to, **options)


def test_steps_turn_further_where_layers_do() -> None:
    """By the angle between tangents alone there were 76 points, and 44 where meshes move from a ratio of 20 on."""
    branch = oscillation().follow("mu", 20.0)
    assert branch.end is End.REACHED
    assert len(branch) <= 24


@pytest.mark.slow
def test_relaxation_oscillations_of_van_der_pol_are_followed_to_stiffness_one_million() -> None:
    """The period by Dorodnitsyn's expansion (1947), whose next terms are of order log(mu)/mu."""
    branch = oscillation().follow("mu", 1000.0)
    assert branch.end is End.REACHED
    assert len(branch) <= 120
    expected = (3.0 - 2.0 * np.log(2.0)) * 1000.0 + 3.0 * 2.338107 * 1000.0 ** (-1.0 / 3.0)
    np.testing.assert_allclose(branch.solutions[-1].period, expected, rtol=1e-5)


@pytest.mark.slow
def test_bursts_of_hindmarsh_and_rose_are_followed_through_their_canard() -> None:
    """Where orbits near a saddle amplify rounding the mesh had been placed by it, and no level was fine enough."""
    x, y, z, current = symbols("x y z I")
    rates = ca.vertcat(y - x**3 + 3 * x**2 - z + current, 1 - 5 * x**2 - y, 0.006 * (4 * (x + 1.6) - z))
    model = OdeModel("neuron", ca.vertcat(x, y, z), rates, current)
    branch = from_hopf(find_equilibrium(model, [-1.5, -10.0, 0.0], parameters={"I": 0.0}).follow("I", 4.0), 0, "I", 2.1)
    assert branch.end is End.REACHED
    folds = [round(point.parameters["I"], 8) for point in branch.special_points]
    assert folds == [1.29995141, 1.56228159, 1.55284896]  # as steps on meshes at rest have them, with 990 points
    assert len(branch) <= 230
    assert max(solution.error for solution in branch.solutions) < 1e-8
    assert max(solution.point.problem.resolution for solution in branch.solutions) <= 450


@pytest.mark.slow
def test_the_multiplier_of_a_burst_that_passes_zero_ends_at_a_period_doubling() -> None:
    """Beside the fold of the canard it goes from 1 to -12 within a step: its sign outside the circle says the kind."""
    x, y, z, current = symbols("x y z I")
    rates = ca.vertcat(y - x**3 + 3 * x**2 - z + current, 1 - 5 * x**2 - y, 0.006 * (4 * (x + 1.6) - z))
    model = OdeModel("neuron", ca.vertcat(x, y, z), rates, current)
    rest = find_equilibrium(model, [-1.5, -10.0, 0.0], parameters={"I": 0.0}).follow("I", 4.0)
    branch = from_hopf(rest, 0, "I", 1.6, stability=True, max_points=180)
    kinds = [(point.kind, round(point.parameters["I"], 8)) for point in branch.special_points]
    assert kinds[:2] == [("fold", 1.29995141), ("period doubling", 1.29995141)]
    for point, expected in zip(branch.special_points, (1.0, -1.0), strict=False):
        others = point.solution.floquet().others
        np.testing.assert_allclose(others[np.argmax(np.abs(others))], expected, rtol=1e-6)


@pytest.mark.slow
def test_tiny_multipliers_along_a_canard_are_those_of_the_divergence_within_their_errors() -> None:
    """From e^-30 to e^-480, where maps that stretch by 1e17 have lost them and the sign of their determinant."""
    x, y, a = symbols("x y a")
    model = OdeModel("canard", ca.vertcat(x, y), ca.vertcat((y - x**3 / 3 + x) / 0.01, a - x), a)
    rest = find_equilibrium(model, [1.1, -0.6], parameters={"a": 1.1}).follow("a", 0.9)
    branch = from_hopf(rest, 0, "a", 0.5, stability=True)
    assert not branch.unresolved
    nodes, weights = np.polynomial.legendre.leggauss(12)
    for orbit in branch.solutions[20:]:
        edges = orbit.mesh / orbit.mesh[-1] * orbit.period
        half = 0.5 * np.diff(edges)
        times = edges[:-1, None] + half[:, None] * (1.0 + nodes)
        divergence = (1.0 - orbit.evaluate(times.ravel())[:, 0].reshape(times.shape) ** 2) / 0.01
        exponents = orbit.floquet().exponents
        (log,), (error,) = exponents.values.real, exponents.noise
        assert exponents.values.imag == 0.0
        assert abs(log - half @ divergence @ weights) <= error + 1e-7
        assert error < 1e-3


def test_a_fold_at_which_the_rate_of_the_parameter_is_rounding_is_no_branch_point() -> None:
    """In the canard of FitzHugh and Nagumo's equations I moves by 1e-11 where the multiplier goes from 16 to 0.1.

    There F_x alone is singular: (F_x, F_I), whose least singular value is 5e-3, has one null vector, and one branch.
    """
    v, w, current = symbols("v w I")
    model = OdeModel(
        "nerve", ca.vertcat(v, w), ca.vertcat(v - v**3 / 3 - w + current, 0.08 * (v + 0.7 - 0.8 * w)), current
    )
    rest = find_equilibrium(model, [-1.2, -0.6], parameters={"I": 0.0}).follow("I", 2.0)
    branch = from_hopf(rest, 0, "I", 1.0, stability=True, max_points=40)
    (fold,) = branch.special_points
    assert fold.kind == "fold"
    assert fold.parameters["I"] == pytest.approx(0.3241785225, abs=5e-9)
    point = fold.solution.point
    (rows, columns), solver = point.problem.pattern, branch.space.point_solver
    jacobian = np.zeros((point.problem.size - 1, point.problem.size))
    jacobian[rows, columns] = point.problem.evaluate(point.z)[1]
    jacobian /= np.sqrt(solver.metric(point.problem, point.z))
    jacobian /= np.linalg.norm(jacobian, axis=1)[:, None]
    assert np.linalg.svd(jacobian)[1][-1] > 1e-3
    assert np.linalg.svd(jacobian[:, :-1])[1][-1] < 1e-9


@pytest.mark.slow
def test_a_canard_is_passed_and_the_relaxation_oscillation_followed() -> None:
    """FitzHugh and Nagumo's equations at eps = 0.01: 649 points by the angle of tangents, 310 on meshes at rest."""
    x, y, a = symbols("x y a")
    model = OdeModel("canard", ca.vertcat(x, y), ca.vertcat((y - x**3 / 3 + x) / 0.01, a - x), a)
    branch = from_hopf(find_equilibrium(model, [1.1, -0.6], parameters={"a": 1.1}).follow("a", 0.9), 0, "a", 0.5)
    assert branch.end is End.REACHED
    assert len(branch) <= 80
    last = branch.solutions[-1]

    def up(t: float, state: np.ndarray) -> float:
        return float(state[0])

    up.direction = 1.0  # type: ignore[attr-defined]
    course = solve_ivp(
        lambda t, s: [(s[1] - s[0] ** 3 / 3 + s[0]) / 0.01, 0.5 - s[0]], (0.0, 4.0 * last.period), last.evaluate(0.0),
        method="Radau", rtol=1e-9, atol=1e-11, events=up,
    )  # fmt: skip
    turns = np.diff(course.t_events[0])
    np.testing.assert_allclose(turns[-1], last.period, rtol=1e-6)


def synapses() -> Branch:
    """Equilibria of Tsodyks and Markram's synapses (Cortes et al. 2013)."""
    E, x, u, E0 = symbols("E x u E0")
    rate = 1.5 * ca.log(1 + ca.exp((3.07 * u * x * E + E0) / 1.5))
    rates = ca.vertcat((rate - E) / 0.013, (1 - x) / 0.2 - u * x * E, (0.3 - u) / 1.5 + 0.3 * (1 - u) * E)
    model = OdeModel("synapses", ca.vertcat(E, x, u), rates, E0)
    start = find_equilibrium(model, [0.238616, 0.982747, 0.367876], parameters={"E0": -2.0})
    return start.follow("E0", -0.9)


@pytest.mark.slow
def test_orbits_that_pass_a_saddle_focus_again_come_to_its_homoclinic_orbit() -> None:
    """The folds come to the limit like a geometric series."""
    rest = synapses()
    branch = from_hopf(rest, -1, "E0", -5.0)
    assert branch.end is End.UNBOUNDED
    limit, error = branch.special_points[-1].parameters["E0"], branch.special_points[-1].error
    folds = np.array([point.parameters["E0"] for point in branch.special_points if point.kind == "fold"])
    first, second = np.diff(folds[-3:])
    assert abs(folds[-1] + second**2 / (first - second) - limit) <= error


@pytest.mark.slow
def test_orbits_beside_a_homoclinic_orbit_are_walked_to_a_period_that_is_asked_for() -> None:
    """Shilnikov's folds go on geometrically, by exp(-pi rho / omega) of the saddle-focus at the end of the branch."""
    rest = synapses()
    branch = from_hopf(rest, -1, "E0", -5.0, period_max=30.0)
    assert branch.end is End.REACHED
    assert branch.solutions[-1].period == 30.0
    assert branch.solutions[-1].error < 1e-7
    folds = np.array([point.parameters["E0"] for point in branch.special_points])
    ratios = np.diff(folds[-5:])[1:] / np.diff(folds[-5:])[:-1]
    saddle = find_equilibrium(rest.solutions[0].model, branch.solutions[-1].evaluate(0.0), parameters={"E0": folds[-1]})
    focus = saddle.eigenvalues[np.argmax(np.abs(saddle.eigenvalues.imag))]
    np.testing.assert_allclose(ratios, -np.exp(-np.pi * abs(focus.real / focus.imag)), rtol=0.02)


@pytest.mark.slow
def test_a_doubling_beside_each_fold_near_a_homoclinic_orbit_is_found_or_its_stretch_is_named() -> None:
    """A multiplier of -1e27 is one of 1e27 a step later: by way of a doubling and a fold, 1e-3 to 1e-9 of a step apart.

    Folds on the last stretch before the homoclinic orbit are on the branch, too. The first two are of other kinds.
    """
    branch = from_hopf(synapses(), -1, "E0", -5.0, stability=True)
    folds, doublings = (
        np.array([point.parameters["E0"] for point in branch.special_points if point.kind == kind])
        for kind in ("fold", "period doubling")
    )
    assert (folds.size >= 14, doublings.size >= 11) == (True, True)
    beside = np.count_nonzero(np.abs(folds[2:, None] - doublings) < 1e-7, axis=1)
    ends = np.array([(gap.start, gap.end) for gap in branch.unresolved])
    named = np.min(np.abs(folds[2:, None, None] - ends), axis=(1, 2)) < 1e-12
    assert np.all((beside == 1) | named)
    assert np.all(beside[:9] == 1)
    for point in branch.special_points:
        critical = {"fold": 1.0, "period doubling": -1.0}.get(point.kind)
        floquet = point.solution.floquet()
        if critical is not None:
            off = np.abs(floquet.others - critical)
            assert off.min() <= floquet.other_errors[off.argmin()]


def autocatalator() -> OdeModel:
    """Petrov, Scott and Showalter (1992)."""
    a, b, c, mu = symbols("a b c mu")
    rates = ca.vertcat(mu * (65 + c) - a * b**2 - a, (a * b**2 + a - b) / 5e-3, (b - c) / 2e-2)
    return OdeModel("autocatalator", ca.vertcat(a, b, c), rates, mu)


@pytest.mark.slow
def test_special_orbits_are_located_between_orbits_whose_layers_are_elsewhere() -> None:
    """The doublings are those that meshes at rest have, with 249 points."""
    rest = find_equilibrium(autocatalator(), [0.1] * 3, parameters={"mu": 1e-3}).follow("mu", 0.3)
    branch = from_hopf(rest, 1, "mu", 0.0374, at=[0.1, 0.05], stability=True)
    assert branch.end is End.REACHED
    assert len(branch) <= 85
    assert not branch.missed
    doublings = [(point.kind, round(point.parameters["mu"], 9)) for point in branch.special_points]
    assert doublings == [("period doubling", 0.156453145), ("period doubling", 0.142956576)]
    for value in (0.1, 0.05):
        near = [solution for solution in branch.solutions if solution.value("mu") == value]
        assert len(near) == 1


def test_points_between_two_are_the_same_on_a_mesh_that_moves() -> None:
    """At mu = 8 of van der Pol: from orbits far apart, and from a branch that stops there."""
    circle = oscillation()
    branch = circle.follow("mu", 20.0)
    exact = circle.follow("mu", 8.0).solutions[-1]
    assert branch.at(8.0).period == pytest.approx(exact.period, rel=1e-9)
    solver, points = branch.space.point_solver, [solution.point for solution in branch.solutions]
    before, after = next((one, two) for one, two in itertools.pairwise(points) if solver.joined(one, two).moving)
    there = solver.along(before, after, 0.4)
    moving = solver.joined(before, after).moving
    assert there is not None
    seen = moving.seen(there, 0.0)
    place = 1.0 - seen.sigma / moving.past.sigma
    assert place == pytest.approx(0.4, abs=0.02)
    assert seen.problem.imbalance(seen.z) < 2.0 * moving.problem.imbalance(moving.start.z)


@pytest.mark.parametrize(("degree", "table"), [(4, "gauss"), (5, "radau")])
def test_velocities_of_a_mesh_are_those_by_numpy(degree: int, table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, method = np.random.default_rng(7), {"transcription": table, "degree": degree}
    orbit = oscillation(3.0, **method)
    problem, z = orbit.problem, orbit.point.z
    t, weights, change = rng.normal(size=z.size), rng.uniform(0.5, 2.0, z.size), rng.normal(size=problem.resolution)

    def both() -> list[np.ndarray]:
        return [*moving._drift(problem, z, t, weights), moving._shifted(problem, z, change)]

    compiled = both()
    monkeypatch.setattr(moving, "kernels", dict)
    for one, other in zip(compiled, both(), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * np.max(np.abs(other)))
        assert np.max(np.abs(one)) > 0.0
