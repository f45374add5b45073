"""Signals at any time: a run ends with what was computed in its files, and a signal is never lost."""

from __future__ import annotations

import os
import signal
import time
from typing import Any

import pytest
from scenes import Runs, chain, family

from casadi_skin.model.interrupts import ended_by_signals, interrupts_deferred
from casadi_skin.results.store import Journal
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.output import complain

pytestmark = pytest.mark.usefixtures("blank", "interruptible")
SCENE = chain(3) + family([1, 3]) + '[accuracy]\npreset = "draft"\n'


def forever() -> None:
    """Goes on until something is raised, and not for ever in a test that fails."""
    for _ in range(5000):
        time.sleep(0.001)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_signal_that_ends_programs_ends_a_run_with_its_files(
    number: signal.Signals, run: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    append, left = Journal.append, iter(range(8))

    def keep(self: Any, record: Any) -> None:
        append(self, record)
        if next(left, None) == 7:
            os.kill(os.getpid(), number)

    run(SCENE, "--quiet")
    whole = [(run.out / name).read_bytes() for name in ("family.csv", "family.nc")]
    monkeypatch.setattr(Journal, "append", keep)
    told = run("", "--quiet", "--overwrite", status=130).err
    assert told.count("\n") == 1
    assert "go on with --resume" in told
    assert 5 < len(run.rows("family")) < 9
    assert {"family.nc", "journal.msgpack"} <= run.files
    run("", "--resume", "--quiet")
    assert [(run.out / name).read_bytes() for name in ("family.csv", "family.nc")] == whole


def test_a_signal_that_is_lost_is_raised_again(run: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where CasADi converts arguments: the interruption becomes an error of another kind, or none."""
    show, lost = Branches.show, list[str]()

    def losing(self: Any, *arguments: Any) -> None:
        for k in range(0 if lost else 3):
            try:
                forever() if k else os.kill(os.getpid(), signal.SIGTERM)
            except KeyboardInterrupt:
                lost.append("once more")
        show(self, *arguments)

    monkeypatch.setattr("casadi_skin.runs.run.Run.show", losing)
    run(SCENE, "--quiet", status=130)
    assert len(lost) == 3


def test_cleaning_up_after_a_signal_is_not_interrupted_by_that_signal() -> None:
    done = list[str]()

    @ended_by_signals()
    def ended() -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            forever()
        finally:
            with interrupts_deferred():
                time.sleep(0.03)  # it is raised again meanwhile
            try:
                raise ValueError
            except ValueError:
                time.sleep(0.03)
            done.append("cleaned up")

    with pytest.raises(KeyboardInterrupt):
        ended()
    assert done
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_second_signal_of_the_user_ends_what_cleans_up() -> None:
    @ended_by_signals()
    def ended() -> None:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            forever()
        finally:
            with interrupts_deferred():
                time.sleep(0.03)
                os.kill(os.getpid(), signal.SIGINT)
                forever()

    with pytest.raises(KeyboardInterrupt):
        ended()


def test_reasons_are_a_few_lines_that_can_be_read(capsys: pytest.CaptureFixture[str]) -> None:
    complain(*(f"scene: {'much ' * 400}\nand more {k}" for k in range(9)))
    *reasons, last = capsys.readouterr().err.splitlines()
    assert [(reason[:7], reason[-10:], len(reason) < 900) for reason in reasons] == [
        ("scene: ", f"and more {k}"[-10:], True) for k in range(5)
    ]
    assert last.startswith("casadi-skin: 4 more reasons")


def test_a_program_that_is_told_to_ignore_a_hangup_goes_on(run: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    append = Journal.append
    monkeypatch.setattr(Journal, "append", lambda *given: (append(*given), os.kill(os.getpid(), signal.SIGHUP)))
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    run(SCENE, "--quiet")
