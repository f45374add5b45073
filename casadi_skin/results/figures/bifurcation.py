"""Bifurcation diagrams: branches of equilibria and cycles against a parameter; curves in two parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium
from casadi_skin.results.extremes import extremes
from casadi_skin.results.figures.branch_lines import LOOKS, MARKS, PLAIN, label_of, smooth, stability_pieces
from casadi_skin.results.figures.style import amplitude_label, blank, colours, finished, plain, style
from casadi_skin.results.figures.style import title as model_title
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.points.edges import EdgeCurve

DASHED, DOTTED = (0, (4.0, 1.4)), (0, (1.0, 1.2))
CURVES = {  # words and dashes of a curve of special points, by kind and whether they are orbits
    ("fold", False): ("folds", "-"),
    ("hopf", False): ("Hopf points", DASHED),
    ("branch point", False): ("branch points", DOTTED),
    ("period doubling", False): ("period doublings", DASHED),
    ("torus", False): ("tori", DOTTED),
    ("fold", True): ("folds of cycles", "-"),
    ("period doubling", True): ("period doublings", DASHED),
    ("torus", True): ("tori", DOTTED),
    ("branch point", True): ("branch points of cycles", DOTTED),
}
WIDTHS = {False: 1.5, True: 2.8}  # of lines of equilibria, and of cycles


def bifurcation_figure(branches: Sequence[Branch], title: str = "", state: int = 0) -> Figure:
    """A state of equilibria, and its largest and smallest value along cycles, against the parameter.

    Arguments:
        branches: branches of equilibria and orbits in one parameter.
        title: stands in place of the name of the model.
        state: place of the state among its names, from 0.

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
    name = plain(first.space.state_names[state])
    rest, cycle = colours(2)
    with style():
        figure = blank(6.4, 4.2)
        axes = figure.subplots()
        for branch in held:
            orbits = isinstance(branch.solutions[0], Orbit)
            for heights in _heights(branch, state):
                path = np.column_stack([branch.values, heights])
                _draw(axes, branch, path, cycle if orbits else rest)
                _mark(axes, branch, path)
        equilibria = [isinstance(branch.solutions[0], Equilibrium) for branch in held]
        both = f"{name}, of cycles largest and smallest" if any(equilibria) else f"{name}: largest and smallest value"
        what = name if all(equilibria) else both
        axes.set(xlabel=plain(held[0].parameter), ylabel=what)
        axes.set_title(_title(held[0], title, (held[0].parameter,)), y=1.0)
        return finished(figure, [axes], 3, plain=True)


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
    planes = {(curve.parameter, *curve.space.free[:1]) for curve in curves if getattr(curve.space, "kind", "")}
    if len(planes) != 1 or len(next(iter(planes))) != 2:
        raise ValueError("curves: given branches of other kinds or in other parameters; accepted: curves in one plane")
    second, first = next(iter(planes))
    with style():
        figure = blank(6.0, 4.4)
        axes = figure.subplots()
        looks = [(str(curve.space.kind), isinstance(curve.solutions[0], Orbit)) for curve in curves]  # type: ignore[attr-defined]
        order = [look for look in CURVES if look in looks]
        for curve, look in zip(curves, looks, strict=True):
            words, dashes = CURVES[look]
            path = np.column_stack([curve[first], curve[second]])
            colour = colours(max(2, len(order)))[order.index(look) if len(order) > 1 else int(look[0] == "hopf")]
            axes.plot(*smooth(path).T, ls=dashes, lw=1.8, color=colour, label=words)
            _mark(axes, curve, path)
        axes.set(xlabel=plain(first), ylabel=plain(second))
        axes.set_title(_title(curves[0], title, (first, second)), y=1.0)
        return finished(figure, [axes], 4, plain=True)


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
    model, name = curves[0].points[0].orbit.model, curves[0].parameter
    words = {"real": "through 1 or -1", "complex": "Krein collisions"}
    with style():
        figure = blank(6.0, 4.4)
        axes = figure.subplots()
        kinds = [*words, *sorted({curve.kind for curve in curves} - set(words))]
        for kind, colour in zip(kinds, colours(len(kinds)), strict=True):
            alike = [curve for curve in curves if curve.kind == kind]
            for k, curve in enumerate(alike):
                path = np.column_stack([curve[name], curve.S])
                axes.plot(*smooth(path).T, lw=1.4, color=colour, label=words.get(kind, kind) if k == 0 else None)
        axes.set(xlabel=plain(name), ylabel=amplitude_label(model))
        axes.set_title(title or f"edges of tongues of {getattr(model, 'name', 'the chain')}", y=1.0)
        return finished(figure, [axes], 4, plain=True)


def _has_orbits(branch: Branch) -> bool:
    return isinstance(branch.solutions[0], Orbit)


def _heights(branch: Branch, state: int) -> list[Array]:
    """A state along a branch: its value at equilibria, its largest and smallest along orbits."""
    if isinstance(branch.solutions[0], Equilibrium):
        return [np.array([solution.evaluate(0.0)[state] for solution in branch.solutions])]
    low, high = np.array([[side[state] for side in extremes(solution)] for solution in branch.solutions]).T
    return [high, low]


def _draw(axes: Axes, branch: Branch, path: Array, colour: object) -> None:
    first = branch.solutions[0]
    kind = "equilibria" if isinstance(first, Equilibrium) else "cycles" if _has_orbits(branch) else "solutions"
    for stable, piece in stability_pieces(branch, path):
        look = {**LOOKS[stable], "lw": WIDTHS[_has_orbits(branch)]}
        known = look.pop("label")
        words = label_of(kind if kind == "solutions" and stable is None else f"{kind}, {known}", piece, path)
        axes.plot(*smooth(piece).T, color=colour, zorder=3, label=words, **look)


def _mark(axes: Axes, branch: Branch, path: Array) -> None:
    """A symbol for each special point."""
    for kind in dict.fromkeys(solution.point.special for solution in branch.solutions):
        if not kind:
            continue
        marker, face = MARKS.get(kind, PLAIN)
        places = [i for i, solution in enumerate(branch.solutions) if solution.point.special == kind]
        axes.plot(*path[places].T, marker, color="black", ms=6, mfc=face, mec="black", ls="none", label=kind, zorder=5)


def _title(branch: Branch, title: str, without: tuple[str, ...]) -> str:
    solution = branch.solutions[0]
    names = (*without, *branch.space.free)
    known = {key: value for key, value in solution.parameters.items() if key not in names}
    return model_title(solution.space.model, known, title)
