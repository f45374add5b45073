"""Time evolution by a symplectic splitting."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.lattice.closed_forms import Array
from casadi_skin.model.integrators import (
    NOT_FINITE,
    IntegrationError,
    Trajectory,
    fastest_frequency,
    finite_trajectory,
    size_of,
)
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.splitting import SPLITTING_ORDER, KicksAndDrifts, srkn_step

LONGEST_FOLD = 4096  # steps in one call, so that an interruption is noticed
MOST_RETRIES = 6


def symplectic(
    model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float, step: float | None = None
) -> Trajectory:
    """States at the times t > 0 by the splitting of order 6 with a fixed step (Blanes and Moan 2002, SRKN 11b).

    Where no step is given, it is such that one step is within the tolerance of two half steps at all of the times and
    at 100 others. The times need not be multiples of the step: a shorter step leads to each from the multiple below it
    and is not gone on from, so that the map that is iterated stays one and the same. Raises IntegrationError where the
    state is not finite, or no step meets the tolerance.
    """
    splitting, scale = _Splitting(model, parameters), size_of(start)
    if step is not None:
        return finite_trajectory("symplectic", splitting.run(start, t, step), t)
    first = min(1.0 / fastest_frequency(model, parameters, start, t[-1]), float(t[-1]))
    step = splitting.fitting_step(start, first, 0.3 * tolerance)
    everywhere = np.union1d(t, np.linspace(0.0, t[-1], 101)[1:])
    for _ in range(MOST_RETRIES):
        result = splitting.run(start, everywhere, step)
        errors = splitting.step_errors(np.vstack([start, result.states]), step, scale)
        count = max(0, int(np.argmax(np.append(errors, np.inf) > tolerance)) - 1)  # without the start
        reached = everywhere[count - 1] if count else 0.0
        states = result.states[np.searchsorted(everywhere, t[t <= reached])]
        found = Trajectory(states, result.evaluations, step)
        if count == everywhere.size:
            return found
        if count == len(result.states):
            raise IntegrationError("symplectic", NOT_FINITE, found, t)
        step *= splitting.shrink(tolerance, float(errors.max()))
    reason = f"one step of {found.step:.2g} is off by up to {errors.max():.1e}; requested: {tolerance:.1e}"
    raise IntegrationError("symplectic", reason, found, t)


class _Splitting:
    """The step of the splitting and its repetitions, as CasADi functions of (q, q', h, parameters)."""

    def __init__(self, model: OdeModel, parameters: Array) -> None:
        if model.order != 2 or model.forced:
            accepted = "cvodes, dop853, or a model of second order without forcing"
            raise ValueError(f"method: given symplectic for {model.name}; accepted: {accepted}")
        self.size, self.parameters = model.full_size, parameters
        self.stages = KicksAndDrifts.of(1).kicks.size
        q, v, h, p = model.state, model.velocity, ca.SX.sym("h"), model.parameters
        x, u = srkn_step(model, h, p)
        # h and the parameters go along unchanged, so that one input is all that a fold has to repeat.
        self._step = ca.Function("step", [ca.vertcat(q, v, h, p)], [ca.vertcat(x, u, h, p)])
        self._folds: dict[int, ca.Function] = {1: self._step}

    def _columns(self, states: Array, steps: Array) -> Array:
        """States, shape (many, size), with their steps and the parameters, one a column."""
        rest = np.broadcast_to(self.parameters, (len(states), self.parameters.size))
        return np.column_stack([states, steps, rest]).T

    def _steps(self, states: Array, steps: Array) -> Array:
        """One step from each of many states, shape (many, size), each of its own length."""
        return np.array(self._step(self._columns(states, steps))).T[:, : self.size]

    def _advance(self, column: Array, count: int) -> tuple[Array, int]:
        """`count` steps, in repetitions of powers of two up to LONGEST_FOLD, fewer to a state not finite; how many."""
        left = count
        while left > 0 and np.all(np.isfinite(column)):
            many = min(LONGEST_FOLD, 1 << (left.bit_length() - 1))
            if many not in self._folds:
                self._folds[many] = self._step.fold(many)
            column, left = np.array(self._folds[many](column)), left - many
        return column, count - left

    def run(self, start: Array, t: Array, step: float) -> Trajectory:
        """States at the times t with a fixed step, up to the last one that is finite."""
        before, steps = np.floor(t / step).astype(int), t.size
        column, states = self._columns(start[None], np.array([step])), np.empty((t.size, self.size))
        for i, count in enumerate(np.diff(before, prepend=0)):
            column, taken = self._advance(column, int(count))
            steps += taken
            states[i] = column[: self.size, 0]
            if not np.all(np.isfinite(states[i])):
                states[i:] = np.nan
                break
        states = self._steps(states, t - before * step)
        finite = np.append(np.all(np.isfinite(states), axis=1), False)
        return Trajectory(states[: np.argmin(finite)], self.stages * steps, step)

    def step_errors(self, states: Array, step: float, scale: float) -> Array:
        """Largest difference between one step and two half steps from states, shape (many, size) -> (many,).

        It is relative to the largest component of the state, or to `scale` where that is larger; inf for nan.
        """
        whole, half = np.full(len(states), step), np.full(len(states), 0.5 * step)
        difference = self._steps(states, whole) - self._steps(self._steps(states, half), half)
        with np.errstate(invalid="ignore"):
            relative = np.abs(difference).max(axis=1) / np.maximum(np.abs(states).max(axis=1), scale)
        return np.asarray(np.nan_to_num(relative, nan=np.inf))

    @staticmethod
    def shrink(tolerance: float, error: float) -> float:
        """Factor of the step that brings its error below the tolerance."""
        return float(max(0.1, 0.95 * (tolerance / error) ** (1.0 / (SPLITTING_ORDER + 1))))

    def fitting_step(self, start: Array, step: float, tolerance: float) -> float:
        """A step that meets the tolerance over the first 50 steps from the start."""
        for _ in range(MOST_RETRIES):
            column, states = self._columns(start[None], np.array([step])), [start]
            for _ in range(50):
                column, _ = self._advance(column, 1)
                states.append(column[: self.size, 0])
            error = float(self.step_errors(np.array(states), step, size_of(start)).max())
            if error <= tolerance:
                break
            step *= self.shrink(tolerance, error)
        return step
