"""What engines of maps cost a cell, and what a second worker is worth; printed with -s."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from maps import MODELS, OF_MODELS, TINY, tasks, write

from casadi_skin import run_map

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]
CELLS = 24
FAMILIES = TINY.replace("points = 3", "points = 24").replace("sites = 2", "sites = 16").replace("[1, 2]", "[1]")
DEAR = FAMILIES.replace("amplitude_max = 0.1", "amplitude_max = 1.0\n[stability]").replace("to = 0.1,", "to = 1.0,")


def seconds(scene: Path, out: Path, **engine: Any) -> float:
    """Time of a map whose workers are there already, as far as its engine keeps them."""
    began = time.perf_counter()
    assert run_map(scene, out, pictures=False, quiet=True, **engine).complete
    return time.perf_counter() - began


def sleeping(folder: Path, name: str) -> Path:
    """A scene of cells that take a second each and no work."""
    names = [f"{name}_{k}" for k in range(CELLS)]
    path = write(folder, OF_MODELS.replace("NAMES", str(names)))
    models = MODELS + "def second():\n    time.sleep(1.0)\n    return good\n" + " = ".join([*names, "second"]) + "\n"
    (folder / "models.py").write_text(models, encoding="utf-8")
    return path


def test_a_dask_cluster_costs_less_than_a_twentieth_of_a_cell_of_a_second(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        seconds(sleeping(tmp_path / "first", "first"), tmp_path / "out_1", scheduler=address)  # the workers start
        taken = seconds(sleeping(tmp_path / "second", "second"), tmp_path / "out_2", scheduler=address)
    inside = sum(task.seconds for task in tasks(tmp_path / "out_2" / "journal.msgpack"))
    cost = (2.0 * taken - inside) / CELLS
    print(f"\ndask: {1e3 * cost:.0f} ms a cell of {inside / CELLS:.3f} s, {CELLS} cells on 2 workers in {taken:.2f} s")
    assert cost < 0.05


def test_two_workers_are_worth_two(tmp_path: Path) -> None:
    scene = write(tmp_path, DEAR)
    one = seconds(scene, tmp_path / "one", workers=1)
    two = seconds(scene, tmp_path / "two", workers=2)
    print(f"\n{one:.1f} s with one worker, {two:.1f} s with two: {one / two:.2f} times as fast")
    assert one / two > 1.5
