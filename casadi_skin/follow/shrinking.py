"""The end of a curve of special orbits where the orbits shrink to an equilibrium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadi_skin.follow.find import find_equilibrium
from casadi_skin.follow.follow import Following, run_following
from casadi_skin.follow.location import locate_rest
from casadi_skin.follow.rest_space import EquilibriumSpace, curve_space
from casadi_skin.follow.space import Followed
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.kinds import FOLD, HOPF, TORUS
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest import Statics, sizes_of
from casadi_skin.zero.settings import ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, stated

ENDING_KINDS = {FOLD: ("generalized hopf",), TORUS: ("hopf-hopf", "zero-hopf")}  # at which curves of orbits end
HOPF_WAY_FRACTION = 0.5  # of the way of the second parameter: how far Hopf points are followed
END_DISTANCE_FRACTION = 0.1  # of it: how far from the smallest orbit the end may be


def shrunk(space: Followed, before: Point, after: Point) -> Point | None:
    """The point of a curve of Hopf points at which the orbits have amplitude zero; None where none is found."""
    smaller = min((before, after), key=lambda point: float(np.max(np.ptp(_states(space, point), axis=0))))
    hopf = _hopf_near(space, smaller)
    if hopf is None or space.kind not in ENDING_KINDS:
        return None
    start, span = hopf.parameters[space.parameter], space.to - space.statement.values[space.parameter]
    found = list[SpecialPoint]()
    for side in (1.0, -1.0):
        to = start + side * HOPF_WAY_FRACTION * span
        curve = run_following(
            Following(curve_space(hopf, space.parameter, to, at=(), max_points=500, max_step=0.05)), None
        )
        found += [point for point in curve.special_points if point.kind in ENDING_KINDS[space.kind]]
    close = [p for p in found if abs(p.parameters[space.parameter] - start) <= END_DISTANCE_FRACTION * abs(span)]
    if not close:
        return None
    nearest = min(close, key=lambda point: abs(point.parameters[space.parameter] - start))
    return _as_orbit(space, smaller, nearest)


def _states(space: Followed, point: Point) -> Array:
    return np.asarray(space.states_at(point, np.linspace(0.0, 2.0 * np.pi, 257)[:-1], None))


def _hopf_near(space: Followed, orbit: Point) -> SpecialPoint | None:
    """The Hopf point near an orbit of small amplitude, in the first parameter, from its mean and its period."""
    model, values = space.model, space.parameters(orbit)
    assert space.singularity is not None
    name, period = space.singularity.first, space.interval(orbit)[1]
    x = _states(space, orbit).mean(axis=0)
    statics = Statics(model, {key: values[key] for key in model.parameter_names})
    unit = float(space.sizes.scalars[len(space.statement.free)])
    equilibria = EquilibriumSpace(statics, 1e-10, "newton", sizes_of([x]), parameter=name, to=values[name] + unit)
    found = locate_rest(equilibria, HOPF, np.append(x / equilibria.sizes, 0.0), 2j * np.pi / period)
    if found is None:
        return None
    course = equilibria.course
    assert course is not None
    at = {**statics.values, name: float(course.at(found.value))}
    resting = find_equilibrium(model, equilibria.problem.state(found.resting), parameters=at)
    resting = replace(resting, space=replace(resting.space, parameter=name, to=at[name] + unit))
    return SpecialPoint(HOPF, name, at, found.error * unit, resting)


def _as_orbit(space: Followed, orbit: Point, end: SpecialPoint) -> Point:
    """The end as an orbit of amplitude zero of the curve."""
    problem, z = stated(orbit.problem), orbit.z.copy()
    z[: problem.states].reshape(problem.columns, -1)[:] = end.solution.evaluate(0.0)
    for place, name in enumerate(problem.statement.free, start=problem.states):
        if name == PERIOD:
            values = end.solution.eigenvalues
            known = 2.0j * np.pi / z[place]
            z[place] = 2.0 * np.pi / float(values[np.argmin(np.abs(values - known))].imag)
        elif name in end.parameters:
            z[place] = end.parameters[name]
    start = space.statement.values[space.parameter]
    z[-1] = (end.parameters[space.parameter] - start) / (space.to - start)
    moved = end.error / abs(space.to - start) / problem.parameter_size(z)
    error = ErrorEstimate(end.solution.error, end.solution.error, parameter=moved)
    return replace(orbit, z=z, error=error, requested=False, walked=False, better=None, special=end.kind)
