"""Cost of families as multiples of `numpy.linalg.solve` on a dense 193 x 193 system timed in the same run, one thread.

Run with `pytest -m benchmark -s tests/benchmarks`; with `--record` what is measured is kept in history.csv. Nothing
here asserts a time; results are checked, ratios printed. The multiple carries over between machines.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable

import pytest
from stopwatch import seconds

from casadi_skin import Chain
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchRun
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.ipopt import ArbitratedCorrector
from casadi_skin.solve.levels import Levels
from casadi_skin.stability import family_stability
from casadi_skin.zero.cosines import TaylorRecursion, TrigonometricProblem
from casadi_skin.zero.family import family_request

pytestmark = pytest.mark.benchmark

MODES = (1, 6, 10, 14, 18, 24)  # of figure 3 of the paper

SOFT = Chain(24, 1.0, 0.25, -1.0)
Record = Callable[[str, float, int], None]


def follow(tools: Family, stability: bool) -> BranchRun:
    walk = BranchRun(tools, stability, events=False)
    for _ in walk:
        pass
    assert walk.branch().complete
    return walk


@pytest.mark.parametrize("walker", ["series", "arclength"])
@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
def test_end_breather_family_with_and_without_multipliers(record: Record, corrector: str, walker: str) -> None:
    request = family_request(SOFT, 1, 3.0, at=(0.2, 1.0, 3.0), tolerance=1e-9, corrector=corrector, walker=walker)
    started = time.perf_counter()
    tools = Family(request)
    BranchRun(tools)
    tools.levels.corrector(tools.levels.problem(8))
    print(f"\n{corrector}, {walker}: first build {time.perf_counter() - started:.3f} s")
    walk = follow(tools, stability=True)
    assert abs(walk.solutions[-1].Omega - 0.765958900020734) < 1e-9
    for stability in (True, False):
        value = seconds(lambda s=stability: follow(tools, s), 9)  # type: ignore[misc]
        words = "with multipliers" if stability else "without"
        record(f"end breather, {corrector}, {walker}, {words}", value, len(walk.solutions))


def test_twelve_families_with_stability(record: Record) -> None:
    """Those of the paper's Fig. 3: six modes, hardening and softening, to S = 3."""
    wanted = [(g, mode) for g in (1.0, -1.0) for mode in MODES]
    every = [Family(family_request(Chain(24, 1.0, 0.25, g), mode, 3.0, tolerance=1e-8)) for g, mode in wanted]
    for tools in every:
        follow(tools, stability=True)
    started = time.process_time()
    points = sum(len(follow(tools, stability=True).solutions) for tools in every)
    record("twelve families with stability", time.process_time() - started, points)


@pytest.mark.parametrize("walker", ["series", "arclength"])
def test_where_the_time_goes(unit: float, walker: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time inside the calls of each part, everything built; what the parts call of each other is counted once."""
    tools = Family(family_request(SOFT, 1, 3.0, tolerance=1e-9, walker=walker))
    follow(tools, stability=True)
    spent: Counter[str] = Counter()
    calls: Counter[str] = Counter()
    inside: list[float] = []  # time of the parts that the current one has called, one entry for each that is open

    def watch(owner: object, method: str, part: str) -> None:
        original = getattr(owner, method)

        def timed(*arguments: object, **more: object) -> object:
            inside.append(0.0)
            started = time.perf_counter()
            result = original(*arguments, **more)
            total = time.perf_counter() - started
            spent[part] += total - inside.pop()
            calls[part] += 1
            if inside:
                inside[-1] += total
            return result

        monkeypatch.setattr(owner, method, timed)

    watch(ArbitratedCorrector, "confirm_all", "Ipopt's last word, with its evaluations")
    for method in ("evaluate", "evaluate_all"):
        watch(TrigonometricProblem, method, "residuals and Jacobians outside Ipopt")
    watch(BorderedSolver, "factor", "factorisations outside Ipopt")
    watch(BorderedSolver, "steps", "Newton steps at places of stretches")
    watch(TaylorRecursion, "series", "series")
    watch(Levels, "refined", "error estimates, but for the two above")
    watch(family_stability, "floquets", "multipliers")
    started = time.perf_counter()
    walk = follow(tools, stability=True)
    spent["the rest, Python"] = time.perf_counter() - started - sum(spent.values())
    print(f"\n{walker}, {len(walk.solutions)} points")
    for part, value in spent.most_common():
        print(f"  {part:<42} {value / unit:6.0f} solves, {calls[part] or '':>4}")
    assert calls["multipliers"] > 0


def test_a_value_of_gamma_in_a_scan(record: Record) -> None:
    """A family with its multipliers, its request and all that is made of it, after others of the same size."""
    times, points = [], 0
    for gamma in (0.2, 0.21, 0.22, 0.23, 0.24, 0.25, 0.26):
        started = time.process_time()
        walk = follow(Family(family_request(Chain(24, 1.0, gamma, -1.0), 1, 3.0, tolerance=1e-9)), stability=True)
        times.append(time.process_time() - started)
        points = len(walk.solutions)
    record("a value of gamma in a scan, with multipliers", min(times[1:]), points)


@pytest.mark.parametrize("sites", [24, 96, 384, 1000])
def test_multipliers_of_one_orbit(record: Record, sites: int) -> None:
    tools = Family(family_request(Chain(sites, 1.0, 0.25, -1.0), 1, 1.0, tolerance=1e-8, tail="full"))
    point = follow(tools, stability=False).solutions[-1].point
    (result,) = tools.floquets([point])
    assert result.error < 1e-7
    record(f"multipliers of one orbit, N = {sites}", seconds(lambda: tools.floquets([point]), 3), 1)


@pytest.mark.parametrize("sites", [1000, 10_000, float("inf")])
@pytest.mark.parametrize(("mode", "g"), [("last", 1.0), ("first", -1.0)])
def test_long_chains_without_their_tail(record: Record, mode: str, g: float, sites: float) -> None:
    """Everything built: what a second family takes."""
    tools = Family(family_request(Chain(sites, 1.0, 0.25, g), mode, 3.0, at=(3.0,), tolerance=1e-9))
    walk = follow(tools, stability=False)
    record(f"N = {sites}, mode {mode}, tail eliminated", seconds(lambda: follow(tools, False), 3), len(walk.solutions))


@pytest.mark.parametrize("sites", [1000, float("inf")])
def test_localised_multipliers_of_one_orbit(record: Record, sites: float) -> None:
    """On 193 sites at the edge of a chain whose tail is eliminated."""
    chain = Chain(sites, 1.0, 0.25, -1.0)
    tools = Family(family_request(chain, "first", 1.0, at=(1.0,), tolerance=1e-8, stability_sites=193))
    point = follow(tools, stability=False).solutions[-1].point
    assert tools.floquets([point])[0].max_abs_multiplier == pytest.approx(1.1729244569, abs=1e-8)
    record(f"localised multipliers of one orbit, N = {sites}", seconds(lambda: tools.floquets([point]), 5), 1)


LONG_CHAIN = """
import resource, time
from casadi_skin import Chain
from casadi_skin.follow.follow import BranchRun
from casadi_skin.zero.family import family_request
from casadi_skin.follow.family import Family
chain = Chain({sites}, 1.0, 0.25, 1.0)
tools = Family(family_request(chain, {sites}, 3.0, at=(3.0,), tolerance=1e-9, corrector="{corrector}"))
started = time.perf_counter()
walk = BranchRun(tools)
for _ in walk:
    pass
assert abs(walk.solutions[-1].Omega - 2.3200364277694) < 1e-8, walk.solutions[-1].Omega
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
print(time.perf_counter() - started, len(walk.solutions), memory)
"""


@pytest.mark.parametrize("corrector", ["ipopt", "newton"])
@pytest.mark.parametrize("sites", [24, 100, 300, 1000, 3000, 10000])
def test_long_chains(record: Record, sites: int, corrector: str) -> None:
    """First runs in processes of their own, everything built on the way: cost a point by the size."""
    code = LONG_CHAIN.format(sites=sites, corrector=corrector)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    value, points, memory = done.stdout.split()
    record(f"N = j = {sites}, {corrector}, first run", float(value), int(points))
    print(f"    peak memory {float(memory):.2f} GB")


def test_import_and_help() -> None:
    for code in ("import casadi", "import casadi_skin", "from casadi_skin import follow_family"):
        value = seconds(lambda c=code: subprocess.run([sys.executable, "-c", c], check=True), 5)  # type: ignore[misc]
        print(f"\n{code:<40} {value:.2f} s")
    command = [sys.executable, "-m", "casadi_skin.runs.program", "--help"]
    print(f"casadi-skin --help: {seconds(lambda: subprocess.run(command, check=True, capture_output=True), 5):.2f} s")
    print(f"peak memory of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
