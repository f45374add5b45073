"""Output of a command: results as JSON, tables of text, the exit status, and streams whose faults are known.

Progress of long work on a terminal; silent elsewhere.
"""

from __future__ import annotations

import argparse
import errno
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from casadi_skin.model.methods import FORMATS

if TYPE_CHECKING:
    from rich.status import Status

    from casadi_skin.follow.solution import Solution

Value = float | int | str | None


def add_study_options(parser: argparse.ArgumentParser, default: Path) -> None:
    """Add the options that every study has: where its results go, and in which formats."""
    words = f"directory of the results (default: {default})"
    parser.add_argument("--out", type=Path, default=default, metavar="DIR", help=words)
    words = "format of its pictures, once for each that is wanted (default: png)"
    parser.add_argument("--format", action="append", dest="formats", choices=FORMATS, help=words)
    parser.add_argument("--overwrite", action="store_true", help="replace what DIR holds of the same")
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--quiet", action="store_true", help="print nothing but errors")
    either.add_argument("--json", action="store_true", help="print the results as JSON, and nothing else")


def print_json(value: object) -> None:
    """Print a value as JSON on one line; numbers that are not finite are refused, as JSON has none."""
    import json  # here: --help does not need it

    print(json.dumps(value, ensure_ascii=False, allow_nan=False))


def print_results(directory: Path, complete: bool, reasons: Sequence[str]) -> None:
    """Print the results that a run or a study has left in its directory.

    Arguments:
        directory: where its files are.
        complete: whether every requested result was found.
        reasons: why not, in a line each.
    """
    files = sorted(path.name for path in directory.iterdir() if not path.name.startswith("."))
    tables = {name.removesuffix(".csv"): _rows(directory / name) for name in files if name.endswith(".csv")}
    place = str(directory)
    print_json({"directory": place, "complete": complete, "reasons": list(reasons), "files": files, "tables": tables})


def _rows(path: Path) -> list[dict[str, Value]]:
    """The rows of a table; an empty cell is None."""
    import csv

    with path.open(encoding="utf-8", newline="") as file:
        return [{name: _value(cell) for name, cell in row.items()} for row in csv.DictReader(file)]


def _value(cell: str) -> Value:
    """A cell as the number it is, or as text."""
    for kind in (int, float):
        try:
            value: float = kind(cell)
        except ValueError:
            continue
        return value if abs(value) < float("inf") else cell
    return cell or None


# Tables on standard output, without the time that a library for terminals takes to load -------------------------------

BOLD, PLAIN = "\033[1m", "\033[0m"


def print_table(title: str | None, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a title, and columns of cells, right-justified; names are bold on a terminal, cells left out are empty."""
    whole = [columns, *([*row, *[""] * (len(columns) - len(row))] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
    lines = [" " + "  ".join(map(str.rjust, row, widths)).rstrip() for row in whole]
    names = f"{BOLD}{lines[0]}{PLAIN}" if sys.stdout.isatty() else lines[0]
    print(*([title] if title else []), names, *lines[1:], sep="\n")


# Exit status of commands, and wrong input -----------------------------------------------------------------------------

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
MOST_REASONS = 5  # that are printed
LINE_BEGIN, LINE_END = 500, 300  # characters of a line that is printed; what is between them is left out


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line."""


def complain(*reasons: str) -> None:
    """Print reasons on standard error: the first few, each in one line of a length that can be read.

    Characters that would command a terminal, as a name may hold, are shown as Python writes them.
    """
    for reason in reasons[:MOST_REASONS]:
        line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(reason.split()))
        fits = len(line) <= LINE_BEGIN + LINE_END
        print(line if fits else f"{line[:LINE_BEGIN]} ... {line[-LINE_END:]}", file=sys.stderr)
    if len(reasons) > MOST_REASONS:
        print(f"casadi-skin: {len(reasons) - MOST_REASONS} more reasons of this kind; --json has all", file=sys.stderr)


def exit_status(act: Callable[[], int]) -> int:
    """The exit status of a command; where it ends in an error, that is reported in one line on standard error."""
    try:
        return act()
    except InputError as error:
        complain(f"casadi-skin: {error}")
        return WRONG_INPUT
    except KeyboardInterrupt:
        complain("casadi-skin: interrupted")
        return INTERRUPTED
    except OSError as error:
        complain(f"casadi-skin: {error.filename or 'a file'}: {error.strerror or error}")
        return FAILED


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


# Names and values in the lines that `check` prints --------------------------------------------------------------------

Lines = list[tuple[str, str]]  # pairs (subject, text)
MOST_WORDS = 16  # that a line of the plan lists


def named(values: Mapping[str, float]) -> str:
    """Names and values, one after the other."""
    return listed([f"{name} = {value:g}" for name, value in values.items()])


def listed(words: Sequence[str]) -> str:
    """Words one after the other; of many the first and the last."""
    if len(words) <= MOST_WORDS:
        return ", ".join(words)
    return f"{', '.join(words[:2])}, ..., {words[-1]} ({len(words)} in all)"


# Progress of long work on a terminal; silent elsewhere ----------------------------------------------------------------


class Progress:
    """One line on standard error with the place on a branch, points and step; only on a terminal and unless `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet, self.on_terminal = quiet, not quiet and sys.stderr.isatty()
        self._status: Status | None = None
        if self.on_terminal:  # rich takes time to load
            from rich.console import Console

            self._status = Console(stderr=True).status("building", spinner="line")

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the line off the terminal."""
        if self._status is not None:
            self._status.stop()

    def solution(self, solution: Solution, points: int) -> None:
        """Show that a solution has been reached, with its number on the branch."""
        if self._status is not None:
            self._status.update(f"{_place(solution)}, {points} points, step {solution.point.step:.2g}")

    def report(self, words: str) -> None:
        """Leave a line on standard error, unless quiet."""
        if not self._quiet:
            complain(f"casadi-skin: {words}")

    def say(self, words: str) -> None:
        """Show the present step."""
        if self._status is not None:
            self._status.update(words)


def _place(solution: Solution) -> str:
    """Place of a solution on its branch, and the end of the branch."""
    space: Any = solution.space
    if space.is_family:
        S, end = space.value("S", solution.point), space.request.amplitude_max
        return f"j = {space.coordinates.mode_number}: S = {S:.6g} of {end:g}"
    if space.parameter:
        return f"{space.parameter} = {solution.parameters[space.parameter]:.6g} on the way to {space.to:g}"
    return "solved"
