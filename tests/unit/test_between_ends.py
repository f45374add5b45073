"""A Newton step on a finer mesh by the equations between the ends of intervals: that of all equations together."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit
from casadi_skin.solve.between_ends import step_on_finer
from casadi_skin.solve.levels import FOLD_TANGENT_RATIO, at_parameter
from casadi_skin.zero.problem import Scalar


def van_der_pol(transcription: str) -> Any:
    """Solutions on coarse meshes, closed by conditions and an integral for the phase."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    model = OdeModel("vdp", ca.vertcat(x, y), ca.vertcat(y, mu * (1.0 - x**2) * y - x), mu)
    guess = lambda t: [2 * np.cos(t), -2 * np.sin(t)]  # noqa: E731
    orbit = find_orbit(model, guess, 6.6, parameters={"mu": 1.0}, transcription=transcription, tolerance=1e-5)
    return orbit.follow("mu", 3.0)


def mathieu(transcription: str) -> Any:
    """Conditions at both ends, one free parameter and an integral of the states."""
    u, v, t, a, q = (ca.SX.sym(name) for name in ("u", "v", "t", "a", "q"))
    field = ca.vertcat(v, -(a - 2.0 * q * ca.cos(2.0 * t)) * u)
    model = OdeModel("mathieu", ca.vertcat(u, v), field, ca.vertcat(a, q), time=t, forcing_period=np.pi)
    ends, interval = [model.start(v), model.end(v)], (0.0, np.pi / 2)
    problem = BoundaryValueProblem(model, ends, [u**2 - 1], interval, {"a": 4.0, "q": 0.0}, ["a"])
    guess = lambda t: [np.sqrt(2.0) * np.cos(2 * t), -2 * np.sqrt(2.0) * np.sin(2 * t)]  # noqa: E731
    return problem.solve(guess, tolerance=1e-5, transcription=transcription).follow("q", 2.0)


@needs_kernels
@pytest.mark.parametrize("followed", [van_der_pol, mathieu])
@pytest.mark.parametrize("transcription", ["gauss", "radau"])
@pytest.mark.parametrize("along", [False, True])
def test_a_step_between_ends_is_that_of_all_equations(followed: Any, transcription: str, along: bool) -> None:
    branch = followed(transcription)
    point, levels = branch.solutions[2].point, branch.space.levels
    problem, z, tangent = point.problem, point.z, point.tangent if along else None
    finer = levels.finer(problem)
    least = FOLD_TANGENT_RATIO * problem.parameter_size(z)
    found = step_on_finer(problem, finer, z, tangent, least)
    with numpy_alone():
        assert step_on_finer(problem, finer, z, tangent, least) is None
    on_finer, ways = levels._on_finer(problem, z, tangent, None if along else Scalar.PARAMETER)
    step = at_parameter(finer, on_finer.z[0], on_finer.steps[0], None if ways is None else ways[0])
    assert np.max(np.abs(step)) > 1e-9
    np.testing.assert_allclose(found, on_finer.z[0] - step, rtol=0, atol=1e-4 * np.max(np.abs(step)))
    assert found[-1] == on_finer.z[0][-1]
