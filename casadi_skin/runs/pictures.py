"""The pictures of a run: drawn once, in the formats of its scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec

from casadi_skin.results.figures.style import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from casadi_skin.runs.scene import Scene

Arguments = ParamSpec("Arguments")


def picture(
    scene: Scene,
    stem: Path,
    draw: Callable[Arguments, Figure | None],
    *arguments: Arguments.args,
    **options: Arguments.kwargs,
) -> None:
    """Draw a figure and write it as `stem`.png and so on; a scene without formats draws nothing."""
    if scene.figures.formats:
        figure = draw(*arguments, **options)
        if figure is not None:
            save(figure, stem, scene.figures.formats)
