"""Runs without the work of drawing: nine tenths of a small one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


def blank_pictures(patch: pytest.MonkeyPatch) -> None:
    """Empty files in place of pictures and films."""

    def write(drawn: Any, path: object, **__: object) -> None:
        if isinstance(path, (str, Path)):
            Path(path).touch()
        drawn._draw_was_started = True  # a film that was not drawn warns

    patch.setattr("matplotlib.figure.Figure.savefig", write)
    patch.setattr("matplotlib.animation.Animation.save", write)
    patch.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: None)
