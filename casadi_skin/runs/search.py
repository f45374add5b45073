"""The search that a scene asks for: its request, its run with a journal of starts, and its files."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec

from casadi_skin import figures
from casadi_skin.figures.search import search_figure
from casadi_skin.optimise.request import SearchRequest, search_request
from casadi_skin.optimise.result import SearchResult, SearchStatus
from casadi_skin.optimise.search import Search
from casadi_skin.optimise.search_nlp import programme
from casadi_skin.optimise.starts import Ending, first_harmonics, sample_starts
from casadi_skin.progress import Progress
from casadi_skin.results.journal import Journal, read_records, trim_journal
from casadi_skin.results.search import OutcomeRecord, outcome_record, restored, write_search
from casadi_skin.runs.request import Request, chain_of
from casadi_skin.scene import Scene, SearchTable

COMPLETE = (SearchStatus.FOUND, SearchStatus.ON_BOUND)


def search_table(scene: Scene) -> SearchTable:
    """The table [search]; raises ValueError where there is none."""
    if scene.search is None:
        raise ValueError("[search]: missing; accepted: a scene with a [search]")
    return scene.search


def scene_search(scene: Scene) -> SearchRequest:
    """What the scene's [search] asks for; raises ValueError or TypeError for what cannot be meant."""
    table = search_table(scene)
    constraints = [
        (held.quantity, *((held.equal, held.equal) if held.equal is not None else (held.lower, held.upper)))
        for held in table.constraints
    ]
    return search_request(
        chain_of(scene), table.mode, table.S, table.objective, table.maximise, table.free, table.bounds, constraints,
        scene.accuracy.relative_tolerance,
    )  # fmt: skip


def run_search(request_of_run: Request, journal: Path, progress: Progress) -> SearchResult:
    """Run the search, each start kept in the journal as it ends; starts that the journal holds are not run again."""
    scene = request_of_run.scene
    table, request = search_table(scene), scene_search(scene)
    decoder = msgspec.msgpack.Decoder(OutcomeRecord)
    records = [r for r in (read_records(journal, decoder) if journal.exists() else []) if _ended(r)]
    trim_journal(journal, records)
    starts = sample_starts(request, table.starts, table.seed)
    search = Search(request, starts, table.deflate, [restored(record) for record in records])
    progress.say("building")
    with Journal(journal) as file:
        return search.run(
            lambda where: progress.say(str(where)),
            table.workers,
            None,
            lambda found: file.append(outcome_record(found)),
        )


def _ended(record: OutcomeRecord) -> bool:
    return record.ending is not Ending.INTERRUPTED


def write_results(request: Request, scene_text: str, result: SearchResult, directory: Path) -> None:
    """search.csv, starts.csv, search.nc and the picture."""
    scene = request.scene
    table = search_table(scene)
    write_search(result, directory, scene_search(scene).free_names, scene_text, scene.title or "")
    if result.optima or result.others:
        figures.save(search_figure(result, table.objective), directory / "search")


def check_search(request: Request) -> None:
    """Raises ValueError or TypeError where the scene's search cannot be meant."""
    scene_search(request.scene)


def summary_lines(result: SearchResult, request: Request) -> list[str]:
    """The result in lines for a terminal."""
    objective = search_table(request.scene).objective
    lines = [f"search: {result.reason}"]
    for rank, optimum in enumerate((*result.optima, *result.others), start=1):
        named = ", ".join(f"{name} = {value:.10g}" for name, value in list(optimum.parameters.items())[:4])
        more = ", ..." if len(optimum.parameters) > 4 else ""
        words = ", on another family" if optimum.on_family is False else ""
        held = f"; on {', '.join(optimum.active)}" if optimum.active else ""
        lines.append(f"{rank}: {objective} = {optimum.objective:.10g} at {named}{more}; Omega = {optimum.Omega:.10g}"
                     f"{held}{words}")  # fmt: skip
    if result.nearest is not None and result.nearest.solution is not None:
        near = result.nearest
        lines.append(f"nearest: from start {near.start.number}, {near.worst} off by {near.gap:.3g}")
    return lines


def plan_search(scene: Scene) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the search of a scene, with one start's programme measured."""
    table, request = search_table(scene), scene_search(scene)
    started = time.perf_counter()
    first = sample_starts(request, 1, table.seed)[0]
    harmonics = first_harmonics(request, first)
    nlp = programme(request, harmonics)
    building = time.perf_counter() - started
    bounds = ", ".join(f"{low:g} <= {name} <= {high:g}" for name, (low, high) in zip(request.free, request.bounds,
                                                                                    strict=True))  # fmt: skip
    held = [f"{c.name} = {c.upper:g}" if c.equality else f"{c.lower:g} <= {c.name} <= {c.upper:g}"
            for c in request.conditions]  # fmt: skip
    where = f"j = {request.mode}" + ("" if "S" in request.free else f", S = {request.amplitudes[0]:g}")
    return [
        ("search", f"{'largest' if table.maximise else 'smallest'} {table.objective} on the family {where}"),
        ("free", bounds),
        ("held", "; ".join(held) or "nothing"),
        ("tolerance", f"{request.tolerance:g}, relative, of objective and Omega"),
        ("starts", f"{table.starts}, seed {table.seed}, {table.workers} process{'' if table.workers == 1 else 'es'}"),
        ("unknowns", f"{nlp.size} on {harmonics} odd cosines; more harmonics where the tolerance asks for it"),
        ("built", "the orbit's equations" + (" and those of its tangent" if any(nlp.has_tangent) else "")
         + ", their exact first and second derivatives, Ipopt"),
        ("not built", "families beyond the starts and checks" + ("" if any(nlp.has_tangent) else ", the tangent")),
        ("expected cost", f"{building:.1g} s to build (measured now); starts and checks are not estimated"),
    ]  # fmt: skip
