"""Cost of families as multiples of `numpy.linalg.solve` on a dense 193 x 193 system timed in the same run, one thread.

Run with `pytest -m benchmark -s tests/benchmarks`. Nothing here asserts a time; results are checked, ratios printed.
The multiple carries over between machines; AUTO-07p at its best takes 8400 for the family with multipliers and 1570
without, measured beside the same solve.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest

from casadi_skin import Chain
from casadi_skin.bvp.problem import Array
from casadi_skin.correctors.base import Correction
from casadi_skin.correctors.ipopt import IpoptCorrector
from casadi_skin.families.follow import FamilyWalk
from casadi_skin.families.request import FamilyRequest, FamilyTools

pytestmark = pytest.mark.benchmark


def seconds(act: Callable[[], object], repeats: int) -> float:
    """Median time of `act` after one call that is not counted."""
    act()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        act()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


@pytest.fixture(scope="module")
def unit() -> float:
    """Seconds of the 193 x 193 solve."""
    generator = np.random.default_rng(0)
    matrix, right = generator.normal(size=(193, 193)), generator.normal(size=193)
    value = seconds(lambda: np.linalg.solve(matrix, right), 2000)
    print(f"\n193 x 193 solve: {1e3 * value:.3f} ms")
    return value


def follow(tools: FamilyTools, stability: bool) -> FamilyWalk:
    walk = FamilyWalk(tools, stability, events=False)
    for _ in walk:
        pass
    assert walk.branch().complete
    return walk


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_end_breather_family_with_and_without_multipliers(unit: float, corrector: str) -> None:
    request = FamilyRequest(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, (0.2, 1.0, 3.0), 1e-9, corrector=corrector)
    started = time.perf_counter()
    tools = FamilyTools(request)
    FamilyWalk(tools)
    tools.ladder.corrector(tools.ladder.problem(8))
    building = time.perf_counter() - started
    walk = follow(tools, stability=True)
    assert abs(walk.orbits[-1].Omega - 0.765958900020734) < 1e-9
    points = len(walk.orbits)
    print(f"{corrector}: {points} points; first build {building:.3f} s")
    for stability in (True, False):
        value = seconds(lambda s=stability: follow(tools, s), 9)  # type: ignore[misc]
        words = "with multipliers" if stability else "without"
        print(
            f"  {words:<17} {1e3 * value:7.1f} ms = {value / unit:6.0f} solves, {1e3 * value / points:.2f} ms a point"
        )


def test_overhead_of_ipopt(unit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time inside Ipopt's calls, and of it the part that is spent in our functions."""
    calls: list[tuple[float, float, int]] = []
    original = IpoptCorrector.correct

    def timed(self: IpoptCorrector, guess: Array, row: Array, value: float) -> Correction:
        started = time.perf_counter()
        result = original(self, guess, row, value)
        stats = self._solver.stats()
        ours = sum(stats[f"t_wall_{name}"] for name in ("nlp_g", "nlp_jac_g", "nlp_hess_l", "nlp_f", "nlp_grad_f"))
        calls.append((time.perf_counter() - started, ours, result.iterations))
        return result

    tools = FamilyTools(FamilyRequest(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, (), 1e-9))
    follow(tools, stability=False)
    monkeypatch.setattr(IpoptCorrector, "correct", timed)
    started = time.perf_counter()
    follow(tools, stability=False)
    total = time.perf_counter() - started
    inside, ours, iterations = (sum(column) for column in zip(*calls, strict=True))
    print(
        f"family {total / unit:.0f} solves: in Ipopt {inside / unit:.0f} ({len(calls)} calls, {iterations} iterations) "
        f"of which our functions {ours / unit:.0f}, Ipopt and MUMPS themselves {(inside - ours) / unit:.0f}"
    )


LONG_CHAIN = """
import resource, time
from casadi_skin import Chain
from casadi_skin.families.follow import FamilyWalk
from casadi_skin.families.request import FamilyRequest, FamilyTools
started = time.perf_counter()
tools = FamilyTools(FamilyRequest(Chain(1000, 1.0, 0.25, 1.0), 1000, 3.0, (3.0,), 1e-9, corrector="{corrector}"))
tools.ladder.corrector(tools.ladder.problem(8))
built = time.perf_counter()
walk = FamilyWalk(tools)
for _ in walk:
    pass
assert abs(walk.orbits[-1].Omega - 2.3200364277694) < 1e-8, walk.orbits[-1].Omega
print(f"built in {{built - started:.2f}} s, {{len(walk.orbits)}} points in {{time.perf_counter() - built:.1f}} s, "
      f"peak memory {{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f}} GB")
"""


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_thousand_sites(corrector: str) -> None:
    code = LONG_CHAIN.format(corrector=corrector)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    print(f"\nN = 1000, j = 1000, {corrector}: {done.stdout.strip()}")


def test_import_and_help() -> None:
    for code in ("import casadi", "import casadi_skin", "from casadi_skin import follow_family"):
        value = seconds(lambda c=code: subprocess.run([sys.executable, "-c", c], check=True), 5)  # type: ignore[misc]
        print(f"\n{code:<40} {value:.2f} s")
    command = [sys.executable, "-m", "casadi_skin.cli", "--help"]
    print(f"casadi-skin --help: {seconds(lambda: subprocess.run(command, check=True, capture_output=True), 5):.2f} s")
    print(f"peak memory of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
