"""The command map: a scene over its parameters."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from casadi_skin.runs.output import DONE, FAILED, INTERRUPTED, InputError, add_output, print_results

if TYPE_CHECKING:
    from casadi_skin.runs.map_result import Map

Commands: TypeAlias = "argparse._SubParsersAction[Any]"
MOST_REASONS = 5  # of failed cells that are printed


def add_map(commands: Commands) -> None:
    """Add the command to those of a parser."""
    parser = commands.add_parser(
        "map",
        help="a scene over one or two of its parameters, on one machine or many",
        description="Compute the map that a scene's table [map] asks for, cell by cell.",
        epilog="Example: casadi-skin map examples/stability_chart.toml --workers 2",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE.toml")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="directory of the results (default: results/NAME-OF-THE-SCENE)"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes on this machine (default: 1)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="a dask scheduler, whose workers compute the cells")
    where.add_argument("--part", metavar="K/N", help="one share of a batch array; whoever comes last joins them")
    where.add_argument("--collect", action="store_true", help="join what all shares have; compute nothing")
    held = parser.add_mutually_exclusive_group()
    held.add_argument("--resume", action="store_true", help="compute what is missing of a map that was begun")
    held.add_argument("--overwrite", action="store_true", help="replace the results that DIR holds")
    parser.add_argument("--no-pictures", action="store_true", help="tables alone")
    add_output(parser)
    parser.set_defaults(act="map_command:run")


def run(arguments: argparse.Namespace) -> int:
    """Compute the map of a scene; nothing is written where the scene or its model is wrong."""
    from casadi_skin.runs.directory import Existing
    from casadi_skin.runs.reading import read_text
    from casadi_skin.runs.scene_commands import name_program, read_scene

    scene, _ = read_scene(arguments.scene)
    if scene.map is None:
        raise InputError(f"{arguments.scene}: [map]: missing; accepted: a table of parameters with ranges or lists")
    part = _part(arguments.part)
    name_program(scene, arguments.scene, arguments.quiet, apart=arguments.json)

    from casadi_skin.model.interrupts import TimeLimit, time_limited
    from casadi_skin.runs.map import Mapped, Ways, check_ways, compute_map
    from casadi_skin.runs.progress import Progress

    existing = Existing.RESUME if arguments.resume else Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    ways = Ways(
        arguments.workers, arguments.scheduler, None, part, arguments.collect, existing, not arguments.no_pictures
    )
    try:
        check_ways(ways)
    except (ValueError, TypeError) as error:
        raise InputError(f"map: --{error}") from None
    mapped = Mapped.of(read_text(arguments.scene), arguments.scene)
    directory = arguments.out or Path("results") / arguments.scene.stem
    limit = TimeLimit(scene.time_limit)
    with Progress(arguments.quiet) as progress:
        try:
            with time_limited(limit):
                found = compute_map(mapped, directory, ways, progress)
        except ImportError as error:
            raise InputError(f"map: --scheduler: {error}") from None
        except KeyboardInterrupt:
            words = f"{arguments.scene}: {limit}" if limit.is_over else "interrupted"
            print(f"{words}; what was computed is in {directory}; go on with --resume", file=sys.stderr)
            return FAILED if limit.is_over else INTERRUPTED
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
