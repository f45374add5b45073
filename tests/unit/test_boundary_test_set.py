"""The benchmark on the test set of Cash and Mazzia: what it says of a problem in closed form, and of a singular one."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "boundary_test_set.py"


@pytest.fixture(scope="module")
def benchmark_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("boundary_test_set", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["boundary_test_set"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_singular_problem_is_refused_here_and_wrong_elsewhere(benchmark_script: ModuleType) -> None:
    """Number 35 at eps = 0.01, by Kummer's function; at 0.1 and for other numbers both are right."""
    assert len(benchmark_script.CASES) == 34
    singular = benchmark_script.compare(35, 0.01)
    assert singular.ours is None
    assert "singular" in singular.told
    assert singular.scipy > 1e-4
    for number, e in ((35, 0.1), (8, 0.01), (13, 0.01)):
        found = benchmark_script.compare(number, e)
        assert found.ours <= found.estimate <= 1e-6
        assert found.scipy < 1e-6
