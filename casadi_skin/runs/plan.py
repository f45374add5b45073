"""The plan of a scene: what would be built and solved, what would not, and what it is expected to cost."""

from __future__ import annotations

import time

from casadi_skin.bvp.problem import Problem
from casadi_skin.bvp.shooting import ShootingProblem
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.full_chain import EdgeSite
from casadi_skin.orbits.family import Family
from casadi_skin.runs.request import scene_requests
from casadi_skin.scene import DynamicsTable, Scene
from casadi_skin.solvers.levels import ErrorEstimate

TYPICAL_POINTS = (15, 150)  # a family, from interior modes of short chains to end modes of long or steep ones


def plan_lines(scene: Scene) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe what a run of the scene would do."""
    table = scene.chain
    lines = [("chain", f"N = {table.sites}, alpha = {table.alpha:g}, gamma = {table.gamma:g}, g = {table.g:g}")]
    if scene.spectrum is not None:
        lines.append(("spectrum", "linear frequencies and modes"))
    requests = scene_requests(scene)
    if requests:
        lines += _family_lines(scene, requests)
        if scene.dynamics is not None:
            lines.append(("dynamics", _dynamics(scene.dynamics, requests[0].mode)))
    elif scene.search is not None:
        from casadi_skin.runs.search import plan_search

        lines += plan_search(scene)
    else:
        lines.append(("not built", "any boundary-value problem: the scene asks for no family"))
    if scene.export is not None:
        from casadi_skin.runs.export import plan_export

        lines += plan_export(scene)
    return lines


def _dynamics(table: DynamicsTable, only_mode: int) -> str:
    """What of which orbit is followed in time, and how."""
    kicks = {"site": f"at site {table.site}", "vector": "along a vector", "seed": f"at random, seed {table.seed}"}
    kicked = [words for name, words in kicks.items() if getattr(table, name) is not None]
    start = f", perturbed by {table.size:g} {kicked[0]}" if kicked else ""
    end = f"t = {table.duration:g}" if table.duration is not None else f"{table.periods:g} periods"
    samples = f"{table.samples} times" if table.samples is not None else "20 times a period, 401 to 4001 in all"
    orbit = f"the orbit j = {table.mode or only_mode}, S = {table.S:g}"
    return f"{orbit}{start}, to {end}; {samples}; {table.method}, tolerance {table.tolerance:g}"


def _family_lines(scene: Scene, requests: list[FamilyRequest]) -> list[tuple[str, str]]:
    request, tools = requests[0], Family(requests[0])
    modes = ", ".join(str(r.mode) for r in requests)
    wanted = (("S", request.at), ("Omega", request.at_Omega), ("period", request.at_period))
    exactly = [f"{name} = {', '.join(f'{value:g}' for value in values)}" for name, values in wanted if values]
    at = f", points exactly at {'; '.join(exactly)}" if exactly else ""
    end = f"S = {request.amplitude_max:g}"
    if request.period_max is not None:
        end += f" or a period of {request.period_max:g}, whichever comes first"
    lines = [
        ("families", f"j = {modes}, to {end}{at}; {request.max_points} points at most"),
        ("tolerance", f"{request.tolerance:g}, relative, of Omega and the profile"),
        ("symmetry", tools.symmetry.reason),
    ]
    if isinstance(tools.coordinates, CoreWithTail):
        words = f"{tools.coordinates.core.sites} at the edge, where the cubic term is felt; the linear tail is eliminated exactly"
        lines.append(("unknown sites", words))
    elif isinstance(tools.coordinates, EdgeSite):
        lines.append(("unknown sites", "the edge site alone: at |gamma| = 1 no other site moves in the gauge"))
    started = time.perf_counter()
    problem, error = _first_problem(tools)
    building = time.perf_counter() - started
    lines += [
        ("transcription", _transcription(request, problem)),
        (
            "unknowns",
            f"{problem.size} at the start; {problem.size - 1} equations; more where the tolerance asks for it",
        ),
        ("non-zeros", f"{problem.function.nnz_out(1)} in the Jacobian"),
        ("first error", f"{error.relative(tools.coordinates.frequency):.1e} estimated at the start"),
    ]
    built = f"model in the gauge, collocation equations, {request.corrector} corrector"
    if scene.stability is not None:
        what = "multipliers and events" if scene.stability.events else "multipliers"
        lines.append(("built", f"{built}, variational system with the {request.flow} flow for {what}"))
    else:
        lines += [("built", built), ("not built", "the variational system: the scene has no [stability]")]
    lines.append(("expected cost", _cost(scene, tools, problem, len(requests), building)))
    return lines


def _first_problem(tools: Family) -> tuple[Problem, ErrorEstimate]:
    """The coarsest problem that meets the tolerance at a small amplitude, and its error there."""
    start = tools.start
    problem, z = start.problem, start.z + start.step * start.tangent
    while True:
        row = problem.parameter_row()
        correction = tools.levels.corrector(problem).correct(z, row, float(row @ z))
        error = tools.levels.error(problem, correction.z)
        finer = tools.levels.finer(problem)
        at_top = finer is None or tools.levels.finer(finer) is None  # the last level has no error to show
        if finer is None or at_top or error.relative(problem.frequency(z)) <= tools.request.tolerance:
            return problem, error
        problem, z = finer, problem.prolong(correction.z, finer)


def _transcription(request: FamilyRequest, problem: Problem) -> str:
    if request.transcription == "trigonometric":
        return f"trigonometric: positions only, {problem.resolution} odd cosines at the start"
    if isinstance(problem, ShootingProblem):
        words = f"shooting: positions and velocities, {problem.segments} segments integrated by CVODES"
        return f"{words} with a local tolerance of 1e-{problem.resolution} at the start"
    words = f"{request.transcription}: positions and velocities, {problem.resolution} intervals"
    return f"{words} with polynomials of degree {request.collocation_degree} at the start"


def _cost(scene: Scene, tools: Family, problem: Problem, families: int, building: float) -> str:
    """Cost from one measured solve (and one transition matrix), times the usual number of points."""
    start = tools.start
    z = start.problem.prolong(start.z + start.step * start.tangent, problem)
    row = problem.parameter_row()
    started = time.perf_counter()
    z = tools.levels.corrector(problem).correct(z, row, float(row @ z)).z
    tools.levels.error(problem, z)
    point = time.perf_counter() - started
    words = f"{1e3 * building:.0f} ms to build, {1e3 * point:.2g} ms a point"
    if scene.stability is not None:
        tools.flow.transition(problem, z)
        started = time.perf_counter()
        tools.flow.transition(problem, z)
        stability = time.perf_counter() - started
        point += stability
        words += f" and {1e3 * stability:.2g} ms for its multipliers"
    low, high = (families * (building + n * point) for n in TYPICAL_POINTS)
    return f"{words} (measured now); {low:.1g} to {high:.1g} s for {families} famil{'y' if families == 1 else 'ies'}"
