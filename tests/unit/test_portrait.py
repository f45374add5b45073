"""Phase portraits and time courses of chosen solutions."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium_models import rosenzweig_macarthur

from casadi_skin import find_equilibrium
from casadi_skin.results.figures.solutions import portrait_figure


def test_equilibria_are_points_of_the_portrait_and_more_than_six_are_refused() -> None:
    start = find_equilibrium(rosenzweig_macarthur(), [1.0, 1.0], parameters={"K": 2.0})
    other = find_equilibrium(rosenzweig_macarthur(), [1.0, 1.0], parameters={"K": 2.5})
    in_time, in_plane = portrait_figure([start, other]).axes[:2]
    assert [line.get_label() for line in in_time.lines] == ["K = 2, at rest", "K = 2.5, at rest"]
    for line, equilibrium in zip(in_plane.lines, (start, other), strict=True):
        np.testing.assert_allclose(line.get_xydata()[0], equilibrium.state)
    with pytest.raises(ValueError, match="solutions: given 7; accepted: 1 to 6"):
        portrait_figure([start] * 7)
