"""The command line as a program of its own: `casadi-skin`, `python -m casadi_skin`."""

from __future__ import annotations

import atexit
import os
import sys
from typing import NoReturn

from casadi_skin.runs.program import main


def program() -> NoReturn:
    """Run the command line and end the process, without taking apart what it holds: that took a tenth of a run."""
    status = list[int]()
    atexit.register(_leave, status)  # the first that is registered is called last, when all others have cleaned up
    try:
        status.append(main())
    except SystemExit as error:  # of argparse, which has printed why
        if isinstance(error.code, int):
            status.append(error.code)
        raise
    sys.exit(status[0])


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
