"""A periodic orbit as a boundary-value problem: its guess, its closure, its phase conditions, its unfolding.

Guesses of solutions are numbers, functions, arrays, simulations and other solutions.

An orbit of an autonomous model has an unknown period and a phase that an integral condition fixes (Doedel 1981): the
orbit is orthogonal to the derivative of a reference, here a trigonometric polynomial made from the guess, beside what a
rotation adds in proportion to time. In a conservative model orbits come in families at fixed parameters, so that a
condition selects one, and the equations are made regular by a multiple of the gradient of each conserved quantity that
comes back as zero (Sepulchre and MacKay 1997; Munoz-Almaraz et al. 2003). A symmetry that belongs to one of them has a
phase of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from numbers import Real
from typing import Any, Protocol, TypeAlias, TypeGuard, TypeVar, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.model import methods
from casadi_skin.model.arguments import check_name, cut, number, short_repr
from casadi_skin.model.conserved import (
    HAMILTONIAN,
    SymmetryClass,
    directions,
    independent,
    is_odd,
    pinned_components,
    quantities,
)
from casadi_skin.model.expressions import Expression, real_array
from casadi_skin.model.jumps import Jumps
from casadi_skin.model.ode import OdeModel
from casadi_skin.native.programs import Program
from casadi_skin.zero.family import Method
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.stated_problem import PERIOD, SMALLEST_COMPONENT_RATIO
from casadi_skin.zero.statement import Bounds, Statement, check_expressions

T = TypeVar("T")


@runtime_checkable
class Evaluated(Protocol):
    """A solution, an orbit or a simulation."""

    def evaluate(self, t: ArrayLike) -> Array:
        """States, shape (time, component)."""
        ...


Guess: TypeAlias = Evaluated | Mapping[str, Any] | Callable[[float], Any] | ArrayLike | tuple[ArrayLike, ArrayLike]
JUMP_SAMPLES = 4001  # of a guess that has jumps
FIRST_SAMPLES = 501  # of any guess
SMOOTH_RANGES = 50.0  # ranges that a state without jumps goes through in an interval, at its greatest speed
CLOSED_GUESS_RTOL = 1e-6  # relative to the ranges of the states: a function that closes to this is left alone
CLOSER_RATIO = 0.1  # of how far it is from closing after the stated period, after its own
NEAR_PERIOD_RATIO = 0.25  # of the stated period, where its own is sought
RATE_STEP = 1e-5  # of the period: of differences that are velocities of a guess
CLOSING_STEP = 1e-9  # last step, relative to the period
ACCEPTED_GUESSES = (
    "numbers, one a state; a function of t; numbers or functions by state name; (t, x) with x of shape (times, "
    "states) or (states, times); a simulation or a solution"
)


def sampled(statement: Statement, guess: Guess, t: Array) -> Array:
    """The guess at times t, shape (time, component); raises ValueError unless it is one."""
    n = statement.model.full_size
    values = _values(statement.model.state_names, guess, t)
    if values.shape != (t.size, n):
        one = values.ndim == 2 and len(values) == t.size
        given = f"{values.shape[1]} at a time" if one else f"shape {values.shape} at {t.size} times"
        raise ValueError(f"guess: given {given}; accepted: {n} states: {', '.join(statement.model.state_names)}")
    if not np.all(np.isfinite(values)):
        raise ValueError("guess: given values that are not finite; accepted: finite numbers")
    return values


def known_times(statement: Statement, guess: Guess, count: int) -> Array:
    """Times over the interval at which a guess is best sampled: those of a simulated cycle, or even ones."""
    start, end = statement.span()
    known = getattr(guess, "times", None)
    return np.linspace(start, end, count) if known is None else start + (end - start) * known / known[-1]


def over_its_own_period(guess: Guess, names: Sequence[str], period: float, rotation: Array) -> Guess:
    """A function of time that closes after another time near the period, stretched to it; any other guess as it is.

    Where it does not close, a wave that goes around a ring has its jump at another phase of every unit, and what that
    does to the phases dies out slowly, so that Newton's method and Ipopt lose their way. `rotation` is what a period
    adds to the states called `names`.
    """
    functions = guess.values() if isinstance(guess, Mapping) else () if isinstance(guess, Evaluated) else (guess,)
    if not any(map(callable, functions)):
        return guess

    def at(t: float) -> Array:
        return np.asarray(_values(names, guess, np.array([t]))[0], dtype=float)

    try:
        ratio = _closing_time(at, period, rotation) / period
    except Exception:  # of the user's function, beyond the period for one: reported where it is sampled
        return guess
    return guess if ratio == 1.0 else lambda t: at(ratio * t)


def _closing_time(at: Callable[[float], Array], period: float, rotation: Array) -> float:
    """The time near the period after which a function closes, by nonlinear least squares; the period else."""
    from scipy.optimize import least_squares

    ranges, first = np.ptp([at(period * k / 8.0) for k in range(9)], axis=0), at(0.0)
    sizes = np.where(ranges > 0.0, ranges, 1.0)

    def miss(ratio: Array) -> Array:
        return np.asarray((at(period * float(ratio[0])) - first - rotation) / sizes)

    before = float(np.linalg.norm(miss(np.ones(1))))
    if before <= CLOSED_GUESS_RTOL:
        return period
    limits = 1.0 - NEAR_PERIOD_RATIO, 1.0 + NEAR_PERIOD_RATIO
    found = least_squares(miss, np.ones(1), bounds=limits, diff_step=[1e-6], xtol=CLOSING_STEP, ftol=None, gtol=None)
    return period * float(found.x[0]) if np.linalg.norm(found.fun) <= CLOSER_RATIO * before else period


def along_the_guess(statement: Statement, guess: Guess, counts: Sequence[int]) -> list[Array]:
    """Lengths of intervals that hold equal parts of time and of the length of a guess with jumps; empty for others.

    One array of shape (intervals,) for each of `counts`. The states are measured by their ranges. A guess with
    its own times, as a simulated cycle, is sampled there.
    """
    if is_straight(guess):
        return []
    start, end = statement.span()
    for samples in (FIRST_SAMPLES, JUMP_SAMPLES):
        times = known_times(statement, guess, samples)
        fine = np.unique(np.concatenate([times, 0.5 * (times[1:] + times[:-1])]))
        values = sampled(statement, guess, fine)
        ranges = np.ptp(values, axis=0)
        steps = np.abs(np.diff(values, axis=0)) / np.where(ranges > 0.0, ranges, np.inf)
        if np.all(
            np.max(steps, axis=1) * (end - start) < SMOOTH_RANGES * np.diff(fine)
        ):  # samples may be dense in a jump
            return []
    length = np.diff(fine) / (end - start) + np.sum(steps, axis=1) + 4.0 / (fine.size - 1)
    total = np.concatenate([[0.0], np.cumsum(length)])
    places = (fine - start) / (end - start)
    return [np.diff(np.interp(np.linspace(0.0, total[-1], count + 1), total, places)) for count in counts]


def is_straight(guess: Guess) -> bool:
    """Whether a guess is numbers, one a state, or samples at two times: such a guess says nothing of a mesh."""
    constant = isinstance(guess, list | tuple | np.ndarray) and all(isinstance(entry, Real) for entry in guess)
    return constant or (_is_sampled(guess) and np.size(guess[0]) == 2)


def _is_sampled(guess: Guess) -> TypeGuard[tuple[ArrayLike, ArrayLike]]:
    """Whether a guess is (t, x)."""
    times = guess[0] if isinstance(guess, list | tuple) and len(guess) == 2 else None
    return isinstance(times, list | tuple | range | np.ndarray)


def _values(names: Sequence[str], guess: Any, t: Array) -> Array:
    if not isinstance(guess, list | tuple | np.ndarray) and isinstance(guess, Evaluated):
        evaluated = partial(guess.evaluate, t)
        states = np.asarray(_called(evaluated, f"{short_repr(guess)} fails", ACCEPTED_GUESSES), dtype=float)
        if getattr(getattr(guess, "space", None), "is_family", False):  # whose orbits are evaluated in positions alone
            half = RATE_STEP * getattr(guess, "period", 1.0)
            states = np.hstack([states, (guess.evaluate(t + half) - guess.evaluate(t - half)) / (2.0 * half)])
        return states
    if isinstance(guess, Mapping):
        for name in guess:
            check_name("guess", name, names)
        return np.stack([_column(name, guess.get(name, 0.0), t) for name in names], axis=1)
    if callable(guess):

        def rows() -> Array:
            return np.array([np.asarray(guess(float(x)), dtype=float).ravel() for x in t])

        return _called(rows, "the function fails", f"one that gives {len(names)} numbers")
    if _is_sampled(guess):
        times, values = (real_array("guess", part, ACCEPTED_GUESSES) for part in guess)
        turned = values.shape == (len(names), times.size) != (times.size, len(names))  # as scipy has it
        return _interpolated(times, values.T if turned else values, t)
    return np.tile(real_array("guess", guess, ACCEPTED_GUESSES).ravel(), (t.size, 1))


def _column(name: str, given: Any, t: Array) -> Array:
    """Values of one state from a number or a function."""
    accepted = "a number, or a function of t"
    if callable(given):
        column = partial(np.fromiter, (float(given(float(x))) for x in t), float)
        return _called(column, f"the function for {name} fails", accepted)
    try:
        return np.full(t.size, number(name, given))
    except (TypeError, ValueError):
        raise ValueError(f"guess: given {short_repr(given)} for {name}; accepted: {accepted}") from None


def _called(compute: Callable[[], T], words: str, accepted: str) -> T:
    """The result of a function of the user, of a class, or of somebody else's object; raises ValueError as it fails."""
    try:
        return compute()
    except Exception as error:
        raised = cut(" ".join(f"{type(error).__name__}: {error}".split()), 200)
        raise ValueError(f"guess: {words}: {raised}; accepted: {accepted}") from error


def _interpolated(times: Array, values: Array, t: Array) -> Array:
    if times.ndim != 1 or times.size != len(values) or times.size < 2 or not np.all(np.diff(times) > 0):
        given = f"times of shape {times.shape}, states of shape {values.shape}"
        raise ValueError(f"guess: given {given}; accepted: two or more ascending times, one row of states each")
    if not np.all(np.isfinite(values)):
        raise ValueError("guess: given values that are not finite; accepted: finite numbers")
    if times.size == 2:
        share = np.clip((t - times[0]) / (times[1] - times[0]), 0.0, 1.0)[:, None]
        return np.asarray((1.0 - share) * values[0] + share * values[1])
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(times, values)(np.clip(t, times[0], times[-1])))


# Orbits as statements -------------------------------------------------------------------------------------------------

UNFOLDING = "unfolding"  # of the hamiltonian; of another quantity with its name after it
GUESS_SAMPLES = 256  # of the guess over a period
LARGEST_GUESS_STATE = 1e150  # state of a guess
REFERENCE_HARMONICS = 12  # of the reference of the phase
REFERENCE_ROUNDING = 1e-10  # of the largest harmonic: smaller ones are rounding, of a guess that is a cosine
DEPENDENT_GRADIENTS = 0.05  # relative: gradients of conserved quantities along a guess that count as dependent
CONSTANT_ROUNDING = 10.0 * EPSILON  # of a component: harmonics that rounding gives to one that does not move
TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Extended(OdeModel):
    """A model with more parameters; its values are as good as those of the one that it is made of."""

    inner: OdeModel

    @property
    def rounding(self) -> float:
        return self.inner.rounding

    @property
    def programs(self) -> tuple[Program, ...]:
        return self.inner.programs

    @cached_property
    def jumps(self) -> Jumps:
        """Those of the model that it is made of: time does not enter."""
        return self.inner.jumps


def extended(model: OdeModel, length: float, unfolded: Mapping[str, Expression]) -> Extended:
    """A model with its period, nominally `length`, and the unfolding coefficients among the parameters.

    Time goes from 0 to the period.
    """
    kind, names = type(model.state), (*model.parameter_names, PERIOD, *unfolded)
    p, count = kind.sym("p", len(names)), int(model.parameters.numel())
    rhs = model.field_at(0.0, model.state, p[:count])
    for k, quantity in enumerate(unfolded.values(), start=1):
        slope = model.function("slope", ca.gradient(quantity, model.state))
        rhs = rhs + p[count + k] * slope(0.0, model.state, p[:count])
    nominal = [*(model.nominal or ()), length, *(0.0 for _ in unfolded)]
    return Extended(
        model.name, model.state, rhs, p, time=kind.sym("t"), forcing_period=p[count], checked=False,
        nominal=tuple(nominal) if len(nominal) == len(names) else None,
        state_labels=model.state_names, parameter_labels=names, inner=model,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Reference:
    """One period of a guess as a trigonometric polynomial in the turn, from 0 to 1, beside its rotation.

    `complex` coefficients have shape (harmonics, states), `mean` and `rotation` (what is added in a period) (states,).
    """

    coefficients: Any
    mean: Array
    rotation: Array

    @property
    def _slopes(self) -> Any:
        """Coefficients of the derivative by the angle 2 pi turn."""
        return 1j * np.arange(1.0, len(self.coefficients) + 1)[:, None] * self.coefficients

    def _waves(self, turn: Expression, coefficients: Any) -> Expression:
        first = cos, sin = ca.cos(TWO_PI * turn), ca.sin(TWO_PI * turn)
        waves = [first]
        for _ in coefficients[1:]:  # products cost a tenth of what cosines do
            c, s = waves[-1]
            waves.append((c * cos - s * sin, s * cos + c * sin))
        cosines, sines = (ca.horzcat(*parts) for parts in zip(*waves, strict=True))
        return (cosines @ ca.DM(coefficients.real) - sines @ ca.DM(coefficients.imag)).T

    def state(self, turn: Expression) -> Expression:
        """The reference at a turn, without its rotation."""
        return self._waves(turn, self.coefficients) + ca.DM(self.mean)

    def along(self, turn: Array) -> Array:
        """Numbers of it at turns, with its rotation, shape (turns, states)."""
        waves = np.exp(2j * np.pi * np.outer(turn, np.arange(1, len(self.coefficients) + 1))) @ self.coefficients
        return np.asarray(self.mean + waves.real + np.outer(turn, self.rotation))

    def slope(self, turn: Expression) -> Expression:
        """Its derivative by the angle 2 pi turn, of the rotation too."""
        return self._waves(turn, self._slopes) + ca.DM(self.rotation / TWO_PI)

    @property
    def size(self) -> float:
        """Mean square of the slope over a period."""
        order = np.arange(1.0, len(self.coefficients) + 1)
        waves = np.sum(order[:, None] ** 2 * np.abs(self.coefficients) ** 2) / 2.0
        return float(waves + np.sum((self.rotation / TWO_PI) ** 2))


@dataclass(frozen=True, eq=False)
class OrbitRequest:
    """A first-order model, a guessed period, parameters, and the conditions on the orbit.

    `rotations` are how many times 2 pi is added to each state in a period, shape (states,).
    """

    model: OdeModel
    length: float
    cycles: int
    values: Mapping[str, float]
    rotations: Array
    guess: Guess | Reference
    symmetry: SymmetryClass = SymmetryClass.FULL
    select: Expression | None = None
    section: Expression | None = None
    free: tuple[str, ...] = ()
    bounds: Bounds | None = None
    objective: Expression | str | None = None
    running: Expression | None = None

    # Unfolding --------------------------------------------------------------------------------------------------------

    @cached_property
    def unfolded(self) -> dict[str, Expression]:
        """Conserved quantities that are unfolded, by the names of their coefficients.

        Of a reversible orbit those that change sign with the reversal: the others do not repeat what it closes by.
        Where gradients depend on each other along the guess, as where a symmetry moves it as time does, one is enough.
        """
        known = quantities(self.model)
        if self.symmetry is not SymmetryClass.FULL:
            odd = [name for name in self._phases if is_odd(self.model, name)]
            return {_unfolding(name): known[name] for name in odd}
        if len(known) > 1:
            slopes = [ca.densify(ca.gradient(quantity, self.model.state)) for quantity in known.values()]
            gradients = self.model.function("slopes", *slopes)
            _, values = self.sampled
            p = [self.values_of(self.model)[name] for name in self.model.parameter_names]
            along = [np.array([np.array(g) for g in gradients(0.0, x, p)]).reshape(len(known), -1) for x in values]
            kept = independent(np.hstack(along), DEPENDENT_GRADIENTS)
            known = {name: quantity for i, (name, quantity) in enumerate(known.items()) if i in kept}
        return {_unfolding(name): quantity for name, quantity in known.items()}

    @cached_property
    def _phases(self) -> dict[str, Expression]:
        return directions(self.model) if self.model.conserved else {}

    @property
    def symmetries(self) -> dict[str, Expression]:
        """Directions of the symmetries whose phase has to be fixed, by the names of the conserved quantities."""
        return {name: way for name, way in self._phases.items() if _unfolding(name) in self.unfolded}

    @property
    def selects(self) -> int:
        """Number of conditions that pick an orbit among those at fixed parameters."""
        if self.symmetry is not SymmetryClass.FULL:
            return 1
        return len(self.unfolded) - len(self.symmetries)

    # The model ------------------------------------------------------------------------------------------------------

    def extended(self) -> OdeModel:
        """The model with its period and the unfolding coefficients among the parameters."""
        return extended(self.model, self.length, self.unfolded)

    def at_start(self, model: OdeModel, label: str, expression: Expression) -> Expression:
        """An expression in states and parameters of the model, at phase zero of the extended one."""
        check_expressions([(label, expression)], [self.model.state, self.model.parameters])
        count = int(self.model.parameters.numel())
        function = ca.Function("condition", [self.model.state, self.model.parameters], [expression])
        return function(model.ends[0], model.parameters[:count])

    def values_of(self, model: OdeModel) -> dict[str, float]:
        """Values of the parameters, those that were added among them, by name."""
        known = dict(zip(self.model.parameter_names, self.model.nominal or (), strict=False)) | {PERIOD: self.length}
        known |= dict.fromkeys(model.parameter_names[len(self.model.parameter_names) + 1 :], 0.0)
        return {name: known[name] for name in model.parameter_names if name in known} | dict(self.values)

    def minimised(self, model: OdeModel, period: Expression) -> dict[str, Any]:
        """Objective and running cost of the statement, in the extended model."""
        found: dict[str, Any] = {"bounds": self.bounds or {}}
        if isinstance(self.objective, str):
            if self.objective != PERIOD:
                raise ValueError(
                    f"objective: given {short_repr(self.objective)}; accepted: an expression, or {PERIOD!r}"
                )
            found["objective"] = type(model.state)(period)
        elif self.objective is not None:
            found["objective"] = self.at_start(model, "objective", self.objective)
        if self.running is not None:
            symbols = [self.model.state, self.model.parameters, *([self.model.time] if self.model.forced else [])]
            check_expressions([("running", self.running)], symbols)
            along = self.model.function("running", self.running)
            time = model.time if self.model.forced else 0.0
            count = int(self.model.parameters.numel())
            found["running"] = along(time, model.state, model.parameters[:count]) / period
        return found

    # The guess ------------------------------------------------------------------------------------------------------

    @cached_property
    def sampled(self) -> tuple[Array, Array]:
        """Times over the guessed period and states of the guess there; raises ValueError for other guesses."""
        model, span = self.model, (0.0, self.length)
        if isinstance(self.guess, Reference):
            times = np.linspace(*span, GUESS_SAMPLES + 1)
            return times, self.guess.along(times / self.length)
        statement = Statement(model, [model.start(model.state)], interval=span, parameters=self.values_of(model))
        times = known_times(statement, self.guess, GUESS_SAMPLES + 1)
        states = sampled(statement, self.guess, times)
        largest = float(np.max(np.abs(states)))
        if largest > LARGEST_GUESS_STATE:
            raise ValueError(
                f"guess: given states up to {largest:.3g}; "
                f"accepted: up to {LARGEST_GUESS_STATE:g}, whose squares are finite"
            )
        return times, states

    @cached_property
    def reference(self) -> Reference:
        """The guess as a reference of phases; raises ValueError for one that does not move."""
        if isinstance(self.guess, Reference):
            return self.guess
        times, values = self.sampled
        turn, rotation = times / self.length, TWO_PI * self.rotations
        values = values - turn[:, None] * rotation
        waves = np.exp(-1j * TWO_PI * np.outer(np.arange(1, REFERENCE_HARMONICS + 1), turn))
        c = 2.0 * np.trapezoid(waves[:, :, None] * values, turn, axis=1)
        sizes = np.maximum(np.max(np.abs(c), axis=0), REFERENCE_ROUNDING * np.max(np.abs(c)))
        least = np.maximum(REFERENCE_ROUNDING * sizes, CONSTANT_ROUNDING * np.max(np.abs(values), axis=0))
        c = c[: 1 + np.max(np.flatnonzero(np.any(np.abs(c) > least, axis=1)), initial=0)]
        found = Reference(c, np.asarray(np.trapezoid(values, turn, axis=0)), rotation)
        if not found.size > 1e-24 * float(np.max(np.abs(values))) ** 2:
            raise ValueError("guess: given a state that does not move; accepted: one period of an orbit")
        return found


def _unfolding(name: str) -> str:
    return UNFOLDING if name == HAMILTONIAN else f"{UNFOLDING}_{name}"


def statement_of(request: OrbitRequest) -> Statement:
    """The boundary-value problem whose solution is the requested orbit.

    It is whole periods of a forcing; or the whole period, closed, with its phase; or half or a quarter of the period,
    from one fixed set of the reversal to the other. Autonomous models have their period among the unknowns.
    """
    forced, conditions, integrals = request.model.forced, list[Expression](), list[Expression]()
    if forced:
        model, values, free = request.model, request.values, request.free
        period: Any = request.cycles * model.forcing_period  # type: ignore[operator]
    else:
        model = request.extended()
        values, free = request.values_of(model), (PERIOD, *request.unfolded, *request.free)
        period = model.parameters[model.parameter_names.index(PERIOD)]
        integrals = _symmetry_phases(request, model, period)
    minimised, end = request.minimised(model, period), period
    if forced or request.symmetry is SymmetryClass.FULL:
        closure = model.end(model.state) - model.start(model.state)
        conditions.append(closure - ca.DM(TWO_PI * request.rotations) if np.any(request.rotations) else closure)
    else:
        first, last = pinned_components(request.model, request.symmetry)
        part, turned = request.symmetry.value, np.pi * request.rotations[last]  # half of the change in a period
        conditions += [model.start(model.state)[first], model.end(model.state)[last] - ca.DM(turned)]
        integrals = [phase / part for phase in integrals]
        minimised |= {"running": minimised["running"] / part} if "running" in minimised else {}
        end = part * period
    if request.select is not None:
        conditions.append(request.at_start(model, "select", request.select))
    if not forced and request.symmetry is SymmetryClass.FULL:
        if request.section is not None:
            conditions.append(request.at_start(model, "section", request.section))
        else:
            slope = request.reference.slope(model.time / period)
            phase = ca.dot(slope, _without_rotation(request, model, period)) / request.reference.size / period
            integrals = [phase, *integrals]
    return Statement(model, conditions, integrals, (0.0, end), values, free, **minimised)


def _without_rotation(request: OrbitRequest, model: OdeModel, period: Expression) -> Expression:
    """The state without its rotation, which is proportional to time, and without the mean of the reference then."""
    if not np.any(request.rotations):
        return model.state
    reference = request.reference
    return model.state - ca.DM(reference.rotation) * (model.time / period) - ca.DM(reference.mean)


def _symmetry_phases(request: OrbitRequest, model: OdeModel, period: Expression) -> list[Expression]:
    """For each symmetry the distance from the reference along it, whose mean vanishes."""
    found, reference = [], request.reference if request.symmetries else None
    for name, way in request.symmetries.items():
        assert reference is not None
        turn, count = model.time / period, int(request.model.parameters.numel())
        at, moved = reference.state(turn), request.model.function(name, ca.densify(way))
        along = moved(0.0, at, model.parameters[:count])
        away = model.state - ca.DM(reference.rotation) * turn - at
        _, states = request.sampled
        p = [request.values_of(request.model)[entry] for entry in request.model.parameter_names]
        size = float(np.mean([float(ca.sumsqr(moved(0.0, x, p))) for x in states]))
        found.append(ca.dot(along, away) / size / period)
    return found


# Choices for a boundary-value problem: methods, scales of its unknowns, and the data of orbits ------------------------

DEFAULT_DEGREE, FIRST_INTERVALS = 6, 12  # of the polynomials, and intervals of the first mesh, by default


def boundary_method(options: Mapping[str, Any]) -> Method:
    """The methods of a boundary-value problem, every choice made; raises ValueError for values out of range."""
    for name, accepted, first in (
        ("transcription", tuple(methods.COLLOCATION_TABLES), "gauss"),
        ("flow", tuple(methods.FULL_PERIOD_FLOWS), "collocation"),
        ("walker", ("arclength",), "arclength"),
    ):
        options = {name: first, **options}
        if not isinstance(options[name], str) or options[name] not in accepted:
            raise ValueError(f"{name}: given {short_repr(options[name])}; accepted: {', '.join(accepted)}")
    method = Method(**{"degree": DEFAULT_DEGREE, "intervals": FIRST_INTERVALS, **options})
    method.check_degree(1)
    return method


MOVED_SAMPLES = 9  # places along a guess at which components are asked what others move them by


def _moved_by_others(statement: Statement, guess: Array, sizes: Array) -> Array:
    """What others of such sizes move each component by within the interval, or against its decay, (components,)."""
    model, (start, end), p = statement.model, statement.span(), list(statement.values.values())
    slopes, moved = model.function("slopes", ca.jacobian(model.full_rhs, model.full_state)), np.zeros(sizes.size)
    rows, columns = map(np.array, slopes.sparsity_out(0).get_triplet())
    for turn in np.linspace(0.0, 1.0, MOVED_SAMPLES):
        x = guess[int(turn * (len(guess) - 1))]
        changes = (end - start) * np.abs(np.array(slopes(start + turn * (end - start), x, p).nonzeros()))
        own, others = rows == columns, rows != columns
        by_others = np.bincount(rows[others], changes[others] * sizes[columns[others]], sizes.size)
        moved = np.fmax(moved, by_others / (1.0 + np.bincount(rows[own], changes[own], sizes.size)))
    return np.where(np.isfinite(moved), moved, 0.0)


def _moving(statement: Statement, guess: Array, name: str) -> float:
    """The value of a parameter that moves a component by its largest value within the interval; 1 where none does."""
    model, (start, end), p = statement.model, statement.span(), list(statement.values.values())
    way = ca.DM([float(other == name) for other in model.parameter_names])
    slopes, most = model.function("slopes", ca.jtimes(model.full_rhs, model.parameters, way)), 0.0
    sizes = np.max(np.abs(guess), axis=0)
    for turn in np.linspace(0.0, 1.0, MOVED_SAMPLES):
        slope = np.array(slopes(start + turn * (end - start), guess[int(turn * (len(guess) - 1))], p)).ravel()
        moved = (end - start) * np.abs(slope[sizes > 0.0]) / sizes[sizes > 0.0]
        most = float(np.max(moved, where=np.isfinite(moved), initial=most))
    return 1.0 / most if most > 0.0 else 1.0


@dataclass(frozen=True)
class Sizes:
    """Least scales of the components of the state and of the free parameters."""

    states: Array
    scalars: Array

    @classmethod
    def of(cls, statement: Statement, guess: Array) -> Sizes:
        """A thousandth of each component of the guess, as components have units; 1 for a guess of zeros.

        A thousandth of each free parameter too; of one that is 0, what moves a component by its size in the interval.

        A component far below others may be zero but for rounding: a millionth of what others move it by is the least.
        """
        states = 1e-3 * np.max(np.abs(guess), axis=0) if np.any(guess) else np.ones(guess.shape[1])
        small = (states > 0.0) & (states < SMALLEST_COMPONENT_RATIO * np.max(states))
        moved = np.max(np.abs(guess), axis=0)
        for _ in range(np.count_nonzero(small)):  # a position that is zero is moved by a velocity that is
            by_others = _moved_by_others(statement, guess, moved)
            rounded = small & (moved < SMALLEST_COMPONENT_RATIO * by_others)
            if not np.any(rounded):
                break
            moved = np.where(rounded, by_others, moved)
        states = np.where(small, np.maximum(states, SMALLEST_COMPONENT_RATIO * moved), states)
        values = {name: abs(statement.values[name]) for name in statement.free}
        return cls(states, np.array([1e-3 * v or _moving(statement, guess, name) for name, v in values.items()]))


@dataclass(frozen=True, eq=False)
class Periodic:
    """Data of an orbit: the model as declared, that of first order, the part of the period solved for.

    `turns` are the rotations of the states in a period, none where it is empty.
    """

    given: OdeModel
    model: OdeModel
    symmetry: SymmetryClass
    turns: tuple[int, ...] = ()

    def rotated(self, theta: Array) -> Array:
        """Additions of rotations at phases to states of the solved part, mirrored or not, shape (phases, states)."""
        turn = np.asarray(theta, dtype=float) / (2.0 * np.pi)
        mirrored = np.mod(turn, 1.0) > self.symmetry.value
        return np.asarray(2.0 * np.pi * np.outer(np.floor(turn) + mirrored, self.turns))
