"""Initial-value solvers of an `OdeModel`: SUNDIALS CVODES, Dormand-Prince of order 8, a symplectic splitting.

`tolerance` is what one step may do wrong relative to the largest component of the start, as in the paper (Sec. III).
Measured over some ten periods of chains, the error of the result is then 1 to 30 times the tolerance for every method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.splitting import srkn_coefficients
from casadi_skin.theory.linear import Array

CVODES_SHARE, CVODES_TIGHTEST = 1e-3, 1e-14  # measured: what CVODES returns is up to 4000 of its local tolerances off
CVODES_STEPS = 20_000  # allowed over PHASE radians of the stiffest vibration: ten times what the tightest run needs
PHASE = 100.0
SPLITTING_ORDER = 6
LONGEST_FOLD = 4096  # steps in one call, so that an interruption is heard
RETRIES = 12


class IntegrationError(ArithmeticError):
    """An integrator gave up; the message tells where and why in one line."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the times asked for, shape (time, 2n), evaluations of the forces, and the step where it is fixed."""

    states: Array
    evaluations: int
    step: float | None = None


def _field(model: OdeModel) -> ca.Function:
    """Function (full state, parameters) -> its dense time derivative."""
    first = model.first_order()
    return ca.Function("field", [first.state, first.parameters], [ca.densify(first.rhs)])


def _stiffness(model: OdeModel, parameters: Array, start: Array) -> float:
    """Largest absolute row sum of df/dq at the start: a bound of the largest squared frequency there."""
    jacobian = ca.DM(model.rhs_and_jacobian()(start[: model.size], parameters)[1])
    rows = np.array(jacobian.sparsity().row())
    return float(np.bincount(rows, np.abs(jacobian.nonzeros()), minlength=model.size).max())


def _scale(start: Array) -> float:
    return float(np.abs(start).max()) or 1.0


def cvodes(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by CVODES: Adams formulas, functional iteration (Hindmarsh et al. 2005).

    Raises IntegrationError where CVODES fails, with the last time it reached.
    """
    local = max(CVODES_SHARE * tolerance, CVODES_TIGHTEST)
    # The limit on steps holds from output to output: outputs in long gaps let a blow-up be noticed soon.
    gap = PHASE / (np.sqrt(_stiffness(model, parameters, start)) or 1.0)
    grid = np.union1d(t, np.arange(1, int(t[-1] / gap) + 1) * gap)
    grid = grid[grid <= t[-1]]
    first = model.first_order()
    options = {
        "reltol": local,
        "abstol": local * _scale(start),
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
        "max_num_steps": CVODES_STEPS,
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    dae = {"x": first.state, "p": first.parameters, "ode": first.rhs}
    integrator = ca.integrator("evolution", "cvodes", dae, 0.0, list(grid), options)
    try:
        states = np.array(integrator(x0=start, p=parameters)["xf"]).T
    except RuntimeError as error:
        reason = str(error).rpartition("CVode returned ")[2].partition(".")[0].strip('"')
        raise IntegrationError(_stopped("cvodes", integrator.stats()["tcur"], t, reason)) from error
    return Trajectory(_finite("cvodes", states[np.searchsorted(grid, t)], t), int(integrator.stats()["nfevals"]))


def dop853(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by the Dormand-Prince method of order 8 (Hairer, Norsett and Wanner 1993, II.5).

    The paper's integrator. Raises IntegrationError where the step becomes too small.
    """
    from scipy.integrate import solve_ivp

    state, rate = np.empty(start.size), np.empty(start.size)
    buffer, evaluate = _field(model).buffer()
    buffer.set_arg(0, memoryview(state))
    buffer.set_arg(1, memoryview(parameters))
    buffer.set_res(0, memoryview(rate))

    def right_hand_side(_: float, x: Array) -> Array:
        state[:] = x
        evaluate()
        return rate.copy()

    with np.errstate(all="ignore"):  # a state that runs away overflows before the step is found too small
        result = solve_ivp(
            right_hand_side, (0.0, t[-1]), start, "DOP853", t, rtol=tolerance, atol=tolerance * _scale(start)
        )
    if not result.success:
        reached = float(result.t[-1]) if len(result.t) else 0.0
        raise IntegrationError(_stopped("dop853", reached, t, str(result.message).strip(" .").lower()))
    return Trajectory(_finite("dop853", result.y.T, t), int(result.nfev))


def symplectic(
    model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float, step: float | None = None
) -> Trajectory:
    """States at the times t > 0 by the splitting of order 6 with a fixed step (Blanes and Moan 2002, SRKN 11b).

    Where no step is given, it is such that one step is within the tolerance of two half steps at all of the times and at
    100 others. The times need not be multiples of the step: a shorter step leads to each from the multiple below it and
    is not gone on from, so that the map that is iterated stays one and the same. Raises IntegrationError where the
    state is not finite, or no step meets the tolerance.
    """
    splitting = _Splitting(model, parameters)
    if step is not None:
        return splitting.run(start, t, step)
    step = 1.0 / (np.sqrt(_stiffness(model, parameters, start)) or 1.0)
    step = splitting.fitting_step(start, min(step, float(t[-1])), 0.3 * tolerance)
    everywhere = np.union1d(t, np.linspace(0.0, t[-1], 101)[1:])
    for _ in range(RETRIES):
        result = splitting.run(start, everywhere, step)
        error = splitting.step_error(result.states, step) / _scale(start)
        if error <= tolerance:
            states = result.states[np.searchsorted(everywhere, t)]
            return Trajectory(states, result.evaluations, step)
        step *= max(0.1, 0.9 * (tolerance / error) ** (1.0 / (SPLITTING_ORDER + 1)))
    raise IntegrationError(f"symplectic: one step of {step:.2g} is off by {error:.1e}; asked: {tolerance:.1e}")


class _Splitting:
    """The step of the splitting and its repetitions, as CasADi functions of (q, q', h, parameters)."""

    def __init__(self, model: OdeModel, parameters: Array) -> None:
        if model.order != 2:
            raise ValueError(f"{model.name}: the splitting needs a model of second order; use cvodes or dop853")
        self.size, self.parameters = model.full_size, parameters
        drifts, kicks = srkn_coefficients()
        self.stages = kicks.size
        q, v, h, p = model.state, model.velocity, ca.SX.sym("h"), model.parameters
        force = ca.Function("force", [q, p], [ca.densify(model.rhs)])
        x, u = q, v + kicks[0] * h * force(q, p)
        for drift, kick in zip(drifts, kicks[1:], strict=True):
            x = x + drift * h * u
            u = u + kick * h * force(x, p)
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

    def _advance(self, column: Array, count: int) -> Array:
        """`count` steps, in repetitions of powers of two up to LONGEST_FOLD."""
        while count > 0:
            many = min(LONGEST_FOLD, 1 << (count.bit_length() - 1))
            if many not in self._folds:
                self._folds[many] = self._step.fold(many)
            column, count = np.array(self._folds[many](column)), count - many
        return column

    def run(self, start: Array, t: Array, step: float) -> Trajectory:
        """States at the times t with a fixed step; raises IntegrationError where one is not finite."""
        before = np.floor(t / step).astype(int)
        column, states = self._columns(start[None], np.array([step])), np.empty((t.size, self.size))
        for i, count in enumerate(np.diff(before, prepend=0)):
            column = self._advance(column, int(count))
            states[i] = column[: self.size, 0]
            if not np.all(np.isfinite(states[i])):
                raise IntegrationError(_stopped("symplectic", t[i - 1] if i else 0.0, t, "it is not finite after that"))
        states = _finite("symplectic", self._steps(states, t - before * step), t)
        return Trajectory(states, self.stages * int(before[-1] + t.size), step)

    def step_error(self, states: Array, step: float) -> float:
        """Largest difference between one step and two half steps from states, shape (many, size); inf for nan."""
        whole, half = np.full(len(states), step), np.full(len(states), 0.5 * step)
        difference = self._steps(states, whole) - self._steps(self._steps(states, half), half)
        return float(np.nan_to_num(np.abs(difference).max(), nan=np.inf))

    def fitting_step(self, start: Array, step: float, tolerance: float) -> float:
        """A step that meets the tolerance over the first 50 steps from the start."""
        for _ in range(RETRIES):
            column, states = self._columns(start[None], np.array([step])), [start]
            for _ in range(50):
                column = self._advance(column, 1)
                states.append(column[: self.size, 0])
            error = self.step_error(np.array(states), step) / _scale(start)
            if error <= tolerance:
                return step
            step *= max(0.1, 0.95 * (tolerance / error) ** (1.0 / (SPLITTING_ORDER + 1)))
        return step


def _finite(method: str, states: Array, t: Array) -> Array:
    """The states; raises IntegrationError where one is not finite."""
    bad = ~np.all(np.isfinite(states), axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise IntegrationError(_stopped(method, t[first - 1] if first else 0.0, t, "it is not finite after that"))
    return states


def _stopped(method: str, reached: float, t: Array, reason: str) -> str:
    return f"{method}: the state was followed to t = {reached:.6g} of {t[-1]:.6g}: {reason}"


Integrator = Callable[[OdeModel, Array, Array, Array, float], Trajectory]
