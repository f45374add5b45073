"""The search of a scene: its request, its run with a journal of starts, and its files."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.ode import OdeModel
from casadi_skin.optimise.families import ChainFamily, ModelFamily
from casadi_skin.optimise.family_search import FamilyNlp, FamilySearch
from casadi_skin.optimise.search import SearchResult, SearchStatus, search
from casadi_skin.optimise.search_problem import Ending
from casadi_skin.results.figures.search import search_figure
from casadi_skin.results.journal import Journal
from casadi_skin.results.search_records import OutcomeRecord, outcome_record, restored, write_search
from casadi_skin.runs.pictures import picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.task_tables import SearchTable

COMPLETE = (SearchStatus.FOUND, SearchStatus.ON_BOUND)


def search_table(scene: Scene) -> SearchTable:
    """The table [search]; raises ValueError where there is none."""
    if scene.search is None:
        raise ValueError("[search]: missing; accepted: a scene with a [search]")
    return scene.search


def family_search(request: Request) -> FamilySearch:
    """The search of the scene's [search]; raises ValueError or TypeError for values that are not accepted."""
    table, model = search_table(request.scene), request.model
    constraints = [
        (held.quantity, *((held.equal, held.equal) if held.equal is not None else (held.lower, held.upper)))
        for held in table.constraints
    ]
    if isinstance(model, Chain):
        family: ChainFamily | ModelFamily = ChainFamily.of(model, table.mode)
    else:
        assert isinstance(model, OdeModel)
        family = ModelFamily.of(model, table.mode, request.parameters)
    return FamilySearch.of(
        family, S=table.S, objective=table.objective, free=table.free,
        bounds=table.bounds, constraints=constraints, maximise=table.maximise,
        tolerance=request.scene.accuracy.relative_tolerance,
    )  # fmt: skip


def run_search(request: Request, journal: Path, progress: Progress) -> SearchResult:
    """Run the search, each start kept in the journal as it ends; starts that the journal holds are not run again."""
    problem, table = family_search(request), search_table(request.scene)
    progress.say("building")
    with Journal(journal, msgspec.msgpack.Decoder(OutcomeRecord)) as file:
        if file.fault:
            progress.report(f"{journal}: {file.fault}; what follows it is dropped and computed again")
        records = [record for record in file.records if record.ending is not Ending.INTERRUPTED]
        return search(
            problem,
            problem.starts(table.starts, table.seed),
            deflate=table.deflate,
            known=[restored(record) for record in records],
            keep=lambda outcome: file.append(outcome_record(outcome)),
            progress=lambda where: progress.say(str(where)),
            workers=table.workers,
        )


def write_results(request: Request, scene_text: str, result: SearchResult, directory: Path) -> None:
    """search.csv, starts.csv, search.nc and the picture."""
    scene = request.scene
    table = search_table(scene)
    write_search(result, directory, scene_text, scene.title or "")
    if result.optima or result.others:
        picture(scene, directory / "search", search_figure, result, table.objective)


def check_search(request: Request) -> None:
    """Raises ValueError or TypeError where the scene's search cannot be meant."""
    family_search(request)


def summary_lines(result: SearchResult, request: Request) -> list[str]:
    """The result in lines for a terminal."""
    objective = search_table(request.scene).objective
    lines = [f"search: {result.reason}"]
    for rank, optimum in enumerate((*result.optima, *result.others), start=1):
        named = ", ".join(f"{name} = {value:.10g}" for name, value in list(optimum.parameters.items())[:4])
        more = ", ..." if len(optimum.parameters) > 4 else ""
        words = ", on another family" if optimum.on_family is False else ""
        held = f"; on {', '.join(optimum.active)}" if optimum.active else ""
        found = f"{objective} = {optimum.objective:.10g} at {named}{more}; Omega = {optimum.Omega:.10g}"
        lines.append(f"{rank}: {found}{held}{words}")
    if result.nearest is not None and result.nearest.solution is not None:
        near = result.nearest
        lines.append(f"nearest: from start {near.start.number}, {near.worst} off by {near.gap:.3g}")
    return lines


def plan_search(request: Request) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the search of a scene, with the nonlinear programme of one start measured."""
    table, problem = search_table(request.scene), family_search(request)
    started = time.perf_counter()
    problem = problem.prepared(problem.starts(1, table.seed)[0])
    nlp = FamilyNlp(problem, problem.harmonics)
    building = time.perf_counter() - started
    limits = zip(problem.free, problem.bounds, strict=True)
    bounds = ", ".join(f"{low:g} <= {name} <= {high:g}" for name, (low, high) in limits)
    held = [f"{c.name} = {c.upper:g}" if c.equality else f"{c.lower:g} <= {c.name} <= {c.upper:g}"
            for c in problem.conditions]  # fmt: skip
    where = f"j = {problem.family.mode}" + ("" if "S" in problem.free else f", S = {problem.amplitudes[0]:g}")
    tangent = " and those of its tangent" if nlp.has_tangent else ""
    return [
        ("search", f"{'largest' if table.maximise else 'smallest'} {table.objective} on the family {where}"),
        ("free", bounds),
        ("held", "; ".join(held) or "nothing"),
        ("tolerance", f"{problem.tolerance:g}, relative, of objective and Omega"),
        ("starts", f"{table.starts}, seed {table.seed}, {table.workers} process{'' if table.workers == 1 else 'es'}"),
        ("unknowns", f"{nlp.size} on {nlp.harmonics} odd cosines; more harmonics where the tolerance asks for it"),
        ("built", f"the orbit's equations{tangent}, their exact first and second derivatives, Ipopt"),
        ("not built", "families beyond the starts and checks" + ("" if tangent else ", the tangent")),
        ("expected cost", f"{building:.1g} s to build (measured now); starts and checks are not estimated"),
    ]
