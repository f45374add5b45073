"""The command line: each command is a function with its purpose, an example and its options, and returns a status.

Nothing is written where a scene or its model is wrong. What a command needs is loaded when it is run: --help needs
none of it.
"""

from __future__ import annotations

import argparse
import gc
import math
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from casadi_skin._version import __version__
from casadi_skin.model.interrupts import ended_by_signals
from casadi_skin.runs.output import (
    DONE,
    FAILED,
    INTERRUPTED,
    MOST_REASONS,
    WRONG_INPUT,
    InputError,
    OutputError,
    add_study_options,
    complain,
    exit_status,
    guarded_streams,
    print_json,
    print_results,
)

if TYPE_CHECKING:
    from casadi_skin.model.interrupts import TimeLimit
    from casadi_skin.runs.directory import Existing
    from casadi_skin.runs.map_result import Map
    from casadi_skin.runs.output import Progress
    from casadi_skin.runs.request import Request
    from casadi_skin.runs.scene import Scene

COLLECTOR_THRESHOLDS = (200_000, 20, 50)  # modules live to the end, and a picture is 20,000 objects
OF_MODEL = ("orbit", "continuation", "design", "dynamics", "export", "map")  # tables checked against the model
ASKED_TASKS = ("family", "equilibrium", "orbit", "solution", "design", "dynamics", "export", "spectrum")
KINDS = ("chain", "lattice", "model")  # of scenes to start from

# Options, and the table of commands -----------------------------------------------------------------------------------

Option = tuple[str, dict[str, Any]]  # a name, and what argparse takes with it
Act = Callable[[argparse.Namespace], int]
Options = tuple[Option | list[Option], ...]  # of those in one list one may be given
COMMANDS: dict[str, tuple[Act, Options]] = {}  # functions by name, whose help is their docstring


def command(*options: Option | list[Option]) -> Callable[[Act], Act]:
    """Enter a function as the command of its name."""

    def enter(act: Act) -> Act:
        COMMANDS[act.__name__.rstrip("_")] = act, options
        return act

    return enter


def switch(name: str, words: str) -> Option:
    """An option that is there or not."""
    return name, {"action": "store_true", "help": words}


def value(name: str, words: str | None, metavar: str | None, kind: Callable[[str], object], **more: object) -> Option:
    """An option or an argument with a value."""
    return name, {"type": kind, "help": words, **({} if metavar is None else {"metavar": metavar}), **more}


SCENE = value("scene", None, "SCENE.toml", Path)
OUT = value("--out", "directory of the results (default: results/NAME-OF-THE-SCENE)", "DIR", Path)
RESUME = switch("--resume", "go on with a run or a map that was killed, interrupted or ended early")
OVERWRITE = switch("--overwrite", "replace the results that DIR holds")
QUIET = switch("--quiet", "print nothing but errors")
OUTPUT = [QUIET, switch("--json", "print the results as JSON, and nothing else")]

# A scene: run, check, spectrum, map -----------------------------------------------------------------------------------


def _scene(arguments: argparse.Namespace) -> tuple[Scene, str]:
    """The scene in the file that a command is given, and its text."""
    from casadi_skin.runs.reading import parse_scene, read_text

    text = read_text(arguments.scene)
    return parse_scene(text, str(arguments.scene)), text


def _bound(scene: Scene, arguments: argparse.Namespace) -> Request:
    """The scene with its model, checked; which Python file that is about to be run is printed before.

    A program may do anything, a saved model nothing. The line goes to standard error where standard output is for
    results alone.
    """
    _name_program(scene, arguments)
    from casadi_skin.runs.binding import bound

    return bound(scene, arguments.scene)


def _name_program(scene: Scene, arguments: argparse.Namespace) -> None:
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


BEYOND_MEMORY = switch("--beyond-memory", "run what needs more memory than there is")


@command(SCENE, OUT, [RESUME, OVERWRITE], OUTPUT, BEYOND_MEMORY)
def run(arguments: argparse.Namespace) -> int:
    """Compute what a scene asks for.

    Example: casadi-skin run examples/softening_end_breather.toml --out results/breather
    """
    scene, text = _scene(arguments)
    if not scene.given(*ASKED_TASKS):
        accepted = "a table [family], [equilibrium], [orbit], [solution], [design], [dynamics], [export] or [spectrum]"
        raise InputError(f"{arguments.scene}: asks for nothing to compute; accepted: {accepted}")
    request = _bound(scene, arguments)
    if not arguments.beyond_memory:
        from casadi_skin.runs.cost import check_memory

        check_memory(request, arguments.scene)
    from casadi_skin.runs.directory import in_use
    from casadi_skin.runs.output import Progress

    directory, existing = _place(arguments)
    with Progress(arguments.quiet) as progress, in_use(directory, progress.report):
        return _run_in(directory, existing, request, text, arguments, progress)


def _run_in(
    directory: Path, existing: Existing, request: Request, text: str, arguments: argparse.Namespace, progress: Progress
) -> int:
    """Compute a request in a directory of this process, and return the exit status."""
    from casadi_skin.runs.directory import prepare

    if not prepare(directory, request, text, existing):
        if arguments.json:
            print_results(directory, True, ())
        elif not arguments.quiet:
            print(f"{directory} holds the complete run already")
        return DONE

    from casadi_skin.model.interrupts import TimeLimit, time_limited
    from casadi_skin.runs.run import Run, print_summary

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
    place = f"{arguments.scene}: "
    if stopped:
        reasons, place = [f"{stopped}; what was computed is in {directory}; go on with --resume"], ""
    complain(*(f"{place}{reason}" for reason in reasons))
    return status


@command(SCENE, switch("--measure", "build and solve at the start of families too: unknowns, expected cost"), OUTPUT)
def check(arguments: argparse.Namespace) -> int:
    """Print what a run would do.

    Example: casadi-skin check examples/fput_modes.toml
    """
    from casadi_skin.runs.plan import chain_lines, plan_lines

    scene, _ = _scene(arguments)
    lines = None if arguments.measure else chain_lines(scene)
    if lines is None:
        request = _bound(scene, arguments)
        from casadi_skin.runs.rules import SceneError

        try:
            lines = plan_lines(request, arguments.measure)
            if scene.map is not None:
                from casadi_skin.runs.map import map_lines

                lines += map_lines(scene, request, arguments.scene)
        except SceneError as error:
            raise InputError(f"{arguments.scene}: {error}") from None
        except (ValueError, ArithmeticError) as error:  # numbers that are finite, and what is made of them is not
            raise InputError(f"{arguments.scene}: cannot be planned: {error}") from None
    if arguments.json:
        print_json([{"subject": subject, "words": words} for subject, words in lines])
    elif not arguments.quiet:
        for subject, words in lines:
            print(f"{subject:<14}{words}")
    return DONE


@command(SCENE, value("--out", "also write spectrum.csv and its picture there", "DIR", Path), OVERWRITE, OUTPUT)
def spectrum(arguments: argparse.Namespace) -> int:
    """Print the linear frequencies omega_j of a scene's model.

    Example: casadi-skin spectrum examples/fput_modes.toml --out results/spectrum
    """
    scene, text = _scene(arguments)
    frequencies = None if arguments.out is not None else _closed_form(scene)
    if frequencies is None:
        from casadi_skin.runs.binding import bound, check_spectrum
        from casadi_skin.runs.rules import faults_at, in_file, placed

        request = bound(scene, arguments.scene)
        with in_file(arguments.scene):
            check_spectrum(request)
            with faults_at(partial(placed, table="lattice")):  # a run writes it all the same
                frequencies = [float(omega) for omega in request.model.linear_frequencies(request.parameters)]
        if arguments.out is not None:
            from casadi_skin.runs.directory import Existing, prepare
            from casadi_skin.runs.tasks import write_spectrum

            prepare(arguments.out, request, text, Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE)
            write_spectrum(request, arguments.out)
    if arguments.json:
        print_json({"omega": frequencies})
    elif not arguments.quiet:
        print("j omega_j")
        for mode, omega in enumerate(frequencies, start=1):
            print(f"{mode} {omega:.15g}")
    return DONE


def _closed_form(scene: Scene) -> list[float] | None:
    """Linear frequencies of a finite chain that oscillates, without loading numerics; None for another scene."""
    from casadi_skin.lattice.stiffness import stiffness

    chain = scene.chain
    if chain is None or chain.sites == math.inf or scene.given(*OF_MODEL):
        return None
    squares = [chain.alpha + stiffness(chain.sites, chain.gamma, mode) for mode in range(1, int(chain.sites) + 1)]
    return [math.sqrt(square) for square in squares] if min(squares) > 0.0 else None


@command(
    SCENE, OUT, [RESUME, OVERWRITE], switch("--no-pictures", "tables alone"), OUTPUT, BEYOND_MEMORY,
    value("--workers", "processes on this machine (default: 1)", "N", int, default=1),
    [value("--scheduler", "a dask scheduler, whose workers compute the cells", "ADDRESS", str),
     value("--part", "one share of a batch array; whoever comes last joins them", "K/N", str),
     switch("--collect", "join what all shares have; compute nothing")],
)  # fmt: skip
def map_(arguments: argparse.Namespace) -> int:
    """Compute a scene over one or two of its parameters, cell by cell, on one machine or many.

    Example: casadi-skin map examples/stability_chart.toml --workers 2
    """
    scene, _ = _scene(arguments)
    if scene.map is None:
        raise InputError(f"{arguments.scene}: [map]: missing; accepted: a table of parameters with ranges or lists")
    pair = re.fullmatch(r"(\d{1,6})/(\d{1,6})", arguments.part or "")
    part: Any = arguments.part if pair is None else (int(pair[1]), int(pair[2]))  # checked with the other options
    _name_program(scene, arguments)
    from casadi_skin.model.interrupts import TimeLimit, time_limited
    from casadi_skin.runs.map import MapRun
    from casadi_skin.runs.output import Progress

    directory, existing = _place(arguments)
    options = arguments.workers, arguments.scheduler, None, part, arguments.collect, existing
    try:
        mapping = MapRun(arguments.scene, directory, *options, not arguments.no_pictures)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"map: --{error}") from None
    if not (arguments.beyond_memory or arguments.collect or arguments.scheduler):
        from casadi_skin.runs.cost import check_memory

        check_memory(mapping.request, arguments.scene, arguments.workers)
    limit = TimeLimit(scene.time_limit)
    with Progress(arguments.quiet) as progress:
        try:
            with time_limited(limit):
                found = mapping.execute(progress)
        except ImportError as error:
            raise InputError(f"map: --scheduler: {error}") from None
        except KeyboardInterrupt:
            status, words = _stopped(arguments, limit)
            complain(f"{words}; what was computed is in {directory}; go on with --resume")
            return status
        except (ValueError, ArithmeticError) as error:
            if type(error).__module__.startswith("casadi_skin"):
                raise
            complain(f"casadi-skin: {directory}: {error}")
            return FAILED
    return _report_map(found, arguments)


def _report_map(found: Map, arguments: argparse.Namespace) -> int:
    """Report the computed and the missing cells of the map, and return the exit status."""
    waits = found.waits and arguments.part is not None
    failures = [] if waits else [": ".join(known) for known in found.failures(MOST_REASONS + 1)]
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
    complain(*(f"{arguments.scene}: {reason}" for reason in reasons))
    return FAILED if reasons else DONE


# Other commands -------------------------------------------------------------------------------------------------------

MEASURED = (
    "scene whose family is measured, the first of several; its accuracy and methods do not matter "
    "(default: j = 1, g = -1, N = 24 to S = 1)"
)


@command(
    value("scene", MEASURED, "SCENE.toml", Path, nargs="?"),
    switch("--quick", "three tolerances, each timed once"),
    value("--repeats", "timed runs of each setting (default: 5; 1 if quick)", "K", int),
)
def tradeoff(arguments: argparse.Namespace) -> int:
    """Measure time, memory and true errors of every method and tolerance on one family.

    Example: casadi-skin tradeoff examples/softening_end_breather.toml --quick
    """
    status: int = import_module("casadi_skin.runs.tradeoff").run(arguments)
    return status


def _target(arguments: argparse.Namespace, default: Path, suffix: str = "") -> Path:
    """The file that a command writes; raises InputError where that cannot be."""
    from casadi_skin.model.arguments import new_file

    try:
        return new_file("--out", arguments.out or default, suffix)
    except ValueError as error:
        raise InputError(f"{arguments.command}: {error}") from None


@command(
    value("directory", "the directory of a run or of a map, or a file of one", "DIR", Path),
    value("--out", "the file (default: DIR/explore.html, beside a file its name with .html)", "FILE.html", Path),
    QUIET,
)
def explore(arguments: argparse.Namespace) -> int:
    """Write one HTML file that shows a run, a map, or a branch or diagram that was saved, without network.

    Example: casadi-skin explore results/chain
    """
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


@command(
    value("kind", "what the scene is of; a model comes with its Python file", None, str, choices=KINDS),
    value("--out", "the file (default: KIND.toml)", "SCENE.toml", Path),
    QUIET,
)
def new(arguments: argparse.Namespace) -> int:
    """Write a scene of a chain, a lattice or a model, with a comment on every line, that runs as it is.

    Example: casadi-skin new chain --out breather.toml
    """
    from importlib.resources import files

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


@command(value("--out", "write it there in place of printing it", "FILE.json", Path))
def schema(arguments: argparse.Namespace) -> int:
    """Print the JSON schema of scenes; editors complete and check scenes with it.

    Example: casadi-skin schema --out scene.schema.json
    """
    import json

    from casadi_skin.runs.reading import scene_schema

    text = json.dumps(scene_schema(), indent=2)
    if arguments.out is None:
        print(text)
    else:
        _write(_target(arguments, Path()), f"{text}\n")
    return DONE


def _write(path: Path, text: str) -> None:
    from casadi_skin.model.files import replacing

    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@command(value("shell", None, None, str, choices=("bash", "zsh", "tcsh")))
def completion(arguments: argparse.Namespace) -> int:
    """Print what a shell needs to complete commands, options and files.

    Example: eval "$(casadi-skin completion bash)"
    """
    import shtab

    for parser in arguments.parsers.values():
        for action in parser._actions:
            if action.type is Path:
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
    sys.stdout.write(shtab.complete(arguments.parser, arguments.shell))
    return DONE


@command(value("verb", "default: all of them", "COMMAND", str, nargs="?", choices=(*COMMANDS, "help")))
def help_(arguments: argparse.Namespace) -> int:
    """Print what a command does, with an example.

    Example: casadi-skin help run
    """
    arguments.parsers.get(arguments.verb, arguments.parser).print_help()
    return DONE


# The program ----------------------------------------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        words = " ".join(message.split())
        choice = re.fullmatch(r"argument (\S+): invalid choice: '(.*)' \(choose from (.*)\)", words)
        if choice is not None:
            from casadi_skin.model.arguments import accepted_names

            known = [name.strip("'") for name in choice[3].split(", ")]
            words = f"{choice[1]}: given '{choice[2]}'; {accepted_names(choice[2], known)}"
        complain(f"{self.prog}: {words}; see {self.prog} --help")
        self.exit(WRONG_INPUT)


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from casadi_skin.native import kernels_in_words

        print(f"casadi-skin {__version__} (kernels: {kernels_in_words()})")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="casadi-skin",
        description="Periodic orbits of lattices and of any model: families, branches, stability, pictures.",
        epilog="Example: casadi-skin new chain && casadi-skin run chain.toml. Exit status: 0 done, 1 failed or ended "
        "early, 2 wrong input, 130 interrupted. CASADI_SKIN_TRACEBACK=FILE in the environment keeps the traceback of "
        "an unexpected error in a file.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version, and which kernels are in use")
    added = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (act, options) in COMMANDS.items():
        words, _, example, *_ = map(str.strip, (act.__doc__ or "\n\n").split("\n"))
        one = added.add_parser(name, help=words[:1].lower() + words[1:-1], description=words, epilog=example)
        for either in options:
            group = one.add_mutually_exclusive_group() if isinstance(either, list) else one
            for option, given in either if isinstance(either, list) else [either]:
                group.add_argument(option, **given)
    add_study_options(added.choices["tradeoff"], Path("results/tradeoff"))
    parser.set_defaults(parser=parser, parsers=added.choices)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    before = gc.get_threshold()
    gc.set_threshold(*COLLECTOR_THRESHOLDS)
    try:
        with guarded_streams():
            parsed, unknown = _parser().parse_known_args(arguments)
            if unknown:
                _Parser(prog=f"casadi-skin {parsed.command}").error(f"unrecognized arguments: {' '.join(unknown)}")
            with ended_by_signals():
                return exit_status(lambda: COMMANDS[parsed.command][0](parsed))
    except OutputError as error:
        with suppress(OSError, ValueError, AttributeError):  # standard error may be closed, too
            sys.stderr.write(f"casadi-skin: standard output: {error}\n")
        return FAILED
    finally:
        gc.set_threshold(*before)


if __name__ == "__main__":
    sys.exit(main())
