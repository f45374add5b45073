"""Cost of every change of stability as multiples of a dense 193 x 193 solve timed in the same run, one thread.

Run with `pytest -m benchmark -s tests/benchmarks/test_changes_speed.py`; with `--record` what is measured is added to
history.csv. What is counted, bordered solves and intervals, is asserted; times are printed.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from casadi_skin import Chain, follow_family
from casadi_skin.follow.family_changes import family_tongues
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.stability.tongues.diagram import StabilityDiagram

pytestmark = pytest.mark.benchmark

MODES = (1, 6, 10, 14, 18, 24)  # of figure 3 of the paper

Record = Callable[[str, float, int], None]


def changes(sites: int, g: float, mode: int) -> StabilityDiagram:
    """All of the family to S = 3 anew, and its changes."""
    branch = follow_family(Chain(sites, 1.0, 0.25, g), mode, 3.0, stability=False)
    diagram = family_tongues(branch.space, (branch.start, *(orbit.point for orbit in branch.orbits)))
    assert diagram.complete
    return diagram


@pytest.fixture
def solves(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by one at each factorisation of an orbit's bordered matrix, of the family and of its orbits alike."""
    counted = [0]
    original = BorderedSolver.factor

    def factor(*arguments: object) -> object:
        counted[0] += 1
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(BorderedSolver, "factor", factor)
    return counted


def test_the_first_family_of_the_readme(record: Record, unit: float, solves: list[int]) -> None:
    """47 changes by fewer than 1500 solves in all."""
    changes(24, -1.0, 1)
    values = []
    for _ in range(5):  # the least of them: others may be at work too
        solves[0], started = 0, time.process_time()
        diagram = changes(24, -1.0, 1)
        values.append(time.process_time() - started)
    value = min(values)
    assert len(diagram.changes) == 47
    record("every change of j = 1, g = -1, N = 24 to S = 3", value, diagram.samples)
    print(f"    {solves[0]} factorisations, {diagram.samples} orbits")
    assert solves[0] < 1500


def test_twelve_families(record: Record, unit: float, solves: list[int]) -> None:
    """Those of the paper's Fig. 3 by fewer than 15000 solves in all."""
    solves[0], started = 0, time.process_time()
    diagrams = [changes(24, g, mode) for g in (1.0, -1.0) for mode in MODES]
    value = time.process_time() - started
    samples = sum(diagram.samples for diagram in diagrams)
    record("every change of twelve families to S = 3", value, samples)
    print(f"    {solves[0]} factorisations, {samples} orbits, {sum(len(d.changes) for d in diagrams)} changes")
    assert solves[0] < 15_000


def test_a_hundred_sites(record: Record) -> None:
    """Under a minute on one core of a machine that has it alone."""
    started = time.process_time()
    diagram = changes(100, -1.0, 1)
    value = time.process_time() - started
    record("every change of j = 1, g = -1, N = 100 to S = 3", value, diagram.samples)
    print(f"    {len(diagram.changes)} changes, {len(diagram.tongues)} tongues, {value:.1f} s")
