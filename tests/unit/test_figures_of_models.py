"""Pictures, films and progress of models of one's own: families, branches in a parameter, orbits and evolutions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from drawing import legend_labels, lines, overlaps, points, stretches
from equilibrium_models import rosenzweig_macarthur
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from PIL import Image
from small_models import bratu, forced_orbit, fput, limit_cycle, pendulums, two_wells, van_der_pol

from casadi_skin import (
    Bond,
    Branch,
    Chain,
    Lattice,
    OdeModel,
    Site,
    find_equilibrium,
    find_orbit,
    follow_family,
    simulate_orbit,
)
from casadi_skin.follow.closed_curve import cosine_curve
from casadi_skin.follow.solution import Solution
from casadi_skin.results.figures.bands import spectrum_figure
from casadi_skin.results.figures.branches import branch_figure, smooth
from casadi_skin.results.figures.evolutions import spacetime_figure
from casadi_skin.results.figures.families import frequency_figure, profile_figure
from casadi_skin.results.figures.multipliers import MODULUS_LABEL, multiplier_figure
from casadi_skin.results.figures.solutions import animate, orbit_figure, portrait_figure
from casadi_skin.results.quantities import extremes
from casadi_skin.runs.output import Progress

pytestmark = pytest.mark.usefixtures("pictures")

SITES = 8


@pytest.fixture(scope="module")
def families() -> list[Branch]:
    """The lowest and the third family of FPUT-beta; the third loses its stability."""
    model, options = fput(SITES), {"stability": True, "tolerance": 1e-6, "corrector": "newton"}
    return [follow_family(model, j, 0.5, at=[0.1, 0.5], **options) for j in (1, 3)]  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def cycles() -> Branch:
    """Limit cycles of van der Pol."""
    return limit_cycle().follow("mu", 3.0, at=[2.0], stability=True)


@pytest.fixture(scope="module")
def resonance() -> Branch:
    """The response of the driven oscillator over its two folds."""
    return forced_orbit().follow("omega", 2.6, at=[1.8], stability=True)


@pytest.fixture(scope="module")
def solutions() -> Branch:
    """Those of Bratu's problem round their fold."""
    return bratu(0.5).solve([0.0, 0.0]).follow("lam", 6.0)


# Families -------------------------------------------------------------------------------------------------------------


def test_frequencies_of_a_family_start_at_the_linear_ones(families: list[Branch]) -> None:
    figure = frequency_figure(families)
    axes = figure.axes[0]
    omega = 2.0 * np.sin(np.arange(1, SITES + 1) * np.pi / (2 * (SITES + 1)))  # of the linear lattice
    (first, third) = [line for line in axes.get_lines() if line.get_label() == "stable"]
    (unstable,) = lines(axes, "unstable")
    assert points(first)[0] == pytest.approx([0.0, omega[0]])
    assert points(third)[0] == pytest.approx([0.0, omega[2]])
    (change,) = families[1].changes
    assert tuple(points(third)[-1]) == tuple(points(unstable)[0])
    assert points(third)[-1] == pytest.approx((change.value, change.Omega), rel=1e-14)
    S, Omega = points(first)[:: len(points(first)) // 5].T
    assert Omega[1:] == pytest.approx([families[0].at(S=float(value)).Omega for value in S[1:]], rel=1e-6)
    (band,) = [patch for patch in axes.patches if patch.get_label() == "linear band"]
    low, high = axes.transData.inverted().transform(band.get_extents().get_points())[:, 1]
    assert (low, high) == pytest.approx((omega[0], omega[-1]))
    assert axes.get_title() == "FPUT-beta: bond = $1$"
    theory = lines(axes, "multiple scales, first order in $S$")
    for mode, line in zip((1, 3), theory, strict=True):  # 3 sum d^4/(8 omega (sum u^2)^2) by extensions d of the mode u
        u = np.pad(np.sin(np.arange(1, SITES + 1) * mode * np.pi / (SITES + 1)), 1)
        slope = 3.0 * np.sum(np.diff(u) ** 4) / (8.0 * omega[mode - 1] * np.sum(u**2) ** 2)
        S, Omega = points(line).T
        assert Omega == pytest.approx(omega[mode - 1] + slope * S, rel=1e-12)


def shaded(axes: Axes, label: str) -> list[list[float]]:
    """Ends of the horizontal stretches of a look, ascending; one of several has the label."""
    (first,) = [patch for patch in axes.patches if patch.get_label() == label]
    alike = [patch for patch in axes.patches if patch.get_linewidth() == first.get_linewidth()]
    return sorted(axes.transData.inverted().transform(p.get_extents().get_points())[:, 1].tolist() for p in alike)


def test_a_gap_of_a_lattice_is_no_band() -> None:
    """Two ground springs in turn: omega^2 = 2 + (a + b)/2 -+ sqrt((b - a)^2/4 + 4 cos^2(k/2))."""
    a, b = 1.0, 3.0
    sites = [Site("light", onsite="y + y^3"), Site("heavy", onsite="3*y + y^3")]
    bonds = [Bond("light", "heavy", (0,), "d"), Bond("heavy", "light", (1,), "d")]
    branch = follow_family(Lattice(6, sites, bonds), 1, 0.01, tolerance=1e-4)
    (axes,) = frequency_figure([branch]).axes
    middle, reach = 2.0 + (a + b) / 2, np.sqrt((b - a) ** 2 / 4 + 4.0)
    edges = np.sqrt([[middle - reach, middle - (b - a) / 2], [middle + (b - a) / 2, middle + reach]])
    np.testing.assert_allclose(shaded(axes, "linear band"), edges, rtol=1e-12)
    assert "linear frequency" not in legend_labels(axes.figure)


def test_a_frequency_in_a_gap_is_a_line_and_cells_that_differ_have_no_band() -> None:
    """Weak bonds at both ends of a chain of bonds 0.2 and 1 in turn: a mode at each end, omega^2 = 2.4, in the gap."""
    bonds = [Bond("a", "b", (0,), "0.2*d"), Bond("b", "a", (1,), "d")]
    ends = Lattice(8, [Site("a", onsite="1.2*y + y^3"), Site("b", onsite="1.2*y + y^3")], bonds)
    drawn = frequency_figure([follow_family(ends, 1, 0.01, tolerance=1e-4)]).axes[0]
    np.testing.assert_allclose(np.square(shaded(drawn, "linear band")), [[1.2, 1.6], [3.2, 3.6]], rtol=1e-12)
    np.testing.assert_allclose(np.square(shaded(drawn, "linear frequency")), np.full((2, 2), 2.4), rtol=1e-5)
    different = Lattice(
        3, [Site("a", onsite="s*y + y^3")], [Bond("a", "a", (1,), "d")], parameters={"s": [1.0, 5.0, 9.0]}
    )
    branch = follow_family(different, 1, 0.01, tolerance=1e-4)
    (axes,) = frequency_figure([branch]).axes
    assert "linear band" not in [patch.get_label() for patch in axes.patches]
    squares = np.linalg.eigvalsh(np.diag([3.0, 7.0, 11.0]) - np.eye(3, k=1) - np.eye(3, k=-1))
    np.testing.assert_allclose(np.square(shaded(axes, "linear frequency")), np.stack([squares, squares], 1), rtol=1e-9)


def test_families_must_be_of_one_model_with_the_same_parameters(families: list[Branch]) -> None:
    other = follow_family(families[0].space.model, 1, 0.1, parameters={"bond": 2.0}, tolerance=1e-3)
    for draw in (frequency_figure, profile_figure):
        with pytest.raises(ValueError, match="branches: given branches of 2 models; accepted: one or more, all of"):
            draw([families[0], other])


def test_other_branches_are_no_families_and_families_no_other_branches(cycles: Branch, families: list[Branch]) -> None:
    for draw in (frequency_figure, profile_figure):
        with pytest.raises(ValueError, match="branches: given a branch in mu; accepted: families"):
            draw([cycles])
    with pytest.raises(
        ValueError, match="branch: given a family; accepted: a branch of orbits or solutions in a parameter"
    ):
        branch_figure(families[0])


def test_the_amplitude_of_a_model_with_its_own_normalisation_is_called_so() -> None:
    q, v, S = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("S")
    force = -ca.vertcat(2 * q[0] - q[1], 2 * q[1] - q[0]) - q**3
    model = OdeModel(
        "pair", q, force, S, 2, v, reversal=(1, 1, -1, -1), half_period=(-1,) * 4, normalisation=2 * ca.dot(q, q) - S
    )
    branch = follow_family(model, 1, 1.0, at=[1.0], tolerance=1e-6, corrector="newton")
    assert frequency_figure([branch]).axes[0].get_xlabel() == "amplitude $S$"
    figure = profile_figure([branch])
    assert np.linalg.norm(points(lines(figure.axes[0], "$S = 1$")[0])[:, 1]) == pytest.approx(1.0)


@pytest.mark.parametrize("model", [fput(SITES), pendulums(5, gamma=0.4)])
def test_the_spectrum_of_a_model(model: OdeModel) -> None:
    jacobian = ca.Function("J", [model.state, model.parameters], [ca.jacobian(model.rhs, model.state)])
    stiffness = -np.array(jacobian(0.0, list(model.nominal or ())))
    squares, vectors = np.linalg.eig(stiffness)
    order = np.argsort(squares)
    axes, *modes = spectrum_figure(model).axes
    np.testing.assert_allclose(points(axes.get_lines()[0])[:, 1], np.sqrt(squares[order]), rtol=1e-10)
    assert not axes.texts  # no cutoffs are known
    for panel, place in zip(modes, (-1, 0), strict=True):
        vector = vectors[:, order[place]]
        drawn = points(panel.get_lines()[1])[:, 1]
        np.testing.assert_allclose(drawn, vector * np.sign(vector[np.argmax(np.abs(vector))]), atol=1e-10)


def test_models_without_linear_modes_have_no_spectrum() -> None:
    with pytest.raises(ValueError, match="model: given van der Pol; accepted"):
        spectrum_figure(van_der_pol())
    with pytest.raises(ValueError, match="sites: given an infinite chain"):
        spectrum_figure(Chain(np.inf, 1.0, 0.2, 1.0))


# Branches in a parameter ----------------------------------------------------------------------------------------------


def test_a_branch_of_cycles_shows_extremes_and_period(cycles: Branch) -> None:
    figure = branch_figure(cycles, "Limit cycle")
    top, bottom = figure.axes
    high, low = lines(top, "stable")
    np.testing.assert_array_equal(points(high)[:, 0], cycles["mu"])
    np.testing.assert_allclose(points(high)[:, 1], [extremes(orbit)[1][0] for orbit in cycles.orbits])
    np.testing.assert_allclose(points(low)[:, 1], -points(high)[:, 1], atol=1e-6)  # the cycle is symmetric
    assert points(high)[0, 1] == pytest.approx(2.00861986, abs=1e-6)  # published, mu = 1 (Urabe 1960)
    (period,) = lines(bottom, "stable")
    np.testing.assert_allclose(points(period)[:, 1], cycles.period)
    assert points(period)[0, 1] == pytest.approx(6.66328686, abs=1e-7)
    assert points(lines(bottom, "requested")[0])[:, 0] == pytest.approx([2.0])
    assert (top.get_title(), bottom.get_xlabel(), bottom.get_ylabel()) == ("Limit cycle", "mu", "period")


def test_a_resonance_loses_stability_between_its_folds(resonance: Branch) -> None:
    figure = branch_figure(resonance)
    top, bottom = figure.axes
    folds = np.sort([point.parameters["omega"] for point in resonance.special_points])
    assert folds.size == 2
    np.testing.assert_allclose(np.sort(points(lines(top, "fold")[0])[:, 0]), folds)
    for axes, curves in ((top, 2), (bottom, 1)):
        stable, unstable = stretches(lines(axes, "stable")), stretches(lines(axes, "unstable"))
        assert (len(stable), len(unstable)) == (2 * curves, curves)
        for line in unstable:
            assert points(line)[[0, -1], 0] == pytest.approx(folds[::-1], abs=1e-6)
    assert np.all(points(lines(bottom, "unstable")[0])[1:-1, 1] > 1.0)
    assert points(lines(top, "requested")[0])[:, 0] == pytest.approx([1.8] * 3)
    assert bottom.get_ylabel() == "largest |multiplier|"
    assert legend_labels(figure) == {"stable", "unstable", "fold", "requested"}  # changes lie at the folds


def test_a_change_that_was_not_located_is_drawn_at_the_fold(resonance: Branch) -> None:
    top = branch_figure(dataclasses.replace(resonance, located=())).axes[0]
    folds = {tuple(row) for line in lines(top, "fold") for row in points(line)}
    unstable = lines(top, "unstable")
    assert unstable
    for line in unstable:
        assert {tuple(points(line)[0]), tuple(points(line)[-1])} <= folds


def test_solutions_without_stability_are_drawn_round_their_fold(solutions: Branch) -> None:
    figure = branch_figure(solutions)
    (axes,) = figure.axes
    (fold,) = lines(axes, "fold")[:1]
    assert points(fold)[0] == pytest.approx([3.513830719, 1.186842169], abs=1e-6)  # published (Bratu; Gelfand)
    assert "stability not computed" not in legend_labels(figure)
    assert axes.get_title() == "Bratu"
    plain = orbit_figure(solutions.solutions[0])
    assert plain.get_suptitle() == "Bratu: lam = $0.5$"
    assert plain.axes[0].get_xlim() == (0.0, 1.0)
    assert multiplier_figure(solutions) is None


def test_smooth_curves_pass_their_points_and_do_not_overshoot() -> None:
    angle = np.sort(np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 40))
    ring = np.column_stack([2.0 * np.cos(angle), 0.1 * np.sin(angle)])
    curve = smooth(ring)
    assert {tuple(point) for point in ring} <= {tuple(point) for point in curve}
    inside = np.diff(angle).max() < 0.6
    assert inside
    np.testing.assert_allclose(np.hypot(curve[:, 0] / 2.0, curve[:, 1] / 0.1), 1.0, atol=0.02)
    x = np.sort(np.random.default_rng(4).uniform(0.5, 5.0, 30))
    level = smooth(np.column_stack([x, 1.0 + 1e-15 * np.sin(1e3 * x)]))  # a constant but for rounding
    assert np.all(np.diff(level[:, 0]) > 0.0)
    assert level[-1, 0] == x[-1]
    lost = smooth(np.array([[0, 0], [1, 0], [1, 1e-30], [1, 2e-30], [2, 0], [3, 1], [4, 0]]))  # in the whole length
    assert np.all(np.isfinite(lost))


def test_branches_that_ended_early_say_so(cycles: Branch) -> None:
    assert "ended early" not in legend_labels(branch_figure(cycles))
    short = dataclasses.replace(cycles, solutions=cycles.solutions[:3], end=None)
    assert "ended early" in legend_labels(branch_figure(short))
    assert "ended early" not in legend_labels(branch_figure(dataclasses.replace(short, stopped=True)))


# Multipliers ----------------------------------------------------------------------------------------------------------


def test_multipliers_of_a_driven_oscillator(resonance: Branch) -> None:
    figure = multiplier_figure(resonance, "Resonance")
    moduli, *planes = figure.axes
    (largest,) = lines(moduli, r"largest $\left|\lambda\right|$")
    kept = {tuple(row) for row in np.column_stack([resonance["omega"], resonance.max_abs_multiplier])}
    assert kept <= {tuple(point) for point in points(largest)}
    assert moduli.get_ylabel() == MODULUS_LABEL  # none is trivial
    dots = np.concatenate([points(line)[:, 1] for line in moduli.get_lines() if line.get_marker() == "."])
    sizes = np.abs([orbit.floquet().multipliers for orbit in resonance.orbits]).ravel()
    np.testing.assert_allclose(np.sort(dots), np.sort(sizes[np.abs(sizes - 1.0) > 1e-6]), atol=1e-6)
    titles = [axes.get_title(loc="left") for axes in planes]
    assert [("passage" in title) for title in titles] == [False, True, True]
    for axes, orbit in zip(planes, (resonance.at(1.8, k) for k in range(3)), strict=True):
        drawn = np.concatenate([points(line) for line in axes.get_lines() if "circle" in str(line.get_label())])
        expected = orbit.floquet().multipliers
        np.testing.assert_allclose(np.sort_complex(drawn @ [1, 1j]), np.sort_complex(expected), atol=1e-6)
        assert not lines(axes, "trivial pair")
    assert figure.get_suptitle() == "Resonance"


def test_multipliers_of_a_cycle_and_of_a_family(cycles: Branch, families: list[Branch]) -> None:
    figure = multiplier_figure(cycles)
    assert len(lines(figure.axes[1], "trivial multiplier")) == 1
    assert figure.axes[0].get_xlabel() == "mu"
    figure = multiplier_figure(families[1])
    assert len(lines(figure.axes[2], "trivial pair")) == 1
    assert figure.get_suptitle() == "family $j = 3$; FPUT-beta: bond = $1$"
    (ticks,) = figure.axes[0].collections
    assert ticks.get_label() == "change of stability (complex)"
    assert [segment[0, 0] for segment in ticks.get_segments()] == [families[1].changes[0].value]


# Orbits and evolutions ------------------------------------------------------------------------------------------------


def first_curve(figure: Figure) -> np.ndarray:
    return points(figure.axes[0].get_lines()[0])


def test_orbits_of_every_kind_are_drawn_over_their_period(cycles: Branch, families: list[Branch]) -> None:
    for orbit in (cycles.orbits[-1], families[0].orbits[-1]):
        figure = orbit_figure(orbit)
        t, x = first_curve(figure).T
        assert (t[0], t[-1]) == pytest.approx((0.0, orbit.period))
        first = int(np.argmax(np.abs(orbit.profile))) if orbit is families[0].orbits[-1] else 0
        np.testing.assert_allclose(x, orbit.evaluate(t)[:, first], atol=1e-14)
        plane = points(figure.axes[1].get_lines()[0])
        np.testing.assert_allclose(plane[0], plane[-1], atol=1e-8)
    assert figure.get_suptitle() == "FPUT-beta: bond = $1$, $j = 1$, $S = 0.5$"
    assert figure.axes[0].get_ylabel() == "states (6 of 8)"
    ranked = np.argsort(-np.abs(families[0].orbits[-1].profile))[:6]
    drawn = [points(line)[0, 1] for line in figure.axes[0].get_lines()]
    np.testing.assert_allclose(np.abs(drawn), np.abs(families[0].orbits[-1].profile[ranked]), rtol=1e-12)


def test_an_orbit_of_an_infinite_chain_is_drawn_at_its_edge() -> None:
    orbit = follow_family(Chain(np.inf, 1.0, 0.25, 1.0), "last", 1.0, at=[1.0], tolerance=1e-4).at(1.0)
    figure = orbit_figure(orbit)
    curves = {str(line.get_label()): points(line) for line in figure.axes[0].get_lines()}
    assert set(curves) == {f"y_{-n}" for n in range(6)}
    for name, (t, x) in ((name, curve.T) for name, curve in curves.items()):
        np.testing.assert_allclose(x, orbit.evaluate(t, [int(name[2:])])[:, 0], atol=1e-14)
    assert [figure.axes[1].get_xlabel(), figure.axes[1].get_ylabel()] == list(curves)[:2]


def test_an_orbit_with_one_position_is_drawn_with_its_velocity() -> None:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = OdeModel("pendulum", q, -ca.sin(q), order=2, velocity=v, reversal=(1, -1), half_period=(-1, -1))
    orbit = follow_family(model, 1, 1.0, at=[1.0]).at(1.0)
    y, velocity = points(orbit_figure(orbit).axes[1].get_lines()[0]).T
    np.testing.assert_allclose((orbit.Omega * velocity) ** 2 / 2 - np.cos(y), -np.cos(1.0), atol=1e-7)
    np.testing.assert_allclose(cosine_curve(orbit).points(np.zeros(1))[0], [[1.0, 0.0]], atol=1e-7)


def test_an_evolution_of_a_lattice_is_an_image_and_of_few_states_lines(families: list[Branch], cycles: Branch) -> None:
    orbit = families[0].at(0.5)
    run = simulate_orbit(orbit, np.linspace(0.0, 2 * orbit.period, 101), 0.01, site=2)
    figure = spacetime_figure(run, "kicked", profile=True, energy=True, kicked_site=2)
    (image,) = [c for axes in figure.axes for c in axes.collections if isinstance(c, QuadMesh) and c.colorbar]
    np.testing.assert_array_equal(np.asarray(image.get_array()), run.displacements.T)
    assert figure.get_suptitle() == "kicked; FPUT-beta: bond = $1$"
    assert "position $n$" in {axes.get_ylabel() for axes in figure.axes}
    cycle = cycles.orbits[0]
    run = simulate_orbit(cycle, np.linspace(0.0, 2 * cycle.period, 101), 0.1, site=1)
    figure = spacetime_figure(run, "kicked", profile=True, energy=True, kicked_site=1)
    (axes,) = figure.axes  # neither energy nor profile
    for line, x in zip(axes.get_lines(), run.states.T, strict=True):
        np.testing.assert_array_equal(points(line), np.column_stack([run.t, x]))
    assert legend_labels(figure) == {"x", "y"}


def test_long_evolutions_show_the_range_of_each_state() -> None:
    orbit = forced_orbit()
    run = simulate_orbit(orbit, np.linspace(0.0, 150 * orbit.period, 3001), 0.1, site=1, tolerance=1e-6)
    figure = spacetime_figure(run)
    (axes,) = figure.axes
    assert axes.get_ylabel().startswith("range of states in windows of")
    assert len(axes.patches) == 2
    assert not axes.get_lines()


def frames(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        found = []
        for frame in range(film.n_frames):
            film.seek(frame)
            found.append(np.array(film.convert("L"), dtype=float))
    return found


@pytest.mark.parametrize("pictures", ["drawn"], indirect=True)
@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_films_of_every_kind_of_orbit_move(families: list[Branch], cycles: Branch, tmp_path: Path, quick: bool) -> None:
    x, t = ca.SX.sym("x"), ca.SX.sym("t")
    relaxed = OdeModel("relaxation", x, ca.cos(t) - x, time=t, forcing_period=2 * np.pi)
    wells = follow_family(two_wells(), 1, 0.02, at=[0.02], tolerance=1e-6).at(0.02)
    for name, orbit in (
        ("lattice", families[0].at(0.5)),
        ("plane", cycles.orbits[0]),
        ("positions", wells),
        ("one_state", find_orbit(relaxed, lambda t: [np.cos(t)])),
    ):
        if quick and name != "plane":
            continue
        pictures = frames(animate(orbit, tmp_path / f"{name}.gif", frames=4))
        assert len(pictures) == 4
        below_the_clock = [picture[picture.shape[0] // 3 :] for picture in pictures]
        assert np.abs(below_the_clock[0] - below_the_clock[1]).max() > 100, name


@pytest.mark.parametrize("pictures", ["drawn"], indirect=True)
def test_a_film_repeats_and_shows_displacements_reversed_after_half_a_period(
    families: list[Branch], tmp_path: Path
) -> None:
    orbit = families[0].at(0.5)
    path = animate(orbit, tmp_path / "mode.gif", frames=4)
    first, _, third, _ = frames(path)
    assert np.abs(first - third).max() > 100
    with Image.open(path) as film:
        assert film.info["loop"] == 0
    for name, count in (("mode.avi", 8), ("other.gif", 1)):
        with pytest.raises(ValueError, match="accepted"):
            animate(orbit, tmp_path / name, frames=count)
    assert [p.name for p in tmp_path.iterdir()] == ["mode.gif"]


def test_equilibria_are_points_of_the_portrait_and_more_than_six_are_refused() -> None:
    start = find_equilibrium(rosenzweig_macarthur(), [1.0, 1.0], parameters={"K": 2.0})
    other = find_equilibrium(rosenzweig_macarthur(), [1.0, 1.0], parameters={"K": 2.5})
    in_time, in_plane = portrait_figure([start, other]).axes[:2]
    assert [line.get_label() for line in in_time.lines] == ["K = 2, at rest", "K = 2.5, at rest"]
    for line, equilibrium in zip(in_plane.lines, (start, other), strict=True):
        np.testing.assert_allclose(line.get_xydata()[0], equilibrium.state)
    with pytest.raises(ValueError, match="solutions: given 7; accepted: 1 to 6"):
        portrait_figure([start] * 7)


# Progress -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("families", "j = 1: S = 0.5 of 0.5, 7 points, step"),
        ("cycles", "mu = 3 on the way to 3, 7 points, step"),
        ("resonance", "omega = 2.6 on the way to 2.6, 7 points, step"),
        ("single", "solved, 7 points, step"),
    ],
)
def test_progress_says_where_a_branch_is(kind: str, words: str, request: pytest.FixtureRequest) -> None:
    said: list[str] = []

    class Status:
        def update(self, text: str) -> None:
            said.append(text)

    if kind == "single":
        last: Solution = limit_cycle()
    else:
        found = request.getfixturevalue(kind)
        last = (found[0] if isinstance(found, list) else found).solutions[-1]
    progress = Progress(quiet=True)
    progress._status = Status()  # type: ignore[assignment]
    progress.solution(last, 7)
    assert said[0].startswith(words)


# Places -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("pictures", ["drawn"], indirect=True)
@pytest.mark.parametrize("draw", ["cycles", "resonance", "orbit", "multipliers", "families", "spectrum", "portrait"])
def test_no_text_covers_another(draw: str, cycles: Branch, resonance: Branch, families: list[Branch]) -> None:
    figures: dict[str, Callable[[], Figure | None]] = {
        "cycles": lambda: branch_figure(cycles),
        "resonance": lambda: branch_figure(resonance, "Resonance"),
        "orbit": lambda: orbit_figure(cycles.orbits[-1]),
        "multipliers": lambda: multiplier_figure(resonance),
        "families": lambda: profile_figure(families),
        "spectrum": lambda: spectrum_figure(Chain(24, 1.0, 0.25, 1.0)),
        "portrait": lambda: portrait_figure(cycles.orbits[:3]),
    }
    figure = figures[draw]()
    assert overlaps(figure) == []
