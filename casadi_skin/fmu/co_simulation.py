"""FMUs for Co-Simulation as maps: the states that their solvers come to, after a period or at the next crossing.

A slave goes on in communication steps and shows its states between them. Inputs are constant within a step, with the
value at its middle: an error of second order that half the step shows.

A crossing of a section lies on the polynomial through eight communication points: slaves of fixed steps have no shorter
ones to land by, and the steps of others stay those that they had. What that leaves is seen with half the step, too.
"""

from __future__ import annotations

import itertools
import math
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import KroghInterpolator
from scipy.optimize import brentq

from casadi_skin.fmu.description import CO_SIMULATION, Array, FmuChoices, Unpacked, unpack
from casadi_skin.fmu.fmu_component import MOST_COMPLAINTS
from casadi_skin.fmu.map_orbit import EPSILON, MapOrbit, Returns, fixed_point
from casadi_skin.fmu.model import TIME_LIMIT, Signal, check_answer, checked_choices, signal_at
from casadi_skin.fmu.slave import SAME_VALUE_RTOL, Slave, SlaveError, SlaveVariables
from casadi_skin.model.arguments import by_name, file_path, number, numbers, short_repr, whole
from casadi_skin.model.result import WithVerbs, in_turn
from casadi_skin.zero.statement import named_values

STEPS_PER_PERIOD = 200  # of a forcing, where neither the script nor the FMU names a step
DEFAULT_TOLERANCE = 1e-6  # of the solver, where neither does
MOST_STEPS = 100_000  # to the next crossing
SAME, SHORTER_STEP, LONGER_STEP, SMALLER_TOLERANCE = (1.0, 1.0), (0.5, 1.0), (2.0, 1.0), (1.0, 0.1)  # factors
INTERPOLATED_BEFORE, INTERPOLATED_AFTER = 4, 3  # communication points, of the end of the step that crosses
UNSEEN = 100 * EPSILON  # relative change of values that are computed in the same way
RESTING, ON_SECTION = 1e-8, 1e-3  # of the largest values: states that do not move; a start on the section
Section = Callable[[Array], float]


@dataclass(frozen=True, eq=False)
class _Way:
    """How returns are computed: with parameters and inputs, steps and tolerances times factors, up to a section."""

    given: Array
    section: Section | None
    cycles: int
    least: float  # time before which no crossing counts
    factors: tuple[float, float] = SAME


@dataclass(frozen=True, eq=False)
class _Return:
    """The motion to a return, and after it to the last communication point that its end was computed from."""

    t: Array
    states: Array
    duration: float
    end: Array


class CoSimulation(WithVerbs):
    """An FMU for Co-Simulation, as `import_co_simulation` reads it, whose solver makes a map of its states.

    `start_state` is where the FMU starts, `step` the communication step, and `complaints` are its last messages. The
    instance and its temporary folder go when the model does.
    """

    def __init__(
        self, unpacked: Unpacked, choices: FmuChoices, signals: Mapping[str, Signal], step: float | None,
        tolerance: float | None,
    ) -> None:  # fmt: skip
        variables = SlaveVariables(unpacked.path, unpacked.description, choices)
        self.path, self.name = unpacked.path, str(unpacked.description.modelName)
        self.state_names = tuple(state.name for state in variables.states)
        self.parameter_names, self.forcing_period = choices.parameters, choices.forcing_period
        self.nominal = tuple(e.start for e in variables.given[: len(choices.parameters)])
        self.start_state = np.array([state.start for state in variables.states])
        self._sizes = np.array([state.size for state in variables.states])
        usual = unpacked.description.defaultExperiment
        self.tolerance = float(tolerance or (usual and usual.tolerance) or DEFAULT_TOLERANCE)
        own = float(unpacked.description.coSimulation.fixedInternalStepSize or 0.0)
        self.step = self._step(step or float((usual and usual.stepSize) or own), own)
        t = ca.MX.sym("t")
        inputs = [signal_at(name, signals[name], t, choices.forcing_period) for name in choices.inputs]
        self._signals = ca.Function("signals", [t], [ca.vertcat(*inputs) if inputs else ca.MX(0, 1)])
        self._moving = bool(inputs) and bool(ca.depends_on(ca.vertcat(*inputs), t))
        self._messages = deque[str](maxlen=MOST_COMPLAINTS)
        self._slave = Slave(unpacked, variables, self._messages)
        self._finalizer = weakref.finalize(self, _close, self._slave, unpacked.remove)
        self._slave.tried(self._all_given(self.nominal, 0.0), self.tolerance, self.step)

    def _step(self, step: float, own: float) -> float:
        """The communication step, of which a period of the forcing has a whole number, a multiple of its own step."""
        period = self.forcing_period
        if period is not None:
            step = period / max(1, round(period / step if step else STEPS_PER_PERIOD))
        if not step > 0.0:
            raise ValueError(f"{self.path}: it names no communication step; accepted: step=, a number > 0")
        if own and abs(step / own - max(1, round(step / own))) > SAME_VALUE_RTOL * step / own:
            what = "step" if period is None else "step and forcing_period"
            raise ValueError(f"{what}: a communication step of {step:.9g}; accepted: multiples of its own, {own:.9g}")
        return step

    @property
    def complaints(self) -> tuple[str, ...]:
        """The FMU's last messages."""
        return tuple(self._messages)

    def close(self) -> None:
        """Free the FMU and remove its folder."""
        self._finalizer()

    def find_orbit(
        self, guess: MapOrbit | ArrayLike | None = None, period: float | None = None, *,
        parameters: Mapping[str, float] | None = None, section: Section | None = None, cycles: int = 1,
        transient: float = 0.0,
    ) -> MapOrbit:  # fmt: skip
        """The periodic orbit near a guess, stable or not: a fixed point of the map to its return.

        A forced model returns after `cycles` periods of its forcing, an autonomous one at the `cycles`-th crossing of a
        section at which that grows.

        Arguments:
            guess: A state near the orbit, shape (states,), or an orbit, as that at other parameters; by default the
                FMU's start.
            period: Guess of an autonomous model's period: crossings before half of it are not counted.
            parameters: Values of the model's parameters by name; the others are those of the FMU.
            section: A function of the state, an array, that is zero at the orbit's start and grows there; by default
                the plane through the guess that its motion is normal to.
            cycles: Returns after which the orbit closes.
            transient: Time in which the FMU first moves on from the guess, as to come near a stable orbit.

        Returns:
            The orbit with its errors and multipliers.

        Raises:
            BoundaryError: None is found, or the FMU does not answer on the way.
            TypeError, ValueError: An argument is of another kind, or out of range.
        """
        x, way = self._request(guess, period, parameters, section, cycles)
        if number("transient", transient) < 0.0:
            raise ValueError(f"transient: given {transient!r}; accepted: a number >= 0")
        if transient:
            steps = math.ceil(transient / self.step)
            if self.forcing_period is not None:
                steps = math.ceil(transient / self.forcing_period) * round(self.forcing_period / self.step)
            x = next(itertools.islice(self._motion(x, way), steps, None))[1]
        way, x, scale = self._placed(x, way)
        unit = self._return(x, way).duration

        def returns(factors: tuple[float, float]) -> Returns:
            return self._returns(replace(way, factors=factors), scale, unit)

        at = returns(SAME)
        others = self._others(returns, x / scale)
        again = self._returns(replace(way, cycles=2 * way.cycles), scale, unit)
        found = fixed_point(at, x / scale, others, again, self.forcing_period is None)
        motion, state = self._return(found.y * scale, way), found.y * scale
        inside = motion.t < motion.duration
        return MapOrbit(
            name=self.name,
            state_names=self.state_names,
            parameters=dict(zip(self.parameter_names, way.given.tolist(), strict=False)),
            state=state,
            state_error=found.errors * scale,
            period=motion.duration,
            period_error=0.0 if self.forcing_period is not None else found.period_error * unit,
            cycles=way.cycles,
            multipliers=found.multipliers,
            multiplier_errors=found.multiplier_errors,
            t=np.append(motion.t[inside], motion.duration),
            states=np.vstack([motion.states[inside], motion.end]),
            noise=found.noise,
            solver_seen=self._solver_seen(state, way, motion.t.size // 4),
        )

    def _request(
        self, guess: MapOrbit | ArrayLike | None, period: float | None, parameters: Mapping[str, float] | None,
        section: Section | None, cycles: int,
    ) -> tuple[Array, _Way]:  # fmt: skip
        """The state that a search begins with, and how returns are computed."""
        state = guess.state if isinstance(guess, MapOrbit) else self.start_state if guess is None else guess
        x = np.array(numbers("guess", state))
        if x.size != len(self.state_names):
            raise ValueError(f"guess: given {x.size} numbers; accepted: {len(self.state_names)}, one for each state")
        if x.size == 1 and self.forcing_period is None:
            words = "one state without forcing has no orbit; accepted: states= with all of them, or forcing_period="
            raise ValueError(f"{self.path}: {words}")
        model: Any = self
        values = tuple(named_values(model, parameters).values())
        for label, given in (("period", period), ("section", section)):
            if given is not None and self.forcing_period is not None:
                raise ValueError(f"{label}: given {short_repr(given)}; accepted: none, the forcing has the period")
        if period is not None and number("period", period) <= 0.0:
            raise ValueError(f"period: given {period!r}; accepted: a number > 0")
        if section is not None and not callable(section):
            raise TypeError(f"section: given {short_repr(section)}; accepted: a function of the state")
        if section is not None:
            number("section(guess)", section(x))
        return x, _Way(self._all_given(values, 0.0), section, whole("cycles", cycles, 1), 0.5 * (period or 0.0))

    def _placed(self, x: Array, way: _Way) -> tuple[_Way, Array, Array]:
        """The way with its section, a state on that, and the ranges of the states along a first return."""
        given, scale = way.section, self._sizes
        for _ in range(2):  # the plane of the nominal sizes, then that of the ranges
            if given is None and self.forcing_period is None:
                moved = next(itertools.islice(self._motion(x, way), 1, None))[1] - x
                way = replace(way, section=_plane(x, moved / scale**2))
            motion = self._return(x, way)
            scale = np.ptp(motion.states, axis=0)
            scale = np.where(scale > RESTING * np.max(np.abs(motion.states), axis=0), scale, self._sizes)
        if given is not None:
            values = [given(state) for state in motion.states]
            if abs(values[0]) > ON_SECTION * np.max(np.abs(values)):
                x = self._return(x, replace(way, cycles=1)).end
        return way, x, scale

    # Motion -----------------------------------------------------------------------------------------------------------

    def _all_given(self, values: tuple[float, ...], time: float) -> Array:
        """Values of parameters and inputs at a time."""
        return np.array([*values, *np.array(self._signals(time)).ravel()])

    def _motion(self, x: Array, way: _Way) -> Iterator[tuple[float, Array]]:
        """Times and states at communication points, without end; raises SlaveError."""
        if not self._finalizer.alive:
            raise ValueError(f"{self.path}: closed; accepted: calls before that")
        step, given = way.factors[0] * self.step, way.given.copy()
        self._slave.begin(x, given, way.factors[1] * self.tolerance)
        yield 0.0, x
        for k in itertools.count():
            if self._moving:
                given[len(self.nominal) :] = np.array(self._signals((k + 0.5) * step)).ravel()
                self._slave.give(given)
            yield (k + 1) * step, self._slave.advance(k * step, step)

    def _return(self, x: Array, way: _Way) -> _Return:
        """The motion from a state to its return; raises SlaveError."""
        if self.forcing_period is None:
            return self._crossing(x, way)
        steps = self.forcing_period / (way.factors[0] * self.step)
        if abs(steps - round(steps)) > SAME_VALUE_RTOL * steps:
            raise SlaveError(f"{self.path}: {steps:.3g} steps in a period; accepted: a whole number")
        path = list(itertools.islice(self._motion(x, way), way.cycles * round(steps) + 1))
        t, states = np.array([t for t, _ in path]), np.array([state for _, state in path])
        return _Return(t, states, way.cycles * self.forcing_period, states[-1])

    def _crossing(self, x: Array, way: _Way) -> _Return:
        """The motion to a crossing of the section; from a start before it, the first does not count."""
        section = way.section or _plane(x, np.zeros(x.size))
        t, states, values = list[float](), list[Array](), list[float]()
        left, last, beyond = way.cycles, MOST_STEPS, False
        for k, (time, state) in enumerate(self._motion(x, way)):
            t.append(time)
            states.append(state)
            values.append(float(section(state)))
            if beyond and left and values[k - 1] < 0.0 <= values[k] and time > way.least:
                left -= 1
                last = MOST_STEPS if left else k
            beyond = beyond or values[k] > 0.0
            if k >= last + INTERPOLATED_AFTER or (left and k >= MOST_STEPS):
                break
        if left:
            raise SlaveError(
                f"{self.path}: the section is not crossed again up to t = {t[-1]:.6g}: another one, or a nearer guess"
            )
        near = slice(max(last - INTERPOLATED_BEFORE, 0), last + INTERPOLATED_AFTER + 1)
        path = KroghInterpolator(np.array(t[near]) - t[last], np.array(states[near]))
        ends = {t[last - 1] - t[last]: values[last - 1], 0.0: values[last]}  # as computed, without rounding

        def value(time: float) -> float:
            return ends.get(time, float(section(path(time))))

        late = brentq(value, t[last - 1] - t[last], 0.0, xtol=EPSILON * t[last])
        return _Return(np.array(t), np.array(states), t[last] + late, np.asarray(path(late)))

    def _solver_seen(self, x: Array, way: _Way, pairs: int) -> bool:
        """Whether another step or tolerance gives other states than rounding makes after pairs of steps."""
        found: list[Array] = []
        for factors in (SAME, SMALLER_TOLERANCE, SHORTER_STEP, LONGER_STEP):
            with suppress(SlaveError):
                steps = round(2 * pairs / factors[0])
                found.append(next(itertools.islice(self._motion(x, replace(way, factors=factors)), steps, None))[1])
        return bool(np.any(np.ptp(found, axis=0) > UNSEEN * np.max(np.abs(found), axis=0)))

    def _returns(self, way: _Way, scale: Array, unit: float) -> Returns:
        """The map in units, NaN where the slave fails."""

        def at(y: Array) -> Array:
            found = None
            if np.all(np.isfinite(y)):
                with suppress(SlaveError):
                    found = self._return(y * scale, way)
            if found is None:
                return np.full(y.size + 1, np.nan)
            return np.append(found.end / scale, found.duration / unit)

        return at

    def _others(self, returns: Callable[[tuple[float, float]], Returns], y: Array) -> list[Returns]:
        """The map by a smaller tolerance, and in half the step; in twice where the slave has no such step."""
        ways = [returns(factors) for factors in (SMALLER_TOLERANCE, SHORTER_STEP, LONGER_STEP)]
        return [way for way in ways if np.all(np.isfinite(way(y)))][:2]


def _plane(x: Array, normal: Array) -> Section:
    return lambda state: float(normal @ (state - x))


def _close(slave: Slave, remove: Callable[[], object]) -> None:
    slave.free()
    remove()


@in_turn
def import_co_simulation(
    path: str | Path,
    *,
    states: Sequence[str] | None = None,
    starts: Mapping[str, str] | None = None,
    parameters: Sequence[str] = (),
    inputs: Mapping[str, Signal] | None = None,
    forcing_period: float | None = None,
    step: float | None = None,
    solver_tolerance: float | None = None,
    time_limit: float = TIME_LIMIT,
) -> CoSimulation:
    """The map of an FMU for Co-Simulation (FMI 2.0 or 3.0), through its binary for this platform.

    Arguments:
        path: The FMU.
        states: Names of all states that it has, real variables; by default those of its ModelStructure.
        starts: Names of the variables by which states are put in, by the states' names, where they are others.
        parameters: Its real parameters and inputs that become parameters of the model; the others keep their values.
        inputs: Values of its inputs by name, or signals: functions f(t) of CasADi's time with the forcing's period.
        forcing_period: The period of a model that depends on time.
        step: The communication step, a period of the forcing being a whole number of steps; by default the FMU's, or
            a 200th of the period.
        solver_tolerance: Of its solver, where that has one; by default the FMU's, or 1e-6.
        time_limit: Seconds in which the binary must answer in a process of its own.

    Returns:
        The model, whose `find_orbit` finds periodic orbits.

    Raises:
        ValueError: As `import_fmu` does; no state can be put in, or none is named.
        TypeError: An argument is of another kind.
    """
    for label, value in (("step", step), ("solver_tolerance", solver_tolerance)):
        if value is not None and number(label, value) <= 0:
            raise ValueError(f"{label}: given {value!r}; accepted: a number > 0")
    choices, signals, at_start = checked_choices(states, parameters, inputs, forcing_period, time_limit)
    choices = replace(choices, starts=tuple(by_name("starts", starts, "names").items()))
    unpacked = unpack(file_path("path", path), CO_SIMULATION)
    try:
        _ = SlaveVariables(unpacked.path, unpacked.description, choices)  # names first: they run nothing
        check_answer(unpacked, choices, at_start, time_limit, CoSimulation, step, solver_tolerance)
        return CoSimulation(unpacked, choices, signals, step, solver_tolerance)
    except SlaveError as error:
        unpacked.remove()
        raise ValueError(str(error)) from error
    except BaseException:
        unpacked.remove()
        raise
