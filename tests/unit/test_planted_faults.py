"""Checks of single lines that a fault could enter without any result looking wrong: each was broken once, and seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import erf

from casadi_skin import Bond, BoundaryValueProblem, Chain, Lattice, OdeModel, Site, evolve, follow_family
from casadi_skin.dynamics.starts import spreading
from casadi_skin.follow.find import packed, space_of
from casadi_skin.search.pareto import undominated
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.stated_problem import BoundaryProblem

flint = pytest.importorskip("flint")

from casadi_skin.certify import balls
from casadi_skin.certify.bounds import FiniteInverse
from casadi_skin.certify.certify import cosine_coefficients, step_of
from casadi_skin.certify.system import CosineSeries, system_of


def test_bounds_of_a_ball_hold_for_every_number_in_it() -> None:
    """Y over a ball of amplitudes, and Z over one of frequencies, beside those at numbers in the ball."""
    orbit = follow_family(Chain(3, 1.0, 0.25, -1.0), 1, 0.5, at=[0.5], tolerance=1e-10).at(S=0.5)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        system = system_of(orbit.space.whole.coordinates, 0.5, step_of(orbit.space), False)
        columns = cosine_coefficients(orbit, system, 8).T.tolist()
        rows = [[(flint.arb(c) / d).mid() for c in column] for column, d in zip(columns, system.scale, strict=True)]
        middle, S, nu, width = orbit.Omega**2, 0.5, flint.arb(1.02), 1e-3
        inverse = FiniteInverse(CosineSeries(system, flint.arb(middle), rows), nu).matrix

        def bounds(amplitude: Any, square: Any) -> tuple[float, float]:
            series = CosineSeries(replace(system, S=amplitude), square, rows)
            found = FiniteInverse(series, nu, inverse)
            return found.Y(), found.finite_columns()

        over_S = bounds(flint.arb(S, width), flint.arb(middle))[0]
        over_square = bounds(flint.arb(S), flint.arb(middle, width))[1]
        for at in (-width, 0.4 * width, width):
            assert bounds(flint.arb(S + at), flint.arb(middle))[0] <= over_S * (1.0 + 1e-9)
            assert bounds(flint.arb(S), flint.arb(middle + at))[1] <= over_square * (1.0 + 1e-9)


def test_energy_on_both_sides_of_the_seam_of_a_ring_is_near_its_centre() -> None:
    """Two equal kicks beside each other, on cells 10 and 1 of ten, or 3 and 4: half a cell from the centre both."""
    ring = Lattice(10, [Site("a", onsite="y")], [Bond("a", "a", (1,), "0.1*d")], "periodic")
    for cells, centre in (((9, 0), 0.5), ((2, 3), 3.5)):
        v = np.zeros(10)
        v[list(cells)] = 1.0
        found = spreading(evolve(ring, np.zeros(10), v, [0.0, 0.1]))
        assert np.mod(found.centre[0, 0] - centre + 5.0, 10.0) == pytest.approx(5.0, abs=1e-9)
        assert found.second_moment[0] == pytest.approx(0.25, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "kept"),
    [
        ([(1.0, 2.0), (1.0, 3.0), (2.0, 1.0)], [(2.0, 1.0), (1.0, 2.0)]),  # as good in one, worse in the other
        ([(1.0, 2.0), (3.0, 2.0), (0.5, 4.0)], [(1.0, 2.0), (0.5, 4.0)]),
        ([(1.0, 2.0), (1.0, 2.0)], [(1.0, 2.0)]),
        ([(1.0, 1.0), (2.0, 2.0)], [(1.0, 1.0)]),
    ],
)
def test_a_point_of_a_front_is_better_in_one_quantity_than_every_other(
    values: list[tuple[float, float]], kept: list[tuple[float, float]]
) -> None:
    assert [values[k] for k in undominated(np.array(values))] == kept


DIPS = [  # power of the rate beside the dip, floor, width, centre, depth, units of the state and of the parameter
    *(
        (2, floor, width, at, 2.0, 1.0, 1.0)
        for floor, width in ((1e-4, 0.01), (1e-5, 0.005))
        for at in (2.0, 2.03, 2.07)
    ),
    (2, 1e-4, 0.003, 2.03, 2.0, 1.0, 1.0),
    (2, 1e-4, 0.003, 2.11, 2.0, 1.0, 1.0),
    (2, 1e-3, 0.01, 2.0, 2.0, 1.0, 1.0),
    (2, 1.8e-3, 6e-3, 2.01, 4.0, 1e5, 1e-6),
    (2, 1e-4, 0.003, 2.03, 2.0, 1e-6, 1e8),
    (4, 1e-6, 0.02, 2.03, 2.0, 1e4, 1.0),
    (4, 6e-4, 0.02, 1.94, 4.0, 1e5, 1e6),
    *((4, 6e-4, 0.02, at, 4.0, 1.0, 1.0) for at in (1.86, 2.1)),
    (0, 1.0, 0.1, 2.0, 2.0, 1.0, 1.0),
]


@pytest.mark.parametrize(("power", "floor", "width", "centre", "depth", "unit", "height_unit"), DIPS)
def test_two_folds_in_a_dip_between_two_points_are_seen(
    power: int, floor: float, width: float, centre: float, depth: float, unit: float, height_unit: float
) -> None:
    """a = F(x), F' = u^power + floor (1 - depth exp(-(u/width)^2)) with u = x - centre; of power 0 the dip alone."""
    x, a, steep = ca.SX.sym("x"), ca.SX.sym("a"), float(power > 0)

    def height(u: Any, error_function: Any) -> Any:
        dip = u - 0.5 * depth * np.sqrt(np.pi) * width * error_function(u / width)
        return height_unit * (steep * u ** (power + 1) / (power + 1) + floor * dip)

    def rate(u: float) -> float:
        return float(steep * u**power + floor * (1.0 - depth * np.exp(-((u / width) ** 2))))

    model = OdeModel("dip", x, ca.SX(0.0), a)
    start, ends = model.start(x) / unit, [float(height(end - centre, erf)) for end in (1.0, 3.0)]
    condition = (height(start - centre, ca.erf) - a) / height_unit
    problem = BoundaryValueProblem(model, [condition], parameters={"a": ends[0]})
    branch = problem.solve([unit], tolerance=1e-10).follow("a", ends[1])
    fold = brentq(rate, 0.0, 3.0 * width, xtol=1e-16)
    found = [point.states[0, 0] / unit - centre for point in branch.folds]
    np.testing.assert_allclose(found, [-fold, fold], atol=1e-5)
    if power == 2 and unit == 1.0:
        walked = np.array([s.states[0, 0] - centre for s in branch.solutions if not s.point.special])
        assert np.min(np.abs(walked)) > fold


@dataclass(frozen=True)
class Meshes:
    """Largest errors between the ends of the intervals on two meshes, and what is expected of the finer one."""

    coarse: float
    fine: float
    expected: float


def measured(degree: int, transcription: str) -> Meshes:
    """x' = y, y' = -x over a turn and a half, from the state at its start."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    model = OdeModel("turning", ca.vertcat(x, y), ca.vertcat(y, -x))
    stated = BoundaryValueProblem(model, [model.start(x), model.start(y) - 1.0], interval=(0.0, 3.0 * np.pi))
    guess = {"x": np.sin, "y": np.cos}
    space = space_of(stated, guess, {"degree": degree, "transcription": transcription})
    errors, problems, unknowns = list[float](), list[BoundaryProblem](), list[Any]()
    for intervals in (18, 40):
        problem = space.levels.problem(intervals)
        found = NewtonCorrector(problem, 1e-13).correct(packed(problem, guess), problem.parameter_row(), 0.0)
        assert found.converged
        places = np.linspace(0.0, 1.0, 2001)
        errors.append(float(np.max(np.abs(problem.sample(found.z, places)[:, 0] - np.sin(3.0 * np.pi * places)))))
        problems.append(problem)
        unknowns.append(found.z)
    return Meshes(*errors, problems[0].expected_error(unknowns[0], errors[0], problems[1]))


@pytest.mark.parametrize("transcription", ["gauss", "radau"])
@pytest.mark.parametrize("degree", [3, 4, 5])
def test_the_error_that_a_finer_mesh_is_expected_to_have_is_the_one_that_it_has(
    degree: int, transcription: str
) -> None:
    """Between the ends of its intervals collocation converges with the number of stages and one."""
    found = measured(degree, transcription)
    assert found.expected == pytest.approx(found.fine, rel=0.35)
    assert abs(np.log(found.fine / found.coarse) / np.log(18 / 40) - (degree + 1)) < 0.3
