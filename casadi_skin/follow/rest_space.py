"""Equilibria of one model: those near a guess, and as the solutions that a branch connects (see `SolutionSpace`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.codimension_two import EquilibriumCurveSearch, special_on_curve
from casadi_skin.follow.normal_forms import terms_of
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.rest_events import Census, special_between
from casadi_skin.follow.rest_samples import Leading, is_blurred, sample_of
from casadi_skin.follow.samples import Sample
from casadi_skin.follow.solution import Equilibrium, Solution, following_settings
from casadi_skin.follow.space import EQUILIBRIA, EquilibriumError, ParameterSpace, corrector_of, of_last_points
from casadi_skin.follow.special_points import SpecialPoint, check_second
from casadi_skin.model import methods
from casadi_skin.model.arguments import (
    by_name,
    check_name,
    number,
    number_within,
    pair,
    short_repr,
    state_by_name,
    whole,
)
from casadi_skin.model.integrators import simulated
from casadi_skin.model.jumps import PARAMETER, STATE, JumpError
from casadi_skin.model.ode import OdeModel, model_of
from casadi_skin.model.result import NoQuantityError, in_turn, renamed, warn_caller
from casadi_skin.solve.levels import ExactLevels, Levels
from casadi_skin.solve.newton import Correction
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.augmented import Singularity, SingularRest, singular_rest
from casadi_skin.zero.half_plane import HalfPlaneError
from casadi_skin.zero.kinds import BRANCH_POINT, EQUILIBRIUM_CURVES, HOPF, Unresolved
from casadi_skin.zero.linearised import LinearisedRest
from casadi_skin.zero.problem import Array, Scalar, SingularError
from casadi_skin.zero.rest import AlgebraicProblem, Course, Spectrum, Statics, sizes_at, sizes_of
from casadi_skin.zero.settings import ContinuationSettings, End, Point

if TYPE_CHECKING:
    from casadi_skin.lattice.chain import Chain

LONGEST_STEP = 1.0 / 30.0  # of the range of the parameter: eigenvalues do not come and go within a step
AT_JUMP = 1e-6  # of the sizes of states: distance of an equilibrium from a jump at which it counts as on it
SMALLEST_STATE = 1e-3  # of the sizes of states: a smaller one counts as no less
NO_ORBIT = "an equilibrium is no orbit: it has eigenvalues in place of multipliers, and no period"


@dataclass(frozen=True, eq=False)
class EquilibriumSpace(ParameterSpace):
    """Equilibria of a model; where `parameter` is named they are followed in it from a start.

    Attributes:
        statics: the model at rest; values of its parameters are those at the start of a branch.
        tolerance: relative error of the state.
        corrector: name of the corrector.
        sizes: scales of the components of the state.
    """

    statics: Statics
    tolerance: float
    corrector: str
    sizes: Array
    connects = EQUILIBRIA
    stability_included = True
    solution_class = Equilibrium
    error = EquilibriumError

    @property
    def model(self) -> OdeModel:
        """The model in its own coordinates."""
        return self.statics.model

    @property
    def begins(self) -> float:
        """Value of the parameter followed at the start."""
        return self.statics.values[self.parameter]

    @property
    def course(self) -> Course | None:
        """Course of the parameter that is followed; None where none is."""
        return Course(self.parameter, self.begins, self.to) if self.parameter else None

    @cached_property
    def problem(self) -> AlgebraicProblem:
        """The equations, with u that follows the parameter."""
        return AlgebraicProblem(self.statics, self.sizes, (), self.course)

    def problem_at(self, first: Point) -> AlgebraicProblem:
        """The only equations that there are."""
        return self.problem

    @cached_property
    def levels(self) -> Levels:
        """The one level that there is."""
        return ExactLevels(self.problem, lambda problem: corrector_of(self.corrector, self.tolerance, problem))

    @cached_property
    def point_solver(self) -> PointSolver:
        """The solver of points at the tolerance."""
        settings = self.settings or ContinuationSettings(1.0, self.tolerance)
        return PointSolver(self.levels, replace(settings, max_parameter_step=LONGEST_STEP))

    @of_last_points
    def sample(self, point: Point) -> Sample:
        """Eigenvalues and rates at a point."""
        return sample_of(point, self.point_solver.metric(point.problem, point.z), self.leading(point))

    @of_last_points
    def blurred(self, point: Point) -> bool:
        """Whether rounding decides the sign of the rate of the parameter at a point."""
        return is_blurred(point, self.point_solver.metric(point.problem, point.z), self.leading(point))

    @of_last_points
    def leading(self, point: Point) -> Leading:
        """The eigenvalues at a point that matter."""
        return Leading.at(point, self.census.whole)

    @cached_property
    def census(self) -> Census:
        """Where the number of eigenvalues is proved."""
        return Census(self)

    def unproved(self) -> list[Unresolved]:
        """The last part of the branch where the number of eigenvalues is not proved."""
        return self.census.close()

    def refined(self, problem: Any, correction: Correction) -> Point:
        """The equilibrium of a correction with u held; raises EquilibriumError where it is not regular."""
        name = self.model.name
        deficiency = problem.deficiency(correction.z)
        if deficiency:
            why = "the equilibrium is not alone there, as with a conserved quantity, or lies at a fold"
            raise EquilibriumError(f"{name}: {deficiency}: {why}")
        try:
            point = self.point_solver.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
        except SingularError as error:
            raise EquilibriumError(f"{name}: the equilibrium cannot be refined: {error}") from error
        if point is None:
            raise EquilibriumError(f"{name}: the equilibrium cannot be refined to the tolerance; try a larger one")
        return point

    # The branch -----------------------------------------------------------------------------------------------------

    def branch_space(
        self, solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> EquilibriumSpace:
        """The space of the branch through one of these equilibria in a parameter."""
        x, statics = solution.point.problem.state(solution.point.z), Statics(self.model, solution.parameters)
        sizes = sizes_at(statics, x, (Course(parameter, solution.parameters[parameter], to),), self.sizes)
        first = replace(solution.point, z=np.append(x / sizes, 0.0))
        return EquilibriumSpace(
            statics, self.tolerance, self.corrector, sizes,
            parameter=parameter, to=to, settings=settings, at=at, first=first,
        )  # fmt: skip

    def special_between(self, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
        """Special points on the stretch between two points, in order; `gaps` gets parts that are not resolved."""
        yield from special_between(self, before, after, gaps)

    def is_unclear(self, start: Point, reach: float) -> bool:
        """Likewise, by where pairs cross the imaginary axis to first order: at other points a start is not regular."""
        if self.leaves or self.kind:
            return self.leaves
        here = self.leading(start)
        crosses = np.abs(here.values.real) <= here.noise + reach * np.abs(here.rates.real)
        return bool(np.any(crosses & (here.values.imag > 0.0)))

    def stop(self, point: Point) -> tuple[End | None, str]:
        """JUMP where the equations jump at the point, or between the start of the branch and the point."""
        jumps = self.model.jumps
        if not jumps.found:
            return None, ""
        (_, x, p), (_, y, q) = map(self.reading, (self.start, point))
        words = self.jump(point) or jumps.along(np.zeros(2), np.array([x, y]), np.array([p, q]), STATE | PARAMETER)
        return (End.JUMP if words else None), words

    def jump(self, point: Point) -> str:
        """That the equations jump at an equilibrium, with the equation; empty where they do not."""
        _, x, p = self.reading(point)
        sizes = np.resize(self.sizes, x.size)  # those of velocities are not known: the positions' stand for them
        return self.model.jumps.beside(x, p, AT_JUMP * np.maximum(np.abs(x), sizes))

    def reading(self, point: Point) -> tuple[float, Array, Array]:
        """Time 0, the state of first order and the parameters of a point."""
        y = point.problem.state(point.z)
        return 0.0, np.concatenate([y, np.zeros(self.model.full_size - y.size)]), point.problem.parameters(point.z)

    # Values ---------------------------------------------------------------------------------------------------------

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.statics.names

    def parameters(self, point: Point) -> dict[str, float]:
        return dict(point.problem.named(point.z))

    def parameter_error(self, point: Point) -> float:
        """Estimated absolute error of the parameter followed at a special point."""
        return abs(point.error.parameter * (self.to - self.begins)) if self.parameter else 0.0

    def free_error(self, point: Point) -> float:
        """0: no parameter is found with the state."""
        return 0.0

    @of_last_points
    def spectrum(self, point: Point) -> Spectrum:
        """Eigenvalues at a point."""
        z = point.z
        return self.statics.spectrum(point.problem.state(z), point.problem.parameters(z), self._off(point))

    def _off(self, point: Point) -> Array:
        """The estimated error of the state."""
        z, error = point.z, point.error.profile
        moved = self.sizes * np.maximum(np.abs(z[: self.statics.size]), SMALLEST_STATE)
        return moved * (error if np.isfinite(error) else 0.0)

    @of_last_points
    def unstable_at(self, point: Point) -> int:
        """The number of eigenvalues at a point with a positive real part, by more than estimated errors."""
        part = self.leading(point).part if self.model.order == 1 and self.statics.is_sparse else None
        with suppress(HalfPlaneError):
            if part is not None and part.missing == 0:
                x, p = point.problem.state(point.z), point.problem.parameters(point.z)
                here, there = (self.statics.matrix(y, p) for y in (x, x + self._off(point)))
                there.data -= here.data
                off = np.abs(part.rates(self.statics.scaled(there, point.problem.scale)))
                return int(np.count_nonzero(part.values.real > part.errors(self.model.rounding) + off))
        found = self.spectrum(point)
        return int(np.count_nonzero(found.values.real > found.errors))

    def energy(self, *_: object) -> Any:
        """Raises NoQuantityError, as `floquets` and `floquet_vectors`."""
        raise NoQuantityError(NO_ORBIT)

    floquets = floquet_vectors = energy


# Folds, Hopf points and branch points followed in a second parameter, by augmented problems --------------------------

UNFOLDING_PUSH = 1e-7  # of the size of a push, in a step: one that grows along a curve of branch points


class UnfoldingError(EquilibriumError):
    """A branch point does not stay one in a second parameter: nothing keeps both branches together."""


@dataclass(frozen=True, eq=False)
class CurveSpace(EquilibriumSpace):
    """Special points of a model in two parameters, of which one is followed and the other one free.

    Attributes:
        singularity: what makes them special.
        second: course of the free parameter: 0 at its start, 1 after a change by its usual size.
    """

    singularity: Singularity | None = None
    second: Course | None = None

    @property
    def kind(self) -> str:
        """Of the special points."""
        assert self.singularity is not None
        return self.singularity.kind

    @cached_property
    def problem(self) -> AlgebraicProblem:
        """The augmented problem, with u that follows the parameter."""
        assert self.singularity is not None
        assert self.second is not None
        return SingularRest(self.singularity, AlgebraicProblem(self.statics, self.sizes, (self.second,), self.course))

    @property
    def free(self) -> tuple[str, ...]:
        """The parameter that is solved for with the state."""
        return () if self.second is None else (self.second.name,)

    def linearised(self, point: Point, widening: float = 1.0) -> LinearisedRest:
        """The equations around a point, in the sizes of the branch: tests along it have one scale.

        Raises ArithmeticError where a pair is real.
        """
        problem, z, names = point.problem, point.z, list(self.statics.values)
        statics = self.statics if widening == 1.0 else replace(self.statics, widening=widening)
        ways = {names.index(course.name): course.extent for course in (*problem.free, problem.walking) if course}
        left = problem.border(z).left[:, 0] if self.kind == BRANCH_POINT else None
        near = problem.frequency_of(z) if self.kind == HOPF else None
        x, p = problem.state(z), problem.parameters(z)
        return LinearisedRest(statics, x, p, problem.scale, np.ones(problem.states), ways, left, near)

    def coefficient(self, point: Point, widening: float = 1.0) -> float:
        """The coefficient of the normal form of a Hopf point; infinite where a pair is real, or an eigenvalue zero."""
        try:
            linear = self.linearised(point, widening)
            return float(np.sum(terms_of(self.kind, linear, *linear.critical(self.kind))))
        except (ArithmeticError, np.linalg.LinAlgError):
            return np.inf

    def special_between(self, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
        """Points of codimension two on the stretch between two points, in order; `gaps` gets parts not resolved."""
        yield from special_on_curve(EquilibriumCurveSearch(self, before, after), gaps)

    def stop(self, point: Point) -> tuple[End | None, str]:
        """Beyond a Bogdanov-Takens point there are neutral saddles in place of Hopf points."""
        end = EQUILIBRIUM_CURVES[self.kind].ends.get(point.special)
        return (end, "") if end is not None else super().stop(point)


def curve_space(point: SpecialPoint, parameter: str, to: float, **options: Any) -> CurveSpace:
    """The space of the curve of a special point of equilibria in a second parameter; options are those of `curve`.

    Raises ValueError for arguments out of range and points of another kind, EquilibriumError where the curve cannot be
    started, or a branch point does not stay one.
    """
    solution = point.solution
    if not (solution.is_equilibrium and point.has_curve) or solution.space.free:
        raise ValueError(f"curve: given a {point.kind}; accepted: a fold, Hopf point or branch point of equilibria")
    check_second(point, parameter)
    settings = following_settings(solution, parameter, to, **options)
    old, statics = solution.space, Statics(solution.space.model, solution.parameters)
    x, p0, course = solution.positions, solution.parameters[point.parameter], old.course
    own = Course(parameter, solution.parameters[parameter], float(to))
    sizes, second = sizes_at(statics, x, (course, own), old.sizes), replace(course, start=p0, to=p0 + course.extent)
    near = 1j * point.frequency if point.kind == HOPF else None
    both = AlgebraicProblem(statics, sizes, (second,), own)
    problem, z = singular_rest(point.kind, both, np.append(x / sizes, [0.0, 0.0]), near)
    space = CurveSpace(
        statics, old.tolerance, old.corrector, sizes, problem.singularity, second, parameter=parameter, to=float(to),
        at=tuple(map(float, options["at"])), settings=settings,
        first=replace(solution.point, problem=problem, z=z, special="", walked=True),
    )  # fmt: skip
    check_kept(space, "no symmetry, and no state that stays zero,")
    return space


def check_kept(space: Any, why: str) -> None:
    """Raise UnfoldingError where branch points are none at other values of the second parameter."""
    start, problem = space.start, space.start.problem
    pushed = abs(float(start.tangent[problem.added_index]))
    if problem.singularity.pushes and pushed > UNFOLDING_PUSH * problem.push_size(start.z):
        where = f"{space.model.name}: the branch point is none at other values of {space.parameter}"
        raise UnfoldingError(f"{where}: {why} keeps both branches together")


# The equilibrium near a guess, and those near several starts ----------------------------------------------------------

TOLERANCE_RANGE = (1e-13, 1e-2)
MOST_STARTS = 1_000_000
# Of the sizes of the state: where a simulation ends, from the equilibrium that it is said to settle at.
SETTLED_DISTANCE = 0.05
FAR_POWERS_OF_TWO = 4.0  # powers of two between the sizes of a guess and those of the equilibrium found
SAME_EQUILIBRIUM_DISTANCE = 1e-6  # of the sizes: distance of two equilibria that are the same
ACCEPTED_GUESSES = "numbers, one a state, numbers by state name, a simulation or another equilibrium"


@in_turn
def find_equilibrium(
    model: OdeModel | Chain,
    guess: Any,
    *,
    parameters: Mapping[str, float] | None = None,
    transient: float | None = None,
    tolerance: float = 1e-10,
    corrector: str = "newton",
) -> Equilibrium:
    """The equilibrium near a guess, or where a simulation settles; dimensionless, or in the model's units.

    Arguments:
        model: an `OdeModel` of first or second order that no force drives in time, or a `Chain`.
        guess: numbers, one a state (of a model of second order the positions, or positions and velocities); numbers by
            state name, others 0; a simulation, whose end is taken; another equilibrium.
        parameters: values by name, where they are not the model's nominal ones.
        transient: time to simulate from the guess first.
        tolerance: relative error of each component, which counts as no less than a thousandth of its guess.
        corrector: "newton", which tries Ipopt where it fails, or "ipopt".

    Returns:
        The equilibrium, with its eigenvalues and its estimated error.

    Raises:
        ValueError, TypeError: an argument does not fit the model; a forced model is refused.
        EquilibriumError: no equilibrium is found, it is not alone, or the simulation does not settle.
        IntegrationError: the simulation fails.
    """
    statics = _statics(model, parameters)
    _check(tolerance, corrector)
    start = positions_of(statics.model, guess)
    statics = statics.decaying()
    with one_thread(), np.errstate(all="ignore"):  # of equations that are not finite somewhere
        if transient is None:
            return _near(EquilibriumSpace(statics, float(tolerance), corrector, sizes_of(statics, [start])), start)
        return _settled(statics, start, number("transient", transient), float(tolerance), corrector)


@renamed(lower="bounds")
@in_turn
def find_equilibria(
    model: OdeModel | Chain,
    bounds: Mapping[str, tuple[float, float]],
    upper: ArrayLike | None = None,
    *,
    starts: int = 64,
    seed: int = 0,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-10,
    corrector: str = "newton",
) -> tuple[Equilibrium, ...]:
    """The distinct equilibria near several starts in a box; there may be more.

    Arguments:
        model: as in `find_equilibrium`.
        bounds: (lower, upper) by state name, of each: a box, beyond which equilibria may lie.
        upper: until version 0.4 the upper corner of the box, its lower one in place of bounds.
        starts: number of starts, spread by a Sobol sequence.
        seed: of its scrambling.
        parameters, tolerance, corrector: as in `find_equilibrium`.

    Returns:
        The equilibria in the order of their first component; empty without any.

    Raises:
        ValueError, TypeError: an argument does not fit the model.
    """
    from scipy.stats.qmc import Sobol

    statics = _statics(model, parameters)
    model = statics.model
    _check(tolerance, corrector)
    if upper is None:
        low, high = _corners(bounds, model.state_names[: statics.size])
    else:
        words = "find_equilibria: lower and upper are bounds, (lower, upper) by name, and taken until version 0.4"
        warn_caller(words, DeprecationWarning)
        low, high = positions_of(model, bounds, "lower"), positions_of(model, upper, "upper")
        if not np.all(low <= high):
            raise ValueError("upper: given a number below that in lower; accepted: numbers >= those in lower")
    statics = statics.decaying()
    whole("starts", starts, 1, MOST_STARTS)
    whole("seed", seed, 0)
    space = EquilibriumSpace(statics, float(tolerance), corrector, sizes_of(statics, [low, high]))
    places = Sobol(statics.size, seed=seed).random(1 << max(0, (starts - 1).bit_length()))[:starts]
    found: list[Equilibrium] = []
    with one_thread():
        for place in places:
            try:
                equilibrium = _near(space, low + place * (high - low), second=False)
            except ArithmeticError:
                continue
            apart = [np.max(np.abs(other.positions - equilibrium.positions) / space.sizes) for other in found]
            if min(apart, default=np.inf) > SAME_EQUILIBRIUM_DISTANCE:
                found.append(equilibrium)
    return tuple(sorted(found, key=lambda equilibrium: tuple(equilibrium.positions)))


def _corners(bounds: Any, names: Sequence[str]) -> tuple[Array, Array]:
    """Lower and upper ends by name as arrays, shape (n,) each; raises ValueError and TypeError for what is none."""
    pairs = by_name("bounds", bounds, "(lower, upper)")
    for name in pairs:
        check_name("bounds", name, names)
    for name in names:
        if name not in pairs:
            raise ValueError(f"bounds: given none of {name}; accepted: (lower, upper) of each of {', '.join(names)}")
    ends = np.array([pair(f"bounds[{name}]", pairs[name]) for name in names])
    if not np.all(np.isfinite(ends)):
        raise ValueError(f"bounds: given {short_repr(bounds)}; accepted: finite numbers")
    return ends[:, 0], ends[:, 1]


def _statics(model: Any, parameters: Mapping[str, float] | None) -> Statics:
    """The equations of a model at rest; raises ValueError and TypeError for objects that are no model."""
    return Statics(model_of(model), dict(by_name("parameters", parameters)))


def _check(tolerance: float, corrector: str) -> None:
    number_within("tolerance", tolerance, *TOLERANCE_RANGE)
    check_name("corrector", corrector, methods.CORRECTORS)


def positions_of(model: OdeModel, guess: Any, label: str = "guess") -> Array:
    """A guess as values of the unknowns, shape (n,); raises ValueError for objects that are no guess."""
    names = model.state_names
    if isinstance(guess, Equilibrium):
        guess = guess.state
    elif hasattr(guess, "states") and hasattr(guess, "t"):  # a simulation, or an orbit
        guess = np.asarray(guess.states)[-1]
    if isinstance(guess, Mapping):
        guess = state_by_name(label, guess, names)
    try:
        values = np.asarray(guess, dtype=float).ravel()
    except (TypeError, ValueError):
        raise ValueError(f"{label}: given {short_repr(guess)}; accepted: {ACCEPTED_GUESSES}") from None
    if values.size not in (model.size, model.full_size):
        shown = ", ".join(names[: model.size])
        raise ValueError(f"{label}: given {values.size}; accepted: {model.size} numbers: {shown}")
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{label}: given numbers that are not finite; accepted: finite numbers")
    return np.array(values[: model.size])


def _near(space: EquilibriumSpace, start: Array, second: bool = True) -> Equilibrium:
    """The equilibrium near a state, by the corrector and, where that fails, by the other one."""
    problem, model, failure = space.problem, space.model, ""
    z, row = np.append(start / space.sizes, 0.0), problem.parameter_row()
    others = [name for name in methods.CORRECTORS if name != space.corrector] if second else []
    for name in (space.corrector, *others):
        own = name == space.corrector
        corrector = space.levels.corrector(problem) if own else corrector_of(name, space.tolerance, problem)
        correction = corrector.correct(z, row, 0.0)
        finite = bool(np.all(np.isfinite(correction.z)))
        if correction.converged and finite:
            found = Equilibrium(space, space.refined(problem, correction))
            words = space.jump(found.point)
            if words:
                raise JumpError(model, f"{words}, at the equilibrium")
            return _in_own_units(found) if second else found
        worst = problem.describe_largest_residual(correction.z if finite else z)
        failure = failure or f"{name}: {correction.status.value}; {worst}"
    full, p = np.concatenate([start, np.zeros(model.full_size - start.size)]), problem.parameters(z)
    rates = np.array(model.vector_field(0.0, full, p)).ravel()
    if not np.all(np.isfinite(rates)):
        name = model.state_names[int(np.argmax(~np.isfinite(rates)))]
        at = ", ".join(f"{k} = {x:.6g}" for k, x in zip(model.state_names, full, strict=True))
        failure = f"not finite at the equation of {name}, where {at} at the guess"
        given = np.array(model.function("given", model.given_rhs)(0.0, full, p))
        if np.all(np.isfinite(given)):
            failure = f"mass: no derivative of {name} follows {problem.describe_parameters(z)}, where {at} at the guess"
    jumps = model.jumps.beside(full, p, np.maximum(np.abs(full), np.resize(space.sizes, full.size)))
    more = f"; beside the guess {jumps}" if jumps else ""
    raise EquilibriumError(f"{model.name}: no equilibrium near the guess: {failure}{more}")


def _in_own_units(found: Equilibrium) -> Equilibrium:
    """An equilibrium solved for again where the sizes of its guess are far from its own."""
    space = found.space
    sizes = sizes_at(space.statics, found.positions, (), space.sizes)
    if np.max(np.abs(np.log2(sizes / space.sizes))) < FAR_POWERS_OF_TWO:
        return found
    again = replace(space, sizes=sizes)
    z, row = np.append(found.positions / sizes, 0.0), again.problem.parameter_row()
    correction = again.levels.corrector(again.problem).correct(z, row, 0.0)
    return Equilibrium(again, again.refined(again.problem, correction)) if correction.converged else found


def _settled(statics: Statics, start: Array, transient: float, tolerance: float, corrector: str) -> Equilibrium:
    """The stable equilibrium that a simulation approaches; raises EquilibriumError where it does not settle."""
    model = statics.model
    if not transient > 0.0:
        raise ValueError(f"transient: given {transient!r}; accepted: a finite number > 0")
    full = np.concatenate([start, np.zeros(model.full_size - model.size)])
    values = np.array(list(statics.values.values()))
    states = simulated(model.first_order(), values, full, np.linspace(0.0, transient, 201), 1e-9).states
    end = np.array(states[-1][: model.size])
    space = EquilibriumSpace(statics, tolerance, corrector, sizes_of(statics, [end]))
    last = np.stack([state[: model.size] for state in states[-50:]])
    moving = float(np.max(np.ptp(last, axis=0) / np.maximum(np.abs(end), space.sizes)))
    if moving > SETTLED_DISTANCE:
        words = f"over its last quarter the state changes by {moving:.2g} of its size"
        raise EquilibriumError(
            f"{model.name}: the simulation does not settle: {words}; try a longer transient or a guess"
        )
    found = _near(space, end)
    apart = float(np.max(np.abs(found.positions - end) / np.maximum(np.abs(end), space.sizes)))
    if apart > SETTLED_DISTANCE:
        words = f"the equilibrium found is {apart:.2g} of the state's size from where the simulation ends"
        raise EquilibriumError(f"{model.name}: the simulation does not settle: {words}; try a longer transient")
    return found
