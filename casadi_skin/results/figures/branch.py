"""A branch of orbits or solutions of any model against its parameter; one of them in time and in its phase plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit, cosine_curve
from casadi_skin.follow.solution import Solution
from casadi_skin.results.extremes import extremes
from casadi_skin.results.figures.branch_lines import draw_lines, draw_marks, stability_pieces
from casadi_skin.results.figures.style import DASHES, blank, colours, finished, number, plain, style
from casadi_skin.results.figures.style import title as model_title
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES = 2001  # of an orbit
SHOWN = 6  # states drawn against time


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
    if not isinstance(space, BoundarySpace) or not space.parameter or not branch.solutions:
        given = "a family" if isinstance(space, Family) else "one without a parameter or solutions"
        given = "one of equilibria, see bifurcation_figure" if space.stability_included else given
        raise ValueError(f"branch: given {given}; accepted: a branch of orbits or solutions in a parameter")
    state = plain(space.state_names[0])
    low, high = np.array([[side[0] for side in extremes(solution)] for solution in branch.solutions]).T
    from matplotlib.lines import Line2D

    panels: list[tuple[str, list[Array]]] = [(f"{state}: largest and smallest value", [high, low])]
    panels += _second_panel(branch, space)
    with style():
        figure = blank(6.0, 3.6 if len(panels) == 1 else 5.6)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (label, curves) in zip(axes, panels, strict=True):
            for curve, colour in zip(curves, colours(len(curves)), strict=True):
                path = np.column_stack([branch.values, curve])
                draw_lines(panel, branch, path, stability_pieces(branch, path), colour)
                draw_marks(panel, branch, path, "black")
            if len(curves) == 2:
                handles = [Line2D([], [], color=colour, lw=2.0) for colour in colours(2)]
                panel.legend(handles, ["largest", "smallest"], loc="best")
            panel.set_ylabel(label)
        axes[-1].set_xlabel(plain(space.parameter))
        axes[0].set_title(_title(branch.solutions[0], title, (space.parameter, *space.statement.free)), y=1.0)
        return finished(figure, axes, 5, in_black=True, plain=True)


def _second_panel(branch: Branch, space: BoundarySpace) -> list[tuple[str, list[Array]]]:
    """The period where it is unknown, else the largest multiplier where there are multipliers."""
    if space.periodic is not None and PERIOD in space.statement.free:
        return [("period", [branch.period])]
    if not branch.with_stability or not branch.orbits[0].floquet().others.size:
        return []
    return [("largest |multiplier|", [branch.max_abs_multiplier])]


def orbit_figure(solution: Solution, title: str = "") -> Figure:
    """States against time over the interval or the period and, of two or more, the plane of the first two.

    Of many states the first six are drawn; of many positions of a family those that move most, the largest first.

    Arguments:
        solution: an orbit of any kind, or a solution of a boundary-value problem.
        title: stands in place of the name of the model.

    Returns:
        The figure.
    """
    chosen, t, known = drawn_states(solution), times(solution), len(solution.space.state_names)
    names, x, plane = _names(solution, chosen), _states(solution, t, chosen), in_plane(solution, t)
    with style():
        figure = blank(5.0 if plane is None else 8.0, 3.6)
        axes = figure.subplots(1, 1 if plane is None else 2, squeeze=False)[0]
        for i, colour in enumerate(colours(len(names))):
            axes[0].plot(t, x[:, i], color=colour, ls=DASHES[i], lw=1.4, label=names[i])
        more = f" ({len(names)} of {known})" if known > len(names) else ""
        axes[0].set(xlabel="t", ylabel=f"states{more}", xlim=(t[0], t[-1]))
        if plane is not None:
            points, labels = plane
            axes[1].plot(*points.T, color="black", lw=1.4)
            words = "t = 0" if isinstance(solution, Orbit) else f"t = {t[0]:.4g}"
            axes[1].plot(*points[0], "o", ms=5, mfc="white", mec="black", label=words)
            axes[1].set(xlabel=labels[0], ylabel=labels[1])
        figure.suptitle(orbit_title(solution, title))
        return finished(figure, axes, SHOWN + 1, plain=True)


def drawn_states(solution: Solution) -> Indices:
    """Indices of the states that are drawn, six at the most: of a family with more positions those that move most."""
    count = len(solution.space.state_names)
    if count <= SHOWN or not isinstance(solution.space, Family):
        return np.arange(min(count, SHOWN))
    return np.argsort(-np.abs(_states(solution, np.zeros(1), np.arange(count))[0]), kind="stable")[:SHOWN]


def _names(solution: Solution, chosen: Indices) -> list[str]:
    return [plain(solution.space.state_names[i]) for i in chosen]


def _states(solution: Solution, t: Array, chosen: Indices) -> Array:
    if isinstance(solution, Orbit):
        return solution.evaluate(t, solution.output_sites[chosen])
    return solution.evaluate(t)[:, chosen]


def times(solution: Solution) -> Array:
    """Times over the interval or the period at which a solution looks smooth: those of its mesh among them."""
    start, end = solution.interval
    even = np.linspace(start, end, SAMPLES)
    if not isinstance(solution.point.problem, BoundaryProblem):
        return even
    return np.unique(np.concatenate([even, np.clip(solution.t, start, end)]))


def in_plane(solution: Solution, t: Array) -> tuple[Array, tuple[str, str]] | None:
    """Points of a solution in the plane of the first two states drawn, shape (times, 2), and the names of the axes.

    Of an orbit of a family with one position that and its velocity; None for another solution with one state.
    """
    chosen = drawn_states(solution)[:2]
    names, x = _names(solution, chosen), _states(solution, t, chosen)
    if len(names) > 1:
        return x, (names[0], names[1])
    if not (isinstance(solution, Orbit) and isinstance(solution.space, Family)):
        return None
    velocity = cosine_curve(solution).points(solution.Omega * t)[0][:, 1]
    return np.column_stack([x, velocity]), (names[0], rf"velocity of {names[0]} over $\Omega$")


def orbit_title(solution: Solution, name: str = "") -> str:
    """A solution in words: its model, with mode and S of an orbit of a family, or with the period of another orbit."""
    words = _title(solution, name, ())
    if isinstance(solution.space, Family):
        assert isinstance(solution, Orbit)
        return f"{words}, $j = {solution.space.coordinates.mode_number}$, $S = {number(solution.S)}$"
    return f"{words}, period ${number(solution.period)}$" if isinstance(solution, Orbit) else words


def _title(solution: Solution, name: str, without: tuple[str, ...]) -> str:
    known = {key: value for key, value in solution.parameters.items() if key not in without}
    return model_title(solution.space.model, known, name)
