"""What engines of maps cost a cell, and what a second worker is worth; printed with -s."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from maps import MODELS, OF_MODELS, TINY, tasks, write

from casadi_skin import run_map

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]
FEW, MANY = 4, 24
FAMILIES = TINY.replace("points = 3", "points = 12").replace("sites = 2", "sites = 16").replace("[1, 2]", "[1]")
DEAR = FAMILIES.replace("amplitude_max = 0.1", "amplitude_max = 1.0\n[stability]").replace("to = 0.1,", "to = 1.0,")


def seconds(scene: Path, out: Path, **engine: Any) -> float:
    """Time of a map whose workers are there already, as far as its engine keeps them."""
    began = time.perf_counter()
    assert run_map(scene, out, pictures=False, quiet=True, **engine).complete
    return time.perf_counter() - began


def outside(folder: Path, count: int, **engine: Any) -> float:
    """Time of two workers outside of cells that take a second each and no work."""
    names = [f"second_{folder.name}_{k}" for k in range(count)]
    path = write(folder, OF_MODELS.replace("NAMES", str(names)))
    models = MODELS + "def second():\n    time.sleep(1.0)\n    return good\n\n" + " = ".join([*names, "second"]) + "\n"
    (folder / "models.py").write_text(models, encoding="utf-8")
    taken = seconds(path, folder / "out", **engine)
    return 2.0 * taken - sum(task.seconds for task in tasks(folder / "out" / "journal.msgpack"))


def test_a_dask_cluster_costs_less_than_a_twentieth_of_a_cell_of_a_second(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        outside(tmp_path / "warm", 2, scheduler=address)  # the workers start
        few, many = (outside(tmp_path / str(count), count, scheduler=address) for count in (FEW, MANY))
    cost = (many - few) / (MANY - FEW)
    print(f"\ndask: {1e3 * cost:.1f} ms a cell of a second, beside {few - FEW * cost:.1f} s a map")
    assert cost < 0.05


def test_two_workers_are_worth_two(tmp_path: Path) -> None:
    scene = write(tmp_path, DEAR)
    one = seconds(scene, tmp_path / "one", workers=1)
    two = seconds(scene, tmp_path / "two", workers=2)
    print(f"\n{one:.1f} s with one worker, {two:.1f} s with two: {one / two:.2f} times as fast")
    assert one / two > 1.5
