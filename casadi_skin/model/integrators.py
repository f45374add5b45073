"""Common results, errors and starts of all integrators."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.equations import Array
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.jumps import JumpError
from casadi_skin.model.ode import OdeModel
from casadi_skin.native.places import Buffers

LONGEST_EVOLUTION = 1e8  # radians that may be followed: a thousand times 10^4 periods of a chain
NOT_FINITE = "it is not finite then"
ESCAPE_FACTOR = 1e6  # times the largest component, beyond which a state has escaped
ESCAPE_STEPS = 20_000  # in which it escapes
STILL_STEPS, STILL_SHARE = 200, 1e-6  # so many in such a part of the time lead nowhere but where it doubles


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the requested times, shape (time, 2n), evaluations of the forces, and the step where it is fixed."""

    states: Array
    evaluations: int
    step: float | None = None


class IntegrationError(ArithmeticError):
    """An integrator gave up: the message says where and why in one line, `trajectory` holds the states before that."""

    def __init__(self, method: str, reason: str, trajectory: Trajectory, t: Array, origin: float = 0.0) -> None:
        count = len(trajectory.states)
        reached = t[count - 1] if count else origin
        super().__init__(f"{method}: the state was followed to t = {reached:.6g} of {t[-1]:.6g}: {reason}")
        self.reason, self.trajectory = reason, trajectory


# (model, parameters, start, times > 0, tolerance) -> states. The tolerance is that of one step, relative to the largest
# component of the start. Raises IntegrationError where it gives up, as soon as a state runs to infinity.
Integrator = Callable[[OdeModel, Array, Array, Array, float], Trajectory]


def finite_trajectory(method: str, trajectory: Trajectory, t: Array, origin: float = 0.0) -> Trajectory:
    """The trajectory; raises IntegrationError where a state is missing or not finite."""
    finite = np.append(np.all(np.isfinite(trajectory.states), axis=1), False)
    count = int(np.argmin(finite))
    if count < t.size:
        whole = Trajectory(trajectory.states[:count], trajectory.evaluations, trajectory.step)
        raise IntegrationError(method, NOT_FINITE, whole, t, origin)
    return trajectory


def fastest_frequency(model: OdeModel, parameters: Array, start: Array, end: float) -> float:
    """Bound of the largest frequency or rate at the start and at rest, from the row sums of df/dx at time 0.

    Raises ValueError where `end` is out of reach of any integrator.
    """
    slope, fastest = model.function("slope", ca.jacobian(model.rhs, model.state)), 0.0
    for x in (start, np.zeros(start.size)):
        jacobian = ca.DM(slope(0.0, x, parameters))
        rows = np.array(jacobian.sparsity().row(), dtype=int)
        sums = np.bincount(rows, np.abs(jacobian.nonzeros()), minlength=model.size)
        if x is start or np.all(np.isfinite(sums)):  # a model need not be defined at rest
            fastest = max(fastest, float(sums.max()))
    frequency = float(np.sqrt(fastest)) if model.order == 2 else fastest
    if not frequency * end <= LONGEST_EVOLUTION:
        radians = f"{frequency * end:.2g} radians of the fastest vibration"
        raise ValueError(
            f"t: given up to {end:.6g}, which is {radians} at the start; accepted: up to {LONGEST_EVOLUTION:g}"
        )
    return frequency or 1.0


def size_of(start: Array) -> float:
    """Largest component, to which tolerances are relative; 1 at rest."""
    return float(np.abs(start).max()) or 1.0


# SUNDIALS CVODES through CasADi (Hindmarsh et al. 2005): every use of it is set up, run and reported here -------------

# Measured: results of CVODES are up to 1500 of its local tolerances off.
LOCAL_TOLERANCE_SHARE, TIGHTEST_LOCAL_TOLERANCE = 1e-3, 1e-15
TIGHT_ITERATION = 1e-3  # share of a step's error left to the iteration; at the default, 0.1, the order falls to 5
STEPS_PER_RADIAN = 200  # allowed per radian of the stiffest vibration: ten times the need of the tightest run
LARGEST_OUTPUT_GAP = 100.0  # radians from output to output
STIFF_SHARE = 1e-2  # local tolerance of BDF per tolerance: errors of steps add up
STIFF_STEPS = 100_000  # of BDF, from output to output
EVENT_PLACES = 2001  # of a motion that is looked at for events
LEAST_STRETCH = 1e-8  # of time from output to output
UNITS_OF_TIME = 1e6  # in all, where stretches are shorter
BDF_STRETCHES = 1000  # of an evolution by BDF, with an output after each: its end may need more steps than one stretch


class CvodesError(ArithmeticError):
    """CVODES did not reach the end: the message names its return value, as in "it returned CV_TOO_MUCH_WORK"."""


@dataclass(frozen=True)
class CvodesOptions:
    """Local tolerances and formulas of CVODES.

    `max_steps` counts from output to output. A `stiff` problem takes BDF formulas with Newton's iteration, another one
    Adams formulas with functional iteration, which stops at `iteration` of a step's error (CVODES' default is 0.1).
    Where sensitivities are computed, `sensitivity_errors` makes them part of the error that steps are chosen by.
    """

    rtol: float
    atol: float
    max_steps: int
    stiff: bool = False
    iteration: float | None = None
    sensitivity_errors: bool = False

    def integrator(self, name: str, dae: dict[str, Any], times: Sequence[float]) -> ca.Function:
        """CasADi's integrator of a DAE (x, p, ode, and t, z, alg where it has them) between its times."""
        options: dict[str, Any] = {
            "reltol": self.rtol,
            "abstol": self.atol,
            "max_num_steps": self.max_steps,
            "disable_internal_warnings": True,
            "show_eval_warnings": False,
        }
        if not self.stiff:
            options |= {"linear_multistep_method": "adams", "nonlinear_solver_iteration": "functional"}
        if self.iteration is not None:
            options["nonlin_conv_coeff"] = self.iteration
        if self.sensitivity_errors:
            options["fsens_err_con"] = True
        solver = "idas" if "alg" in dae else "cvodes"
        if "alg" in dae:  # its unknowns follow from the others: as parts of the error they made steps ever shorter
            options["suppress_algebraic"] = True
        return ca.integrator(name, solver, dae, float(times[0]), [float(t) for t in times[1:]], options)

    def transition(self, name: str, dae: dict[str, Any]) -> ca.Function:
        """Function (x0, p) -> state at the time 1 and its derivative with respect to x0 at the time 0."""
        return self.integrator(name, dae, (0.0, 1.0)).factory(name, ["x0", "p"], ["xf", "jac:xf:x0"])


def run_cvodes(
    function: ca.Function, start: Array, parameters: Array, end_solver: bool = False, **algebraic: Array
) -> dict[str, ca.DM]:
    """Results by name of an integrator, or of the `transition` of one; raises CvodesError.

    An interruption waits for the result, or ends CVODES at once where `end_solver`.
    """
    try:
        with interrupts_deferred(end_solver):
            results: dict[str, ca.DM] = function(x0=start, p=parameters, **algebraic)
            return results
    except RuntimeError as error:
        raise CvodesError(f"it {cvodes_reason(error)}") from error


def cvodes_reason(error: RuntimeError) -> str:
    """The outcome of CVODES, as in "returned CV_TOO_MUCH_WORK", from CasADi's message of several lines."""
    flags = re.findall(r'returned "?((?:CV|IDA)_\w+)', str(error))
    return f"returned {flags[-1]}" if flags else "failed"


def followed_by_cvodes(
    dae: dict[str, Any],
    parameters: Array,
    start: Array,
    t: Array,
    options: CvodesOptions,
    origin: float = 0.0,
    gap: float | None = None,
) -> Trajectory:
    """States at the times t > `origin`, where the state is `start`; raises IntegrationError where CVODES fails.

    With a `gap`, CVODES puts out states at least as often: its limit of steps holds from output to output, so that a
    blow-up is noticed soon. Where times are near to each other they are in another unit, as CasADi leaves stretches
    below 1e-9 out.
    """
    grid = t if gap is None else np.union1d(t, np.arange(origin + gap, t[-1], gap))
    near = min(gap or np.inf, float(np.min(np.diff(t, prepend=origin)))) < LEAST_STRETCH
    unit = 2.0 ** np.round(np.log2((t[-1] - origin) / UNITS_OF_TIME)) if near else 1.0  # a change that rounds nothing
    rates = {
        part: ca.substitute(dae[part], dae["t"], unit * dae["t"]) for part in ("ode", "alg") if near and part in dae
    }
    scaled = dae | rates | {"ode": unit * rates.get("ode", dae["ode"])}
    integrator, n = options.integrator("evolution", scaled, (origin / unit, *(grid / unit))), dae["x"].numel()
    try:
        found = run_cvodes(integrator, start[:n], parameters, end_solver=True, z0=start[n:])
        states = np.array(ca.vertcat(found["xf"], found["zf"])).T
    except CvodesError as error:
        before = t[t <= unit * integrator.stats()["tcur"]]
        whole = Trajectory(np.empty((0, start.size)), 0)
        if before.size:  # CasADi gives nothing of a run that fails: its good part is done again
            whole = followed_by_cvodes(dae, parameters, start, before, options, origin, gap)
        raise IntegrationError("cvodes", str(error), whole, t, origin) from error
    trajectory = Trajectory(states[np.searchsorted(grid, t)], int(integrator.stats()["nfevals"]))
    return finite_trajectory("cvodes", trajectory, t, origin)


def cvodes(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by CVODES: Adams formulas for the vibrations of models of second order, else BDF.

    Raises IntegrationError where CVODES fails, with the last time it reached.
    """
    if model.order == 1:
        return stiff_cvodes(model, parameters, start, t, tolerance, gap=float(t[-1]) / BDF_STRETCHES)
    local = max(LOCAL_TOLERANCE_SHARE * tolerance, TIGHTEST_LOCAL_TOLERANCE)
    options = CvodesOptions(
        local, local * size_of(start), int(STEPS_PER_RADIAN * LARGEST_OUTPUT_GAP), iteration=TIGHT_ITERATION
    )
    gap = LARGEST_OUTPUT_GAP / fastest_frequency(model, parameters, start, t[-1])
    return followed_by_cvodes(_dae_of(model), parameters, start, t, options, gap=gap)


def stiff_cvodes(
    model: OdeModel,
    parameters: Array,
    start: Array,
    t: Array,
    tolerance: float,
    origin: float = 0.0,
    gap: float | None = None,
) -> Trajectory:
    """States at the times t > `origin` by CVODES with BDF formulas, of any model: stiff, forced, or from an FMU.

    By IDAS, which has the same formulas, where a model has algebraic equations, which the start has to meet. There is
    an output at least every `gap`. Raises IntegrationError where it fails.
    """
    local = max(STIFF_SHARE * tolerance, TIGHTEST_LOCAL_TOLERANCE)
    options = CvodesOptions(local, local * size_of(start), STIFF_STEPS, stiff=True)
    implicit = model.implicit
    if implicit is None or not implicit.conditions:
        dae = _dae_of(model)

        def follow(times: Array) -> Trajectory:
            return followed_by_cvodes(dae, parameters, start, times, options, origin, gap)

        return _between_events(model, parameters, t, origin, follow)
    dae, matrix = implicit.semi_explicit(origin, start, parameters)

    def in_states(found: Trajectory) -> Trajectory:
        states = np.linalg.solve(matrix, found.states.T).T  # in which what is algebraic was interpolated
        pairs = zip(states, t.tolist(), strict=False)
        met = [consistent(model, parameters, x, time) for x, time in pairs]
        return replace(found, states=np.reshape(met, states.shape))

    try:
        return in_states(followed_by_cvodes(dae, parameters, matrix @ start, t, options, origin, gap))
    except IntegrationError as error:
        error.trajectory = in_states(error.trajectory)
        raise


def _between_events(
    model: OdeModel, parameters: Array, t: Array, origin: float, follow: Callable[[Array], Trajectory]
) -> Trajectory:
    """The trajectory; of an FMU with events it is looked at between the times too: raises JumpError at an event."""
    jumps = model.jumps
    if not jumps.end_motion:
        return follow(t)
    grid = np.union1d(t, np.linspace(origin, t[-1], EVENT_PLACES)[1:])
    try:
        found = follow(grid)
    except IntegrationError as error:
        found = error.trajectory
    words = jumps.along(grid[: len(found.states)], found.states, parameters)
    if words:
        raise JumpError(model, words)
    if len(found.states) < grid.size:
        return follow(t)  # which says how far it comes
    return Trajectory(found.states[np.searchsorted(grid, t)], found.evaluations)


def consistent(model: OdeModel, parameters: Array, start: Array, time: float = 0.0) -> Array:
    """A start that meets the algebraic equations of a model; raises IntegrationError where none is near."""
    if model.implicit is None:
        return start
    try:
        return model.implicit.consistent(time, start, parameters)
    except ArithmeticError as error:
        none = Trajectory(np.empty((0, start.size)), 0)
        raise IntegrationError("idas", str(error), none, np.array([time]), time) from error


def _dae_of(model: OdeModel) -> dict[str, Any]:
    kind = type(model.state)
    time, x, p = kind.sym("t"), kind.sym("x", model.full_size), kind.sym("p", model.parameters.numel())
    return {"t": time, "x": x, "p": p, "ode": model.field_at(time, x, p)}


def simulated(model: OdeModel, parameters: Array, start: Array, times: Array, tolerance: float) -> Trajectory:
    """States at all but the first of the times by `stiff_cvodes`; raises IntegrationError with what runs away."""
    try:
        return stiff_cvodes(model, parameters, start, times[1:], tolerance, float(times[0]))
    except IntegrationError as error:
        trajectory, reason = error.trajectory, error.reason
        before = trajectory.states
        state, time = (before[-1], float(times[len(before)])) if len(before) else (start, float(times[0]))
        escape = far_state(model, parameters, state, time, float(times[-1]))
        if escape is not None:
            words = f"{escape[1]} runs to infinity: it is {escape[2]:.3g} at t = {escape[0]:.6g}"
        else:
            k = int(np.argmax(np.abs(state)))
            words = f"{model.state_names[k]} = {state[k]:.3g} is its largest component there, and CVODES"
            words += reason.removeprefix("it")
        raise IntegrationError("cvodes", words, trajectory, times[1:], float(times[0])) from error


def far_state(
    model: OdeModel, parameters: Array, state: Array, time: float, end: float
) -> tuple[float, str, float] | None:
    """When a component is far away, by name, and its value then, from a state at a time; None where none is soon.

    Positions alone count where there are some.
    """
    from scipy.integrate import DOP853

    field, moving = model.vector_field, model.size if model.order == 2 else None
    far = ESCAPE_FACTOR * max(1.0, float(np.max(np.abs(state))))
    with np.errstate(all="ignore"):  # a state that overflows has run away, which is what is asked
        rule = DOP853(lambda t, x: np.array(field(t, x, parameters)).ravel(), time, state, end, rtol=1e-6)
        largest, before, reached = float(np.max(np.abs(state[:moving]))), 0.0, -np.inf
        for count in range(1, ESCAPE_STEPS):  # a stiff model would take very many
            if not np.isfinite(rule.h_abs):  # scipy's step would never end
                break
            rule.step()
            k = int(np.argmax(np.abs(rule.y[:moving])))
            largest = max(largest, abs(rule.y[k]))
            if largest > far:
                return float(rule.t), model.state_names[k], float(rule.y[k])
            if rule.status != "running":
                break
            if count % STILL_STEPS == 0:
                if rule.t - reached <= STILL_SHARE * (end - time) and largest <= 2.0 * before:
                    break
                before, reached = largest, rule.t
    return None


# The Dormand-Prince method of order 8 (Hairer, Norsett and Wanner 1993, II.5) of scipy on CasADi functions ------------


def solve_dop853(
    field: ca.Function,
    parameters: Array,
    start: Array,
    end: float,
    tolerance: float,
    t: Array | None = None,
    rate: float = 1.0,
) -> Any:
    """Solution by scipy of x' = rate field(rate t, x, p) from 0 to `end`: at the times t, or a dense one without t.

    `field` has a dense result. Tolerances are relative to the largest component of the start. The interpolant between
    steps is of a lower order than these: on steps half as long it is as precise, within rounding.
    """
    from scipy.integrate import DOP853, solve_ivp

    class HalfSteps(DOP853):
        def step(self) -> str | None:
            self.h_abs *= 0.5  # of the length that errors of steps allow
            return super().step()

    call = Buffers(field)

    def right_hand_side(t: float, x: Array) -> Array:
        return rate * call(rate * t, x, parameters)[0]

    options: dict[str, Any] = {"rtol": tolerance, "atol": tolerance * size_of(start), "dense_output": t is None}
    with np.errstate(all="ignore"):  # a state that runs away overflows before the step is found too small
        return solve_ivp(right_hand_side, (0.0, end), start, HalfSteps if t is None else DOP853, t, **options)


def dop853_reason(solution: Any) -> str:
    """Why scipy's solution ended early, in lower case and without a full stop."""
    return str(solution.message).strip(" .").lower()


def dop853(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0; the paper's integrator. Raises IntegrationError where the step becomes too small."""
    fastest_frequency(model, parameters, start, t[-1])

    def follow(times: Array) -> Trajectory:
        solution = solve_dop853(model.vector_field, parameters, start, t[-1], tolerance, times)
        states = np.asarray(solution.y).T if len(solution.t) else np.empty((0, start.size))
        trajectory = Trajectory(states, int(solution.nfev))
        if not solution.success:
            raise IntegrationError("dop853", dop853_reason(solution), trajectory, times)
        return finite_trajectory("dop853", trajectory, times)

    return _between_events(model, parameters, t, 0.0, follow)


INTEGRATORS: Mapping[str, Integrator] = {"cvodes": cvodes, "dop853": dop853}  # of any model; `model.methods` names them
