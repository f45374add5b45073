"""PNG files, read back by Pillow."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from casadi_skin.results.figures.style import save, style


@pytest.mark.parametrize("size", [(1.0, 0.5), (2.345, 1.077)])
def test_other_readers_of_png_see_what_matplotlib_draws(size: tuple[float, float], tmp_path: Path) -> None:
    figure = Figure(figsize=size)
    figure.add_axes((0.1, 0.1, 0.8, 0.8)).plot([0.0, 1.0, 0.3], color="tab:red")
    (path,) = save(figure, tmp_path / "own")
    with style():
        figure.savefig(tmp_path / "matplotlib.png", dpi=200)
    with Image.open(path) as own, Image.open(tmp_path / "matplotlib.png") as other:
        assert own.mode == "RGB"
        assert own.info["dpi"] == pytest.approx((200.0, 200.0), abs=0.01)
        assert np.array_equal(np.asarray(own), np.asarray(other)[..., :3])
        assert np.ptp(np.asarray(own)) > 100
