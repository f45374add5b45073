"""Branches of orbits of any ODE with their multipliers, beside AUTO-07p on the least mesh that is as accurate.

Times are of a processor, in dense 193 x 193 solves. Ours have tolerance 1e-8. AUTO is run where AUTO_DIR names its
folder, on 10 to 320 intervals of four points until the period at the end agrees to 1e-8 with ours at 1e-11; its points
depend on its longest step. Run with `pytest -m benchmark -s tests/benchmarks/test_any_ode_speed.py`, one thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from ode_cases import SMALL, OdeCase, lorenz

from casadi_skin import find_equilibrium, find_orbit

sys.path.append(str(Path(__file__).parent / "peers"))
from auto_orbits import AutoOrbits, folder

pytestmark = pytest.mark.benchmark

ASKED, REFERENCE = 1e-8, 1e-11
MESHES = (10, 20, 40, 80, 160, 320)
REPEATS, FIRST_STEP = 3, 0.01


def least(act: Callable[[], Any]) -> tuple[float, Any]:
    """Least time of the processor, after a first call that builds, and the last result."""
    times, found = [], act()
    for _ in range(REPEATS):
        started = time.process_time()
        found = act()
        times.append(time.process_time() - started)
    return min(times), found


def line(name: str, seconds: float, points: int, unit: float, aim: float | None = None) -> None:
    units, wanted = seconds / unit, "" if aim is None else f"  (aim {aim:g})"
    print(f"  {name:<34} {points:5d} points {units:9.0f} units {units / points:8.1f} a point{wanted}")


@pytest.mark.parametrize("case", SMALL, ids=lambda case: case.name)
def test_a_point_with_multipliers(case: OdeCase, unit: float, tmp_path: Path) -> None:
    model = case.model()
    start = case.start(model)
    seconds, branch = least(lambda: start.follow(case.parameter, case.to, stability=True))
    assert branch.complete
    assert branch.values[-1] == case.to
    print()
    line(case.name, seconds, len(branch.values), unit, case.aim)
    last = branch.orbits[-1]
    values = {case.parameter: case.to}
    exact = find_orbit(model, last, last.period, parameters=values, tolerance=REFERENCE).period
    assert abs(branch.period[-1] / exact - 1.0) <= ASKED
    if folder() is None:
        return
    first, value = branch.orbits[1], float(branch.values[1])
    auto = AutoOrbits(model, tmp_path, first, value)
    for intervals in MESHES:
        follow = partial(auto.follow, case.to, value, intervals, FIRST_STEP, case.longest)
        found = min((follow() for _ in range(REPEATS)), key=lambda branch: branch.seconds)
        if abs(found.period / exact - 1.0) <= ASKED:
            break
    line(f"AUTO-07p, {intervals} x 4, {found.period / exact - 1.0:.0e}", found.seconds, found.points, unit)


def test_equilibria(unit: float) -> None:
    rest = find_equilibrium(lorenz(), [7.1, 7.1, 19.0], parameters={"r": 20.0})
    seconds, branch = least(lambda: rest.follow("r", 28.0))
    print()
    line("equilibria of Lorenz", seconds, len(branch.values), unit, 3.0)
