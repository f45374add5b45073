"""What benchmarks share: the unit of their times, and the record of what they measured."""

from __future__ import annotations

import csv
import datetime
import platform
from collections.abc import Callable, Iterator
from pathlib import Path

import casadi
import numpy as np
import pytest
from stopwatch import unit_seconds

from casadi_skin import __version__
from casadi_skin.solve.watch import one_thread

HISTORY = Path(__file__).parent / "history.csv"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--record", action="store_true", help="keep what benchmarks measure in tests/benchmarks/history.csv"
    )


@pytest.fixture(scope="session", autouse=True)
def single_thread() -> Iterator[None]:
    """One core for the unit as for what is measured by it."""
    with one_thread():
        yield


@pytest.fixture(scope="module")
def unit() -> float:
    """Seconds of the 193 x 193 solve."""
    value = unit_seconds()
    print(f"\n193 x 193 solve: {1e3 * value:.3f} ms")
    return value


@pytest.fixture
def record(unit: float, request: pytest.FixtureRequest) -> Callable[[str, float, int], None]:
    """Prints a case's seconds as multiples of the unit, and keeps them as the last of this version where asked to."""

    def keep(case: str, value: float, points: int) -> None:
        solves, forty = value / unit, 40 * value / unit / points
        print(f"  {case:<60} {1e3 * value:9.1f} ms = {solves:7.0f} solves; {points} points, {forty:6.0f} per 40")
        if request.config.getoption("--record"):
            today = datetime.date.today().isoformat()
            versions = (__version__, platform.python_version(), np.__version__, casadi.__version__)
            with HISTORY.open(newline="") as file:
                kept = [row for row in csv.reader(file) if (row[1], row[5]) != (__version__, case)]
            with HISTORY.open("w", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerows([*kept, (today, *versions, case, round(solves), points, round(forty))])

    return keep
