"""Runs that a signal ends at a point of their own, however fast the machine is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from casadi_skin.cli import main
from casadi_skin.results.journal import Journal


def ended(number: int, records: int, scene: Path, out: Path) -> int:
    """Exit status of a run that gets a signal when its journal has some records."""
    left = iter(range(records - 1))
    append = Journal.append

    def count(self: Journal, record: object) -> None:
        append(self, record)  # type: ignore[arg-type]
        if next(left, None) is None:
            os.kill(os.getpid(), number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Journal, "append", count)
        return main(["run", str(scene), "--out", str(out), "--quiet"])


def killed(records: int, scene: Path, out: Path) -> int:
    """The same of a process that is killed."""
    code = f"from pathlib import *; from endings import ended; ended({signal.SIGKILL:d}, {records}, {scene!r}, {out!r})"
    return subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parent, check=False).returncode
