"""Commands that run studies: reproduce, tradeoff, honesty, extremes."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from casadi_skin.model.methods import FORMATS
from casadi_skin.runs.output import DONE, FAILED, INTERRUPTED, InputError, add_output, print_results

if TYPE_CHECKING:
    from casadi_skin.studies.study import Study

Commands: TypeAlias = "argparse._SubParsersAction[Any]"


def add_studies(commands: Commands) -> None:
    """Add the commands of all studies to those of a parser."""
    paper = commands.add_parser(
        "reproduce",
        help="the paper's figures and claims, recomputed",
        description="Recompute the figures of arXiv:2512.17483, fig1 to fig7, and check its claims.",
        epilog="Example: casadi-skin reproduce fig3 claims --out results/paper",
    )
    paper.add_argument("targets", nargs="*", metavar="TARGET", help="fig1 ... fig7, claims (default: all)")
    paper.set_defaults(study=_paper, out=Path("results/paper"))

    work = commands.add_parser(
        "tradeoff",
        help="what accuracy costs, method by method",
        description="Measure time, memory and true errors of every method and tolerance on one family.",
        epilog="Example: casadi-skin tradeoff examples/softening_end_breather.toml --quick",
    )
    work.add_argument(
        "scene",
        type=Path,
        nargs="?",
        metavar="SCENE.toml",
        help="scene whose family is measured, the first of several; its accuracy and methods do not matter "
        "(default: j = 1, g = -1, N = 24 to S = 1)",
    )
    work.add_argument("--quick", action="store_true", help="three tolerances, each timed once")
    work.add_argument("--repeats", type=int, metavar="K", help="timed runs of each setting (default: 5; 1 if quick)")
    work.set_defaults(study=_work_precision, out=Path("results/tradeoff"))

    errors = commands.add_parser(
        "honesty",
        help="whether estimated errors are honest, on random cases",
        description="Compare estimated with true errors of random orbits; exit status 1 where they are not honest.",
        epilog="Example: casadi-skin honesty --cases 20 --seed 1",
    )
    errors.add_argument("--cases", type=int, default=200, metavar="K", help="number of cases (default: 200)")
    errors.add_argument("--seed", type=int, default=0, metavar="K", help="of the draw (default: 0)")
    errors.add_argument("--first", type=int, default=0, metavar="K", help="index of the first case (default: 0)")
    errors.set_defaults(study=_error_calibration, out=Path("results/honesty"))

    hard = commands.add_parser(
        "extremes",
        help="hard cases: where results hold, and where they are refused",
        description="Check orbits and multipliers at the extremes of every parameter by independent means; exit "
        "status 1 where a case neither holds nor is refused as expected.",
        epilog="Example: casadi-skin extremes --quick",
    )
    hard.add_argument("--quick", action="store_true", help="the shorter cases alone")
    hard.set_defaults(study=_stress_test, out=Path("results/extremes"))

    for parser in (paper, work, errors, hard):
        default = parser.get_default("out")
        parser.add_argument("--out", type=Path, metavar="DIR", help=f"directory of the results (default: {default})")
        words = "format of its pictures, once for each that is wanted (default: png)"
        parser.add_argument("--format", action="append", dest="formats", choices=FORMATS, help=words)
        parser.add_argument("--overwrite", action="store_true", help="replace what DIR holds of the same")
        add_output(parser)
        parser.set_defaults(act="study_commands:run_study")


def run_study(arguments: argparse.Namespace) -> int:
    """Run the study of the arguments, show its report, and return the exit status."""
    from casadi_skin.runs.directory import prepare_study

    study: Study = arguments.study(arguments)
    study.formats = arguments.formats or study.formats
    prepare_study(study.directory, arguments.overwrite)

    from casadi_skin.runs.progress import Progress

    with Progress(arguments.quiet) as progress:
        study.say = progress.say
        try:
            study.run()
        except (KeyboardInterrupt, ArithmeticError) as error:
            progress.__exit__(None, None, None)
            interrupted = isinstance(error, KeyboardInterrupt)
            words = f"interrupted after {study.done} {study.part}" if interrupted else f"casadi-skin: {error}"
            print(f"{words}; the results so far are in {study.directory}", file=sys.stderr)
            return INTERRUPTED if interrupted else FAILED
    faults = [str(fault) for fault in study.faults]
    if arguments.json:
        print_results(study.directory, not faults, faults)
    elif not arguments.quiet:
        _print_report(study)
    if arguments.json or arguments.quiet:  # the report would have shown them
        for fault in faults:
            print(f"casadi-skin: {fault}", file=sys.stderr)
    return FAILED if faults else DONE


def _print_report(study: Study) -> None:
    from rich.console import Console

    for item in study.report():
        if isinstance(item, str):
            print(item)
        else:
            Console().print(item)
    print(f"{study.done} {study.part}; {len(study.files)} files in {study.directory}")


# The study of a command ---------------------------------------------------------------------------------------------


def _paper(arguments: argparse.Namespace) -> Study:
    from casadi_skin.studies.paper.reproduce import PaperReproduction

    try:
        return PaperReproduction(arguments.out, arguments.targets)
    except ValueError as error:
        raise InputError(f"reproduce: {error}") from error


def _work_precision(arguments: argparse.Namespace) -> Study:
    from casadi_skin.runs.scene_commands import bound, read_scene

    scene = None if arguments.scene is None else read_scene(arguments.scene)[0]
    if scene is not None and (scene.family is None or scene.chain is None or scene.chain.sites == math.inf):
        accepted = "a scene with a table [family], and a [chain] of finite length"
        raise InputError(f"{arguments.scene}: asks for no family that can be measured; accepted: {accepted}")
    if arguments.repeats is not None and arguments.repeats < 1:
        raise InputError(f"tradeoff: given --repeats {arguments.repeats}; accepted: a whole number >= 1")

    from casadi_skin.runs.request import chain_of
    from casadi_skin.studies.work_precision.settings import FamilyCase
    from casadi_skin.studies.work_precision.study import DEFAULT_FAMILY, REPEATS, WorkPrecision

    family = DEFAULT_FAMILY
    if scene is not None:
        request = bound(scene, arguments.scene).families[0]
        family = FamilyCase(
            chain_of(scene), int(request.mode), request.amplitude_max, tuple(request.targets.at)
        ).with_points()
    repeats = arguments.repeats or (1 if arguments.quick else REPEATS)
    return WorkPrecision(arguments.out, family, arguments.quick, repeats)


def _error_calibration(arguments: argparse.Namespace) -> Study:
    for name, least in (("cases", 1), ("seed", 0), ("first", 0)):
        if getattr(arguments, name) < least:
            raise InputError(f"honesty: given --{name} {getattr(arguments, name)}; accepted: a whole number >= {least}")

    from casadi_skin.studies.calibration.study import ErrorCalibration

    return ErrorCalibration(arguments.out, arguments.cases, arguments.seed, arguments.first)


def _stress_test(arguments: argparse.Namespace) -> Study:
    from casadi_skin.studies.stress.study import StressTest

    return StressTest(arguments.out, arguments.quick)
