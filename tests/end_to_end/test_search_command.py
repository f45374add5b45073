"""A scene with a [search]: its plan, its files, its exit status, and runs that are interrupted and resumed."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
import pytest
from apart import ended_from_outside
from outputs import EXAMPLES
from scenes import Runs, chain, table
from scipy.io import netcdf_file

pytestmark = pytest.mark.usefixtures("blank")


def search(**keys: Any) -> str:
    given = {"objective": "participation", "free": ["gamma"], "bounds": {"gamma": [0.1, 0.6]}, "starts": 3}
    return chain(6, gamma=0.3, g=1.0) + table("search", **given | keys)


@pytest.mark.usefixtures("pictures")
def test_run_writes_optima_starts_and_a_picture(run: Runs) -> None:
    assert "the best optimum sits on a bound: gamma <= 0.6; 3 of 3 starts led to it" in run(search()).out
    (best,) = run.rows("search")
    assert float(best["gamma"]) == pytest.approx(0.6, abs=1e-6)
    assert best["on_family"] == "1"
    assert abs(float(best["Omega_difference"])) < 1e-9
    assert [row["ending"] for row in run.rows("starts")] == ["converged"] * 3
    with netcdf_file(run.out / "search.nc", mmap=False) as file:
        profile = file.variables["profile"].data[0].astype(float)
    assert np.sum(profile**2) ** 2 / np.sum(profile**4) == pytest.approx(float(best["objective"]), rel=1e-9)
    assert run.files == {"scene.toml", "search.csv", "starts.csv", "search.nc", "search.png"}
    assert "complete run already" in run("", "--resume").out
    run(status=2)
    run("", "--overwrite")


def test_the_plan_of_a_search(run: Runs) -> None:
    printed = run(search(constraints=[{"quantity": "Omega_slope", "lower": 0.0}]), command="check").out
    for words in ("smallest participation on the family j = 6, S = 1", "0.1 <= gamma <= 0.6", "those of its tangent"):
        assert words in printed
    assert "those of its tangent" not in run(search(), command="check").out


@pytest.mark.slow
def test_an_infeasible_search_has_status_1(run: Runs) -> None:
    told = run(search(constraints=[{"quantity": "Omega", "lower": 5.0}]), status=1)
    assert len(told.err.splitlines()) == 1
    assert "no start met the constraints; Omega is off by" in told.err
    assert "nearest: from start" in told.out
    assert "starts.csv" in run.files


@pytest.mark.usefixtures("interruptible")
@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupted_search_keeps_its_best_and_resumes(
    workers: int, run: Runs, capsys: pytest.CaptureFixture[str]
) -> None:
    run.scene.write_text(search(starts=60, workers=workers), encoding="utf-8")
    assert ended_from_outside(signal.SIGINT, run.scene, run.out, 8000) == 130
    told, error = capsys.readouterr()
    assert "go on with --resume" in error
    assert "interrupted after" in told
    assert "best so far" in told
    assert 0 < len(run.rows("starts")) < 60
    assert float(run.rows("search")[0]["gamma"]) == pytest.approx(0.6, abs=1e-6)
    run("", "--resume")
    assert len(run.rows("starts")) == 60
    assert "journal.msgpack" not in run.files


@pytest.mark.slow
def test_the_example_scene(run: Runs) -> None:
    run(EXAMPLES / "search_hardest_breather.toml")
    best = run.rows("search")[0]
    assert float(best["gamma"]) == pytest.approx(0.663154498, abs=1e-7)
    assert float(best["S"]) == pytest.approx(0.961039022, abs=1e-8)
