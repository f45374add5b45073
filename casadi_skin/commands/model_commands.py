"""Commands on a scene of a model: run, check."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.commands.status import DONE, FAILED, INTERRUPTED, InputError
from casadi_skin.runs.directory import SCENE_MODEL, DirectoryError, Existing, prepare
from casadi_skin.scene import ModelScene, SceneError

if TYPE_CHECKING:
    from casadi_skin.runs.model_request import ModelRequest
    from casadi_skin.runs.model_run import ModelRun


def run(arguments: argparse.Namespace, scene: ModelScene, text: str, directory: Path, existing: Existing) -> int:
    """Compute what a scene of a model asks for; nothing is written where the scene or its model is wrong."""
    if scene.orbit is None and scene.solution is None:
        accepted = "a table [orbit] or [solution]"
        raise InputError(f"{arguments.scene}: asks for nothing to compute; accepted: {accepted}")
    request = _bound(scene, arguments.scene)
    if existing is Existing.RESUME:
        _check_same_model(directory, request)
    if not prepare(directory, scene, text, existing):
        print(f"{directory} holds the complete run already")
        return DONE

    from casadi_skin.progress import Progress
    from casadi_skin.runs.model_run import ModelRun

    with Progress(arguments.quiet) as progress:
        run = ModelRun(request, text, directory, progress)
        try:
            complete = run.execute()
        except KeyboardInterrupt:
            progress.__exit__(None, None, None)
            _summary(run)
            words = f"what was computed is in {directory}; --resume starts again"
            print(f"interrupted; {words}", file=sys.stderr)
            return INTERRUPTED
    _summary(run)
    for reason in run.reasons:
        print(f"{arguments.scene}: {reason}", file=sys.stderr)
    return DONE if complete else FAILED


def check(arguments: argparse.Namespace, scene: ModelScene) -> int:
    """Print the plan; the model's file is run, nothing is solved."""
    request = _bound(scene, arguments.scene)
    from casadi_skin.runs.model_plan import plan_lines

    for subject, words in plan_lines(request):
        print(f"{subject:<14}{words}")
    return DONE


def _bound(scene: ModelScene, path: Path) -> ModelRequest:
    from casadi_skin.runs.model_request import bind

    try:
        return bind(scene, path)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _check_same_model(directory: Path, request: ModelRequest) -> None:
    """Raises DirectoryError where the directory is a run of a model file that has been changed since."""
    held = directory / f"{SCENE_MODEL}{request.path.suffix}"
    if held.exists() and held.read_text(encoding="utf-8") != request.source:
        raise DirectoryError(
            f"{directory}: was begun with another {request.path.name} (see {held.name}); accepted: the same, or "
            "--overwrite"
        )


def _summary(run: ModelRun) -> None:
    """A table of the first and last point, those asked for and folds, on standard output."""
    from casadi_skin.results.branch import summary_columns, summary_rows

    if not run.points:
        return
    from rich.console import Console
    from rich.table import Table

    title = run.request.scene.title or run.request.model.name
    table = Table(title=title, box=None, header_style="bold", padding=(0, 1), title_justify="left")
    for column in summary_columns(run.request):
        table.add_column(column, justify="right", no_wrap=True)
    for cells in summary_rows(run.request, run.points):
        table.add_row(*cells)
    Console().print(table)
    print(f"{len(run.points)} point{'' if len(run.points) == 1 else 's'}; results in {run.directory}")
