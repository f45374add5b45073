"""Windows of instability at random: as many, where and as wide as they are made, whatever lies beside them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
from symplectic_families import SymplecticFamily, collision, cubic

from casadi_skin.stability.tongues.find_changes import find_changes

window = st.tuples(st.floats(0.05, 0.95), st.floats(-9.0, -1.5), st.floats(0.2, 1.0), st.sampled_from([-1.0, 1.0]))


@settings(max_examples=15, deadline=None)
@given(st.lists(window, min_size=1, max_size=5))
def test_windows_of_random_places_widths_and_speeds(windows: list[tuple[float, float, float, float]]) -> None:
    """Each pair of modes has a window of its own: the union of all of them is unstable, and nothing else."""
    blocks, union = [], []
    for i, (middle, digits, speed, sign) in enumerate(windows):
        coupling = 0.25 * speed * 10.0**digits
        blocks.append(collision(cubic(-sign * speed * middle, sign * speed), coupling, square=1.0 + 1.3 * i))
    for middle, digits, _, _ in sorted(windows, key=lambda w: w[0] - 0.5 * 10.0 ** w[1]):
        a, b = middle - 0.5 * 10.0**digits, middle + 0.5 * 10.0**digits
        if union and a <= union[-1][1]:
            union[-1][1] = max(union[-1][1], b)
        else:
            union.append([a, b])
    diagram = find_changes(SymplecticFamily(blocks))
    inside = [place for pair in union for place in pair if 0.0 < place < 1.0]
    found = np.array([edge.S for edge in diagram.changes])
    assert found.size == len(inside)
    assert np.max(np.abs(found - np.array(inside)), initial=0.0) < 1e-11
    assert len(diagram.tongues) == len(windows)
