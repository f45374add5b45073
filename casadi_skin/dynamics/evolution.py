"""Time evolutions: the equations of motion as they are integrated, and the states that follow from them.

The equations are in the coordinates of the model, or in a gauge that makes them symmetric: the positions are y = D q
with a diagonal matrix D of positive factors for which the linear equations at rest are symmetric. Without it an error
at the far end of a nonreciprocal lattice is amplified on its way to the edge that the modes lean to (Hatano and Nelson
1996).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from casadi_skin.lattice.chain import Chain, check_no_parameters
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.expressions import at_instants, instants
from casadi_skin.model.integrators import IntegrationError, stiff_cvodes
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import NoQuantityError, Result
from casadi_skin.zero.model_coordinates import linear_spectrum, scale_of_couplings
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import named_values

GAUGE, PHYSICAL = "gauge", "physical"
LONGEST_ENVELOPE = 700.0  # of -log D: beyond, positions at the far end are below the smallest double


@dataclass(frozen=True, eq=False)
class Gauge:
    """Equations of q, where the positions are y = D q; values of their parameters, and log D, shape (positions,)."""

    model: OdeModel
    parameters: Array
    log_scale: Array


@dataclass(frozen=True, eq=False)
class EquationsOfMotion:
    """The equations of motion of a model at fixed values of its parameters, which `equations_of_motion` makes.

    Attributes:
        model: the model as users see it.
        physical: its equations in its own coordinates.
        parameters: values of the model's parameters by name.
        values: of the parameters of `physical`, in its order.
        names: of the components of the state.
        gauge: the equations in their gauge; None where they have none.
        gauge_is_default: whether they are integrated in it unless it is said otherwise.
        escape: why a state may run to infinity, for messages.
        well: the displacement beyond which a position escapes; infinite where the model declares none.
    """

    model: Any
    parameters: Mapping[str, float]
    values: Array
    names: tuple[str, ...]
    gauge: Gauge | None
    gauge_is_default: bool
    escape: str = ""
    well: float = np.inf

    @property
    def physical(self) -> OdeModel:
        """The model in physical coordinates, that of a chain made where it is asked for."""
        return self.model if isinstance(self.model, OdeModel) else _physical_model(self.model)

    @property
    def positions(self) -> int:
        """Number of positions; 0 in a model of first order."""
        return self.size // 2 if self.gauge is not None or self.physical.order == 2 else 0

    @property
    def size(self) -> int:
        """Number of components of the state, positions then velocities in a model of second order."""
        return len(self.names)

    @cached_property
    def linear_frequencies(self) -> tuple[float, float] | None:
        """Lowest and highest linear frequency, of a chain their limits; None for a model without linear modes."""
        if not self.positions:
            return None
        used = [ca.depends_on(self.physical.rhs, entry) for entry in ca.vertsplit(self.physical.parameters)]
        kept = {name: value for (name, value), in_use in zip(self.parameters.items(), used, strict=False) if in_use}
        try:
            spectrum = linear_spectrum(self.model, kept)
        except ValueError:
            return None
        low, high = np.sqrt(np.maximum(spectrum.cutoffs or spectrum.ends, 0.0))
        return float(low), float(high)

    # Coordinates ------------------------------------------------------------------------------------------------------

    def in_coordinates(self, coordinates: str) -> tuple[OdeModel, Array, Array]:
        """Equations to be integrated, values of their parameters, and factors D of the positions.

        Raises ValueError where there is no such gauge, or doubles do not hold its factors.
        """
        if coordinates == PHYSICAL:
            return self.physical, self.values, np.ones(self.physical.size)
        gauge = self._known_gauge("coordinates")
        least = float(np.min(gauge.log_scale[np.isfinite(gauge.log_scale)]))
        if -least > LONGEST_ENVELOPE:
            raise ValueError(
                f"coordinates: given gauge, in which positions span exp({least:.4g}); accepted: down to "
                f"exp(-{LONGEST_ENVELOPE:g}), or physical"
            )
        return gauge.model, gauge.parameters, np.exp(gauge.log_scale)

    def to_gauge(self, states: Array, name: str) -> Array:
        """q = y/D of states (..., 2 positions); raises ValueError where a position that moves has no image."""
        scale = np.tile(np.exp(self._known_gauge(name).log_scale), 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            q = np.where(states == 0, 0.0, states / scale)
        absent = ~np.all(np.isfinite(q), axis=tuple(range(q.ndim - 1)))
        if np.any(absent):
            moves, accepted = self.names[int(np.argmax(absent))], 'zero there, or coordinates = "physical"'
            words = f"at {moves}, which moves and has no image in the gauge"
            raise ValueError(f"{name}: {words}; accepted: {accepted}, where no energy is kept")
        return np.asarray(q)

    def _known_gauge(self, name: str) -> Gauge:
        if self.gauge is None:
            raise ValueError(f"{name}: given gauge for {self.physical.name}, which has none; accepted: physical")
        return self.gauge

    # Energy -----------------------------------------------------------------------------------------------------------

    @property
    def conserves(self) -> bool:
        """Whether the model declares a conserved quantity, in its coordinates or in its gauge."""
        in_gauge = self.gauge is not None and self.gauge.model.hamiltonian is not None
        return in_gauge or self.physical.hamiltonian is not None

    def energy(self, states: Array) -> Array:
        """The conserved quantity that the model declares at states (many, size), shape (many,).

        Raises ValueError where it declares none, or declares one in a gauge without an image of the states.
        """
        model, values = self.physical, self.values
        if not self.conserves:
            raise NoQuantityError(f"energy: {model.name} declares no hamiltonian")
        if model.hamiltonian is None:
            gauge = self._known_gauge("energy")
            model, values, states = gauge.model, gauge.parameters, self.to_gauge(states, "energy")
        hamiltonian = model.function("H", ca.densify(model.hamiltonian))
        return np.array(hamiltonian(0.0, states.T, values), dtype=float).ravel()


def equations_of_motion(model: Any, parameters: Mapping[str, float] | None = None) -> EquationsOfMotion:
    """The equations of motion of a model.

    Arguments:
        model: a `Chain`, or any `OdeModel`.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.

    Returns:
        The equations with their gauge.

    Raises:
        ValueError, TypeError: the model or a parameter is not accepted.
    """
    if isinstance(model, type) or not hasattr(model, "equations_of_motion"):
        raise TypeError(f"model: given {short_repr(model)}; accepted: a Chain or an OdeModel")
    found: EquationsOfMotion = model.equations_of_motion(parameters)
    return found


def model_equations(model: OdeModel, parameters: Mapping[str, float] | None = None) -> EquationsOfMotion:
    """`equations_of_motion` of an `OdeModel`."""
    known = named_values(model, parameters)
    values = np.array(list(known.values()))
    gauge = _gauge_of(model, values)
    by_default = gauge is not None and 0.0 < -float(np.min(gauge.log_scale)) <= LONGEST_ENVELOPE
    return EquationsOfMotion(model, known, values, model.state_names, gauge, by_default)


def _gauge_of(model: OdeModel, values: Array) -> Gauge | None:
    """The equations in their gauge: of a model of second order whose linear part at 0 can be made symmetric."""
    if model.order == 1 or model.forced:
        return None
    force = ca.substitute(model.rhs, model.parameters, ca.SX(ca.DM(values)))
    slope = ca.Function("slope", [model.state], [ca.jacobian(force, model.state)])
    K = -np.array(slope(0.0))
    log_scale = scale_of_couplings(K, force, model.state) if np.all(np.isfinite(K)) else None
    if log_scale is None:
        return None
    D = ca.SX(ca.DM(np.exp(log_scale)))
    in_gauge = ca.substitute(force, model.state, D * model.state) / D
    scaled = OdeModel(model.name, model.state, in_gauge, order=2, velocity=model.velocity, checked=False)
    return Gauge(scaled, np.empty(0), log_scale)


# The last models of chains are kept, since evolutions of one are often many.
_gauge_model, _physical_model = (lru_cache(maxsize=2)(make) for make in (Chain.gauge_model, Chain.physical_model))


def chain_equations(chain: Chain, parameters: Mapping[str, float] | None = None) -> EquationsOfMotion:
    """Displacements y_n and velocities v_n of all sites of a chain; the energy is that of the gauge.

    Raises ValueError for an infinite chain.
    """
    check_no_parameters(parameters)
    if chain.infinite:
        raise ValueError("sites: given an infinite chain; accepted for time evolution: a whole number >= 1")
    escape, well, values = "", np.inf, np.array([chain.g], dtype=float)
    if chain.g < 0:
        escape = "with g < 0 a large displacement leaves the well and runs to infinity in finite time"
    if chain.g < 0 and chain.alpha > -2.0:
        well = float(np.sqrt((2.0 + chain.alpha) / -chain.g))
    names = tuple(f"{x}_{n}" for x in "yv" for n in range(1, chain.sites + 1))
    gauge = Gauge(_gauge_model(chain), values, chain.log_rho)  # eta at S = 1, where kappa is g
    return EquationsOfMotion(chain, chain.parameters, values, names, gauge, True, escape, well)


# The cycle that an evolution settles on: where it returns to itself, followed on where its outputs do not show it -----

FEWEST_CYCLE_TIMES = 40  # output times that a cycle is looked for in
AT_REST = 1e-6  # motion relative to that of the whole time that is none
NOISE_PER_TOLERANCE = 100.0  # motion relative to the tolerance that is none
CLOSED_CYCLE_DISTANCE = 0.02  # distance of two states a cycle apart, relative to the cycle's size
FOLLOWED_MOTION_TOLERANCE = 1e-11  # of the motion that is followed on
LEAST_COMPONENT_SIZE = 1e-6  # of the largest component, a size at least
PLACE_DISTANCE, PLACES_PER_STRETCH, MOST_STRETCHES = 0.02, 2000, 200  # of a size from place to place; places; stretches
TIME_SHARE = 40.0  # sizes that the whole time counts as
CUBIC_ERROR = 1e-6  # what cubics between the samples of a cycle may be off, of the value
MOST_CUBIC_HALVINGS = 20  # at most
LEAST_MEASURE = 1e-6  # of a size: smaller values are measured by it


def _cycle(evolution: Evolution) -> tuple[float, float] | None:
    """Start and period of the last cycle that output times show; None where they show none."""
    t, states = evolution.t, evolution.states
    if t.size < FEWEST_CYCLE_TIMES:
        raise ValueError(f"last_cycle: given {t.size} output times; accepted: {FEWEST_CYCLE_TIMES} or more, 20 a cycle")
    half = states[t.size // 2 :]
    spread = np.ptp(half, axis=0)
    noise = NOISE_PER_TOLERANCE * evolution.tolerance * np.max(np.abs(states))
    still = np.maximum(AT_REST * np.ptp(states, axis=0), noise)
    if np.all(spread <= still):
        raise ValueError(f"last_cycle: from t = {t[t.size // 2]:g} on the state rests: this is an equilibrium")
    component = int(np.argmax(np.std(half, axis=0)))
    level = float(np.mean(half[:, component]))
    below = states[:, component] < level
    up = np.flatnonzero(below[:-1] & ~below[1:])
    for earlier in up[-2::-1]:
        start, end = (_crossing(evolution, i, component, level) for i in (earlier, up[-1]))
        gap = np.abs(evolution.evaluate(start) - evolution.evaluate(end))
        if np.all(gap <= CLOSED_CYCLE_DISTANCE * np.maximum(spread, 1e-9 * spread.max())):
            return start, end - start
    return None


def _crossing(evolution: Evolution, i: int, component: int, level: float) -> float:
    """The time between two output times at which a component has a value."""
    curve = evolution.curve
    return float(brentq(lambda t: curve(t)[component] - level, evolution.t[i], evolution.t[i + 1]))


def _along_its_path(evolution: Evolution) -> Evolution:
    """The motion from the last state on for as long again, by CVODES, at places evenly along its path.

    The length of the path, in the sizes of the components, is the independent variable, with a share of the time that
    keeps it moving at rest: a jump, however fast, has as many places as its length asks for. Sizes grow with what is
    found: the output times may have missed all jumps.
    """
    equations, t, states = evolution.equations, evolution.t, evolution.states
    begin, span, places = float(t[-1]), float(t[-1] - t[0]), PLACE_DISTANCE * np.arange(1.0, PLACES_PER_STRETCH + 1)
    path, sizes = np.append(states[-1], 0.0)[None], np.max(np.abs(states), axis=0)
    for _ in range(MOST_STRETCHES):
        sizes = np.maximum(sizes, np.max(np.abs(path[:, :-1]), axis=0))
        scale = np.append(_least(sizes), 1.0)
        model = _by_length(equations.physical, scale[:-1], begin, span)
        try:
            found = stiff_cvodes(model, equations.values, path[-1] / scale, places, FOLLOWED_MOTION_TOLERANCE).states
        except IntegrationError:
            return evolution
        path = np.vstack([path, scale * found[: np.searchsorted(found[:, -1], 1.0) + 1]])
        if path[-1, -1] >= 1.0:
            break
    times = begin + span * path[:, -1]
    later = np.append(True, np.diff(times) > 0.0)
    return replace(evolution, t=times[later], states=path[later, :-1])


def _least(sizes: Array) -> Array:
    return np.maximum(sizes, LEAST_COMPONENT_SIZE * np.max(sizes))


def _by_length(model: OdeModel, scale: Array, start: float, span: float) -> OdeModel:
    """A model in its states over `scale` and in (time - start)/span, by the length of the path in all of these."""
    kind, n = type(model.state), scale.size
    z, p = kind.sym("z", n + 1), kind.sym("p", model.parameters.numel())
    rates = span * model.field_at(start + span * z[n], ca.DM(scale) * z[:n], p) / ca.DM(scale)
    speed = TIME_SHARE + ca.sqrt(ca.sumsqr(rates))
    return OdeModel(model.name, z, ca.vertcat(rates, 1.0) / speed, p, checked=False)


def _resolved(evolution: Evolution, start: float, period: float) -> Evolution:
    """A cycle at so many times that the cubics between its states follow the motion.

    Stretches are halved by CVODES until what their cubic misses halfway is small: beside a jump states decay within
    times that no length of the path shows.
    """
    first = int(np.searchsorted(evolution.t, start, side="right")) - 1
    last = int(np.searchsorted(evolution.t, start + period)) + 1
    found = replace(evolution, t=evolution.t[first:last], states=evolution.states[first:last])
    sizes = _least(np.max(np.abs(found.states), axis=0))
    open_ends = np.ones(found.t.size - 1, dtype=bool)  # stretches that may have to be halved
    for _ in range(MOST_CUBIC_HALVINGS):
        middles = 0.5 * (found.t[:-1] + found.t[1:])[open_ends]
        if not middles.size:
            break
        guessed, t = found.curve(middles), np.union1d(found.t, middles)
        states = np.vstack([found.states[:1], _followed(found, t[1:])])
        apart = np.abs(states[np.searchsorted(t, middles)] - guessed)
        off = np.max(apart / (np.abs(guessed) + LEAST_MEASURE * sizes), axis=1)
        found = replace(found, t=t, states=states)
        open_ends = np.isin(t, middles[off > CUBIC_ERROR])[1:] | np.isin(t, middles[off > CUBIC_ERROR])[:-1]
    return found


def _followed(evolution: Evolution, t: Array) -> Array:
    equations = evolution.equations
    start, origin = evolution.states[0], float(evolution.t[0])
    return stiff_cvodes(equations.physical, equations.values, start, t, FOLLOWED_MOTION_TOLERANCE, origin).states


@dataclass(frozen=True, eq=False)
class Evolution(Result):
    """States of a model in time; dimensionless, or in the units of the model.

    Attributes:
        equations: the equations of motion, with the model and the values of its parameters.
        t: times, ascending, shape (time,).
        states: in the coordinates of the model, shape (time, component): displacements, then velocities in a model of
            second order.
        method: name of the integrator.
        tolerance: tolerance requested of the integrator.
        coordinates: "gauge" or "physical", those that were integrated in.
        evaluations: of the forces, or of the right-hand side.
        step: of a method with a fixed one.
    """

    equations: EquationsOfMotion
    t: Array
    states: Array
    method: str
    tolerance: float
    coordinates: str
    evaluations: int
    step: float | None = None

    def __repr__(self) -> str:
        name = getattr(self.model, "name", None) or repr(self.model)
        times = f"{self.t.size} times from {self.t[0]:g} to {self.t[-1]:g}"
        return f"<Evolution of {name}: {times}, {self.states.shape[1]} components, by {self.method}>"

    @property
    def model(self) -> Any:
        """The model that moves, in its own coordinates."""
        return self.equations.model

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters of the model by name."""
        return self.equations.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components of the state."""
        return self.equations.names

    @property
    def displacements(self) -> Array:
        """Positions, shape (time, position); raises ValueError for a model of first order."""
        return self.states[:, : self._positions("displacements")]

    @property
    def velocities(self) -> Array:
        """Velocities, shape (time, position); raises ValueError for a model of first order."""
        return self.states[:, self._positions("velocities") :]

    def _positions(self, name: str) -> int:
        if not self.equations.positions:
            raise NoQuantityError(f"{name}: {self.equations.physical.name} is of first order; accepted: states")
        return self.equations.positions

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times between the first and the last by cubic Hermite interpolation.

        Shape (time, component), of one time (component,). Raises ValueError and TypeError for other times.
        """
        times = instants(t)
        if np.any((times < self.t[0]) | (times > self.t[-1])):
            raise ValueError(f"t: given {times.min():g} to {times.max():g}; accepted: {self.t[0]:g} to {self.t[-1]:g}")
        return at_instants(t, np.asarray(self.curve(times)))

    @cached_property
    def curve(self) -> Any:
        """The states as a spline of scipy."""
        field, values = self.equations.physical.vector_field, self.equations.values
        rates = field.map(self.t.size)(self.t[None], self.states.T, np.tile(values[:, None], self.t.size))
        return CubicHermiteSpline(self.t, self.states, np.array(rates).T)

    def last_cycle(self) -> Cycle:
        """The last stretch of time over which the state returns to itself.

        Where the output times are too far apart to show it, as in the jumps of a relaxation oscillation, the motion is
        followed on from the last of them for as long again by CVODES, at places evenly along its path.

        Raises:
            ValueError: there is none.
        """
        found = _cycle(self)
        if found is not None:
            return Cycle(self, *found)
        later = _along_its_path(self)
        found = _cycle(later)
        if found is None:
            words = "the state does not come back to itself"
            raise ValueError(f"last_cycle: from t = {self.t[0]:g} to {self.t[-1]:g} {words}")
        return Cycle(_resolved(later, *found), *found)

    # Energy -----------------------------------------------------------------------------------------------------------

    @property
    def has_energy(self) -> bool:
        """Whether the model declares a conserved quantity."""
        return self.equations.conserves

    @cached_property
    def energy(self) -> Array:
        """The conserved quantity that the model declares, shape (time,).

        Of a chain that of its gauge, with rho = 1 at the edge that the modes lean to. Raises ValueError where none is
        declared, and at |gamma| = 1 of a chain where sites off that edge move.
        """
        return self.equations.energy(self.states)

    @property
    def energy_drift(self) -> Array:
        """H(t) - H(first t), which the equations keep at 0, relative to |H(first t)|, shape (time,).

        In a model of second order it is relative to the largest kinetic energy where that is larger, as beside negative
        potential energies. Raises ValueError where `energy` does.
        """
        energy, n = self.energy, self.equations.positions
        size = abs(energy[0])
        if n:
            at_rest = np.hstack([self.states[:, :n], np.zeros((self.t.size, n))])
            size = max(size, float(np.max(energy - self.equations.energy(at_rest))))
        return np.asarray((energy - energy[0]) / (size or 1.0))

    @property
    def status(self) -> str:
        """The computation, its method and the drift of the energy, in a sentence."""
        words = f"{self.method} in {self.coordinates} coordinates, tolerance {self.tolerance:.3g}"
        if self.step is not None:
            words += f", step {self.step:.4g}"
        words += f": t = {self.t[-1]:.6g} reached with {self.evaluations} evaluations"
        if self.equations.physical.hamiltonian is not None or (self.has_energy and self.coordinates == GAUGE):
            words += f", energy kept to {np.abs(self.energy_drift).max():.1e}"
        return words


@dataclass(frozen=True, eq=False)
class Cycle:
    """A stretch of a time evolution after which it repeats itself: a guess for `find_orbit`, period included.

    `turns` are how many times 2 pi each state has grown by then, where angles rotate.
    """

    evolution: Evolution
    start: float
    period: float
    turns: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"<Cycle: from t = {self.start:.6g}, period {self.period:.10g}>"

    @property
    def times(self) -> Array:
        """Times of the samples of the states, from 0 at the start of the cycle to the period."""
        t = self.evolution.t - self.start
        return np.concatenate([[0.0], t[(t > 0.0) & (t < self.period)], [self.period]])

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times from the start of the cycle on, shape (time, component), or at one, shape (component,)."""
        periods, within = np.divmod(instants(t), self.period)
        states = self.evolution.evaluate(np.clip(self.start + within, self.start, self.evolution.t[-1]))
        if any(self.turns):
            states = states + 2.0 * np.pi * np.outer(periods, self.turns)
        return at_instants(t, states)


class EvolutionError(ArithmeticError):
    """A time evolution could not be followed to its end: the message names the time and the reason in one line.

    `evolution` holds the part computed before; None where there is none.
    """

    def __init__(self, message: str, evolution: Evolution | None) -> None:
        super().__init__(message)
        self.evolution = evolution
