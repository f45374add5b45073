"""Time evolution of any model from any start."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, cached_property, lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.evolution import (
    GAUGE,
    PHYSICAL,
    EquationsOfMotion,
    Evolution,
    EvolutionError,
    equations_of_motion,
)
from casadi_skin.follow.closed_curve import Curve, cosine_curve
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.space import FAMILY
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import by_name, check_instance, check_name, number, short_repr, state_by_name, whole
from casadi_skin.model.expressions import real_array
from casadi_skin.model.integrators import INTEGRATORS as ANY_INTEGRATORS
from casadi_skin.model.integrators import (
    NOT_FINITE,
    IntegrationError,
    Integrator,
    Trajectory,
    consistent,
    far_state,
    fastest_frequency,
    finite_trajectory,
    simulated,
    size_of,
)
from casadi_skin.model.ode import OdeModel, model_of
from casadi_skin.model.operations import read
from casadi_skin.model.result import in_turn
from casadi_skin.native import Structure, kernels, program_lists, stepped
from casadi_skin.stability.flows import SPLITTING_ORDER, KicksAndDrifts, srkn_step
from casadi_skin.zero.problem import Array, Indices

LONGEST_CALL = 4096  # steps, so that an interruption is noticed
SEQUENCE = KicksAndDrifts.of(1).kicks, KicksAndDrifts.of(1).drifts
MOST_RETRIES = 6
FIRST_STEPS = 50  # that the first step is fitted to


def symplectic(
    model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float, step: float | None = None
) -> Trajectory:
    """States at the times t > 0 by the splitting of order 6 with a fixed step (Blanes and Moan 2002, SRKN 11b).

    Where no step is given, it is such that one step is within the tolerance of two half steps at all of the times and
    at 100 others. The times need not be multiples of the step: a shorter step leads to each from the multiple below it
    and is not gone on from, so that the map that is iterated stays one and the same. Raises IntegrationError where the
    state is not finite, or no step meets the tolerance.
    """
    splitting = Splitting(model, parameters)
    if step is not None:
        return finite_trajectory("symplectic", splitting.run(start, t, step), t)
    first = min(1.0 / fastest_frequency(model, parameters, start, t[-1]), float(t[-1]))
    beginning = np.linspace(0.0, min(FIRST_STEPS * first, float(t[-1])), FIRST_STEPS + 1)[1:]
    step = splitting.fitted(start, beginning, first, 0.3 * tolerance)[0].step  # in a hundredth of the time, mostly
    everywhere = np.union1d(t, np.linspace(0.0, t[-1], 101)[1:])
    found, reached, reason = splitting.fitted(start, everywhere, step or first, tolerance)
    wanted = replace(found, states=found.states[:reached][np.isin(everywhere[:reached], t)])
    if reason:
        raise IntegrationError("symplectic", reason, wanted, t)
    return wanted


@lru_cache(maxsize=2)
def _force(model: OdeModel, parameters: tuple[float, ...]) -> Structure | None:
    """The forces of a model for kernels."""
    force = ca.Function("force", [model.state, ca.vec(model.parameters)], [ca.densify(model.rhs)])
    return program_lists(*read(force), np.array(parameters))


class Splitting:
    """The splitting with equal steps of q'' = f(q, parameters), compiled, or else by CasADi with the same numbers."""

    def __init__(self, model: OdeModel, parameters: Array) -> None:
        if model.order != 2 or model.forced:
            accepted = f"{', '.join(ANY_INTEGRATORS)}, or a model of second order without forcing"
            raise ValueError(f"method: given symplectic for {model.name}; accepted: {accepted}")
        self.model, self.size, self.parameters = model, model.full_size, parameters
        self._force = _force(model, tuple(parameters.tolist())) if kernels() else None

    @cached_property
    def _step(self) -> ca.Function:
        """One step; h and the parameters go along unchanged, so that one input is all that a fold has to repeat."""
        q, v, h, p = self.model.state, self.model.velocity, ca.SX.sym("h"), self.model.parameters
        x, u = srkn_step(self.model, h, p)
        return ca.Function("step", [ca.vertcat(q, v, h, p)], [ca.vertcat(x, u, h, p)])

    def _columns(self, states: Array, steps: Array) -> Array:
        """States, shape (many, size), with their steps and the parameters, one a column."""
        rest = np.broadcast_to(self.parameters, (len(states), self.parameters.size))
        return np.column_stack([states, steps, rest]).T

    def _steps(self, states: Array, steps: Array) -> Array:
        """One step from each of many states, shape (many, size), each of its own length."""
        if self._force is None:
            return np.array(self._step(self._columns(states, steps))).T[:, : self.size]
        after = np.array(states)
        stepped(self._force, SEQUENCE, np.ones(len(after), dtype=np.int64), steps, after)
        return after

    def chain(self, states: Array, counts: Indices, step: float) -> None:
        """Fill in all states but the first, each so many steps after the one before; nan where one is not finite."""
        if self._force is not None:
            stepped(self._force, SEQUENCE, counts, np.full(counts.size, step), states, chained=True)
            return
        column = self._columns(states[:1], np.array([step]))
        for state, count in zip(states[1:], counts[1:].tolist(), strict=True):
            for k in reversed(range(count.bit_length())):  # repetitions of powers of two
                if count >> k & 1 and np.all(np.isfinite(column)):
                    column = np.array(self._folds(1 << k)(column))
            state[:] = column[: self.size, 0]

    @cached_property
    def _folds(self) -> Callable[[int], ca.Function]:
        return cache(self._step.fold)

    def run(self, start: Array, t: Array, step: float) -> Trajectory:
        """States at the times t with a fixed step, up to the last one that is finite."""
        before = np.floor(t / step).astype(np.int64)
        marks = np.union1d(np.arange(0, before[-1] + 1, LONGEST_CALL), before)
        states = np.full((marks.size, self.size), np.nan)
        states[0] = start
        for first in range(0, int(before[-1]), LONGEST_CALL):
            these = slice(*np.searchsorted(marks, (first, first + LONGEST_CALL + 1)))
            if np.all(np.isfinite(states[these.start])):
                self.chain(states[these], np.diff(marks[these], prepend=first), step)
        states = self._steps(states[np.searchsorted(marks, before)], t - before * step)
        count = int(np.argmin(np.append(np.all(np.isfinite(states), axis=1), False)))
        taken = int(np.append(0, before)[count])
        return Trajectory(states[:count], SEQUENCE[0].size * (count + taken), step)

    def step_errors(self, states: Array, step: float, scale: float) -> Array:
        """Largest difference between one step and two half steps from states, shape (many, size) -> (many,).

        It is relative to the largest component of the state, or to `scale` where that is larger; inf for nan.
        """
        whole, half = np.full(len(states), step), np.full(len(states), 0.5 * step)
        difference = self._steps(states, whole) - self._steps(self._steps(states, half), half)
        with np.errstate(invalid="ignore"):
            relative = np.abs(difference).max(axis=1) / np.maximum(np.abs(states).max(axis=1), scale)
        return np.asarray(np.nan_to_num(relative, nan=np.inf))

    def fitted(self, start: Array, t: Array, step: float, tolerance: float) -> tuple[Trajectory, int, str]:
        """A run whose steps are within the tolerance of two half steps at all times, and shorter than given if need be.

        Returns it with the number of times up to which they are, and why these are not all; empty where they are.
        """
        scale, reason = size_of(start), ""
        for _ in range(MOST_RETRIES):
            found = self.run(start, t, step)
            errors = self.step_errors(np.vstack([start, found.states]), step, scale)
            reached = max(0, int(np.argmax(np.append(errors, np.inf) > tolerance)) - 1)  # without the start
            if reached == t.size or reached == len(found.states):
                return found, reached, "" if reached == t.size else NOT_FINITE
            reason = f"one step of {step:.2g} is off by up to {errors.max():.1e}; requested: {tolerance:.1e}"
            step *= float(max(0.1, 0.95 * (tolerance / float(errors.max())) ** (1.0 / (SPLITTING_ORDER + 1))))
        return found, reached, reason


# A model followed from a state at time 0 ------------------------------------------------------------------------------

SYMPLECTIC = "symplectic"
INTEGRATORS: Mapping[str, Integrator] = {**ANY_INTEGRATORS, SYMPLECTIC: symplectic}


@in_turn
def evolve(
    model: Any,
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
    equations = equations_of_motion(model, parameters)
    _check_choices(method, tolerance, coordinates, step)
    times, start = _times(t), _start(equations, positions, velocities)
    start = consistent(equations.physical, equations.values, start)
    if coordinates is None:
        coordinates = GAUGE if equations.gauge_is_default else PHYSICAL
    model, values, scale = equations.in_coordinates(coordinates)
    origin = equations.to_gauge(start, "positions") if coordinates == GAUGE else start
    later = times[times > 0]
    trajectory, failure = Trajectory(np.empty((0, start.size)), 0, step), None
    integrator: Integrator = partial(symplectic, step=step) if method == SYMPLECTIC else INTEGRATORS[method]
    try:
        if later.size:
            trajectory = integrator(model, values, origin, later, tolerance)
    except IntegrationError as error:
        trajectory, failure = error.trajectory, error
    states = np.tile(scale, model.order) * np.vstack([origin[None]] * int(times[0] == 0) + [trajectory.states])
    how = (method, tolerance, coordinates, trajectory.evaluations, trajectory.step)
    evolution = Evolution(equations, times[: len(states)], states, *how)
    if failure is not None:
        reason = equations.escape
        if not reason:
            last = states[-1] if len(states) else start
            far = far_state(equations.physical, equations.values, last, 0.0, times[-1])
            reason = "" if far is None else f"{far[1]} runs to infinity"
        words = f"{failure}; {reason}" if reason else str(failure)
        raise EvolutionError(words, evolution if len(states) else None) from failure
    return evolution


# Arguments ------------------------------------------------------------------------------------------------------------


def _check_choices(method: str, tolerance: float, coordinates: str | None, step: float | None) -> None:
    check_name("method", method, INTEGRATORS)
    check_name("coordinates", GAUGE if coordinates is None else coordinates, (GAUGE, PHYSICAL))
    _check_tolerance(tolerance)
    if step is not None and not number("step", step, "a finite number > 0") > 0:
        raise ValueError(f"step: given {step!r}; accepted: a finite number > 0")
    if step is not None and method != SYMPLECTIC:
        raise ValueError(f"step: given {step!r} with {method}; accepted: with {SYMPLECTIC}, whose step is fixed")


def _check_tolerance(given: float) -> None:
    if not 1e-13 <= number("tolerance", given) <= 1e-2:
        raise ValueError(f"tolerance: given {given!r}; accepted: 1e-13 to 1e-2")


def _times(t: ArrayLike) -> Array:
    times = np.atleast_1d(real_array("t", t, finite=False))
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
    vector = real_array(name, given, finite=False)
    if vector.shape not in [(size,) for size in sizes]:
        accepted = " or ".join(f"({size},)" for size in sizes)
        raise ValueError(f"{name}: given shape {vector.shape}; accepted: shape {accepted}")
    if not np.all(np.isfinite(vector)):
        raise ValueError(f"{name}: given a value that is not finite at {components[np.argmin(np.isfinite(vector))]}")
    return vector


# Time evolution of an orbit of any model, perturbed or not (paper, Sec. III and Fig. 6) -------------------------------


def _given_model(orbit: Orbit) -> tuple[Any, dict[str, float]]:
    """The model of an orbit as its caller stated it, and the values of its parameters."""
    check_instance("orbit", orbit, Orbit)
    periodic = getattr(orbit.space, "periodic", None)
    model = orbit.model if periodic is None else periodic.given
    # The parameter for S in the normalisation of a family is none of its orbits, and not in the equations.
    return model, {name: orbit.parameters.get(name, 0.0) for name in model.parameter_names}


def unit_direction(
    name: str,
    components: tuple[str, ...],
    sites: int,
    choices: Mapping[str, Any],
    of_mode: Callable[[int], Array] | None = None,
) -> Array:
    """The direction that one of some choices gives, of norm 1, shape (sites,), or (component,) with velocities.

    Arguments:
        name: of the direction, for messages.
        components: names of those of the state.
        choices: by name, all but one None: `site`, from 1; `vector`; `seed` of normally distributed numbers; `mode`.
        of_mode: displacements of a linear mode by number.

    Raises ValueError where there is not one, or one that does not fit.
    """
    given = [key for key, value in choices.items() if value is not None]
    if len(given) != 1:
        raise ValueError(f"{name}: given {' and '.join(given) or 'none'}; accepted: one of {', '.join(choices)}")
    (key,), value = given, choices[given[0]]
    if key in ("mode", "site") and not (isinstance(value, int | np.integer) and 1 <= value <= sites):
        raise ValueError(f"{key}: given {short_repr(value)}; accepted: 1..{sites}")
    if key == "mode" and of_mode is not None:
        direction = of_mode(value)
    elif key == "site":
        direction = np.zeros(sites)
        direction[value - 1] = 1.0
    elif key == "vector":
        direction = checked_vector("vector", value, components, *sorted({sites, len(components)}))
    else:
        direction = np.random.default_rng(whole("seed", value, 0)).normal(size=sites)
    largest = float(np.abs(direction).max())
    if largest == 0.0:
        raise ValueError("vector: given zeros; accepted: a vector with a direction")
    return np.asarray(direction / (largest * np.linalg.norm(direction / largest)))


@in_turn
def perturbed(
    orbit: Orbit,
    size: float,
    *,
    site: int | None = None,
    vector: ArrayLike | None = None,
    seed: int | None = None,
) -> tuple[Array, Array]:
    """A state near an orbit: that at phase zero plus `size` times a perturbation of norm 1 (paper, Fig. 6).

    Arguments:
        orbit: any orbit.
        size: of the perturbation; the paper's is 0.005.
        site: number of the one position that is displaced, from 1; in a model of first order of the component.
        vector: direction, shape (position,) or (component,): displacements, then velocities.
        seed: of random displacements, normally distributed; in a model of first order of all components.

    Returns:
        Displacements and velocities, shape (position,) each; of a model of first order the state, and no velocities.

    Raises:
        ValueError: not one of site, vector and seed is given, or the argument does not fit the model.
    """
    equations = equations_of_motion(*_given_model(orbit))
    n = equations.positions or equations.size
    direction = unit_direction("perturbation", equations.names, n, {"site": site, "vector": vector, "seed": seed})
    return _displaced(orbit, equations, number("size", size) * direction)


def _displaced(orbit: Orbit, equations: EquationsOfMotion, by: Array) -> tuple[Array, Array]:
    """Positions and velocities of an orbit at phase zero, displaced; an orbit of a family rests there."""
    state, n = np.append(orbit.profile, np.zeros(equations.size - orbit.profile.size)), equations.positions
    state[: by.size] += by
    return state[: n or state.size], state[n or state.size :]


@in_turn
def simulate_orbit(
    orbit: Orbit,
    t: ArrayLike,
    size: float = 0.0,
    *,
    site: int | None = None,
    vector: ArrayLike | None = None,
    seed: int | None = None,
    method: str = "cvodes",
    tolerance: float = 1e-11,
    coordinates: str | None = None,
) -> Evolution:
    """Evolve an orbit from its phase zero, perturbed where a perturbation is given.

    Arguments:
        orbit: any orbit: of a family, or forced or dissipative of `find_orbit`.
        t: the wanted times, ascending from 0 on.
        size: of the perturbation.
        site: see `perturbed`, as for `vector` and `seed`.
        vector: direction of the perturbation.
        seed: of a random perturbation.
        method: see `evolve`, as for `tolerance` and `coordinates`.
        tolerance: of one step.
        coordinates: "gauge" or "physical".

    Returns:
        States at the times, in the coordinates of the model.

    Raises:
        ValueError: an argument is out of range.
        EvolutionError: the integrator fails.
    """
    model, values = _given_model(orbit)
    if number("size", size) != 0 or site is not None or vector is not None or seed is not None:
        start = perturbed(orbit, size, site=site, vector=vector, seed=seed)
    else:
        start = _displaced(orbit, equations_of_motion(model, values), np.zeros(0))
    return evolve(model, *start, t, method, tolerance, coordinates, parameters=values)


# Distance of a time evolution from an orbit: to its nearest point, so that a shift of phase alone has none ------------

ORBIT_PHASES = 2048  # of an orbit with any wave form
LEAST_COMPONENT_SCALE = 1e-6  # of the largest component of an orbit: the least scale of a component


def _state_curve(orbit: Orbit) -> tuple[Curve, Array]:
    """The states of an orbit of `find_orbit`, with the scale of each: half its range over the period.

    The unit is the root of the mean square distance of the orbit from its mean.
    """
    equations, count = equations_of_motion(*_given_model(orbit)), ORBIT_PHASES
    field = equations.physical.vector_field
    x = orbit.evaluate(orbit.period * np.arange(count) / count)
    half = 0.5 * np.ptp(x, axis=0)
    sizes = np.maximum(half, LEAST_COMPONENT_SCALE * np.max(half))

    def points(theta: Array) -> tuple[Array, Array]:
        t = np.mod(theta / orbit.Omega, orbit.period)
        states = orbit.evaluate(t)
        values = np.tile(equations.values[:, None], t.size)
        rates = np.array(field.map(t.size)(t[None], states.T, values)).T
        return states / sizes, rates / (sizes * orbit.Omega)

    unit = float(np.sqrt(np.mean(np.sum(((x - x.mean(axis=0)) / sizes) ** 2, axis=1))))
    return Curve(points, count, unit), sizes


@in_turn
def distance_from_orbit(orbit: Any, evolution: Evolution) -> Array:
    """Distance of a time evolution from an orbit at each time.

    Arguments:
        orbit: any orbit.
        evolution: of the same model.

    Returns:
        Shape (time,): of an orbit of a family the distance of (y, y'/Omega) to its nearest point over sqrt(S).
        Of another orbit each state is measured by half its range over the period, and the distance relative to the root
        of the mean square distance of the orbit from its mean. In a forced model it is the distance to the point that
        the orbit has at the same time, in others to the nearest: a shift of phase alone has no distance.
    """
    check_instance("evolution", evolution, Evolution)
    if not hasattr(orbit, "coefficients"):
        check_instance("orbit", orbit, Orbit)
    space = getattr(orbit, "space", None)
    if space is not None and space.connects != FAMILY:
        curve, sizes = _state_curve(orbit)
        states = evolution.states / sizes
        if not evolution.equations.physical.forced:
            return curve.distances(states)
        at_the_time, _ = curve.points(orbit.Omega * evolution.t)
        return np.asarray(np.linalg.norm(states - at_the_time, axis=1) / curve.unit)
    return cosine_curve(orbit).distances(np.hstack([evolution.displacements, evolution.velocities / orbit.Omega]))


# A model followed from any state and any time, stiff or not, for guesses of orbits ------------------------------------


@in_turn
def simulate(
    model: OdeModel | Chain,
    start: ArrayLike | Mapping[str, float],
    t: ArrayLike,
    *,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-9,
) -> Evolution:
    """Follow a model in time by CVODES with formulas for stiff equations (BDF), one with algebraic equations by IDAS.

    Arguments:
        model: any model, a `Chain` too; one of second order is followed in positions and velocities.
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
    equations = equations_of_motion(model_of(model).first_order(), by_name("parameters", parameters))
    given = state_by_name("start", start, equations.names) if isinstance(start, Mapping) else start
    x = real_array("start", given).ravel()
    if x.size != equations.size:
        raise ValueError(f"start: given {x.size} states; accepted: {equations.size}, {', '.join(equations.names)}")
    times = real_array("t", t).ravel()
    if times.size < 2 or np.any(np.diff(times) <= 0):
        raise ValueError(f"t: given {short_repr(times.tolist())}; accepted: two or more times, ascending")
    _check_tolerance(tolerance)
    x = consistent(equations.physical, equations.values, x, float(times[0]))
    later = simulated(equations.physical, equations.values, x, times, tolerance)
    states = np.vstack([x[None], later.states])
    implicit = equations.physical.implicit
    method = "cvodes" if implicit is None or not implicit.conditions else "idas"
    return Evolution(equations, times, states, method, tolerance, PHYSICAL, later.evaluations)
