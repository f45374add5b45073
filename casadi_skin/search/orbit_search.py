"""A search among the periodic orbits of any model near a guess, by collocation on meshes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any, cast

import casadi as ca
import numpy as np

from casadi_skin.follow.find import accuracy_of, find_orbit, guessed_period, scalar_of
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.space import BoundaryError
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import accepted_names, check_options, short_repr, truth, whole
from casadi_skin.model.conserved import symmetry_class
from casadi_skin.model.expressions import Expression, real_array
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.result import in_turn, renamed
from casadi_skin.search.boundary_nlp import BoundaryNlp, refined
from casadi_skin.search.conditions import checked_bounds, checked_conditions, free_names, sampled_starts
from casadi_skin.search.design import Design, Ending, best_of, grouped, optimum_words
from casadi_skin.search.design_problem import DesignProblem, family_starts
from casadi_skin.search.designs import best_design
from casadi_skin.search.nlp import Outcome, Start, lost_start, solve_start
from casadi_skin.solve.processes import Report, Runner
from casadi_skin.zero.orbit import Guess, Sizes, sampled
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import PERIOD, stated
from casadi_skin.zero.statement import Statement, check_expressions, named_values

GUESS_SAMPLES = 401  # of the guess over a period
COMPARED_PHASES = 200  # at which an optimum is compared with its plain orbit
CONSERVED = "hamiltonian"
SPECIAL_QUANTITIES = (PERIOD, "Omega")
ENGINE = "Ipopt on the equations of one orbit with objective and constraints"

Quantity = str | Expression


class OrbitSearch:
    """A search for orbits near a guess: `states` at times `t` over the unknown part of a period.

    Quantities are functions of (t, x, p, period): the `objective`, at phase zero; `running`, whose mean over the period
    is added; those of `selecting`, which vanish at phase zero; those of `conditions`; and all that have `names`.
    `limits` has the bounds of states, free parameters and the period. It can be pickled where its model can.
    """

    def __init__(
        self, model: OdeModel, *, guess: Guess, free: Sequence[str], period: float | None = None,
        parameters: Mapping[str, float] | None = None, objective: Quantity | None = None,
        running: Quantity | None = None, select: Expression | None = None, section: Expression | None = None,
        bounds: Mapping[str, Any] | None = None, constraints: Sequence[Any] = (), maximise: bool = False,
        symmetric: bool = False, cycles: int = 1, **accuracy: Any,
    ) -> None:  # fmt: skip
        """From the arguments of `search_orbit`; raises ValueError and TypeError for values that are not accepted."""
        accuracy_of(accuracy)  # raises for options that are not accepted
        if objective is None and running is None:
            raise ValueError("objective: given neither objective nor running; accepted: one of them, or both")
        self.model = model = model.first_order()
        self.parameters, self.free = named_values(model, parameters), free_names(free, model.parameter_names)
        self.options, self.accuracy = {"symmetric": symmetric, "cycles": cycles}, accuracy  # of `find_orbit`
        kind = type(model.state)
        time = kind.sym("t") if model.time is None else model.time
        symbols = [time, model.full_state, model.parameters, kind.sym(PERIOD)]
        known = _quantities(model, symbols[-1])
        self.names, self.values = tuple(known), ca.Function("values", symbols, list(known.values()))

        def function(label: str, given: Any, special: bool = True) -> ca.Function | None:
            return None if given is None else _function(model, symbols, known, label, given, special)

        self.objective, self.running = function("objective", objective), function("running", running, False)
        words = [] if objective is None else [objective if isinstance(objective, str) else "objective"]
        words += [] if running is None else [f"mean of {running if isinstance(running, str) else 'running'}"]
        self.quantity, self.maximise = " + ".join(words), bool(maximise)
        selecting = {"select": function("select", select, False), "section": function("section", section, False)}
        self.selecting = {label: each for label, each in selecting.items() if each is not None}
        held = checked_conditions(constraints, (ca.SX, ca.MX), "an expression in states and parameters")
        fixed = [name for name in self.parameters if name not in self.free]
        self.limits, more = checked_bounds(bounds, dict.fromkeys(self.free, (-math.inf, math.inf)), fixed, known)
        own = (*model.state_names, *(() if model.forced else (PERIOD,)))
        self.limits |= {c.quantity: (c.lower, c.upper) for c in more if c.quantity in own}
        self.conditions = [
            replace(c, quantity=function(f"constraints, item {item}", c.quantity))
            for item, c in enumerate((*held, *(c for c in more if c.quantity not in own)), start=1)
        ]
        self._begin_near(guess, period)

    def _begin_near(self, guess: Guess, period: float | None) -> None:
        """Take the states of the guess."""
        model, cycles = self.model, whole("cycles", self.options["cycles"], 1)
        truth("symmetric", self.options["symmetric"])
        if model.forced:
            length = cycles * model.forcing_period_at(list(self.parameters.values()))
        else:
            length = guessed_period(guess, period)
        self.t = np.linspace(0.0, self._part * length, GUESS_SAMPLES)
        closed = Statement(model, [model.end(model.state) - model.start(model.state)], parameters=self.parameters)
        self.states = sampled(closed, guess, self.t)

    def check_programs(self) -> None:
        """Raises ValueError for quantities that other processes cannot have; those of models raise it themselves."""
        every = self.objective, self.running, *self.selecting.values(), *(c.quantity for c in self.conditions)
        for program in (name for each in every if each is not None for name in programs_in(each)):
            raise ValueError(f"workers: given with the program {program}; accepted: 1, as it stays in this process")

    @property
    def _part(self) -> float:
        """The part of the period that is unknown."""
        return symmetry_class(self.model).value if self.options["symmetric"] else 1.0

    # Orbits and programmes ------------------------------------------------------------------------------------------

    def plain(self, free: Sequence[float] | Array, t: Array, states: Array, intervals: int | None = None) -> Orbit:
        """The orbit near states at free numbers, without objective; raises BoundaryError where none is found."""
        values = {**self.parameters, **dict(zip(self.free, map(float, free), strict=True))}
        at_zero = 0.0, self.model.full_state, self.model.parameters, 0.0
        selecting = {label: function(*at_zero) for label, function in self.selecting.items()}
        options = {**selecting, **self.options, **self.accuracy}
        options |= {} if intervals is None else {"intervals": intervals}
        period = None if self.model.forced else float(t[-1]) / self._part
        return find_orbit(self.model, (t, states), period, parameters=values, **options)

    def nlp_at(self, start: Start) -> tuple[BoundaryNlp, Array]:
        return self._stated(self.plain(start.free, self.t, self.states))

    def _stated(self, plain: Orbit) -> tuple[BoundaryNlp, Array]:
        """The programme on the mesh of a plain orbit, with that orbit as a point of it."""
        given, objectives = plain.statement, dict[str, Any]()
        if self.objective is not None:
            objectives["objective"] = self._at_zero(plain, self.objective)
        if self.running is not None:
            time = given.model.time if self.model.forced else 0.0
            p = given.model.parameters[: len(self.parameters)]
            objectives["running"] = self.running(time, given.model.full_state, p, 0.0) / given.interval[1]
        free = (*given.free, *self.free)
        statement = replace(given, free=free, bounds=dict(self.limits), **objectives)
        space = replace(plain.space, statement=statement, sizes=Sizes.of(statement, plain.states))
        problem = stated(space.levels.problem(plain.intervals).with_constants(plain.problem.constants))
        conditions = [replace(c, quantity=self._at_zero(plain, c.quantity)) for c in self.conditions]
        scales = {name: high - low for name, (low, high) in self.limits.items() if name in self.free}
        scales = {name: s if math.isfinite(s) else abs(self.parameters[name]) or 1.0 for name, s in scales.items()}
        if not self.model.forced:
            scales[PERIOD] = float(self.t[-1]) / self._part
        x = np.concatenate([plain.point.z[:-1], [plain.parameters[name] for name in self.free], [0.0]])
        return BoundaryNlp(space, problem, conditions, scales, self.maximise), x

    def _at_zero(self, plain: Orbit, function: ca.Function) -> Expression:
        """A quantity at phase zero, in the start's state and the parameters of the statement's model."""
        model, end = plain.statement.model, plain.statement.interval[1]
        period = type(model.state)(end) / plain.symmetry.value
        return function(0.0, model.ends[0], model.parameters[: len(self.parameters)], period)

    # Designs --------------------------------------------------------------------------------------------------------

    def design(self, outcome: Outcome) -> Design:
        """The design of a start that led to no optimum."""
        status, words, path, values = outcome.ending, outcome.words, outcome.path, outcome.values
        if status is Ending.UNBOUNDED:
            k = int(np.argmax(np.abs(path[-1])))  # the free number that ran off the farthest
            words = f"{self.free[k]} = {path[-1][k]:.3g}, {self.quantity} = {values[-1]:.3g}"
        elif status is Ending.INFEASIBLE:
            words += " at the nearest design"
        return Design(
            self.quantity, self.maximise, float(values[-1]), np.nan,
            dict(zip(self.free, path[-1].tolist(), strict=True)), {name: self.limits[name] for name in self.free}, path,
            values, status, f"{status.value}; {words}", ENGINE, violation=outcome.violation,
        )  # fmt: skip

    def polished(self, outcome: Outcome) -> Design:
        """The optimum on a mesh that meets the tolerance, beside the plain orbit at its parameters."""
        solution, n = outcome.solution, self.model.full_size
        assert solution is not None
        states = solution.x[: n * outcome.times.size].reshape(-1, n)
        try:
            nlp, x = self._stated(self.plain(outcome.path[-1], outcome.times, states))
            best = refined(nlp, nlp.solved(x, warm=True), flat=True)
            orbit = Orbit(best.nlp.space, best.point, optimum=best.optimum)
            free = [orbit.parameters[name] for name in self.free]
            plain = self.plain(free, orbit.t, orbit.states, orbit.intervals)
        except BoundaryError as error:
            words = f"found on the first meshes, and not confirmed by more: {error}"
            return self.design(replace(outcome, ending=Ending.FAILED, words=words))
        rows = best.nlp.residual(best.solution.x)[best.nlp.condition_rows, None]
        found, value = best.optimality, best.solution.objective
        flat = "; it is flat: neighbours along some direction of the free numbers do as well"
        return replace(
            self.design(outcome), value=value, error=best.objective_error,
            parameters=dict(zip(self.free, free, strict=True)), path=np.array([*outcome.path, free]),
            values=np.append(outcome.values, value), located=(orbit,), quantities=(self._quantities(orbit),),
            conditions=dict(zip((condition.name for condition in self.conditions), rows, strict=True)),
            multipliers=found.multipliers, optimality=found.kkt, violation=found.violation, curvature=found.curvature,
            difference=difference(orbit, plain), status=Ending.FOUND,
            reason=optimum_words(found.multipliers) + (flat if found.flat else ""),
        )  # fmt: skip

    def _quantities(self, orbit: Orbit) -> dict[str, float]:
        """Those that have names, at phase zero."""
        parameters = [orbit.parameters[name] for name in self.parameters]
        values = self.values.call([0.0, orbit.evaluate(0.0), parameters, orbit.period])
        return dict(zip(self.names, map(float, values), strict=True))


def _quantities(model: OdeModel, period: Expression) -> dict[str, Expression]:
    """The quantities that have names: period and Omega, states, parameters, outputs, the hamiltonian."""
    special = {PERIOD: period, "Omega": 2.0 * math.pi / period}
    found = dict(zip(model.state_names, ca.vertsplit(model.full_state), strict=True))
    found |= dict(zip(model.parameter_names, ca.vertsplit(model.parameters), strict=True)) | dict(model.outputs)
    found |= {} if model.hamiltonian is None else {CONSERVED: model.hamiltonian}
    return special | found | special


def _function(
    model: OdeModel, symbols: Sequence[Expression], known: Mapping[str, Expression], label: str, given: Quantity,
    special: bool,
) -> ca.Function:  # fmt: skip
    """A quantity as a function of the symbols; raises ValueError and TypeError. Not all may be of the period alone."""
    if isinstance(given, str):
        names = [name for name in known if special or name not in SPECIAL_QUANTITIES]
        if given not in names:
            raise ValueError(f"{label}: given {short_repr(given)}; {accepted_names(given, names)}, or an expression")
        return ca.Function("quantity", symbols, [known[given]])
    expression = scalar_of(label, given, model)
    time, *others, _ = symbols
    check_expressions([(label, expression)], [*others, *([time] if model.forced and label == "running" else [])])
    return ca.Function("quantity", symbols, [expression])


def difference(orbit: Orbit, plain: Orbit) -> float:
    """The larger one of the periods and of the states of an optimum and of the plain orbit, relative.

    States are compared at the same phases, each component relative to its largest value and no less than a millionth of
    the largest of all.
    """
    fractions = np.arange(COMPARED_PHASES) / COMPARED_PHASES
    one, other = (o.evaluate(fractions * o.period) for o in (orbit, plain))
    largest = np.max(np.abs(other), axis=0)
    apart = float(np.max(np.abs(one - other) / np.maximum(largest, 1e-6 * np.max(largest))))
    return max(abs(orbit.period - plain.period) / plain.period, apart)


# The public entry -----------------------------------------------------------------------------------------------------


@renamed(chain_or_model="model")
@in_turn
def search_orbit(
    model: Chain | OdeModel,
    *,
    guess: Guess | None = None,
    free: Sequence[str],
    bounds: Mapping[str, Any] | None = None,
    constraints: Sequence[Any] = (),
    maximise: bool = False,
    starts: int = 8,
    seed: int = 0,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Report | None = None,
    **stated: Any,
) -> Design:
    """Find the periodic orbits that optimise an objective over free parameters, from many starts.

    Without a guess, orbits of one mode's family by `optimise`, which also takes special points. Near a guess a plain
    orbit is solved from each start, and Ipopt (Waechter and Biegler 2006) goes on from there with exact second
    derivatives, by collocation. Distinct optima are made final on finer meshes and compared with plain orbits.

    Arguments:
        model: a `Chain` of finitely many sites, or an `OdeModel`.
        mode, S: of a family: its mode, and the total amplitude of its orbit or of the first start; with a list of S
            there is one orbit at each, and functions get the tuple of them. The objective is a name or a function of
            the orbit, as in `optimise`.
        objective: near a guess a name (of a state, an output, a parameter, "period", "Omega" or "hamiltonian") or an
            expression in states and parameters, taken at phase zero.
        running: a name or an expression whose mean over the period is added to the objective.
        free: names of the free parameters.
        bounds: (lower, upper) by name, None where there is none: of free parameters, of quantities, and of states over
            the whole period.
        constraints: each a quantity that has to vanish, or (quantity, lower, upper).
        maximise: whether the objective is maximised.
        guess, period, select, section, symmetric, cycles: the orbit that starts begin near, as in `find_orbit`.
        parameters: values of parameters by name, where they are not nominal.
        tolerance: bound of the estimated relative error by discretisation; `transcription`, `degree`, `corrector` and
            `intervals` may be given as well, as in `find_orbit`.
        starts: number of starts: the own parameters first, then a Halton sequence within the bounds; where one is
            missing from half to twice the own value, so that a 0 without bounds stays.
        seed: of that sequence.
        workers, executor: near a guess, processes that share the starts. Models and quantities that are programs stay
            in this one.
        progress: called with a `SearchProgress` at iterations and at the end of every start; of a family at designs.

    Returns:
        The best `Design`, with distinct other optima and how every start ended. Ctrl-C ends the search with the best
        so far. Near a guess, where nothing is found the design is the nearest one, which says why in `reason`.

    Raises:
        ValueError, TypeError: arguments that are not accepted, before anything is solved.
    """
    truth("maximise", maximise)
    if not isinstance(model, cast(Any, OdeModel if guess is not None else Chain | OdeModel)):
        accepted = "an OdeModel" if guess is not None else "a Chain or an OdeModel"
        raise TypeError(f"model: given {short_repr(model)}; accepted: {accepted}")
    if guess is None:
        given = {"free": free, "bounds": bounds, "constraints": constraints, "maximise": maximise, **stated}
        check_options("search_orbit", stated, search_orbit, _of_family)
        return _of_family(model, starts=starts, seed=seed, progress=progress, **given)
    problem = OrbitSearch(
        model, guess=guess, free=free, bounds=bounds, constraints=constraints, maximise=maximise, **stated
    )
    own, limits = [problem.parameters[name] for name in problem.free], [problem.limits[name] for name in problem.free]
    first = [Start(number, row) for number, row in enumerate(sampled_starts(own, limits, starts, seed), start=1)]
    runner = Runner(progress, workers, executor, lost_start)
    if workers > 1 or executor is not None:
        problem.check_programs()
    with runner.listening():
        outcomes = sorted(runner.run(partial(solve_start, problem), first), key=lambda outcome: outcome.start.number)
        outcomes = outcomes or [lost_start(first[0], "before it began")]
        ends = {one.start.number: problem.design(one) for one in outcomes if not one.found}
        for group in grouped(outcomes):
            ends |= dict.fromkeys((one.start.number for one in group), problem.polished(group[0]))
    gone = f"interrupted after {len(outcomes)} of {len(first)} starts" if runner.interrupted else ""
    return best_of([ends[number] for number in sorted(ends)], gone)


def _of_family(
    model: Chain | OdeModel, *, objective: Any = None, mode: int | str | None = None, S: Any = 1.0,
    parameters: Mapping[str, float] | None = None, tolerance: float = 1e-8, free: Sequence[str],
    bounds: Mapping[str, Any] | None, constraints: Sequence[Any], maximise: bool, starts: int, seed: int,
    progress: Report | None,
) -> Design:  # fmt: skip
    """The design of the same arguments: functions of several orbits get the tuple of them."""
    several = isinstance(S, list | tuple | np.ndarray)
    amplitudes = real_array("S", S).ravel().tolist()
    if not amplitudes or min(amplitudes) <= 0:
        raise ValueError(f"S: given {short_repr(S)}; accepted: a finite number > 0, or a list of such numbers")
    checked_conditions(constraints, (str, Callable), "a function of the orbits")

    def joined(quantity: Any) -> Any:
        if several and isinstance(quantity, str):
            return f"a.{quantity}"
        return (lambda *known: quantity(known)) if several and callable(quantity) else quantity

    held = [(joined(c[0]), *c[1:]) if isinstance(c, list | tuple) else joined(c) for c in constraints]
    of = family_starts(model, mode, amplitudes, parameters, tolerance)
    words = "objective", "free", "constraints"
    problem = DesignProblem.of(joined(objective), of, free, held, bounds, maximise, words)
    return best_design(problem, problem.places(starts, seed), tolerance, progress, so_far=True)
