"""A directory in use is kept from other processes, for as long as its process lives and no longer."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from apart import Ended
from maps import TINY, write

from casadi_skin import run_map
from casadi_skin.runs.directory import DirectoryError, in_use

HOLD = """
import os, sys, time
from pathlib import Path
from casadi_skin.runs.directory import in_use
with in_use(Path(sys.argv[1]), print):
    if not os.fork():
        print("held", flush=True)
    time.sleep(100.0)
"""


def silent(words: str) -> None:
    raise AssertionError(words)


def taken(directory: Path, **how: object) -> bool:
    try:
        with in_use(directory, silent, **how):  # type: ignore[arg-type]
            return False
    except DirectoryError:
        return True


def test_one_process_alone_or_several_that_share(tmp_path: Path) -> None:
    directory = tmp_path / "new" / "out"
    with in_use(directory, silent):
        assert taken(directory)
        assert taken(directory, shared=True)
    assert not directory.exists()  # it was empty
    directory.mkdir(parents=True)
    with in_use(directory, silent, shared=True):
        assert taken(directory)
        with in_use(directory, silent, shared=True), in_use(directory, silent, part="3"):
            assert not taken(directory, part="2")
            assert taken(directory, part="3")
        assert taken(directory)
    assert not taken(directory)
    assert list(directory.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_process_that_is_killed_gives_it_back_whatever_it_has_forked(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdout=-1, text=True, start_new_session=True
    ) as held:
        assert held.stdout.readline() == "held\n"
        with pytest.raises(DirectoryError, match=f"process {held.pid} on .* computes in it; accepted: another"):
            in_use(tmp_path, silent).__enter__()
        os.kill(held.pid, signal.SIGKILL)
        held.wait()
        assert not taken(tmp_path)
        os.killpg(held.pid, signal.SIGKILL)  # what it has forked


@pytest.mark.parametrize("words", ["map", "map --overwrite", "map --part 1/2", "run --overwrite"])
def test_a_second_command_is_refused_and_changes_nothing(words: str, tmp_path: Path, cli: Callable[..., Ended]) -> None:
    scene, out, (command, *flags) = write(tmp_path, TINY), tmp_path / "out", words.split()
    out.mkdir()
    (out / "map.csv").touch()
    with in_use(out, silent):
        before = sorted(out.iterdir())
        assert cli(command, scene, "--out", out, *flags).line.startswith(
            f"casadi-skin: {out}: process {os.getpid()} on "
        )
        assert sorted(out.iterdir()) == before


def test_shares_are_shared_and_the_whole_map_is_not(tmp_path: Path) -> None:
    scene, out = write(tmp_path, TINY), tmp_path / "out"
    with in_use(out, silent, shared=True), in_use(out, silent, part="1"):
        for part, refused in ((None, "computes in it"), ((1, 2), "computes in it")):
            with pytest.raises(DirectoryError, match=refused):
                run_map(scene, out, part=part, quiet=True)
        with pytest.raises(DirectoryError, match="holds no map to collect"):
            run_map(scene, out, collect=True, quiet=True)


def test_a_lock_that_its_last_holder_removed_meanwhile_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between opening the file and locking it: what is locked then is a file that nobody else will find."""
    plainly, left = fcntl.flock, [1]

    def late(descriptor: int, how: int) -> None:
        if left:
            left.pop()
            next(tmp_path.iterdir()).unlink()
        plainly(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with in_use(tmp_path, silent):
        assert len(list(tmp_path.iterdir())) == 1
        assert taken(tmp_path)


def test_a_disk_without_locks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    told: list[str] = []
    keep: Callable[[str], None] = told.append
    with in_use(tmp_path, keep):
        pass
    assert told == [f"{tmp_path}: cannot be locked (No locks available): nothing else may compute in it meanwhile"]
