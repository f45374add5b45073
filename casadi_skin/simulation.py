"""Time evolution of any model by SUNDIALS CVODES, and the cycle that it settles on: guesses for orbits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_skin.arguments import number, numbers, short_repr
from casadi_skin.bvp.statement import named_values
from casadi_skin.integrators import IntegrationError, Trajectory
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.ode import OdeModel

Array = NDArray[np.float64]
LOCAL = 1e-2  # local tolerance per tolerance: errors of steps add up
STEPS = 100_000  # from output to output
FEWEST = 40  # output times that a cycle is looked for in
CLOSED = 0.02  # distance of two states a cycle apart, relative to the cycle's size


@dataclass(frozen=True, eq=False)
class Simulation:
    """States of a first-order `model` at the times t, shape (time, component), at fixed parameters."""

    model: OdeModel
    parameters: Array
    t: Array
    states: Array

    @cached_property
    def _curve(self) -> Any:
        from scipy.interpolate import CubicHermiteSpline

        rates = self.model.vector_field.map(self.t.size)(
            self.t[None], self.states.T, np.tile(self.parameters[:, None], self.t.size)
        )
        return CubicHermiteSpline(self.t, self.states, np.array(rates).T)

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times between the first and the last, shape (time, component), by cubic Hermite interpolation."""
        times = np.atleast_1d(np.asarray(t, dtype=float))
        if np.any((times < self.t[0]) | (times > self.t[-1])):
            raise ValueError(f"t: given {times.min():g} to {times.max():g}; accepted: {self.t[0]:g} to {self.t[-1]:g}")
        return np.asarray(self._curve(times))

    def last_cycle(self) -> Cycle:
        """The last stretch of time over which the state comes back to itself; raises ValueError where it does not."""
        if self.t.size < FEWEST:
            raise ValueError(f"last_cycle: given {self.t.size} output times; accepted: {FEWEST} or more, 20 a cycle")
        half = self.states[self.t.size // 2 :]
        spread = np.ptp(half, axis=0)
        component = int(np.argmax(np.std(half, axis=0)))
        level = float(np.mean(half[:, component]))
        below = self.states[:, component] < level
        up = np.flatnonzero(below[:-1] & ~below[1:])
        for earlier in up[-2::-1]:
            start, end = (self._crossing(i, component, level) for i in (earlier, up[-1]))
            gap = np.abs(self.evaluate(start) - self.evaluate(end))[0]
            if np.all(gap <= CLOSED * np.maximum(spread, 1e-9 * spread.max())):
                return Cycle(self, start, end - start)
        raise ValueError(f"last_cycle: from t = {self.t[0]:g} to {self.t[-1]:g} the state does not come back to itself")

    def _crossing(self, i: int, component: int, level: float) -> float:
        from scipy.optimize import brentq

        return float(brentq(lambda t: self._curve(t)[component] - level, self.t[i], self.t[i + 1]))


@dataclass(frozen=True, eq=False)
class Cycle:
    """A stretch of a simulation after which it repeats itself: a guess for `find_orbit`, period included."""

    simulation: Simulation
    start: float
    period: float

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times from the start of the cycle on, shape (time, component)."""
        times = np.mod(np.atleast_1d(np.asarray(t, dtype=float)), self.period)
        return self.simulation.evaluate(np.clip(self.start + times, self.start, self.simulation.t[-1]))


def simulate(
    model: OdeModel,
    start: ArrayLike,
    t: ArrayLike,
    *,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-9,
) -> Simulation:
    """Follow a model in time from a first-order state `start` at the first of the times t, ascending, by CVODES (BDF).

    `parameters` are values by name, where they are not the model's nominal ones. `tolerance` is relative to the
    largest component of the start. Raises ValueError for arguments that do not fit, IntegrationError where CVODES
    fails.
    """
    first = model.first_order()
    p, x = np.array(list(named_values(first, parameters or {}).values())), np.array(numbers("start", np.ravel(start)))
    if x.size != first.full_size:
        raise ValueError(f"start: given {x.size} states; accepted: {first.full_size}, {', '.join(first.state_names)}")
    times = np.array(numbers("t", np.ravel(t)))
    if times.size < 2 or np.any(np.diff(times) <= 0):
        raise ValueError(f"t: given {short_repr(times.tolist())}; accepted: two or more times, ascending")
    if not 1e-13 <= number("tolerance", tolerance) <= 1e-2:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-13 to 1e-2")
    return Simulation(first, p, times, _integrated(first, p, x, times, tolerance))


def _integrated(model: OdeModel, p: Array, start: Array, times: Array, tolerance: float) -> Array:
    kind = type(model.state)
    t, x, parameters = kind.sym("t"), kind.sym("x", model.full_size), kind.sym("p", p.size)
    local = max(LOCAL * tolerance, 1e-15)
    options = {
        "reltol": local,
        "abstol": local * (float(np.max(np.abs(start))) or 1.0),
        "max_num_steps": STEPS,
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    dae = {"t": t, "x": x, "p": parameters, "ode": model.vector_field(t, x, parameters)}
    nothing = Trajectory(np.empty((0, start.size)), 0)
    integrator = ca.integrator("simulation", "cvodes", dae, float(times[0]), list(times[1:]), options)
    try:
        with interrupts_deferred(end_solver=True):
            states = np.array(integrator(x0=start, p=p)["xf"]).T
    except RuntimeError as error:
        reason = str(error).rpartition("CVode returned ")[2].partition(".")[0].strip('"') or "an error"
        raise IntegrationError("cvodes", f"it returned {reason}", nothing, times) from error
    if not np.all(np.isfinite(states)):
        raise IntegrationError("cvodes", "the state is not finite", nothing, times)
    return np.vstack([start[None], states])
