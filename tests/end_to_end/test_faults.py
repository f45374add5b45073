"""Faults of files and streams: one line on standard error, exit status 1, and what was computed is kept."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from apart import BLANK, Ended
from outputs import read_rows as rows
from scenes import chain, family

from casadi_skin.results.store import Journal
from casadi_skin.runs import run as writing
from casadi_skin.runs.program import main

SCENE = chain(4) + family([1, 4], at=[0.5]) + "[stability]\n"
FULL = Path("/dev/full")
pytestmark = pytest.mark.usefixtures("blank")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def run(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """casadi-skin with these words, in a process of its own; its pictures stay blank."""
    code = f"{BLANK}from casadi_skin.runs.program import main\nraise SystemExit(main({[*map(str, words)]!r}))"
    streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    folder = Path(__file__).parents[1]
    return subprocess.run([sys.executable, "-c", code], cwd=folder, text=True, check=False, timeout=60, **streams)


def one_line(told: str, words: str) -> None:
    assert words in told
    assert told.count("\n") == 1
    assert told.startswith("casadi-skin: ")


# Streams ------------------------------------------------------------------------------------------------------------


@needs_full
@pytest.mark.parametrize(
    "word", ["run", *(pytest.param(w, marks=pytest.mark.slow) for w in ("spectrum", "check", "--help"))]
)
def test_a_full_standard_output_is_a_failure(word: str, scene: Path, tmp_path: Path) -> None:
    more = {"run": [scene, "--out", tmp_path / "out"], "spectrum": [scene], "check": [scene], "--help": []}[word]
    with FULL.open("w", encoding="utf-8") as full:
        done = run(word, *more, stdout=full)
    assert done.returncode == 1
    one_line(done.stderr, "standard output: No space left on device")
    if word == "run":
        assert len(rows(tmp_path / "out" / "family.csv")) > 10
        assert (tmp_path / "out" / "family.nc").exists()


@pytest.mark.slow
def test_a_standard_output_that_is_closed_or_has_gone_is_a_failure_unless_nothing_is_printed(
    scene: Path, tmp_path: Path
) -> None:
    reading, writing_end = os.pipe()
    os.close(reading)
    gone: dict[str, Any] = {"stdout": writing_end}
    shut: dict[str, Any] = {"stdout": None, "preexec_fn": partial(os.close, 1)}
    for options, words in ((shut, "it is closed"), (gone, "Broken pipe")):
        done = run("spectrum", scene, **options)
        assert done.returncode == 1
        one_line(done.stderr, f"standard output: {words}")
    os.close(writing_end)
    assert run("run", scene, "--out", tmp_path / "out", "--quiet", **shut).returncode == 0
    assert (tmp_path / "out" / "family.nc").exists()


@pytest.mark.slow
@needs_full
def test_the_exit_status_does_not_depend_on_standard_error(scene: Path, tmp_path: Path) -> None:
    with FULL.open("w", encoding="utf-8") as full:
        assert run("check", tmp_path / "nothing.toml", stderr=full).returncode == 2
    done = run("check", tmp_path / "nothing.toml", stderr=None, preexec_fn=partial(os.close, 2))
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.slow
def test_warnings_of_other_packages_do_not_reach_the_terminal(
    scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import numpy as np

    write = writing.write_netcdf

    def warning(*arguments: Any) -> None:
        np.float64(1e300) * np.float64(1e300)
        write(*arguments)

    monkeypatch.setattr(writing, "write_netcdf", warning)
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")


# Files --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("size", [9_000, *(pytest.param(n, marks=pytest.mark.slow) for n in (512, 25_000))])
def test_a_limit_on_the_size_of_files_keeps_what_was_computed(size: int, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run(
        "run",
        scene,
        "--out",
        out,
        "--quiet",
        preexec_fn=partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size)),
    )
    assert done.returncode == 1
    one_line(done.stderr, "File too large; what was computed is in")
    assert not list(out.glob(".*"))
    assert main(["run", str(scene), "--out", str(out), "--resume", "--quiet"]) == 0
    assert not (out / "journal.msgpack").exists()


@pytest.mark.slow
def test_a_directory_that_is_removed_during_a_run_is_made_again_with_what_was_computed(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, left, append = tmp_path / "out", iter(range(20)), Journal.append

    def removing(self: Any, record: Any) -> None:
        append(self, record)
        if next(left, None) == 19:
            shutil.rmtree(out)

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "append", removing)
        assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert str(out) in told
    assert len(rows(out / "family.csv")) >= 8
    assert main(["run", str(scene), "--out", str(out), "--resume", "--quiet"]) == 0
    assert {row["mode"] for row in rows(out / "family.csv")} == {"1", "4"}


@pytest.mark.parametrize("out", ["/proc/out", "/dev/null/out", "a" * 300, "b/" + "a" * 300])
@pytest.mark.parametrize("command", ["run", "spectrum"])
def test_a_directory_that_cannot_be_made_is_refused_before_anything_is_computed(
    command: str, out: str, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Callable[..., Ended]
) -> None:
    if out.startswith("/") and not Path(out).parent.exists():
        pytest.skip(f"needs {Path(out).parent}")
    monkeypatch.chdir(tmp_path)
    started = time.monotonic()
    done = cli(command, scene, "--out", out)
    assert time.monotonic() - started < 5.0
    assert done.out == ""
    one_line(done.line, out)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]
