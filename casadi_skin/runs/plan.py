"""The plan of a scene: the equations that would be built and solved, and their expected cost."""

from __future__ import annotations

import time
from dataclasses import replace

from casadi_skin.follow.family import Family
from casadi_skin.model import methods
from casadi_skin.model.conserved import SymmetryClass, symmetry_class
from casadi_skin.runs.family_plan import SPECTRUM_LINE, FamilyPlan, chain_line, family_lines
from casadi_skin.runs.output import Lines, listed, named
from casadi_skin.runs.request import Request, state_of
from casadi_skin.runs.scene import LEAVING, ContinuationTable, EquilibriumTable
from casadi_skin.runs.tasks import tasks_of
from casadi_skin.zero.butcher import TABLES
from casadi_skin.zero.problem import Problem
from casadi_skin.zero.settings import ErrorEstimate

TYPICAL_SAMPLES = (60, 450)  # orbits of a family that its changes of stability are sought with
TYPICAL_POINTS = (15, 150)  # a family, from interior modes of short chains to end modes of long or steep ones


def plan_lines(request: Request, measure: bool) -> Lines:
    """Pairs (subject, text) that describe the work of a run of the request; with `measure` of families the cost too."""
    scene, lines = request.scene, _model_lines(request)
    if scene.spectrum is not None:
        lines.append(SPECTRUM_LINE)
    if request.families:
        lines += _family_lines(request, measure)
    elif scene.equilibrium is not None:
        lines += _equilibrium_lines(request, scene.equilibrium)
    elif scene.orbit is not None or request.problem is not None:
        lines += _boundary_lines(request)
    elif scene.search is None:
        lines.append(("not built", _nothing(request)))
    for task in tasks_of(request):
        lines += task.plan()
    if scene.time_limit is not None:
        lines.append(("time limit", f"{scene.time_limit:g} s"))
    return lines


def _nothing(request: Request) -> str:
    tables = "family" if request.scene.chain is not None else "[family], [equilibrium], [orbit] or [solution]"
    return f"any boundary-value problem: the scene asks for no {tables}"


def _model_lines(request: Request) -> Lines:
    model = request.model
    if request.scene.chain is not None:
        return [chain_line(model.sites, model.alpha, model.gamma, model.g)]
    if request.scene.lattice is not None:
        from casadi_skin.runs.lattices import lattice_lines, long_lattice_lines

        lattice = request.scene.lattice
        return long_lattice_lines(model) if lattice.long else lattice_lines(model, request.parameters)
    words = {
        "time reversal": model.reversal is not None,
        "half-period symmetry": model.half_period is not None,
        "conserved quantity": model.hamiltonian is not None or bool(model.conserved),
        "forced": model.forced,
    }
    declared = ", ".join(word for word, holds in words.items() if holds)
    return [
        ("model", f"{model.name}, from {request.path}"),
        ("states", listed(model.state_names)),
        ("parameters", named(request.parameters) or "none"),
        ("declared", declared or "no symmetry, no conserved quantity"),
    ]


# Families -------------------------------------------------------------------------------------------------------------


def _family_lines(request: Request, measure: bool) -> Lines:
    first, family = request.families[0], Family(request.families[0])
    localised, method = first.coordinates.localised, first.method
    full = first.coordinates.description == methods.EVERY_SITE
    plan = FamilyPlan(
        [int(known.mode) for known in request.families],
        family.symmetry.reason,
        first.coordinates.description,
        str(method.transcription),
        str(method.flow),
        None if localised is None else localised.sites[0],
        int(request.model.sites) if full and request.scene.chain is not None else None,
    )
    return family_lines(request.scene, plan, _measured(request, family) if measure else None)


def _measured(request: Request, family: Family) -> Lines:
    """The problem at the start of the first family, and the cost of all."""
    started = time.perf_counter()
    problem, error = _first_problem(family)
    building = time.perf_counter() - started
    sizes = f"{problem.size} at the start ({problem.resolution_in_words()}); {problem.size - 1} equations"
    return [
        ("unknowns", f"{sizes}; more where the tolerance asks for it"),
        ("non-zeros", f"{problem.pattern[0].size} in the Jacobian"),
        ("first error", f"{error.relative(family.coordinates.frequency):.1e} estimated at the start"),
        ("expected cost", _cost(request, family, problem, building)),
    ]


def _first_problem(family: Family) -> tuple[Problem, ErrorEstimate]:
    """The coarsest problem that meets the tolerance at a small amplitude, and its error there."""
    start = family.start
    problem, z = start.problem, start.z + start.step * start.tangent
    while True:
        row = problem.parameter_row()
        correction = family.levels.corrector(problem).correct(z, row, float(row @ z))
        error = family.levels.error(problem, correction.z)
        finer = family.levels.finer(problem)
        at_top = finer is None or family.levels.finer(finer) is None  # the last level has no error to show
        if finer is None or at_top or error.relative(problem.frequency(z)) <= family.tolerance:
            return problem, error
        problem, z = finer, problem.prolong(correction.z, finer)


def _cost(request: Request, family: Family, problem: Problem, building: float) -> str:
    """Cost from one measured solve (and one transition matrix), times the usual number of points."""
    start, families = family.start, len(request.families)
    z = start.problem.prolong(start.z + start.step * start.tangent, problem)
    row = problem.parameter_row()
    started = time.perf_counter()
    z = family.levels.corrector(problem).correct(z, row, float(row @ z)).z
    family.levels.error(problem, z)
    point = time.perf_counter() - started
    words = f"{1e3 * building:.0f} ms to build, {1e3 * point:.2g} ms a point"
    if request.scene.stability is not None:
        there = replace(start, problem=problem, z=z, better=None)
        for _ in range(2):
            started = time.perf_counter()
            if family.coordinates.localised is None:
                family.flow.transition(problem, z)
            else:
                family.floquets([there])
            multipliers = time.perf_counter() - started
        point += multipliers
        words += f" and {1e3 * multipliers:.2g} ms for its multipliers"
    stability = request.scene.stability
    events = stability is not None and stability.events and family.coordinates.localised is None
    counts = zip(TYPICAL_POINTS, TYPICAL_SAMPLES if events else (0, 0), strict=True)
    low, high = (families * (building + (points + samples) * point) for points, samples in counts)
    return f"{words} (measured now); {low:.1g} to {high:.1g} s for {families} famil{'y' if families == 1 else 'ies'}"


# Equilibria -----------------------------------------------------------------------------------------------------------


def _equilibrium_lines(request: Request, equilibrium: EquilibriumTable) -> Lines:
    model, table = request.equations, request.scene.continuation
    names = model.state_names[: model.size]
    state = named(dict(zip(names, state_of(equilibrium.start, model.state_names), strict=False)))
    where = "near" if equilibrium.transient is None else f"where a simulation for {equilibrium.transient:g} rests, from"
    lines = [("equilibrium", f"{where} {state}"), ("unknowns", f"{model.size}: {listed(names)}")]
    located = [("located", "folds, branch points and Hopf points, with their normal forms")]
    lines += _branch_lines(table, located)
    lines.append(("tolerance", f"{request.tolerance:g}, relative, of each component of the state"))
    return lines


def _branch_lines(table: ContinuationTable | None, located: Lines) -> Lines:
    """A branch, what is located on it, the branches that leave it, and curves in two parameters."""
    if table is None:
        return []
    at = f", points exactly at {', '.join(f'{value:g}' for value in table.at)}" if table.at else ""
    lines = [("branch", f"in {table.parameter} to {table.to:g}{at}; {table.max_points} points at most"), *located]
    if table.switch or table.depth:
        kinds = " and ".join(table.switch or LEAVING)
        deep = "" if table.depth is None else f", {table.depth} deep and {table.limit} branches at most"
        lines.append(("leaving", f"branches at every {kinds}, as far{deep}"))
    if table.curve is not None:
        lines.append(("curves", f"special points in {table.curve.parameter} to {table.curve.to:g}"))
    return lines


# Orbits and solutions -------------------------------------------------------------------------------------------------


def _boundary_lines(request: Request) -> Lines:
    scene = request.scene
    lines = _orbit_lines(request) if scene.orbit is not None else _problem_lines(request)
    if scene.orbit is None and scene.solution is None:
        return [*lines, ("not built", _nothing(request))]
    lines += _branch_lines(scene.continuation, [])
    lines.append(("tolerance", f"{request.tolerance:g}, relative, of each state and free parameter"))
    lines.append(("unknowns", _unknowns(request)))
    if scene.stability is not None:
        lines.append(("stability", f"multipliers over the full period at every point, by {scene.methods.flow}"))
    else:
        lines.append(("not built", "multipliers: the scene has no [stability]"))
    return lines


def _symmetry(request: Request) -> SymmetryClass:
    symmetric = request.scene.orbit is not None and request.scene.orbit.symmetric
    return symmetry_class(request.ode) if symmetric else SymmetryClass.FULL


def _orbit_lines(request: Request) -> Lines:
    orbit, model = request.scene.orbit, request.ode
    assert orbit is not None
    start = named(dict(zip(model.state_names, state_of(orbit.start, model.state_names), strict=True)))
    turning = f", but for {named(orbit.rotations)} turns" if orbit.rotations else ""
    if model.forced:
        times = "a period" if orbit.cycles == 1 else f"{orbit.cycles} periods"
        what = f"closes after {times} of the forcing{turning}"
        after = f", after a transient of {orbit.transient:g} or little more" if orbit.transient else ""
        return [("orbit", what), ("guess", f"{times} simulated from {start}{after}")]
    symmetry, selected = _symmetry(request), "" if orbit.select is None else f", selected by {named(orbit.select)}"
    if symmetry is SymmetryClass.FULL:
        phase = "an integral phase condition" if orbit.section is None else f"phase zero at {named(orbit.section)}"
        what = f"the full period, {phase}{selected}"
        what += ", unfolded by a damping that comes back as zero" if model.hamiltonian is not None else ""
    else:
        what = f"{symmetry.reason}{selected}"
    what += turning
    if orbit.period is not None:
        return [("orbit", what), ("guess", f"one period of {orbit.period:g} from {start}")]
    return [("orbit", what), ("guess", f"the last cycle of a simulation for {orbit.transient:g} from {start}")]


def _problem_lines(request: Request) -> Lines:
    problem = request.problem
    assert problem is not None
    start, end = problem.span(request.parameters.values())
    ends = sum(int(expression.numel()) for expression in problem.conditions)
    integrals = sum(int(expression.numel()) for expression in problem.integrals)
    words = f"t from {start:g} to {end:g}; {ends} conditions at the ends, {integrals} integrals"
    free = f"; free: {', '.join(problem.free)}" if problem.free else ""
    best = "; an objective is minimised" if problem.optimises else ""
    return [("problem", f"{words}{free}{best}")]


def _unknowns(request: Request) -> str:
    """States at the ends and stages of the intervals, and free parameters, on the first mesh."""
    from casadi_skin.zero.orbit import DEFAULT_DEGREE, FIRST_INTERVALS, UNFOLDING
    from casadi_skin.zero.stated_problem import PERIOD

    method, model, problem = request.scene.methods, request.ode, request.problem
    intervals, degree = method.intervals or FIRST_INTERVALS, method.degree or DEFAULT_DEGREE
    table = TABLES[str(method.transcription)](degree)
    columns = intervals * table.ends.size + 1
    unfolded = model.hamiltonian is not None and _symmetry(request) is SymmetryClass.FULL
    orbit = () if model.forced else (PERIOD, UNFOLDING) if unfolded else (PERIOD,)
    free = orbit if problem is None else tuple(problem.free)
    mesh = f"{intervals} {method.transcription} intervals of degree {degree} at the start"
    also = f"and {', '.join(free)} " if free else ""
    return f"{model.full_size * columns} state values {also}on {mesh}; more where the tolerance asks for it"
