"""A scene with a [search]: its plan, its files, its exit status, and runs that are interrupted and resumed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from outputs import read_rows
from scipy.io import netcdf_file

from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("blank")

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENE = """[chain]
sites = 6
alpha = 1.0
gamma = 0.3
g = 1.0
[search]
objective = "participation"
free = ["gamma"]
bounds = { gamma = [0.1, 0.6] }
starts = 3
"""


def write(path: Path, **changes: str) -> Path:
    lines = SCENE.splitlines()
    for key, value in changes.items():
        lines = [line for line in lines if not line.startswith(f"{key} =")] + ([f"{key} = {value}"] if value else [])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.usefixtures("pictures")
def test_run_writes_optima_starts_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["run", str(write(tmp_path / "s.toml")), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "the best optimum sits on a bound: gamma <= 0.6; 3 of 3 starts led to it" in printed
    (best,) = read_rows(out / "search.csv")
    assert float(best["gamma"]) == pytest.approx(0.6, abs=1e-6)
    assert best["on_family"] == "1"
    assert abs(float(best["Omega_difference"])) < 1e-9
    assert [row["ending"] for row in read_rows(out / "starts.csv")] == ["converged"] * 3
    with netcdf_file(out / "search.nc", mmap=False) as file:
        profile = file.variables["profile"].data[0].astype(float)
    assert np.sum(profile**2) ** 2 / np.sum(profile**4) == pytest.approx(float(best["objective"]), rel=1e-9)
    assert {p.name for p in out.iterdir()} == {
        "scene.toml", "search.csv", "starts.csv", "search.nc", "search.png"
    }  # fmt: skip
    assert main(["run", str(tmp_path / "s.toml"), "--out", str(out), "--resume"]) == 0
    assert "complete run already" in capsys.readouterr().out
    assert main(["run", str(tmp_path / "s.toml"), "--out", str(out)]) == 2
    assert main(["run", str(tmp_path / "s.toml"), "--out", str(out), "--overwrite"]) == 0


def test_the_plan_of_a_search(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write(tmp_path / "s.toml", constraints='[{ quantity = "Omega_slope", lower = 0.0 }]')
    assert main(["check", str(scene)]) == 0
    printed = capsys.readouterr().out
    assert "smallest participation on the family j = 6, S = 1" in printed
    assert "0.1 <= gamma <= 0.6" in printed
    assert "those of its tangent" in printed
    assert main(["check", str(write(tmp_path / "s.toml"))]) == 0
    assert "those of its tangent" not in capsys.readouterr().out


@pytest.mark.slow
def test_an_infeasible_search_has_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write(tmp_path / "s.toml", constraints='[{ quantity = "Omega", lower = 5.0 }]')
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr()
    assert len(told.err.splitlines()) == 1
    assert "no start met the constraints; Omega is off by" in told.err
    assert "nearest: from start" in told.out
    assert (tmp_path / "out" / "starts.csv").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"objective": '"participaton"'}, 'did you mean "participation"?'),
        ({"free": '["gama"]'}, 'did you mean "gamma"?'),
        ({"bounds": "{ gama = [0.1, 0.6] }"}, 'did you mean "gamma"?'),
        ({"bounds": "{ gamma = [0.6, 0.1] }"}, "lower <= upper"),
        ({"bounds": "{ gamma = [-0.6, 0.1] }"}, "one side of 0"),
        ({"bounds": "{ gamma = [0.1] }"}, "[search] bounds"),
        ({"constraints": '[{ quantity = "Omega" }]'}, "neither equal nor a bound"),
        ({"constraints": '[{ quantity = "Omega", equal = 1.0, lower = 1.0 }]'}, "equal beside a bound"),
        ({"constraints": '[{ quantity = "Omga", equal = 1.0 }]'}, 'did you mean "Omega"?'),
        ({"mode": "9"}, "whole numbers from 1 to 6"),
        ({"starts": "0"}, "[search] starts"),
        ({"objectiv": '"S"'}, "did you mean 'objective'?"),
        ({"S": "1" + "0" * 400}, "[search] S"),
        ({"bounds": "{ gamma = [0.1, 1" + "0" * 400 + "] }"}, "[search] bounds"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(
    changes: dict[str, str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write(tmp_path / "s.toml", **changes)
    for command in (["check", str(scene)], ["run", str(scene), "--out", str(tmp_path / "out")]):
        assert main(command) == 2
        error = capsys.readouterr().err
        assert words in error
        assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_search_stands_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text(SCENE + "[family]\nmode = 1\namplitude_max = 1.0\n", encoding="utf-8")
    assert main(["check", str(scene)]) == 2
    assert "beside [family]" in capsys.readouterr().err


@pytest.mark.usefixtures("interruptible")
@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_interrupted_search_keeps_its_best_and_resumes(workers: str, tmp_path: Path) -> None:
    scene, out = write(tmp_path / "s.toml", starts="60", workers=workers), tmp_path / "out"
    command = [sys.executable, "-m", "casadi_skin.runs.program", "run", str(scene), "--out", str(out)]
    journal = out / "journal.msgpack"
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 50
    while not (journal.exists() and journal.stat().st_size > 8000) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    told, error = process.communicate(timeout=50)
    assert process.returncode == 130, error
    assert "go on with --resume" in error
    assert "interrupted after" in told
    assert "best so far" in told
    kept = len(read_rows(out / "starts.csv"))
    assert 0 < kept < 60
    assert float(read_rows(out / "search.csv")[0]["gamma"]) == pytest.approx(0.6, abs=1e-6)
    assert main(["run", str(scene), "--out", str(out), "--resume"]) == 0
    assert len(read_rows(out / "starts.csv")) == 60
    assert not journal.exists()


@pytest.mark.slow
def test_the_example_scene(tmp_path: Path) -> None:
    scene = EXAMPLES / "search_hardest_breather.toml"
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    best = read_rows(tmp_path / "out" / "search.csv")[0]
    assert float(best["gamma"]) == pytest.approx(0.663154498, abs=1e-7)
    assert float(best["S"]) == pytest.approx(0.961039022, abs=1e-8)
