"""Initial-value solvers of an `OdeModel`: SUNDIALS CVODES, Dormand-Prince of order 8, a symplectic splitting.

`tolerance` is what one step may do wrong relative to the largest component of the start, as in the paper (Sec. III).
Measured over seven periods of the paper's breather, perturbed or not, the error of the result relative to its largest
component is 0.03 to 25 times the tolerance, of CVODES at most twice down to 1e-12 and 1e-12 to 2e-12 at 1e-13.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.splitting import srkn_coefficients
from casadi_skin.theory.linear import Array

CVODES_SHARE, CVODES_TIGHTEST = 1e-3, 1e-15  # measured: what CVODES returns is up to 1500 of its local tolerances off
CVODES_ITERATION = 1e-3  # share of a step's error left to the iteration; at the default, 0.1, the order falls to 5
CVODES_STEPS = 200  # allowed per radian of the stiffest vibration: ten times what the tightest run needs
CVODES_GAP = 100.0  # radians from output to output
LONGEST = 1e8  # radians that may be followed: a thousand times 10^4 periods of a chain
SPLITTING_ORDER = 6
LONGEST_FOLD = 4096  # steps in one call, so that an interruption is heard
RETRIES = 6
NOT_FINITE = "it is not finite then"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the times asked for, shape (time, 2n), evaluations of the forces, and the step where it is fixed."""

    states: Array
    evaluations: int
    step: float | None = None


class IntegrationError(ArithmeticError):
    """An integrator gave up: the message tells where and why in one line, `trajectory` holds the states before that."""

    def __init__(self, method: str, reason: str, trajectory: Trajectory, t: Array) -> None:
        count = len(trajectory.states)
        reached = t[count - 1] if count else 0.0
        super().__init__(f"{method}: the state was followed to t = {reached:.6g} of {t[-1]:.6g}: {reason}")
        self.trajectory = trajectory


def _field(model: OdeModel) -> ca.Function:
    """Function (full state, parameters) -> its dense time derivative."""
    first = model.first_order()
    return ca.Function("field", [first.state, first.parameters], [ca.densify(first.rhs)])


def _stiffest(model: OdeModel, parameters: Array, start: Array, end: float) -> float:
    """Bound of the largest frequency at the start and at rest, from the row sums of df/dq.

    Raises ValueError where `end` is out of reach of any integrator.
    """
    evaluate, square = model.rhs_and_jacobian(), 0.0
    for q in (start[: model.size], np.zeros(model.size)):
        jacobian = ca.DM(evaluate(q, parameters)[1])
        rows = np.array(jacobian.sparsity().row())
        square = max(square, float(np.bincount(rows, np.abs(jacobian.nonzeros()), minlength=model.size).max()))
    frequency = float(np.sqrt(square))
    if not frequency * end <= LONGEST:
        radians = f"{frequency * end:.2g} radians of the fastest vibration"
        raise ValueError(f"t: given up to {end:.6g}, which is {radians} at the start; accepted: up to {LONGEST:g}")
    return frequency or 1.0


def _scale(start: Array) -> float:
    return float(np.abs(start).max()) or 1.0


def cvodes(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by CVODES: Adams formulas, functional iteration (Hindmarsh et al. 2005).

    Raises IntegrationError where CVODES fails, with the last time it reached.
    """
    local = max(CVODES_SHARE * tolerance, CVODES_TIGHTEST)
    # The limit on steps holds from output to output: outputs in long gaps let a blow-up be noticed soon.
    gap = CVODES_GAP / _stiffest(model, parameters, start, t[-1])
    grid = np.union1d(t, np.arange(gap, t[-1], gap))
    first = model.first_order()
    options = {
        "reltol": local,
        "abstol": local * _scale(start),
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
        "nonlin_conv_coeff": CVODES_ITERATION,
        "max_num_steps": int(CVODES_STEPS * CVODES_GAP),
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    dae = {"x": first.state, "p": first.parameters, "ode": first.rhs}
    integrator = ca.integrator("evolution", "cvodes", dae, 0.0, list(grid), options)
    try:
        with interrupts_deferred(end_solver=True):
            states = np.array(integrator(x0=start, p=parameters)["xf"]).T
    except RuntimeError as error:
        reason = str(error).rpartition("CVode returned ")[2].partition(".")[0].strip('"')
        before = t[t <= integrator.stats()["tcur"]]
        whole = Trajectory(np.empty((0, start.size)), 0)
        if before.size:  # CasADi gives nothing of a run that fails: what went well is done again
            whole = cvodes(model, parameters, start, before, tolerance)
        raise IntegrationError("cvodes", f"it returned {reason}", whole, t) from error
    return _finite("cvodes", Trajectory(states[np.searchsorted(grid, t)], int(integrator.stats()["nfevals"])), t)


def dop853(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by the Dormand-Prince method of order 8 (Hairer, Norsett and Wanner 1993, II.5).

    The paper's integrator. Raises IntegrationError where the step becomes too small.
    """
    from scipy.integrate import solve_ivp

    state, rate, parameters = np.empty(start.size), np.empty(start.size), np.array(parameters, dtype=float)
    buffer, evaluate = _field(model).buffer()
    buffer.set_arg(0, state.data)
    buffer.set_arg(1, parameters.data)
    buffer.set_res(0, rate.data)

    def right_hand_side(_: float, x: Array) -> Array:
        state[:] = x
        evaluate()
        return rate.copy()

    _stiffest(model, parameters, start, t[-1])
    with np.errstate(all="ignore"):  # a state that runs away overflows before the step is found too small
        result = solve_ivp(
            right_hand_side, (0.0, t[-1]), start, "DOP853", t, rtol=tolerance, atol=tolerance * _scale(start)
        )
    trajectory = Trajectory(np.asarray(result.y).T if len(result.t) else np.empty((0, start.size)), int(result.nfev))
    if not result.success:
        raise IntegrationError("dop853", str(result.message).strip(" .").lower(), trajectory, t)
    return _finite("dop853", trajectory, t)


def symplectic(
    model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float, step: float | None = None
) -> Trajectory:
    """States at the times t > 0 by the splitting of order 6 with a fixed step (Blanes and Moan 2002, SRKN 11b).

    Where no step is given, it is such that one step is within the tolerance of two half steps at all of the times and
    at 100 others. The times need not be multiples of the step: a shorter step leads to each from the multiple below it
    and is not gone on from, so that the map that is iterated stays one and the same. Raises IntegrationError where the
    state is not finite, or no step meets the tolerance.
    """
    splitting, scale = _Splitting(model, parameters), _scale(start)
    if step is not None:
        return _finite("symplectic", splitting.run(start, t, step), t)
    first = min(1.0 / _stiffest(model, parameters, start, t[-1]), float(t[-1]))
    step = splitting.fitting_step(start, first, 0.3 * tolerance)
    everywhere = np.union1d(t, np.linspace(0.0, t[-1], 101)[1:])
    for _ in range(RETRIES):
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
    reason = f"one step of {found.step:.2g} is off by up to {errors.max():.1e}; asked: {tolerance:.1e}"
    raise IntegrationError("symplectic", reason, found, t)


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
        """States at the times t with a fixed step, up to the last one that is finite."""
        before = np.floor(t / step).astype(int)
        column, states = self._columns(start[None], np.array([step])), np.empty((t.size, self.size))
        for i, count in enumerate(np.diff(before, prepend=0)):
            column = self._advance(column, int(count))
            states[i] = column[: self.size, 0]
            if not np.all(np.isfinite(states[i])):
                states[i:] = np.nan
                break
        states = self._steps(states, t - before * step)
        finite = np.append(np.all(np.isfinite(states), axis=1), False)
        return Trajectory(states[: np.argmin(finite)], self.stages * int(before[-1] + t.size), step)

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
        for _ in range(RETRIES):
            column, states = self._columns(start[None], np.array([step])), [start]
            for _ in range(50):
                column = self._advance(column, 1)
                states.append(column[: self.size, 0])
            error = float(self.step_errors(np.array(states), step, _scale(start)).max())
            if error <= tolerance:
                break
            step *= self.shrink(tolerance, error)
        return step


def _finite(method: str, trajectory: Trajectory, t: Array) -> Trajectory:
    """The trajectory; raises IntegrationError where a state is missing or not finite."""
    finite = np.append(np.all(np.isfinite(trajectory.states), axis=1), False)
    count = int(np.argmin(finite))
    if count < t.size:
        whole = Trajectory(trajectory.states[:count], trajectory.evaluations, trajectory.step)
        raise IntegrationError(method, NOT_FINITE, whole, t)
    return trajectory


Integrator = Callable[[OdeModel, Array, Array, Array, float], Trajectory]
