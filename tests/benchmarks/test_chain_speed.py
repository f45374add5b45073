"""What a chain takes beside its families: evolution in time, the smallest kick, a design; in units of the same run.

Run with `pytest -m benchmark -s tests/benchmarks/test_chain_speed.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from stopwatch import seconds

from casadi_skin import Chain, evolve, follow_family, optimise, smallest_kick

pytestmark = pytest.mark.benchmark

Record = Callable[[str, float, int], None]


@pytest.mark.parametrize("method", ["symplectic", "dop853", "cvodes"])
def test_an_evolution(record: Record, method: str) -> None:
    chain, t = Chain(24, 1.0, 0.25, -1.0), np.linspace(0.0, 200.0, 401)
    start = 0.5 * np.eye(24)[-1]
    record(f"evolution of 24 sites to t = 200, {method}", seconds(lambda: evolve(chain, start, None, t, method), 5), 1)


def test_the_smallest_kick(record: Record) -> None:
    orbit = follow_family(Chain(24, 1.0, 0.25, -1.0), 1, 0.2, at=(0.2,)).at(S=0.2)
    assert smallest_kick(orbit, 40.0).norm == pytest.approx(6.528830e-4, rel=1e-6)
    record("smallest kick of 24 sites, t = 40, 8 starts", seconds(lambda: smallest_kick(orbit, 40.0), 1), 1)


def test_the_end_breather_that_is_hardest_to_make(record: Record) -> None:
    orbit = follow_family(Chain(24, 1.0, 0.4, 1.0), "last", 1.0).orbits[-1]

    def hardest() -> float:
        found = optimise(
            "S", orbit, over=("S", "gamma"), bounds={"S": (0.01, 2.0), "gamma": (0.0, 0.95)}, maximise=True,
            subject_to=[lambda o: o.Omega - o.upper_cutoff],
        )  # fmt: skip
        return float(found["gamma"])

    assert hardest() == pytest.approx(0.663154498, abs=1e-8)
    record("hardest end breather", seconds(hardest, 5), 1)
