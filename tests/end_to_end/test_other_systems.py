"""Commands and calls where POSIX's names are missing, as on Windows: with the numbers that they have where these are.

`tests/other_system` says what is taken away. Windows itself runs in the workflows of the host.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from apart import Ended
from maps import TINY, write
from scenes import chain, family, table

ROOT = Path(__file__).parents[2]
FAMILIES = chain(12) + family([1, 2, 3, 4, 5], 2.0) + table("stability")
FORBIDDEN = set('<>:"/\\|?*')  # in names of files on Windows
ODE = """
import casadi as ca, numpy as np
from pathlib import Path
from casadi_skin import OdeModel, export_c, find_equilibrium, read_result
from casadi_skin.export.codegen import build_c

if __name__ == "__main__":
    x, y, p = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("p")
    model = OdeModel("hopf", ca.vertcat(x, y), ca.vertcat(p*x - y - x*(x**2 + y**2), x + p*y - y*(x**2 + y**2)), p)
    branch = find_equilibrium(model, [0.0, 0.0], parameters={"p": -0.5}).follow("p", 0.5)
    (point,) = branch.special_points
    cycles = point.follow("p", 0.2)
    out = Path(OUT)
    cycles.save(out / "cycles.json")
    again = read_result(out / "cycles.json")
    assert np.array_equal(again["period"], cycles["period"])
    export_c(model, out / "c")
    build_c(out / "c")
    print(point.parameters["p"], cycles["period"][-1] / (2.0 * np.pi))
"""
FOLDER = """
import os, sys
from casadi_skin.model.files import TemporaryFolder
folder = TemporaryFolder("casadi_skin_try_")
(folder.path / "file").touch()
print(folder.path, flush=True)
os.kill(os.getpid(), 9)
"""
USE = """
import sys, time
from pathlib import Path
from casadi_skin.runs.directory import DirectoryError, in_use
try:
    with in_use(Path(OUT), print, shared=SHARED):
        print("has it", flush=True)
        sys.stdin.read()
except DirectoryError as error:
    print(error)
"""


def started(*words: object) -> subprocess.Popen[str]:
    """Python with these words, without POSIX's names; text that it prints is that of a console of Windows."""
    paths = os.pathsep.join([str(ROOT / "tests" / "other_system"), str(ROOT)])
    env = {**os.environ, "PYTHONPATH": paths, "PYTHONWARNDEFAULTENCODING": "1", "PYTHONIOENCODING": "cp1252"}
    pipe = subprocess.PIPE
    command = [sys.executable, *map(str, words)]
    return subprocess.Popen(command, env=env, stdin=pipe, stdout=pipe, stderr=pipe, encoding="cp1252")


def elsewhere(*words: object, status: int = 0) -> Ended:
    """What casadi-skin does with these words there."""
    process = started("-m", "casadi_skin", *words)
    done = Ended(0, *process.communicate(timeout=300))._replace(status=process.returncode)
    assert done.status == status, done.err
    return done


def program(code: str, **values: object) -> str:
    """What a program prints there."""
    process = started("-c", "".join(f"{name} = {value!r}\n" for name, value in values.items()) + code)
    printed, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    return printed


def same_files(one: Path, other: Path, *names: str) -> None:
    for name in names:
        assert (one / name).read_bytes() == (other / name).read_bytes()
    assert {path.name for path in one.iterdir()} == {path.name for path in other.iterdir()}
    assert not any(FORBIDDEN & set(path.name) for path in one.rglob("*"))


def test_posix_is_missing(tmp_path: Path) -> None:
    """Else the tests below would assert nothing."""
    code = """
import importlib, os, signal, subprocess
for name in ("fcntl", "resource", "pwd"):
    try:
        importlib.import_module(name)
        print("has", name)
    except ImportError:
        continue
print([name for name in ("fork", "getuid", "killpg", "pwrite", "O_NOFOLLOW") if hasattr(os, name)])
print([name for name in ("SIGALRM", "SIGHUP", "SIGKILL", "setitimer", "pthread_sigmask") if hasattr(signal, name)])
for change in (lambda: os.unlink(FILE), lambda: os.replace(OTHER, FILE), lambda: subprocess.Popen(["/bin/sh"])):
    with open(FILE, "w", encoding="utf-8"), open(OTHER, "w", encoding="utf-8"):
        pass
    held = open(FILE, encoding="utf-8")
    try:
        change()
    except OSError as error:
        print(type(error).__name__)
    held.close()
"""
    printed = program(code, FILE=str(tmp_path / "file"), OTHER=str(tmp_path / "other"))
    assert printed.split("\n") == ["[]", "[]", "PermissionError", "PermissionError", "FileNotFoundError", ""]


def test_an_ode_is_followed_saved_read_and_exported(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(f"OUT = {str(tmp_path)!r}\n{ODE}", encoding="utf-8")
    process = started(script)
    printed, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    p, turns = map(float, printed.split())
    assert abs(p) < 1e-9
    assert turns == pytest.approx(1.0, abs=1e-9)  # the period of r' = p r - r^3, phi' = 1
    assert (tmp_path / "c" / "main").is_file()


def test_a_folder_goes_with_a_process_that_is_killed() -> None:
    process = started("-c", FOLDER)
    folder = Path(process.communicate(timeout=60)[0].strip())
    assert process.returncode == -signal.SIGKILL
    assert folder.name.startswith("casadi_skin_try_")
    deadline = time.monotonic() + 20.0
    while folder.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not folder.exists()


@pytest.mark.parametrize(("first", "second"), [(False, False), (False, True), (True, False), (True, True)])
def test_a_directory_is_kept_from_others(first: bool, second: bool, tmp_path: Path) -> None:
    holder = started("-c", f"OUT, SHARED = {str(tmp_path)!r}, {first}\n{USE}")
    assert holder.stdout.readline() == "has it\n"
    printed = program(USE, OUT=str(tmp_path), SHARED=second)
    assert printed == "has it\n" if first and second else f"process {holder.pid} on " in printed
    holder.communicate(timeout=60)
    assert program(USE, OUT=str(tmp_path), SHARED=second) == "has it\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_run_of_the_readme(tmp_path: Path, cli: Callable[..., Ended]) -> None:
    scene = ROOT / "examples" / "softening_end_breather.toml"
    assert "N = 24" in elsewhere("check", scene).out
    assert "changes" in elsewhere("run", scene, "--out", tmp_path / "there").out
    assert cli("run", scene, "--out", tmp_path / "here", "--quiet").status == 0
    same_files(tmp_path / "there", tmp_path / "here", "family.csv", "events.csv", "tongues.csv")


@pytest.mark.slow
def test_a_map_by_two_workers_and_in_two_shares(tmp_path: Path, cli: Callable[..., Ended]) -> None:
    scene = write(tmp_path, TINY)
    assert cli("map", scene, "--out", tmp_path / "here", "--quiet", "--no-pictures").status == 0
    elsewhere("map", scene, "--out", tmp_path / "workers", "--workers", 2, "--quiet", "--no-pictures")
    same_files(tmp_path / "workers", tmp_path / "here", "map.csv")
    shares = [started("-m", "casadi_skin", "map", scene, "--part", f"{k}/2", "--out", tmp_path / "shares",
                      "--quiet", "--no-pictures")
              for k in (1, 2)]  # fmt: skip
    for share in shares:
        _, error = share.communicate(timeout=300)
        assert share.returncode == 0, error
    assert (tmp_path / "shares" / "map.csv").read_bytes() == (tmp_path / "here" / "map.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_run_is_resumed(tmp_path: Path, cli: Callable[..., Ended]) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(FAMILIES, encoding="utf-8")
    process = started("-m", "casadi_skin", "run", scene, "--out", out, "--quiet")
    journal = out / "journal.msgpack"
    while process.poll() is None and not (journal.exists() and journal.stat().st_size > 0):
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    assert error.count("\n") == 1
    assert "go on with --resume" in error
    assert journal.exists()
    elsewhere("run", scene, "--out", out, "--resume", "--quiet")
    assert cli("run", scene, "--out", tmp_path / "here", "--quiet").status == 0
    same_files(out, tmp_path / "here", "family.csv")


@pytest.mark.slow
def test_a_run_ends_when_its_time_is_over(tmp_path: Path) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text("time_limit = 1.0\n" + chain(24) + family([*range(1, 25)], 3.0) + table("stability"), "utf-8")
    told = elsewhere("run", scene, "--out", out, "--quiet", status=1).err
    assert "time_limit: 1 s are over; what was computed is in" in told
    assert (out / "family.csv").is_file()
