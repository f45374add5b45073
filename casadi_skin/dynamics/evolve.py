"""Time evolution of any model from any start."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.equations import GAUGE, PHYSICAL, EquationsOfMotion, MovingModel, equations_of_motion
from casadi_skin.dynamics.evolution import Evolution, EvolutionError
from casadi_skin.model import methods
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.trajectory import IntegrationError, Integrator, Trajectory
from casadi_skin.zero.problem import Array

SYMPLECTIC = "symplectic"
FAR = 1e6  # times the largest component, beyond which a state has escaped
MOST_STEPS = 20_000  # in which it escapes


def evolve(
    model: MovingModel | OdeModel,
    positions: ArrayLike,
    velocities: ArrayLike | None,
    t: ArrayLike,
    method: str = "cvodes",
    tolerance: float = 1e-11,
    coordinates: str | None = None,
    *,
    step: float | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Evolution:
    """Solve the equations of motion from a state at time 0.

    Arguments:
        model: a `Chain`, or any `OdeModel`, forced or not.
        positions: displacements, shape (position,); the whole state of a model of first order.
        velocities: shape (position,); None where they are zero, and for a model of first order.
        t: the wanted times, ascending from 0 on.
        method: "cvodes" (SUNDIALS: Adams formulas for models of second order, else BDF), "dop853" (as in the paper), or
            "symplectic" (order 6, for forces that depend on positions alone and for long runs: the energy oscillates
            and does not drift).
        tolerance: of one step, relative to the largest component of the start.
        coordinates: "gauge" or "physical"; the gauge by default for a `Chain`, and for a model of second order whose
            linear equations another scale of the positions makes symmetric.
        step: fixed step of "symplectic"; by default it follows from the tolerance.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.

    Returns:
        States at the times, in the coordinates of the model.

    Raises:
        ValueError: an argument is out of range, or a site of a chain with |gamma| = 1 moves that has no gauge.
        EvolutionError: the integrator fails.
    """
    _check_choices(method, tolerance, coordinates, step)
    equations = equations_of_motion(model, parameters)
    times, start = _times(t), _start(equations, positions, velocities)
    return _evolved(equations, start, times, method, tolerance, coordinates, step)


def _evolved(
    equations: EquationsOfMotion,
    start: Array,
    times: Array,
    method: str,
    tolerance: float,
    coordinates: str | None = None,
    step: float | None = None,
) -> Evolution:
    """States at times, shape (times,), from a state (component,) at time 0; raises as `evolve`."""
    if coordinates is None:
        coordinates = GAUGE if equations.gauge_is_default else PHYSICAL
    model, values, scale = equations.in_coordinates(coordinates)
    n, factors = equations.positions, np.tile(scale, model.order)
    origin = start
    if coordinates == GAUGE:
        origin = np.concatenate(
            [equations.to_gauge(start[:n], "positions"), equations.to_gauge(start[n:], "velocities")]
        )
    later = times[times > 0]
    trajectory, failure = Trajectory(np.empty((0, start.size)), 0, step), None
    try:
        if later.size:
            trajectory = _integrator(method, step)(model, values, origin, later, tolerance)
    except IntegrationError as error:
        trajectory, failure = error.trajectory, error
    states = factors * np.vstack([origin[None]] * int(times[0] == 0) + [trajectory.states])
    how = (method, tolerance, coordinates, trajectory.evaluations, trajectory.step)
    evolution = Evolution(equations, times[: len(states)], states, *how)
    if failure is not None:
        reason = equations.escape or escape_of(equations, states[-1] if len(states) else start, times[-1])
        why = f"; {reason}" if reason else ""
        raise EvolutionError(f"{failure}{why}", evolution if len(states) else None) from failure
    return evolution


def escape_of(equations: EquationsOfMotion, state: Array, duration: float) -> str:
    """Which component runs to infinity from a state in finite time, in words; empty where none does soon."""
    found = far_state(equations, state, 0.0, duration)
    return "" if found is None else f"{found[1]} runs to infinity"


def far_state(equations: EquationsOfMotion, state: Array, time: float, end: float) -> tuple[float, str, float] | None:
    """When a component is far away, by name, and its value then, from a state at a time; None where none is soon.

    Positions alone count where there are some.
    """
    from scipy.integrate import DOP853

    field, values, moving = equations.physical.vector_field, equations.values, equations.positions or None
    far = FAR * max(1.0, float(np.max(np.abs(state))))
    with np.errstate(all="ignore"):
        rule = DOP853(lambda t, x: np.array(field(t, x, values)).ravel(), time, state, end, rtol=1e-6)
        for _ in range(MOST_STEPS):  # a stiff model would take very many
            rule.step()
            k = int(np.argmax(np.abs(rule.y[:moving])))
            if abs(rule.y[k]) > far:
                return float(rule.t), equations.names[k], float(rule.y[k])
            if rule.status != "running":
                break
    return None


def _integrator(method: str, step: float | None) -> Integrator:
    integrator: Integrator = methods.INTEGRATORS[method].load()
    return partial(integrator, step=step) if method == SYMPLECTIC else integrator  # type: ignore[call-arg]


# Arguments ------------------------------------------------------------------------------------------------------------


def _check_choices(method: str, tolerance: float, coordinates: str | None, step: float | None) -> None:
    for name, value, accepted in (
        ("method", method, tuple(methods.INTEGRATORS)),
        ("coordinates", coordinates or GAUGE, (GAUGE, PHYSICAL)),
    ):
        if value not in accepted:
            raise ValueError(f"{name}: given {value!r}; accepted: {', '.join(accepted)}")
    if not 1e-13 <= tolerance <= 1e-2:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-13 to 1e-2")
    if step is not None and method != SYMPLECTIC:
        raise ValueError(f"step: given {step!r} with {method}; accepted: with {SYMPLECTIC}, whose step is fixed")
    if step is not None and not (np.isfinite(step) and step > 0):
        raise ValueError(f"step: given {step!r}; accepted: a finite number > 0")


def _times(t: ArrayLike) -> Array:
    times = np.atleast_1d(np.asarray(t, dtype=float))
    if times.ndim != 1 or times.size == 0:
        raise ValueError(f"t: given shape {times.shape}; accepted: one or more times")
    if not np.all(np.isfinite(times)) or times[0] < 0 or np.any(np.diff(times) <= 0):
        raise ValueError("t: given times that are not finite, not ascending or negative; accepted: ascending from 0 on")
    return times


def _start(equations: EquationsOfMotion, positions: ArrayLike, velocities: ArrayLike | None) -> Array:
    """Positions and velocities, or the state of a model of first order, shape (component,)."""
    n, names = equations.positions, equations.names
    if n == 0:
        if velocities is not None and np.size(velocities):
            raise ValueError(f"velocities: given for {equations.physical.name}, of first order; accepted: None")
        return checked_vector("positions", positions, names, equations.size)
    x = checked_vector("positions", positions, names[:n], n)
    v = np.zeros(n) if velocities is None else checked_vector("velocities", velocities, names[n:], n)
    return np.concatenate([x, v])


def checked_vector(name: str, given: ArrayLike, components: tuple[str, ...], *sizes: int) -> Array:
    """A vector of one of the sizes; raises ValueError for other shapes and values that are not finite."""
    vector = np.array(given, dtype=float)
    if vector.shape not in [(size,) for size in sizes]:
        accepted = " or ".join(f"({size},)" for size in sizes)
        raise ValueError(f"{name}: given shape {vector.shape}; accepted: shape {accepted}")
    if not np.all(np.isfinite(vector)):
        raise ValueError(f"{name}: given a value that is not finite at {components[np.argmin(np.isfinite(vector))]}")
    return vector
