"""Programs in a process of their own, and runs that a signal ends at a point of their own, however fast the machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from casadi_skin.results.store import Journal
from casadi_skin.runs.program import main
from casadi_skin.solve.processes import Worker

BLANK = "import pytest; from drawing import blank_pictures; blank_pictures(pytest.MonkeyPatch())\n"


def program(code: str) -> subprocess.Popen[str]:
    """Python code with the modules of this folder, started."""
    command = [sys.executable, "-c", code]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=Path(__file__).parent, stdout=pipe, stderr=pipe, text=True)


def undrawn(*arguments: object) -> subprocess.Popen[str]:
    """casadi-skin with these arguments, started; its pictures stay blank."""
    words = [str(argument) for argument in arguments]
    return program(f"{BLANK}from casadi_skin.runs.program import main\nraise SystemExit(main({words!r}))")


def modules_of_a_run(scene: Path, out: Path) -> set[str]:
    """What a run of a scene has imported when it ends; its pictures stay blank."""
    return modules_of("run", str(scene), "--out", str(out), before=BLANK)


def modules_of(*words: str, before: str = "") -> set[str]:
    """What casadi-skin with these arguments has imported when it ends."""
    code = f"import sys\nfrom casadi_skin.runs.program import main\nassert main({words!r}) == 0\nprint(*sys.modules)"
    process = program(before + code)
    printed, error = process.communicate()
    assert process.returncode == 0, error
    return set(printed.splitlines()[-1].split())


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
    process = program(
        f"from pathlib import *; from apart import ended; ended({signal.SIGKILL:d}, {records}, {scene!r}, {out!r})"
    )
    process.communicate()
    return process.returncode


class Ended(NamedTuple):
    """How a command ended, and what it said."""

    status: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """What is on standard error where input is wrong: one line."""
        assert (self.status, self.err.count("\n")) == (2, 1)
        return self.err


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Runs casadi-skin with some words in this process."""

    def run(*words: object) -> Ended:
        capsys.readouterr()
        try:
            status = main([str(word) for word in words])
        except SystemExit as stop:  # of argparse
            status = int(stop.code or 0)
        return Ended(status, *capsys.readouterr())

    return run


def killing(monkeypatch: pytest.MonkeyPatch, times: int) -> list[Worker]:
    """The worker that is killed so many times as it is about to answer; grows by one each time."""
    answer, killed = Worker._answer, list[Worker]()

    def kill(self: Worker, *options: Any) -> Any:
        if self.process is not None and len(killed) < times and self in (killed or [self]):
            killed.append(self)
            self.process.kill()
        return answer(self, *options)

    monkeypatch.setattr(Worker, "_answer", kill)
    return killed
