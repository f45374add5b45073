"""Times of calls, and the unit in which benchmarks give them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

LEAST_OF = 3


def seconds(act: Callable[[], object], repeats: int) -> float:
    """Median time of the processor in `act` after one call that is not counted: others may be at work too."""
    act()
    times = []
    for _ in range(repeats):
        started = time.process_time()
        act()
        times.append(time.process_time() - started)
    return float(np.median(times))


def unit_seconds(repeats: int = 1000) -> float:
    """Median time of the processor in numpy.linalg.solve on a dense 193 x 193 system."""
    generator = np.random.default_rng(0)
    matrix, right = generator.normal(size=(193, 193)), generator.normal(size=193)
    return seconds(lambda: np.linalg.solve(matrix, right), repeats)


def least(act: Callable[[], Any], repeats: int = LEAST_OF) -> tuple[float, Any]:
    """Least time of the processor, after a first call that builds if there are several, and the last result."""
    times = []
    for _ in range(repeats if repeats == 1 else repeats + 1):
        started = time.process_time()
        found = act()
        times.append(time.process_time() - started)
    return min(times[-repeats:]), found
