"""A branch ends before its next point once its time is over: what was computed is kept, as it is without a limit."""

from __future__ import annotations

import time
import types
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import casadi_skin.follow.follow as following
from casadi_skin import Branch, Chain, OdeModel, find_orbit, follow_family
from casadi_skin.solve.watch import TimeLimitError, watched
from casadi_skin.zero.settings import End

CHAIN = Chain(3, 1.0, 0.3, -1.0)


class Clock:
    """A clock that goes on by a second with each solution."""

    now = 0.0

    def tick(self, _: object) -> None:
        self.now += 1.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(following, "time", types.SimpleNamespace(monotonic=lambda: clock.now))
    return clock


def family(clock: Clock, limit: float | None, stability: bool) -> Branch:
    clock.now = 0.0
    return follow_family(CHAIN, 1, 0.5, at=[0.45], stability=stability, time_limit=limit, progress=clock.tick)


@pytest.mark.parametrize("stability", [False, True])
def test_a_family_ends_with_what_was_computed(stability: bool, clock: Clock) -> None:
    whole, cut = family(clock, None, stability), family(clock, 2.5, stability)
    assert whole.complete
    assert 3 <= len(cut) < len(whole)
    assert cut.end is End.TIME
    assert not cut.complete
    assert not any(cut.misses.values())  # what lies ahead was not missed
    last = cut.orbits[-1]
    assert cut.reason == f"the time limit is over (S = {last.S:.10g}, Omega = {last.Omega:.6g}): 2.5 s"
    np.testing.assert_array_equal(cut.S, whole.S[: len(cut)])
    if stability:  # of every orbit, those that waited for it among them
        found = [cut.orbits[-1].floquet().multipliers, whole.orbits[len(cut) - 1].floquet().multipliers]
        np.testing.assert_array_equal(*found)


def test_time_that_is_over_at_the_end_cuts_nothing(clock: Clock) -> None:
    whole = family(clock, None, False)
    assert family(clock, len(whole) - 0.5, False).complete
    assert family(clock, len(whole) - 1.5, False).end is End.TIME


def test_a_branch_has_its_first_solution_at_least() -> None:
    orbit = follow_family(CHAIN, 1, 0.1).orbits[-1]
    branch = orbit.follow("alpha", 1.2, time_limit=1e-9)
    assert len(branch) == 1
    assert branch.reason == "the time limit is over: 1e-09 s"


@pytest.mark.parametrize("given", [0, -1.0, float("nan"), "5", True])
def test_other_limits_are_refused(given: object) -> None:
    with pytest.raises((ValueError, TypeError), match=r"time_limit: given .*; accepted: a number of seconds > 0"):
        follow_family(CHAIN, 1, 0.5, time_limit=given)  # type: ignore[arg-type]


def test_what_is_sought_later_ends_with_the_time_that_was_left() -> None:
    """Changes of stability of a family, the points where others leave it and resonances: named where they are cut."""
    branch = follow_family(Chain(8, 1.0, 0.25, -1.0), 1, 2.0, stability=True, time_limit=1e6)
    whole = follow_family(Chain(8, 1.0, 0.25, -1.0), 1, 2.0, stability=True)
    assert [change.value for change in branch.changes] == [change.value for change in whole.changes]
    assert branch.unresolved == whole.unresolved
    assert 0.0 < branch.time_left < 1e6
    cut = replace(whole, time_left=1e-6)
    assert cut.changes == ()
    assert cut.special_points == ()
    assert cut.passed_resonances is None
    kinds = {stretch.kind for stretch in cut.unresolved}
    assert "changes of stability" in kinds
    assert all("the time allowed" in stretch.reason for stretch in cut.unresolved)
    assert all(stretch.start <= cut.S[0] and stretch.end == cut.S[-1] for stretch in cut.unresolved)
    assert "unresolved: " in repr(cut)


def test_a_search_within_a_point_ends_with_the_time() -> None:
    """Solvers heed the limit: a branch whose points take long each does not finish the one that it is at."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    model = OdeModel("slow", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu)
    orbit = find_orbit(model, lambda t: [2.0 * np.cos(t), -2.0 * np.sin(t)], 2.0 * np.pi, parameters={"mu": 0.5})
    steps = list[str]()
    with watched(report=steps.append):
        whole = orbit.follow("mu", 3.0, stability=True)
    assert whole.complete
    assert len(steps) > len(whole)  # of Newton's method: each is a place at which a limit is heeded
    start = time.monotonic()
    cut = orbit.follow("mu", 1e4, stability=True, max_points=10_000, time_limit=1.0)
    assert cut.end is End.TIME
    assert time.monotonic() - start < 20.0
    assert 1 <= len(cut) < 10_000
    with watched(0.0), pytest.raises(TimeLimitError):
        cut.at(mu=0.5 * (cut.values[0] + cut.values[-1]))


def test_folds_of_a_family_start_no_search_for_changes_of_stability() -> None:
    branch = follow_family(Chain(8, 1.0, 0.25, -1.0), 1, 2.0, stability=True)
    assert branch.folds == ()
    assert not branch.changes_known
    assert branch.changes
    assert branch.changes_known
