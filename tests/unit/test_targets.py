"""Points at values of Omega, of the period and of S on families of chains, by both continuations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin import Branch, Chain, Orbit, follow_family
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchRun
from casadi_skin.results.branch_records import EndRecord, known_of, point_record
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.family import family_request
from casadi_skin.zero.settings import End

Array = NDArray[np.float64]

WALKERS = pytest.mark.parametrize("walker", ["arclength", "series"])


# Families of chains -------------------------------------------------------------------------------------------------

FOLDED = Chain(4, 1.219, 0.57, 1.0)  # mode 3 folds in S


@cache
def folded(walker: str, at_Omega: tuple[float, ...] = (), at_period: tuple[float, ...] = ()) -> Branch:
    return follow_family(
        FOLDED, 3, 10.0, at=(1.0,), at_Omega=at_Omega, at_period=at_period, corrector="newton", walker=walker
    )


@pytest.mark.parametrize("walker", ["arclength", pytest.param("series", marks=pytest.mark.slow)])
def test_points_at_Omega_and_period_are_among_the_orbits_and_are_what_the_branch_gives(walker: str) -> None:
    plain = folded(walker)
    low, high = np.quantile(plain.Omega, [0.3, 0.7])
    period = 2 * np.pi / float(0.5 * (low + high))
    branch = folded(walker, (float(low), float(high)), (period,))
    asked = [o for o in branch.orbits if o.point.requested]
    for value in (float(low), float(high)):
        crossings = int(np.sum(np.diff(np.sign(plain.Omega - value)) != 0))
        found = [o for o in asked if value == o.Omega]
        assert len(found) == crossings > 0
        for which, orbit in enumerate(found):
            other = plain.at(Omega=value, which=which)
            assert other.Omega == value
            assert abs(other.S - orbit.S) <= other.S_error + orbit.S_error
            assert 0.0 < orbit.S_error <= 1e-8 * orbit.S
    assert [o.period for o in asked].count(period) >= 1
    assert plain.at(period=period).period == period
    other = branch.at(period=period)
    assert abs(plain.at(period=period).S - other.S) <= 1e-8 * other.S
    assert branch.complete
    assert [o.S_error for o in asked if o.S == 1.0] == [0.0] * sum(o.S == 1.0 for o in asked)


@WALKERS
@pytest.mark.parametrize(("S", "period_max"), [(2.0, 5.0), (0.2, 9.0)])
def test_the_first_end_that_is_reached_counts(walker: str, S: float, period_max: float) -> None:
    """alpha = 1, g = -1: the oscillator y'' = -3 y + y^3, whose period grows from 3.63."""
    branch = follow_family(Chain(1, 1.0, 0.0, -1.0), 1, S, period_max=period_max, corrector="newton", walker=walker)
    assert branch.end is End.REACHED
    assert branch.complete
    ends = branch.S[-1] == S, branch.period[-1] == period_max
    assert ends == (S == 0.2, S == 2.0)
    assert branch.S[-1] <= S
    assert not any(o.point.requested for o in branch.orbits[:-1])


def test_what_a_branch_does_not_pass_is_named() -> None:
    branch = follow_family(Chain(2, 1.0, 0.3, 1.0), 1, 1.0, at_Omega=[9.0], at_period=[100.0], corrector="newton")
    assert branch.end is End.REACHED
    assert not branch.complete
    assert (branch.missed, dict(branch.misses)) == ((), {"Omega": (9.0,), "period": (100.0,)})
    assert "no orbit was found at Omega = 9: the family was followed from" in branch.reason
    assert "no orbit was found at period = 100: " in branch.reason


def test_a_corrector_that_fails_at_a_requested_Omega_leaves_it_named(monkeypatch: pytest.MonkeyPatch) -> None:
    true_correct, wanted = NewtonCorrector.correct, 1.48

    def correct(self: NewtonCorrector, guess: Array, row: Array, value: float):  # type: ignore[no-untyped-def]
        correction = true_correct(self, guess, row, value)
        return replace(correction, z=2 * correction.z) if abs(value) == wanted else correction

    monkeypatch.setattr(NewtonCorrector, "correct", correct)
    branch = follow_family(
        Chain(2, 1.0, 0.0, 1.0), 1, 1.0, at_Omega=[wanted, 1.5], corrector="newton", walker="arclength"
    )
    assert branch.misses == {"Omega": (wanted,)}
    assert "no orbit was found at Omega = 1.48, which the family passes" in branch.reason
    assert [o.Omega for o in branch.orbits if o.point.requested] == [1.5]
    with pytest.raises(ArithmeticError, match=r"at: no orbit was found at Omega = 1\.48"):
        branch.at(Omega=wanted)
    for limit, misses in ((1.47, {}), (1.49, {"Omega": (wanted,)})):
        stopped = follow_family(
            Chain(2, 1.0, 0.0, 1.0), 1, 1.0, at_Omega=[wanted, 1.5], corrector="newton", walker="arclength",
            until=lambda orbit, limit=limit: orbit.Omega > limit,
        )  # fmt: skip
        assert stopped.misses == misses
        assert stopped.complete == (not misses)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "at: given nothing; accepted: one of S, Omega, period"),
        ({"S": 0.5, "Omega": 1.5}, "at: given S and Omega; accepted: one of S, Omega, period"),
        ({"Omega": -1.0}, r"at: given Omega = -1\.0; accepted: a finite number > 0"),
        ({"period": np.inf}, "at, period: given inf; accepted: a finite number"),
        ({"Omega": 7.0}, r"at: given Omega = 7\.0, which = 0; the branch covers .* and passes Omega 0 times"),
        ({"Omega": 1.5, "which": 1}, "passes Omega 1 times"),
    ],
)
def test_at_refuses_what_it_cannot_mean(given: dict[str, float], message: str) -> None:
    branch = follow_family(Chain(2, 1.0, 0.0, 1.0), 1, 1.0, corrector="newton")
    with pytest.raises(ValueError, match=message):
        branch.at(**given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"at_Omega": (1.0, 1.0)}, "at_Omega: given 1.0 as item 2 again; accepted: each number once"),
        ({"at_Omega": (0.0,)}, "at_Omega: given .*finite numbers > 0"),
        (
            {"at_period": (9.0,), "period_max": 8.0},
            "at_period: given 9.0 as item 1; accepted: numbers <= period_max = 8.0",
        ),
        ({"period_max": 3.0}, r"period_max: given 3\.0; accepted: a finite number > 3\.6275\d* \(the period of linear"),
        ({"max_points": 0}, "max_points: given 0; accepted: a whole number >= 1"),
    ],
)
def test_requests_out_of_range_are_refused_by_name(given: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        family_request(Chain(1, 1.0, 0.0, -1.0), 1, 2.0, **given)  # type: ignore[arg-type]


# The limit on points ------------------------------------------------------------------------------------------------

WANDERING = Chain(5, 0.71, 0.3, -1.0)


@WALKERS
@pytest.mark.parametrize("limit", [1, pytest.param(137, marks=pytest.mark.slow)])
def test_a_family_ends_after_its_points_and_tells_what_it_did(walker: str, limit: int) -> None:
    branch = follow_family(WANDERING, 1, 6.0, corrector="newton", walker=walker, max_points=limit)
    assert len(branch) == limit
    assert branch.end is End.POINTS
    assert not branch.complete
    assert f"{limit} points, largest S = {branch.S.max():.6g}" in branch.reason
    assert f"max_points above {limit}" in branch.reason
    assert "does not exist" not in branch.reason


def test_a_family_of_exactly_as_many_points_is_complete() -> None:
    chain = Chain(2, 1.0, 0.3, 1.0)
    whole = follow_family(chain, 1, 1.0, corrector="newton")
    assert follow_family(chain, 1, 1.0, corrector="newton", max_points=len(whole)).complete
    assert not follow_family(chain, 1, 1.0, corrector="newton", max_points=len(whole) - 1).complete


@WALKERS
def test_points_before_an_interruption_count(walker: str) -> None:
    request = family_request(WANDERING, 1, 6.0, corrector="newton", walker=walker, max_points=60)
    whole = list(BranchRun(Family(request)))
    cut = max(i for i, o in enumerate(whole[:40]) if isinstance(o, Orbit) and o.point.walked)
    again = BranchRun(Family(request), solutions=[o for o in whole[: cut + 1] if isinstance(o, Orbit)])
    list(again)
    assert len(again.solutions) == 60
    assert again.branch().end is End.POINTS
    assert again.branch().S[-1] == pytest.approx(whole[-1].S, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("walker", [pytest.param("arclength", marks=pytest.mark.slow), "series"])
def test_a_run_that_is_taken_up_again_has_the_same_points_at_Omega_with_the_same_errors(walker: str) -> None:
    period = 2 * np.pi / 0.13
    request = family_request(
        Chain(1, -1.0, 0.0, -1.0), 1, 2.0, corrector="newton", walker=walker,
        at_Omega=(0.5, 0.2), at_period=(period,), period_max=60.0,
    )  # fmt: skip
    whole = [o for o in BranchRun(Family(request)) if isinstance(o, Orbit)]
    records = [point_record("mode 1", k, o.point) for k, o in enumerate(whole)]
    for cut in (len(whole) // 3, len(whole) // 2, len(whole) - 1):
        known = known_of(records[:cut], "mode 1", Family(request), False)
        assert (known.fault, known.kept) == ("", cut)
        walk = BranchRun(Family(request), solutions=known.solutions)
        assert len(list(walk)) == len(whole) - cut  # nothing is computed twice
        again = walk.branch()
        assert again.complete
        assert [o.Omega for o in again.orbits] == [o.Omega for o in whole]
        assert [o.S_error for o in again.orbits] == [o.S_error for o in whole]
        assert [o.period for o in again.orbits if o.point.requested][-1] == period


def test_what_was_missed_is_kept_in_the_journal() -> None:
    tools = Family(family_request(Chain(2, 1.0, 0.3, 1.0), 1, 1.0, corrector="newton", at_Omega=(9.0,)))
    known = known_of([EndRecord("mode 1", 0, End.LIMIT, "words")], "mode 1", tools, False)
    missed = [tools.target("Omega", 9.0)]
    restored = BranchRun(tools, missed=missed).branch(known.end.end, known.end.detail)
    assert (restored.end, restored.detail, restored.misses) == (End.LIMIT, "words", {"Omega": (9.0,)})
    assert not restored.complete
