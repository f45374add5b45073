"""Expressions of users along a branch: where one vanishes is a special point of its name, against closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from small_models import circles, wave

from casadi_skin import Chain, OdeModel, find_equilibrium, follow_family, read_result
from casadi_skin.follow.search import MonitorSearch

X = ca.SX.sym("q")


@pytest.mark.parametrize("value", [0.5, -0.1, 0.9999, 1.0 - 1e-9])
@pytest.mark.parametrize("max_step", [0.05, 0.2, 5.0])
def test_both_passages_of_a_value_are_found_with_any_step(value: float, max_step: float) -> None:
    branch = wave(monitors={"level": lambda t, x, p: x[1] - value}, max_step=max_step)
    first = np.arcsin(value) / 3
    expected = [place for place in (first, np.pi / 3 - first) if 0.0 < place < 1.0]
    assert [point.kind for point in branch.special_points] == ["level"] * len(expected)
    for point, place in zip(branch.special_points, expected, strict=True):
        assert abs(point.parameters["p"] - place) <= point.error <= 1e-8
        assert float(point.solution["y"]) == pytest.approx(value, abs=1e-12)
    assert not branch.unresolved


def test_monitors_are_columns_and_words_and_are_read_back(tmp_path: Path) -> None:
    branch = wave(monitors={"half": lambda t, x, p: x[1] - 0.5, "quarter": lambda t, x, p: x[0] - 0.25}, at=[0.25])
    assert [point.kind for point in branch.special_points] == ["half", "quarter", "half"]
    quarter = branch.special_points[1]
    assert quarter.parameters["p"] == 0.25
    assert quarter.solution.point.requested
    assert sum(value == 0.25 for value in branch["p"]) == 1
    np.testing.assert_allclose(branch["half"], branch["y"] - 0.5, atol=1e-15)
    assert "half at 0.17453293, quarter at 0.25" in str(branch)
    assert "2 half, 1 quarter" in repr(branch)
    assert {"half", "quarter", "special"} <= set(branch.to_dataframe().columns)
    assert branch.at(half=-0.2)["y"] == pytest.approx(0.3, abs=1e-10)
    assert (quarter.criticality, np.isnan(quarter.coefficient)) == ("", True)
    branch.plot()
    branch.save(tmp_path / "branch")
    again = read_result(tmp_path / "branch")
    assert [point.kind for point in again.special_points] == ["half", "quarter", "half"]
    np.testing.assert_array_equal(again["quarter"], branch["quarter"])


def test_a_monitor_that_is_rounding_alone_takes_nothing_from_another_one() -> None:
    both = {"rounding": lambda t, x, p: x[0] + 1.0 - (p + 1.0), "level": lambda t, x, p: x[1] - 0.9999}
    branch = wave(monitors=both, max_step=5.0)
    assert [point.kind for point in branch.special_points] == ["level", "level"]
    assert max(point.error for point in branch.special_points) < 1e-10


@pytest.mark.parametrize("unit", [1e-15, 1.0, 1e12])
def test_zeros_do_not_depend_on_the_units_of_a_monitor(unit: float) -> None:
    branch = wave(monitors={"level": lambda t, x, p: unit * (x[1] - 0.5)})
    found = [point.parameters["p"] for point in branch.special_points]
    np.testing.assert_allclose(found, [np.pi / 18, np.pi / 3 - np.pi / 18], rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    "cube", [lambda x, p: x**3, lambda x, p: x + p, lambda x, p: 1e-9 * x**3], ids=["cube", "cancelling", "small"]
)
def test_a_zero_of_order_three_is_found_within_its_error(cube: Any) -> None:
    """Equilibria of x' = p + x - x^3 have x + p = x^3; 1e-16 of rounding there are 5e-6 of x."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    start = find_equilibrium(OdeModel("cusp", x, p + x - x**3, p, nominal=(-1.0,)), [-1.3])
    branch = start.follow("p", 1.0, monitors={"cube": cube(x, p)})
    (point,) = (point for point in branch.special_points if point.kind == "cube")
    assert abs(point.parameters["p"]) <= point.error <= 1e-4


def test_the_error_of_a_zero_that_noise_hides_reaches_round_a_fold() -> None:
    """p = x^2 with both ends at p = 0.04, between which noise hides a quantity that vanishes at x = 0.05."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    branch = find_equilibrium(OdeModel("fold", x, p - x**2, p, nominal=(1.0,)), [-1.0]).follow("p", -1.0, at=[0.04])
    first, last = (one.point for one in branch.solutions if one["p"] == 0.04)
    assert first.parameter == last.parameter
    search = MonitorSearch(
        branch.space, first, last, ["level"], lambda point: (branch.space.reading(point)[1] - 0.05) ** 3,
        lambda point: np.full(1, float(point.parameter != first.parameter)),
    )  # fmt: skip
    (point,) = search.on_stretch()
    assert branch.space.parameter_error(point) == pytest.approx(0.04 - 0.05**2, rel=1e-3)


@pytest.mark.parametrize("at", [0.01, 0.05])
def test_a_zero_on_a_stretch_that_is_rounding_is_named(at: float) -> None:
    """(x - a)^3 + (y - 1e9) with y = 1e9 has no digits near x = a, where it changes its sign."""
    (x, y), p = (ca.SX.sym(name) for name in "xy"), ca.SX.sym("p")
    model = OdeModel("fold", ca.vertcat(x, y), ca.vertcat(p - x**2, 1e9 - y), p, nominal=(1.0,))
    branch = find_equilibrium(model, [-1.0, 1e9]).follow("p", -1.0, monitors={"cube": (x - at) ** 3 + (y - 1e9)})
    assert [point.kind for point in branch.special_points] == ["fold"]
    (stretch,) = branch.unresolved
    assert stretch.kind == "cube"
    assert "changes its sign where it is no larger than its error, by way of" in stretch.reason
    assert "1 stretch" in repr(branch)


@pytest.mark.parametrize("offset", [1e3, 1e6, 1e9])
def test_rounding_of_large_terms_is_in_the_error(offset: float) -> None:
    branch = wave(monitors={"level": lambda t, x, p: offset + x[1] - 0.5 - offset})
    for point, place in zip(branch.special_points, (np.pi / 18, np.pi / 3 - np.pi / 18), strict=True):
        assert abs(point.parameters["p"] - place) <= point.error <= 1e-15 * offset + 1e-12


def test_a_value_that_is_touched_is_no_point_and_that_of_its_derivative_is() -> None:
    """y = sin(3 p) touches 1 at p = pi/6."""
    branch = wave(monitors={"top": lambda t, x, p: x[1] - 1.0, "slope": lambda t, x, p: ca.cos(3.0 * p)})
    (point,) = branch.special_points
    assert (point.kind, point.parameters["p"]) == ("slope", pytest.approx(np.pi / 6, abs=1e-12))
    assert not branch.unresolved


def test_a_branch_on_which_a_monitor_is_zero_throughout_or_at_its_start_has_no_point_of_it() -> None:
    monitors = {"always": lambda t, x, p: x[0] - p, "start": lambda t, x, p: x[1]}
    assert not wave(monitors=monitors, max_points=6).special_points


def test_orbits_are_located_by_their_state_at_phase_zero_beside_their_stability() -> None:
    p = ca.SX.sym("p")
    orbit = circles(p, p, 0.25, section=lambda t, x, p: x[1])
    branch = orbit.follow("p", 0.75, stability=True, monitors={"gap": orbit.model.state[0] - 0.6})
    (gap,) = branch.special_points
    assert abs(gap.parameters["p"] - 0.36) <= gap.error <= 1e-8
    assert abs(gap.solution.evaluate(0.0)[0]) == pytest.approx(0.6, abs=1e-9)
    assert branch.stable.all()
    assert not branch.changes
    assert not branch.unresolved
    with pytest.raises(ValueError, match="follow: given a gap"):
        gap.follow("p", 1.0)


def test_monitors_hold_on_cycles_that_leave_a_hopf_point_and_on_orbits_of_a_family() -> None:
    """Cycles of radius sqrt(p) about zero; a chain's orbit in a parameter, located at a value of it."""
    p = ca.SX.sym("p")
    model = circles(p, p, 0.25).model
    (hopf,) = find_equilibrium(model, [0.0, 0.0], parameters={"p": -0.5}).follow("p", 0.5).special_points
    cycles = hopf.follow("p", 0.5, monitors={"small": ca.sumsqr(model.state) - 0.09, "large": lambda t, x, p: p - 0.4})
    assert [one.kind for one in cycles.special_points[-2:]] == ["small", "large"]
    assert [one.parameters["p"] for one in cycles.special_points[-2:]] == pytest.approx([0.09, 0.4], abs=1e-7)
    orbit = follow_family(Chain(2, 1.0, 0.1, 1.0), 1, 0.5, tolerance=1e-6).at(0.5)
    branch = orbit.follow("gamma", 0.3, monitors={"middle": lambda t, x, p: p[1] - 0.2})
    assert [one.parameters["gamma"] for one in branch.special_points] == pytest.approx([0.2], abs=1e-6)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"fold": X}, ValueError, "given 'fold'; accepted: names in one line, which no state, parameter or kind"),
        ({"x": X}, ValueError, "monitors: given 'x'"),
        ({"": X}, ValueError, "monitors: given ''"),
        ({"h": X}, ValueError, "monitors, h: depends on q; accepted: t, x, y, p"),
        ({"h": ca.vertcat(X, X)}, ValueError, r"monitors, h: given shape \(2, 1\); accepted: a scalar"),
        ({"h": X == 1}, ValueError, "given a comparison"),
        ({"h": "x"}, TypeError, "monitors, h: given 'x'"),
        ([X], TypeError, "monitors: given .*; accepted: expressions by name"),
    ],
)
def test_other_monitors_are_refused(given: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        wave(monitors=given)
