"""Films of a breathing mode."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from casadi_skin import Chain, Orbit, follow_family
from casadi_skin.results.figures.solutions import animate


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    return follow_family(Chain(5, 1.0, 0.25, -1.0), 1, 0.5, at=[0.5], corrector="newton").at(S=0.5)


def test_a_film_has_its_frames_moves_and_repeats(orbit: Orbit, tmp_path: Path) -> None:
    path = animate(orbit, tmp_path / "mode.gif", frames=4)
    with Image.open(path) as film:
        assert film.n_frames == 4
        assert film.info["loop"] == 0
        pictures = []
        for frame in range(4):
            film.seek(frame)
            pictures.append(np.array(film.convert("L"), dtype=float))
    assert np.abs(pictures[0] - pictures[2]).max() > 100  # half a period later all displacements are reversed
    assert [p.name for p in tmp_path.iterdir()] == ["mode.gif"]


@pytest.mark.parametrize(("name", "frames"), [("mode.avi", 8), ("mode.gif", 1)])
def test_what_is_no_film_is_refused(orbit: Orbit, tmp_path: Path, name: str, frames: int) -> None:
    with pytest.raises(ValueError, match="accepted"):
        animate(orbit, tmp_path / name, frames=frames)
    assert not list(tmp_path.iterdir())
