"""What the commands of the program do: each takes its parsed arguments and returns the exit status.

Nothing is written where a scene or its model is wrong. What a command needs beyond scenes is loaded when it is needed.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model.files import replacing
from casadi_skin.runs.family_plan import chain_lines
from casadi_skin.runs.output import DONE, FAILED, INTERRUPTED, InputError, Lines, print_json, print_results
from casadi_skin.runs.reading import parse_scene, read_text, scene_schema
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

if TYPE_CHECKING:
    from casadi_skin.model.interrupts import TimeLimit
    from casadi_skin.runs.directory import Existing
    from casadi_skin.runs.map_result import Map
    from casadi_skin.runs.progress import Progress
    from casadi_skin.runs.request import Request

OF_MODEL = ("orbit", "continuation", "search", "dynamics", "export", "map")  # tables checked against the model
ASKED_TASKS = ("family", "equilibrium", "orbit", "solution", "search", "dynamics", "export", "spectrum")
MOST_REASONS = 5  # of failed cells that are printed


def read_scene(path: Path) -> tuple[Scene, str]:
    """The scene in a file and its text."""
    text = read_text(path)
    return parse_scene(text, str(path)), text


def name_program(scene: Scene, arguments: argparse.Namespace) -> None:
    """Print which Python file a scene is about to run, if any: a program may do anything, a saved model nothing.

    It goes to standard error where standard output is for results alone.
    """
    if scene.model is not None and scene.model.file.endswith(".py") and not arguments.quiet:
        name = str(arguments.scene.parent / scene.model.file)
        words = f"{'program':<14}{name if name.isprintable() else repr(name)} is run as Python"
        print(words, flush=True, file=sys.stderr if arguments.json else sys.stdout)


def _place(arguments: argparse.Namespace) -> tuple[Path, Existing]:
    """The directory of the results, and what is done where it holds some."""
    from casadi_skin.runs.directory import Existing

    existing = Existing.RESUME if arguments.resume else Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    return arguments.out or Path("results") / arguments.scene.stem, existing


def _stopped(arguments: argparse.Namespace, limit: TimeLimit) -> tuple[int, str]:
    """Exit status and reason of an interruption: by the limit of time, or by the user."""
    return (FAILED, f"{arguments.scene}: {limit}") if limit.is_over else (INTERRUPTED, "interrupted")


def run(arguments: argparse.Namespace) -> int:
    """Compute the request of a scene."""
    scene, text = read_scene(arguments.scene)
    if not scene.given(*ASKED_TASKS):
        accepted = "a table [family], [equilibrium], [orbit], [solution], [search], [dynamics], [export] or [spectrum]"
        raise InputError(f"{arguments.scene}: asks for nothing to compute; accepted: {accepted}")
    name_program(scene, arguments)
    from casadi_skin.runs.binding import bound

    request = bound(scene, arguments.scene)
    from casadi_skin.runs.directory import in_use
    from casadi_skin.runs.progress import Progress

    directory, existing = _place(arguments)
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
        status, stopped = _stopped(arguments, limit)
    except OSError as error:
        status, stopped = FAILED, f"casadi-skin: {error.filename or directory}: {error.strerror or error}"
    progress.stop()
    reasons = run.reasons()
    if arguments.json:
        print_results(directory, status == DONE, [stopped] if stopped else reasons)
    elif not arguments.quiet:
        print_summary(run)
    if stopped:
        reasons = []
        print(f"{stopped}; what was computed is in {directory}; go on with --resume", file=sys.stderr)
    for reason in reasons:
        print(f"{arguments.scene}: {reason}", file=sys.stderr)
    return status


def check(arguments: argparse.Namespace) -> int:
    """Print the plan; the file of a model is run; only with --measure is anything solved."""
    scene, _ = read_scene(arguments.scene)
    lines = (None if arguments.measure else chain_lines(scene)) or _plan_with_numerics(scene, arguments)
    if arguments.json:
        print_json([{"subject": subject, "words": words} for subject, words in lines])
    elif not arguments.quiet:
        for subject, words in lines:
            print(f"{subject:<14}{words}")
    return DONE


def _plan_with_numerics(scene: Scene, arguments: argparse.Namespace) -> Lines:
    """The plan of any scene, checked against its model."""
    name_program(scene, arguments)
    from casadi_skin.runs.binding import bound

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
        return _print_frequencies(known, arguments)
    from casadi_skin.lattice.spectrum import linear_frequencies
    from casadi_skin.runs.binding import bound, check_spectrum

    request = bound(scene, arguments.scene)

    try:
        check_spectrum(request)
    except SceneError as error:
        raise InputError(f"{arguments.scene}: {error}") from error
    if arguments.out is not None:
        from casadi_skin.runs.directory import Existing, prepare

        prepare(arguments.out, scene, text, Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE)
    frequencies = [float(omega) for omega in linear_frequencies(request.model, request.parameters)]
    if arguments.out is not None:
        from casadi_skin.runs.run import write_spectrum

        write_spectrum(request, arguments.out)
    return _print_frequencies(frequencies, arguments)


def _print_frequencies(frequencies: Sequence[float], arguments: argparse.Namespace) -> int:
    if arguments.json:
        print_json({"omega": frequencies})
    elif not arguments.quiet:
        print("j omega_j")
        for mode, omega in enumerate(frequencies, start=1):
            print(f"{mode} {omega:.15g}")
    return DONE


def _closed_form(scene: Scene) -> list[float] | None:
    """Linear frequencies of a finite chain that oscillates, without loading numerics; None for another scene."""
    chain = scene.chain
    if chain is None or chain.sites == math.inf or scene.given(*OF_MODEL):
        return None
    squares = [chain.alpha + stiffness(chain.sites, chain.gamma, mode) for mode in range(1, int(chain.sites) + 1)]
    return [math.sqrt(square) for square in squares] if min(squares) > 0.0 else None


def map_scene(arguments: argparse.Namespace) -> int:
    """Compute the map of a scene."""
    scene, text = read_scene(arguments.scene)
    if scene.map is None:
        raise InputError(f"{arguments.scene}: [map]: missing; accepted: a table of parameters with ranges or lists")
    part = _part(arguments.part)
    name_program(scene, arguments)
    from casadi_skin.model.interrupts import TimeLimit, time_limited
    from casadi_skin.runs.map import Mapped, Ways, check_ways, compute_map
    from casadi_skin.runs.progress import Progress

    directory, existing = _place(arguments)
    ways = Ways(
        arguments.workers, arguments.scheduler, None, part, arguments.collect, existing, not arguments.no_pictures
    )
    try:
        check_ways(ways)
    except (ValueError, TypeError) as error:
        raise InputError(f"map: --{error}") from None
    mapped, limit = Mapped.of(text, arguments.scene), TimeLimit(scene.time_limit)
    with Progress(arguments.quiet) as progress:
        try:
            with time_limited(limit):
                found = compute_map(mapped, directory, ways, progress)
        except ImportError as error:
            raise InputError(f"map: --scheduler: {error}") from None
        except KeyboardInterrupt:
            status, words = _stopped(arguments, limit)
            print(f"{words}; what was computed is in {directory}; go on with --resume", file=sys.stderr)
            return status
        except (ValueError, ArithmeticError) as error:
            if type(error).__module__.startswith("casadi_skin"):
                raise
            print(f"casadi-skin: {directory}: {error}", file=sys.stderr)
            return FAILED
    return _told(found, arguments)


def _part(words: str | None) -> tuple[int, int] | None:
    if words is None:
        return None
    pair = re.fullmatch(r"(\d{1,6})/(\d{1,6})", words)
    if pair is None or not 1 <= int(pair[1]) <= int(pair[2]):
        raise InputError(f"map: --part: given {words}; accepted: K/N with 1 <= K <= N, such as 3/20")
    return int(pair[1]), int(pair[2])


def _told(found: Map, arguments: argparse.Namespace) -> int:
    """Report the computed and the missing cells of the map, and return the exit status."""
    waits = found.waits and arguments.part is not None
    failures = [] if waits else [f"{cell}: {reason}" for cell, reason in found.failures(MOST_REASONS + 1)]
    reasons = failures[:MOST_REASONS]
    if len(failures) > MOST_REASONS:
        reasons.append(f"more cells failed or ended early; see {found.directory / 'map.csv'}")
    if not found.complete and not waits:
        reasons.append("cells are missing; go on with --resume")
    if arguments.json:
        print_results(found.directory, found.complete and not failures, reasons)
    elif waits and not arguments.quiet:
        print(f"the share {arguments.part} is computed; {found.directory} waits for the other shares")
    elif not arguments.quiet:
        print(f"{found.summary()}\nresults in {found.directory}")
    for reason in reasons:
        print(f"{arguments.scene}: {reason}", file=sys.stderr)
    return FAILED if reasons else DONE


def _target(arguments: argparse.Namespace, default: Path, suffix: str = "") -> Path:
    """The file that a command writes; raises InputError where that cannot be."""
    path: Path = arguments.out or default
    if path.suffix != (suffix or path.suffix):
        raise InputError(f"{arguments.command}: given --out {path}; accepted: a name that ends in {suffix}")
    if not path.parent.is_dir():
        place = "--out in a directory that is there"
        raise InputError(f"{arguments.command}: {path.parent} is no directory; accepted: {place}")
    return path


def explore(arguments: argparse.Namespace) -> int:
    """Write the page of a run."""
    from casadi_skin.runs.explorer import PAGE_FILE, write_page

    source = arguments.directory
    if not source.exists():
        accepted = "accepted: the directory of a run or a map, or a file of one"
        raise InputError(f"explore: {source} does not exist; {accepted}")
    target = _target(arguments, source.with_suffix(".html") if source.is_file() else source / PAGE_FILE, ".html")
    try:
        write_page(source, target)
    except ValueError as error:
        raise InputError(f"explore: {error}") from None
    if not arguments.quiet:
        print(f"wrote {target}; open it in a browser")
    return DONE


def new(arguments: argparse.Namespace) -> int:
    """Write a scene to start from, with the Python file of a model; files that are there are not touched."""
    scene = _target(arguments, Path(f"{arguments.kind}.toml"), ".toml")
    names = {scene: f"{arguments.kind}.toml"}
    if arguments.kind == "model":
        names[scene.with_suffix(".py")] = "model.py"
    for path in filter(Path.exists, names):
        raise InputError(f"new: {path} is there already; accepted: another --out")
    for path, name in names.items():
        text = (files("casadi_skin.runs") / "starts" / name).read_text(encoding="utf-8")
        _write(path, text.replace("NAME.py", scene.with_suffix(".py").name))
    if not arguments.quiet:
        print(f"wrote {' and '.join(map(str, names))}; next: casadi-skin run {scene}")
    return DONE


def schema(arguments: argparse.Namespace) -> int:
    """Print the JSON schema of scenes, or write it into a file."""
    text = json.dumps(scene_schema(), indent=2)
    if arguments.out is None:
        print(text)
    else:
        _write(_target(arguments, Path()), f"{text}\n")
    return DONE


def _write(path: Path, text: str) -> None:
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def completion(arguments: argparse.Namespace) -> int:
    """Print the completion of the program for a shell."""
    import shtab

    for parser in arguments.parsers.values():
        for action in parser._actions:
            if action.type is Path:
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
    sys.stdout.write(shtab.complete(arguments.parser, arguments.shell))
    return DONE


def print_help(arguments: argparse.Namespace) -> int:
    """Print the help of a command, or of all."""
    arguments.parsers.get(arguments.verb, arguments.parser).print_help()
    return DONE


ACTS: Mapping[str, Callable[[argparse.Namespace], int]] = {
    "run": run,
    "check": check,
    "spectrum": spectrum,
    "map": map_scene,
    "tradeoff": lambda arguments: import_module("casadi_skin.runs.tradeoff").run(arguments),
    "explore": explore,
    "new": new,
    "schema": schema,
    "completion": completion,
    "help": print_help,
}
