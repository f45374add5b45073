"""A branch of orbits or solutions of any model against its parameter; one of them in time and in its phase plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.figures.style import blank, colours, finished, number, style
from casadi_skin.orbits.periodic_orbit import PeriodicOrbit
from casadi_skin.results.branch import BranchPoint, fold_marks, requested_marks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.runs.model_request import ModelRequest

SAMPLES = 2001  # of an orbit
SHOWN = 6  # states drawn against time
DASHES: tuple[Any, ...] = ("-", (0, (5.0, 1.6)), (0, (1.0, 1.2)), (0, (5.0, 1.4, 1.0, 1.4)), (0, (3.0, 3.0)),
                           (0, (1.0, 3.0)))  # fmt: skip
LOOKS: dict[bool | None, dict[str, Any]] = {
    True: {"label": "stable", "lw": 2.0},
    False: {"label": "unstable", "lw": 1.4, "ls": (0, (3.0, 1.6))},
    None: {"lw": 1.2},
}


def branch_figure(request: ModelRequest, points: Sequence[BranchPoint]) -> Figure:
    """Largest and smallest value of the first state, and the period or the largest multiplier, against the parameter.

    Stable solid, unstable dashed; folds and points asked for are marked. Raises ValueError without a continuation.
    """
    if request.scene.continuation is None:
        raise ValueError("branch_figure: given a scene without [continuation]; accepted: one with it")
    parameter = request.scene.continuation.parameter
    p = np.array([point.solution.parameters[parameter] for point in points])
    state = _plain(request.model.state_names[0])
    low, high = (np.array([point.extremes[i][0] for point in points]) for i in (0, 1))
    panels: list[tuple[str, list[Array]]] = [(f"{state}: largest and smallest value", [high, low])]
    panels += _second_panel(request, points)
    with style():
        figure = blank(6.0, 3.6 if len(panels) == 1 else 5.6)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (label, curves) in zip(axes, panels, strict=True):
            for curve, colour in zip(curves, colours(len(curves)), strict=True):
                _draw_curve(panel, request, points, p, curve, colour)
            panel.set_ylabel(label)
        axes[-1].set_xlabel(_plain(parameter))
        axes[0].set_title(_title(request, points[0], without=parameter))
        return finished(figure, axes, 4, in_black=True)


def _second_panel(request: ModelRequest, points: Sequence[BranchPoint]) -> list[tuple[str, list[Array]]]:
    """The period where it is unknown, else the largest multiplier where there are multipliers."""
    if request.problem is not None:
        return []
    if not request.model.forced:
        return [("period", [np.array([_period(point) for point in points])])]
    if any(point.multipliers is None for point in points):
        return []
    largest = [np.abs(m.others).max() for m in (point.multipliers for point in points) if m is not None]
    return [("largest |multiplier|", [np.array(largest)])]


def _period(point: BranchPoint) -> float:
    solution = point.solution
    return solution.period if isinstance(solution, PeriodicOrbit) else float("nan")


def _draw_curve(
    axes: Axes, request: ModelRequest, points: Sequence[BranchPoint], x: Array, y: Array, colour: Array
) -> None:
    stable = [None if point.multipliers is None else point.multipliers.stable for point in points]
    rows, folds = np.column_stack([x, y]), fold_marks(points)
    for first, last, held in _stretches(stable):
        head = [_joint(rows, folds, first - 1)] if first > 0 else []
        tail = [_joint(rows, folds, last)] if last < len(points) - 1 else []
        axes.plot(*np.vstack([*head, rows[first : last + 1], *tail]).T, color=colour, zorder=3, **LOOKS[held])
    marks: tuple[tuple[list[bool], str, dict[str, Any]], ...] = (
        (folds, "fold", {"marker": "D", "ms": 5, "mfc": "0.6"}),
        (requested_marks(request, points), "asked for", {"marker": "o", "ms": 4.5, "mfc": "white"}),
    )
    for which, label, look in marks:
        if any(which):
            axes.plot(x[which], y[which], ls="none", mec="black", label=label, zorder=5, **look)


def _stretches(stable: Sequence[bool | None]) -> list[tuple[int, int, bool | None]]:
    """First and last place of each stretch with the same stability."""
    starts = [0, *(i for i in range(1, len(stable)) if stable[i] != stable[i - 1])]
    ends = [*(i - 1 for i in starts[1:]), len(stable) - 1]
    return [(first, last, stable[first]) for first, last in zip(starts, ends, strict=True)]


def _joint(rows: Array, folds: Sequence[bool], i: int) -> Array:
    """Where stability changes between a point and the next: at the fold, if one of them is, else midway."""
    if folds[i] or folds[i + 1]:
        return np.asarray(rows[i if folds[i] else i + 1])
    return np.asarray(0.5 * (rows[i] + rows[i + 1]))


def orbit_figure(request: ModelRequest, point: BranchPoint) -> Figure:
    """The first states against time over the interval or the period and, of two or more, the plane of the first two."""
    solution, names = point.solution, request.model.state_names
    start, end = (0.0, solution.period) if isinstance(solution, PeriodicOrbit) else solution.interval
    t = np.unique(np.concatenate([np.linspace(start, end, SAMPLES), np.clip(solution.t, start, end)]))
    x = solution.evaluate(t)
    with style():
        figure = blank(8.0 if len(names) > 1 else 5.0, 3.6)
        axes = figure.subplots(1, 2 if len(names) > 1 else 1, squeeze=False)[0]
        for i, colour in enumerate(colours(min(len(names), SHOWN))):
            axes[0].plot(t, x[:, i], color=colour, ls=DASHES[i], lw=1.4, label=_plain(names[i]))
        more = f" (first {SHOWN} of {len(names)})" if len(names) > SHOWN else ""
        axes[0].set(xlabel="t", ylabel=f"states{more}", xlim=(start, end))
        if len(names) > 1:
            axes[1].plot(x[:, 0], x[:, 1], color="black", lw=1.4)
            words = "t = 0" if isinstance(solution, PeriodicOrbit) else f"t = {start:.4g}"
            axes[1].plot(x[0, 0], x[0, 1], "o", ms=5, mfc="white", mec="black", label=words)
            axes[1].set(xlabel=_plain(names[0]), ylabel=_plain(names[1]))
        figure.suptitle(_title(request, point))
        return finished(figure, axes, SHOWN + 1)


def _title(request: ModelRequest, point: BranchPoint, without: str = "") -> str:
    known = point.solution.parameters
    names = [name for name in request.model.parameter_names if name != without][:SHOWN]
    free = () if request.problem is None else request.problem.free
    shown = [f"{_plain(n)} = ${number(known[n])}$" for n in names if not (without and n in free)]
    if isinstance(point.solution, PeriodicOrbit) and not without:
        shown.append(f"period ${number(point.solution.period)}$")
    return f"{_plain(request.scene.title or request.model.name)}{': ' if shown else ''}{', '.join(shown)}"


def _plain(name: str) -> str:
    """A name that a user chose, without mathematics in it."""
    return name.replace("$", r"\$")
