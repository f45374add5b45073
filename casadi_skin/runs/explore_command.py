"""The command explore: a page that shows a run in a browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TypeAlias

from casadi_skin.runs.output import DONE, InputError

Commands: TypeAlias = "argparse._SubParsersAction[Any]"
PAGE = "explore.html"


def add_explore(commands: Commands) -> None:
    """Add the command to those of a parser."""
    parser = commands.add_parser(
        "explore",
        help="a page that shows a run or a map in a browser",
        description="Write one HTML file with linked pictures of the branches of a run, or of a map, without network. "
        "A map, a branch or a diagram that was saved as one file is shown too.",
        epilog="Example: casadi-skin explore results/chain",
    )
    parser.add_argument(
        "directory", type=Path, metavar="DIR", help="the directory of a run or of a map, or a file of one"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE.html",
        help=f"the file (default: DIR/{PAGE}, beside a file its name with .html)",
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.set_defaults(act=explore)


def explore(arguments: argparse.Namespace) -> int:
    """Write the page of a run."""
    from casadi_skin.runs.explorer import write_page

    source = arguments.directory
    if not source.exists():
        raise InputError(
            f"explore: {source} does not exist; accepted: the directory of a run or a map, or a file of one"
        )
    target = arguments.out or (source.with_suffix(".html") if source.is_file() else source / PAGE)
    if not target.parent.is_dir() or target.suffix != ".html":
        raise InputError(
            f"explore: given --out {target}; accepted: a name that ends in .html, in a directory that is there"
        )
    try:
        write_page(source, target)
    except ValueError as error:
        raise InputError(f"explore: {error}") from None
    if not arguments.quiet:
        print(f"wrote {target}; open it in a browser")
    return DONE
