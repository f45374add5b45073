"""First solutions: orbits near a guess, and solutions of boundary-value problems.

A guess is sampled on meshes, and corrected on one after the other; the point is refined until its estimated error meets
the tolerance. Where no corrector reaches a solution, Newton's method is next, where it has not been tried; then a short
continuation: the problem is solved at an easier value of one of its parameters, ten or a hundred times as large or as
small, and followed from there to the requested values.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import BoundaryError, FamilyError, NotRefinedError
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.arguments import (
    by_name,
    check_name,
    duration,
    function_of,
    number,
    number_within,
    short_repr,
    truth,
    whole,
)
from casadi_skin.model.conserved import SymmetryClass, quantities, symmetry_class
from casadi_skin.model.declarations import check_forcing_period
from casadi_skin.model.expressions import Expression, expression_of
from casadi_skin.model.integrators import IntegrationError, stiff_cvodes
from casadi_skin.model.jumps import JumpError
from casadi_skin.model.ode import OdeModel, model_of
from casadi_skin.model.result import in_turn
from casadi_skin.solve.levels import Levels, converged_mesh
from casadi_skin.solve.newton import Correction, NewtonCorrector, equilibrium_words, not_finite, rank_deficiency
from casadi_skin.solve.watch import TimeLimitError, watched
from casadi_skin.zero.family import Method
from casadi_skin.zero.orbit import (
    GUESS_SAMPLES,
    TWO_PI,
    UNFOLDING,
    Guess,
    OrbitRequest,
    Periodic,
    Sizes,
    along_the_guess,
    boundary_method,
    is_straight,
    over_its_own_period,
    sampled,
    statement_of,
)
from casadi_skin.zero.problem import Array, SingularError
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem, stated
from casadi_skin.zero.statement import Bounds, Statement, check_expressions, named_values

# Periodic orbits of any model: autonomous, forced, conservative, reversible; closed or rotating -----------------------

NOT_ZERO = 100.0  # tolerances that rates of what is conserved by the unfolding parameter may be of all
LONGEST_RETURN, RETURN_SAMPLES = 8.0, 1601  # stated periods in which a motion may come back, and places looked at
RETURN_TOLERANCE = 1e-6
# Of the ranges of the states: distance from the start that has left it, and that has come back.
GONE_DISTANCE, RETURNED_DISTANCE = 0.5, 0.1
OTHER_PERIOD_RTOL = 0.1  # relative difference of the stated period and another one
TURN_TRIALS, SAME_TIME = 3, 1e-9  # random points at which a field is compared with itself after one turn
# Motion relative to that of the guess, and to the states, that counts as rest.
SHRUNK_MOTION, STILL_MOTION = 1e-6, 1e-12


@in_turn
def find_orbit(
    model: OdeModel | Chain,
    guess: Guess,
    period: float | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    select: Expression | None = None,
    section: Expression | None = None,
    symmetric: bool = False,
    cycles: int = 1,
    rotations: Mapping[str, int] | None = None,
    free: Sequence[str] = (),
    bounds: Bounds | None = None,
    objective: Expression | str | None = None,
    running: Expression | None = None,
    **options: Any,
) -> Orbit:
    """The periodic orbit near a guess, closed or rotating.

    `model` is an `OdeModel`, a `Lattice` or a `Chain`, in physical coordinates with parameters alpha, gamma and g.

    `guess` gives the states over one period from time 0 on, as in `BoundaryValueProblem.solve`; `period` guesses the
    period of an autonomous model, where the guess (a cycle, another orbit) has none; the orbit of a forced one closes
    after `cycles` periods of the forcing. A function that closes after another time near `period` is taken over that
    time in its place.

    `select`, an expression in states and parameters that vanishes at phase zero,
    picks a member of the family in a model with a `hamiltonian` or where the orbit is `symmetric`: reversible, and then
    only half of it is unknown, or a quarter with the half-period symmetry. `section` vanishes at phase zero in place of
    the integral phase condition; without it phase zero is where the guess has it, so that a guess shifted in time makes
    `select` pick another member of a family, unless its expression is conserved. It has an entry for each of the
    `conserved` quantities without a symmetry; the guess fixes the phase of each one with a symmetry.

    `rotations` are numbers of turns by the names of states that are angles: 2 pi times as much is added in a period.

    Parameters that are `free` are solved for too: by `select`, or so that `objective` (at phase zero, or the word
    "period") plus the mean of `running` over the period is smallest within `bounds` on states, free parameters and
    "period". Expressions may be given as functions f(t, x, p) of CasADi's symbols. Options are those of
    `BoundaryValueProblem.solve`. Raises ValueError and TypeError for arguments that do not fit the model, BoundaryError
    where no orbit is found.
    """
    model = model_of(model)
    turns = rotations_of(model, rotations, truth("symmetric", symmetric))
    check_orbit(model, period, select, section, symmetric, cycles, free)
    length = 0.0 if model.forced else guessed_period(guess, period)
    model = model.decaying(lambda _: TWO_PI / (length or cycles * _forcing_period(model_of(model), parameters)))
    first = model.first_order()
    stated = {"section": section, "objective": objective, "running": running}
    section, objective, running = (scalar_of(label, given, first) for label, given in stated.items())
    if not model.forced:
        guess = over_its_own_period(guess, first.state_names, length, TWO_PI * turns)
    symmetry = SymmetryClass.FULL
    if symmetric:  # angles that rotate have no half-period symmetry
        symmetry = SymmetryClass.HALF if np.any(turns) else symmetry_class(model)
    request = OrbitRequest(
        first, length, cycles, by_name("parameters", parameters), turns, guess, symmetry,
        _column_of("select", select, first), section, tuple(free), by_name("bounds", bounds, "(lower, upper)"),
        objective, running,
    )  # fmt: skip
    _check_selects(request)
    statement = statement_of(request)
    try:
        solution = statement.solve(guess, **options)
        if not model.forced:
            _check_moves(model.name, solution, guess, length)
    except BoundaryError as error:
        apart = model.forced or isinstance(error, FamilyError)
        words = "" if apart else _returning_words(statement, guess, first, length)
        raise (BoundaryError(f"{error}; {words}") if words else error) from error.__cause__
    space = solution.space
    space = replace(space, periodic=Periodic(model, first, symmetry, tuple(int(k) for k in turns)))
    orbit = Orbit(space, solution.point, solution.exact, solution.optimum)
    if model.forced:
        check_forcing_period(model, orbit, orbit.period, orbit.parameters)
    if orbit.unfolding and _unfolded_rate(model, solution) > NOT_ZERO * max(space.tolerance, orbit.error):
        words = f"the unfolding parameter is {orbit.unfolding:.1e} in place of 0"
        kept = " or ".join(f"the {name}" for name in quantities(model))
        raise BoundaryError(f"{model.name}: {words}: {kept} is not conserved, or the orbit is degenerate")
    return orbit


def _forcing_period(model: OdeModel, parameters: Mapping[str, float] | None) -> float:
    return model.forcing_period_at(list(named_values(model, parameters).values()))


def rotations_of(model: OdeModel, given: Mapping[str, int] | None, symmetric: bool = False) -> Array:
    """Turns of each state in a period, shape (states,); raises ValueError and TypeError unless states are angles."""
    turns, names = np.zeros(model.full_size), model.state_names
    known = by_name("rotations", given, "whole numbers by the names of states")
    for name, k in known.items():
        check_name("rotations", name, names)
        if isinstance(k, bool) or not isinstance(k, int | np.integer):
            raise TypeError(f"rotations: given {short_repr(k)} for {name}; accepted: a whole number of turns")
        turns[names.index(name)] = k
    field, generator, turned = model.vector_field, np.random.default_rng(0), [n for n, k in known.items() if k]
    for _ in range(TURN_TRIALS if turned else 0):
        t, x, p = (np.abs(generator.normal(size=n)) for n in (1, model.full_size, model.parameters.numel()))
        here, there = (np.array(field(t, at, p)).ravel() for at in (x, x + TWO_PI * turns))
        if not np.max(np.abs(there - here)) <= SAME_TIME * (1.0 + np.max(np.abs(here))):
            why = f"in which {model.name} has no period 2 pi"
            raise ValueError(f"rotations: given {' and '.join(turned)}, {why}; accepted: states that are angles")
    if symmetric and model.reversal is not None:
        for name, k, sign in zip(names, turns, model.reversal, strict=True):
            if k and sign > 0:
                accepted = "angles whose sign the reversal changes, where the orbit is symmetric"
                raise ValueError(f"rotations: given {name}, which the reversal leaves as it is; accepted: {accepted}")
    return turns


def _check_selects(request: OrbitRequest) -> None:
    """Raises ValueError where the number of entries of `select` is not the dimension of the family."""
    given = 0 if request.select is None else int(request.select.numel())
    if request.model.forced or request.free or given == request.selects:
        return
    if request.selects < 2 and given < 2:
        return  # reported by name before
    alone = [name for name in request.model.conserved if name not in request.symmetries]
    why = f"; {', '.join(alone)} belong to no symmetry that is known (symmetries)" if alone else ""
    raise ValueError(f"select: given {given} expressions; accepted: {request.selects}{why}")


def _column_of(label: str, given: Any, model: OdeModel) -> Any:
    """One or several expressions of an argument, as a column; None as it is."""
    if given is None:
        return None
    symbols = [type(model.state).sym("t"), model.full_state, model.parameters]
    return ca.vec(expression_of(label, given, symbols, constants=False))


def scalar_of(label: str, given: Any, model: OdeModel) -> Any:
    """A scalar expression of an argument, a function f(t, x, p) too; names and None as they are."""
    if given is None or isinstance(given, str):
        return given
    time = type(model.state).sym("t") if model.time is None else model.time
    symbols = [time, model.full_state, model.parameters]
    expression = expression_of(label, given, symbols, constants=False)
    if expression.numel() != 1:
        raise ValueError(f"{label}: given shape {expression.shape}; accepted: a scalar expression")
    return expression


def checked_scalar(label: str, given: Any, model: OdeModel) -> Expression:
    """A scalar expression in time, states and parameters; raises ValueError and TypeError for other arguments."""
    expression = scalar_of(label, given, model)
    time = type(model.state).sym("t") if model.time is None else model.time
    check_expressions([(label, expression)], [time, model.full_state, model.parameters])
    return ca.densify(expression)


def _unfolded_rate(model: OdeModel, solution: Solution) -> float:
    """The largest rate of a conserved quantity by the unfolding terms, over those by which its components change it."""
    values = {name: solution.parameters[name] for name in solution.statement.model.parameter_names}
    without = {name: 0.0 if name.startswith(UNFOLDING) else value for name, value in values.items()}
    field, p = solution.statement.model.vector_field, [solution.parameters[name] for name in model.parameter_names]
    slopes = model.function("slopes", *(ca.gradient(kept, model.full_state) for kept in quantities(model).values()))

    def rates(x: Array) -> tuple[Array, Array]:
        whole, plain = (np.array(field(0.0, x, list(p.values()))).ravel() for p in (values, without))
        by_state = np.hstack([np.array(slope) for slope in slopes.call([0.0, x, p])]).T
        return np.abs(by_state @ (whole - plain)), np.abs(by_state) @ np.abs(whole)

    unfolded, own = np.array([rates(x) for x in solution.states]).max(axis=0)
    return float(np.max(unfolded[own > 0.0] / own[own > 0.0], initial=0.0))


def _check_moves(name: str, solution: Solution, guess: Guess, length: float) -> None:
    """Raises BoundaryError for an orbit at rest: an equilibrium solves the equations for any period."""
    statement, states = solution.statement, solution.states
    wanted = np.ptp(sampled(statement, guess, np.linspace(0.0, length, GUESS_SAMPLES)), axis=0)
    moved, size = np.ptp(states, axis=0), np.max(np.abs(states), axis=0)
    if np.any(moved > np.maximum(SHRUNK_MOTION * wanted, STILL_MOTION * size)):
        return
    raise BoundaryError(f"{name}: {equilibrium_words(solution.problem, solution.point.z)}")


def _returning_words(statement: Statement, guess: Guess, model: OdeModel, period: float) -> str:
    """That the motion from the guess comes back after another time than the stated period; empty where it does not."""
    times = np.linspace(0.0, LONGEST_RETURN * period, RETURN_SAMPLES)
    try:
        start = sampled(statement, guess, times[:1])[0]
        p = np.array([statement.values[name] for name in model.parameter_names])
        states = np.vstack([start[None], stiff_cvodes(model, p, start, times[1:], RETURN_TOLERANCE).states])
    except IntegrationError:  # from there nothing comes back
        return ""
    away = np.linalg.norm((states - start) / np.maximum(np.ptp(states, axis=0), np.finfo(float).tiny), axis=1)
    gone = int(np.argmax(away > GONE_DISTANCE)) if np.any(away > GONE_DISTANCE) else times.size
    least = gone + np.flatnonzero((away[gone + 1 : -1] < away[gone:-2]) & (away[gone + 1 : -1] <= away[gone + 2 :])) + 1
    back = least[away[least] < RETURNED_DISTANCE]
    if not back.size or abs(times[back[0]] / period - 1.0) < OTHER_PERIOD_RTOL:
        return ""
    found = float(times[back[0]])
    return f"from there the motion comes back after {found:.4g}, {found / period:.3g} times the given period"


def guessed_period(guess: Guess, period: float | None) -> float:
    """The period of the argument or of the guess; raises ValueError and TypeError where both are missing."""
    found = number("period", getattr(guess, "period", None) if period is None else period, "a number > 0")
    if found <= 0:
        raise ValueError(f"period: given {period!r}; accepted: a number > 0")
    return found


def check_orbit(
    model: OdeModel,
    period: float | None,
    select: object,
    section: object,
    symmetric: bool,
    cycles: int,
    free: Sequence[str] = (),
) -> None:
    """Raises ValueError and TypeError for conditions and a period that an orbit of the model does not have."""
    whole("cycles", cycles, 1)
    if not isinstance(free, list | tuple):
        raise TypeError(f"free: given {short_repr(free)}; accepted: a list of names of parameters")
    if model.forced:
        selects = None if free else select
        given = [n for n, v in (("period", period), ("select", selects), ("section", section)) if v is not None]
        given += ["symmetric"] if symmetric else []
        if given:
            raise ValueError(
                f"{given[0]}: given for {model.name}, which is forced; accepted: cycles, after which it closes"
            )
        return
    if cycles != 1:
        raise ValueError(f"cycles: given {cycles} for {model.name}, which is autonomous; accepted: 1, with its period")
    if symmetric and model.reversal is None:
        raise ValueError(f"symmetric: given for {model.name}, which declares no reversal; accepted: with one")
    family = symmetric or model.hamiltonian is not None or bool(model.conserved)
    if family and select is None and not free:
        why = "symmetric" if symmetric else "conservative"
        raise ValueError(f"select: given none; accepted: a value at phase zero, for {why} orbits come in families")
    if not family and select is not None and not free:
        raise ValueError(f"select: given for {model.name}; accepted: with a hamiltonian, or a symmetric orbit")
    if symmetric and section is not None:
        raise ValueError("section: given with symmetric = True, which fixes the phase; accepted: one of them")
    for name in (PERIOD, UNFOLDING):
        if name in model.parameter_names or name in model.state_names:
            raise ValueError(f"{model.name}: given a state or parameter called {name}; accepted: other names")


# An orbit of a family as a boundary-value problem of its model, so that it can be followed in any parameter -----------

AMPLITUDE_NAME = "S"


def restated(orbit: Any, parameter: str) -> Orbit:
    """The orbit of the model in its own coordinates at the same S, which becomes a parameter.

    Arguments:
        orbit: an orbit of a family.
        parameter: the parameter to follow, for the message: one of the model, or "S".

    Returns:
        The same orbit, solved by Gauss collocation on the part of the period that the symmetries leave.

    Raises:
        ValueError: the model has no such parameter.
        BoundaryError: the orbit is not found in these coordinates.
    """
    family = orbit.space
    family.coordinates.check_whole("an orbit followed in a parameter")
    extended, amplitude, select = with_amplitude(family.coordinates.model)

    def guess(t: float) -> list[float]:
        h = 1e-6 * orbit.period
        before, here, after = orbit.evaluate([t - h, t, t + h])
        return [*here, *((after - before) / (2.0 * h))]

    values = {**orbit.parameters, amplitude: orbit.S}
    return find_orbit(
        extended, guess, orbit.period, parameters=values, select=select, symmetric=True, tolerance=orbit.space.tolerance
    )


def with_amplitude(model: OdeModel) -> tuple[OdeModel, str, ca.SX]:
    """The model with S among its parameters, its name there, and the function that vanishes where S has its value."""
    form = amplitude_square(model)
    if form.parameter is not None:
        return model, form.parameter, form.form - model.parameters[model.parameter_names.index(form.parameter)]
    name = AMPLITUDE_NAME
    while name in (*model.parameter_names, *model.state_names):
        name += "_"
    extended, square = model.with_parameter(name, form.form)
    return extended, name, square - extended.parameters[-1]


# Other ways to a first solution where the correctors do not reach it from the guess -----------------------------------

EASIER_PARAMETER_FACTORS = (10.0, 0.1)  # of a parameter, and their squares, at which the problem may be easier
MOST_PARAMETERS = 3  # that are tried
MOST_POINTS = 60  # of a continuation


def other_ways(space: BoundarySpace, guess: Guess) -> tuple[Solution | None, str]:
    """The solution near a guess by another way with its description, or None with the ways that failed, in words."""
    statement, tried = space.statement, list[str]()
    newton = replace(space, method=replace(space.method, corrector="newton"))

    def near(guess: Guess, **values: float) -> Solution | None:
        """The solution near a guess at other values of parameters, sought quickly."""
        there = replace(newton, statement=statement.with_parameters(**values)) if values else newton
        with suppress(BoundaryError):
            return Solution(there, first_point(there, guess, QUICK_TRIES))
        return None

    def followed(easier: Solution, name: str, value: float) -> Solution | None:
        """The solution that the branch from an easier one comes to, unless it turns back before."""
        with suppress(BoundaryError):
            branch = easier.follow(name, value, max_points=MOST_POINTS, until=lambda one: bool(one.point.special))
            reached = branch.solutions[-1]
            return near(reached) if reached.parameters[name] == value else None
        return None

    if space.method.corrector != "newton":
        tried.append("Newton's method")
        found = near(guess)
        if found is not None:
            return replace(found, found_by=tried[-1]), tried[-1]
    fixed = {name: value for name, value in statement.values.items() if name not in statement.free and value}
    fixed = fixed if len(fixed) <= MOST_PARAMETERS else {}
    for name, value in fixed.items():
        starts = []
        for factor in EASIER_PARAMETER_FACTORS:
            for easier_value in (factor * value, factor**2 * value):
                starts.append(f"{easier_value:g}")
                easier = near(guess, **{name: easier_value})
                if easier is None:
                    continue
                found = followed(easier, name, value)
                if found is not None:
                    words = f"{name} followed from {easier_value:g} to {value:g}"
                    return replace(found, found_by=words), words
                break  # the branch does not come here: nor does it from farther off
        tried.append(f"{name} followed from {', '.join(starts)}")
    hint = f"; not tried: {' or '.join(fixed)} by arclength past folds, with follow from a solution at another value"
    return None, "; ".join(tried) + (hint if fixed else "")


# Solving a stated boundary-value problem: a mesh that adapts until the estimated error meets the tolerance ------------

NOT_METHODS = ("tolerance", "time_limit", "progress")
METHODS = ("transcription", "degree", "corrector", "intervals", "flow", "walker")
FIRST_SOLUTION_OPTIONS = (NOT_METHODS[0], *METHODS, *NOT_METHODS[1:])
RESOLUTIONS_TRIED = 6  # resolutions on which a first solution is sought
JUMP_SAMPLES = 2001  # of a guess that is looked at for jumps
QUICK_TRIES = 1  # the same by another way
JUMP_RESOLUTIONS = (90, 200, 450)  # the same where the guess has jumps, on a mesh that follows its length
STEEP_INTERVAL_RATIO = 0.02  # of the mean interval: a shorter one on such a mesh is in a jump
FIRST_TOLERANCE_RANGE = (1e-13, 1e-1)
UNSOLVED_CHANGE = 1e-6  # relative change by a Newton step of a solution that its corrector accepts


def accuracy_of(options: Mapping[str, Any]) -> tuple[float, Method]:
    """Tolerance and methods; raises ValueError for options that are unknown or out of range."""
    for name in options:
        check_name("options", name, FIRST_SOLUTION_OPTIONS)
    tolerance = number_within("tolerance", options.get("tolerance", 1e-8), *FIRST_TOLERANCE_RANGE)
    return tolerance, boundary_method({k: v for k, v in options.items() if k in METHODS and v is not None})


def space_of(statement: Statement, guess: Guess, options: Mapping[str, Any]) -> BoundarySpace:
    """The space of solutions of a statement, measured by a guess; raises ValueError for options out of range."""
    tolerance, method = accuracy_of(options)
    times = np.linspace(*statement.span(), 201)
    return BoundarySpace(statement, tolerance, method, Sizes.of(statement, sampled(statement, guess, times)))


def limits_of(options: Mapping[str, Any]) -> tuple[float | None, Callable[[str], None] | None]:
    """`time_limit` and `progress` of options; raises ValueError and TypeError."""
    limit, report = options.get("time_limit"), options.get("progress")
    duration("time_limit", limit)
    function_of("progress", report, "words")
    return limit, report


def solve(statement: Statement, guess: Guess, **options: Any) -> Solution:
    """The solution of a boundary-value problem without objective and bounds near a guess.

    Arguments and what is raised are those of `casadi_skin.search.boundary_nlp.solve`.
    """
    limit, report = limits_of(options)
    space = space_of(statement, guess, options)
    watch = (
        watched(limit, report) if limit is not None or report is not None else nullcontext()
    )  # or that of the caller
    try:
        with watch, np.errstate(all="ignore"):  # no corrector takes a residual that is not finite
            return solution_near(space, guess)
    except TimeLimitError as error:
        advice = "try a guess nearer by, or a larger tolerance"
        raise BoundaryError(f"{statement.model.name}: {error}; {advice}") from None


def _jump_along(space: BoundarySpace, guess: Guess) -> str:
    """That the equations jump along a guess, with the equation; empty where they do not."""
    jumps, values = space.model.jumps, space.statement.values
    if not jumps.found:
        return ""
    t = np.linspace(*space.statement.span(), JUMP_SAMPLES)
    p = np.array([values[name] for name in jumps.model.parameter_names])
    return jumps.along(t, sampled(space.statement, guess, t)[:, : jumps.model.full_size], p)


class NotReachedError(BoundaryError):
    """The corrector does not converge from the guess; another method may find a solution."""


def solution_near(space: BoundarySpace, guess: Guess) -> Solution:
    """The solution near a guess, by `other_ways` where the corrector does not reach it; raises BoundaryError."""
    try:
        point = first_point(space, guess)
        jumps = space.jump(point)
        if jumps:
            raise JumpError(space.model, f"{jumps}, along the solution")
        return Solution(space, point)
    except BoundaryError as error:
        jumps = _jump_along(space, guess)
        if jumps:
            raise JumpError(space.model, f"{jumps}, along the guess, near which no solution was found") from error
        if not isinstance(error, NotReachedError) or PERIOD in space.statement.values:  # an orbit's guess is a cycle
            raise
        found, words = other_ways(space, guess)
        if found is None:
            raise BoundaryError(f"{error}; tried as well: {words}" if words else str(error)) from error
        return found


def first_point(space: BoundarySpace, guess: Guess, tries: int | None = None) -> Point:
    """The solution near a guess with u = 0 held, refined to the tolerance; raises BoundaryError.

    `tries` is the largest number of resolutions.
    """
    levels, failures, undetermined = space.point_solver.levels, list[str](), ""
    least = int(space.method.intervals or 1)
    resolutions = [r for r in levels.resolutions if r >= least][:RESOLUTIONS_TRIED]
    for problem, z in itertools.islice(_first_problems(space.statement, levels, resolutions, guess), tries):
        row, steep = problem.parameter_row(), problem.resolution in JUMP_RESOLUTIONS
        correction = levels.corrector(problem).correct(z, row, 0.0)
        if not correction.converged and steep:  # Ipopt's scaling suffers from steep jumps
            correction = NewtonCorrector(problem).correct(z, row, 0.0)
        backwards = problem.backwards(correction.z) if correction.converged else ""
        if backwards:
            failures.append(backwards)
        elif correction.converged:
            correction = _sized(levels, problem, correction, not np.any(z[: problem.states]))
            try:
                return space.refined(*(converged_mesh(levels, problem, correction) or (problem, correction)))
            except BoundaryError as error:
                again = isinstance(error, NotRefinedError) and PERIOD in space.statement.free
                if not (steep or again):
                    raise
                words = str(error).removeprefix(f"{space.statement.model.name}: ")
                failures.append(words.removeprefix("no solution near the guess: "))
        else:
            undetermined = rank_deficiency(problem, correction.z, everywhere=True)
            both = (f"{correction.status.value}; {problem.describe_largest_residual(correction.z)}", undetermined)
            failures.append(not_finite(problem, z) or "; there ".join(filter(None, both)))
    kind = BoundaryError if undetermined else NotReachedError
    raise kind(f"{space.statement.model.name}: no solution near the guess: {failures[0]}")


def _sized(levels: Levels, problem: BoundaryProblem, correction: Correction, unmeasured: bool) -> Correction:
    """The correction, solved to its own size: Ipopt's tolerance is absolute where states are below 1.

    Where the guess of zeros left states `unmeasured`, their scales follow from a Newton step.
    """
    z, row = correction.z, problem.parameter_row()
    residual, nonzeros = problem.evaluate(z)
    try:
        step = (correction.solve or levels.solver(problem).factor(z, nonzeros, row))(np.append(residual, 0.0))
    except SingularError:  # the refinement of the solution names the condition at fault
        return correction
    if unmeasured:
        problem.measure_by(z - step)
    if problem.profile_change(z - step, step) <= UNSOLVED_CHANGE:
        return correction
    finished = NewtonCorrector(problem).correct(z, row, 0.0)
    return finished if finished.converged else correction


def _first_problems(
    statement: Statement, levels: Levels, resolutions: Sequence[int], guess: Guess
) -> Iterator[tuple[BoundaryProblem, Array]]:
    """Problems on which a first solution is sought, and unknowns at the guess: on its own mesh, then placed for it.

    A guess with jumps, which a uniform mesh would miss, gets a mesh along its length before.
    """
    if (
        isinstance(guess, Solution)
        and isinstance(guess.point.problem, BoundaryProblem)
        and guess.intervals in levels.resolutions
    ):
        problem = stated(levels.problem(guess.intervals).with_constants(guess.problem.constants))
        yield problem, packed(problem, guess)
    for resolution, lengths in zip(JUMP_RESOLUTIONS, along_the_guess(statement, guess, JUMP_RESOLUTIONS), strict=False):
        if np.min(lengths) < STEEP_INTERVAL_RATIO / resolution:
            problem = stated(levels.problem(resolution))
            steep = problem.with_constants(lengths)
            yield steep, packed(steep, guess)
    for resolution in resolutions:
        problem = stated(levels.problem(resolution))
        z = packed(problem, guess)
        if not is_straight(guess) and problem.imbalance(z) > 1.0:
            problem = problem.placed(z, problem)
            z = packed(problem, guess)
        yield problem, z


def packed(problem: BoundaryProblem, guess: Guess) -> Array:
    """Unknowns at a guess, with u = 0."""
    statement = problem.statement
    start, end = statement.span()
    states = sampled(statement, guess, start + problem._fractions() * (end - start))
    scalars = [statement.values[name] for name in statement.free]
    return np.concatenate([states.ravel(), scalars, [0.0]])
