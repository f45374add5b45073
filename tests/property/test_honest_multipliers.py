"""Estimated errors of multipliers over the full period against true ones, of random cycles in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from known_cycles import drawn, errors

ROUNDED = 1e-13  # true errors below are rounding alone: their ratios say nothing of estimates


def options_of(index: int) -> dict[str, Any]:
    random = np.random.default_rng([7, index])
    return {
        "tolerance": 10.0 ** random.uniform(-10, -4), "degree": int(random.integers(3, 9)),
        "transcription": str(random.choice(["gauss", "radau"])), "intervals": int(random.integers(5, 14)),
    }  # fmt: skip


def judged(seed: int, count: int, by: str | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True errors, estimates, and tolerances relative to sizes of 1 or more, of all multipliers of all cycles."""
    found: list[tuple[float, float, float]] = []
    for index in range(count):
        cycle, options = drawn(seed, index), options_of(index)
        floquet = cycle.orbit(**options).floquet(by)
        true, estimates = errors(floquet, cycle.others)
        assert floquet.other_errors.shape == floquet.others.shape
        found += [(t, e, options["tolerance"]) for t, e in zip(true, estimates, strict=True)]
    true, estimates, tolerances = np.array(found).T
    return true, estimates, tolerances


@pytest.mark.parametrize("count", [12, pytest.param(60, marks=pytest.mark.slow)])
def test_estimates_are_no_smaller_than_true_errors_and_not_far_above(count: int) -> None:
    true, estimates, tolerances = judged(1, count)
    assert np.all(true <= estimates)
    real = true > ROUNDED
    assert real.sum() >= 0.5 * count
    assert np.median(estimates[real] / true[real]) < 3.0
    assert np.quantile(estimates / tolerances, 0.95) <= 1.0
    assert np.quantile(true / tolerances, 0.99) <= 1.0


def test_cycles_in_units_of_1e_minus_5_to_1e5_have_the_same_multipliers() -> None:
    """Some components stay at zero: rounding of their equations is not that of components 1e10 times as large."""
    for index in range(5, 11):
        plain, scaled = (drawn(11, index, decades) for decades in (0.0, 5.0))
        assert np.array_equal(plain.others, scaled.others)
        for cycle in (plain, scaled):
            true, estimates = errors(cycle.orbit(**options_of(index)).floquet(), cycle.others)
            assert np.all(true <= estimates)


@pytest.mark.slow
def test_estimates_of_cvodes_are_no_smaller_than_true_errors() -> None:
    true, estimates, _ = judged(2, 45, "cvodes")
    assert np.all(true <= estimates)
    assert np.median(estimates / np.maximum(true, 1e-16)) < 20.0
