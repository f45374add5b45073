"""Commands on a scene: run, check, spectrum."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.commands import model_commands
from casadi_skin.commands.status import DONE, FAILED, INTERRUPTED, InputError
from casadi_skin.runs.directory import Existing, prepare
from casadi_skin.scene import AnyScene, ModelScene, Scene, parse_any_scene, parse_scene, read_text

if TYPE_CHECKING:
    from casadi_skin.runs.run import Run


def run(arguments: argparse.Namespace) -> int:
    scene, text = _read_any_scene(arguments.scene)
    directory = arguments.out or Path("results") / arguments.scene.stem
    existing = Existing.RESUME if arguments.resume else Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    if isinstance(scene, ModelScene):
        return model_commands.run(arguments, scene, text, directory, existing)
    if scene.family is None and scene.spectrum is None and scene.search is None and scene.export is None:
        accepted = "a table [family], [search], [export] or [spectrum]"
        raise InputError(f"{arguments.scene}: asks for nothing to compute; accepted: {accepted}")
    if scene.spectrum is not None:
        _check_spectrum(arguments.scene, scene)
    _check_tail(arguments.scene, scene)
    _check_search(arguments.scene, scene)
    if not prepare(directory, scene, text, existing):
        print(f"{directory} holds the complete run already")
        return DONE

    from casadi_skin.progress import Progress
    from casadi_skin.runs.run import Run

    with Progress(arguments.quiet) as progress:
        run = Run(scene, text, directory, progress)
        try:
            complete = run.execute()
        except KeyboardInterrupt:
            progress.__exit__(None, None, None)
            _summary(run)
            print(f"interrupted; what was computed is in {directory}; go on with --resume", file=sys.stderr)
            return INTERRUPTED
    _summary(run)
    for branch in run.branches:
        if not branch.complete:
            print(f"{arguments.scene}: mode {branch.space.coordinates.mode_number}: {branch.reason}", file=sys.stderr)
    if run.export_failure:
        print(f"{arguments.scene}: [export]: {run.export_failure}", file=sys.stderr)
    if run.search is not None and not complete:
        print(f"{arguments.scene}: [search]: {run.search.reason}", file=sys.stderr)
    if run.evolution_failure:
        print(f"{arguments.scene}: [dynamics]: {run.evolution_failure}", file=sys.stderr)
    return DONE if complete else FAILED


def check(arguments: argparse.Namespace) -> int:
    scene, _ = _read_any_scene(arguments.scene)
    if isinstance(scene, ModelScene):
        return model_commands.check(arguments, scene)
    _check_tail(arguments.scene, scene)
    _check_search(arguments.scene, scene)
    from casadi_skin.runs.plan import plan_lines

    for subject, words in plan_lines(scene):
        print(f"{subject:<14}{words}")
    return DONE


def spectrum(arguments: argparse.Namespace) -> int:
    scene, text = read_scene(arguments.scene)
    _check_spectrum(arguments.scene, scene)
    if arguments.out is not None:
        prepare(arguments.out, scene, text, Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE)
    from casadi_skin.results.tables import spectrum_rows
    from casadi_skin.runs.request import scene_chain

    chain = scene_chain(scene)
    print("j omega_j")
    for row in spectrum_rows(chain):
        print(f"{row['mode']} {row['omega']:.15g}")
    if arguments.out is not None:
        from casadi_skin.runs.run import write_spectrum

        write_spectrum(chain, arguments.out)
    return DONE


# Parts ---------------------------------------------------------------------------------------------------------------


def read_scene(path: Path) -> tuple[Scene, str]:
    """The scene of a chain in a file and its text."""
    text = read_text(path)
    return parse_scene(text, str(path)), text


def _read_any_scene(path: Path) -> tuple[AnyScene, str]:
    text = read_text(path)
    return parse_any_scene(text, str(path)), text


def _check_spectrum(path: Path, scene: Scene) -> None:
    """Raises InputError where the lowest mode does not oscillate."""
    from casadi_skin.runs.request import scene_chain

    try:
        scene_chain(scene).linear_frequency(1)
    except ValueError as error:
        raise InputError(f"{path}: [chain] alpha: given {scene.chain.alpha:g}; {error}") from error


def _check_tail(path: Path, scene: Scene) -> None:
    """Raises InputError where the tail of the chain cannot be eliminated, but is asked to be or is infinite."""
    if scene.family is None or (scene.method.tail != "eliminated" and scene.chain.sites != math.inf):
        return
    from casadi_skin.runs.request import scene_requests

    try:
        scene_requests(scene)
    except ValueError as error:
        table = "[chain] " if str(error).startswith("sites") else "[method] "
        raise InputError(f"{path}: {table}{error}") from error


def _check_search(path: Path, scene: Scene) -> None:
    """Raises InputError where the scene's search cannot be meant."""
    if scene.search is None:
        return
    from casadi_skin.runs.search import scene_search

    try:
        scene_search(scene)
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: [search] {error}") from error


def _summary(run: Run) -> None:
    """A table of the families on standard output."""
    if run.search is not None and run.scene.search is not None:
        from casadi_skin.runs.search import summary_lines

        print("\n".join([*summary_lines(run.search, run.scene.search.objective), f"results in {run.directory}"]))
    for path in run.exported:
        print(f"exported to {path}")
    if not run.branches:
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(title=run.scene.title, box=None, header_style="bold", padding=(0, 1), title_justify="left")
    columns = ["mode", "points", "S", "Omega", "its error"]
    if run.scene.stability is not None:
        columns += ["max |multiplier|", "changes"]
    for column in (*columns, "seconds"):
        table.add_column(column, justify="right", no_wrap=True)
    for branch, seconds in zip(run.branches, [*run.seconds, 0.0], strict=False):
        cells = [str(branch.space.coordinates.mode_number), str(len(branch))]
        if not len(branch):
            table.add_row(*cells)
            continue
        last = branch.orbits[-1]
        cells += [f"{last.S:.6g}", f"{last.Omega:.10g}", f"{max(o.Omega_error for o in branch.orbits):.1e}"]
        if branch.with_stability:
            cells += [f"{branch.max_abs_multiplier.max():.8g}", str(len(branch.changes))]
        table.add_row(*cells, f"{seconds:.2f}")
    Console().print(table)
    for branch in run.branches:
        if branch.threshold is not None:
            words = f"end breather of the infinite chain born at S_c = {branch.threshold:.10g}"
            print(f"mode {branch.space.coordinates.mode_number}: {words}")
    if run.evolution is not None:
        print(f"dynamics: {run.evolution.status}")
    print(f"results in {run.directory}")
