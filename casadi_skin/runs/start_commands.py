"""Commands for the first steps: new, schema, completion, help."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, TypeAlias

from casadi_skin.runs.output import DONE, InputError

Commands: TypeAlias = "argparse._SubParsersAction[Any]"
KINDS = ("chain", "lattice", "model")
SHELLS = ("bash", "zsh", "tcsh")
SCHEMA = "scene.schema.json"


def add_first_steps(commands: Commands, parser: argparse.ArgumentParser) -> None:
    """Add the commands to those of a parser, after all others: help and completion list these."""
    new = commands.add_parser(
        "new",
        help="write a commented scene to start from",
        description="Write a scene of a chain, a lattice or a model, with a comment on every line, that runs as it is.",
        epilog="Example: casadi-skin new chain --out breather.toml",
    )
    new.add_argument("kind", choices=KINDS, help="what the scene is of; a model comes with its Python file")
    new.add_argument("--out", type=Path, metavar="SCENE.toml", help="the file (default: KIND.toml)")
    new.add_argument("--quiet", action="store_true", help="print nothing but errors")
    new.set_defaults(act=write_start)

    schema = commands.add_parser(
        "schema",
        help="the JSON schema of scenes, for editors",
        description="Print the JSON schema of scenes; editors complete and check scenes with it.",
        epilog=f"Example: casadi-skin schema --out {SCHEMA}",
    )
    schema.add_argument("--out", type=Path, metavar="FILE.json", help="write it there in place of printing it")
    schema.set_defaults(act=write_schema)

    completion = commands.add_parser(
        "completion",
        help="completion of commands and options for a shell",
        description="Print what a shell needs to complete commands, options and files.",
        epilog='Example: eval "$(casadi-skin completion bash)"',
    )
    completion.add_argument("shell", choices=SHELLS)
    completion.set_defaults(act=lambda arguments: print_completion(parser, arguments.shell))

    on = commands.add_parser(
        "help",
        help="what a command does",
        description="Print what a command does, with an example.",
        epilog="Example: casadi-skin help run",
    )
    on.add_argument("verb", nargs="?", choices=tuple(commands.choices), metavar="COMMAND", help="default: all of them")
    on.set_defaults(act=lambda arguments: print_help(commands.choices.get(arguments.verb, parser)))


def print_help(parser: argparse.ArgumentParser) -> int:
    """Print the help of a parser."""
    parser.print_help()
    return DONE


def write_start(arguments: argparse.Namespace) -> int:
    """Write a scene to start from, with the Python file of a model; files that are there are not touched."""
    from importlib.resources import files

    from casadi_skin.model.files import replacing

    scene = arguments.out or Path(f"{arguments.kind}.toml")
    if scene.suffix != ".toml":
        raise InputError(f"new: given --out {scene}; accepted: a name that ends in .toml")
    names = {scene: f"{arguments.kind}.toml"}
    if arguments.kind == "model":
        names[scene.with_suffix(".py")] = "model.py"
    for path in names:
        if path.exists():
            raise InputError(f"new: {path} is there already; accepted: another --out")
        if not path.parent.is_dir():
            raise InputError(f"new: {path.parent} is no directory; accepted: --out in a directory that is there")
    for path, name in names.items():
        text = (files("casadi_skin.runs") / "starts" / name).read_text(encoding="utf-8")
        with replacing(path) as temporary:
            temporary.write_text(text.replace("NAME.py", scene.with_suffix(".py").name), encoding="utf-8")
    if not arguments.quiet:
        print(f"wrote {' and '.join(map(str, names))}; next: casadi-skin run {scene}")
    return DONE


def write_schema(arguments: argparse.Namespace) -> int:
    """Print the JSON schema of scenes, or write it into a file."""
    import json

    from casadi_skin.model.files import replacing
    from casadi_skin.runs.reading import scene_schema

    text = json.dumps(scene_schema(), indent=2)
    if arguments.out is None:
        print(text)
        return DONE
    if not arguments.out.parent.is_dir():
        raise InputError(f"schema: {arguments.out.parent} is no directory; accepted: --out in one that is there")
    with replacing(arguments.out) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")
    return DONE


def print_completion(parser: argparse.ArgumentParser, shell: str) -> int:
    """Print the completion of a parser for a shell."""
    import shtab

    for action in _paths(parser):
        action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
    sys.stdout.write(shtab.complete(parser, shell))
    return DONE


def _paths(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """The arguments of a parser and of its commands that are paths."""
    found = list[argparse.Action]()
    for action in parser._actions:
        if action.type is Path:
            found.append(action)
        if isinstance(action, argparse._SubParsersAction):
            found += [inner for command in action.choices.values() for inner in _paths(command)]
    return found
