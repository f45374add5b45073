"""Times of both programs on the test set of Cash and Mazzia at the same true error, beside scipy's solve_bvp.

Problems of `boundary_test_set` whose solution is known. Each program gets the loosest of the tolerances 1e-2, 1e-3 ...
1e-11 that brings the true error below a bound. Times are of the processor in whole calls, everything built in them, the
least of several calls that alternate; derivatives of solve_bvp are differences.

Run: python tests/benchmarks/boundary_same_error.py 1e-6 1e-10, which prints a table of ratios and their medians.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import boundary_test_set as test_set
import numpy as np
from boundary_test_set import CASES, Array, Case, here, places, scipys

TOLERANCES = 10.0 ** -np.arange(2, 12)
CALLS = 5
Program = Callable[[Case, float], tuple[Any, str, float]]


@dataclass(frozen=True)
class Result:
    """One problem: the tolerances that suffice, None where none does, and seconds here and there."""

    number: int
    eps: float
    tolerances: tuple[float | None, float | None]
    seconds: tuple[float, float]


def values(solution: Any, x: Array) -> Array:
    """The first component at places."""
    return np.asarray(solution.evaluate(x)[:, 0] if hasattr(solution, "evaluate") else solution.sol(x)[0])


def sufficient(program: Program, case: Case, e: float, bound: float) -> float | None:
    """The loosest tolerance with a true error below the bound."""
    x = places(case)
    exact = case.exact(x, e)
    for tolerance in TOLERANCES:
        test_set.TOLERANCE = float(tolerance)
        found = program(case, e)[0]
        if found is not None and np.max(np.abs(values(found, x) - exact)) <= bound * np.max(np.abs(exact)):
            return float(tolerance)
    return None


def compare(number: int, e: float, bound: float) -> Result:
    """Both programs on one problem."""
    case = CASES[number]
    programs: tuple[Program, Program] = (here, scipys)
    tolerances = sufficient(here, case, e, bound), sufficient(scipys, case, e, bound)
    least = [np.inf, np.inf]
    for _ in range(CALLS if None not in tolerances else 0):
        for k, tolerance in enumerate(tolerances):
            test_set.TOLERANCE = float(tolerance or 0.0)
            began = time.process_time()
            programs[k](case, e)
            least[k] = min(least[k], time.process_time() - began)
    return Result(number, e, tolerances, (least[0], least[1]))


def main(bound: float) -> list[Result]:
    """All problems with a known solution, in order."""
    return [compare(number, e, bound) for number, case in CASES.items() if case.exact for e in case.eps]


if __name__ == "__main__":
    print("| true error | problems of both | median ratio | quartiles | reached here alone | by solve_bvp alone |")
    print("| --- | --- | --- | --- | --- | --- |")
    for bound in map(float, sys.argv[1:]):
        results = main(bound)
        for r in results:
            print(f"{r.number} {r.eps:g} {r.tolerances} {r.seconds[0] / r.seconds[1]:.2f}", file=sys.stderr, flush=True)
        ratios = [r.seconds[0] / r.seconds[1] for r in results if None not in r.tolerances]
        alone = [sum(r.tolerances[k] is not None and r.tolerances[1 - k] is None for r in results) for k in (0, 1)]
        low, middle, high = np.percentile(ratios, [25, 50, 75])
        print(
            f"| {bound:.0e} | {len(ratios)} | {middle:.2f} | {low:.2f}, {high:.2f} | {alone[0]} | {alone[1]} |",
            flush=True,
        )
