"""The command line: its commands and their options as a table, and standard streams whose faults are known."""

from __future__ import annotations

import argparse
import errno
import gc
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, NoReturn, TextIO

from casadi_skin._version import __version__
from casadi_skin.runs.output import FAILED, WRONG_INPUT, add_study_options, exit_status

# Standard output and error of a command: faults of the first end it in one line, those of the second are nothing ------


class OutputError(Exception):
    """Standard output cannot be written; the message says why."""


class _Stream:
    """A stream whose faults are raised as OutputError, or forgotten; None is one that is closed."""

    def __init__(self, stream: TextIO | None, forgiving: bool = False) -> None:
        self._stream, self._forgiving = stream, forgiving

    def write(self, text: str) -> int:
        self._call("write", text)
        return len(text)

    def flush(self) -> None:
        self._call("flush")

    def _call(self, name: str, *arguments: str) -> None:
        try:
            if self._stream is not None:
                getattr(self._stream, name)(*arguments)
            elif arguments:
                raise OSError(errno.EBADF, "it is closed")
        except (OSError, ValueError) as error:  # ValueError: closed since
            if not self._forgiving:
                raise OutputError(getattr(error, "strerror", None) or str(error)) from error

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Standard streams whose faults are known, without warnings of other packages, inside the block.

    Raises OutputError where something that was printed cannot be written.
    """
    _fill_descriptors()
    output, error = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Stream(output), _Stream(error, forgiving=True)
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:  # users can enable them in Python
                warnings.simplefilter("ignore")
            yield
        sys.stdout.flush()
    except OutputError:
        _discard(output)
        raise
    finally:
        sys.stdout, sys.stderr = output, error


def _fill_descriptors() -> None:
    """Open the standard descriptors that are closed, or a file of results would take their place and be printed to."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def _discard(stream: TextIO | None) -> None:
    """Discard the rest of a stream, or Python would try again, and fail, when it ends."""
    try:
        if stream is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):  # a stream without a file, as in tests
        return


COLLECTOR_THRESHOLDS = (200_000, 20, 50)  # modules live to the end, and a picture is 20,000 objects

# The commands: what each is for, an example, and its options; options of which one may be given stand in one list --


Option = tuple[str, dict[str, Any]]  # a name, and what argparse takes with it


def switch(name: str, words: str) -> Option:
    """An option that is there or not."""
    return name, {"action": "store_true", "help": words}


def value(name: str, words: str | None, metavar: str | None, kind: Callable[[str], object], **more: object) -> Option:
    """An option or an argument with a value."""
    return name, {"type": kind, "help": words, **({} if metavar is None else {"metavar": metavar}), **more}


class Command(NamedTuple):
    """A command: what it does, an example, and its options."""

    words: str
    example: str
    options: Sequence[Sequence[Option]]


SCENE = [value("scene", None, "SCENE.toml", Path)]
OUT = [value("--out", "directory of the results (default: results/NAME-OF-THE-SCENE)", "DIR", Path)]
OVERWRITE = switch("--overwrite", "replace the results that DIR holds")
QUIET = switch("--quiet", "print nothing but errors")
OUTPUT = [QUIET, switch("--json", "print the results as JSON, and nothing else")]
MEASURED = (
    "scene whose family is measured, the first of several; its accuracy and methods do not matter "
    "(default: j = 1, g = -1, N = 24 to S = 1)"
)
PAGE = "the file (default: DIR/explore.html, beside a file its name with .html)"
COMMANDS = {
    "run": Command(
        "Compute what a scene asks for.",
        "casadi-skin run examples/softening_end_breather.toml --out results/breather",
        [SCENE, OUT, [switch("--resume", "go on with a run that was killed, interrupted or ended early"), OVERWRITE],
         OUTPUT],
    ),
    "check": Command(
        "Print what a run would do.",
        "casadi-skin check examples/fput_modes.toml",
        [SCENE, [switch("--measure", "build and solve at the start of families too: unknowns, expected cost")], OUTPUT],
    ),
    "spectrum": Command(
        "Print the linear frequencies omega_j of a scene's model.",
        "casadi-skin spectrum examples/fput_modes.toml --out results/spectrum",
        [SCENE, [value("--out", "also write spectrum.csv and its picture there", "DIR", Path)], [OVERWRITE], OUTPUT],
    ),
    "map": Command(
        "Compute a scene over one or two of its parameters, cell by cell, on one machine or many.",
        "casadi-skin map examples/stability_chart.toml --workers 2",
        [SCENE, OUT, [value("--workers", "processes on this machine (default: 1)", "N", int, default=1)],
         [value("--scheduler", "a dask scheduler, whose workers compute the cells", "ADDRESS", str),
          value("--part", "one share of a batch array; whoever comes last joins them", "K/N", str),
          switch("--collect", "join what all shares have; compute nothing")],
         [switch("--resume", "compute what is missing of a map that was begun"), OVERWRITE],
         [switch("--no-pictures", "tables alone")], OUTPUT],
    ),
    "tradeoff": Command(
        "Measure time, memory and true errors of every method and tolerance on one family.",
        "casadi-skin tradeoff examples/softening_end_breather.toml --quick",
        [[value("scene", MEASURED, "SCENE.toml", Path, nargs="?")],
         [switch("--quick", "three tolerances, each timed once")],
         [value("--repeats", "timed runs of each setting (default: 5; 1 if quick)", "K", int)]],
    ),
    "explore": Command(
        "Write one HTML file that shows a run, a map, or a branch or diagram that was saved, without network.",
        "casadi-skin explore results/chain",
        [[value("directory", "the directory of a run or of a map, or a file of one", "DIR", Path)],
         [value("--out", PAGE, "FILE.html", Path)], [QUIET]],
    ),
    "new": Command(
        "Write a scene of a chain, a lattice or a model, with a comment on every line, that runs as it is.",
        "casadi-skin new chain --out breather.toml",
        [[value("kind", "what the scene is of; a model comes with its Python file", None, str,
                choices=("chain", "lattice", "model"))],
         [value("--out", "the file (default: KIND.toml)", "SCENE.toml", Path)], [QUIET]],
    ),
    "schema": Command(
        "Print the JSON schema of scenes; editors complete and check scenes with it.",
        "casadi-skin schema --out scene.schema.json",
        [[value("--out", "write it there in place of printing it", "FILE.json", Path)]],
    ),
    "completion": Command(
        "Print what a shell needs to complete commands, options and files.",
        'eval "$(casadi-skin completion bash)"',
        [[value("shell", None, None, str, choices=("bash", "zsh", "tcsh"))]],
    ),
}  # fmt: skip
COMMANDS["help"] = Command(
    "Print what a command does, with an example.",
    "casadi-skin help run",
    [[value("verb", "default: all of them", "COMMAND", str, nargs="?", choices=(*COMMANDS, "help"))]],
)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        words = " ".join(message.split())
        choice = re.fullmatch(r"argument (\S+): invalid choice: '(.*)' \(choose from (.*)\)", words)
        if choice is not None:
            from casadi_skin.model.arguments import accepted_names

            known = [name.strip("'") for name in choice[3].split(", ")]
            words = f"{choice[1]}: given '{choice[2]}'; {accepted_names(choice[2], known)}"
        self.exit(WRONG_INPUT, f"{self.prog}: {words}; see {self.prog} --help\n")


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
        "early, 2 wrong input, 130 interrupted.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version, and which kernels are in use")
    added = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        purpose = f"{command.words[0].lower()}{command.words[1:-1]}"
        one = added.add_parser(name, help=purpose, description=command.words, epilog=f"Example: {command.example}")
        for options in command.options:
            group = one if len(options) == 1 else one.add_mutually_exclusive_group()
            for option, given in options:
                group.add_argument(option, **given)
    add_study_options(added.choices["tradeoff"], Path("results/tradeoff"))
    parser.set_defaults(parser=parser, parsers=added.choices)
    return parser


def _interrupt(number: int, frame: FrameType | None) -> None:
    """A polite kill ends a run like Ctrl-C: the results so far are written."""
    raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    before = gc.get_threshold()
    gc.set_threshold(*COLLECTOR_THRESHOLDS)
    try:
        with guarded_streams():
            return _status(arguments)
    except OutputError as error:
        with suppress(OSError, ValueError, AttributeError):  # standard error may be closed, too
            sys.stderr.write(f"casadi-skin: standard output: {error}\n")
        return FAILED
    finally:
        gc.set_threshold(*before)


def _status(arguments: Sequence[str] | None) -> int:
    """Exit status of a command that has reported its reason."""
    parsed, unknown = _parser().parse_known_args(arguments)
    if unknown:
        _Parser(prog=f"casadi-skin {parsed.command}").error(f"unrecognized arguments: {' '.join(unknown)}")
    signal.signal(signal.SIGTERM, _interrupt)
    from casadi_skin.runs.commands import ACTS  # here: --help needs none of it

    return exit_status(lambda: ACTS[parsed.command](parsed))


if __name__ == "__main__":
    sys.exit(main())
