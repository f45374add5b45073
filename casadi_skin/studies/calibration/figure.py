"""The picture of an error calibration: estimated against true errors."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from matplotlib.figure import Figure

from casadi_skin.figures.style import blank, finished, style
from casadi_skin.studies.calibration.cases import Outcome
from casadi_skin.studies.study import letter

LOWEST = 1e-17  # of the axes, where smaller errors are drawn
SIZE = (8.6, 3.7)
MARKERS = {  # quantity: label, marker, its edge and face
    "Omega": (r"$\Omega$", "o", "black", "none"),
    "profile": ("profile", "^", "0.35", "0.8"),
    "multipliers": ("multipliers", "x", "0.2", "none"),
}


def calibration_figure(outcomes: Iterable[Outcome]) -> Figure:
    """Estimated against true error, a panel and a marker a quantity, both relative to its size."""
    drawn = [q for outcome in outcomes for q in outcome.quantities]
    finite = [q.estimate / q.scale for q in drawn if math.isfinite(q.estimate)]
    highest = 10.0 ** math.ceil(math.log10(max([1e-3, *finite, *(q.relative for q in drawn)])))
    ends, ticks = np.array([LOWEST, highest]), 10.0 ** np.arange(-16, math.log10(highest), 4)
    with style():
        figure = blank(*SIZE)
        panels = figure.subplots(1, len(MARKERS), sharey=True)
        for axes, name, panel in zip(panels, MARKERS, "abc", strict=True):
            label, marker, edge, face = MARKERS[name]
            pairs = [(q.relative, min(q.estimate / q.scale, highest)) for q in drawn if q.name == name]
            true, estimate = np.maximum(np.array(pairs).reshape(-1, 2), LOWEST).T
            axes.fill_between(ends, ends / 10.0, LOWEST, color="0.9", linewidth=0)
            axes.loglog(ends, ends, "k-", linewidth=0.9, label="estimate = true error")
            axes.loglog(ends, ends / 10.0, "k--", linewidth=0.9, label="estimate = a tenth of it")
            if pairs:  # the layout fails on markers of nothing that are not clipped
                axes.loglog(
                    true, estimate, marker, markersize=4.0, markeredgewidth=0.7, markeredgecolor=edge,
                    markerfacecolor=face, clip_on=False,
                )  # fmt: skip
            axes.set(xlim=ends, ylim=ends, xticks=ticks, yticks=ticks, aspect="equal", xlabel="true relative error")
            letter(axes, panel, label)
        panels[0].set_ylabel("estimated relative error")
        return finished(figure, panels, columns=2)
