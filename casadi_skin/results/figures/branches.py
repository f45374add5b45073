"""Branches against a parameter: lines by stability with marks of special points, bifurcation diagrams, curves, edges.

A branch is a path in the plane; `stability_pieces` cuts it where stability changes, `smooth` bends it, and one table
has the looks of stable and unstable stretches, and `KINDS` those of special points and their curves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS, SOLUTIONS
from casadi_skin.results.figures import style
from casadi_skin.results.quantities import extremes
from casadi_skin.zero.kinds import HOPF, KINDS, kind_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import End
from casadi_skin.zero.stated_problem import PERIOD

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.points.edges import EdgeCurve

SAME_PLACE = 5e-3  # of the extent of a branch: a distance that a picture does not show
STABILITY_LOOKS: dict[bool | None, dict[str, Any]] = {
    True: {"label": "stable", "lw": 2.0},
    False: {"label": "unstable", "lw": 2.0, "ls": (0, (3.0, 1.6))},
    None: {"label": "stability not computed", "lw": 0.9},
}
LINE_WIDTHS = {False: 1.5, True: 2.8}  # of lines of equilibria, and of cycles
CLOSE_MARK_DISTANCE = 0.008  # of the width of a picture: marks that are closer overlap
ROUNDING_CHANGE = 1e-6  # of a quantity: a change that is no course of a curve
FEWEST_SMOOTH_POINTS, POINTS_BETWEEN = 4, 12  # through which a curve is drawn smooth, and drawn between two of them
STRIP_HEIGHT = 0.025  # of the height of a picture: a strip along its lower edge
Pieces = Sequence[tuple[bool | None, Array]]


# Branches as lines in a plane -----------------------------------------------------------------------------------------


def stability_pieces(branch: Branch, path: Array) -> list[tuple[bool | None, Array]]:
    """Stretches of a path with one stability each, neighbours sharing the change between them.

    Arguments:
        branch: the branch.
        path: its points in the plane, shape (points, 2), in its order; the quantity followed comes first, and where
            there is one point more than solutions, that is the limit that the branch starts from.

    Returns:
        Stability of each stretch (None: not computed), and its points. A change that was not located is placed at the
        fold, where one of its two points is that, else midway.
    """
    if not branch.with_stability or not branch.solutions:
        return [(None, path)]
    stable = np.append(np.repeat(branch.stable[:1], len(path) - len(branch)), branch.stable)
    flips = np.flatnonzero(stable[1:] != stable[:-1])
    located, at_fold = len(branch.located) >= flips.size, special_places(branch, path)
    pieces: list[tuple[bool | None, Array]] = []
    rest = path[:0]
    for index, (flip, first) in enumerate(zip(flips, np.append(0, flips + 1), strict=False)):
        before, after = path[flip], path[flip + 1]
        joint = 0.5 * (before + after)
        if located:
            value = branch.located[index].value
            part = (value - before[0]) / ((after[0] - before[0]) or 1.0)
            joint = np.array([value, before[1] + part * (after[1] - before[1])])
        elif flip in at_fold or flip + 1 in at_fold:
            joint = before if flip in at_fold else after
        pieces.append((bool(stable[flip]), np.vstack([rest, path[first : flip + 1], joint])))
        rest = joint[None]
    return [*pieces, (bool(stable[-1]), np.vstack([rest, path[flips[-1] + 1 if flips.size else 0 :]]))]


def smooth(path: Array) -> Array:
    """A curve through points of the plane by modified Akima splines, which do not overshoot.

    Arguments:
        path: the points in their order, shape (points, 2).

    Returns:
        The points with others between them, shape (more, 2); the points alone where they are fewer than four.
    """
    from scipy.interpolate import Akima1DInterpolator

    extent = np.maximum(np.ptp(path, axis=0), ROUNDING_CHANGE * np.max(np.abs(path), axis=0, initial=0.0))
    lengths = np.hypot(*(np.diff(path, axis=0) / np.where(extent > 0.0, extent, 1.0)).T)
    places = np.append(0.0, np.cumsum(lengths))
    apart = np.append(True, ~(np.diff(places) <= 0.0))  # also from what is lost in the sum
    path, places = path[apart], places[apart]
    if len(path) < FEWEST_SMOOTH_POINTS or not np.all(np.isfinite(places)):
        return path
    parts = np.linspace(0.0, 1.0, POINTS_BETWEEN + 1, endpoint=False)
    between = places[:-1, None] + np.diff(places)[:, None] * parts
    curve = Akima1DInterpolator(places, path, method="makima")(between)
    curve[:, 0] = path[:-1]
    return np.vstack([curve.reshape(-1, 2), path[-1:]])


def special_places(branch: Branch, path: Array) -> dict[int, str]:
    """Kinds of the special points that were located while the branch was followed, by their places in a path."""
    lead = len(path) - len(branch)
    return {lead + i: s.point.special for i, s in enumerate(branch.solutions) if s.point.special}


def courses(branch: Branch, state: int) -> list[Array]:
    """A state along a branch: its value at equilibria, its largest and its smallest along orbits and solutions."""
    if branch.space.connects == EQUILIBRIA:
        return [np.array([solution.evaluate(0.0)[state] for solution in branch.solutions])]
    low, high = np.array([[side[state] for side in extremes(solution)] for solution in branch.solutions]).T
    return [high, low]


def draw_pieces(axes: Axes, branch: Branch, path: Array, pieces: Pieces, colour: Any, kind: str = "") -> None:
    """The path of a branch in pieces, as `stability_pieces` makes them.

    Pieces of one stability are one line with gaps between them: a line takes a fifth of a millisecond, a gap nothing.
    With a `kind` of solutions their lines are smooth and labelled by it too, and those of orbits are broader.
    """
    space, gap, extent = branch.space, np.full((1, 2), np.nan), SAME_PLACE * np.ptp(path, axis=0)
    closed = space.connects == ORBITS
    for stable in dict.fromkeys(stable for stable, _ in pieces):
        alike = [piece for known, piece in pieces if known is stable]
        parts = map(smooth, alike) if kind or space.kind else alike
        look = STABILITY_LOOKS[stable]
        if space.kind:
            words, dashes = KINDS[space.kind].line
            alone = not (closed and KINDS[space.kind].of_equilibria)
            look = {"lw": 1.8, "ls": dashes, "label": words if alone else f"{words} of cycles"}
        elif kind:
            silent = stable is None and kind != "cycles" and space.connects != EQUILIBRIA
            look = {**look, "lw": LINE_WIDTHS[closed], "label": kind if silent else f"{kind}, {look['label']}"}
        if len(path) > 1 and not np.any(np.sum([np.ptp(piece, axis=0) for piece in alike], axis=0) > extent):
            look = {**look, "label": "_nolegend_"}  # too short to be seen
        axes.plot(*np.vstack([line for part in parts for line in (gap, part)])[1:].T, color=colour, zorder=3, **look)


def draw_changes(axes: Axes, branch: Branch, path: Array, pieces: Pieces, strip: bool = False) -> None:
    """Marks where stability changes between pieces of a path, but for those at special points.

    With `strip`, changes whose marks would overlap are shown by a strip along the lower edge, dark where unstable.
    """
    joints, special = np.array([piece[-1] for _, piece in pieces[:-1]]).reshape(-1, 2), special_places(branch, path)
    near = np.abs(joints[:, None] - path[list(special)]) <= SAME_PLACE * np.ptp(path, axis=0)
    joints = joints[~np.any(np.all(near, axis=2), axis=1)]  # the others have the mark of the special point
    if joints.size and strip and np.all(np.diff(path[:, 0]) > 0.0) and crowded(joints[:, 0]):
        bars = [(piece[0, 0], np.ptp(piece[:, 0])) for stable, piece in pieces if stable is False]
        look: dict[str, Any] = {"fc": "0.25", "ec": "none", "transform": axes.get_xaxis_transform(), "zorder": 4}
        axes.broken_barh(bars, (0.0, STRIP_HEIGHT), label="unstable, along the amplitude", **look)
    elif joints.size:
        axes.plot(*thinned(joints).T, "|", ms=7, mew=0.9, color="black", label="change of stability", zorder=5)


def crowded(places: Array) -> bool:
    """Whether marks at places along an axis would overlap."""
    return bool(np.any(np.diff(np.sort(places)) < CLOSE_MARK_DISTANCE * np.max(np.abs(places), initial=0.0)))


def thinned(places: Array) -> Array:
    """Marks of shape (marks, 2) without those that would overlap the one before along the axis."""
    least, kept = 2.0 * CLOSE_MARK_DISTANCE * np.max(np.abs(places[:, 0])), [0]
    for i in range(1, len(places)):
        if np.abs(places[i, 0] - places[kept[-1], 0]) >= least:
            kept.append(i)
    return np.asarray(places[kept])


def draw_special(axes: Axes, branch: Branch, path: Array, size: float) -> None:
    """A symbol for each special point."""
    places = special_places(branch, path)
    for kind in dict.fromkeys(places.values()):
        points = path[[i for i, found in places.items() if found == kind]]
        marker, face = kind_of(kind).mark
        look: dict[str, Any] = {"mfc": face, "mec": "black", "ls": "none", "zorder": 5}
        axes.plot(*points.T, marker, color="black", ms=size, label=kind, **look)


def draw_marks(axes: Axes, branch: Branch, path: Array, colour: Any) -> None:
    """Marks of special points, of values that were requested, and of an early end."""
    draw_special(axes, branch, path, 5)
    marked = [len(path) - len(branch) + i for i, solution in enumerate(branch.solutions) if solution.point.requested]
    if marked:
        look: dict[str, Any] = {"mfc": "white", "mec": colour, "label": "requested", "zorder": 6, "clip_on": False}
        axes.plot(*path[marked].T, "o", color=colour, ms=4, **look)
    if branch.end not in (End.REACHED, End.RETURNED, End.CLOSED, End.UNBOUNDED) and not branch.stopped:
        axes.plot(*path[-1], "x", ms=6, color="black", label="ended early", zorder=7)


def solution_title(solution: Solution, name: str = "", without: Iterable[str] = ()) -> str:
    """The model of a solution, or `name` in its place, and the values of its parameters but for some."""
    known = {key: value for key, value in solution.parameters.items() if key not in set(without)}
    return style.title(solution.space.model, known, name)


# Branches in one parameter, and curves in two -------------------------------------------------------------------------


@style.drawn
def branch_figure(branch: Branch, title: str = "") -> Figure:
    """Largest and smallest value of the first state, and the period or the largest multiplier, against the parameter.

    Stable stretches are solid, unstable ones dashed; folds and requested points are marked.

    Arguments:
        branch: a branch of orbits or solutions in a parameter; for families see `frequency_figure`.
        title: stands in place of the name of the model.

    Returns:
        The figure.

    Raises:
        ValueError: the branch is a family, or has no solutions.
    """
    space = branch.space
    if space.connects not in (ORBITS, SOLUTIONS) or not space.parameter or not branch.solutions:
        names = {FAMILY: "a family", EQUILIBRIA: "one of equilibria, see bifurcation_figure"}
        given = names.get(space.connects, "one without a parameter or solutions")
        raise ValueError(f"branch: given {given}; accepted: a branch of orbits or solutions in a parameter")
    state = style.plain(space.state_names[0])
    from matplotlib.lines import Line2D

    panels = [(f"{state}: largest and smallest value", courses(branch, 0)), *_second_panel(branch)]
    figure = style.blank(6.0, 3.6 if len(panels) == 1 else 5.6)
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for panel, (label, curves) in zip(axes, panels, strict=True):
        for curve, colour in zip(curves, style.colours(len(curves)), strict=True):
            path = np.column_stack([branch.values, curve])
            pieces = stability_pieces(branch, path)
            draw_pieces(panel, branch, path, pieces, colour, "" if space.connects == ORBITS else "solutions")
            draw_changes(panel, branch, path, pieces)
            draw_marks(panel, branch, path, "black")
        if len(curves) == 2:
            handles = [Line2D([], [], color=colour, lw=2.0) for colour in style.colours(2)]
            panel.legend(handles, ["largest", "smallest"], loc="best")
        panel.set_ylabel(label)
    axes[-1].set_xlabel(style.plain(space.parameter))
    axes[0].set_title(solution_title(branch.solutions[0], title, (space.parameter, *space.free)), y=1.0)
    return style.finished(figure, axes, 5, in_black=True)


def _second_panel(branch: Branch) -> list[tuple[str, list[Array]]]:
    """The period where it is unknown, else the largest multiplier where there are multipliers."""
    if branch.space.connects == ORBITS and PERIOD in branch.space.free:
        return [("period", [branch.period])]
    if not branch.with_stability or not branch.orbits[0].floquet().others.size:
        return []
    return [("largest |multiplier|", [branch.max_abs_multiplier])]


@style.drawn
def bifurcation_figure(branches: Sequence[Branch], title: str = "") -> Figure:
    """The first state of equilibria, and its largest and smallest value along cycles, against the parameter.

    Arguments:
        branches: branches of equilibria and orbits in one parameter.
        title: stands in place of the name of the model.

    Returns:
        The figure: stable stretches solid, unstable ones dashed, cycles in broader lines of another colour, and a
        symbol for each kind of special point. Lines are smooth curves through the points computed.

    Raises:
        ValueError: there is no solution, or a branch is followed in another parameter.
    """
    held = [branch for branch in branches if len(branch)]
    if not held or any(branch.parameter != held[0].parameter for branch in held):
        raise ValueError("branches: given none, or several parameters; accepted: branches in one parameter")
    first = held[0].solutions[0]
    rest, cycle = style.colours(2)
    figure = style.blank(6.4, 4.2)
    axes = figure.subplots()
    for branch in held:
        closed = branch.space.connects in (FAMILY, ORBITS)
        kind = "cycles" if closed else "equilibria" if branch.space.connects == EQUILIBRIA else "solutions"
        for heights in courses(branch, 0):
            path = np.column_stack([branch.values, heights])
            draw_pieces(axes, branch, path, stability_pieces(branch, path), cycle if closed else rest, kind)
            draw_special(axes, branch, path, 6)
    at_rest = {branch.space.connects == EQUILIBRIA for branch in held}
    words = ", of cycles largest and smallest" if True in at_rest else ": largest and smallest value"
    name = style.plain(first.space.state_names[0]) + words * (False in at_rest)
    axes.set(xlabel=style.plain(held[0].parameter), ylabel=name)
    axes.set_title(solution_title(first, title, (held[0].parameter, *held[0].space.free)), y=1.0)
    return style.finished(figure, [axes], 3)


@style.drawn
def curves_figure(curves: Sequence[Branch], title: str = "") -> Figure:
    """Curves of special points in the plane of two parameters, with their points of codimension two.

    Arguments:
        curves: results of `point.curve`, all in the same two parameters.
        title: stands in place of the name of the model.

    Returns:
        The figure.

    Raises:
        ValueError: a branch is no curve in these two parameters.
    """
    planes = {(curve.parameter, *curve.space.free[:1]) for curve in curves if curve.space.kind}
    if len(planes) != 1 or len(next(iter(planes))) != 2:
        raise ValueError("curves: given branches of other kinds or in other parameters; accepted: curves in one plane")
    second, first = next(iter(planes))
    figure = style.blank(6.0, 4.4)
    axes = figure.subplots()
    looks = [(curve.space.kind, curve.space.connects == ORBITS) for curve in curves]
    order = sorted(set(looks), key=lambda look: (look[1], list(KINDS).index(look[0])))
    for curve, look in zip(curves, looks, strict=True):
        path = np.column_stack([curve[first], curve[second]])
        colour = style.colours(max(2, len(order)))[order.index(look) if len(order) > 1 else int(look[0] == HOPF)]
        draw_pieces(axes, curve, path, [(None, path)], colour)
        draw_special(axes, curve, path, 6)
    axes.set(xlabel=style.plain(first), ylabel=style.plain(second))
    axes.set_title(solution_title(curves[0].solutions[0], title, (first, second, *curves[0].space.free)), y=1.0)
    return style.finished(figure, [axes], 4)


@style.drawn
def edges_figure(curves: Sequence[EdgeCurve], title: str = "") -> Figure:
    """Edges of tongues of families in the plane of a parameter and S, with their error bars where these show.

    Arguments:
        curves: results of `Branch.edge(number).curve`, all in the same parameter.
        title: stands in place of the name of the model.

    Returns:
        The figure.

    Raises:
        ValueError: curves are in different parameters.
    """
    if len({curve.parameter for curve in curves}) != 1:
        raise ValueError("curves: given edges in different parameters, or none; accepted: edges in one parameter")
    model, words = curves[0].points[0].orbit.model, {"real": "through 1 or -1", "complex": "Krein collisions"}
    figure = style.blank(6.0, 4.4)
    axes = figure.subplots()
    kinds = [*words, *sorted({curve.kind for curve in curves} - set(words))]
    for curve in curves:
        colour, label = style.colours(len(kinds))[kinds.index(curve.kind)], words.get(curve.kind, curve.kind)
        draw_edge(axes, curve, lw=1.4, color=colour, label=label)
    axes.set_title(title or f"edges of tongues of {getattr(model, 'name', 'the chain')}", y=1.0)
    return style.finished(figure, [axes], 4)


def draw_edge(axes: Axes, curve: EdgeCurve, **look: Any) -> None:
    """A curve of edges in the plane of its parameter and S."""
    axes.plot(*smooth(np.column_stack([curve[curve.parameter], curve.S])).T, **look)
    axes.set(xlabel=style.plain(curve.parameter), ylabel=style.amplitude_label(curve.points[0].orbit.model))
