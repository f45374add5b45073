"""Following a family from a linear mode, or the branch through a solution: arguments checked, then continuation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.branch_run import Following, run_following
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Orbit, Solution, following_settings
from casadi_skin.follow.space import FAMILY
from casadi_skin.model.arguments import check_options, duration, function_of, truth
from casadi_skin.zero.family import MAX_POINTS, Method
from casadi_skin.zero.kinds import BRANCH_POINT, FOLD
from casadi_skin.zero.request import FamilyModel, family_request


def follow_family(
    model: FamilyModel,
    mode: int | str,
    amplitude_max: float,
    *,
    at: Sequence[float] = (),
    at_Omega: Sequence[float] = (),
    at_period: Sequence[float] = (),
    period_max: float | None = None,
    max_points: int = MAX_POINTS,
    time_limit: float | None = None,
    until: Callable[[Orbit], bool] | None = None,
    stability: bool = False,
    events: bool = True,
    tolerance: float = 1e-8,
    parameters: Mapping[str, float] | None = None,
    progress: Callable[[Orbit], None] | None = None,
    **method: Any,
) -> Branch:
    """Follow the family of nonlinear modes that grows from a linear mode; dimensionless, or in the model's units.

    Arguments:
        model: a `Chain`, or an `OdeModel` of second order with a declared reversal and an equilibrium at 0.
        mode: the linear mode by ascending frequency from 1, "first" or "last".
        amplitude_max: S at which the family ends: the sum of squares of the positions at the phase where all velocities
            vanish, or the S of the model's normalisation.
        at: values of S at which orbits are wanted exactly, as often as the family passes them.
        at_Omega: frequencies, likewise.
        at_period: periods, likewise.
        period_max: period at which the family ends where that comes before `amplitude_max`.
        max_points: number of orbits after which it ends wherever it is.
        time_limit: seconds after which it ends likewise, with what was computed; what is sought later, as changes of
            stability, has the seconds that are left.
        until: ends the family at the first orbit for which it is true.
        stability: whether multipliers are computed for each orbit.
        events: whether every change of stability is sought.
        tolerance: bounds the relative error of Omega, profile and multipliers.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.
        progress: called with each orbit.
        method: fields of `Method`: transcription, degree, corrector, walker, flow, tail, symmetry,
            stability_sites.

    Returns:
        The branch; one that ended early has `complete` False and a `reason`.

    Raises:
        ValueError, TypeError: an argument is out of range; the message names it.

    Collocation and pseudo-arclength continuation in scaled coordinates (paper, Sec. II; Keller 1977).
    """
    _check_choices(stability, events, until, progress)
    check_options("follow_family", method, follow_family, Method)
    seconds = duration("time_limit", time_limit)
    request = family_request(
        model, mode, amplitude_max, at=at, at_Omega=at_Omega, at_period=at_period, period_max=period_max,
        max_points=max_points, tolerance=tolerance, parameters=parameters, **method,
    )  # fmt: skip
    request = request.for_stability(method.get("walker")) if stability else request
    return run_following(Following(Family(request), stability, events, until=until, time_limit=seconds), progress)


def _check_choices(stability: object, events: object, until: object, progress: object) -> None:
    """Raises TypeError for flags that are no choice, and for callbacks that are neither a function nor None."""
    truth("stability", stability)
    truth("events", events)
    for name, function in (("until", until), ("progress", progress)):
        function_of(name, function, "a solution")


def follow(
    solution: Solution,
    parameter: str,
    to: float,
    *,
    at: Sequence[float] = (),
    max_points: int = MAX_POINTS,
    max_step: float = 0.2,
    back_to: float | None = None,
    time_limit: float | None = None,
    until: Callable[[Any], bool] | None = None,
    stability: bool = False,
    events: bool = True,
    progress: Callable[[Any], None] | None = None,
) -> Branch:
    """The branch through a solution in the direction of `to`, by pseudo-arclength continuation (Keller 1977).

    Arguments:
        solution: an equilibrium, an orbit or a solution of a boundary-value problem without objective; an orbit of a
            family is first solved again as a boundary-value problem at its S.
        parameter: name of the parameter to follow; the others keep their values.
        to: where the branch ends; it goes round folds on its way.
        at: values at which solutions are wanted exactly, as often as the branch passes them.
        max_points: number of points after which the branch ends.
        max_step: longest step, 1 being a change of the states by their own size.
        back_to: a value on the other side of the start, where a branch that comes back ends; left out, it ends at the
            value that it started from, and one of equilibria or of a forced model goes on to see whether it closes.
        time_limit: seconds after which the branch ends, with what was computed.
        until: ends the branch at the first solution for which it is true.
        stability: whether multipliers are computed for each orbit; equilibria have their eigenvalues always.
        events: whether changes of stability are located.
        progress: called with each solution.

    Returns:
        The branch. One that is a closed curve is followed once, and its end is named so.

    Raises:
        ValueError: an argument is out of range.
        BoundaryError, EquilibriumError: the start cannot be solved.
    """
    _check_choices(stability, events, until, progress)
    seconds = duration("time_limit", time_limit)
    space = following_space(solution, parameter, to, at=at, max_points=max_points, max_step=max_step, back_to=back_to)
    if stability and not space.closes:
        accepted = "for orbits, and for conditions x(end) = S x(start)"
        raise ValueError(f"stability: given for solutions that are no orbits; accepted: {accepted}")
    return run_following(Following(space, stability, events, until=until, time_limit=seconds), progress)


def following_space(
    solution: Solution, parameter: str, to: float, *, at: Sequence[float], max_points: int, max_step: float,
    back_to: float | None = None,
) -> Any:  # fmt: skip
    """The space of the branch through a solution in a parameter; raises ValueError as `follow` does."""
    if solution.space.connects == FAMILY:
        from casadi_skin.follow.find import restated

        solution = restated(solution, parameter)
    if solution.space.optimises:
        raise ValueError("follow: given a solution with an objective; accepted: one without")
    settings = following_settings(
        solution, parameter, to, at=at, max_points=max_points, max_step=max_step, back_to=back_to
    )
    _check_regular(solution, parameter)
    return solution.space.following(solution, parameter, float(to), tuple(float(np.float64(v)) for v in at), settings)


def _check_regular(solution: Solution, parameter: str) -> None:
    """Raises ValueError for a fold or a branch point, where equations at a held parameter are singular."""
    kind = solution.space.kind or solution.point.special
    if kind in (FOLD, BRANCH_POINT):
        why = f"where the equations at a held {parameter} are singular"
        accepted = f"a solution beside it, or `curve` of the {kind} itself"
        raise ValueError(f"follow: given a {kind}, {why}; accepted: {accepted}")
