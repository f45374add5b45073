"""Studies: a directory to which tables and pictures are written as results arrive, a report, and a command.

`casadi-skin tradeoff` is one; the paper's figures (examples/paper) and the studies of the tests are programs of their
own, by `study_program`.
"""

from __future__ import annotations

import argparse
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, TypeVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from casadi_skin.model.files import replacing
from casadi_skin.results.dataset import write_csv
from casadi_skin.results.figures.style import save
from casadi_skin.results.quantities import Cell
from casadi_skin.runs.directory import prepare_study
from casadi_skin.runs.output import DONE, FAILED, INTERRUPTED, Progress, add_study_options, exit_status, print_results

Case = TypeVar("Case")


@dataclass
class Study(ABC):
    """A study that writes into `directory`; `say` is called with each step, `files` are those written so far."""

    directory: Path
    say: Callable[[str], None] = field(default=lambda words: None, kw_only=True)
    formats: Sequence[str] = field(default=("png",), kw_only=True)  # of pictures
    files: list[Path] = field(default_factory=list, kw_only=True)
    done: int = field(default=0, kw_only=True)  # parts of the study, as `part` calls them, that are finished

    part: ClassVar[str] = "cases"

    @abstractmethod
    def run(self) -> None:
        """Compute everything, and write it as it becomes known, also where KeyboardInterrupt ends the study.

        Raises:
            ArithmeticError: The study cannot go on.
        """

    @abstractmethod
    def report(self) -> Iterable[str]:
        """The results in lines, below the tables."""

    def tables(self) -> Iterable[Table]:
        """The results in tables for the terminal; none unless the study has some."""
        return ()

    @property
    def faults(self) -> Sequence[object]:
        """Faults of the study; empty where there are none."""
        return ()

    def work_through(self, cases: Sequence[Case], words: Callable[[Case], str], work: Callable[[Case], None]) -> None:
        """Do the work of one case after the other, and count those that are done."""
        for number, case in enumerate(cases, start=1):
            self.say(f"{words(case)} ({number} of {len(cases)})")
            work(case)
            self.done = number

    # Files ----------------------------------------------------------------------------------------------------------

    def write_table(self, stem: str, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
        """Replace STEM.csv; see `cell`."""
        path = self.directory / f"{stem}.csv"
        write_csv(path, columns, ({name: cell(row.get(name)) for name in columns} for row in rows))
        self._written([path])

    def write_text(self, name: str, text: str) -> None:
        """Replace a text file."""
        path = self.directory / name
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        self._written([path])

    def write_figure(self, stem: str, figure: Figure) -> None:
        """Replace STEM.png, or the files of other `formats`."""
        self._written(save(figure, self.directory / stem, self.formats))

    def _written(self, paths: Iterable[Path]) -> None:
        self.files += [path for path in paths if path not in self.files]


def cell(value: object) -> Cell:
    """A cell of a table: empty for None and nan, 0 or 1 for a truth value."""
    if value is None or value != value:
        return ""
    if isinstance(value, bool):
        return int(value)
    finite = isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))
    return value if finite else str(value)  # type: ignore[return-value]


def letter(axes: Axes, name: str, words: str = "") -> None:
    """The panel's letter and a few words above it, at the left."""
    axes.set_title(f"({name})  {words}".rstrip(), loc="left")


# The command of a study ---------------------------------------------------------------------------------------------


def study_program(
    parser: argparse.ArgumentParser,
    default: Path,
    study_of: Callable[[argparse.Namespace], Study],
    arguments: Sequence[str] | None = None,
) -> int:
    """Run a study as a program of its own.

    Arguments:
        parser: holds what this study alone can be asked for.
        default: directory of the results unless one is given.
        study_of: the study of parsed arguments; raises InputError where they are wrong.
        arguments: words of the command line; those of this process unless given.

    Returns:
        The exit status: 0 done, 1 a fault of the study, 2 wrong input, 130 interrupted.
    """
    add_study_options(parser, default)
    parsed = parser.parse_args(arguments)
    return exit_status(lambda: run_study(study_of(parsed), parsed))


def run_study(study: Study, arguments: argparse.Namespace) -> int:
    """Run a study with the options of `add_study_options`, show its report, and return the exit status."""
    study.formats = arguments.formats or study.formats
    prepare_study(study.directory, arguments.overwrite)
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

    for table in study.tables():
        Console().print(table)
    print(*study.report(), f"{study.done} {study.part}; {len(study.files)} files in {study.directory}", sep="\n")
