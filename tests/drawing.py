"""Runs without the work of drawing: nine tenths of a small one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


def blank_pictures(patch: pytest.MonkeyPatch) -> None:
    """Empty files in place of pictures and films."""
    from matplotlib.figure import Figure  # here: numpy comes with it, after the number of threads is set

    drawn_savefig = Figure.savefig

    def write(drawn: Any, path: Any, *rest: Any, **more: Any) -> None:
        if not isinstance(path, (str, Path)):  # drawn into memory, where it may be kept for other tests: an FMU's icon
            drawn_savefig(drawn, path, *rest, **more)
            return
        Path(path).touch()
        drawn._draw_was_started = True  # a film that was not drawn warns

    patch.setattr("matplotlib.figure.Figure.savefig", write)
    patch.setattr("matplotlib.animation.Animation.save", write)
    patch.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: None)
    patch.setattr("casadi_skin.figures.style.lay_out", lambda *_: None)
