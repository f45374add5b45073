"""The branch that leaves at a special point: cycles at a Hopf point, the other branch at a branch point."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.follow.boundary_space import up_to_period
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.branch_points import other_direction
from casadi_skin.follow.follow import BranchRun, following_space, monitored_space
from casadi_skin.follow.rest_space import EquilibriumSpace, find_equilibrium
from casadi_skin.follow.solution import Equilibrium, Orbit, Solution, following_settings
from casadi_skin.follow.space import EquilibriumError
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.arguments import duration
from casadi_skin.model.result import in_turn
from casadi_skin.points.leaving import DEFAULT_TOLERANCE, born_at, leaving_solutions
from casadi_skin.points.lost_symmetry import breaking_space, start_of
from casadi_skin.solve.newton import Correction
from casadi_skin.zero.balanced import ROUNDED_COMPONENT_RATIO
from casadi_skin.zero.family import MAX_POINTS
from casadi_skin.zero.kinds import HOPF, kind_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest import Course, power_of_two, sizes_at, sizes_of
from casadi_skin.zero.settings import ContinuationSettings, Point

PROBE_STEP = 1e-2  # of the unit of length: a step along the branch that leaves, for the direction of its parameter
SHORT = 1e-4  # of the range of the parameter: a step along the branch that leaves, for its units
PROBE_TRIES = 20  # of such steps
ROUNDED_TANGENT_RATIO = 1e-6  # of the largest: components of a tangent that are rounding
DIFFERENCE_STEP = 1e-4  # of the units of the unknowns: that of second derivatives
SAME_DIRECTION_DISTANCE = 1e-4  # of a direction: the difference that distinguishes two branches


@in_turn
def switch(
    point: SpecialPoint,
    parameter: str,
    to: float,
    *,
    side: int = 1,
    at: Sequence[float] = (),
    max_points: int = MAX_POINTS,
    max_step: float = 0.2,
    back_to: float | None = None,
    time_limit: float | None = None,
    until: Callable[[Any], bool] | None = None,
    stability: bool = False,
    events: bool = True,
    monitors: Mapping[str, Any] | None = None,
    period_max: float | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    progress: Callable[[Any], None] | None = None,
) -> Branch:
    """The branch that leaves at a special point.

    At a Hopf point that of the cycles born there, from amplitude zero, or that of the equilibria to which orbits have
    shrunk; at a branch point the other branch; at a period doubling the orbits of twice the period.

    Arguments:
        point: a Hopf point or a branch point of equilibria; of orbits the Hopf point at which they end, a period
            doubling, or a branch point that the other branch leaves to both sides, as where a symmetry is lost; of a
            family too, whose amplitude is then a parameter, "S"; of boundary-value problems a branch point or, where
            solutions close, a period doubling.
        parameter: name of the parameter to follow: at a branch point that in which it was found.
        to: where the branch ends.
        side: 1 or -1: which half of a branch whose halves leave towards the same parameters; that along which the
            component that changes most grows is 1.
        at, max_points, max_step, time_limit, until, events, monitors, period_max, progress: as in `follow`.
        back_to: as in `follow`; left out, cycles and orbits end as far to the other side as `to` is to this side.
        stability: whether multipliers are computed for each cycle.
        tolerance: of cycles, as in `find_orbit`.

    Returns:
        The branch, whose first solution is the special point itself; a branch of cycles also ends where it has gone as
        far to the other side as `to` is to this side.

    Raises:
        ValueError: an argument is out of range, or no branch leaves there towards `to`.
        BoundaryError, EquilibriumError: the branch cannot be started.
    """
    seconds = duration("time_limit", time_limit)
    space = leaving_space(
        point, parameter, to, side=side, at=at, max_points=max_points, max_step=max_step, tolerance=tolerance,
        back_to=back_to,
    )  # fmt: skip
    space = monitored_space(up_to_period(space, period_max), monitors)
    return BranchRun(space, stability, events, until=until, time_limit=seconds).to_end(progress)


def leaving_space(
    point: SpecialPoint, parameter: str, to: float, *, side: int, tolerance: float, **options: Any
) -> Any:
    """The space of the branch that leaves at a special point; options are those of `switch`, checked here."""
    solution = point.solution
    if side not in (1, -1):
        raise ValueError(f"side: given {side!r}; accepted: 1 or -1")
    if point.kind == HOPF and solution.is_orbit:
        return following_space(_at_rest(solution), parameter, to, **options)
    of_family, rests = point.mu is not None and solution.is_orbit, solution.is_equilibrium
    born, turns = point.kind == HOPF and rests, kind_of(point.kind).turns
    if not (of_family or born or turns == 1 or (turns and not rests)):
        accepted = "a Hopf point of equilibria, a period doubling, or a branch point"
        raise ValueError(f"follow: given a {point.kind} of {_kind_of(solution)}; accepted: {accepted}")
    start = start_of(solution) if of_family else solution
    settings = following_settings(start, parameter, to, **options)
    both = replace(settings, parameter_min=settings.parameter_min or -1.0, closing=False)
    to, at = float(to), tuple(float(value) for value in options["at"])
    if of_family:
        return breaking_space(solution, point.mu, parameter, to, at, both, side, start)  # type: ignore[arg-type]
    if not rests:
        return leaving_solutions(solution, turns, parameter, to, at, both, side)
    if born:
        statics = solution.space.statics.at(solution.parameters)
        return born_at(statics, _seen(solution), point.frequency, parameter, to, at, both, tolerance)
    return other_branch(point, parameter, to, at, settings, side)


def _seen(equilibrium: Equilibrium) -> Array:
    """Its state; what rounding leaves of a component that is zero has no size."""
    x = equilibrium.positions
    return np.where(np.abs(x) > ROUNDED_COMPONENT_RATIO * equilibrium.space.sizes, x, 0.0)


def _at_rest(orbit: Orbit) -> Equilibrium:
    """The equilibrium that an orbit of amplitude zero is, with the sizes of the branch of orbits."""
    space = orbit.space
    values = {name: orbit.parameters[name] for name in space.given.parameter_names}
    found = find_equilibrium(space.given, orbit.evaluate(0.0), parameters=values)
    sizes = sizes_of(found.space.statics, [found.positions, space.sizes.states[: found.positions.size]])
    return replace(found, space=replace(found.space, sizes=sizes))


def _kind_of(solution: Solution) -> str:
    if solution.is_equilibrium:
        return "equilibria"
    return "orbits" if solution.is_orbit else "a boundary-value problem"


# The other branch at a branch point -----------------------------------------------------------------------------------


def other_branch(
    point: SpecialPoint, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings, side: int
) -> EquilibriumSpace:
    """The space of the other branch at a branch point of equilibria; raises ValueError where it goes elsewhere."""
    solution = point.solution
    space = solution.space
    if parameter != point.parameter:
        raise ValueError(f"parameter: given {parameter!r}; accepted: {point.parameter}, in which the point was found")
    direction = _other_direction(space, solution.point)
    statics = space.statics.at(solution.parameters)
    old, value = space.course, solution.parameters[parameter]
    assert old is not None
    n, span, x = statics.size, to - value, _seen(solution)
    sizes = sizes_at(statics, x, (Course(parameter, value, to),), space.sizes)
    leaving, z, tangent = _towards(space, solution, direction, sizes, to, settings, at)
    reach = _reach(leaving, z, tangent)
    if reach is not None:  # in units of the branch that leaves, where those of the point say nothing
        grown, silent = np.abs(tangent[:n]), np.abs(x) <= ROUNDED_COMPONENT_RATIO * sizes
        sizes = power_of_two(
            np.where(silent & (grown > ROUNDED_TANGENT_RATIO * np.max(grown)), reach * grown * sizes, sizes)
        )
        leaving, z, tangent = _towards(space, solution, direction, sizes, to, settings, at)
    for sign in (float(side), -float(side)) if abs(tangent[-1]) > SAME_DIRECTION_DISTANCE else (float(side),):
        if _goes_on(leaving, z, sign * tangent):
            first = replace(solution.point, problem=leaving.problem, z=z, tangent=sign * tangent, special="")
            return replace(leaving, first=first)
    elsewhere = "below" if span > 0 else "above"
    raise ValueError(
        f"to: given {to!r}; accepted: a value {elsewhere} {solution.parameters[parameter]:.10g}, to which the other "
        "branch goes"
    )


def _towards(
    space: EquilibriumSpace, solution: Equilibrium, direction: Array, sizes: Array, to: float,
    settings: ContinuationSettings, at: tuple[float, ...],
) -> tuple[EquilibriumSpace, Array, Array]:  # fmt: skip
    """The space of a branch that leaves, with its start and its unit tangent there; the largest component grows."""
    statics, old = space.statics.at(solution.parameters), space.course
    assert old is not None
    n, span = statics.size, to - solution.parameters[space.parameter]
    leaving = EquilibriumSpace(
        statics, space.tolerance, space.corrector, sizes,
        parameter=space.parameter, to=to, settings=settings, at=at, leaves=True,
    )  # fmt: skip
    tangent = np.append(direction[:n] * space.sizes / sizes, direction[-1] * (old.to - old.start) / span)
    z = np.append(_seen(solution) / sizes, 0.0)
    weights = leaving.point_solver.metric(leaving.problem, z)
    tangent = tangent / np.sqrt(np.sum(weights * tangent**2)) * np.sign(tangent[np.argmax(np.abs(tangent[:n]))])
    return leaving, z, np.asarray(tangent)


def _stepped(space: EquilibriumSpace, z: Array, tangent: Array, step: float) -> Correction:
    """The correction of a step along a tangent."""
    row = space.point_solver.metric(space.problem, z) * tangent
    guess = z + step * tangent
    return space.levels.corrector(space.problem).correct(guess, row, float(row @ guess))


def _reach(space: EquilibriumSpace, z: Array, tangent: Array) -> float | None:
    """How far along its tangent a branch has gone where the parameter has gone its range, to leading order.

    None where no step shows it.
    """
    step = PROBE_STEP
    for _ in range(PROBE_TRIES):
        correction = _stepped(space, z, tangent, step)
        gone = abs(float(correction.z[-1])) if correction.converged else np.inf
        if SHORT / 30.0 <= gone <= SHORT * 30.0:
            evenly = abs(float(tangent[-1])) * step > 0.5 * gone
            return step / (gone if evenly else float(np.sqrt(gone)))
        step *= float(np.clip(np.sqrt(SHORT / max(gone, 1e-300)), 1e-2, 1e2))
    return None


def _goes_on(space: EquilibriumSpace, z: Array, tangent: Array) -> bool:
    """Whether the parameter goes on to its end along a tangent, judged after a small step along it."""
    correction = _stepped(space, z, tangent, PROBE_STEP)
    if not correction.converged:
        raise EquilibriumError(f"{space.model.name}: the other branch cannot be started: {correction.status.value}")
    return bool(correction.z[-1] > 0.0)


def _other_direction(space: EquilibriumSpace, point: Point) -> Array:
    """The tangent of the other branch, from the quadratic terms of the equations on their null space (Keller 1977)."""
    problem, z = space.problem, point.z
    units = problem.units_of_all(z)
    found = problem.null_space(z, _off(point, units))
    several = found.vanishing
    if several > 1:
        why = f"{several} eigenvalues vanish at once; accepted: a branch point of one, as where less symmetry is left"
        raise EquilibriumError(f"{space.model.name}: more than two branches cross at the branch point: {why}")
    first, second, psi = found.right[:, -1] / units, found.right[:, -2] / units, found.left[:, -1]

    def form(a: Array, b: Array) -> float:
        h = DIFFERENCE_STEP / np.max(np.abs(a)) * units * a
        change = (problem.jacobian(z + h) - problem.jacobian(z - h)) @ (units * b)
        return float(psi @ change * np.max(np.abs(a)) / (2.0 * DIFFERENCE_STEP))

    along = point.tangent / units / np.linalg.norm(point.tangent / units)
    direction, discriminant = other_direction(form, first, second, along)
    if not discriminant > 0.0:
        raise EquilibriumError(f"{space.model.name}: no two branches cross at the branch point, to second order")
    return units * direction


def _off(point: Point, units: Array) -> Array:
    """What the unknowns of a special point may be off by: along the branch, and each by its error."""
    profile = point.error.profile if np.isfinite(point.error.profile) else 0.0
    rate = abs(float(point.tangent[-1]))
    along = (
        point.tangent * (point.error.parameter / rate)
        if rate > SAME_DIRECTION_DISTANCE
        else np.zeros_like(point.tangent)
    )
    return np.asarray(along + profile * units)
