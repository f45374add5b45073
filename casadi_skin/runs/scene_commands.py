"""Commands on a scene of any kind: run, check, spectrum."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.runs.family_plan import chain_lines
from casadi_skin.runs.output import DONE, FAILED, INTERRUPTED, InputError, Lines, print_json, print_results
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

if TYPE_CHECKING:
    from casadi_skin.runs.directory import Existing
    from casadi_skin.runs.progress import Progress
    from casadi_skin.runs.request import Request

OF_MODEL = ("orbit", "continuation", "search", "dynamics", "export", "map")  # tables checked against the model
ASKED = ("family", "equilibrium", "orbit", "solution", "search", "dynamics", "export", "spectrum")


def run(arguments: argparse.Namespace) -> int:
    """Compute the request of a scene; nothing is written where the scene or its model is wrong."""
    scene, text = read_scene(arguments.scene)
    if all(getattr(scene, name) is None for name in ASKED):
        accepted = "a table [family], [equilibrium], [orbit], [solution], [search], [dynamics], [export] or [spectrum]"
        raise InputError(f"{arguments.scene}: asks for nothing to compute; accepted: {accepted}")
    from casadi_skin.runs.directory import Existing  # here: spectrum does not need it

    directory = arguments.out or Path("results") / arguments.scene.stem
    existing = Existing.RESUME if arguments.resume else Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    name_program(scene, arguments.scene, arguments.quiet, apart=arguments.json)
    request = bound(scene, arguments.scene)
    from casadi_skin.runs.directory import in_use
    from casadi_skin.runs.progress import Progress

    with Progress(arguments.quiet) as progress, in_use(directory, progress.report):
        return _run_in(directory, existing, request, text, arguments, progress)


def _run_in(
    directory: Path, existing: Existing, request: Request, text: str, arguments: argparse.Namespace, progress: Progress
) -> int:
    """Compute a request in a directory of this process, and return the exit status."""
    from casadi_skin.runs.directory import Existing, check_same_source, prepare

    if existing is Existing.RESUME and request.path is not None:
        check_same_source(directory, request.path, request.source)
    if not prepare(directory, request.scene, text, existing):
        if arguments.json:
            print_results(directory, True, ())
        elif not arguments.quiet:
            print(f"{directory} holds the complete run already")
        return DONE

    from casadi_skin.model.interrupts import TimeLimit, time_limited
    from casadi_skin.runs.run import Run
    from casadi_skin.runs.summary import print_summary

    run, stopped, limit = Run(request, text, directory, progress), "", TimeLimit(request.scene.time_limit)
    try:
        with time_limited(limit):
            status = DONE if run.execute() else FAILED
    except KeyboardInterrupt:
        status, stopped = INTERRUPTED, "interrupted"
        if limit.is_over:
            status, stopped = FAILED, f"{arguments.scene}: {limit}"
    except OSError as error:
        status, stopped = FAILED, f"casadi-skin: {error.filename or directory}: {error.strerror or error}"
    progress.stop()
    if arguments.json:
        print_results(directory, status == DONE, [stopped] if stopped else run.reasons())
    elif not arguments.quiet:
        print_summary(run)
    if stopped:
        print(f"{stopped}; what was computed is in {directory}; go on with --resume", file=sys.stderr)
        return status
    for reason in run.reasons():
        print(f"{arguments.scene}: {reason}", file=sys.stderr)
    return status


def check(arguments: argparse.Namespace) -> int:
    """Print the plan; the file of a model is run; only with --measure is anything solved."""
    scene, _ = read_scene(arguments.scene)
    lines = None if arguments.measure else chain_lines(scene)
    lines = lines or _plan_with_numerics(scene, arguments)
    if arguments.json:
        print_json([{"subject": subject, "words": words} for subject, words in lines])
    elif not arguments.quiet:
        for subject, words in lines:
            print(f"{subject:<14}{words}")
    return DONE


def _plan_with_numerics(scene: Scene, arguments: argparse.Namespace) -> Lines:
    """The plan of any scene, checked against its model."""
    name_program(scene, arguments.scene, arguments.quiet, apart=arguments.json)
    request = bound(scene, arguments.scene)
    from casadi_skin.runs.plan import plan_lines

    try:
        lines = plan_lines(request, arguments.measure)
        if scene.map is not None:
            from casadi_skin.runs.map import map_lines

            lines += map_lines(scene, request, arguments.scene)
    except SceneError as error:
        raise SceneError(f"{arguments.scene}: {error}") from None
    except (ValueError, TypeError) as error:  # of a search that cannot be meant
        raise InputError(f"{arguments.scene}: [search] {error}") from error
    return lines


def spectrum(arguments: argparse.Namespace) -> int:
    """Print the linear frequencies of a scene's model, and write them where a directory is given."""
    scene, text = read_scene(arguments.scene)
    known = _closed_form(scene)
    if known is not None and arguments.out is None:
        _print_frequencies(known, arguments)
        return DONE
    request = _with_spectrum(scene, arguments.scene)
    from casadi_skin.lattice.spectrum import linear_frequencies

    if arguments.out is not None:
        from casadi_skin.runs.directory import Existing, prepare

        prepare(arguments.out, scene, text, Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE)
    _print_frequencies([float(omega) for omega in linear_frequencies(request.model, request.parameters)], arguments)
    if arguments.out is not None:
        from casadi_skin.runs.run import write_spectrum

        write_spectrum(request, arguments.out)
    return DONE


def _print_frequencies(frequencies: Sequence[float], arguments: argparse.Namespace) -> None:
    if arguments.json:
        print_json({"omega": frequencies})
    elif not arguments.quiet:
        print("j omega_j")
        for mode, omega in enumerate(frequencies, start=1):
            print(f"{mode} {omega:.15g}")


def _closed_form(scene: Scene) -> list[float] | None:
    """Linear frequencies of a finite chain that oscillates, without loading numerics; None for another scene."""
    chain = scene.chain
    if chain is None or chain.sites == math.inf or any(getattr(scene, name) is not None for name in OF_MODEL):
        return None
    squares = [chain.alpha + stiffness(chain.sites, chain.gamma, mode) for mode in range(1, int(chain.sites) + 1)]
    return [math.sqrt(square) for square in squares] if min(squares) > 0.0 else None


def _with_spectrum(scene: Scene, path: Path) -> Request:
    """The request of a scene whose linear frequencies can be shown; raises InputError where they cannot."""
    request = bound(scene, path)
    from casadi_skin.runs.binding import check_spectrum

    try:
        check_spectrum(request)
    except SceneError as error:
        raise InputError(f"{path}: {error}") from error
    return request


def read_scene(path: Path) -> tuple[Scene, str]:
    """The scene in a file and its text."""
    text = read_text(path)
    return parse_scene(text, str(path)), text


def name_program(scene: Scene, path: Path, quiet: bool = False, apart: bool = False) -> None:
    """Print which Python file a scene is about to run, if any: a program may do anything, a saved model nothing.

    `apart` is on standard error, where standard output is for results alone.
    """
    if scene.model is not None and scene.model.file.endswith(".py") and not quiet:
        name = str(path.parent / scene.model.file)
        words = f"{'program':<14}{name if name.isprintable() else repr(name)} is run as Python"
        print(words, flush=True, file=sys.stderr if apart else sys.stdout)


def bound(scene: Scene, path: Path) -> Request:
    """The request of a scene; raises SceneError and InputError that begin with its file."""
    from casadi_skin.runs.binding import bind

    try:
        request = bind(scene, path)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    if scene.search is not None:
        from casadi_skin.runs.tasks import check_search

        try:
            check_search(request)
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: [search] {error}") from error
    return request
