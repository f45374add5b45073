"""The command line: words -> a scene, a study."""

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
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TextIO

from casadi_skin._version import __version__
from casadi_skin.runs import explore_command, map_command, start_commands
from casadi_skin.runs.output import FAILED, WRONG_INPUT, add_output, add_study_options, exit_status

# Standard output and error of a command: faults of the first end it in one line, those of the second are nothing ------


class OutputError(Exception):
    """Standard output cannot be written; the message says why."""


class _Stream:
    """A stream whose faults are raised as OutputError, or forgotten; None is one that is closed."""

    def __init__(self, stream: TextIO | None, forgiving: bool = False) -> None:
        self._stream, self._forgiving = stream, forgiving

    def write(self, text: str) -> int:
        try:
            if self._stream is None:
                raise OSError(errno.EBADF, "it is closed")
            return self._stream.write(text)
        except (OSError, ValueError) as error:  # ValueError: closed since
            self._fault(error)
            return len(text)

    def flush(self) -> None:
        try:
            if self._stream is not None:
                self._stream.flush()
        except (OSError, ValueError) as error:
            self._fault(error)

    def _fault(self, error: OSError | ValueError) -> None:
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


RARELY = (200_000, 20, 50)  # thresholds of the collector: modules live to the end, and a picture is 20,000 objects


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
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser(
        "run",
        help="compute what a scene asks for",
        description="Compute what a scene asks for.",
        epilog="Example: casadi-skin run examples/softening_end_breather.toml --out results/breather",
    )
    run.add_argument("scene", type=Path, metavar="SCENE.toml")
    run.add_argument(
        "--out", type=Path, metavar="DIR", help="directory of the results (default: results/NAME-OF-THE-SCENE)"
    )
    held = run.add_mutually_exclusive_group()
    held.add_argument(
        "--resume", action="store_true", help="go on with a run that was killed, interrupted or ended early"
    )
    held.add_argument("--overwrite", action="store_true", help="replace the results that DIR holds")
    add_output(run)
    run.set_defaults(act="scene_commands:run")

    check = commands.add_parser(
        "check",
        help="print the plan of a scene",
        description="Print what a run would do.",
        epilog="Example: casadi-skin check examples/fput_modes.toml",
    )
    check.add_argument("scene", type=Path, metavar="SCENE.toml")
    check.add_argument(
        "--measure", action="store_true", help="build and solve at the start of families too: unknowns, expected cost"
    )
    add_output(check)
    check.set_defaults(act="scene_commands:check")

    spectrum = commands.add_parser(
        "spectrum",
        help="linear frequencies of a scene's model",
        description="Print the linear frequencies omega_j.",
        epilog="Example: casadi-skin spectrum examples/fput_modes.toml --out results/spectrum",
    )
    spectrum.add_argument("scene", type=Path, metavar="SCENE.toml")
    spectrum.add_argument("--out", type=Path, metavar="DIR", help="also write spectrum.csv and its picture there")
    spectrum.add_argument("--overwrite", action="store_true", help="replace the results that DIR holds")
    add_output(spectrum)
    spectrum.set_defaults(act="scene_commands:spectrum")

    map_command.add_map(commands)
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
    add_study_options(work, Path("results/tradeoff"))
    work.set_defaults(act="tradeoff:run")

    explore_command.add_explore(commands)
    start_commands.add_first_steps(commands, parser)
    return parser


def _interrupt(number: int, frame: FrameType | None) -> None:
    """A polite kill ends a run like Ctrl-C: the results so far are written."""
    raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    before = gc.get_threshold()
    gc.set_threshold(*RARELY)
    try:
        with guarded_streams():
            return _status(arguments)
    except OutputError as error:
        _complain(f"standard output: {error}")
        return FAILED
    finally:
        gc.set_threshold(*before)


def _status(arguments: Sequence[str] | None) -> int:
    """Exit status of a command that has reported its reason."""
    parsed, unknown = _parser().parse_known_args(arguments)
    if unknown:
        _Parser(prog=f"casadi-skin {parsed.command}").error(f"unrecognized arguments: {' '.join(unknown)}")
    signal.signal(signal.SIGTERM, _interrupt)
    return exit_status(lambda: _act_of(parsed)(parsed))


def _act_of(parsed: argparse.Namespace) -> Callable[[argparse.Namespace], int]:
    """What a command does; its module is loaded when it is wanted."""
    if callable(parsed.act):
        return parsed.act  # type: ignore[no-any-return]
    module, name = parsed.act.split(":")
    return getattr(import_module(f"casadi_skin.runs.{module}"), name)  # type: ignore[no-any-return]


def _complain(words: str) -> None:
    """A line on standard error, if it can be written."""
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(f"casadi-skin: {words}\n")


if __name__ == "__main__":
    sys.exit(main())
