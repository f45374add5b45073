"""A model followed from any state and any time, stiff or not, for guesses of orbits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.equations import PHYSICAL, EquationsOfMotion
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.evolve import far_state
from casadi_skin.lattice.uniform_chain import Array
from casadi_skin.model.arguments import by_name, number, short_repr, state_by_name
from casadi_skin.model.arrays import real_array
from casadi_skin.model.cvodes import stiff_cvodes
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.trajectory import IntegrationError


def simulate(
    model: OdeModel,
    start: ArrayLike | Mapping[str, float],
    t: ArrayLike,
    *,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-9,
) -> Evolution:
    """Follow a model in time by CVODES with formulas for stiff equations (BDF).

    Arguments:
        model: any model; one of second order is followed in positions and velocities.
        start: the state at the first of the times, shape (component,), or numbers by state name, others 0.
        t: two or more times, ascending.
        parameters: values by name, where they are not the model's nominal ones.
        tolerance: relative to the largest component of the start.

    Returns:
        States at all times; its `last_cycle()` is a guess for `find_orbit`.

    Raises:
        ValueError, TypeError: an argument does not fit the model.
        IntegrationError: CVODES fails, as where a state runs to infinity: with the times and the component.
    """
    if not isinstance(model, OdeModel):
        raise TypeError(f"model: given {short_repr(model)}; accepted: an OdeModel")
    equations = EquationsOfMotion(model.first_order(), by_name("parameters", parameters))
    given = state_by_name("start", start, equations.names) if isinstance(start, Mapping) else start
    x = real_array("start", given).ravel()
    if x.size != equations.size:
        raise ValueError(f"start: given {x.size} states; accepted: {equations.size}, {', '.join(equations.names)}")
    times = real_array("t", t).ravel()
    if times.size < 2 or np.any(np.diff(times) <= 0):
        raise ValueError(f"t: given {short_repr(times.tolist())}; accepted: two or more times, ascending")
    if not 1e-13 <= number("tolerance", tolerance) <= 1e-2:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-13 to 1e-2")
    try:
        later = stiff_cvodes(equations.physical, equations.values, x, times[1:], tolerance, float(times[0]))
    except IntegrationError as error:
        raise _in_words(error, equations, x, times) from error
    states = np.vstack([x[None], later.states])
    return Evolution(equations, times, states, "cvodes", tolerance, PHYSICAL, later.evaluations)


def _in_words(error: IntegrationError, equations: EquationsOfMotion, start: Array, times: Array) -> IntegrationError:
    """The failure with the time of the last state and its largest component in place of CVODES' word alone."""
    before = error.trajectory.states
    state, time = (before[-1], float(times[len(before)])) if len(before) else (start, float(times[0]))
    escape = far_state(equations, state, time, float(times[-1]))
    if escape is not None:
        reason = f"{escape[1]} runs to infinity: it is {escape[2]:.3g} at t = {escape[0]:.6g}"
    else:
        k = int(np.argmax(np.abs(state)))
        reason = f"{equations.names[k]} = {state[k]:.3g} is its largest component there, and CVODES {error.reason}"
    return IntegrationError("cvodes", reason, error.trajectory, times[1:], float(times[0]))
