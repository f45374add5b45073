"""The command line: words -> a scene, a study."""

from __future__ import annotations

import argparse
import difflib
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

from casadi_skin._version import __version__
from casadi_skin.rundir import DirectoryError, Existing, prepare, prepare_study
from casadi_skin.scene import Scene, SceneError, parse_scene, read_text

if TYPE_CHECKING:
    from casadi_skin.run import Run

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_INPUT, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="casadi-skin",
        description="Nonlinear periodic orbits of nonreciprocal chains: families, stability, pictures.",
        epilog="Exit status: 0 done, 1 failed or ended early, 2 wrong input, 130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=f"casadi-skin {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="compute what a scene asks for", description="Compute what a scene asks for.")
    run.add_argument("scene", type=Path, metavar="SCENE.toml")
    run.add_argument(
        "--out", type=Path, metavar="DIR", help="directory of the results (default: results/NAME-OF-THE-SCENE)"
    )
    held = run.add_mutually_exclusive_group()
    held.add_argument(
        "--resume", action="store_true", help="go on with a run that was killed, interrupted or ended early"
    )
    held.add_argument("--overwrite", action="store_true", help="replace the results that DIR holds")
    run.add_argument("--quiet", action="store_true", help="no progress on the terminal")
    run.set_defaults(act=_run)

    check = commands.add_parser("check", help="print the plan of a scene", description="Print what a run would do.")
    check.add_argument("scene", type=Path, metavar="SCENE.toml")
    check.set_defaults(act=_check)

    spectrum = commands.add_parser(
        "spectrum", help="linear frequencies of a scene's chain", description="Print the linear frequencies omega_j."
    )
    spectrum.add_argument("scene", type=Path, metavar="SCENE.toml")
    spectrum.add_argument("--out", type=Path, metavar="DIR", help="also write spectrum.csv and its picture there")
    spectrum.add_argument("--overwrite", action="store_true", help="replace the results that DIR holds")
    spectrum.set_defaults(act=_spectrum)

    again = commands.add_parser(
        "reproduce",
        help="the paper's figures and claims, recomputed",
        description="Recompute the figures of arXiv:2512.17483, fig1 to fig7, and check its claims.",
    )
    again.add_argument("targets", nargs="*", metavar="TARGET", help="fig1 ... fig7, claims (default: all)")
    again.add_argument("--out", type=Path, metavar="DIR", help="directory of the results (default: results/paper)")
    again.add_argument("--overwrite", action="store_true", help="replace what DIR holds of the targets")
    again.add_argument("--quiet", action="store_true", help="no progress on the terminal")
    again.set_defaults(act=_reproduce)

    trade = commands.add_parser(
        "tradeoff",
        help="what accuracy costs, method by method",
        description="Measure time, memory and true errors of every method and tolerance on one family.",
    )
    trade.add_argument(
        "scene",
        type=Path,
        nargs="?",
        metavar="SCENE.toml",
        help="scene whose family is measured, the first of several; its accuracy and methods do not matter "
        "(default: j = 1, g = -1, N = 24 to S = 1)",
    )
    trade.add_argument("--out", type=Path, metavar="DIR", help="directory of the results (default: results/tradeoff)")
    trade.add_argument("--quick", action="store_true", help="three tolerances, each timed once")
    trade.add_argument("--repeats", type=int, metavar="K", help="timed runs of each setting (default: 5; 1 if quick)")
    trade.add_argument("--overwrite", action="store_true", help="replace what DIR holds of an earlier measurement")
    trade.add_argument("--quiet", action="store_true", help="no progress on the terminal")
    trade.set_defaults(act=_tradeoff)

    honest = commands.add_parser(
        "honesty",
        help="whether estimated errors are honest, on random cases",
        description="Compare estimated with true errors of random orbits; exit status 1 where they are not honest.",
    )
    honest.add_argument("--cases", type=int, default=200, metavar="K", help="number of cases (default: 200)")
    honest.add_argument("--seed", type=int, default=0, metavar="K", help="of the draw (default: 0)")
    honest.add_argument("--first", type=int, default=0, metavar="K", help="index of the first case (default: 0)")
    honest.add_argument("--out", type=Path, metavar="DIR", help="directory of the results (default: results/honesty)")
    honest.add_argument("--overwrite", action="store_true", help="replace what DIR holds of an earlier run")
    honest.add_argument("--quiet", action="store_true", help="no progress on the terminal")
    honest.set_defaults(act=_honesty)
    return parser


# Commands -----------------------------------------------------------------------------------------------------------


def _run(arguments: argparse.Namespace) -> int:
    scene, text = _read(arguments.scene)
    if scene.family is None and scene.spectrum is None:
        raise InputError(f"{arguments.scene}: asks for nothing to compute; accepted: a table [family] or [spectrum]")
    if scene.spectrum is not None:
        _check_spectrum(arguments.scene, scene)
    directory = arguments.out or Path("results") / arguments.scene.stem
    existing = Existing.RESUME if arguments.resume else Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    if not prepare(directory, scene, text, existing):
        print(f"{directory} holds the complete run already")
        return DONE

    from casadi_skin.progress import Progress
    from casadi_skin.run import Run

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
            print(f"{arguments.scene}: mode {branch.tools.request.mode}: {branch.reason}", file=sys.stderr)
    if run.evolution_failure:
        print(f"{arguments.scene}: [dynamics]: {run.evolution_failure}", file=sys.stderr)
    return DONE if complete else FAILED


def _check(arguments: argparse.Namespace) -> int:
    scene, _ = _read(arguments.scene)
    from casadi_skin.plan import plan_lines

    for subject, words in plan_lines(scene):
        print(f"{subject:<14}{words}")
    return DONE


def _spectrum(arguments: argparse.Namespace) -> int:
    scene, text = _read(arguments.scene)
    _check_spectrum(arguments.scene, scene)
    if arguments.out is not None:
        prepare(arguments.out, scene, text, Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE)
    from casadi_skin.plan import scene_chain
    from casadi_skin.results.tables import spectrum_rows

    chain = scene_chain(scene)
    print("j omega_j")
    for row in spectrum_rows(chain):
        print(f"{row['mode']} {row['omega']:.15g}")
    if arguments.out is not None:
        from casadi_skin.run import write_spectrum

        write_spectrum(chain, arguments.out)
    return DONE


def _reproduce(arguments: argparse.Namespace) -> int:
    from casadi_skin.studies.reproduce import TARGETS, reproduce

    for name in arguments.targets:
        if name not in TARGETS:
            near = next(iter(difflib.get_close_matches(name[:40].lower(), TARGETS, n=1)), None)
            hint = f"did you mean {near}? " if near else ""
            raise InputError(f"reproduce: given {name[:40]!r}; {hint}accepted: {', '.join(TARGETS)}")
    directory = arguments.out or Path("results") / "paper"
    prepare_study(directory, arguments.overwrite)

    from casadi_skin.progress import Progress

    with Progress(arguments.quiet) as progress:
        try:
            made = reproduce(arguments.targets, directory, progress.say)
        except KeyboardInterrupt:
            progress.__exit__(None, None, None)
            print(f"interrupted; what was computed is in {directory}", file=sys.stderr)
            return INTERRUPTED
        except ArithmeticError as error:
            progress.__exit__(None, None, None)
            print(f"casadi-skin: {error}; what was computed is in {directory}", file=sys.stderr)
            return FAILED
    if made.claims:
        counts = ", ".join(f"{verdict}: {count}" for verdict, count in made.verdicts.items())
        print(f"{len(made.claims)} claims; {counts}")
    print(f"{len(made.files)} files in {directory}")
    return DONE


def _tradeoff(arguments: argparse.Namespace) -> int:
    scene = None if arguments.scene is None else _read(arguments.scene)[0]
    if scene is not None and scene.family is None:
        raise InputError(f"{arguments.scene}: asks for no family to measure; accepted: a scene with a table [family]")
    if arguments.repeats is not None and arguments.repeats < 1:
        raise InputError(f"tradeoff: given --repeats {arguments.repeats}; accepted: a whole number >= 1")
    directory = arguments.out or Path("results") / "tradeoff"
    prepare_study(directory, arguments.overwrite)

    from casadi_skin.plan import scene_requests
    from casadi_skin.progress import Progress
    from casadi_skin.studies.tradeoff import REPEATS, Tradeoff, default_request, with_points

    request = default_request() if scene is None else with_points(scene_requests(scene)[0])
    repeats = arguments.repeats or (1 if arguments.quick else REPEATS)
    with Progress(arguments.quiet) as progress:
        study = Tradeoff(request, directory, arguments.quick, repeats, progress.say)
        try:
            study.execute()
        except KeyboardInterrupt:
            progress.__exit__(None, None, None)
            print(f"interrupted; what was measured is in {directory}", file=sys.stderr)
            return INTERRUPTED
        except ArithmeticError as error:
            progress.__exit__(None, None, None)
            print(f"casadi-skin: {error}; what was measured is in {directory}", file=sys.stderr)
            return FAILED
    for line in study.advice():
        print(line)
    print(f"{len(study.measured)} settings; {len(study.files)} files in {directory}")
    return DONE


def _honesty(arguments: argparse.Namespace) -> int:
    for name, least in (("cases", 1), ("seed", 0), ("first", 0)):
        if getattr(arguments, name) < least:
            raise InputError(f"honesty: given --{name} {getattr(arguments, name)}; accepted: a whole number >= {least}")
    directory = arguments.out or Path("results") / "honesty"
    prepare_study(directory, arguments.overwrite)

    from rich.console import Console

    from casadi_skin.progress import Progress
    from casadi_skin.studies.honesty import Honesty, honesty, honesty_table

    study = Honesty(directory, arguments.cases)
    with Progress(arguments.quiet) as progress:
        try:
            honesty(study, arguments.seed, progress.say, arguments.first)
        except KeyboardInterrupt:
            progress.__exit__(None, None, None)
            print(f"interrupted after {len(study.outcomes)} cases; they are in {directory}", file=sys.stderr)
            return INTERRUPTED
    Console().print(honesty_table(study))
    for outcome in study.failures:
        print(f"case {outcome.case.index}: {outcome.reason}")
    for fault in study.faults:
        print(f"not honest: {fault}")
    print(f"{len(study.outcomes)} cases; {len(study.files)} files in {directory}")
    return FAILED if study.faults else DONE


# Parts --------------------------------------------------------------------------------------------------------------


def _read(path: Path) -> tuple[Scene, str]:
    """The scene of a file and its text."""
    text = read_text(path)
    return parse_scene(text, str(path)), text


def _check_spectrum(path: Path, scene: Scene) -> None:
    """Raises InputError where the lowest mode does not oscillate."""
    from casadi_skin.plan import scene_chain

    try:
        scene_chain(scene).linear_frequency(1)
    except ValueError as error:
        raise InputError(f"{path}: [chain] alpha: given {scene.chain.alpha:g}; {error}") from error


def _summary(run: Run) -> None:
    """A table of the families on standard output."""
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
        cells = [str(branch.tools.request.mode), str(len(branch))]
        if not len(branch):
            table.add_row(*cells)
            continue
        last = branch.orbits[-1]
        cells += [f"{last.S:.6g}", f"{last.Omega:.10g}", f"{max(o.Omega_error for o in branch.orbits):.1e}"]
        if branch.with_stability:
            cells += [f"{branch.max_abs_multiplier.max():.8g}", str(len(branch.changes))]
        table.add_row(*cells, f"{seconds:.2f}")
    Console().print(table)
    if run.evolution is not None:
        print(f"dynamics: {run.evolution.status}")
    print(f"results in {run.directory}")


def _interrupt(number: int, frame: FrameType | None) -> None:
    """A polite kill ends a run like Ctrl-C: what was computed is written."""
    raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parsed = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        return int(parsed.act(parsed))
    except (SceneError, DirectoryError, InputError) as error:
        print(f"casadi-skin: {error}", file=sys.stderr)
        return WRONG_INPUT
    except KeyboardInterrupt:
        print("casadi-skin: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone, as in `casadi-skin spectrum SCENE.toml | head`; nothing more can be said.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE


if __name__ == "__main__":
    sys.exit(main())
