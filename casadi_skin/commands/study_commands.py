"""Commands that run studies: reproduce, tradeoff, honesty, extremes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from casadi_skin.arguments import accepted_names, short_repr
from casadi_skin.commands.scene_commands import read_scene
from casadi_skin.commands.status import DONE, FAILED, INTERRUPTED, InputError
from casadi_skin.runs.directory import prepare_study


def reproduce_paper(arguments: argparse.Namespace) -> int:
    from casadi_skin.studies.paper.reproduce import TARGETS, reproduce

    for name in arguments.targets:
        if name not in TARGETS:
            raise InputError(f"reproduce: given {short_repr(name)}; {accepted_names(name, TARGETS)}")
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


def measure_tradeoff(arguments: argparse.Namespace) -> int:
    scene = None if arguments.scene is None else read_scene(arguments.scene)[0]
    if scene is not None and scene.family is None:
        raise InputError(f"{arguments.scene}: asks for no family to measure; accepted: a scene with a table [family]")
    if arguments.repeats is not None and arguments.repeats < 1:
        raise InputError(f"tradeoff: given --repeats {arguments.repeats}; accepted: a whole number >= 1")
    directory = arguments.out or Path("results") / "tradeoff"
    prepare_study(directory, arguments.overwrite)

    from casadi_skin.progress import Progress
    from casadi_skin.runs.request import scene_requests
    from casadi_skin.studies.work_precision.study import REPEATS, Tradeoff, default_request, with_points

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


def measure_honesty(arguments: argparse.Namespace) -> int:
    for name, least in (("cases", 1), ("seed", 0), ("first", 0)):
        if getattr(arguments, name) < least:
            raise InputError(f"honesty: given --{name} {getattr(arguments, name)}; accepted: a whole number >= {least}")
    directory = arguments.out or Path("results") / "honesty"
    prepare_study(directory, arguments.overwrite)

    from rich.console import Console

    from casadi_skin.studies.calibration.study import Honesty, honesty, honesty_table

    study = Honesty(directory, arguments.cases)
    if _interrupted(lambda say: honesty(study, arguments.seed, say, arguments.first), study, arguments.quiet):
        return INTERRUPTED
    Console().print(honesty_table(study))
    for outcome in study.failures:
        print(f"case {outcome.case.index}: {outcome.reason}")
    for fault in study.faults:
        print(f"not honest: {fault}")
    print(f"{len(study.outcomes)} cases; {len(study.files)} files in {directory}")
    return FAILED if study.faults else DONE


def measure_extremes(arguments: argparse.Namespace) -> int:
    directory = arguments.out or Path("results") / "extremes"
    prepare_study(directory, arguments.overwrite)

    from rich.console import Console

    from casadi_skin.studies.stress.study import Extremes, extremes, extremes_table

    study = Extremes(directory)
    if _interrupted(lambda say: extremes(study, arguments.quick, say), study, arguments.quiet):
        return INTERRUPTED
    Console().print(extremes_table(study))
    for outcome in study.refusals:
        print(f"refused: {outcome.case.name}: {outcome.refused}")
    for outcome in study.faults:
        print(f"not as expected: {outcome.case.theme}, {outcome.case.name}: {outcome.fault}")
    held = len(study.outcomes) - len(study.refusals) - len(study.faults)
    counts = f"{held} hold, {len(study.refusals)} are refused, {len(study.faults)} not as expected"
    print(f"{len(study.outcomes)} cases: {counts}")
    print(f"{len(study.files)} files in {directory}")
    return FAILED if study.faults else DONE


class _Cases(Protocol):
    """A study of cases that are written as they come."""

    directory: Path

    @property
    def outcomes(self) -> Sequence[object]: ...


def _interrupted(act: Callable[[Callable[[str], None]], None], study: _Cases, quiet: bool) -> bool:
    """Whether a study, which `act` carries out, was interrupted; what it has then is told."""
    from casadi_skin.progress import Progress

    with Progress(quiet) as progress:
        try:
            act(progress.say)
        except KeyboardInterrupt:
            progress.__exit__(None, None, None)
            print(f"interrupted after {len(study.outcomes)} cases; they are in {study.directory}", file=sys.stderr)
            return True
    return False
