"""Every change of stability of random families: the list does not depend on how the family was followed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from effort import examples
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
from symplectic_families import Entries, SymplecticFamily, cluster, cubic

from casadi_skin import Chain, follow_family
from casadi_skin.follow.family_changes import family_tongues
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.find_changes import find_changes

tenths, hundredths = (st.integers(1, most).map(lambda k, size=size: k / size) for most, size in ((15, 10), (50, 100)))
chains = st.builds(Chain, st.integers(3, 10), tenths, hundredths, st.sampled_from([-1.0, 1.0]))


def diagram_of(chain: Chain, mode: int, S_max: float, **method: Any) -> StabilityDiagram:
    branch = follow_family(chain, mode, S_max, **method)
    return family_tongues(branch.space, (branch.start, *(orbit.point for orbit in branch.orbits)))


@examples(5, deadline=None)
@given(chains, st.integers(1, 3), st.integers(5, 12).map(lambda k: k / 10))
def test_the_list_is_the_same_by_every_way_along_the_family(chain: Chain, mode: int, S_max: float) -> None:
    """Of any two lists the changes agree one by one: kind, order, and the place within the error bars of both."""
    first = diagram_of(chain, mode, S_max, tolerance=1e-9)
    at = [0.13 * S_max, 0.61 * S_max]
    for method in ({"tolerance": 1e-5, "at": at}, {"tolerance": 1e-11}, {"tolerance": 1e-7, "walker": "arclength"}):
        other = diagram_of(chain, mode, S_max, **method)
        assert first.complete
        assert other.complete
        assert len(first.changes) == len(other.changes)
        for a, b in zip(first.changes, other.changes, strict=True):
            assert (a.kind, a.stable_before, a.stable_after) == (b.kind, b.stable_before, b.stable_after)
            assert abs(a.S - b.S) <= a.S_error + b.S_error + 1e-14


def random_cluster(seed: int) -> Entries:
    """Three to five modes of random signatures that all pull at one another."""
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 6))
    signs = random.choice([-1, 1], count).tolist()
    constants, slopes, bends = 1.5 + random.uniform(-0.6, 0.6, count), *random.uniform(-1.0, 1.0, (2, count))
    squares = [cubic(a, b, 0.6 * c) for a, b, c in zip(constants, slopes, bends, strict=True)]
    couplings = np.triu(random.normal(size=(count, count)), 1) * 10.0 ** random.uniform(-3.0, -0.8)
    return cluster(squares, signs, couplings + couplings.T)


@examples(10, deadline=None)
@given(st.integers(0, 10**6))
def test_modes_that_all_pull_at_one_another_are_unstable_where_their_frequencies_say_so(seed: int) -> None:
    entries = random_cluster(seed)
    diagram = find_changes(SymplecticFamily([entries]))
    assert diagram.complete
    edges = np.array([edge.S for edge in (*diagram.changes, *diagram.further)])
    for s in np.linspace(0.0, 1.0, 402)[1:-1].tolist():
        A, B = entries(s)
        squares = np.linalg.eigvals(B @ A)
        if np.min(np.abs(edges - s), initial=1.0) > 1e-6:
            assert diagram.is_stable(s) == bool(np.all((np.abs(squares.imag) < 1e-9) & (squares.real > 0.0)))
