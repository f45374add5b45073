"""The command line as a program of its own: `casadi-skin`, `python -m casadi_skin`.

It has the last handler: an error that no command expects, also one of an import, is a line, and no traceback.
"""

from __future__ import annotations

import atexit
import os
import sys
import traceback
from contextlib import suppress
from importlib import import_module
from typing import NoReturn

FAILED, INTERRUPTED = 1, 130  # as in `runs.output`, which may be what cannot be imported
TRACEBACK_VARIABLE = "CASADI_SKIN_TRACEBACK"  # names the file that the traceback of an unexpected error goes to
MOST_CHARACTERS = 300  # of the words of such an error


def program() -> NoReturn:
    """Run the command line and end the process, without taking apart what it holds: that took a tenth of a run."""
    status = list[int]()
    atexit.register(_leave, status)  # the first that is registered is called last, when all others have cleaned up
    try:
        status.append(import_module("casadi_skin.runs.program").main())
    except SystemExit as error:  # of argparse, which has printed why
        if isinstance(error.code, int):
            status.append(error.code)
        raise
    except KeyboardInterrupt:  # before a command begins
        status.append(_told("interrupted", INTERRUPTED))
    except BaseException as error:
        status.append(_told(_last_words(error), FAILED))
    sys.exit(status[0])


def _told(words: str, status: int) -> int:
    with suppress(OSError, ValueError, AttributeError):  # standard error may be closed
        sys.stderr.write(f"casadi-skin: {words}\n")
    return status


def _last_words(error: BaseException) -> str:
    """An unexpected error in one line, and where its traceback is."""
    cause = error
    while cause.__cause__ is not None:  # numpy's own words on an import that failed do not say why
        cause = cause.__cause__
    words = " ".join(f"{type(cause).__name__}: {cause}".split()).removesuffix(":")[:MOST_CHARACTERS]
    file = os.environ.get(TRACEBACK_VARIABLE)
    if not file:
        return f"unexpected error: {words}; {TRACEBACK_VARIABLE}=FILE keeps its traceback"
    try:
        with open(file, "w", encoding="utf-8", errors="backslashreplace") as kept:
            traceback.print_exception(error, file=kept)
    except OSError as fault:
        return f"unexpected error: {words}; its traceback: {file}: {fault.strerror}"
    return f"unexpected error: {words}; its traceback is in {file}"


def _leave(status: list[int]) -> None:
    """End the process at once; a command that raised, or whose output is not taken, ends as Python ends it."""
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError, AttributeError):
        return
    if status:
        os._exit(status[0])


if __name__ == "__main__":
    program()
